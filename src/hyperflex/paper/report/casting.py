"""The part of the reproduction that is on casting (paper section IV): figures, claims, sections of the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from hyperflex import paper
from hyperflex.paper import OUTCOMES, T_MOVE, T_REST, cable, casting_arm
from hyperflex.paper.report import casting_figures as casting
from hyperflex.paper.report.part import Part, write_picture
from hyperflex.paper.report.tables import reaches_table
from hyperflex.report.page import Picture, Section
from hyperflex.report.style import png

NAMES = ("fig9", "fig10", "fig11", "fig12")
TITLE = "Casting a rope by swinging"
CLAIMS = "Claims of the paper on casting, simulated"
LEAD = (
    "Casting by swinging, open loop: section IV of Suzuki and Ebihara, Casting Control for Hyper-Flexible Manipulation "
    "(ICRA 2007), simulated with the paper's own cable in the four readings that the paper leaves open."
)
_CAPTIONS = {
    "fig9": "Arm angle. The failing rest of 0.34 s is inferred from the paper's c = 0.34 s.",
    "fig10": "Tip position in the four readings.",
    "fig11": "Spiral coordinates of the tip; shaded while the arm of the success moves (line below).",
    "fig12": "Phase portraits of the tip, thick while the arm moves, thin while it rests.",
}


def write(wanted: Sequence[str], folder: Path, tell: Callable[[str], None]) -> Part:
    """Write the wanted figures to `folder`."""
    tell("simulating the casts")
    casts = paper.casts()
    written: list[str] = []
    pictures = []
    for name in wanted:
        tell(f"drawing {name}")
        content = png(getattr(casting, name)(casts))
        written += write_picture(folder, name, content, getattr(paper, name)())
        pictures.append(Picture(content, _CAPTIONS[name]))
    tell("measuring the claims on casting")
    claims = paper.claims()
    rests = " and ".join(f"{T_REST[outcome]:.2f} s ({outcome})" for outcome in OUTCOMES)
    sections = [
        Section("Figures", text=(f"Rest between the arm's motions: {rests}.",), pictures=tuple(pictures)),
        Section("Reach of the tip", text=("Greatest |x| of the tip in each 2 s, m.",), table=reaches_table()),
        Section("Set-up", text=(_setup_text(),)),
    ]
    return Part(written, claims, sections)


def _setup_text() -> str:
    rope, arm = cable(), casting_arm()
    return (
        f"Cable: {rope.total_length:g} m, {rope.total_mass:g} kg, radius {1e3 * rope.radius:g} mm, {rope.n_links} "
        f"rigid links, joint friction {rope.friction[0]:g} N m s/rad, inertia of the cylinder {rope.inertia[0]:.4g} "
        f"kg m^2 a link (the printed 3.37e-4 is a slip). Arm: {1e3 * arm.length:g} mm, half a turn in {T_MOVE:g} s "
        "with bang-bang acceleration, then a rest. The rope starts hanging at rest, the arm at -90 degrees."
    )
