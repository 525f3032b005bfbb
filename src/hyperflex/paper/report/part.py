"""A part of the paper as it is reproduced: items to write (figures, tables), claims and sections of the page."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hyperflex import files
from hyperflex.paper.casting import Reading
from hyperflex.paper.results import Claim, Table
from hyperflex.report import Picture, Progress, Section, TextTable, png, whole_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEXTS = ("claims.md", "report.html")  # what is written when all is done


@dataclass(frozen=True)
class Item:
    """A figure or table of the paper: its numbers, what draws it and its caption, or sections of the page."""

    table: Callable[[], Table]
    draw: "Callable[[], Figure] | None" = None
    caption: str = ""
    sections: Callable[[], list[Section]] = list


@dataclass(frozen=True)
class Part:
    """A part of the paper."""

    title: str
    lead: str
    claims_title: str  # of the text file of the claims
    message: str  # on what takes long
    items: Mapping[str, Item]  # by name, in the paper's order
    claims: Callable[[], list[Claim]]
    sections: Callable[[list[Section], tuple[Picture, ...]], list[Section]]  # given those of its tables, and pictures


@dataclass(frozen=True)
class Written:
    """Claims of a part, and its sections of the page."""

    claims: list[Claim]
    sections: list[Section]


def write_part(
    part: Part, names: Sequence[str], folder: Path, progress: Progress, note: Callable[[Path], None]
) -> Written:
    """Write the items of these names to `folder`, each when it is done, and measure the part's claims.

    `note` is called with each file that has been written.
    """
    progress(part.message)
    sections: list[Section] = []
    pictures = []
    for name in names:
        progress(f"making {name}")
        item = part.items[name]
        picture, table = None if item.draw is None else png(item.draw()), item.table()
        files.rescued(partial(_write_item, name, picture, table), folder)
        if picture is not None:
            pictures.append(Picture(picture, item.caption))
        for kind in ("csv",) if item.draw is None else ("png", "csv"):
            note(folder / f"{name}.{kind}")
        sections += item.sections()
    progress("measuring the claims")
    return Written(part.claims(), part.sections(sections, tuple(pictures)))


def _write_item(name: str, picture: bytes | None, table: Table, folder: Path) -> None:
    with whole_folder(folder, TEXTS) as stage:
        if picture is not None:
            files.write_bytes(stage / f"{name}.png", picture)
        rows = list(zip(*table.columns.values(), strict=True))
        files.write_table(stage / f"{name}.csv", list(table.columns), rows, notes=table.notes)


def claims_table(claims: Sequence[Claim], *, short: bool = False) -> TextTable:
    """Return measured values, thresholds and verdicts of the paper's claims; `short` omits statements and notes."""
    header = ("claim", "what is measured", "in", "value", "threshold", "verdict", "note")
    rows = (
        (
            claim.name,
            claim.statement,
            claim.case.title,
            f"{claim.measured:.3g}" if claim.measured < 0.1 else f"{claim.measured:.4f}",
            f"{claim.relation} {claim.threshold:g}",
            "holds" if claim.holds else "does not hold",
            claim.note,
        )
        for claim in claims
    )
    shown = [k for k, name in enumerate(header) if not short or name not in ("what is measured", "note")]
    return TextTable(tuple(header[k] for k in shown), tuple(tuple(row[k] for k in shown) for row in rows))


def verdicts(claims: Sequence[Claim]) -> tuple[str, ...]:
    """Return a sentence for each claim on where it holds and where not."""
    sentences = []
    for name in dict.fromkeys(claim.name for claim in claims):
        own = [claim for claim in claims if claim.name == name]
        titles = list(dict.fromkeys(claim.case.title for claim in own))
        broken = [title for title in titles if not all(c.holds for c in own if c.case.title == title)]
        kept = [title for title in titles if title not in broken]
        what = "readings" if isinstance(own[0].case, Reading) else "swings"
        if not broken:
            sentences.append(f"{name} holds in all {len(titles)} {what}.")
        elif not kept:
            sentences.append(f"{name} holds in none of the {len(titles)} {what}.")
        else:
            sentences.append(
                f"{name} holds in {len(kept)} of {len(titles)} {what} ({'; '.join(kept)}), "
                f"not in the others ({'; '.join(broken)})."
            )
    return tuple(sentences)
