"""The report of a planned cast: its words, player and figures."""

import math
from collections.abc import Callable
from textwrap import fill
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from hyperflex import winding
from hyperflex.model import Peg
from hyperflex.planning import (
    BOUNCE_TIME,
    MAX_SLIP,
    SETTLING_TIME,
    WATCH_TIME,
    CastOutcome,
    CastPlan,
    FallbackTarget,
    HoldingForce,
)
from hyperflex.report.cast.figures import behind_sentence, course_figure, sense, strike_figure, tug_figure, way
from hyperflex.report.cast.target_map import target_map, target_map_caption
from hyperflex.report.page import Picture, Section, TextTable
from hyperflex.report.plan import (
    NOT_KNOWN,
    PlanReport,
    clear_of,
    clearance_tiles,
    counted,
    searched,
    torque_tiles,
    torque_warning,
)
from hyperflex.report.player import Line, Plot
from hyperflex.report.style import png
from hyperflex.report.units import length

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINE = 90  # letters that fit beside each other in a film
_LEAST_SLIP = 1e-5  # m; a run does not resolve less, so it is not told in numbers
_END = 2.0  # s at the end of a film in which the hold force is shown


class CastReport(PlanReport[CastPlan]):
    """The report of a planned cast, and of a tug at the wound rope, if there was one.

    A plan without a throw leaves no more than a page with the reason and where the target is.
    """

    captions: ClassVar = {
        "film": "The planned cast, simulated: arm, rope (ochre), path of the tip (green), target (red).",
        "strike": "The rope about the strike, early instants dark, late ones bright; simulated.",
        "course": "Arm angle, turns, tension and torque over time. Dashed red: the strike. Green: slip is measured.",
        "tug": "The simulated tug that gives the hold force: pull, and slip of the rope on the target.",
    }
    checks_note: ClassVar = ("Links near the target are cut shorter than the rope's own for both runs.",)
    layout: ClassVar = {"The cast": ("film", "strike"), "Time course": ("course",), "Hold": ("tug",)}

    def __init__(self, plan: CastPlan, held: HoldingForce | None, name: str = "cast") -> None:
        super().__init__(plan)
        self.held, self.name = held, name
        thrown, found = ("is", "A planned cast") if plan.success else ("is to be", "No cast found")
        where = f"x = {plan.target.x:.3g} m, y = {plan.target.y:.3g} m".replace(" ", "\u00a0").replace(",\u00a0", ", ")
        self.title = f"{found} round a target at {where}"
        self.task = f"A rope on a motor-driven arm {thrown} thrown round a peg, so that it winds round it and holds."
        self.target = f"a round peg at {_place(plan.target)}, friction mu = {plan.target.mu:g}"
        self.verdict = f"No cast that winds and holds was found: {_failure(plan)}."
        if plan.success and plan.outcome is not None:
            self.verdict = (
                f"The rope winds {abs(plan.outcome.turns):.2f} turns round the target, "
                f"covers {math.degrees(plan.outcome.contact_angle):.0f} degrees of it, and holds, in simulation."
            )
        self.warning, self.advice = _warning(plan), _advice(plan)
        self.tiles, self.story, self.checks = self._tiles(), self._story(), _checks(plan)
        self.others = {"nearest": None if plan.fallback is None else plan.fallback.plan}
        if plan.run is None:
            place = Picture(png(target_map(plan)), target_map_caption(plan))
            self.without_run = (Section("Where the target is", pictures=(place,)),)

    def _tiles(self) -> tuple[tuple[str, str], ...]:
        plan, peg, cast = self.plan, self.plan.target, self.plan.outcome
        place = f"target, a round peg: radius; centre at x = {peg.x:.3g} m, y = {peg.y:.3g} m"
        shown = [(length(peg.radius), place)]
        if plan.throw is not None:
            shown.append((_swings(plan), "of the arm to and fro, then one last move"))
        if cast is not None and cast.completed:
            if math.isfinite(cast.strike_time):
                shown.append((f"{cast.strike_time:.2f} s", "after the start the rope strikes the target"))
                needed = f"{plan.problem.turns:g} are needed"
                counted_from = f"in the end, {way(plan)}, from the arm's tip to the rope's end; {needed}"
                shown.append((f"{abs(cast.turns):.2f} turns", counted_from))
                covered = f"{math.degrees(cast.contact_angle):.0f}\N{DEGREE SIGN}"
                shown.append((covered, _covered(cast.contact_angle, plan.problem.contact)))
            else:
                shown.append(("never", "the rope strikes the target"))
        elif plan.throw is not None:
            shown.append((NOT_KNOWN, "strike, turns and hold: the throw was not verified to its end"))
        shown += clearance_tiles(plan) + torque_tiles(plan, cast)
        if self.held is not None:
            least = "" if self.held.tug.slipped else "at least "
            shown.append(
                (
                    f"{least}{self.held.force:.2f}\u00a0N",
                    "hold force: the pull that the wound rope withstands before it slips",
                )
            )
        return tuple(shown)

    def _story(self) -> tuple[str, ...]:
        plan, cast, limits = self.plan, self.plan.outcome, self.plan.problem.limits
        if plan.throw is None:
            return ()
        starts, stop = plan.throw.starts(limits), plan.throw.stops(limits)
        times = ", ".join(f"{start:.2f}" for start in starts[:-1])
        begin = np.degrees(plan.throw.angles(limits)[0])
        start = "swings, in the state that the plan's file holds (q0, qd0)," if plan.problem.q0 else "hangs at rest"
        lines = [
            f"Target: a round peg, {_place(plan.target)}.",
            (
                f"The rope {start} from the arm at {begin:.0f} degrees (0 hangs down, 90 points along +x). The arm "
                f"makes {_swings(plan)}, begun at {times} s, and a last move at {starts[-1]:.2f} s; it stands still "
                f"from {stop:.2f} s on."
            ),
        ]
        if cast is not None and cast.completed:
            lines.append(_outcome(plan, cast))
        else:
            lines.append("What the rope then does is not known: the throw was not verified to its end.")
        if self.warning:
            lines.append(self.warning)
        if self.held is not None:
            lines.append(_hold(self.held))
        if (chance := plan.success_probability) is not None:
            lines.append(
                f"Success probability: the rope stays wound in {chance} of simulated scenarios with rope, friction and "
                f"motor drawn anew from the given uncertainty. Slip and hold force are not asked."
                if chance.samples
                else f"Success probability: {chance}."
            )
        return tuple(lines)

    def figures(self) -> "dict[str, Figure]":
        """Draw strike, time course, and tug if there was one."""
        drawn = {"strike": strike_figure(self.plan), "course": course_figure(self.plan)}
        return drawn if self.held is None else drawn | {"tug": tug_figure(self.held)}

    def film(self) -> dict[str, Any]:
        """Return title and notes of the film, the turns as a plot, and when the rope strikes."""
        turns = sense(self.plan) * winding.turns(self.plan.required(self.plan.run, "run"), self.plan.target)
        plots = (Plot(f"turns, {way(self.plan)}", "", (Line("", turns),)),)
        strike = math.nan if self.plan.outcome is None else self.plan.outcome.strike_time
        marks = (strike,) if math.isfinite(strike) else ()
        walls = self.plan.problem.obstacles
        words = {"title": "planned cast, simulated", "note": self.film_note()}
        return {**words, "plots": plots, "marks": marks, "obstacles": walls}

    def film_note(self) -> Callable[[float], str]:
        """Return what the film says at a time, s: target, arm, turns, and at the end the hold."""
        run, cast = self.plan.required(self.plan.run, "run"), self.plan.outcome
        turns = sense(self.plan) * winding.turns(run, self.plan.target)
        strike = np.inf if cast is None or not np.isfinite(cast.strike_time) else cast.strike_time

        def note(t: float) -> str:
            lines = [f"target: {_place(self.plan.target)}", f"arm: {self._arm_words(t)}"]
            if t < strike:
                lines.append("rope: in the air")
            else:
                lines.append(f"rope: {np.interp(t, run.t, turns):.2f} turns round the target, {way(self.plan)}")
            if t > run.t[-1] - _END:
                lines.append(self._end_words())
            return "\n".join(lines)

        return note

    def _arm_words(self, t: float) -> str:
        if self.plan.throw is None:
            return ""
        limits, count = self.plan.problem.limits, self.plan.throw.count
        begun = int((self.plan.throw.starts(limits) <= t).sum())
        if begun == 0:
            return f"at rest, {_swings(self.plan)} to come"
        if begun <= count:
            rests = self.plan.motion is not None and float(self.plan.motion.rate(t)) == 0.0
            return f"{'rests after ' if rests else ''}swing {begun} of {count}"
        done = t >= self.plan.throw.stops(limits)
        return f"stands still, {_swings(self.plan)} done" if done else f"last move after {_swings(self.plan)}"

    def _end_words(self) -> str:
        if not self.plan.success:
            return fill(f"FAILS: {_failure(self.plan)}", _LINE)
        if self.held is None:
            return "wound and held"
        return f"wound and held; hold force {self.held.force:.2f} N" + (
            " (tug)" if self.held.tug.slipped else " or more (tug)"
        )


def _covered(contact: float, asked: float) -> str:
    """Return what contact is, and how much is there and was asked for, rad."""
    told = f"contact: the angle of the target that the rope covers, {contact:.2f} rad"
    return told + (f"; {asked:.3g} rad are asked" if asked else "")


def _place(peg: Peg) -> str:
    """Return where the target is and how large."""
    return f"x = {peg.x:.3g} m, y = {peg.y:.3g} m, radius {length(peg.radius)}"


def _swings(plan: CastPlan) -> str:
    """Return how many swings the arm makes."""
    return counted(0 if plan.throw is None else plan.throw.count, "swing")


def _failure(plan: CastPlan) -> str:
    """Return why a plan fails, without a full stop; a heuristic criterion is called one."""
    if plan.message == plan.feasibility.message and not plan.feasibility.impossible:
        return plan.message.replace("out of reach", "out of reach by a rule of thumb", 1)
    return plan.message


def _advice(plan: CastPlan) -> tuple[str, ...]:
    """Return, for a plan that fails, where a target would work, and what would help for this one."""
    if plan.success:
        return ()
    lines = []
    if plan.fallback is not None:
        lines.append(_nearest(plan, plan.fallback))
    elif not plan.unfinished:
        lines.append(f"No place was found where a target like this {_expected(plan)}.")
    if plan.unfinished:
        on = "to let the search go on" if plan.interrupted else "a longer --time-budget, less load on the machine"
        lines.append(f"By a rule of thumb the target itself is in reach. What may help: {on}, another --seed.")
    elif lacking := _lacks(plan):
        lines.append(lacking)
    elif plan.feasibility.feasible:
        lines.append(
            "By the same rule this target is in reach, too: a longer --time-budget or another --seed may help."
        )
    if plan.remedies:
        lines.append(f"By the same rule this target would be in reach with {' or '.join(plan.remedies)}.")
    if not (searched(plan) or plan.feasibility.impossible):
        lines.append("Near its edge the rule may be wrong: --skip-feasibility searches all the same.")
    return tuple(lines)


def _expected(plan: CastPlan) -> str:
    return "should be easier" if plan.feasibility.feasible else "should be in reach"


def _nearest(plan: CastPlan, near: FallbackTarget) -> str:
    where = f"x = {near.target.x:.4g} m, y = {near.target.y:.4g} m, {length(near.distance, small='cm')} away"
    if near.plan is not None:
        return f"Nearest target that works: {where}. A throw was planned for it that winds and holds, simulated."
    tried = (
        f"nearer places planned for in vain: {near.failed_plans}; this one not"
        if near.failed_plans
        else "not planned for"
    )
    return f"Nearest target that {_expected(plan)}: {where}; expected by a rule of thumb, {tried}."


def _lacks(plan: CastPlan) -> str:
    """Return what a throw that winds but fails needs, where more search does not help; else ""."""
    cast, given = plan.outcome, plan.problem.limits.torque
    if cast is None or not cast.wound:
        return ""
    if cast.torque > given:
        return f"For this throw a motor of {cast.torque:.3g} N m is needed; {given:.3g} N m are given."
    if MAX_SLIP <= cast.slip < math.inf:
        return (
            "The rope winds but slips: with more friction on the target, or a weight at the rope's end, it would hold."
        )
    return ""


def _outcome(plan: CastPlan, cast: CastOutcome) -> str:
    if not math.isfinite(cast.strike_time):
        return "The rope does not touch the target."
    struck = f"{_grazes(cast)}The rope strikes the target at {cast.strike_time:.2f} s"
    if not math.isfinite(cast.slip):
        return f"{struck} and does not stay wound on it: {cast.message}."
    return (
        f"{struck}, winds {way(plan)}, and lies round it with "
        f"{abs(cast.turns):.2f} turns: the angle swept about the target's centre from the arm's tip along the rope to "
        f"its end, so straight parts and the hanging tail count beside what lies on the target "
        f"({math.degrees(cast.contact_angle):.0f} degrees), and a tail that swings "
        f"changes it. In the last {WATCH_TIME:g} s{_watched(plan)} the rope slips on the target by "
        f"{length(cast.slip, 2, least=_LEAST_SLIP)}; {1e3 * MAX_SLIP:g} mm are allowed.{behind_sentence(plan)}"
    )


def _watched(plan: CastPlan) -> str:
    """Return when the watch begins, where that is not as usual; else ""."""
    settle = plan.problem.settle
    return "" if settle == SETTLING_TIME else f", from {settle:g} s after the arm's stop on,"


def _grazes(cast: CastOutcome) -> str:
    """Return a sentence about a touch that does not last, which comes before the strike."""
    if cast.strike_time - cast.touch_time <= BOUNCE_TIME:
        return ""
    return f"The rope grazes the target at {cast.touch_time:.2f} s and comes off again. "


def _hold(held: HoldingForce) -> str:
    told = (
        f"the rope withstood {held.force:.2f} N and then slipped"
        if held.tug.slipped
        else f"the rope withstood {held.force:.2f} N and had not slipped when the pull ended, so it holds more"
    )
    return (
        f"Hold force (mean over 0.1 s): pulled away from the target at 20 mm/s, {told}. For comparison, the tail that "
        f"hangs beyond the target weighs {held.tail_weight:.3f} N; times e^(mu angle), with mu = {held.mu:g} and "
        f"{held.contact_angle:.1f} rad of contact, that is {held.capstan_force:.2f} N (Capstan equation). It leaves "
        "out the weight of the rope on the target and of the rope between target and arm, which the pull lifts as well."
    )


def _checks(plan: CastPlan) -> TextTable:
    rows = []
    for name, cast in (("as planned", plan.outcome), ("shorter links", plan.finer_outcome)):
        if cast is None:
            rows.append((name, "not run", *6 * ("",)))
        elif not cast.completed:
            rows.append((name, "not finished", *6 * (NOT_KNOWN,)))
        else:
            struck = math.isfinite(cast.strike_time)
            strike, turns = (f"{cast.strike_time:.2f} s", f"{abs(cast.turns):.2f}") if struck else ("never", "none")
            slip = length(cast.slip, 2, least=_LEAST_SLIP) if math.isfinite(cast.slip) else "does not stay"
            contact, clear = f"{math.degrees(cast.contact_angle):.0f}\N{DEGREE SIGN}", f"{1e3 * cast.clearance:.1f} mm"
            good = "yes" if cast.success else "no"
            rows.append((name, str(cast.n_links), strike, turns, contact, slip, clear, good))
    names = ("run", "links", "strikes", "turns", "contact", "slips", clear_of(plan.problem), "winds and holds")
    return TextTable(names, tuple(rows))


def _warning(plan: CastPlan) -> str:
    """Return a warning of a rope that folds flat on the way, or of a great torque, else nothing."""
    folded = [cast for cast in (plan.outcome, plan.finer_outcome) if cast is not None and cast.folded]
    torque = torque_warning(plan, plan.outcome)
    if not folded:
        return torque
    bend = math.degrees(max(cast.max_bend for cast in folded))
    return (
        f"On the way the simulated rope folds flat, by {bend:.0f} degrees from one link to the next. A real rope makes "
        "a loop or a kink there, so what comes after is less sure." + (f" {torque}" if torque else "")
    )
