"""Fallback targets for a plan that fails: the nearest one with a plan that succeeds, or expected to be feasible."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hyperflex.interruption import catch_interrupt
from hyperflex.model import Peg
from hyperflex.planning.feasibility import check_feasibility, moved, nearest_feasible
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.wind.cast_plan import CastPlan, FallbackTarget
from hyperflex.planning.wind.planner import CastPlanner

# Margins of the targets that are planned for, one after another, beyond the margin of the one asked for if it is
# feasible. The last one is not planned for.
MARGINS = (0.0, 0.25, 0.75, 1.5)
EXISTING = 0.5  # fraction of the time budget for trying existing throws on targets near by
RADII = (0.01, 0.02, 0.035, 0.05, 0.075, 0.1)  # of the rings of targets near by, in rope lengths
PER_RING, THROWS = 8, 6  # targets of a ring, and throws tried on each


def expected_fallback(plan: CastPlan, holding_force: float) -> FallbackTarget | None:
    """Return the nearest target expected to be feasible for a failed plan, by the feasibility check alone.

    `holding_force` is the pull that the wound rope must withstand, N. None if there is no such target, or if the plan
    is unfinished (:attr:`CastPlan.unfinished`).
    """
    return None if plan.unfinished else _expected(plan, holding_force)


def _expected(plan: CastPlan, holding_force: float, number: int = 0) -> FallbackTarget | None:
    """Return the nearest target with margin number `number`; a feasible target begins with the second."""
    margin = MARGINS[number]
    if plan.feasibility.feasible:
        margin = plan.feasibility.margin(holding_force) + MARGINS[min(number + 1, len(MARGINS) - 1)]
    peg = nearest_feasible(plan.problem, plan.target, holding_force=holding_force, margin=margin)
    return None if peg is None else FallbackTarget(peg, math.dist((plan.target.x, plan.target.y), (peg.x, peg.y)))


def plan_fallback(
    plan: CastPlan,
    search: ThrowSearch,
    time_budget: float,
    plan_for: Callable[[Peg], CastPlan],
    *,
    at_hand: bool = True,
) -> CastPlan:
    """Plan for the nearest targets until a plan succeeds; return the failed plan with its fallback.

    Ctrl-C raises Interrupted with it, and with the plan for the nearest target where that succeeds as far as it got.
    `search` is the one that the plan came from, `time_budget` its time, s, and `plan_for` plans for another peg.
    `at_hand`: whether throws of the search are tried on targets near by at first. They are looked at in the expected
    scenario alone, so plans for an uncertainty do without.
    """
    force = search.holding_force
    near = _with_existing_throws(plan, search, time_budget) if at_hand else None
    if near is not None:
        return replace(plan, fallback=near)
    tried: list[Peg] = []
    for number in range(len(MARGINS)):
        near = _expected(plan, force, number)
        if near is None or near.target in tried:
            continue
        near = replace(near, failed_plans=len(tried))
        if number == len(MARGINS) - 1:
            return replace(plan, fallback=near)
        with catch_interrupt() as stop:
            other: CastPlan | None = plan_for(near.target)
        if stop.received:
            other = stop.partial
        if other is not None and other.success:
            plan = replace(plan, fallback=replace(near, plan=other))
        if stop.received or (other is not None and other.success):
            return stop.deliver(plan)
        tried.append(near.target)
    return plan


def _with_existing_throws(plan: CastPlan, search: ThrowSearch, time_budget: float) -> FallbackTarget | None:
    """Return the nearest target round which a throw of the search winds and holds when it is verified.

    None is tried after EXISTING of the `time_budget`, s, and no verification goes on after its end.
    """
    clock = Clock()

    def left() -> float:
        return EXISTING * time_budget - clock.spent

    for beside in searches_near_by(search, left):
        if left() < 0.0:
            return None
        if beside.candidates and beside.candidates[0].turns >= beside.problem.turns:
            planner, peg = CastPlanner(beside, time_budget, clock=clock), beside.peg
            planner.verify_new()
            planner.verify_best()
            other = planner.plan(check_feasibility(beside.problem, peg))
            if other.success:
                distance = math.dist((plan.target.x, plan.target.y), (peg.x, peg.y))
                return FallbackTarget(peg, distance, other)
    return None


def searches_near_by(search: ThrowSearch, left: Callable[[], float] | None = None) -> Iterator[ThrowSearch]:
    """Try the best throws of a search on pegs about its own, nearest first, in the time that is `left`, s.

    Yields a search for each peg, with the throws that strike it as candidates.
    """
    best, problem = search.candidates[:THROWS], search.problem
    for radius in RADII:
        for angle in 2.0 * np.pi * np.arange(PER_RING) / PER_RING:
            way = radius * problem.rope.total_length * np.array([np.cos(angle), np.sin(angle)])
            peg = moved(search.peg, np.array([search.peg.x, search.peg.y]) + way)
            if check_feasibility(problem, peg).impossible:
                continue
            beside = ThrowSearch(problem, peg, search.seed, search.threads, search.holding_force)
            beside.left = left
            if points := [(one.side, one.x) for one in best if one.side in beside.parametrizations]:
                beside.evaluate(points)
            yield beside
