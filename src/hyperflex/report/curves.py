"""Curves of a run over time: plots that the player and the figures share, and the figure of a time course."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.report.pictures import strobe_figure
from hyperflex.report.scene import Line, Plot, span
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, new_figure, note
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure


KINDS = ("strobe", "course")


class Moves(NamedTuple):
    """Moves of the arm, in order: start of each (k,), s, angles between them (k + 1,), rad, and their names."""

    starts: Array
    angles: Array
    names: tuple[str, ...]


@dataclass(frozen=True)
class Panel:
    """A panel of a time course.

    Attributes
    ----------
    plot : Plot
        Its title, unit and curves.
    label : str
        Of the vertical axis, without the unit.
    colours : tuple of str
        Of the curves.
    level : (float, str), optional
        A value to mark by a dashed line, and the note on it.
    event : str
        The note on the time course's event, if this panel has it.
    """

    plot: Plot
    label: str
    colours: tuple[str, ...] = (BLUE, RED, GREEN)
    level: tuple[float, str] | None = None
    event: str = ""


def speed_plot(run: Trajectory) -> Plot:
    """Return the speed of the tip."""
    return Plot("speed of the tip", "m/s", (Line("", np.hypot(*run.tip_velocity.T)),))


def energy_plot(run: Trajectory) -> Plot:
    """Return the energies, the potential one from the start on, and the motor's work."""
    potential = run.potential_energy - run.potential_energy[0]
    lines = (Line("kinetic", run.kinetic_energy), Line("potential", potential), Line("motor's work", run.motor_work))
    return Plot("energy", "J", lines)


def time_course(
    run: Trajectory, what: str, panels: tuple[Panel, ...], moves: Moves | None = None, event: float = np.nan
) -> "Figure":
    """Draw a run over time: angle of the arm with its `moves` numbered, two panels, and the motor's torque.

    The time `event`, s, is marked in all of them; NaN where there is none.
    """
    angle = Plot("angle of the arm", "degrees", (Line("", np.degrees(run.arm_angle)),))
    torque = Plot("torque of the motor for the rope", "N m", (Line("", run.motor_torque),))
    with new_figure(8.6, 8.2, f"Time course of {what}, simulated") as figure:
        axes = figure.subplots(4, 1, sharex=True, height_ratios=(1.15, 1.25, 1.0, 0.8))
        for axis, panel in zip(axes, (Panel(angle, "arm"), *panels, Panel(torque, "torque", (INK,))), strict=True):
            _draw_panel(axis, panel, run, event)
        axes[-1].set(xlabel="time, s")
        if moves is not None:
            axes[0].set_title("Angle of the arm, its moves numbered")
            _name(axes[0], run, moves)
    return figure


def run_figure(
    run: Trajectory, kind: str = "strobe", *, start: float | None = None, end: float | None = None, title: str = ""
) -> "Figure":
    """Draw a run between two times, s: its ``"strobe"``, or its ``"course"``; InvalidInput for another kind or span."""
    if checks.choice("kind", kind, KINDS) == "strobe":
        return strobe_figure(run, start=start, end=end, title=title)
    shown = span(run, start, end)
    panels = Panel(speed_plot(run), "speed", (GREEN,)), Panel(energy_plot(run), "energy")
    figure = time_course(run, title or "the run", panels)
    figure.axes[0].set_xlim(shown)  # all axes share it
    return figure


def _draw_panel(axis: Any, panel: Panel, run: Trajectory, event: float) -> None:
    """Draw the curves of a panel, its level, and the event, with the note on the side with more room."""
    plot = panel.plot
    for line, colour in zip(plot.lines, panel.colours, strict=False):
        axis.plot(run.t, line.values, color=colour, label=line.label)
    unit = f", {plot.unit}" if plot.unit else ""
    axis.set(ylabel=f"{panel.label}{unit}", title=plot.title[0].upper() + plot.title[1:], xlim=(run.t[0], run.t[-1]))
    if len(plot.lines) > 1:
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8.0, borderaxespad=0.1)
    if panel.level is not None:
        value, words = panel.level
        axis.axhline(value, color=GREY, ls="--", lw=1.0)
        note(axis, run.t[0], value, f" {words}")
    if panel.level is not None or panel.event:  # room above the curves for the notes
        low, high = axis.get_ylim()
        axis.set_ylim(low, high + 0.3 * (high - low))
    if np.isfinite(event):
        axis.axvline(event, color=RED, lw=1.0, ls="--")
    if np.isfinite(event) and panel.event:
        late = event > 0.5 * (run.t[0] + run.t[-1])
        place = {"transform": axis.get_xaxis_transform(), "va": "top", "ha": "right" if late else "left"}
        note(axis, event, 0.97, f" {panel.event} ", RED, **place)


def _name(axis: Any, run: Trajectory, moves: Moves) -> None:
    """Write the name of each move on the curve of the arm's angle where the move is half done."""
    ends = [*moves.starts[1:], np.inf]
    for name, start, end, low, high in zip(
        moves.names, moves.starts, ends, moves.angles[:-1], moves.angles[1:], strict=True
    ):
        away = np.where((run.t >= start) & (run.t < end), np.abs(run.arm_angle - 0.5 * (low + high)), np.inf)
        half = int(away.argmin())
        word = len(name) > 1  # goes to the right of the curve, so that it does not hide it
        box = {"boxstyle": "round,pad=0.25" if word else "circle,pad=0.2", "facecolor": "white", "lw": 0.7}
        style: Any = {"ha": "left" if word else "center", "va": "center", "fontsize": 8.5}
        place, offset = (run.t[half], np.degrees(run.arm_angle[half])), (16.0 if word else 0.0, 0.0)  # points
        axis.annotate(name, place, offset, textcoords="offset points", bbox=box | {"edgecolor": "#b9c0c9"}, **style)
