"""The report of a planned whip: its page, film and figures put together."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hyperflex.planning import Impact, WhipPlan
from hyperflex.planning.files import RATE
from hyperflex.planning.whip.files import lash_of
from hyperflex.report.folder import Progress, silent
from hyperflex.report.plan import PlanReport, rope_and_arm, write_plan
from hyperflex.report.whip import words
from hyperflex.report.whip.figures import course_figure, passing_figure, peak_figure

_SLOW = 0.5  # speed of the film, part of real time
_CAPTIONS = {
    "film": "The planned whip, simulated, at half speed: arm (white), rope (yellow), target (red ring).",
    "peak": "The rope about the peak, early instants dark, late ones bright; simulated.",
    "passing": "How the tip passes the target: its path, coloured by its speed; simulated.",
    "course": "Arm angle, the tip's speed and distance from the target, and torque over time. Dashed red: the peak.",
}
_LAYOUT = {"The whip": ("film", "peak", "passing"), "Time course": ("course",)}


def write_whip(
    directory: str | Path, plan: WhipPlan, impact: Impact | None, *, rate: float = RATE, progress: Progress = silent
) -> dict[str, Path]:
    """Write the report of a planned whip; see :func:`hyperflex.report.plan.write_plan`.

    Parameters
    ----------
    directory : str or Path
        Folder to write to.
    plan : WhipPlan
        One without strokes leaves no more than a page with the reason.
    impact : Impact or None
        On a small peg at the target, if it was simulated.
    rate : float
        Rows a second of the motor's file, Hz.
    progress : callable
        Called with a message on what is being done.
    """
    return write_plan(directory, whip_report(plan, impact), rate=rate, progress=progress)


def whip_report(plan: WhipPlan, impact: Impact | None) -> PlanReport:
    """Return what the report of a plan says and shows."""
    film = {}
    if plan.lash is not None:
        film = {"title": "planned whip, simulated, at half speed", "note": film_note(plan)}
        film |= {"speed": _SLOW, "targets": plan.mark.point[None]}
    return PlanReport(
        plan=plan,
        name="whip",
        run=None if plan.lash is None else plan.lash.run,
        title="A planned whip" if plan.success else "No whip found that meets its target",
        lead=words.lead(plan),
        verdict=words.verdict(plan),
        setup=f"{rope_and_arm(plan.thrower)} Target: {words.target_words(plan.mark)}.",
        tiles=words.tiles(plan, impact),
        advice=(),
        story=words.story(plan, impact),
        checks=words.checks_table(plan),
        checks_note=(words.FINER_NOTE,),
        captions=_CAPTIONS,
        figures={
            "peak": lambda: peak_figure(plan),
            "passing": lambda: passing_figure(plan),
            "course": lambda: course_figure(plan),
        },
        layout=_LAYOUT,
        film=film,
    )


def film_note(plan: WhipPlan) -> Callable[[float], str]:
    """Return what a film of the verified run says at a time, s: target, arm, and from the peak on speed and miss."""
    seen, mark = lash_of(plan), plan.mark
    starts = None if plan.strokes is None else plan.strokes.starts(plan.thrower.limits)

    def note(t: float) -> str:
        begun = 0 if starts is None else int((starts <= t).sum())
        arm = f"stroke {begun} of {words.strokes_words(plan)}" if begun else f"{words.strokes_words(plan)} to come"
        end = f"met at {seen.t:.2f} s: {seen.speed:.1f} m/s, {1e3 * seen.miss:.2g} mm off"
        if not plan.success:
            end = f"FAILS: {plan.reason}"
        target = f"target: x = {mark.x:.3g} m, y = {mark.y:.3g} m, {mark.speed:.3g} m/s or more"
        return "\n".join((target, f"arm: {arm}", end if t >= seen.t else ""))

    return note
