"""One-page reports: a single HTML file with its pictures inside, so that it can be mailed or archived as it is."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

from hyperflex import files
from hyperflex.report.tables import TextTable

_KINDS = {b"\x89PNG": "image/png", b"GIF8": "image/gif"}


@dataclass(frozen=True)
class Picture:
    """A PNG or GIF with its caption.

    Attributes
    ----------
    content : bytes
        The file's bytes.
    caption : str
        What to see in it; also the text for those who cannot see it.
    """

    content: bytes
    caption: str

    @property
    def source(self) -> str:
        """The picture as a data URL."""
        kind = next(kind for magic, kind in _KINDS.items() if self.content.startswith(magic))
        return f"data:{kind};base64,{base64.b64encode(self.content).decode('ascii')}"


@dataclass(frozen=True)
class Section:
    """A headed part of a page, shown in the order verdict, text, tiles, marks, pictures, table, notes.

    Attributes
    ----------
    title : str
        Heading.
    verdict : (bool, str), optional
        What it comes to: whether that is good news, and its sentence.
    text : tuple of str
        Paragraphs.
    tiles : tuple of (str, str)
        Key figures: value and what it is.
    marks : tuple of (bool, str)
        Findings: whether each is good news, and its sentence.
    pictures : tuple of Picture
        Shown below each other.
    table : TextTable, optional
        Shown in full; wide ones scroll.
    notes : tuple of str
        Small print.
    folded : str
        If given, pictures and table wait below this line until somebody clicks on it.
    anchor : str
        Its address in the page, for `links`.
    links : tuple of (str, str)
        Anchors of other sections, and what to say of them.
    """

    title: str
    verdict: tuple[bool, str] | None = None
    text: tuple[str, ...] = ()
    tiles: tuple[tuple[str, str], ...] = ()
    marks: tuple[tuple[bool, str], ...] = ()
    pictures: tuple[Picture, ...] = ()
    table: TextTable | None = None
    notes: tuple[str, ...] = ()
    folded: str = ""
    anchor: str = ""
    links: tuple[tuple[str, str], ...] = ()


def write_page(path: str | Path, title: str, lead: str, badge: str, sections: list[Section]) -> None:
    """Write a page, whole or not at all.

    Parameters
    ----------
    path : str or Path
        Where to write, usually ending in ``.html``.
    title, lead : str
        Heading and the paragraph under it.
    badge : str
        A short label above the title, such as "simulated".
    sections : list of Section
        The content.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from hyperflex import __version__

    loader = PackageLoader("hyperflex.report", "templates")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.get_template("page.html")
    text = template.render(title=title, lead=lead, badge=badge, sections=sections, version=__version__)
    files.write_text(path, text)
