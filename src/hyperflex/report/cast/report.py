"""The report of a planned cast: its page, film and figures put together."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from textwrap import fill

import numpy as np

from hyperflex import winding
from hyperflex.planning import CastPlan, Holding
from hyperflex.planning.files import RATE, run_of
from hyperflex.report.cast import words
from hyperflex.report.cast.figures import course_figure, strike_figure, tug_figure
from hyperflex.report.cast.target_map import target_map, target_map_caption
from hyperflex.report.folder import Progress, silent
from hyperflex.report.page import Picture, Section
from hyperflex.report.plan import PlanReport, rope_and_arm, write_plan
from hyperflex.report.style import png

_LINE = 90  # letters that fit beside each other in a film
_END = 2.0  # s at the end of a film in which the hold force is shown
_CAPTIONS = {
    "film": "The planned cast, simulated: arm (white), rope (yellow), target (red).",
    "strike": "The rope about the strike, early instants dark, late ones bright; simulated.",
    "course": "Arm angle, turns, tension and torque over time. Dashed red: the strike. Green: slip is measured.",
    "tug": "The simulated tug that gives the hold force: pull, and slip of the rope on the target.",
}
_LAYOUT = {"The cast": ("film", "strike"), "Time course": ("course",), "Hold": ("tug",)}


def write_cast(
    directory: str | Path, plan: CastPlan, held: Holding | None, *, rate: float = RATE, progress: Progress = silent
) -> dict[str, Path]:
    """Write the report of a planned cast; see :func:`hyperflex.report.plan.write_plan`.

    Parameters
    ----------
    directory : str or Path
        Folder to write to.
    plan : CastPlan
        One without a throw leaves no more than a page with the reason and where the target is.
    held : Holding or None
        Result of a tug at the wound rope, if there was one.
    rate : float
        Rows a second of the motor's file, Hz.
    progress : callable
        Called with a message on what is being done.
    """
    return write_plan(directory, cast_report(plan, held), rate=rate, progress=progress)


def cast_report(plan: CastPlan, held: Holding | None, name: str = "cast") -> PlanReport:
    """Return what the report of a plan says and shows; `name` is the stem of its files."""
    run = None if plan.cast is None else plan.cast.run
    figures = {"strike": lambda: strike_figure(plan), "course": lambda: course_figure(plan)}
    if held is not None:
        figures["tug"] = lambda: tug_figure(held)
    film = {} if run is None else {"title": "planned cast, simulated", "note": film_note(plan, held)}
    place = Section("Where the target is", pictures=(Picture(png(target_map(plan)), target_map_caption(plan)),))
    return PlanReport(
        plan=plan,
        name=name,
        run=run,
        title=words.title(plan),
        lead=words.lead(plan),
        verdict=words.verdict(plan),
        setup=(
            f"{rope_and_arm(plan.thrower)} Links near the target are cut shorter for the verified runs. Target: a "
            f"round peg at {words.target_words(plan.peg)}, friction mu = {plan.peg.mu:g}."
        ),
        tiles=words.tiles(plan, held),
        advice=words.advice(plan),
        story=words.story(plan, held),
        checks=words.checks_table(plan),
        captions=_CAPTIONS,
        figures=figures,
        layout=_LAYOUT,
        film=film,
        without_run=(place,) if run is None else (),
        others={"nearest": None if plan.nearest is None else plan.nearest.plan},
    )


def film_note(plan: CastPlan, held: Holding | None) -> Callable[[float], str]:
    """Return what a film of the verified run says at a time, s: target, arm, turns, and at the end the hold."""
    run, cast = run_of(plan), plan.cast
    turns = words.sense(plan) * winding.turns(run, plan.peg)
    strike = np.inf if cast is None or not np.isfinite(cast.strike) else cast.strike

    def note(t: float) -> str:
        lines = [f"target: {words.target_words(plan.peg)}", f"arm: {_arm_words(plan, t)}"]
        if t < strike:
            lines.append("rope: in the air")
        else:
            lines.append(f"rope: {np.interp(t, run.t, turns):.2f} turns round the target, {words.way(plan)}")
        if t > run.t[-1] - _END:
            lines.append(_end_words(plan, held))
        return "\n".join(lines)

    return note


def _arm_words(plan: CastPlan, t: float) -> str:
    if plan.throw is None:
        return ""
    limits, count = plan.thrower.limits, plan.throw.count
    begun = int((plan.throw.starts(limits) <= t).sum())
    if begun == 0:
        return f"at rest, {words.swings_words(plan)} to come"
    if begun <= count:
        rests = plan.motion is not None and float(plan.motion.rate(t)) == 0.0
        return f"{'rests after ' if rests else ''}swing {begun} of {count}"
    done = t >= plan.throw.stops(limits)
    return f"stands still, {words.swings_words(plan)} done" if done else f"last move after {words.swings_words(plan)}"


def _end_words(plan: CastPlan, held: Holding | None) -> str:
    if not plan.success:
        return fill(f"FAILS: {words.failure(plan)}", _LINE)
    if held is None:
        return "wound and held"
    return f"wound and held; hold force {held.force:.2f} N" + (" (tug)" if held.tug.slipped else " or more (tug)")
