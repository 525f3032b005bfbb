"""The robust phase of a planner of casts: of its candidates, the throw that succeeds in most scenarios."""

import math
from collections.abc import Callable

from hyperflex.planning.robust.refinement import RobustCandidate, RobustRefinement
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.time_budget import OutOfTime
from hyperflex.planning.wind.planner import CastPlanner
from hyperflex.planning.wind.verified import Verified, incomplete, succeeds, with_margin

# Fractions of the time of a robust plan: after ENOUGH a plan that stands ends the search in the nominal scenario, after
# NOMINAL that search ends in any case. After REFINING candidates are only verified, after VERIFYING the success
# probability is estimated
ENOUGH, NOMINAL, REFINING, VERIFYING = 0.3, 0.5, 0.75, 0.9
NO_MARGIN_COST = 0.3  # value by which a throw without a margin must be better than one with a margin
NONE = (False, False, 0.0)  # value of no throw


def refine_robustly(planner: CastPlanner, uncertainty: Uncertainty, report: Callable[[float], None] | None) -> None:
    """Search, in the time that is left to a planner, for the throw that succeeds in most scenarios.

    Candidates without a margin in the nominal scenario are dropped. Where who hears of plans has ended the search, its
    plan stays.
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
        refinement.evaluate_common([one for one, found in known.items() if succeeds(found)])
        while True:
            refinement.drop([one for one, found in known.items() if not with_margin(found)])
            refinement.run(None if report is None else lambda: report(planner.spent))
            if not refinement.order or refinement.incumbent in known or (some and planner.spent > planner.time_budget):
                break
            best = max((_value(*each) for each in known.items()), default=NONE)
            if best >= (True, True, refinement.incumbent.mean):
                break
            some = [one for one in refinement.best(search.workers) if one not in known]
            for one, found in zip(some, planner.outcomes([one.candidate for one in some]), strict=True):
                known[one] = found
    except OutOfTime:
        some = [one for one in refinement.order[: search.workers] if one not in known]
        known |= zip(some, planner.outcomes([one.candidate for one in some]), strict=True)
    finally:
        search.runs += refinement.runs
        chosen = max(known, key=lambda one: _value(one, known[one]), default=None)
        if chosen is not None and (succeeds(known[chosen]) or not succeeds(planner.best)):
            planner.best = known[chosen]


def _value(one: RobustCandidate, found: Verified) -> tuple[bool, bool, float]:
    """Value of a robust candidate as a plan."""
    cost = 0.0 if with_margin(found) else NO_MARGIN_COST
    return succeeds(found), not incomplete(found), one.common_mean - cost
