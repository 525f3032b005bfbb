"""A planned cast in words: target, swings, strike, turns, hold, what it asks of the motor, or why it fails."""

from __future__ import annotations

import math

import numpy as np

from hyperflex.model import Peg
from hyperflex.planning import (
    BOUNCE_TIME,
    MAX_SLIP,
    MIN_TURNS,
    WATCH_TIME,
    CastOutcome,
    CastPlan,
    HoldingForce,
    WhipPlan,
)
from hyperflex.report.cast.figures import way
from hyperflex.report.cast_setup_words import NOT_KNOWN, arm_words, asked_of_motor, rope_words
from hyperflex.report.tables import TextTable
from hyperflex.simulation.time_budget import NAME as OUT_OF_PATIENCE

_TOO_LONG = f"the simulation failed ({OUT_OF_PATIENCE})"
Tiles = tuple[tuple[str, str], ...]


def lead(plan: CastPlan) -> str:
    """Return what this is about, and where it comes from."""
    thrown = "is thrown" if plan.success else "is to be thrown"
    return (
        f"A rope that hangs from a motor-driven arm {thrown} round a peg, so that it winds round it and holds. "
        f"{source(plan)}; nothing here was measured."
    )


def source(plan: CastPlan | WhipPlan) -> str:
    """Return where a plan comes from."""
    if plan.success:
        return "Planned and verified by simulation"
    return "Searched for by simulation" if searched(plan) else "Judged beforehand, without a search"


def title(plan: CastPlan) -> str:
    """Return a heading that says whether there is a cast."""
    where = f"x\u00a0=\u00a0{plan.target.x:.3g}\u00a0m, y\u00a0=\u00a0{plan.target.y:.3g}\u00a0m"
    return f"{'A planned cast round a target' if plan.success else 'No cast found round a target'} at {where}"


def target_words(peg: Peg) -> str:
    """Return where the target is and how large."""
    return f"x = {peg.x:.3g} m, y = {peg.y:.3g} m, radius {1e3 * peg.radius:.3g} mm"


def swings_words(plan: CastPlan) -> str:
    """Return how many swings the arm makes."""
    count = 0 if plan.throw is None else plan.throw.count
    return f"{count} swing{'' if count == 1 else 's'}"


def verdict(plan: CastPlan) -> str:
    """Return in a sentence whether the cast stands."""
    if plan.success and plan.outcome is not None:
        return f"The rope winds {abs(plan.outcome.turns):.2f} turns round the target and holds, in simulation."
    return f"No cast that winds and holds was found: {why(plan)}."


def why(plan: CastPlan) -> str:
    """Return why a plan fails, without a full stop; what the rule of thumb says is said to be that."""
    if plan.message == plan.feasibility.message and not plan.feasibility.impossible:
        return plan.message.replace("out of reach", "out of reach by a rule of thumb", 1)
    return plain(plan.message)


def plain(reason: str) -> str:
    """Return the reason of a cast that fails in words for people."""
    told = "the verification of the best throw took longer than the time allowed for it; give more --patience"
    return reason.replace(_TOO_LONG, told)


def instead(plan: CastPlan) -> tuple[str, ...]:
    """Return, for a plan that fails, where a target would do, and what would do for this one."""
    if plan.success:
        return ()
    told, near = [], plan.fallback
    wanted = "should be easier" if plan.feasibility.feasible else "should be in reach"
    if near is None and not plan.unfinished:
        told.append(f"No place was found where a target like this {wanted}.")
    elif near is not None:
        where = f"x = {near.target.x:.4g} m, y = {near.target.y:.4g} m, {1e2 * near.distance:.3g} cm away"
        if near.plan is not None:
            told.append(
                f"Nearest target that works: {where}. A throw was planned for it that winds and holds, simulated."
            )
        else:
            tried = (
                f"nearer places planned for in vain: {near.failed_plans}; this one not"
                if near.failed_plans
                else "not planned for"
            )
            told.append(f"Nearest target that {wanted}: {where}; expected by a rule of thumb, {tried}.")
    if plan.unfinished:
        on = "to let the search go on" if plan.interrupted else "a longer --patience, less load on the machine"
        told.append(f"By a rule of thumb the target itself is in reach. What may help: {on}, another --seed.")
    elif lacking := _lacks(plan):
        told.append(lacking)
    elif plan.feasibility.feasible:
        told.append("By the same rule this target is in reach, too: a longer --patience or another --seed may help.")
    if plan.remedies:
        told.append(f"By the same rule this target would be in reach with {' or '.join(plan.remedies)}.")
    if not (searched(plan) or plan.feasibility.impossible):
        told.append("Near its edge the rule may be wrong: --regardless searches all the same.")
    return tuple(told)


def _lacks(plan: CastPlan) -> str:
    """Return what a throw that winds lacks, where more searching is not what helps; else nothing."""
    cast, given = plan.outcome, plan.cast_setup.limits.torque
    if cast is None or not cast.wound:
        return ""
    if cast.torque > given:
        return f"For this throw a motor of {cast.torque:.3g} N m is needed; {given:.3g} N m are given."
    if MAX_SLIP <= cast.slip < math.inf:
        return (
            "The rope winds but slips: with more friction on the target, or a weight at the rope's end, it would hold."
        )
    return ""


def tiles(plan: CastPlan, held: HoldingForce | None) -> Tiles:
    """Return the key figures."""
    peg = plan.target
    place = f"target, a round peg: radius; centre at x = {peg.x:.3g} m, y = {peg.y:.3g} m from the motor's shaft"
    shown = [(f"{1e3 * peg.radius:.3g} mm", place)]
    if plan.throw is not None:
        shown.append((swings_words(plan), "of the arm to and fro, then one last move"))
    if plan.outcome is not None and plan.outcome.run is not None:
        struck = math.isfinite(plan.outcome.strike_time)
        strike = f"{plan.outcome.strike_time:.2f} s" if struck else "never"
        shown.append((strike, f"{'after the start ' if struck else ''}the rope strikes the target"))
        if struck:
            contact = math.degrees(plan.outcome.contact_angle)
            counted = (
                f"in the end, {way(plan)}, from the arm's tip to the rope's end, "
                f"{contact:.0f}\N{DEGREE SIGN} of it on the target; {MIN_TURNS:g} are asked"
            )
            shown.append((f"{abs(plan.outcome.turns):.2f} turns", counted))
    elif plan.throw is not None:
        shown.append((NOT_KNOWN, "strike, turns and hold: the throw was not verified to its end"))
    if held is not None:
        least = "" if held.tug.slipped else "at least "
        shown.append(
            (f"{least}{held.force:.2f}\u00a0N", "hold force: the tug that the wound rope bears before it slips")
        )
    return tuple(shown)


def story(plan: CastPlan, held: HoldingForce | None) -> tuple[str, ...]:
    """Return what happens, in order."""
    if plan.throw is None:
        return ()
    limits, cast = plan.cast_setup.limits, plan.outcome
    starts, stop = plan.throw.starts(limits), plan.throw.stops(limits)
    times = ", ".join(f"{start:.2f}" for start in starts[:-1])
    begin = np.degrees(plan.throw.angles(limits)[0])
    told = [f"Target: a round peg, {target_words(plan.target)}."]
    told.append(
        f"The rope hangs at rest from the arm at {begin:.0f} degrees (0 hangs down). The arm makes "
        f"{swings_words(plan)}, begun at {times} s, and a last move at {starts[-1]:.2f} s; it stands still from "
        f"{stop:.2f} s on."
    )
    if cast is not None and cast.run is not None:
        told.append(_outcome(plan))
    else:
        told.append("What the rope then does is not known: the throw was not verified to its end.")
    if warning := folds(plan):
        told.append(warning)
    if held is not None:
        told.append(_hold(held))
    if plan.success_probability is not None:
        told.append(
            f"How sure: in simulated worlds drawn afresh (rope, friction and motor as little known as was said), the "
            f"throw wins {plan.success_probability}."
        )
    return tuple(told)


def _outcome(plan: CastPlan) -> str:
    cast = plan.outcome
    if cast is None or not math.isfinite(cast.strike_time):
        return "The rope does not touch the target."
    struck = f"{grazes(cast)}The rope strikes the target at {cast.strike_time:.2f} s"
    if not math.isfinite(cast.slip):
        return f"{struck} and does not stay wound on it: {plain(cast.message)}."
    return (
        f"{struck}, winds {way(plan)}, and lies round it with "
        f"{abs(cast.turns):.2f} turns: the angle swept about the target's centre from the arm's tip along the rope to "
        f"its end, so straight parts and the hanging tail count beside what lies on the target "
        f"({math.degrees(cast.contact_angle):.0f} degrees), and a tail that swings "
        f"changes it. In the last {WATCH_TIME:g} s the rope slips on the target by {1e3 * cast.slip:.2g} mm; "
        f"{1e3 * MAX_SLIP:g} mm are allowed."
    )


def grazes(cast: CastOutcome) -> str:
    """Return a sentence about a touch that does not last, which comes before the strike."""
    if cast.strike_time - cast.touch_time <= BOUNCE_TIME:
        return ""
    return f"The rope grazes the target at {cast.touch_time:.2f} s and comes off again. "


def folds(plan: CastPlan) -> str:
    """Return a warning of a rope that is folded through itself on the way, else nothing."""
    folded = [cast for cast in (plan.outcome, plan.finer_outcome) if cast is not None and cast.folded]
    if not folded:
        return ""
    bend = math.degrees(max(cast.max_bend for cast in folded))
    return (
        f"On the way the simulated rope folds by {bend:.0f} degrees from one link to the next, through itself: its "
        "contact with itself is not simulated. A real rope makes a loop or a kink there, so what comes after is less "
        "sure."
    )


def _hold(held: HoldingForce) -> str:
    bore = (
        f"the rope bore {held.force:.2f} N and then slipped"
        if held.tug.slipped
        else f"the rope bore {held.force:.2f} N and had not slipped when the pull ended, so it holds more"
    )
    return (
        f"Hold force (mean over 0.1 s): pulled away from the target at 20 mm/s, {bore}. For comparison, the tail that "
        f"hangs beyond the target weighs {held.tail_weight:.3f} N; times e^(mu angle), with mu = {held.mu:g} and "
        f"{held.contact_angle:.1f} rad of contact, that is {held.capstan_force:.2f} N. This rule leaves out the weight "
        "of the rope on the target and of the rope between target and arm, which the pull bears as well."
    )


def motor_table(plan: CastPlan) -> TextTable:
    """Return what the cast asks of the motor beside what it can do."""
    return asked_of_motor(plan.cast_setup.limits, plan.motion, plan.run)


def checks_table(plan: CastPlan) -> TextTable:
    """Return what the verified runs say, with the links and with shorter ones."""
    rows = []
    for name, cast in (("as planned", plan.outcome), ("shorter links", plan.finer_outcome)):
        if cast is None:
            rows.append((name, "not run", "", "", "", ""))
            continue
        if not cast.completed:
            rows.append((name, "not finished", NOT_KNOWN, NOT_KNOWN, NOT_KNOWN, NOT_KNOWN))
            continue
        links = str(cast.n_links)
        slip = f"{1e3 * cast.slip:.2g} mm" if math.isfinite(cast.slip) else "does not stay"
        strike = f"{cast.strike_time:.2f} s" if math.isfinite(cast.strike_time) else "never"
        turns = f"{abs(cast.turns):.2f}" if math.isfinite(cast.strike_time) else "none"
        rows.append((name, links, strike, turns, slip, "yes" if cast.success else "no"))
    return TextTable(("run", "links", "strikes", "turns", "slips", "winds and holds"), tuple(rows))


def searched(plan: CastPlan | WhipPlan) -> bool:
    """Whether a search was made, or at least begun."""
    return bool(plan.runs) or plan.interrupted or plan.motion is not None


def search_words(plan: CastPlan | WhipPlan) -> str:
    """Return how the plan was found."""
    if not searched(plan):
        return "No search was made: the target was judged beforehand."
    ended = ", interrupted before its end" if plan.interrupted else ""
    runs = f"{plan.runs} simulated run{'' if plan.runs == 1 else 's'}"
    return f"The search took {plan.seconds:.0f} s and {runs}{ended}."


def setup_words(plan: CastPlan) -> tuple[str, ...]:
    """Return rope, arm and target as they were given."""
    peg = plan.target
    words = (
        f"{rope_words(plan.cast_setup)}; links near the target are cut shorter for the verified runs. "
        f"{arm_words(plan.cast_setup)} Target: a round peg at {target_words(peg)}, friction mu = {peg.mu:g}."
    )
    return (words,)
