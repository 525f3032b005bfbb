"""The part of the reproduction that is on identification (paper section III): tables, figures, claims, sections."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from hyperflex import paper
from hyperflex.identification import IterativeRevision, RevisionProfile
from hyperflex.paper import SWINGS, methods, revised
from hyperflex.paper.identification import LENGTH, LINK_MASS, LINKS, NOISE, POINTS, RATE, guess, per_sample, true_rope
from hyperflex.paper.identification_figures import DRAWN, periods_text
from hyperflex.paper.report import identification_figures as revision_figures
from hyperflex.paper.report.part import Part, write_numbers, write_picture
from hyperflex.report.page import Picture, Section
from hyperflex.report.style import png
from hyperflex.report.tables import TextTable

NAMES = ("table1", "table2", "fig3", "fig5", "fig6")
TITLE = "Identifying a rope by iterative revision"
CLAIMS = "Claims of the paper on identification, simulated"
LEAD = (
    "Identification by iterative revision: section III of Suzuki and Ebihara, Casting Control for Hyper-Flexible "
    "Manipulation (ICRA 2007), on a simulated twin of its experiment. Length and mass of the rope are inferred."
)
PROFILES: tuple[RevisionProfile, ...] = ("response", "calculated", "measured", "measured rates")
_CAPTIONS = {
    "fig3": "Initial angles as measured and as the downhill simplex finds them, and what the tip link is off by from "
    "either start, with the revised J and eta.",
    "fig5": "Angle of the last link: measured, with the first guess (and the initial angles that suit it best), and "
    "after the revision. Below, measured less calculated.",
    "fig6": "E over all 81 samples after a revision that used only the first ones. The paper's two printed values are "
    "marked.",
}
_PAPER_TABLE1 = (("5.09", "1.26", "4.64"), ("0.143", "0.631", "2.23"), ("0.143", "0.631", "2.23"))
_PAPER_TABLE2 = {"NF": ("102", "16.3"), "CM": ("5.09", "2.62"), "IR": ("0.143", "2.23"), "IR(theta_0)": ("0.143", "")}


def write(wanted: Sequence[str], folder: Path, tell: Callable[[str], None]) -> Part:
    """Write the wanted tables and figures to `folder`."""
    written: list[str] = []
    sections: list[Section] = []
    pictures = []
    for name in wanted:
        tell(f"making {name}; each revision takes a second or two")
        table = getattr(paper, name)()
        if name in _CAPTIONS:
            content = png(getattr(revision_figures, name)())
            written += write_picture(folder, name, content, table)
            pictures.append(Picture(content, _CAPTIONS[name]))
        else:
            written += write_numbers(folder, name, table)
            sections += _table1() if name == "table1" else _table2()
    tell("measuring the claims on identification")
    claims = paper.identification_claims()
    if pictures:
        sections.append(Section("Figures on identification", pictures=tuple(pictures)))
    sections.append(Section("Set-up of the identification", text=(_setup_text(),)))
    return Part(written, claims, sections)


def _table1() -> list[Section]:
    return [
        Section("Table I: change of J, eta and E", text=(_UNIT,), table=rounds_table()),
        Section("What step 4 may mean", text=_STEP4, table=profiles_table()),
    ]


def _table2() -> list[Section]:
    return [Section("Table II: NF, CM and IR", text=(f"T_nat: {periods_text()}.",), table=methods_table())]


_UNIT = (
    "E is the sum (7) over samples and links. The unit of the paper's errors is lost; read as sqrt(E / 81) in 0.01 "
    "rad, its 2.23 is 0.0403 rad^2, the 0.04 rad^2 of Fig. 6. A swing of 0.15 rad then gives its other errors too, "
    "within 15 %, so that is what we take its experiment for. J cannot be told from zero there; in the wide swing it "
    "just can."
)
_LITERAL = (
    "Read as it is printed, step 4 takes angles, rates and accelerations of the calculated motion. That motion fulfils "
    "(4) with the J and eta that it was calculated with, so (6) returns these, and nothing ever moves."
)
_MIXED = (
    "Measured angles and rates with calculated accelerations diverge: an error of an angle times gravity is a hundred "
    "times J's torque. With measured rates alone the rounds creep, and where the swing is small the noise of the rates "
    "takes eta down to nothing."
)
_RESPONSE = (
    "What is used here carries the torques of (5) through the linearised motion to the angles that they change, and "
    "fits those to what the calculated motion leaves of the measured one."
)
_STEP4 = (_LITERAL, _MIXED, _RESPONSE)


def rounds_table() -> TextTable:
    """Return J, eta and E of each round, with the paper's own beside them."""
    rows = [
        ("the paper", str(k), inertia, friction, "", error)
        for k, (inertia, friction, error) in enumerate(_PAPER_TABLE1)
    ]
    for swing in DRAWN:
        found = revised(swing)
        rows += [
            (
                swing.title,
                str(k),
                f"{1e6 * each.inertia:.3f}",
                f"{1e3 * each.friction:.3f}",
                f"{each.error:.4f}",
                f"{per_sample(each.error):.2f}",
            )
            for k, each in enumerate(found.rounds)
        ]
        rows.append(
            (swing.title, "sd", f"{1e6 * found.sd['inertia']:.3f}", f"{1e3 * found.sd['friction']:.3f}", "", "")
        )
    header = ("data", "revision", "J, 1e-6 kg m^2", "eta, 1e-3 N m s/rad", "E, rad^2", "sqrt(E/81), 0.01 rad")
    return TextTable(header, tuple(rows))


def methods_table() -> TextTable:
    """Return J and E of the methods of Table II."""
    rows = [("the paper", name, inertia, "", error) for name, (inertia, error) in _PAPER_TABLE2.items()]
    rows += [
        (
            swing.title,
            each.name,
            f"{1e6 * each.rope.inertia[0]:.3g}",
            f"{each.error:.4f}",
            f"{per_sample(each.error):.2f}",
        )
        for swing in DRAWN
        for each in methods(swing)
    ]
    return TextTable(("data", "method", "J, 1e-6 kg m^2", "E, rad^2", "sqrt(E/81), 0.01 rad"), tuple(rows))


def profiles_table() -> TextTable:
    """Return how the revision ends, for each reading of step 4."""
    rows = []
    for swing in SWINGS:
        for profile in PROFILES:
            found = revised(swing, profile=profile)
            last = found.rounds[-1]
            values = (f"{1e6 * last.inertia:.3g}", f"{1e3 * last.friction:.3g}", f"{last.error:.3g}")
            rows.append((swing.title, profile, *values, _ending(found)))
    header = ("data", "compared", "last J, 1e-6 kg m^2", "last eta, 1e-3 N m s/rad", "last E, rad^2", "end")
    return TextTable(header, tuple(rows))


def _ending(found: IterativeRevision) -> str:
    if found.converged_after is None:
        return f"{found.message} after {len(found.rounds) - 1} revisions"
    return "never moved" if found.converged_after == 0 else f"converged after {found.converged_after} revisions"


def _setup_text() -> str:
    truth, first = true_rope(), guess()
    return (
        f"Rope: {LENGTH:g} m and {LINK_MASS:g} kg a link (inferred), {LINKS} links, J = {truth.inertia[0]:g} kg m^2, "
        f"eta = {truth.friction[0]:g} N m s/rad; first guess J = {first.inertia[0]:.3g} (cylinder), "
        f"eta = {first.friction[0]:g}. It is held straight and let go at rest; {POINTS} samples at {RATE:g} frames a "
        f"second, noise {NOISE:g} rad rms. The finer rope has {DRAWN[-1].links} links, is a thin cylinder and "
        "bends with the same friction: the fitted J and eta are then what 5 links need to move like it."
    )
