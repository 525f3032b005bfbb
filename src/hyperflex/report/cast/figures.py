"""Figures of a planned cast: the strike, its time course, and the tug at the wound rope."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hyperflex import winding
from hyperflex.planning import CastPlan, HoldingForce
from hyperflex.report.plan import in_words
from hyperflex.report.strobe import strobe_figure
from hyperflex.report.style import BLUE, GREEN, GREY, RED, new_figure, note
from hyperflex.report.time_course import ArmMoves, event_note, room_above, time_course

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEFORE, _AFTER = 0.6, 0.8  # s about the strike
_ALLOWED = 5.0  # mm, slip up to which a tug is held


def strike_figure(plan: CastPlan) -> "Figure":
    """Draw the rope at many instants about the strike; before the arm stops, where there is none."""
    run = plan.required(plan.run, "run")
    middle = _strike(plan) if np.isfinite(_strike(plan)) else _stop(plan) - _AFTER
    start, end = max(middle - _BEFORE, run.t[0]), min(middle + _AFTER, run.t[-1])
    red = "the target, and pegs before it" if plan.problem.behind else "the target"
    title = f"{start:.2f} to {end:.2f} s, dark to bright (simulated); red: {red}"
    walls = plan.problem.obstacles
    return strobe_figure(run, start=float(start), end=float(end), count=56, title=title, obstacles=walls)


def course_figure(plan: CastPlan) -> "Figure":
    """Draw arm angle, turns, tension and the motor's torque over time."""
    run, strike, watched = plan.required(plan.run, "run"), _strike(plan), _stop(plan) + plan.problem.settle
    wound, needed = winding.measure_winding(run, plan.target), plan.problem.turns

    def draw(turns: Any, pull: Any) -> None:
        turns.plot(run.t, sense(plan) * wound.turns, color=GREEN)
        turns.axhline(needed, color=GREY, ls="--", lw=1.0)
        note(turns, run.t[0], needed, f" {needed:g} turns are needed")
        turns.set(ylabel="turns", title=f"Turns about the target, {way(plan)} counted positive")
        room_above(turns)
        if np.isfinite(strike):
            event_note(turns, run, strike, f"strikes at {strike:.2f} s")
        place = {"transform": turns.get_xaxis_transform(), "va": "top", "ha": "right"}
        note(turns, run.t[-1], 0.84, "slip is measured ", GREEN, **place)
        pull.plot(run.t, wound.before, color=BLUE, label="towards the arm")
        pull.plot(run.t, wound.after, color=RED, label="towards the tip")
        pull.set(ylabel="tension, N", title="Tension of the rope where it leaves the target")
        pull.legend(loc="upper left", fontsize=8.0)
        if not np.isfinite(wound.before).any():
            pull.set(ylim=(0.0, 1.0), yticks=())
            note(pull, 0.5, 0.5, "the rope does not lie on the target", transform=pull.transAxes, ha="center")
        for axis in turns.figure.axes:
            axis.axvspan(watched, run.t[-1], color=GREEN, alpha=0.10, lw=0)

    return time_course(run, "the cast", _moves(plan), strike, draw)


def tug_figure(held: HoldingForce) -> "Figure":
    """Draw the pull at the wound rope and its slip over the way of the pull."""
    run = held.tug.run
    pulled_way = 1e3 * np.hypot(*(run.joints[:, 0] - run.joints[0, 0]).T)
    with new_figure(8.6, 4.0, "A tug at the wound rope, simulated") as figure:
        pull, slip = figure.subplots(2, 1, sharex=True)
        pulled = winding.rope_tension(run)[:, 0]
        pull.plot(pulled_way, pulled, color=BLUE, lw=1.0, label="pull at the rope's first joint")
        least = "" if held.tug.slipped else "at least "
        pull.axhline(held.force, color=GREEN, ls="--", lw=1.2, label=f"hold force {least}{held.force:.2f} N")
        pull.axhline(
            held.capstan_force,
            color=GREY,
            ls=":",
            lw=1.4,
            label=f"tail weight x e^(mu angle) {held.capstan_force:.2f} N",
        )
        pull.set(ylabel="pull, N", ylim=(0.0, 1.05 * max(held.force, held.capstan_force, float(pulled.max()))))
        pull.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8.0)
        slip.plot(pulled_way, 1e3 * np.abs(held.tug.slip), color=RED)
        slip.axhline(_ALLOWED, color=GREY, ls="--", lw=1.0)
        note(slip, pulled_way[0], _ALLOWED, f" {_ALLOWED:g} mm: has slipped")
        slip.set_ylim(top=max(1.4 * _ALLOWED, slip.get_ylim()[1]))  # the note lies within the panel
        slip.set(ylabel="slip, mm", xlabel="way of the pull away from the target, mm")
    return figure


def sense(plan: CastPlan) -> float:
    """Return 1 where the rope winds counterclockwise in the end, else -1."""
    return -1.0 if plan.outcome is not None and plan.outcome.turns < 0.0 else 1.0


def way(plan: CastPlan) -> str:
    """Return the sense in which the rope winds, in a word."""
    return "clockwise" if sense(plan) < 0.0 else "counterclockwise"


def behind_sentence(plan: CastPlan) -> str:
    """Return a sentence about the pegs that the rope is to run behind, after a space; "" without any."""
    runs = () if plan.outcome is None else plan.outcome.runs_behind
    pegs = zip(plan.problem.behind, runs, strict=False)
    told = [f"{'behind' if there else 'not behind'} {in_words(peg)}" for peg, there in pegs]
    return f" On its way from the arm it runs {', and '.join(told)}." if told else ""


def _strike(plan: CastPlan) -> float:
    return float("nan") if plan.outcome is None else plan.outcome.strike_time


def _stop(plan: CastPlan) -> float:
    return 0.0 if plan.motion is None else float(plan.motion.breaks[-1])


def _moves(plan: CastPlan) -> ArmMoves | None:
    """Return the swings and the last move."""
    if plan.throw is None:
        return None
    limits = plan.problem.limits
    starts, angles = plan.throw.starts(limits), plan.throw.angles(limits)
    names = (*(str(k + 1) for k in range(plan.throw.count)), "last")
    return ArmMoves(starts, starts + limits.fastest_moves(np.diff(angles), 1.0)[0], angles, names)
