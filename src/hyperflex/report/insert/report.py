"""The report of a planned insertion: its words, player and figures."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hyperflex.planning import FRICTION_STD, LENGTH_STD, TIMING_STD, InsertOutcome, InsertPlan
from hyperflex.report.insert.figures import course_figure, entry_figure, gap_figure
from hyperflex.report.page import TextTable
from hyperflex.report.plan import PlanReport, clear_of, clearance_tiles, torque_tiles, torque_warning
from hyperflex.report.tip import stroke_count, stroke_note, stroke_story
from hyperflex.report.units import length

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SLOW = 0.5  # speed of the film, part of real time
_FINER_NOTE = (
    "The second run makes the same strokes beside the same walls with a rope of 2.5 times the links, a fifth of the "
    "tolerance and half the step in contact."
)


class InsertReport(PlanReport[InsertPlan]):
    """The report of a planned insertion. A plan without strokes leaves no more than a page with the reason."""

    name = "insert"
    captions: ClassVar = {
        "film": "The planned insertion, simulated: arm, rope (ochre), path of the tip (green), walls (red).",
        "entry": "The rope until the tip is inside, early instants dark, late ones bright; simulated.",
        "gap": "How the rope goes through the gap: the tip's path, coloured by its speed, and the rope; simulated.",
        "course": "Arm angle, speed of the tip, its depth beyond the walls, and torque over time. Dashed: inside.",
    }
    layout: ClassVar = {"The insertion": ("film", "gap", "entry"), "Time course": ("course",)}
    checks_note: ClassVar = (_FINER_NOTE,)

    def __init__(self, plan: InsertPlan) -> None:
        super().__init__(plan)
        slot = plan.target
        self.title = "A planned insertion" if plan.success else "No way through the slot found"
        swung = "is" if plan.success else "is to be"
        self.task = (
            f"A rope on a motor-driven arm {swung} swung so that its tip goes through a slot between two walls"
            f"{'.' if slot.touching else ' and touches neither.'}"
        )
        self.verdict = f"No way through the slot was found: {plan.message}."
        if plan.success and (seen := plan.outcome) is not None:
            clear = f"and the rope keeps clear of them by {length(seen.wall_clearance, 2)}"
            touches = "and the rope touches them on its way, as it may" if seen.wall_clearance <= 0.0 else clear
            self.verdict = (
                f"The tip is {length(slot.depth)} beyond the walls at {seen.t:.2f} s, {touches}, in simulation."
            )
        self.warning = torque_warning(plan, plan.outcome)
        self.target = (
            f"a slot at x = {slot.x:.3g} m, y = {slot.y:.3g} m, {length(slot.width)} wide, between walls of "
            f"{length(slot.wall)}; way in: {np.degrees(slot.direction):.3g} degrees (0 is +x, 90 up), "
            f"{length(slot.depth)} deep"
            + (f", in a tube of {length(slot.tube)}" if slot.tube > 0.0 else "")
            + (f", with {slot.max_speed:g} m/s at most" if math.isfinite(slot.max_speed) else "")
        )
        self.tiles, self.story, self.checks = self._tiles(), self._story(), _checks(plan)

    def _tiles(self) -> tuple[tuple[str, str], ...]:
        plan, slot, seen = self.plan, self.plan.target, self.plan.outcome
        shown = [(length(slot.width), "width of the slot"), (length(slot.depth), "depth asked beyond the walls")]
        if plan.strokes is not None:
            shown.append((stroke_count(plan), "of the arm to and fro"))
        if seen is not None:
            shown.append((length(seen.wall_clearance, 2), "least distance of the rope from the walls until then"))
            shown.append((f"{seen.speed:.2f} m/s", "speed of the tip inside"))
            shown.append((f"{seen.t:.2f} s", "after the start the tip is inside"))
            shown.append((length(seen.depth, 2), "greatest depth before it leaves, touches or the run ends"))
        if (chance := plan.success_probability) is not None:
            told = "success probability with a slot 2 mm and strokes 2 ms off, unless planned for something else"
            weak = plan.problem.limits.torque < math.inf
            told += "; what the motor must give is not looked at there" if weak else ""
            shown.append((f"{100 * chance.estimate:.0f} %", told) if chance.samples else ("?", f"{told}: {chance}"))
        return (*shown, *clearance_tiles(plan), *torque_tiles(plan, seen))

    def _story(self) -> tuple[str, ...]:
        plan, lines = self.plan, [f"Target: {self.target}."]
        if plan.strokes is None:
            return tuple(lines)
        lines.append(stroke_story(plan))
        if (seen := plan.outcome) is not None:
            lines.append(
                f"The tip comes between the walls at {seen.t_enter:.2f} s, and is inside at {seen.t:.2f} s; it stays "
                f"beyond the walls without a touch for {seen.time_inside:.2f} s of the run."
            )
        if plan.success_probability is not None:
            lines.append(f"Success probability: {plan.success_probability}.")
        if math.isfinite(plan.position_std):
            lines.append(
                f"Uncertainty: where the rope crosses the gap has a standard deviation of "
                f"{1e3 * plan.position_std:.0f} mm if friction is known to {100 * FRICTION_STD:g} %, length to "
                f"{100 * LENGTH_STD:g} % and each rest of the arm to {1e3 * TIMING_STD:g} ms."
            )
        return (*lines, self.warning) if self.warning else tuple(lines)

    def figures(self) -> "dict[str, Figure]":
        """Draw the rope until the tip is inside, its way through the gap, and the time course."""
        plan = self.plan
        return {"entry": entry_figure(plan), "gap": gap_figure(plan), "course": course_figure(plan)}

    def film(self) -> dict[str, Any]:
        """Return title, notes and speed of the film, and when the tip is inside."""
        inside = self.plan.required(self.plan.outcome, "outcome").t
        return {
            "title": "planned insertion, simulated",
            "note": self.film_note(),
            "speed": _SLOW,
            "marks": (inside,),
            "obstacles": self.plan.problem.obstacles,
        }

    def film_note(self) -> Callable[[float], str]:
        """Return what the film says at a time, s: slot, arm, and what the tip does."""
        seen, slot = self.plan.required(self.plan.outcome, "outcome"), self.plan.target

        def note(t: float) -> str:
            end = f"inside at {seen.t:.2f} s: {seen.speed:.2f} m/s, {length(seen.wall_clearance, 2)} clear"
            if not self.plan.success:
                end = f"FAILS: {self.plan.message}"
            place = f"slot: x = {slot.x:.3g} m, y = {slot.y:.3g} m, {length(slot.width)} wide"
            return "\n".join((place, stroke_note(self.plan, t), end if t >= seen.t else ""))

        return note


def _checks(plan: InsertPlan) -> TextTable:
    rows = [
        _check(name, seen) for name, seen in (("as planned", plan.outcome), ("2.5 times the links", plan.finer_outcome))
    ]
    names = ("run", "links", "inside", "depth", "speed", "clear of the walls", clear_of(plan.problem))
    return TextTable(names, tuple(rows))


def _check(name: str, seen: InsertOutcome | None) -> tuple[str, ...]:
    if seen is None:
        return (name, "not through, or not run", *5 * ("",))
    return (
        name,
        str(seen.n_links),
        f"{seen.t:.3f} s",
        length(seen.depth, 2),
        f"{seen.speed:.2f} m/s",
        f"{1e3 * seen.wall_clearance:.1f} mm",
        f"{1e3 * seen.clearance:.1f} mm",
    )
