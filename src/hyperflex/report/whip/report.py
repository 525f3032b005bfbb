"""The report of a planned whip: its words, player and figures."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hyperflex.planning import (
    FRICTION_STD,
    IMPACT_RADIUS,
    IMPACT_TIME,
    LENGTH_STD,
    TIMING_STD,
    Impact,
    TipStrike,
    TipTarget,
    WhipPlan,
)
from hyperflex.report.page import TextTable
from hyperflex.report.plan import PlanReport, clear_of, clearance_tiles, torque_tiles, torque_warning
from hyperflex.report.tip import stroke_count, stroke_note, stroke_story
from hyperflex.report.units import length
from hyperflex.report.whip.figures import course_figure, passing_figure, peak_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SLOW = 0.5  # speed of the film, part of real time
_FINER_NOTE = (
    "The second run makes the same strokes with a rope cut twice as finely: its miss is the error that cutting into "
    "links makes at a fast tip. It may be as large as the uncertainty of the plan itself, and 3 mm in any case; where "
    "that matters, plan with shorter links."
)


class WhipReport(PlanReport[WhipPlan]):
    """The report of a planned whip, and of its impact on a small peg at the target, if that was simulated.

    A plan without strokes leaves no more than a page with the reason.
    """

    name = "whip"
    captions: ClassVar = {
        "film": "The planned whip, simulated: arm, rope (ochre), path of the tip (green), target (red ring).",
        "peak": "The rope about the peak, early instants dark, late ones bright; simulated.",
        "passing": "How the tip passes the target: its path, coloured by its speed; simulated.",
        "course": "Arm angle, speed of the tip, its distance from the target, and torque over time. Dashed: the peak.",
    }
    layout: ClassVar = {"The whip": ("film", "peak", "passing"), "Time course": ("course",)}
    checks_note: ClassVar = (_FINER_NOTE,)

    def __init__(self, plan: WhipPlan, impact: Impact | None) -> None:
        super().__init__(plan)
        self.impact, target = impact, plan.target
        self.title = "A planned whip" if plan.success else "No whip found that meets its target"
        whipped = "is" if plan.success else "is to be"
        self.task = (
            f"A rope on a motor-driven arm {whipped} whipped, so that its tip passes a point at a peak of its speed."
        )
        self.verdict = f"No whip that meets the target was found: {plan.message}."
        if plan.success and (seen := plan.outcome) is not None:
            self.verdict = (
                f"The tip passes the target at {seen.speed:.1f} m/s, {length(seen.miss, 2)} off, in simulation."
            )
            if impact is not None and impact.message:
                self.verdict += f" A peg there is not struck by the tip: {impact.message}."
        self.warning = " ".join(filter(None, (torque_warning(plan, plan.outcome), _finer_warning(plan))))
        self.target = (
            f"x = {target.x:.4g} m, y = {target.y:.4g} m, {_direction(target)}, at {target.least_speed:.3g} m/s or more"
        )
        self.tiles, self.story, self.checks = self._tiles(), self._story(), _checks(plan)

    def _tiles(self) -> tuple[tuple[str, str], ...]:
        plan, target, seen, impact = self.plan, self.plan.target, self.plan.outcome, self.impact
        shown = [(f"{target.x:.4g}, {target.y:.4g} m", "target: x and y (up)")]
        if plan.strokes is not None:
            shown.append((stroke_count(plan), "of the arm to and fro"))
        if seen is not None:
            shown.append(
                (f"{seen.speed:.1f} m/s", f"speed of the tip at its peak; {target.least_speed:.3g} are needed")
            )
            shown.append((length(seen.miss, 2), "miss: from the target to the tip at its peak"))
            if not target.any_direction:
                allowed = f"{np.degrees(target.angle_tolerance):.3g}"
                shown.append(
                    (f"{np.degrees(seen.angle_error):.1f} degrees", f"off the direction needed; {allowed} allowed")
                )
            shown.append((f"{seen.t:.2f} s", "after the start the tip's speed peaks"))
        shown += clearance_tiles(plan) + torque_tiles(plan, seen)
        if impact is not None and impact.success:
            shown.append(
                (
                    f"{1e3 * impact.impulse:.1f} mN s",
                    f"impulse of the impact on a small peg of {1e3 * IMPACT_RADIUS:g} mm at the target",
                )
            )
        return tuple(shown)

    def _story(self) -> tuple[str, ...]:
        plan, impact, lines = self.plan, self.impact, [f"Target: {self.target}."]
        if plan.strokes is None:
            return tuple(lines)
        lines.append(stroke_story(plan))
        if plan.outcome is not None:
            lines.append(_peak(plan.outcome))
            if plan.outcome.touches_later:
                lines.append(f"After the peak the rope touches {plan.outcome.touches_later}, if nothing stops it.")
        if impact is not None:
            lines.append(_impact(impact))
        if math.isfinite(plan.position_std):
            lines.append(
                f"Uncertainty: the place of the peak has a standard deviation of {1e3 * plan.position_std:.0f} mm if "
                f"friction is known to {100 * FRICTION_STD:g} %, length to {100 * LENGTH_STD:g} % and each rest of "
                f"the arm to {1e3 * TIMING_STD:g} ms."
            )
        return (*lines, self.warning) if self.warning else tuple(lines)

    def figures(self) -> "dict[str, Figure]":
        """Draw the rope about the peak, the tip's path past the target, and the time course."""
        plan = self.plan
        return {"peak": peak_figure(plan), "passing": passing_figure(plan), "course": course_figure(plan)}

    def film(self) -> dict[str, Any]:
        """Return title, notes and speed of the film, the target, and when the tip's speed peaks."""
        peak, target = self.plan.required(self.plan.outcome, "outcome").t, self.plan.target.point[None]
        note = self.film_note()
        shown = {"targets": target, "marks": (peak,), "obstacles": self.plan.problem.obstacles}
        return {"title": "planned whip, simulated", "note": note, "speed": _SLOW, **shown}

    def film_note(self) -> Callable[[float], str]:
        """Return what the film says at a time, s: target, arm, and from the peak on speed and miss."""
        seen, target = self.plan.required(self.plan.outcome, "outcome"), self.plan.target

        def note(t: float) -> str:
            end = f"passes it at {seen.t:.2f} s: {seen.speed:.1f} m/s, {length(seen.miss, 2)} off"
            if not self.plan.success:
                end = f"FAILS: {self.plan.message}"
            place = f"target: x = {target.x:.4g} m, y = {target.y:.4g} m, {target.least_speed:.3g} m/s or more"
            return "\n".join((place, stroke_note(self.plan, t), end if t >= seen.t else ""))

        return note


def _direction(target: TipTarget) -> str:
    """Return in which direction the tip must pass."""
    if target.any_direction:
        return "in any direction"
    asked = np.degrees(target.direction)
    return f"within {np.degrees(target.angle_tolerance):.3g} degrees of the direction {asked:.3g} (0 is +x, 90 up)"


def _peak(seen: TipStrike) -> str:
    way = np.degrees(np.arctan2(*seen.velocity[::-1]))
    before = (
        "it was slower at all times before"
        if seen.earlier_speed <= seen.speed
        else f"it reached {seen.earlier_speed:.1f} before"
    )
    return (
        f"At {seen.t:.2f} s the tip's speed peaks at {seen.speed:.2f} m/s ({before}), {length(seen.miss, 2)} from "
        f"the target, in the direction {way:.0f} degrees."
    )


def _impact(impact: Impact) -> str:
    if impact.message:
        return f"A small peg behind the target is not struck by the tip: {impact.message}."
    return (
        f"Impact: a fixed peg of {1e3 * IMPACT_RADIUS:g} mm radius just behind the target, struck by the rope's "
        f"link {impact.link + 1}, takes up {1e3 * impact.impulse:.1f} mN s in {1e3 * IMPACT_TIME:g} ms "
        f"({1e3 * impact.impulse_along:.1f} mN s in the tip's direction), and the rope loses "
        f"{1e3 * impact.energy:.0f} mJ."
    )


def _checks(plan: WhipPlan) -> TextTable:
    rows = []
    for name, seen in (("as planned", plan.outcome), ("links of half the length", plan.finer_outcome)):
        if seen is None:
            rows.append((name, "no peak there", *5 * ("",)))
            continue
        off = "any" if plan.target.any_direction else f"{np.degrees(seen.angle_error):.1f} degrees"
        links = str(seen.n_links)
        peak, speed, clear = f"{seen.t:.3f} s", f"{seen.speed:.2f} m/s", f"{1e3 * seen.clearance:.1f} mm"
        rows.append((name, links, peak, speed, length(seen.miss, 2), off, clear))
    names = ("run", "links", "peak", "speed", "misses by", "off the direction", clear_of(plan.problem))
    return TextTable(names, tuple(rows))


def _finer_warning(plan: WhipPlan) -> str:
    """Return what the finer run of a plan that succeeds lacks, though a whip may succeed without it; else ""."""
    finer = plan.finer_outcome
    return f"With links of half the length {finer.message}." if plan.success and finer and finer.message else ""
