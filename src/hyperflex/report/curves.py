"""Curves over time: plots of a run that the player and the figures share, and recordings."""

from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.recording import Recording
from hyperflex.report.pictures import strobe_figure
from hyperflex.report.scene import Line, Plot, span
from hyperflex.report.style import BLUE, GREEN, GREY, RED, Axes, Figure, new_figure
from hyperflex.simulation import Sideways
from hyperflex.trajectory import Trajectory

KINDS = ("strobe", "course")


def course(run: Trajectory) -> tuple[Plot, ...]:
    """Return the plots of every run: speed of the tip and energies; with an arm its angle first, and its torque last.

    The potential energy is that from the start on.
    """
    potential = run.potential_energy - run.potential_energy[0]
    lines = (Line("kinetic", run.kinetic_energy), Line("potential", potential), Line("motor's work", run.motor_work))
    speed = Plot("speed of the tip", "m/s", (Line("", np.hypot(*run.tip_velocity.T)),))
    plots = speed, Plot("energy", "J", lines)
    if run.setup.arm is None:
        return plots
    angle = Plot("angle of the arm", "degrees", (Line("", np.degrees(run.arm_angle)),))
    return angle, *plots, Plot("torque for the rope", "N m", (Line("", run.motor_torque),))


def sideways_figure(found: Sideways, title: str = "") -> "Figure":
    """Draw the deviation of middle and tip out of the plane over time, and the rope across the plane at the end."""
    joints, run = 1e3 * found.joints, found.run
    ends = "at the end" if found.touch is None else "before the rope touches"
    with new_figure(8.6, 4.0, title or "Motion out of the plane, simulated to first order") as figure:
        over, shape = figure.subplots(1, 2, width_ratios=(2.2, 1.0))
        middle = int(np.searchsorted(run.setup.rope.link_ends, 0.5 * run.setup.rope.total_length)) + 1
        over.plot(found.t, joints[:, middle], color=GREEN, label="middle")
        over.plot(found.t, joints[:, -1], color=BLUE, label="tip")
        over.axhline(0.0, color=GREY, lw=0.8)
        over.set(xlabel="time, s", ylabel="out of the plane, mm", xlim=(found.t[0], found.t[-1]))
        over.set_title(found.warning(), fontsize=8.0, color=RED)
        over.legend(loc="upper left")
        shape.plot(joints[-1], np.append(0.0, run.setup.rope.link_ends), color=BLUE)
        shape.axvline(0.0, color=GREY, lw=0.8)
        shape.set(xlabel="out of the plane, mm", ylabel="along the rope, m", title=f"{ends}, {found.t[-1]:.2f} s")
        shape.invert_yaxis()
    return figure


def run_figure(
    run: Trajectory,
    kind: str = "strobe",
    *,
    start: float | None = None,
    end: float | None = None,
    title: str = "",
    ax: "Axes | None" = None,
) -> "Figure":
    """Draw a run between two times, s: its ``"strobe"``, or its ``"course"``; InvalidInput for another kind or span."""
    if checks.choice("kind", kind, KINDS) == "strobe":
        return strobe_figure(run, start=start, end=end, title=title, ax=ax)
    if ax is not None:
        raise InvalidInput(
            "a course has several panels",
            got="one ax",
            allowed="ax of a strobe",
            fix="Draw on the axes of the figure that it returns",
        )
    plots = course(run)
    with new_figure(8.6, 0.6 + 1.9 * len(plots), f"Time course of {title or 'the run'}, simulated") as figure:
        axes = figure.subplots(len(plots), 1, sharex=True)
        for axis, plot in zip(axes, plots, strict=True):
            for line, colour in zip(plot.lines, (BLUE, RED, GREEN), strict=False):
                axis.plot(run.t, line.values, color=colour, label=line.label)
            axis.set(ylabel=plot.unit, title=plot.title[0].upper() + plot.title[1:])
            if len(plot.lines) > 1:
                axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.1)
        axes[-1].set(xlabel="time, s", xlim=span(run, start, end))
    return figure


def recording_figure(recording: Recording, names: tuple[str, ...] = ()) -> "Figure":
    """Draw a recording: angles in degrees over time; of markers x and y, m, over time, and the paths.

    `names` are those of links or markers, by default their numbers. Of many, some from the first to the last are drawn.
    """
    marked = recording.kind == "markers"
    count = recording.data.shape[1] // (2 if marked else 1)
    names = names or tuple(f"{'marker' if marked else 'link'} {k}" for k in range(count))
    colours = [BLUE, RED, GREEN, GREY, "#7a5ea8", "#c08a2b"]
    shown = np.unique(np.linspace(0, count - 1, min(count, len(colours))).round().astype(int))
    with new_figure(10.0, 4.6, recording.name or "recording") as figure:
        if not marked:
            axis = figure.subplots()
            for k, colour in zip(shown, colours, strict=False):
                axis.plot(recording.t, np.degrees(recording.data[:, k]), color=colour, label=names[k])
            axis.set(xlabel="time, s", ylabel="degrees", title="Angles from hanging")
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=6)
            return figure
        parts: Any = figure.subfigures(1, 2, width_ratios=(1.5, 1.0))
        left, path = parts
        axes = left.subplots(2, 1, sharex=True)
        plane = path.subplots()
        for k, colour in zip(shown, colours, strict=False):
            x, y = recording.data[:, 2 * k], recording.data[:, 2 * k + 1]
            axes[0].plot(recording.t, x, color=colour)
            axes[1].plot(recording.t, y, color=colour)
            plane.plot(x, y, ".-", markersize=2.0, lw=0.6, color=colour, label=names[k])
        axes[0].set(ylabel="x, m", title="Places over time")
        axes[1].set(ylabel="y, m", xlabel="time, s")
        plane.set(xlabel="x, m", ylabel="y, m", title="Paths")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best", fontsize=8.0)
    return figure
