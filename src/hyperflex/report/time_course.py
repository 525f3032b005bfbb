"""The time course of a planned motion: arm angle, two panels of the planner's own, and the motor's torque."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.report.style import BLUE, INK, RED, new_figure, note
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
        arm.set(ylabel="arm, degrees", title="Angle of the arm, its moves numbered")
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
