"""The paper's figures, tables and claims as files: pictures, tables of numbers, a Markdown table and a page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hyperflex import checks, files
from hyperflex.interruption import interruptible
from hyperflex.paper.report import casting, estimation, identification, timing
from hyperflex.paper.report.part import TEXTS, Part, Written, claims_table, verdicts, write_part
from hyperflex.paper.results import Claim
from hyperflex.report import Progress, Section, check_folder, sections_markdown, silent, whole_folder, write_page

PARTS = (identification.PART, estimation.PART, casting.PART, timing.PART)
FIGURES = tuple(name for part in PARTS for name in part.items)


@dataclass(frozen=True)
class Reproduction:
    """What :func:`reproduce` wrote and found."""

    files: tuple[Path, ...]
    claims: tuple[Claim, ...]


@interruptible()
def reproduce(
    names: Sequence[str],
    directory: str | Path,
    *,
    progress: Progress = silent,
    written: Callable[[Path], None] | None = None,
) -> Reproduction:
    """Write figures of the paper (PNG and CSV), the table of its claims (Markdown) and a page that shows it all.

    Parameters
    ----------
    names : sequence of str
        Which figures and tables: "table1", "table2", "fig3", "fig5", "fig6" on identification, "fig8" on online
        estimation, "fig9" to "fig12" on casting, "fig13" on timing control, or "all". The claims of whichever of the
        four is asked for are measured with them.
    directory, progress
        Folder to write to, see :func:`hyperflex.report.folder.whole_folder`; called with what is being done.
    written : callable, optional
        Called with each file as soon as it stands: those of a figure are written when it is done, the claims and the
        page in the end.

    Raises
    ------
    InvalidInput
        A name that is not known.
    FileProblem
        The folder cannot be made or filled; what cannot be written in the end is in a fallback folder, which the
        message names.
    """
    chosen = [checks.choice("figure", name, (*FIGURES, "all")) for name in names]
    figures = [name for name in FIGURES if "all" in chosen or name in chosen]
    check_folder(directory)
    paths: list[Path] = []

    def note(path: Path) -> None:
        paths.append(path)
        if written is not None:
            written(path)

    parts = [(part, [name for name in figures if name in part.items]) for part in PARTS]
    done = [(part, write_part(part, own, Path(directory), progress, note)) for part, own in parts if own]
    texts = [
        sections_markdown(part.claims_title, [_verdict(part, each), *(s for s in each.sections if not s.pictures)])
        for part, each in done
    ]
    sections = [section for part, each in done for section in (_verdict(part, each), *each.sections)]
    title, lead = "; ".join(part.title for part, _ in done), " ".join(part.lead for part, _ in done)

    def write(folder: Path) -> None:
        with whole_folder(folder) as stage:
            files.write_text(stage / "claims.md", "\n".join(texts))
            write_page(stage / "report.html", title, lead, "simulated", sections)

    files.rescued(write, Path(directory))
    for name in TEXTS:
        note(Path(directory) / name)
    return Reproduction(tuple(paths), tuple(claim for _, each in done for claim in each.claims))


def _verdict(part: Part, done: Written) -> Section:
    held = sum(claim.holds for claim in done.claims)
    return Section(
        f"Claims: {part.title[0].lower()}{part.title[1:]}",
        text=verdicts(done.claims),
        tiles=((f"{held} of {len(done.claims)}", "claims hold, each counted once in each reading or swing"),),
        table=claims_table(done.claims),
    )
