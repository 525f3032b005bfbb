"""Plan a whip: swings of a map are aimed at the target one after the other, and the best ones are verified."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy.typing as npt

from hyperflex import checks
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput
from hyperflex.interruption import catch_interrupt, interruptible
from hyperflex.model import Arm, Obstacle, Rope, checked_obstacles
from hyperflex.planning.options import MotorLimits
from hyperflex.planning.problem import Problem
from hyperflex.planning.search.contact_phase import check_start
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.tip.planner import TipPlanner
from hyperflex.planning.whip.search import (
    WhipFeasibility,
    WhipMap,
    build_whip_map,
    check_whip_feasibility,
    pivot_distance,
)
from hyperflex.planning.whip.task import WhipTask
from hyperflex.planning.whip.tip_target import TipTarget
from hyperflex.planning.whip.whip_plan import WhipPlan
from hyperflex.progress import progress_bar

MAPPING = 0.4  # fraction of the time for the map
TIME_BUDGET, PERIODS = 30.0, 3.0  # s; swing periods within which the tip strikes by default


@checks.arguments(limits=MotorLimits)
@interruptible(WhipPlan)
def plan_whip(
    rope: Rope,
    arm: Arm,
    point: npt.ArrayLike,
    direction: npt.ArrayLike | None = None,
    limits: MotorLimits | None = None,
    *,
    least_speed: float = 5.0,
    angle_tolerance: float = math.radians(20.0),
    clearance: float = 0.0,
    obstacles: Sequence[Obstacle] = (),
    time_limit: float | None = None,
    time_budget: float = TIME_BUDGET,
    skip_feasibility: bool = False,
    whip_map: WhipMap | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
) -> WhipPlan:
    """Plan how an arm whips its rope so that the tip passes a point at a peak of its speed.

    Parameters
    ----------
    rope, arm, limits, clearance, obstacles, skip_feasibility, seed, threads, progress
        As of :func:`hyperflex.plan_cast`. The rope must not touch obstacles until the tip is there.
    point : (2,) array_like
        Place of the tip at the peak, m.
    direction : (2,) array_like, optional
        Direction of the tip's velocity there: a vector of any length but 0. By default any direction.
    least_speed : float
        Of the tip, m/s.
    angle_tolerance : float
        Greatest angle between the tip's velocity and the direction, rad; not used without a direction.
    time_limit : float, optional
        Time within which the tip must be there, s; by default that of the map if one is given, else three periods of
        the rope's swing.
    time_budget : float
        Time by the clock for map, search and verifications, s, without compiling.
    whip_map : WhipMap, optional
        Of the same rope, arm, limits, time and obstacles, from :func:`build_whip_map`; by default it is built, which
        takes some seconds.

    Returns
    -------
    WhipPlan

    Raises
    ------
    Interrupted
        By Ctrl-C. Its ``partial`` is the best plan until then; what was not verified before is not verified any more.
    InvalidInput
        If an argument is out of range or of another class, or a link's centre of mass is not in its middle: the second
        verification cuts it in two.
    """
    clock = Clock()
    target = TipTarget.at(point, direction, least_speed, angle_tolerance)
    time_budget = checks.number("time_budget", time_budget, sign="positive", unit="s")
    seed = checks.count("seed", seed, least=0)
    if time_limit is not None:
        time_limit = checks.number("time_limit", time_limit, sign="positive", unit="s")
    problem = replace(_problem(rope, arm, limits, time_limit, obstacles, whip_map), clearance=clearance)
    check_start(problem)

    distance = pivot_distance(problem, target)
    known = WhipFeasibility(distance, math.inf, "interrupted before the map of swings was made")
    planner = None
    with catch_interrupt() as stop, progress_bar(0.0, time_budget, progress, "planning") as report:
        if whip_map is None:
            whip_map = build_whip_map(problem, threads=threads, left=lambda: MAPPING * time_budget - clock.spent)
        known = check_whip_feasibility(whip_map, target)
        if math.isfinite(known.cost) and (known.feasible or skip_feasibility):
            left = max(0.0, time_budget - clock.spent)
            task = WhipTask(replace(whip_map, problem=problem), target)
            planner = TipPlanner(task, left, seed, threads)
            planner.run(None if report is None else lambda: report(min(clock.spent, time_budget)))
    found: dict[str, Any] = {"seconds": clock.elapsed, "interrupted": stop.received}
    if planner is None:
        return stop.deliver(WhipPlan(problem, target, known, message=known.message, **found))
    nothing = "interrupted before any whip was found" if stop.received else "no peak of the tip's speed comes near it"
    return stop.deliver(WhipPlan(problem, target, known, **planner.fields(nothing), **found))


def _problem(
    rope: Rope,
    arm: Arm,
    limits: MotorLimits | None,
    time_limit: float | None,
    obstacles: Sequence[Obstacle],
    whip_map: WhipMap | None,
) -> Problem:
    """Return the set-up of the map, if there is one, which must be the one that is asked for."""
    checks.instance("rope", rope, Rope)
    obstacles = checked_obstacles(obstacles, "obstacles")
    if whip_map is None:
        usual = PERIODS * swing_period(rope)
        time = usual if time_limit is None else time_limit
        return Problem(rope, arm, limits or MotorLimits(), time, obstacles=obstacles)
    if limits is not None:
        checks.instance("limits", limits, MotorLimits)
    made = checks.instance("whip_map", whip_map, WhipMap).problem
    same = made.rope == rope and made.arm == arm and made.obstacles == obstacles
    if not same or limits not in (None, made.limits) or time_limit not in (None, made.time):
        raise InvalidInput(
            "map was made for another rope, arm, motor or time, or other obstacles",
            fix="Make one: build_whip_map(Problem(rope, arm, limits, time_limit, obstacles=...))",
        )
    return made
