"""The paper's figures, tables and claims as files: pictures, tables of numbers, a Markdown table and a page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from hyperflex import checks, files
from hyperflex.interruption import interruptible
from hyperflex.paper import casting, estimation, identification, timing
from hyperflex.paper.part import Claim, Part, Table, claims_table, verdicts
from hyperflex.report import (
    Picture,
    Progress,
    Section,
    check_folder,
    png,
    sections_markdown,
    silent,
    whole_folder,
    write_page,
    write_pictures,
)

PARTS = (identification.PART, estimation.PART, casting.PART, timing.PART)
FIGURES = tuple(name for part in PARTS for name in part.items)
Done = tuple[Part, list[Claim], list[Section]]
TEXTS = ("claims.md", "report.html")  # what is written when all is done


@dataclass(frozen=True)
class Reproduction:
    """The files and results of :func:`reproduce`."""

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
        estimation, "fig9" to "fig12" on casting, "fig13" on timing control, or "all". The claims of each of the four
        parts that has one of them are measured too.
    directory, progress
        Folder to write to, see :func:`hyperflex.report.folder.whole_folder`; called with the present task.
    written : callable, optional
        Called with each file when it has been written: those of a figure when it is done, the claims and the page in
        the end.

    Raises
    ------
    InvalidInput
        A name that is not known.
    FileProblem
        The folder cannot be made or filled; what cannot be written in the end is in a fallback folder, which the
        message names.
    """
    chosen = [checks.choice("figure", name, (*FIGURES, "all")) for name in names]
    folder, paths, done = Path(directory), list[Path](), list[Done]()
    check_folder(folder)

    def note(made: list[Path]) -> None:
        for path in made:
            paths.append(path)
            if written is not None:
                written(path)

    for part in PARTS:
        wanted = [name for name in part.items if name in chosen or "all" in chosen]
        if not wanted:
            continue
        progress(part.message)
        sections = list[Section]()
        for name in wanted:
            progress(f"making {name}")
            item = part.items[name]
            shown = {} if item.draw is None else {name: Picture(png(item.draw()), item.caption)}
            note(files.rescued(partial(_write_item, name, shown, item.table()), folder))
            sections += item.sections()
            sections += [Section(f"Figure {name[3:]}", pictures=(each,)) for each in shown.values()]
        progress("measuring the claims")
        done.append((part, part.claims(), [*sections, *part.sections()]))
    note(files.rescued(partial(_write_texts, done), folder))
    return Reproduction(tuple(paths), tuple(claim for _, claims, _ in done for claim in claims))


def _write_item(name: str, shown: dict[str, Picture], table: Table, folder: Path) -> list[Path]:
    with whole_folder(folder, TEXTS) as stage:
        files.write_table(
            stage / f"{name}.csv", list(table.columns), np.transpose(list(table.columns.values())), notes=table.notes
        )
        write_pictures(stage, shown)
        return sorted(folder / path.name for path in stage.iterdir())


def _write_texts(done: list[Done], folder: Path) -> list[Path]:
    texts, page = list[str](), list[Section]()
    for part, claims, sections in done:
        found = Section(
            f"Claims: {part.title}",
            text=verdicts(claims),
            tiles=((f"{sum(claim.holds for claim in claims)} of {len(claims)}", "claims hold, counted in each case"),),
            table=claims_table(claims),
        )
        page += [found, *sections]
        unpictured = [each for each in sections if not each.pictures]
        texts.append(sections_markdown(f"{part.title}, simulated", [found, *unpictured]))
    title, lead = "; ".join(part.title for part, *_ in done), " ".join(part.lead for part, *_ in done)
    with whole_folder(folder) as stage:
        files.write_text(stage / TEXTS[0], "\n".join(texts))
        write_page(stage / TEXTS[1], title, lead, "simulated", page)
    return [folder / name for name in TEXTS]
