"""The paper's figures and claims as files: pictures, tables of numbers, a Markdown table and a page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hyperflex import checks, files, paper
from hyperflex.paper import OUTCOMES, T_MOVE, T_REST, Claim, cable, casting_arm
from hyperflex.report import casting
from hyperflex.report.folder import whole_folder
from hyperflex.report.page import Picture, Section, write_page
from hyperflex.report.style import png
from hyperflex.report.tables import claims_table, markdown, reaches_table, verdicts

FIGURES = ("fig9", "fig10", "fig11", "fig12")
_CAPTIONS = {
    "fig9": "Arm angle. The failing rest of 0.34 s is inferred from the paper's c = 0.34 s.",
    "fig10": "Tip position in the four readings.",
    "fig11": "Spiral coordinates of the tip; shaded while the arm of the success moves (line below).",
    "fig12": "Phase portraits of the tip, thick while the arm moves, thin while it rests.",
}
_LEAD = (
    "Casting by swinging, open loop: section IV of Suzuki and Ebihara, Casting Control for Hyper-Flexible Manipulation "
    "(ICRA 2007), simulated with the paper's own cable in the four readings that the paper leaves open."
)


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
    names : sequence of {"fig9", "fig10", "fig11", "fig12", "all"}
        Which figures.
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
        names, claims = _write(wanted, stage, tell)
    return Reproduction(tuple(Path(directory) / name for name in names), claims)


def _write(
    wanted: Sequence[str], folder: Path, tell: Callable[[str], None]
) -> tuple[tuple[str, ...], tuple[Claim, ...]]:
    """Write everything to `folder`; return the names of the files, in order, and the claims."""
    tell("simulating the casts")
    casts = paper.casts()
    written: list[str] = []
    pictures = []
    for name in wanted:
        tell(f"drawing {name}")
        content = png(getattr(casting, name)(casts))
        with files.atomic(folder / f"{name}.png", "wb") as file:
            file.write(content)
        table = getattr(paper, name)()
        columns = list(table.columns.values())
        files.write_table(
            folder / f"{name}.csv", list(table.columns), list(zip(*columns, strict=True)), notes=table.notes
        )
        pictures.append(Picture(content, _CAPTIONS[name]))
        written += [f"{name}.png", f"{name}.csv"]
    tell("measuring the claims")
    claims = tuple(paper.claims())
    files.write_text(folder / "claims.md", _claims_text(claims))
    _write_page(folder / "report.html", pictures, claims)
    return (*written, "claims.md", "report.html"), claims


def _claims_text(claims: Sequence[Claim]) -> str:
    parts = [
        "# Claims of the paper on casting, simulated",
        markdown(claims_table(claims)).rstrip(),
        "\n".join(f"- {sentence}" for sentence in verdicts(claims)),
        "## Greatest |x| of the tip in each 2 s, m",
        markdown(reaches_table()),
    ]
    return "\n\n".join(parts)


def _write_page(path: Path, pictures: Sequence[Picture], claims: Sequence[Claim]) -> None:
    held = sum(claim.holds for claim in claims)
    rests = " and ".join(f"{T_REST[outcome]:.2f} s ({outcome})" for outcome in OUTCOMES)
    sections = [
        Section(
            "Claims",
            text=verdicts(claims),
            tiles=((f"{held} of {len(claims)}", "claims hold, each counted once in each reading"),),
            table=claims_table(claims),
        ),
        Section("Figures", text=(f"Rest between the arm's motions: {rests}.",), pictures=tuple(pictures)),
        Section("Reach of the tip", text=("Greatest |x| of the tip in each 2 s, m.",), table=reaches_table()),
        Section("Set-up", text=(_setup_text(),)),
    ]
    write_page(path, "Casting a rope by swinging", _LEAD, "simulated", sections)


def _setup_text() -> str:
    rope, arm = cable(), casting_arm()
    return (
        f"Cable: {rope.total_length:g} m, {rope.total_mass:g} kg, radius {1e3 * rope.radius:g} mm, {rope.n_links} "
        f"rigid links, joint friction {rope.friction[0]:g} N m s/rad, inertia of the cylinder {rope.inertia[0]:.4g} "
        f"kg m^2 a link (the printed 3.37e-4 is a slip). Arm: {1e3 * arm.length:g} mm, half a turn in {T_MOVE:g} s "
        "with bang-bang acceleration, then a rest. The rope starts hanging at rest, the arm at -90 degrees."
    )
