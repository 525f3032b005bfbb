"""The part on casting by swinging (paper section IV): Figs. 9 to 12, claims C1 to C4, and the table of reaches."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.paper import casting
from hyperflex.paper.casting import (
    OUTCOMES,
    READINGS,
    T_MOVE,
    T_REST,
    TIME_CONSTANT,
    Cast,
    Outcome,
    Reading,
    cable,
    cast,
    casting_arm,
    casts,
    reach_table,
)
from hyperflex.paper.linearization import linearized
from hyperflex.paper.report.part import Item, Part
from hyperflex.paper.results import Claim
from hyperflex.report import BLUE, GREY, INK, OUTCOME_COLOUR, Picture, Section, TextTable, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DASH: dict[Outcome, Any] = {"success": "-", "failure": (0, (4.0, 1.6))}
_NAME: dict[Outcome, str] = {
    "success": f"success (rest {T_REST['success']:.2f} s)",
    "failure": f"failure, inferred (rest {T_REST['failure']:.2f} s)",
}
_TOP = 3.0  # m, whip spikes of r and of the portrait are cut off here so that the steps can be seen


def fig9() -> Figure:
    """Arm angle of success and failure, through the bottom and over the top."""
    with new_figure(8.0, 3.6, "Actuation pattern (Fig. 9)") as figure:
        axes = figure.subplots(2, 1, sharex=True)
        ways = (("under", "through the bottom"), ("over", "over the top"))
        for axis, (path, title) in zip(axes, ways, strict=True):
            reading = next(each for each in READINGS if each.path == path)
            _lines(axis, reading, lambda subject: np.degrees(subject.arm_angle))
            axis.set_title(title)
            axis.set_ylabel("arm, degrees")
            axis.set_yticks([-90, 0, 90] if path == "under" else [-270, -180, -90])
        _finish(figure, axes)
    return figure


def fig10() -> Figure:
    """Tip position of success and failure in each reading."""
    with new_figure(10.0, 8.4, "Tip position, simulated (Fig. 10)") as figure:
        axes = figure.subplots(len(READINGS), 2, sharex=True, sharey="col")
        for row, reading in zip(axes, READINGS, strict=True):
            _lines(row[0], reading, lambda subject: subject.tip[:, 0])
            _lines(row[1], reading, lambda subject: subject.tip[:, 1])
            row[0].set(ylabel="tip x, m", title=reading.title)
            row[1].set_ylabel("tip y, m")
        _finish(figure, axes)
    return figure


def fig11() -> Figure:
    """Spiral coordinates r and theta in each reading, with the arm of the success."""
    with new_figure(10.0, 8.4, "Spiral coordinates, simulated (Fig. 11)") as figure:
        axes = figure.subplots(len(READINGS), 2, sharex=True)
        for row, reading in zip(axes, READINGS, strict=True):
            success = cast(reading, "success")
            for start, end in success.intervals:
                label = "the successful arm moves" if start == 0.0 else None
                row[0].axvspan(start, min(end, success.t[-1]), color=BLUE, alpha=0.08, lw=0, label=label)
            _lines(row[0], reading, lambda subject: subject.spiral.r)
            _lines(row[1], reading, lambda subject: subject.spiral.theta)
            swing = (success.arm_angle - success.arm_angle.min()) / np.ptp(success.arm_angle)
            row[0].plot(success.t, 0.35 * swing - 0.45, color=GREY, lw=0.8)
            row[0].set(ylim=(-0.55, _TOP), ylabel="r, m", title=reading.title)
            row[1].set(ylabel="theta, rad")
        _finish(figure, axes)
        greatest = max(float(subject.spiral.r.max()) for subject in casts().values())
        _cut_note(figure, f"r is cut off at {_TOP:g} m: the tip cracks like a whip, and r spikes to {greatest:.1f} m")
    return figure


def fig12() -> Figure:
    """Phase portraits, thick while the arm moves, thin while it rests; circles at its starts, crosses at its ends."""
    with new_figure(11.0, 5.9) as figure:
        axes = figure.subplots(len(OUTCOMES), len(READINGS), sharex="row", sharey="row")
        for row, outcome in zip(axes, OUTCOMES, strict=True):
            for axis, reading in zip(row, READINGS, strict=True):
                _portrait(axis, cast(reading, outcome), OUTCOME_COLOUR[outcome])
                axis.set_xlabel("x, m")
            row[0].set_ylabel(f"{outcome}: c dx/dt, m   (c = {TIME_CONSTANT[outcome]:.2f} s)")
        for axis, reading in zip(axes[0], READINGS, strict=True):
            axis.set_title(reading.title.replace(", ", ",\n"), fontsize=8.5)
        figure.suptitle(
            "Phase portrait of the tip, simulated (Fig. 12). Thick: the arm moves; thin: it rests; "
            "circle: start; cross: end of a motion",
            x=0.01,
            ha="left",
            fontsize=9.5,
            color=INK,
        )
        greatest = max(float(np.abs(subject.spiral.scaled_velocity).max()) for subject in casts().values())
        _cut_note(
            figure, f"cut off at {_TOP:g} m: the tip cracks like a whip, and |c dx/dt| spikes to {greatest:.1f} m"
        )
    return figure


def _cut_note(figure: Figure, text: str) -> None:
    """Say at the foot of a figure what its axes leave out."""
    figure.supxlabel(f"Note: {text}; the CSV file is not cut off.", x=0.01, ha="left", fontsize=8.0, color=INK)


def _portrait(axis: Any, subject: Cast, colour: str) -> None:
    from matplotlib.collections import LineCollection

    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    for radius in np.arange(0.5, _TOP + 0.1, 0.5):
        axis.plot(radius * np.cos(angle), radius * np.sin(angle), color="#dfe3e9", lw=0.7, zorder=0)
    portrait = subject.portrait
    axis.add_collection(LineCollection(portrait.resting, colors=colour, linewidths=0.6, alpha=0.8))
    axis.add_collection(LineCollection(portrait.moving, colors=colour, linewidths=1.9, alpha=0.75))
    axis.plot(*portrait.starts.T, "o", ms=4.0, mfc="white", mec=INK, mew=0.9)
    axis.plot(*portrait.ends.T, "x", ms=4.5, mec=INK, mew=1.1)
    axis.set(xlim=(-_TOP, _TOP), ylim=(-_TOP, _TOP), aspect="equal")
    axis.grid(False)


def _lines(axis: Any, reading: Reading, values: Callable[[Cast], Array]) -> None:
    """Draw what is measured of the failure and of the success over time."""
    for outcome in reversed(OUTCOMES):
        subject, style = cast(reading, outcome), {"color": OUTCOME_COLOUR[outcome], "ls": _DASH[outcome]}
        axis.plot(subject.t, values(subject), label=_NAME[outcome], lw=1.3, **style)
        axis.set_xlim(subject.t[0], subject.t[-1])


def _finish(figure: Figure, axes: Any) -> None:
    for axis in np.atleast_2d(axes)[-1] if np.ndim(axes) == 2 else [axes[-1]]:
        axis.set_xlabel("time, s")
    handles, labels = np.ravel(axes)[0].get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda k: (labels[k] not in _NAME.values(), labels[k] != _NAME["success"]))
    figure.legend(
        [handles[k] for k in order],
        [labels[k] for k in order],
        loc="outside upper right",
        ncols=len(order),
        fontsize=8.5,
    )


def reaches_table() -> TextTable:
    """Return the greatest ``|x|`` of the tip in each 2 s, for every reading and outcome."""
    rows = []
    for reading in READINGS:
        for outcome in OUTCOMES:
            reaches = reach_table(cast(reading, outcome))
            rest = f"{outcome} (rest {T_REST[outcome]:.2f} s)"
            rows.append((reading.title, rest, *(f"{reach:.2f}" for reach in reaches)))
    windows = tuple(f"{2 * k}-{2 * k + 2} s" for k in range(len(rows[0]) - 2))
    return TextTable(("reading", "cast", *windows), tuple(rows))


def _setup_text() -> str:
    rope, arm = cable(), casting_arm()
    return (
        f"Cable: {rope.total_length:g} m, {rope.total_mass:g} kg, radius {1e3 * rope.radius:g} mm, {rope.n_links} "
        f"rigid links, joint friction {rope.friction[0]:g} N m s/rad, inertia of the cylinder {rope.inertia[0]:.4g} "
        f"kg m^2 a link (the printed 3.37e-4 is a slip). Arm: {1e3 * arm.length:g} mm, half a turn in {T_MOVE:g} s "
        "with bang-bang acceleration, then a rest. The rope starts hanging at rest, the arm at -90 degrees."
    )


def _sections(_: list[Section], pictures: tuple[Picture, ...]) -> list[Section]:
    rests = " and ".join(f"{T_REST[outcome]:.2f} s ({outcome})" for outcome in OUTCOMES)
    return [
        Section("Figures", text=(f"Rest between the arm's motions: {rests}.",), pictures=pictures),
        Section("Reach of the tip", text=("Greatest |x| of the tip in each 2 s, m.",), table=reaches_table()),
        Section("Set-up", text=(_setup_text(),)),
    ]


def casting_claims() -> list[Claim]:
    """Measure C1 to C4 in the four readings."""
    measures = (linearized, casting.success_over_failure, casting.straight_phase, casting.steady_step_phase)
    return [measure(reading) for measure in measures for reading in READINGS]


PART = Part(
    title="Casting a rope by swinging",
    lead=(
        "Casting by swinging, open loop: section IV of Suzuki and Ebihara, Casting Control for Hyper-Flexible "
        "Manipulation (ICRA 2007), simulated with the paper's own cable in the four readings that the paper leaves "
        "open."
    ),
    claims_title="Claims of the paper on casting, simulated",
    message="simulating the casts",
    items={
        "fig9": Item(
            casting.fig9, fig9, "Arm angle. The failing rest of 0.34 s is inferred from the paper's c = 0.34 s."
        ),
        "fig10": Item(casting.fig10, fig10, "Tip position in the four readings."),
        "fig11": Item(
            casting.fig11,
            fig11,
            "Spiral coordinates of the tip; shaded while the arm of the success moves (line below).",
        ),
        "fig12": Item(
            casting.fig12, fig12, "Phase portraits of the tip, thick while the arm moves, thin while it rests."
        ),
    },
    claims=casting_claims,
    sections=_sections,
)
