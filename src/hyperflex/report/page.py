"""One-page reports: sections, pictures and tables in a single HTML file; tables as Markdown too."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hyperflex import files

if TYPE_CHECKING:
    from jinja2 import Environment


@dataclass(frozen=True)
class TextTable:
    """A table of ready-made cells, as many in each row as there are column names in the header."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Picture:
    """The bytes of a PNG, and its caption, which is also the text for those who cannot see it."""

    content: bytes
    caption: str
    chart: bool = True  # it has text: on a phone it scrolls instead of being shrunk

    @property
    def source(self) -> str:
        """The picture as a data URL."""
        return f"data:image/png;base64,{base64.b64encode(self.content).decode('ascii')}"


@dataclass(frozen=True)
class Film:
    """A player's HTML document, and the caption below it."""

    document: str
    caption: str


@dataclass(frozen=True)
class Section:
    """A headed part of a page, shown in the order verdict, text, tiles, marks, pictures, table, notes."""

    title: str
    verdict: tuple[bool, str] | None = None  # conclusion: whether it is positive, and its text
    text: tuple[str, ...] = ()  # paragraphs
    tiles: tuple[tuple[str, str], ...] = ()  # key figures: value and what it is
    marks: tuple[tuple[bool, str], ...] = ()  # findings: whether each is positive, and its text
    pictures: tuple[Picture | Film, ...] = ()  # below each other
    table: TextTable | None = None  # in full; wide ones scroll
    notes: tuple[str, ...] = ()  # small print
    folded: str = ""  # if given, pictures and table are hidden below this line until it is clicked
    anchor: str = ""  # its address in the page, for `links`
    links: tuple[tuple[str, str], ...] = ()  # anchors of other sections, and the links' texts


def write_page(path: str | Path, title: str, lead: str, badge: str, sections: list[Section]) -> None:
    """Write a page, whole or not at all: heading, the paragraph under it, and sections.

    The badge is a short label above the title, such as "simulated".
    """
    files.write_text(path, render("page.html", title=title, lead=lead, badge=badge, sections=sections))


def write_pictures(folder: Path, shown: Mapping[str, Picture | Film]) -> dict[str, str]:
    """Write pictures, not films, as PNG; return their names by those in `shown`."""
    pictures = {name: each.content for name, each in shown.items() if isinstance(each, Picture)}
    for name, content in pictures.items():
        files.write_bytes(folder / f"{name}.png", content)
    return {name: f"{name}.png" for name in pictures}


def render(template: str, *, room: str = "hyperflex.report", **content: Any) -> str:
    """Return a template of a `room` with its content filled in; it may include those of this one."""
    return environment(room, autoescape=True).get_template(template).render(**content)


def environment(room: str = "hyperflex.report", **options: Any) -> "Environment":
    """Return the templates of a `room` and of this one; `options` are passed to Jinja."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    from hyperflex import __version__

    loader = ChoiceLoader([PackageLoader(each, "templates") for each in dict.fromkeys((room, "hyperflex.report"))])
    result = Environment(loader=loader, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, **options)
    result.globals["version"] = __version__
    return result


def markdown(table: TextTable) -> str:
    """Return a table as Markdown, columns padded so that it reads well as plain text too."""
    cells = [[cell.replace("|", r"\|") for cell in line] for line in (table.header, *table.rows)]
    widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
    lines = [f"| {' | '.join(map(str.ljust, line, widths))} |" for line in cells]
    lines.insert(1, f"|{'|'.join('-' * (width + 2) for width in widths)}|")
    return "\n".join(lines)


def sections_markdown(title: str, sections: Sequence[Section]) -> str:
    """Return the text, findings, tables and notes of sections as Markdown; pictures are omitted."""
    made = environment()
    made.filters["markdown"] = markdown
    return made.get_template("page.md").render(title=title, sections=sections).strip() + "\n"
