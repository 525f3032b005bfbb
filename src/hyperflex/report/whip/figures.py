"""Figures of a planned whip: the rope about the peak, the tip's path past the target, and the time course."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning import WhipPlan
from hyperflex.report.shapes import shapes
from hyperflex.report.strobe import draw_obstacles, strobe_figure
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, legend, new_figure, note
from hyperflex.report.time_course import event_note, room_above, time_course
from hyperflex.report.tip import draw_path, stroke_moves
from hyperflex.report.units import length

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEFORE, _AFTER = 0.5, 0.1  # s about the peak
_AROUND = 0.12  # m about the target, at least
_WAY_POINTS = 400


def peak_figure(plan: WhipPlan) -> "Figure":
    """Draw the rope at many instants up to just after the peak."""
    seen = plan.required(plan.outcome, "outcome")
    run = plan.required(plan.run, "run")
    start, end = max(seen.t - _BEFORE, run.t[0]), min(seen.t + _AFTER, run.t[-1])
    title = f"{start:.2f} to {end:.2f} s, dark to bright (simulated); ring: the target"
    place, walls = plan.target.point[None], plan.problem.obstacles
    return strobe_figure(run, start=float(start), end=float(end), count=48, title=title, targets=place, obstacles=walls)


def passing_figure(plan: WhipPlan) -> "Figure":
    """Draw how the tip passes the target: its way, in the colour of its speed, and the direction asked."""
    seen, target = plan.required(plan.outcome, "outcome"), plan.target
    run = plan.required(plan.run, "run")
    half = max(_AROUND, 1.3 * seen.miss)
    span = 2.0 * half / max(seen.speed, 1e-3)
    times = np.linspace(max(seen.t - span, run.t[0]), min(seen.t + span, run.t[-1]), _WAY_POINTS)
    way = 1e3 * (shapes(run, times).joints[:, -1] - target.point)
    speed = np.interp(times, run.t, np.hypot(*run.tip_velocity.T))
    with new_figure(8.6, 5.6) as figure:
        axis: Any = figure.subplots()
        draw_path(figure, axis, way, speed)
        size = 0.55e3 * half
        if not target.any_direction:
            _draw_arrow(axis, np.zeros(2), size * _along(target.direction), RED)
            axis.plot([], [], color=RED, lw=2.0, label="direction asked")
        place = 1e3 * (seen.place - target.point)
        _draw_arrow(axis, place, size * seen.velocity / max(seen.speed, 1e-9), INK)
        axis.plot([], [], color=INK, lw=2.0, label=f"velocity at the peak, {seen.speed:.1f} m/s")
        axis.plot(0.0, 0.0, "o", ms=13.0, mfc="none", mec=RED, mew=1.8, label="target")
        axis.plot(*place, "o", ms=4.5, color=INK, label=f"tip at its peak, {length(seen.miss, 2)} off")
        axis.set(xlim=(-1e3 * half, 1e3 * half), ylim=(-1e3 * half, 1e3 * half), aspect="equal")
        draw_obstacles(axis, plan.problem.obstacles, 8.0 * half, origin=target.point, scale=1e3)
        axis.set(xlabel="x from the target, mm", ylabel="y from the target, mm (up)")
        axis.set_title("How the tip passes the target, simulated")
        legend(figure, axis, place="lower center", columns=2)
    return figure


def course_figure(plan: WhipPlan) -> "Figure":
    """Draw arm angle, the tip's speed, its distance from the target and the motor's torque over time."""
    seen, target = plan.required(plan.outcome, "outcome"), plan.target
    run = plan.required(plan.run, "run")

    def draw(speed: Any, away: Any) -> None:
        speed.plot(run.t, np.hypot(*run.tip_velocity.T), color=GREEN)
        speed.axhline(target.least_speed, color=GREY, ls="--", lw=1.0)
        note(speed, run.t[0], target.least_speed, f" {target.least_speed:.3g} m/s are needed")
        speed.set(ylabel="speed, m/s", title="Speed of the tip")
        room_above(speed)
        event_note(speed, run, seen.t, f"peak at {seen.t:.2f} s: {seen.speed:.1f} m/s")
        away.plot(run.t, np.hypot(*(run.tip - target.point).T), color=BLUE)
        away.set(ylabel="distance, m", title="Distance of the tip from the target")
        away.set_ylim(bottom=0.0)

    return time_course(run, "the whip", stroke_moves(plan), seen.t, draw)


def _along(direction: float) -> Array:
    return np.array([np.cos(direction), np.sin(direction)])


def _draw_arrow(axis: Any, start: Array, way: Array, colour: str) -> None:
    """Draw an arrow from a point (2,) along a vector (2,)."""
    axis.annotate(
        "", start + way, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    )
