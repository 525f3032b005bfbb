"""The paper's figures, tables and claims as files: pictures, tables of numbers, a Markdown table and a page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hyperflex import checks, files
from hyperflex.paper import Claim
from hyperflex.paper.report import casting as casting_part
from hyperflex.paper.report import identification as identification_part
from hyperflex.paper.report import timing as timing_part
from hyperflex.paper.report.part import Part
from hyperflex.paper.report.tables import claims_table, verdicts
from hyperflex.report.folder import whole_folder
from hyperflex.report.page import Section, write_page
from hyperflex.report.tables import markdown

PARTS = (identification_part, casting_part, timing_part)
FIGURES = tuple(name for part in PARTS for name in part.NAMES)


@dataclass(frozen=True)
class Reproduction:
    """What :func:`reproduce` wrote and found.

    Attributes
    ----------
    files : tuple of Path
        What was written.
    claims : tuple of Claim
        The claims with their verdicts.
    """

    files: tuple[Path, ...]
    claims: tuple[Claim, ...]


def reproduce(
    names: Sequence[str], directory: str | Path, *, progress: Callable[[str], None] | None = None
) -> Reproduction:
    """Write figures of the paper (PNG and CSV), the table of its claims (Markdown) and a page that shows it all.

    Parameters
    ----------
    names : sequence of str
        Which figures and tables: "table1", "table2", "fig3", "fig5", "fig6" on identification, "fig9" to "fig12" on
        casting, "fig13" on timing control, or "all". The claims of whichever of the three is asked for are measured
        with them.
    directory : str or Path
        Folder to write to, whole or not at all; made if it is not there, other files in it stay.
    progress : callable, optional
        Told in words what is being done.

    Returns
    -------
    Reproduction

    Raises
    ------
    InvalidInput
        A name that is not known.
    FileProblem
        The folder cannot be made or written to.
    """
    chosen = [checks.choice("figure", name, (*FIGURES, "all")) for name in names]
    wanted = [name for name in FIGURES if "all" in chosen or name in chosen]
    tell = progress or (lambda _: None)
    with whole_folder(directory) as stage:
        written, claims = _write(wanted, stage, tell)
    return Reproduction(tuple(Path(directory) / name for name in written), claims)


def _write(
    wanted: Sequence[str], folder: Path, tell: Callable[[str], None]
) -> tuple[tuple[str, ...], tuple[Claim, ...]]:
    """Write everything to `folder`; return the names of the files, in order, and the claims."""
    written: list[str] = []
    claims: list[Claim] = []
    sections: list[Section] = []
    texts, leads, titles = [], [], []
    for part in PARTS:
        own = [name for name in wanted if name in part.NAMES]
        if not own:
            continue
        done = part.write(own, folder, tell)
        written += done.written
        claims += done.claims
        sections += [_verdict(part.TITLE, done.claims), *done.sections]
        texts.append(_claims_text(part.CLAIMS, done))
        leads.append(part.LEAD)
        titles.append(part.TITLE)
    files.write_text(folder / "claims.md", "\n\n".join(texts) + "\n")
    write_page(folder / "report.html", "; ".join(titles), " ".join(leads), "simulated", sections)
    return (*written, "claims.md", "report.html"), tuple(claims)


def _claims_text(title: str, done: Part) -> str:
    """Return the claims of a part and its tables as Markdown."""
    parts = [
        f"# {title}",
        markdown(claims_table(done.claims)).rstrip(),
        "\n".join(f"- {sentence}" for sentence in verdicts(done.claims)),
    ]
    for section in done.sections:
        if not section.pictures:
            parts += [f"## {section.title}", *section.text]
            parts += [markdown(section.table).rstrip()] if section.table else []
    return "\n\n".join(parts)


def _verdict(title: str, claims: Sequence[Claim]) -> Section:
    held = sum(claim.holds for claim in claims)
    return Section(
        f"Claims: {title[0].lower()}{title[1:]}",
        text=verdicts(claims),
        tiles=((f"{held} of {len(claims)}", "claims hold, each counted once in each reading or swing"),),
        table=claims_table(claims),
    )
