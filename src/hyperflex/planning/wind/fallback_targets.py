"""Where a plan fails: the nearest place for which one stands, or for which one is expected to."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

from hyperflex.model import Peg
from hyperflex.planning.cast_plan import CastPlan, come_to
from hyperflex.planning.planner import Course
from hyperflex.planning.search.search import Search
from hyperflex.planning.wind.nearest_target import Nearest, around, nearest, spare
from hyperflex.planning.wind.outcome import WOUND
from hyperflex.planning.wind.reachability import reach

# What places that are planned for, one after another, have to spare, beyond what the target has if it is in reach.
# The last one is no longer planned for.
SPARE = (0.0, 0.25, 0.75, 1.5)
AT_HAND = 0.5  # part of the patience in which throws at hand are tried on pegs near by


def expected(plan: CastPlan, hold: float) -> Nearest | None:
    """Return the nearest place that should be in reach, by the criterion alone.

    Parameters
    ----------
    plan : CastPlan
        That fails.
    hold : float
        Pull that the wound rope should bear, N.

    Returns
    -------
    Nearest or None
        None if there is no such place, and where the target is not to blame (:attr:`CastPlan.unfinished`).
    """
    return None if plan.unfinished else _place(plan, hold)


def _place(plan: CastPlan, hold: float, number: int = 0) -> Nearest | None:
    """Return the nearest place that should be in reach; the higher the number, the more surely.

    `number` is that of what it has to spare, in SPARE; a target in reach for which a search failed begins with the
    second.
    """
    more = SPARE[number]
    if plan.reach.within:
        more = spare(plan.reach, hold) + SPARE[min(number + 1, len(SPARE) - 1)]
    return nearest(plan.thrower, plan.peg, hold=hold, more=more)


def found(plan: CastPlan, search: Search, hold: float, patience: float, again: Callable[[Peg], CastPlan]) -> CastPlan:
    """Plan for the nearest places until one stands; return the plan that failed with what was found.

    Parameters
    ----------
    plan : CastPlan
        That fails.
    search : Search
        That it came from.
    hold : float
        Pull that the wound rope should bear, N.
    patience : float
        Of the search, s.
    again : callable
        Plans for another peg.
    """
    try:
        near = _at_hand(plan, search, patience)
    except KeyboardInterrupt:
        return replace(plan, nearest=expected(plan, hold), interrupted=True)
    if near is not None:
        return replace(plan, nearest=near)
    tried: list[Peg] = []
    for number in range(len(SPARE)):
        near = _place(plan, hold, number)
        if near is None or near.peg in tried:
            continue
        near = replace(near, tried=len(tried))
        if number == len(SPARE) - 1:
            return replace(plan, nearest=near)
        other = again(near.peg)
        if other.success or other.interrupted:
            near = replace(near, plan=other if other.success else None)
            return replace(plan, nearest=near, interrupted=other.interrupted)
        tried.append(near.peg)
    return plan


def _at_hand(plan: CastPlan, search: Search, patience: float) -> Nearest | None:
    """Return the nearest place round which a throw of the search winds and holds when it is verified."""
    until = time.monotonic() + AT_HAND * patience
    for beside in around(search):
        if time.monotonic() > until:
            return None
        if beside.landings and beside.landings[0].turns >= WOUND:
            work = Course(beside, patience)
            work.look()
            other = come_to(work, reach(beside.thrower, beside.peg))
            if other.success:
                return Nearest(beside.peg, math.dist((plan.peg.x, plan.peg.y), (beside.peg.x, beside.peg.y)), other)
    return None
