"""Plan casts: check the target, search for moves that wind the rope and hold, verify them, look for fallbacks."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, overload

import numpy as np

from hyperflex import checks, winding
from hyperflex.budget import Budget
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.executor import checked_chunks, refuse_lost, run_chunks
from hyperflex.interfaces import RopeState
from hyperflex.interruption import Stop, interruptible, stoppable
from hyperflex.model import Arm, MotorLimits, Peg, Rope, Setup, cuts
from hyperflex.motion import hold_arm
from hyperflex.planning.clearance import obstacle_clearance, rope_clearance
from hyperflex.planning.ensemble import estimate_success_probability
from hyperflex.planning.feasibility import (
    Feasibility,
    check_feasibility,
    find_remedies,
    longest_time,
    nearest_feasible,
    search_time,
)
from hyperflex.planning.moves import Moves
from hyperflex.planning.options import LEAST_TURNS, Conditions, SearchOptions, WindCriteria, refuse_behind
from hyperflex.planning.outcome import evaluate_cast
from hyperflex.planning.plan import CastPlan, FallbackTarget
from hyperflex.planning.planner import Planner
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import check_start
from hyperflex.planning.tasks.wind import WindTask
from hyperflex.planning.uncertainty import Uncertainty
from hyperflex.progress import progress_bar
from hyperflex.simulation import simulate

OnPlan = Callable[[CastPlan], bool | None]
# Margins of fallback targets that are planned for, one after the other, beyond the margin of the target if that is
# feasible. The last one is not planned for
MARGINS = (0.0, 0.25, 0.75, 1.5)
TURNS_STEPS = 20.0  # a turn, in which fewer turns are proposed
NEAR = 0.2  # rope lengths, within which a plan for one target helps to find one for another
ROBUST = 0.9  # fraction of the time of a robust plan after which its success probability is estimated


@dataclass(frozen=True, eq=False)
class CastRequest:
    """All that a cast is planned for but the target; see :func:`plan_cast`."""

    rope: Rope
    arm: Arm
    limits: MotorLimits
    criteria: WindCriteria
    conditions: Conditions
    uncertainty: Uncertainty | None
    time_budget: float | Budget | None
    options: SearchOptions
    on_plan: OnPlan | None = None

    def problem(self) -> Problem:
        """Return the problem without a target."""
        given = self.conditions
        return Problem(
            self.rope,
            self.arm,
            self.limits,
            given.time_limit or 0.0,
            clearance=given.clearance,
            criteria=self.criteria,
            side=given.side,
            obstacles=given.obstacles,
        )

    def checked_problem(self, target: Peg) -> tuple[Problem, str]:
        """Return the problem, and what a rope that swings at first touches before the motion, empty if nothing."""
        problem, touch = self.problem(), ""
        if self.uncertainty is not None:
            refuse_behind(self.criteria.behind, "a plan with an uncertainty")
        if self.conditions.state0 is not None:
            problem, touch = _swinging(problem, self.conditions, target)
        # Refuses, before any search, what cannot touch a peg
        Setup(self.rope, arm=self.arm, pegs=problem.beside(target))
        cuts(self.rope, (target, *self.criteria.behind), arm=self.arm)  # or not be wound round it
        check_start(problem)
        limited = self.conditions.time_limit is not None
        return (problem if limited else replace(problem, time=search_time(problem, target))), touch

    @checks.derived()
    @interruptible(CastPlan)
    def plan(self, target: Peg, near: Sequence[CastPlan] = ()) -> CastPlan:
        """Plan a cast round a target; the moves of plans `near` are tried first."""
        if not isinstance(target, Peg):
            raise InvalidInput(
                "target is not a peg", got=target, allowed="hyperflex.Peg(x, y, radius), or a list of them"
            )
        if target.turns:
            raise InvalidInput("casts are planned for fixed targets", got=target, fix="Omit inertia and bearing")
        own = self.share(len(MARGINS) if self.options.fallback else 1)
        budget = Budget.of(own.time_budget, threads=self.options.threads)
        problem, touch = self.checked_problem(target)
        known = check_feasibility(problem, target)
        start = [one.moves for one in (*near, *self.options.start_from) if one.moves is not None]
        longest = problem.time if self.conditions.time_limit is not None else longest_time(problem)
        task = WindTask(problem, target, self.options, self.uncertainty, start, longest=longest)
        if touch or not task.sides:
            inside = "the rope begins in the target, or in an obstacle next to it"
            known = replace(known, impossible=True, message=touch or inside)
        if known.impossible or not (known.feasible or self.options.skip_feasibility):
            plan = CastPlan(problem, target, known, message=known.message)
        else:
            plan = self._search(task, known, budget)
        if plan.success or plan.interrupted:
            return _delivered(plan)
        with stoppable() as stop:
            plan = replace(plan, remedies=find_remedies(problem, target) or fewer_turns(plan))
            plan = replace(plan, fallback=None if plan.unfinished else _expected(plan))
            if self.options.fallback:
                plan = self._plan_fallback(plan)
        plan = stop.partial if isinstance(stop.partial, CastPlan) else plan
        return _delivered(replace(plan, interrupted=stop.received or plan.interrupted))

    def share(self, parts: int) -> "CastRequest":
        """Return the request with one of so many equal parts of a given budget; seconds are those of each target."""
        given = self.time_budget
        return replace(self, time_budget=given.share(1.0 / parts)) if isinstance(given, Budget) else self

    def plan_chunk(self, chunk: "Sequence[_Work]") -> list[CastPlan]:
        """Plan for some targets; for an executor."""
        return [self.share(each.left).plan(each.target, each.near) for each in chunk]

    def _search(self, task: WindTask, known: Feasibility, budget: Budget) -> CastPlan:
        """Search for moves, verify them, and estimate their success probability."""
        robust = self.uncertainty is not None
        search = budget.share(ROBUST) if robust and math.isfinite(budget.remaining) else budget

        def found(interrupted: bool = False) -> CastPlan:
            return _plan(task, known, planner, budget, interrupted)

        improve = math.inf if robust else self.options.improve
        planner = Planner(task, search, improve, lambda: bool(self.on_plan and self.on_plan(found())))
        with stoppable() as stop, budget.progress(self.options.progress, "planning"):
            planner.run()
            plan = found()
            if self.uncertainty is not None and plan.moves is not None:
                given = task.problem, task.peg, plan.moves, self.uncertainty
                aside = math.nan if plan.seen is None else plan.seen.aside
                chance = estimate_success_probability(*given, aside=aside, time_budget=budget, options=self.options)
                plan = replace(plan, success_probability=chance)
        return found(interrupted=True) if stop.received else plan

    def _plan_fallback(self, plan: CastPlan) -> CastPlan:
        """Plan for the nearest targets until a plan succeeds, first with the moves found; return the failed plan.

        Ctrl-C raises Interrupted with it, and with the plan for the nearest target if that succeeds as far as it got.
        """
        alone = replace(self, options=replace(self.options, fallback=False), on_plan=None)
        tried: list[Peg] = []
        for number in range(len(MARGINS)):
            found = _expected(plan, number)
            if found is None or found.target in tried:
                continue
            found, near = replace(found, failed_plans=len(tried)), None
            plan = replace(plan, fallback=found)
            if number == len(MARGINS) - 1:
                return plan
            with stoppable() as stop:
                near = alone.share(len(MARGINS) - 1 - number).plan(found.target, [plan])
            near = stop.partial if isinstance(stop.partial, CastPlan) else near
            succeeds = near is not None and near.success
            if succeeds:
                plan = replace(plan, fallback=replace(found, plan=near))
            if stop.received or succeeds:
                return stop.deliver(plan)
            tried.append(found.target)
        return replace(plan, fallback=None)


class _Work(NamedTuple):
    """One of many targets: its number, how many are left to be planned, and plans for targets near by."""

    number: int
    left: int
    target: Peg
    near: list[CastPlan]


@overload
def plan_cast(
    rope: Rope,
    arm: Arm,
    target: Peg,
    limits: MotorLimits | None = None,
    *,
    criteria: WindCriteria | None = None,
    conditions: Conditions | None = None,
    uncertainty: Uncertainty | None = None,
    time_budget: float | Budget | None = ...,
    options: SearchOptions | None = None,
    on_plan: OnPlan | None = None,
) -> CastPlan: ...


@overload
def plan_cast(
    rope: Rope,
    arm: Arm,
    target: Sequence[Peg],
    limits: MotorLimits | None = None,
    *,
    criteria: WindCriteria | None = None,
    conditions: Conditions | None = None,
    uncertainty: Uncertainty | None = None,
    time_budget: float | Budget | None = ...,
    options: SearchOptions | None = None,
    on_plan: OnPlan | None = None,
) -> list[CastPlan]: ...


@checks.arguments(
    limits=MotorLimits,
    criteria=WindCriteria,
    conditions=Conditions,
    uncertainty=Uncertainty,
    options=SearchOptions,
)
def plan_cast(
    rope: Rope,
    arm: Arm,
    target: Peg | Sequence[Peg],
    limits: MotorLimits | None = None,
    *,
    criteria: WindCriteria | None = None,
    conditions: Conditions | None = None,
    uncertainty: Uncertainty | None = None,
    time_budget: float | Budget | None = 60.0,
    options: SearchOptions | None = None,
    on_plan: OnPlan | None = None,
) -> CastPlan | list[CastPlan]:
    """Plan how an arm casts its rope round a target so that the rope winds and holds.

    Parameters
    ----------
    rope, arm : Rope, Arm
        The rope hangs from the arm, which points to one side, at rest unless the conditions have a `state0`.
    target : Peg or sequence of Peg
        Target of the rope. In a sequence, targets far from each other are planned first, then the others, starting from
        the moves for the nearest of these; `options.executor` plans them in parallel.
    limits : MotorLimits, optional
        Limits of the motor; by default the paper's.
    criteria : WindCriteria, optional
        Criteria of a wound rope.
    conditions : Conditions, optional
        Time limit, clearance, obstacles and start.
    uncertainty : Uncertainty, optional
        Uncertainty of rope, target and motor. With it the plan is the one that succeeds in the largest number of
        sampled scenarios; its success probability is estimated from other scenarios, as many as the time allows.
    time_budget : float or Budget, optional
        Wall-clock time for search, verifications and success probability of a target, s, without compiling. The search
        ends earlier when a plan succeeds with a margin (:func:`hyperflex.planning.ensemble.margin`; with an uncertainty
        also in all scenarios), and a quarter more time after one without. Targets, and fallback targets, get equal
        shares of a Budget.
    options : SearchOptions, optional
        Seed, threads, fallback and other options of the search.
    on_plan : callable, optional
        Called with the first plan that succeeds as soon as it does, and with each better one. If it returns True the
        search ends with that plan. It does not get plans for fallback targets, nor success probabilities.

    Returns
    -------
    CastPlan, or a list of them for a sequence of targets

    Raises
    ------
    InvalidInput
        If an argument is out of range or of another class.
    WorkerLost
        If targets kill the workers of the executor.
    Interrupted
        By Ctrl-C. Its ``partial`` is the best plan so far, or the list of plans so far; unverified candidates remain
        unverified.

    Examples
    --------
    The first plan that succeeds, in a second or two; without `on_plan` better ones are searched for:

    >>> import hyperflex as hf
    >>> cord = hf.Rope.uniform(length=1.2, mass=0.05, n_links=15, radius=0.002, friction=2e-4)
    >>> plan = hf.plan_cast(cord, hf.Arm(length=0.15), hf.Peg(-0.5, -0.7, 0.03), on_plan=lambda plan: True)
    >>> plan.success, plan.outcome.wound, plan.outcome.held
    (True, True, True)

    A target out of reach:

    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> far = hf.plan_cast(cable, hf.Arm(length=0.105), hf.Peg(2.5, 0.0, 0.03))
    >>> far.success, far.message
    (False, 'out of reach: the rope ends 0.36 m short of the target')
    >>> near = far.fallback  # expected to be feasible: nothing was planned for it
    >>> round(near.target.x, 1), round(near.distance, 1), near.plan
    (1.6, 0.9, None)
    >>> far.remedies
    ('a rope of 2.94 m',)
    """
    Budget.of(time_budget)
    chosen = criteria or WindCriteria(), conditions or Conditions(), uncertainty, time_budget
    request = CastRequest(rope, arm, limits or MotorLimits(), *chosen, options or SearchOptions(), on_plan)
    if isinstance(target, Sequence) and all(isinstance(each, Peg) for each in target):
        return _plan_list(request, list(target))
    return request.plan(target)  # type: ignore[arg-type] # refuses what is not a peg


@interruptible(list)
def _plan_list(request: CastRequest, targets: Sequence[Peg]) -> list[CastPlan]:
    plans, stop = plan_each(request, targets)
    return stop.deliver([plans[number] for number in sorted(plans)])


@interruptible(CastPlan)
def replan_cast(
    plan: CastPlan,
    start: Sequence[Moves],
    seen: Sequence[tuple[Moves, RopeState]],
    *,
    anew: bool = True,
    time_budget: float | Budget | None = 60.0,
    options: SearchOptions | None = None,
) -> CastPlan:
    """Plan a cast anew that goes on from what was measured of one: its first moves are made again.

    Parameters
    ----------
    plan : CastPlan
        Of the problem, with the rope as it is known now, and the target.
    start : sequence of Moves
        Moves to begin with.
    seen : sequence of (Moves, RopeState)
        The last of the moves that were made, one more each time, and the rope's state when the arm stopped after them.
    anew : bool
        Whether to plan from the start as well, if some were seen.
    time_budget, options
        As of :func:`plan_cast`.

    Returns
    -------
    CastPlan
        With whole moves from rest; times of its outcomes count from the last measured state that it goes on from.
    """
    chosen = options or SearchOptions()
    budget = Budget.of(time_budget, threads=chosen.threads)
    task = WindTask(plan.problem, plan.target, chosen, None, start, seen, anew)
    planner = Planner(task, budget, chosen.improve)
    with stoppable() as stop:
        planner.run()
    return stop.deliver(_plan(task, plan.feasibility, planner, budget, bool(stop.received)))


def plan_each(request: CastRequest, targets: Sequence[Peg]) -> tuple[dict[int, CastPlan], Stop]:
    """Plan casts for many targets; return plans by the targets' numbers, and the interrupt."""
    executor, size = checked_chunks(request.options.executor, request.options.chunk_size, 1)
    alone = list[int]()
    for k, each in enumerate(targets):
        if all(_distance(each, targets[other]) > NEAR * request.rope.total_length for other in alone):
            alone.append(k)
    work = replace(request, options=replace(request.options, executor=None, progress=False)).plan_chunk
    plans, todo = dict[int, CastPlan](), list[_Work]()
    progress = request.options.progress
    with stoppable() as stop, progress_bar(0, len(targets), progress, "planning", "targets") as report:

        def done(low: int, found: list[CastPlan]) -> None:
            plans.update(zip((each.number for each in todo[low:]), found, strict=False))
            if report is not None:
                report(len(plans))

        for chosen in (alone, [number for number in range(len(targets)) if number not in alone]):
            known = [plans[number] for number in alone if number in plans and plans[number].success]
            left = range(len(targets) - len(plans), 0, -1)
            near = [_nearest(targets[k], known, request.rope) for k in chosen]
            todo = [_Work(k, rest, targets[k], some) for k, rest, some in zip(chosen, left, near, strict=False)]
            refuse_lost(run_chunks(work, todo, executor, size if executor else 1, done), "targets")
    if isinstance(stop.partial, CastPlan):  # of the one that was planned in this process
        own = [each.number for each in todo if each.number not in plans and each.target == stop.partial.target]
        if own:
            plans[own[0]] = stop.partial
    return plans, stop


def _plan(task: WindTask, known: Feasibility, planner: Planner, budget: Budget, interrupted: bool) -> CastPlan:
    """Return the plan so far; if nothing was verified, with the best rollout."""
    moves, outcome, finer, margin = None, None, None, 0.0
    ended = "interrupted" if interrupted else "the time budget was over"
    missing = interrupted or not task.runs
    message = f"{ended} before a plan was found" if missing else "no moves were found that strike it"
    if (best := planner.best) is not None:
        moves, message, outcome, finer = best.candidate.moves, best.message, best.outcome, best.finer_outcome
        margin = 0.0 if message else best.margin
    elif planner.rolled:
        moves, good = planner.rolled[0].moves, planner.rolled[0].good
        message = f"{ended} before the best moves were verified" if good else _unwound(task)
    if message and task.peg.mu == 0.0:
        message += "; few ropes stay wound without friction (mu 0)"
    found = moves, outcome, finer, message, task.runs, budget.elapsed, interrupted
    return CastPlan(task.problem, task.peg, known, *found, margin=margin)


def _unwound(task: WindTask) -> str:
    """Why no rollout is worth a verification."""
    criteria, most = task.problem.criteria, task.most_turns
    return (
        f"the best moves do not wind the rope: it makes {most:.2f} turns at most, {criteria.turns:g} required",
        f"the best moves wind the rope {most:.2f} turns, but it comes off again, or touches its arm or an obstacle",
        "the best moves wind the rope, but it comes too near its arm, the shaft or an obstacle, or not behind its pegs",
        f"the best moves wind the rope, but with shorter links it comes off or slips by {1e3 * criteria.max_slip:g} mm",
    )[task.furthest]


def fewer_turns(plan: CastPlan) -> tuple[str, ...]:
    """Return the turns that the verified runs of a plan keep, as a remedy, if it then fails for nothing else.

    If the other run did not end, the remedy says so.
    """
    runs = [each.run for each in plan.outcomes if each.run is not None]
    if not runs or plan.motion is None:
        return ()
    criteria, end = plan.problem.criteria, plan.motion.end
    kept = min(np.abs(winding.turns(run, plan.target)[run.t >= end + criteria.settle]).min() for run in runs)
    turns = math.floor(TURNS_STEPS * kept) / TURNS_STEPS
    if not LEAST_TURNS < turns < criteria.turns:
        return ()
    easier = replace(plan.problem, criteria=replace(criteria, turns=turns))
    succeeds = all(evaluate_cast(easier, plan.target, run, end).success for run in runs)
    alone = "" if len(runs) > 1 else " (in one run of two; the other was not simulated to its end)"
    return (f"{turns:.3g} turns required{alone}",) if succeeds else ()


def _delivered(plan: CastPlan) -> CastPlan:
    if plan.interrupted:
        raise Interrupted(plan)
    return plan


def _expected(plan: CastPlan, number: int = 0) -> FallbackTarget | None:
    """Return the nearest target with margin number `number`; a feasible target begins with the second."""
    margin = MARGINS[number]
    if plan.feasibility.feasible:
        own = plan.feasibility.margin(plan.problem.criteria.holding_force)
        margin = own + MARGINS[min(number + 1, len(MARGINS) - 1)]
    peg = nearest_feasible(plan.problem, plan.target, margin=margin)
    return None if peg is None else FallbackTarget(peg, _distance(plan.target, peg))


def _nearest(target: Peg, plans: list[CastPlan], rope: Rope) -> list[CastPlan]:
    """Return up to three plans whose targets lie near by, the nearest first."""
    near = [plan for plan in plans if _distance(target, plan.target) <= NEAR * rope.total_length]
    return sorted(near, key=lambda plan: _distance(target, plan.target))[:3]


def _distance(one: Peg, other: Peg) -> float:
    return math.dist(one.point, other.point)


def _swinging(problem: Problem, conditions: Conditions, target: Peg) -> tuple[Problem, str]:
    """Return the problem whose rope begins in the state that it has at t = 0, while the arm stands still until then.

    And what the rope touches until then, as text; empty if nothing.
    """
    state = conditions.state0
    if state is None:
        return problem, ""
    begins = replace(problem, q0=tuple(state.q), qd0=tuple(state.qd))
    if state.t == 0.0:
        return begins, ""
    held, span = hold_arm(problem.limits.start_angle(problem.side)), -state.t
    polls = np.linspace(0.0, span, math.ceil(100.0 * span) + 1)
    run = simulate(problem.rope, held, arm=problem.arm, duration=span, q0=state.q, qd0=state.qd, t_eval=polls)
    least = obstacle_clearance(run, problem.beside(target))
    if problem.clearance > -math.inf:
        least = min(least, rope_clearance(run))
    touch = f"the rope touches {least.what} {span - least.t:.2f} s before the motion begins"
    return replace(begins, q0=tuple(run.q[-1]), qd0=tuple(run.qd[-1])), touch if least.value < 0.0 else ""
