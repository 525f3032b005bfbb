"""Plan a cast: check the target, search for a throw that winds and holds, verify it, and look for fallbacks."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.interfaces import RopeState
from hyperflex.interruption import catch_interrupt, interruptible
from hyperflex.model import Arm, Obstacle, Peg, Rope, Setup, checked_obstacles, cuts
from hyperflex.motion import hold_arm
from hyperflex.planning.clearance import obstacle_clearance, rope_clearance
from hyperflex.planning.feasibility import Feasibility, check_feasibility, find_remedies, search_time
from hyperflex.planning.options import MotorLimits
from hyperflex.planning.problem import MIN_TURNS, SETTLING_TIME, Problem
from hyperflex.planning.robust.scenario_rollouts import estimate_success_probability
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.routing import checked_behind, refuse_behind
from hyperflex.planning.search.contact_phase import check_start
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.throw import Throw
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.wind.cast_plan import CastPlan
from hyperflex.planning.wind.fallback_targets import expected_fallback, plan_fallback
from hyperflex.planning.wind.planner import CastPlanner
from hyperflex.planning.wind.robust_phase import ENOUGH, NOMINAL, refine_robustly
from hyperflex.progress import progress_bar
from hyperflex.simulation import simulate

TIME_BUDGET = 60.0  # s
LOOK = 0.01  # s, between two samples of a rope that swings before the motion begins


@checks.arguments(limits=MotorLimits)
@interruptible(CastPlan)
def plan_cast(
    rope: Rope,
    arm: Arm,
    target: Peg,
    limits: MotorLimits | None = None,
    *,
    state0: RopeState | None = None,
    side: int | None = None,
    time_limit: float | None = None,
    holding_force: float = 0.0,
    contact: float | None = None,
    turns: float = MIN_TURNS,
    settle: float = SETTLING_TIME,
    clearance: float = 0.0,
    obstacles: Sequence[Obstacle] = (),
    behind: Sequence[Peg] = (),
    uncertainty: Uncertainty | None = None,
    time_budget: float = TIME_BUDGET,
    skip_feasibility: bool = False,
    fallback: bool = False,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
    on_plan: Callable[[CastPlan], bool | None] | None = None,
    start_from: Sequence[CastPlan] = (),
) -> CastPlan:
    """Plan how an arm casts its rope round a target so that the rope winds and holds.

    Parameters
    ----------
    rope, arm : Rope, Arm
        The rope hangs from the arm, which points to one side, at rest unless `state0` says otherwise.
    target : Peg
        To be wound by `turns` or more.
    limits : MotorLimits, optional
        Of the motor; by default the paper's.
    state0 : RopeState, optional
        Of a rope that swings while the arm stands still, as a tracker tells it: angles, rad, and rates, rad/s, at a
        time `t` <= 0, s, before the motion begins at 0. Until then it must touch nothing. Its covariance is not used.
        By default the rope hangs at rest.
    side : {-1, 1}, optional
        Side on which the arm stands, left or right; needed with `state0`. By default the planner chooses.
    time_limit : float, optional
        Time within which the rope must strike, s; by default five periods of its swing, and up to eleven where a
        target is so high that strokes must swing the rope up for longer.
    holding_force : float
        Pull that the wound rope must withstand, N: by a rule in the feasibility check, and by a simulated tug when a
        throw is verified. The success probability does not include it.
    contact : float, optional
        Least angle of the target that the rope must cover, rad. By default none is asked for, but where the rope is
        long enough a full turn is sought until 1.25 times the time in which the first plan stood; with 0 it is not.
    turns : float
        Least turns of the rope about the target, from the arm's tip to its end, as of :class:`Problem`.
    settle : float
        Time from the arm's stop, s, after which the rope is watched for 2 s, in which it must stay wound and hold.
    clearance : float
        Least distance of the rope from its own arm, the motor's shaft and obstacles, m, as of :class:`Problem`.
    obstacles : sequence of Peg, Wall, Ground
        That the rope must not touch on its way to the target and while it is watched: a wall, the floor, a person.
    behind : sequence of Peg
        That the rope is to run behind on its way from the arm to the target: in the end it touches each of them between
        the arm and its first touch of the target. It may touch them before. Neither with an uncertainty nor with a
        holding force.
    uncertainty : Uncertainty, optional
        Of rope, target and motor. With it the plan is the throw that succeeds in most of the sampled scenarios, and its
        success probability is estimated from others, as many as there is time for.
    time_budget : float
        Time by the clock for search, verifications and success probability, s, without compiling; on a busy machine,
        too. A plan that succeeds with a margin ends the search before: it makes 0.1 turns more than are asked, slips by
        at most 0.4 of what is allowed, is pulled with no more than the capstan equation allows, its end hangs from the
        peg, or may fall from its top and lose a turn, it was not folded flat on the way, and winds alike with shorter
        links. One without ends it at 1.25 times the time in which the first plan stood. With an uncertainty, one with a
        margin that succeeds in all sampled scenarios does.
    skip_feasibility : bool
        Search even for a target that the feasibility check calls out of reach.
    fallback : bool
        If the plan fails, plan for the nearest targets until a plan succeeds: with the throws found so far (not with an
        uncertainty), then three times at most, each with the same time budget. Without, the fallback is only expected
        to be feasible.
    seed : int
        Of the search, its random numbers. What is searched in a time depends on machine, load and threads, so the same
        seed may give another plan: keep the plan, not the seed.
    threads : int, optional
        One a processor by default.
    progress : bool
        Show a progress bar.
    on_plan : callable, optional
        Called with the first plan that succeeds as soon as it does, and with each better one. If it returns True the
        search ends with that plan. Plans for fallback targets are not told, nor success probabilities.
    start_from : sequence of CastPlan
        Plans for targets near by, for the same rope and arm, whose throws are tried first.

    Returns
    -------
    CastPlan

    Raises
    ------
    InvalidInput
        If an argument is out of range or of another class.
    Interrupted
        By Ctrl-C. Its ``partial`` is the best plan until then; what was not verified before is not verified any more.
        None while the target is checked, before the search.

    Examples
    --------
    The first throw that succeeds, in a second or two; without `on_plan` better ones are looked for:

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
    if not isinstance(target, Peg):
        raise InvalidInput("target is not a peg", got=target, allowed="hyperflex.Peg(x, y, radius, mu)")
    if target.turns:
        raise InvalidInput("casts are planned for fixed targets", got=target, fix="Leave out inertia and bearing")
    clock = Clock()
    time_budget = checks.number("time_budget", time_budget, sign="positive", unit="s")
    fallback, skip_feasibility = checks.flag("fallback", fallback), checks.flag("skip_feasibility", skip_feasibility)
    time = 0.0 if time_limit is None else checks.number("time_limit", time_limit, sign="positive", unit="s")
    motor = MotorLimits() if limits is None else limits
    obstacles, behind = checked_obstacles(obstacles, "obstacles"), checked_behind(behind)
    asked: dict[str, Any] = {"clearance": clearance, "turns": turns, "settle": settle}
    asked |= {"obstacles": obstacles, "behind": behind}
    problem = Problem(rope, arm, motor, time, contact=contact or 0.0, side=side or 0, **asked)
    if uncertainty is not None:
        refuse_behind(problem.behind, "a plan with an uncertainty")
    problem, touch = (problem, "") if state0 is None else _swinging(problem, state0, target)
    # Refuses, before any search, what cannot touch a peg
    Setup(problem.rope, arm=problem.arm, pegs=problem.beside(target))
    cuts(problem.rope, (target, *behind), arm=problem.arm)  # or not be wound round it
    if rope.gravity[0] != 0.0 or rope.gravity[1] > 0.0:
        raise InvalidInput("casts are planned with gravity along -y", got=rope.gravity, fix="Turn the axes: y up")
    check_start(problem)
    if time_limit is None:
        problem = replace(problem, time=search_time(problem, target))
    known = check_feasibility(problem, target, holding_force=holding_force)
    search = ThrowSearch(problem, target, checks.count("seed", seed, least=0), threads, holding_force)
    if touch or not search.parametrizations:
        inside = "the rope begins in the target, or beside it in an obstacle"
        known = replace(known, impossible=True, message=touch or inside)
    if known.impossible or not (known.feasible or skip_feasibility):
        plan = CastPlan(problem, target, known, message=known.message)
    else:
        free = {"full_turn": contact is None, "clock": clock}
        throws = [one.throw for one in start_from if one.throw is not None]
        plan = _search(search, known, throws, uncertainty, time_budget, progress, on_plan, **free)
    with catch_interrupt() as stop:
        if not (plan.success or plan.interrupted):
            plan = replace(plan, remedies=find_remedies(problem, target, holding_force=holding_force))
            plan = replace(plan, fallback=expected_fallback(plan, holding_force))
            if fallback:
                given: dict[str, Any] = {
                    "state0": state0,
                    "side": side,
                    "limits": limits,
                    "time_limit": time_limit,
                    "holding_force": holding_force,
                }
                given |= asked | {"contact": contact, "uncertainty": uncertainty}
                given |= {"time_budget": time_budget, "seed": seed, "threads": threads}
                plan_for = partial(plan_cast, rope, arm, **given, progress=progress)
                plan = plan_fallback(plan, search, time_budget, plan_for, at_hand=uncertainty is None)
    plan = stop.partial if isinstance(stop.partial, CastPlan) else plan
    if plan.interrupted or stop.received:
        raise Interrupted(replace(plan, interrupted=True))
    return plan


def _search(
    search: ThrowSearch,
    known: Feasibility,
    throws: Sequence[Throw],
    uncertainty: Uncertainty | None,
    time_budget: float,
    progress: bool,
    on_plan: Callable[[CastPlan], bool | None] | None,
    **free: Any,
) -> CastPlan:
    """Search for a throw, first among given `throws`, verify it, and estimate its success probability.

    `free` are as of :class:`CastPlanner`.
    """
    nominal = time_budget if uncertainty is None else NOMINAL * time_budget
    enough = None if uncertainty is None else ENOUGH * time_budget
    planner = CastPlanner(search, nominal, enough=enough, **free)
    probability = None
    if on_plan is not None:
        planner.hear = lambda: on_plan(planner.plan(known))
    with catch_interrupt() as stop, progress_bar(0.0, time_budget, progress, "planning") as report:
        search.try_throws(throws)
        planner.run(report)
        if uncertainty is not None:
            refine_robustly(planner, uncertainty, report)
            if (throw := planner.best[0]) is not None:
                given = (search.problem, search.peg, throw, uncertainty)
                seed, threads, left = search.seed, search.threads, time_budget - planner.spent
                probability = estimate_success_probability(*given, seed=seed, threads=threads, time_budget=left)
    return replace(planner.plan(known, stop.received), success_probability=probability)


def _swinging(problem: Problem, state: RopeState, target: Peg) -> tuple[Problem, str]:
    """Return the set-up whose rope begins in a state, or in what becomes of that until t = 0 while the arm stands.

    And what the rope touches until then, in words; empty if nothing.
    """
    if not isinstance(state, RopeState):
        raise InvalidInput("state0 is no rope state", got=state, allowed="hyperflex.RopeState(t, q, qd)")
    t = checks.number("state0.t", state.t, unit="s")
    if t > 0.0:
        raise InvalidInput("state0 is after the motion's begin", got=t, allowed="t <= 0 s", fix="Count t from there")
    begins = replace(problem, q0=tuple(state.q), qd0=tuple(state.qd))
    if t == 0.0:
        return begins, ""
    held = hold_arm(problem.limits.start_angle(problem.side))
    looks = np.linspace(0.0, -t, math.ceil(-t / LOOK) + 1)
    run = simulate(problem.rope, held, arm=problem.arm, duration=-t, q0=state.q, qd0=state.qd, t_eval=looks)
    near = [obstacle_clearance(run, problem.beside(target))]
    near += [] if problem.clearance == -math.inf else [rope_clearance(run)]
    least = min(near)
    touch = f"the rope touches {least.what} {-t - least.t:.2f} s before the motion begins" if least.value < 0.0 else ""
    return replace(begins, q0=tuple(run.q[-1]), qd0=tuple(run.qd[-1])), touch
