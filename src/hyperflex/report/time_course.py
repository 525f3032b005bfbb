"""The time course of a run: arm angle, two panels of its own, and the motor's torque; any run as a figure."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.report.shapes import span
from hyperflex.report.strobe import strobe_figure
from hyperflex.report.style import BLUE, GREEN, INK, RED, new_figure, note
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure


KINDS = ("strobe", "course")


class ArmMoves(NamedTuple):
    """Moves of the arm, in order: start and end (k,), s, angles between them (k + 1,), rad, and their names."""

    starts: Array
    ends: Array
    angles: Array
    names: tuple[str, ...]


def time_course(
    run: Trajectory, what: str, moves: ArmMoves | None, event: float, draw: Callable[[Any, Any], None]
) -> "Figure":
    """Draw a run over time: `moves` are named in the uppermost panel, and `draw` draws the two in the middle.

    The time `event`, s, is marked in all panels; NaN where there is none.
    """
    with new_figure(8.6, 8.2, f"Time course of {what}, simulated") as figure:
        axes = figure.subplots(4, 1, sharex=True, height_ratios=(1.15, 1.25, 1.0, 0.8))
        arm, upper, lower, torque = axes
        arm.plot(run.t, np.degrees(run.arm_angle), color=BLUE)
        numbered = "" if moves is None else ", its moves numbered"
        arm.set(ylabel="arm, degrees", title=f"Angle of the arm{numbered}")
        if moves is not None:
            _name(arm, moves)
        torque.plot(run.t, run.motor_torque, color=INK, lw=1.0)
        torque.set(ylabel="torque, N m", title="Torque of the motor for the rope", xlabel="time, s")
        draw(upper, lower)
        for axis in axes:
            axis.set_xlim(run.t[0], run.t[-1])
            if np.isfinite(event):
                axis.axvline(event, color=RED, lw=1.0, ls="--")
    return figure


def run_figure(
    run: Trajectory, kind: str = "strobe", *, start: float | None = None, end: float | None = None, title: str = ""
) -> "Figure":
    """Draw a run between two times, s: its ``"strobe"``, or its ``"course"``; InvalidInput for another kind or span."""
    if checks.choice("kind", kind, KINDS) == "strobe":
        return strobe_figure(run, start=start, end=end, title=title)
    shown = span(run, start, end)

    def draw(speed: Any, energy: Any) -> None:
        speed.plot(run.t, np.hypot(*run.tip_velocity.T), color=GREEN)
        speed.set(ylabel="speed, m/s", title="Speed of the tip")
        gained = run.potential_energy - run.potential_energy[0]
        lines = (("kinetic", run.kinetic_energy, BLUE), ("potential, from the start", gained, RED))
        for label, values, colour in (*lines, ("work of the motor", run.motor_work, GREEN)):
            energy.plot(run.t, values, color=colour, label=label)
        energy.set(ylabel="energy, J", title="Energy")
        energy.legend(loc="lower left", bbox_to_anchor=(0.12, 1.0), ncols=3, fontsize=8.0, borderaxespad=0.1)

    figure = time_course(run, title or "the run", None, np.nan, draw)
    for axis in figure.axes:
        axis.set_xlim(shown)
    return figure


def room_above(axis: Any) -> None:
    """Make room above the curves of a panel for notes."""
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.3 * (high - low))


def event_note(axis: Any, run: Trajectory, t: float, text: str) -> None:
    """Write a note at the top of a panel beside the line of an event at `t`, s, on the side with more room."""
    late = t > 0.5 * (run.t[0] + run.t[-1])
    place = {"transform": axis.get_xaxis_transform(), "va": "top", "ha": "right" if late else "left"}
    note(axis, t, 0.97, f"{text} " if late else f" {text}", RED, **place)


def _name(axis: Any, moves: ArmMoves) -> None:
    """Write the name of each move on the curve of the arm's angle."""
    patch = {"facecolor": "white", "edgecolor": "#b9c0c9", "linewidth": 0.7}
    places, heights = 0.5 * (moves.starts + moves.ends), 0.5 * np.degrees(moves.angles[:-1] + moves.angles[1:])
    for name, place, height in zip(moves.names, places, heights, strict=True):
        box = {"boxstyle": "circle,pad=0.2" if len(name) == 1 else "round,pad=0.25", **patch}
        aside = (0.0, 0.0) if len(name) == 1 else (16.0, 0.0)  # points: words do not hide the move
        axis.annotate(
            name,
            (place, height),
            aside,
            textcoords="offset points",
            fontsize=8.5,
            color=INK,
            ha="left" if aside[0] else "center",
            va="center",
            bbox=box,
        )
