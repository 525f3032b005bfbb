"""Figures of a planned insertion: the rope about the entry, its way through the gap, and the time course."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.planning import InsertPlan
from hyperflex.report.shapes import shapes, wall_ends
from hyperflex.report.strobe import strobe_figure
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, legend, new_figure, note
from hyperflex.report.time_course import event_note, room_above, time_course
from hyperflex.report.tip import draw_path, stroke_moves

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEFORE, _AFTER = 0.6, 0.05  # s before the tip enters, and after it is inside
_AROUND = 1.6  # depths asked about the gap
_WAY_POINTS, _ROPES = 400, 5


def entry_figure(plan: InsertPlan) -> "Figure":
    """Draw the rope at many instants until the tip is inside."""
    seen, run = plan.required(plan.outcome, "outcome"), plan.required(plan.run, "run")
    start, end = max(seen.t_enter - _BEFORE, run.t[0]), min(seen.t + _AFTER, run.t[-1])
    title = f"{start:.2f} to {end:.2f} s, dark to bright (simulated); red: the walls"
    others = plan.problem.obstacles
    return strobe_figure(run, start=float(start), end=float(end), count=48, title=title, obstacles=others)


def gap_figure(plan: InsertPlan) -> "Figure":
    """Draw how the rope goes through the gap: the tip's path, in the colour of its speed, and the rope at instants."""
    seen, slot = plan.required(plan.outcome, "outcome"), plan.target
    run = plan.required(plan.run, "run")
    half = 1e3 * max(_AROUND * slot.depth, 1.5 * slot.width)
    span = max(seen.t - seen.t_enter, 0.02)
    times = np.linspace(max(seen.t_enter - span, run.t[0]), seen.t, _WAY_POINTS)
    path = 1e3 * (shapes(run, times).joints[:, -1] - slot.point)
    speed = np.interp(times, run.t, np.hypot(*run.tip_velocity.T))
    with new_figure(8.6, 6.0) as figure:
        axis: Any = figure.subplots()
        for part, rope in zip(
            np.linspace(0.25, 1.0, _ROPES),
            shapes(run, np.linspace(seen.t_enter, seen.t, _ROPES)).joints,
            strict=True,
        ):
            axis.plot(*(1e3 * (rope - slot.point)).T, color=INK, lw=1.2, alpha=part)
        axis.plot([], [], color=INK, lw=1.2, label="rope, from the entry to the depth asked")
        draw_path(figure, axis, path, speed)
        for number, wall in enumerate(slot.walls):
            ends = 1e3 * (np.array(wall_ends(wall)) - slot.point)
            axis.plot(*ends.T, color=RED, lw=4.0, solid_capstyle="butt", label="" if number else "walls")
        inner, across = 1e3 * slot.depth * slot.axes[0], 0.5e3 * slot.width * slot.axes[1]
        axis.plot(*np.transpose([inner - across, inner + across]), color=GREY, lw=1.4, ls="--", label="depth asked")
        axis.plot(*(1e3 * (seen.place - slot.point)), "o", ms=5.0, color=INK, label=f"tip inside, {seen.speed:.2f} m/s")
        axis.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
        axis.set(xlabel="x from the middle of the gap, mm", ylabel="y from the middle of the gap, mm (up)")
        axis.set_title("How the rope goes through the gap, simulated")
        legend(figure, axis, place="lower center", columns=2)
    return figure


def course_figure(plan: InsertPlan) -> "Figure":
    """Draw arm angle, the tip's speed, its depth beyond the walls and the motor's torque over time."""
    seen, slot = plan.required(plan.outcome, "outcome"), plan.target
    run = plan.required(plan.run, "run")

    def draw(speed: Any, deep: Any) -> None:
        speed.plot(run.t, np.hypot(*run.tip_velocity.T), color=GREEN)
        speed.set(ylabel="speed, m/s", title="Speed of the tip")
        room_above(speed)
        event_note(speed, run, seen.t, f"inside at {seen.t:.2f} s: {seen.speed:.2f} m/s")
        deep.plot(run.t, (run.tip - slot.point) @ slot.axes[0], color=BLUE)
        deep.axhline(slot.depth, color=GREY, ls="--", lw=1.0)
        note(deep, run.t[0], slot.depth, f" {1e3 * slot.depth:.3g} mm are asked")
        deep.set(ylabel="depth, m", title="Depth of the tip beyond the line of the walls")
        room_above(deep)

    return time_course(run, "the insertion", stroke_moves(plan), seen.t, draw)
