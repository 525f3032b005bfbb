"""Pictures of a planned whip: the rope about the peak, the tip's way past the target, the course of the whip."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning import WhipPlan
from hyperflex.report.cast.figures import number_moves
from hyperflex.report.shapes import shapes
from hyperflex.report.strobe import strobe
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, look, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEFORE, _AFTER = 0.5, 0.1  # s about the peak
_AROUND = 0.12  # m about the target, at least
_WAY_POINTS = 400


def peak_figure(plan: WhipPlan) -> Figure:
    """Draw the rope at many instants up to just after the peak."""
    seen = plan.required(plan.outcome, "outcome")
    run = plan.required(plan.run, "run")
    start, end = max(seen.t - _BEFORE, run.t[0]), min(seen.t + _AFTER, run.t[-1])
    title = f"{start:.2f} to {end:.2f} s, dark to bright (simulated); ring: the target"
    return strobe(run, start=float(start), end=float(end), count=48, title=title, targets=plan.target.point[None])


def passing_figure(plan: WhipPlan) -> Figure:
    """Draw how the tip passes the target: its way, in the colour of its speed, and the direction asked."""
    seen, mark = plan.required(plan.outcome, "outcome"), plan.target
    run = plan.required(plan.run, "run")
    half = max(_AROUND, 1.3 * seen.miss)
    span = 2.0 * half / max(seen.speed, 1e-3)
    times = np.linspace(max(seen.t - span, run.t[0]), min(seen.t + span, run.t[-1]), _WAY_POINTS)
    way = 1e3 * (shapes(run, times).joints[:, -1] - mark.point)
    speed = np.interp(times, run.t, np.hypot(*run.tip_velocity.T))
    with look():
        figure = new_figure(8.6, 5.6)
        axis: Any = figure.subplots()
        _draw_way(figure, axis, way, speed)
        size = 0.55e3 * half
        if not mark.any_direction:
            _arrow(axis, np.zeros(2), size * _along(mark.direction), RED)
            axis.plot([], [], color=RED, lw=2.0, label="direction asked")
        place = 1e3 * (seen.place - mark.point)
        _arrow(axis, place, size * seen.velocity / max(seen.speed, 1e-9), INK)
        axis.plot([], [], color=INK, lw=2.0, label=f"velocity at the peak, {seen.speed:.1f} m/s")
        axis.plot(0.0, 0.0, "o", ms=13.0, mfc="none", mec=RED, mew=1.8, label="target")
        axis.plot(*place, "o", ms=4.5, color=INK, label=f"tip at its peak, {1e3 * seen.miss:.2g} mm off")
        axis.set(xlim=(-1e3 * half, 1e3 * half), ylim=(-1e3 * half, 1e3 * half), aspect="equal")
        axis.set(xlabel="x from the target, mm", ylabel="y from the target, mm (up)")
        axis.set_title("How the tip passes the target, simulated")
        figure.legend(loc="outside lower center", ncols=2, fontsize=8.0)
    return figure


def course_figure(plan: WhipPlan) -> Figure:
    """Draw arm angle, the tip's speed, its distance from the target and the motor's torque over time."""
    seen, mark = plan.required(plan.outcome, "outcome"), plan.target
    run = plan.required(plan.run, "run")
    with look():
        figure = new_figure(8.6, 8.0)
        arm, speed, away, torque = figure.subplots(4, 1, sharex=True, height_ratios=(1.1, 1.3, 1.0, 0.8))
        arm.plot(run.t, np.degrees(run.arm_angle), color=BLUE)
        arm.set(ylabel="arm, degrees", title="What the arm does, strokes numbered")
        _number_strokes(arm, plan)
        speed.plot(run.t, np.hypot(*run.tip_velocity.T), color=GREEN)
        speed.axhline(mark.speed, color=GREY, ls="--", lw=1.0)
        speed.text(run.t[0], mark.speed, f" {mark.speed:.3g} m/s are asked", va="bottom", fontsize=8.0, color="#5a6472")
        speed.set(ylabel="speed, m/s", title="Speed of the tip")
        words = f"peak at {seen.t:.2f} s: {seen.speed:.1f} m/s "
        speed.text(
            seen.t, 0.97, words, transform=speed.get_xaxis_transform(), ha="right", va="top", fontsize=8.0, color=RED
        )
        away.plot(run.t, np.hypot(*(run.tip - mark.point).T), color=BLUE)
        away.set(ylabel="distance, m", title="Distance of the tip from the target")
        away.set_ylim(bottom=0.0)
        torque.plot(run.t, run.motor_torque, color=INK, lw=1.0)
        torque.set(ylabel="torque, N m", title="Torque that the rope asks of the motor", xlabel="time, s")
        for axis in (arm, speed, away, torque):
            axis.set_xlim(run.t[0], run.t[-1])
            axis.axvline(seen.t, color=RED, lw=1.0, ls="--")
        figure.suptitle("Course of the whip, simulated", x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=INK)
    return figure


def _number_strokes(axis: Any, plan: WhipPlan) -> None:
    if plan.strokes is None:
        return
    limits = plan.cast_setup.limits
    starts, angles = plan.strokes.starts(limits), plan.strokes.angles(limits)
    shown = starts < plan.required(plan.run, "run").t[-1]
    ends = np.minimum(
        starts + limits.fastest_moves(np.diff(angles))[0], plan.required(plan.motion, "motion").breaks[-1]
    )
    number_moves(axis, starts[shown], ends[shown], angles[: int(shown.sum()) + 1])


def _draw_way(figure: Figure, axis: Any, way: Array, speed: Array) -> None:
    from matplotlib.collections import LineCollection

    steps = list(np.stack([way[:-1], way[1:]], axis=1))
    lines = LineCollection(steps, array=speed[:-1], cmap="viridis_r", linewidths=2.6)
    axis.add_collection(lines)
    figure.colorbar(lines, ax=axis, label="speed of the tip, m/s", shrink=0.8)


def _arrow(axis: Any, start: Array, way: Array, colour: str) -> None:
    axis.annotate(
        "", start + way, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    )


def _along(direction: float) -> Array:
    return np.array([np.cos(direction), np.sin(direction)])
