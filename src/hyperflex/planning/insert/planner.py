"""Plan an insertion: random swings that nearly enter the slot are aimed one by one, and the best are verified."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hyperflex import checks
from hyperflex.control import swing_period
from hyperflex.interruption import catch_interrupt, interruptible
from hyperflex.model import Arm, Obstacle, Rope, checked_obstacles
from hyperflex.planning.insert.chance import SAMPLES, estimate_insert_probability
from hyperflex.planning.insert.insert_plan import InsertPlan
from hyperflex.planning.insert.search import check_insert_feasibility, insert_candidates, missing_length
from hyperflex.planning.insert.slot import Slot
from hyperflex.planning.insert.task import InsertTask
from hyperflex.planning.options import MotorLimits
from hyperflex.planning.problem import Problem
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.search.contact_phase import check_start
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.tip.planner import TipPlanner
from hyperflex.planning.tip.task import TipCandidate
from hyperflex.progress import progress_bar

SWINGING = 0.5  # fraction of the time for random swings
TIME_BUDGET, PERIODS = 30.0, 2.0  # s; swing periods within which the tip enters by default


@checks.arguments(limits=MotorLimits)
@interruptible(InsertPlan)
def plan_insert(
    rope: Rope,
    arm: Arm,
    slot: Slot,
    limits: MotorLimits | None = None,
    *,
    uncertainty: Uncertainty | None = None,
    clearance: float = 0.0,
    obstacles: Sequence[Obstacle] = (),
    time_limit: float | None = None,
    time_budget: float = TIME_BUDGET,
    skip_feasibility: bool = False,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
) -> InsertPlan:
    """Plan how an arm swings its rope so that the tip goes through a slot, to a depth, and the rope touches no wall.

    Parameters
    ----------
    rope, arm, limits, clearance, obstacles, skip_feasibility, seed, threads, progress
        As of :func:`hyperflex.plan_cast`. Obstacles are looked at until 0.15 s after the tip is there.
    slot : Slot
        Its gap must be three diameters of the rope wide or more.
    uncertainty : Uncertainty, optional
        Of the scenarios that tell the success probability: by default the slot is 2 mm off in each coordinate, and each
        stroke starts 2 ms early or late (standard deviations). A rope that touches a wall fails in them, also where
        the slot allows it, and the motor's torque is not looked at.
    time_limit : float, optional
        Time within which the tip must be inside, s; by default two periods of the rope's swing.
    time_budget : float
        Time by the clock for search, verifications and success probability, s, without compiling.
    samples : int
        Scenarios of the success probability; fewer of them, or none, where the time is over before.

    Returns
    -------
    InsertPlan

    Raises
    ------
    Interrupted
        By Ctrl-C. Its ``partial`` is the best plan until then; what was not verified before is not verified any more.
    InvalidInput
        If an argument is out of range or of another class, or the gap too narrow for the rope.
    """
    clock = Clock()
    checks.instance("rope", rope, Rope)
    checks.instance("slot", slot, Slot).check_width(rope)
    if uncertainty is not None:
        checks.instance("uncertainty", uncertainty, Uncertainty)
    time_budget = checks.number("time_budget", time_budget, sign="positive", unit="s")
    seed, samples = checks.count("seed", seed, least=0), checks.count("samples", samples)
    if time_limit is None:
        time_limit = PERIODS * swing_period(rope)
    time_limit = checks.number("time_limit", time_limit, sign="positive", unit="s")
    walls = checked_obstacles(obstacles, "obstacles")
    problem = Problem(rope, arm, limits or MotorLimits(), time_limit, clearance, obstacles=walls)
    check_start(problem)

    known = check_insert_feasibility(problem, slot, None)
    swings: list[TipCandidate] = []
    planner, found = None, dict[str, Any]()
    with catch_interrupt() as stop, progress_bar(0.0, time_budget, progress, "planning") as report:
        if missing_length(problem, slot) <= 0.0:
            swings = insert_candidates(problem, slot, lambda: SWINGING * time_budget - clock.spent, threads)
            known = check_insert_feasibility(problem, slot, swings)
            if not known.feasible and clock.spent > SWINGING * time_budget:
                short = "the time budget ended before swings were made of which one goes through near to it"
                known = replace(known, message=short)
        if swings and (known.feasible or skip_feasibility):
            task = InsertTask(problem, slot, swings)
            planner = TipPlanner(task, max(0.0, time_budget - clock.spent), seed, threads)
            planner.run(None if report is None else lambda: report(min(clock.spent, time_budget)))
            if planner.best is not None and not planner.best.message:
                given: tuple[Any, ...] = (problem, slot, planner.best.aim.strokes, planner.best.aim.t, uncertainty)
                options: dict[str, Any] = {"samples": samples, "seed": seed, "threads": threads}
                found["success_probability"] = estimate_insert_probability(
                    *given, **options, time_budget=time_budget - clock.spent
                )
    found |= {"seconds": clock.elapsed, "interrupted": stop.received}
    if planner is None:
        return stop.deliver(InsertPlan(problem, slot, known, message=known.message, **found))
    nothing = "interrupted before any entry was found" if stop.received else "no swing brings the tip through it"
    return stop.deliver(InsertPlan(problem, slot, known, **planner.fields(nothing), **found))
