"""Pictures of a planned cast: the strike as a stroboscope shows it, the course of the cast, the tug at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import winding
from hyperflex.checks import Array
from hyperflex.planning import MIN_TURNS, SETTLING_TIME, CastPlan, HoldingForce
from hyperflex.report.strobe import strobe
from hyperflex.report.style import BLUE, GREEN, GREY, INK, RED, look, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEFORE, _AFTER = 0.6, 0.8  # s about the strike
_ALLOWED = 5.0  # mm, slip up to which a tug is held


def strike_figure(plan: CastPlan) -> Figure:
    """Draw the rope at many instants about the strike; before the arm stops, where there is none."""
    run = plan.required(plan.run, "run")
    middle = plan.outcome.strike_time if plan.outcome is not None else np.nan
    if not np.isfinite(middle):
        middle = _stop(plan) - _AFTER
    start, end = max(middle - _BEFORE, run.t[0]), min(middle + _AFTER, run.t[-1])
    title = f"{start:.2f} to {end:.2f} s, dark to bright (simulated); red: the target"
    return strobe(run, start=float(start), end=float(end), count=56, title=title)


def course_figure(plan: CastPlan) -> Figure:
    """Draw arm angle, turns, tension and the motor's torque over time."""
    run = plan.required(plan.run, "run")
    wound = winding.measure_winding(run, plan.target)
    sense = sense_of(plan)
    with look():
        figure = new_figure(8.6, 8.4)
        arm, turns, pull, torque = figure.subplots(4, 1, sharex=True, height_ratios=(1.2, 1.2, 1.0, 0.8))
        arm.plot(run.t, np.degrees(run.arm_angle), color=BLUE)
        arm.set(ylabel="arm, degrees", title="What the arm does: swings numbered, then the last move")
        _number_swings(arm, plan)
        turns.plot(run.t, sense * wound.turns, color=GREEN)
        turns.axhline(MIN_TURNS, color=GREY, ls="--", lw=1.0)
        turns.text(run.t[0], MIN_TURNS, f" {MIN_TURNS:g} turns are asked", va="bottom", fontsize=8.0, color="#5a6472")
        turns.set(ylabel="turns", title=f"Turns about the target, {way(plan)} counted positive")
        pull.plot(run.t, wound.before, color=BLUE, label="towards the arm")
        pull.plot(run.t, wound.after, color=RED, label="towards the tip")
        pull.set(ylabel="tension, N", title="Tension of the rope where it leaves the target")
        pull.legend(loc="upper left", fontsize=8.0)
        torque.plot(run.t, run.motor_torque, color=INK, lw=1.0)
        torque.set(ylabel="torque, N m", title="Torque that the rope asks of the motor", xlabel="time, s")
        for axis in (arm, turns, pull, torque):
            _mark_times(axis, plan)
        _name_times(turns, plan)
        figure.suptitle("Course of the cast, simulated", x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=INK)
    return figure


def tug_figure(held: HoldingForce) -> Figure:
    """Draw the pull at the wound rope and its slip over the way of the pull."""
    run = held.tug.run
    way = 1e3 * np.hypot(*(run.joints[:, 0] - run.joints[0, 0]).T)
    with look():
        figure = new_figure(8.6, 4.0)
        pull, slip = figure.subplots(2, 1, sharex=True)
        pulled = winding.rope_tension(run)[:, 0]
        pull.plot(way, pulled, color=BLUE, lw=1.0, label="pull at the rope's first joint")
        least, rule = "" if held.tug.slipped else "at least ", held.capstan_force
        pull.axhline(held.force, color=GREEN, ls="--", lw=1.2, label=f"hold force {least}{held.force:.2f} N")
        pull.axhline(
            held.capstan_force,
            color=GREY,
            ls=":",
            lw=1.4,
            label=f"tail weight x e^(mu angle) {held.capstan_force:.2f} N",
        )
        pull.set(ylabel="pull, N", ylim=(0.0, 1.05 * max(held.force, rule, float(pulled.max()))))
        pull.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8.0)
        slip.plot(way, 1e3 * np.abs(held.tug.slip), color=RED)
        slip.axhline(_ALLOWED, color=GREY, ls="--", lw=1.0)
        slip.text(way[0], _ALLOWED, f" {_ALLOWED:g} mm: has slipped", va="bottom", fontsize=8.0, color="#5a6472")
        slip.set(ylabel="slip, mm", xlabel="way of the pull away from the target, mm")
        title = "A tug at the wound rope, simulated"
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=INK)
    return figure


def sense_of(plan: CastPlan) -> float:
    """Return 1 where the rope winds counterclockwise in the end, else -1."""
    return -1.0 if plan.outcome is not None and plan.outcome.turns < 0.0 else 1.0


def way(plan: CastPlan) -> str:
    """Return the sense in which the rope winds, in a word."""
    return "clockwise" if sense_of(plan) < 0.0 else "counterclockwise"


def _stop(plan: CastPlan) -> float:
    return 0.0 if plan.motion is None else float(plan.motion.breaks[-1])


def _number_swings(axis: Any, plan: CastPlan) -> None:
    """Write beside each move of the arm what it is."""
    if plan.throw is None:
        return
    starts, angles = plan.throw.starts(plan.cast_setup.limits), plan.throw.angles(plan.cast_setup.limits)
    ends = starts + plan.cast_setup.limits.fastest_moves(np.diff(angles), 1.0)[0]
    count = plan.throw.count
    number_moves(axis, starts[:count], ends[:count], angles[: count + 1])
    if starts.size > count:
        place, height = plan.throw.stops(plan.cast_setup.limits), np.degrees(angles[count + 1])
        axis.annotate("last", (place, height), (4, 5), textcoords="offset points", fontsize=8.5, color=INK)


def number_moves(axis: Any, starts: Array, ends: Array, angles: Array) -> None:
    """Write the number of each move on a curve of the arm's angle.

    Parameters
    ----------
    axis : Axes
        In s and degrees.
    starts, ends : (k,) float64
        s.
    angles : (k + 1,) float64
        Between the moves, rad.
    """
    places, heights = 0.5 * (starts + ends), 0.5 * np.degrees(angles[:-1] + angles[1:])
    patch = {"boxstyle": "circle,pad=0.2", "facecolor": "white", "edgecolor": "#b9c0c9", "linewidth": 0.7}
    for number, (place, height) in enumerate(zip(places, heights, strict=True), start=1):
        axis.text(place, height, str(number), fontsize=8.5, color=INK, ha="center", va="center", bbox=patch)


def _mark_times(axis: Any, plan: CastPlan) -> None:
    """Mark the strike, and the time in which the rope is watched."""
    run = plan.required(plan.run, "run")
    axis.set_xlim(run.t[0], run.t[-1])
    axis.axvspan(_stop(plan) + SETTLING_TIME, run.t[-1], color=GREEN, alpha=0.10, lw=0)
    if plan.outcome is not None and np.isfinite(plan.outcome.strike_time):
        axis.axvline(plan.outcome.strike_time, color=RED, lw=1.0, ls="--")


def _name_times(axis: Any, plan: CastPlan) -> None:
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.15 * (high - low))
    across = axis.get_xaxis_transform()
    if plan.outcome is not None and np.isfinite(plan.outcome.strike_time):
        words = f"strikes at {plan.outcome.strike_time:.2f} s "
        axis.text(
            plan.outcome.strike_time, 0.97, words, transform=across, ha="right", va="top", fontsize=8.0, color=RED
        )
    place = _stop(plan) + SETTLING_TIME
    axis.text(place, 0.97, " watched", transform=across, va="top", fontsize=8.0, color=GREEN)
