"""The robust phase of a planner of casts: of its candidates, the throw that succeeds in most scenarios."""

import math
from collections.abc import Callable

from hyperflex.planning.robust.refinement import RobustCandidate, RobustRefinement
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.wind.planner import CastPlanner
from hyperflex.planning.wind.verified import Asked, Verified, incomplete, succeeds, with_margin

# Fractions of the time of a robust plan: after ENOUGH a plan that stands ends the search in the nominal scenario, after
# NOMINAL that search ends in any case. After REFINING candidates are only verified, after VERIFYING the success
# probability is estimated
ENOUGH, NOMINAL, REFINING, VERIFYING = 0.3, 0.5, 0.8, 0.9
NO_MARGIN_COST = 0.3  # value by which a throw without a margin must be better than one with a margin
EARLY_GAIN = 0.2  # doubted mean by which a throw must be better than those that stand to be verified before REFINING
NONE = (False, False, 0.0)  # value of no throw


def refine_robustly(planner: CastPlanner, uncertainty: Uncertainty, report: Callable[[float], None] | None) -> None:
    """Search, in the time that is left to a planner, for the throw that succeeds in most scenarios.

    Candidates that fail in the nominal scenario are refined no further, nor in the end those without a margin there.
    A plan that succeeds in more scenarios than the one before is told as soon as it was verified.
    """
    if planner.ended:
        return
    planner.time_budget, planner.verifying, planner.enough = planner.time_budget / NOMINAL, VERIFYING, math.inf
    search, known, some = planner.search, dict[RobustCandidate, Verified](), list[RobustCandidate]()
    refinement = RobustRefinement(search, uncertainty, left=lambda: REFINING * planner.time_budget - planner.spent)
    try:
        refinement.halve(search.candidates, [one for one in planner.checked if one.throw is planner.best[0]])
        complete = [found for found in planner.verified if not incomplete(found)]
        known |= {one: found for one in refinement.order for found in complete if found[0] is one.candidate.throw}
        refinement.promote([one for one, found in known.items() if succeeds(found)])
        while not planner.ended:
            late = not refinement.in_time
            vain = [one for one, found in known.items() if not _worth_refining(one, found, late, planner.asked)]
            refinement.drop(vain)
            stands = max((one.doubted_mean for one, found in known.items() if succeeds(found)), default=0.0)
            refinement.run(stands + EARLY_GAIN, None if report is None else lambda: report(planner.spent))
            if not refinement.order or (some and planner.spent > planner.time_budget):
                break
            best = max((_value(*each, planner.asked) for each in known.items()), default=NONE)
            incumbent, late = refinement.incumbent, not refinement.in_time
            if incumbent in known:
                if with_margin(known[incumbent], planner.asked) and (late or incumbent.always_succeeds):
                    break
                continue  # refined on, or dropped
            if best >= (True, True, incumbent.doubted_mean):
                break
            some = [one for one in refinement.best(search.workers if late else 1) if one not in known]
            for one, found in zip(some, planner.outcomes([one.candidate for one in some]), strict=True):
                known[one] = found
            if _choose(planner, known):
                planner.tell()
    finally:
        search.runs += refinement.runs
        _choose(planner, known)  # not told: it may be an interrupt that ends here


def _choose(planner: CastPlanner, known: dict[RobustCandidate, Verified]) -> bool:
    """Let the best of verified throws be the plan; return whether that is another one than before."""
    before, chosen = planner.best[0], max(known, key=lambda one: _value(one, known[one], planner.asked), default=None)
    if chosen is not None and (succeeds(known[chosen]) or not succeeds(planner.best)):
        planner.best = known[chosen]
    return planner.best[0] is not before


def _worth_refining(one: RobustCandidate, found: Verified, late: bool, asked: Asked) -> bool:
    """Whether throws like a verified one may be better.

    Without a margin that is so while there is time for throws that have one, unless it succeeds always.
    """
    return with_margin(found, asked) or (succeeds(found) and not (late or one.always_succeeds))


def _value(one: RobustCandidate, found: Verified, asked: Asked) -> tuple[bool, bool, float]:
    """Value of a robust candidate as a plan."""
    cost = 0.0 if with_margin(found, asked) else NO_MARGIN_COST
    return succeeds(found), not incomplete(found), one.doubted_mean - cost
