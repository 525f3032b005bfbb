"""The report of a planned cast, with a tug at the wound rope: texts, figures and film."""

import math
from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from hyperflex import winding
from hyperflex.model import Peg
from hyperflex.planning import BOUNCE_TIME, CastOutcome, CastPlan, HoldingForce, WindCriteria
from hyperflex.report.curves import Panel, time_course
from hyperflex.report.maps import target_map
from hyperflex.report.page import Picture, Section
from hyperflex.report.plan import NOT_KNOWN, PlanReport, in_words, searched
from hyperflex.report.scene import Line, Overlay, Plot
from hyperflex.report.style import BLUE, GREEN, GREY, RED, new_figure, note, png
from hyperflex.report.units import length

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class CastReport(PlanReport[CastPlan]):
    """The report of a planned cast, and of a tug at the wound rope, if one was simulated.

    For a plan without a throw it is a page with the reason and a map of the target.

    Parameters
    ----------
    plan : CastPlan
    held : HoldingForce, optional
        Result of the tug.
    """

    name, strobe, move, last_move, film_speed = "cast", "strike", "swing", True, 1.0

    layout: ClassVar = {
        "The cast": {
            "film": "The planned cast, simulated: arm, rope (ochre), path of the tip (green), target (red).",
            "strike": "The rope about the strike, early instants dark, late ones bright; simulated.",
        },
        "Time course": {
            "course": "Arm angle, turns, tension and torque over time. Dashed red: the strike. Green: slip is measured."
        },
        "Hold": {"tug": "The simulated tug that gives the hold force: pull, and slip of the rope on the target."},
    }
    columns: ClassVar = {
        "links": lambda cast: str(cast.n_links),
        "strikes": lambda cast: f"{cast.strike_time:.2f} s" if math.isfinite(cast.strike_time) else "never",
        "turns": lambda cast: f"{abs(cast.turns):.2f}" if math.isfinite(cast.strike_time) else "none",
        "contact": lambda cast: f"{math.degrees(cast.contact_angle):.0f}\N{DEGREE SIGN}",
        "slips": lambda cast: _slip(cast) if math.isfinite(cast.slip) else "does not stay",
        "winds and holds": lambda cast: "yes" if cast.success else "no",
    }
    runs = ("as planned", "shorter links")
    runs_note = "Links near the target are cut shorter than the rope's own for both runs."

    def __init__(self, plan: CastPlan, held: HoldingForce | None = None) -> None:
        super().__init__(plan)
        self.held = held
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
        self.clockwise = plan.outcome is not None and plan.outcome.turns < 0.0
        self.way = "clockwise" if self.clockwise else "counterclockwise"
        self.warning = " ".join(filter(None, (_fold_warning(plan), self.torque_warning())))
        self.advice = () if plan.success else _advice(plan)
        self.tiles, self.story = self._tiles(), self._story()

    def without_run(self) -> tuple[Section, ...]:
        """Return a section with a map of the target."""
        near = "" if self.plan.fallback is None else f" Green: {self.nearest_kind}."
        caption = f"Arm and rope at the start, and the target (red), to scale; nothing here was simulated.{near}"
        place = Picture(png(target_map(self.plan, self.nearest_kind)), caption)
        return (Section("Where the target is", pictures=(place,)),)

    def other_plans(self) -> Mapping[str, CastPlan | None]:
        """Return the plan for the nearest target that works."""
        return {"nearest": None if self.plan.fallback is None else self.plan.fallback.plan}

    @property
    def nearest_kind(self) -> str:
        """What the nearest target of a plan that fails is."""
        if self.plan.fallback is not None and self.plan.fallback.plan is not None:
            return "nearest target that works"
        return f"nearest target that {_expected(self.plan)}"

    @property
    def _strike(self) -> float:
        return math.nan if self.plan.outcome is None else self.plan.outcome.strike_time

    @property
    def _stop(self) -> float:
        return 0.0 if self.plan.motion is None else float(self.plan.motion.breaks[-1])

    def _tiles(self) -> tuple[tuple[str, str], ...]:
        plan, peg, cast = self.plan, self.plan.target, self.plan.outcome
        shown = [(length(peg.radius), f"target, a round peg: radius; centre at x = {peg.x:.3g} m, y = {peg.y:.3g} m")]
        if plan.moves is not None:
            shown.append((self.move_count(), "of the arm to and fro, then one last move"))
        if cast is None or not cast.completed:
            if plan.moves is not None:
                shown.append((NOT_KNOWN, "strike, turns and hold: the throw was not verified to its end"))
        elif not math.isfinite(cast.strike_time):
            shown.append(("never", "the rope strikes the target"))
        else:
            shown.append((f"{cast.strike_time:.2f} s", "after the start the rope strikes the target"))
            words = f"in the end, {self.way}, from the arm's tip to the rope's end"
            shown.append((f"{abs(cast.turns):.2f} turns", f"{words}; {plan.problem.criteria.turns:g} are required"))
            required = (
                f"; {plan.problem.criteria.contact:.3g} rad are required" if plan.problem.criteria.contact else ""
            )
            words = f"contact: the angle of the target that the rope covers, {cast.contact_angle:.2f} rad{required}"
            shown.append((f"{math.degrees(cast.contact_angle):.0f}\N{DEGREE SIGN}", words))
        shown += self.arm_tiles()
        if self.held is not None:
            least, words = (
                "" if self.held.tug.slipped else "at least ",
                "hold force: the pull that the wound rope withstands",
            )
            shown.append((f"{least}{self.held.force:.2f}\u00a0N", f"{words} before it slips"))
        return tuple(shown)

    def _story(self) -> tuple[str, ...]:
        plan, cast, limits = self.plan, self.plan.outcome, self.plan.problem.limits
        if plan.moves is None:
            return ()
        *starts, last = plan.moves.starts(limits)
        times = ", ".join(f"{start:.2f}" for start in starts)
        begin = np.degrees(plan.moves.angles(limits)[0])
        start = "swings, in the state that the plan's file holds (q0, qd0)," if plan.problem.q0 else "hangs at rest"
        lines = [
            f"Target: a round peg, {_place(plan.target)}.",
            (
                f"The rope {start} from the arm at {begin:.0f} degrees (0 hangs down, 90 points along +x). The arm "
                f"makes {self.move_count()}, begun at {times} s, and a last move at {last:.2f} s; it stops at "
                f"{self._stop:.2f} s."
            ),
            self._outcome(cast),
            self.warning,
            "" if self.held is None else _hold(self.held),
        ]
        if (chance := plan.success_probability) is not None:
            lines.append(
                f"Success probability: the rope stays wound in {chance} of simulated scenarios in which rope, friction "
                "and motor are sampled from the given uncertainty. Slip and holding force are not checked."
                if chance.samples
                else f"Success probability: {chance}."
            )
        return tuple(filter(None, lines))

    def _outcome(self, cast: CastOutcome | None) -> str:
        """Return a text on the rope at the target."""
        if cast is None or not cast.completed:
            return "What the rope then does is not known: the throw was not verified to its end."
        if not math.isfinite(cast.strike_time):
            return "The rope does not touch the target."
        struck = f"The rope strikes the target at {cast.strike_time:.2f} s"
        if cast.strike_time - cast.touch_time > BOUNCE_TIME:
            struck = f"The rope grazes the target at {cast.touch_time:.2f} s and comes off again. {struck}"
        if not math.isfinite(cast.slip):
            return f"{struck} and does not stay wound on it: {cast.message}."
        criteria = self.plan.problem.criteria
        watch = "" if criteria.settle == 1.0 else f", from {criteria.settle:g} s after the arm's stop on,"
        return (
            f"{struck}, winds {self.way}, and lies round it with {abs(cast.turns):.2f} turns: the angle about the "
            "target's centre from the arm's tip along the rope to its end. Straight parts and the hanging tail count "
            f"in addition to what lies on the target ({math.degrees(cast.contact_angle):.0f} degrees), and a tail that "
            f"swings changes it. In the last {criteria.watch:g} s{watch} the rope slips on it by {_slip(cast)}; "
            f"{1e3 * criteria.max_slip:g} mm are allowed.{self._behind(cast)}"
        )

    def _behind(self, cast: CastOutcome) -> str:
        """Return which pegs the rope runs behind, in a sentence after a space; "" without any."""
        pegs = zip(self.plan.problem.criteria.behind, cast.runs_behind, strict=False)
        found = [f"{'behind' if there else 'not behind'} {in_words(peg)}" for peg, there in pegs]
        return f" On its way from the arm it runs {', and '.join(found)}." if found else ""

    def figures(self) -> "dict[str, Figure]":
        """Draw strike, time course, and tug if there was one."""
        middle = self._strike if math.isfinite(self._strike) else self._stop - 0.8  # before the arm stops
        red = "the target, and pegs before it" if self.plan.problem.criteria.behind else "the target"
        drawn = {"strike": self.strobe_at(middle, 0.6, 0.8, f"red: {red}"), "course": self._course()}
        return drawn if self.held is None else drawn | {"tug": tug_figure(self.held)}

    def overlay(self) -> Overlay:
        """Return notes, turns, obstacles, and when the rope strikes."""
        marks = (self._strike,) if math.isfinite(self._strike) else ()
        plot = Plot(f"turns, {self.way}", "", (Line("", self._turns()),))
        return Overlay(self.film_note, obstacles=self.plan.problem.obstacles, marks=marks, plots=(plot,))

    def film_note(self, t: float) -> str:
        """Return the film's note at a time, s: target, arm, turns, and at the end the hold."""
        lines = [f"target: {_place(self.plan.target)}", self.arm_note(t), "rope: in the air"]
        if t >= self._strike:
            turns = np.interp(t, self.run.t, self._turns())
            lines[-1] = f"rope: {turns:.2f} turns round the target, {self.way}"
        if t > self.run.t[-1] - 2.0:
            lines.append(self._end_words())
        return "\n".join(lines)

    def _turns(self) -> np.ndarray:
        """Return the turns (T,) about the target, positive in the sense in which the rope winds."""
        return (-1.0 if self.clockwise else 1.0) * winding.turns(self.run, self.plan.target)

    def _end_words(self) -> str:
        if not self.plan.success:
            return fill(f"FAILS: {_failure(self.plan)}", 90)  # letters that fit into a line
        if self.held is None:
            return "wound and held"
        more = "" if self.held.tug.slipped else " or more"
        return f"wound and held; hold force {self.held.force:.2f} N{more} (tug)"

    def _course(self) -> "Figure":
        """Draw arm angle, turns, tension and the motor's torque over time."""
        run, wound, setup = self.run, winding.measure_winding(self.run, self.plan.target), self.plan.problem
        turns = Plot(f"turns about the target, {self.way} counted positive", "", (Line("", self._turns()),))
        lines = (Line("towards the arm", wound.before), Line("towards the tip", wound.after))
        tension = Plot("tension of the rope where it leaves the target", "N", lines)
        struck = f"strikes at {self._strike:.2f} s"
        required = (setup.criteria.turns, f"{setup.criteria.turns:g} turns are required")
        panels = Panel(turns, "turns", (GREEN,), required, struck), Panel(tension, "tension")
        figure = time_course(run, "the cast", panels, self.moves(), self._strike)
        for axis in figure.axes:
            axis.axvspan(self._stop + setup.criteria.settle, run.t[-1], color=GREEN, alpha=0.10, lw=0)
        _, upper, lower, _ = figure.axes
        place = {"transform": upper.get_xaxis_transform(), "va": "top", "ha": "right"}
        note(upper, run.t[-1], 0.84, "slip is measured ", GREEN, **place)
        if not np.isfinite(wound.before).any():
            lower.set(ylim=(0.0, 1.0), yticks=())
            note(lower, 0.5, 0.5, "the rope does not lie on the target", transform=lower.transAxes, ha="center")
        return figure


def tug_figure(held: HoldingForce) -> "Figure":
    """Draw pull and slip of the wound rope over the distance that it was pulled."""
    run, tug = held.tug.run, held.tug
    way = 1e3 * np.hypot(*(run.joints[:, 0] - run.joints[0, 0]).T)
    with new_figure(8.6, 4.0, "A tug at the wound rope, simulated") as figure:
        pull, slip = figure.subplots(2, 1, sharex=True)
        tension, least = winding.rope_tension(run)[:, 0], "" if tug.slipped else "at least "
        capstan = f"tail weight x e^(mu angle) {held.capstan_force:.2f} N"
        pull.plot(way, tension, color=BLUE, lw=1.0, label="pull at the rope's first joint")
        pull.axhline(held.force, color=GREEN, ls="--", lw=1.2, label=f"hold force {least}{held.force:.2f} N")
        pull.axhline(held.capstan_force, color=GREY, ls=":", lw=1.4, label=capstan)
        pull.set(ylabel="pull, N", ylim=(0.0, 1.05 * max(held.force, held.capstan_force, float(tension.max()))))
        pull.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8.0)
        allowed = 1e3 * WindCriteria.max_slip
        slip.plot(way, 1e3 * np.abs(tug.slip), color=RED)
        slip.axhline(allowed, color=GREY, ls="--", lw=1.0)
        note(slip, way[0], allowed, f" {allowed:g} mm: has slipped")
        slip.set_ylim(top=max(1.4 * allowed, slip.get_ylim()[1]))  # the note lies within the panel
        slip.set(ylabel="slip, mm", xlabel="distance of the pull away from the target, mm")
    return figure


def _slip(cast: CastOutcome) -> str:
    """Return the slip; a run does not resolve less than 10 um."""
    return length(cast.slip, 2, least=1e-5)


def _place(peg: Peg) -> str:
    """Return place and size of the target."""
    return f"x = {peg.x:.3g} m, y = {peg.y:.3g} m, radius {length(peg.radius)}"


def _failure(plan: CastPlan) -> str:
    """Return why a plan fails, without a full stop; a heuristic criterion is called one."""
    if plan.message == plan.feasibility.message and not plan.feasibility.impossible:
        return plan.message.replace("out of reach", "out of reach by a rule of thumb", 1)
    return plan.message


def _advice(plan: CastPlan) -> tuple[str, ...]:
    """Return, for a failed plan, where a target is feasible and what would help for this target."""
    lines = []
    if plan.fallback is not None:
        lines.append(_nearest(plan))
    elif not plan.unfinished:
        lines.append(f"No place was found where a target like this {_expected(plan)}.")
    if plan.unfinished:
        on = "to let the search continue" if plan.interrupted else "a longer --time-budget, less load on the machine"
        lines.append(f"By a rule of thumb the target itself is in reach. What may help: {on}, another --seed.")
    elif lacking := _lacks(plan):
        lines.append(lacking)
    elif plan.feasibility.feasible:
        words = "a longer --time-budget or another --seed may help."
        lines.append(f"By the same rule this target is in reach, too: {words}")
    if plan.remedies:
        lines.append(f"By the same rule this target would be in reach with {' or '.join(plan.remedies)}.")
    if not (searched(plan) or plan.feasibility.impossible):
        lines.append("Near its limit the rule may be wrong: --skip-feasibility searches nevertheless.")
    return tuple(lines)


def _expected(plan: CastPlan) -> str:
    return "should be easier" if plan.feasibility.feasible else "should be in reach"


def _nearest(plan: CastPlan) -> str:
    """Return the place of the nearest feasible target, planned or expected."""
    near = plan.fallback
    if near is None:
        return ""
    where = f"x = {near.target.x:.4g} m, y = {near.target.y:.4g} m, {length(near.distance, small='cm')} away"
    if near.plan is not None:
        return f"Nearest target that works: {where}. A throw was planned for it that winds and holds, simulated."
    failed = f"planning failed for nearer places: {near.failed_plans}; this one was not tried"
    tried = failed if near.failed_plans else "no throw was planned for it"
    return f"Nearest target that {_expected(plan)}: {where}; expected by a rule of thumb, {tried}."


def _lacks(plan: CastPlan) -> str:
    """Return the requirement that a winding but failed throw violates and more search cannot meet; else ""."""
    cast, given = plan.outcome, plan.problem.limits.torque
    if cast is None or not cast.wound:
        return ""
    if cast.torque > given:
        return f"This throw needs a motor of {cast.torque:.3g} N m; {given:.3g} N m are given."
    if plan.problem.criteria.max_slip <= cast.slip < math.inf:
        return (
            "The rope winds but slips: it would hold with more friction on the target, or a weight at the rope's end."
        )
    return ""


def _hold(held: HoldingForce) -> str:
    withstood = f"the rope withstood {held.force:.2f} N and "
    withstood += "then slipped" if held.tug.slipped else "had not slipped when the pull ended, so it holds more"
    return (
        f"Hold force (mean over 0.1 s): pulled away from the target at 20 mm/s, {withstood}. For comparison, the tail "
        f"that hangs beyond the target weighs {held.tail_weight:.3f} N; times e^(mu angle), with mu = {held.mu:g} and "
        f"{held.contact_angle:.1f} rad of contact, that is {held.capstan_force:.2f} N (Capstan equation). It omits the "
        "weight of the rope on the target and of the rope between target and arm, which the pull lifts as well."
    )


def _fold_warning(plan: CastPlan) -> str:
    """Return a warning of a rope that folds flat on the way, else ""."""
    folded = [cast for cast in (plan.outcome, plan.finer_outcome) if cast is not None and cast.folded]
    if not folded:
        return ""
    bend = math.degrees(max(cast.max_bend for cast in folded))
    return (
        f"On the way the simulated rope folds flat, by {bend:.0f} degrees from one link to the next. A real rope makes "
        "a loop or a kink there, so what follows is less certain."
    )
