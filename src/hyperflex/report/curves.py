"""Curves of a run over time: plots that the player and the figures share, and the figure of a time course."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import checks
from hyperflex.report.pictures import strobe_figure
from hyperflex.report.scene import Line, Plot, span
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, new_figure, note
from hyperflex.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure


KINDS = ("strobe", "course")


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
        A value to mark by a dashed line, and its label.
    event : str
        Label of the time course's event, if this panel has it.
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
    run: Trajectory,
    what: str,
    panels: tuple[Panel, ...],
    moves: Sequence[tuple[float, str]] = (),
    event: float = np.nan,
) -> "Figure":
    """Draw a run over time: angle of the arm with its `moves`, two panels, and the motor's torque.

    A move is its start, s, and its name. The time `event`, s, is marked in all panels; NaN where there is none.
    """
    angle = Plot("angle of the arm", "degrees", (Line("", np.degrees(run.arm_angle)),))
    torque = Plot("torque of the motor for the rope", "N m", (Line("", run.motor_torque),))
    with new_figure(8.6, 8.2, f"Time course of {what}, simulated") as figure:
        axes = figure.subplots(4, 1, sharex=True, height_ratios=(1.15, 1.25, 1.0, 0.8))
        for axis, panel in zip(axes, (Panel(angle, "arm"), *panels, Panel(torque, "torque", (INK,))), strict=True):
            _draw_panel(axis, panel, run, event)
        axes[-1].set(xlabel="time, s")
        axes[0].margins(y=0.15)  # room for the names of the moves
        for start, name in moves:
            axes[0].axvline(start, color=GREY, lw=0.6, ls=":")
            note(axes[0], start, 1.0, f" {name}", transform=axes[0].get_xaxis_transform(), va="top")
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
    """Draw the curves of a panel, its level and the event; a legend above it names them."""
    plot = panel.plot
    for line, colour in zip(plot.lines, panel.colours, strict=False):
        axis.plot(run.t, line.values, color=colour, label=line.label)
    unit = f", {plot.unit}" if plot.unit else ""
    axis.set(ylabel=f"{panel.label}{unit}", title=plot.title[0].upper() + plot.title[1:], xlim=(run.t[0], run.t[-1]))
    if panel.level is not None:
        value, words = panel.level
        axis.axhline(value, color=GREY, ls="--", lw=1.0, label=words)
    if np.isfinite(event):
        axis.axvline(event, color=RED, lw=1.0, ls="--", label=panel.event)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8.0, borderaxespad=0.1)
