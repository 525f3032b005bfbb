"""A throw that is known to wind: what tests of tables, report and commands show, without a search."""

from __future__ import annotations

import functools
import time
from dataclasses import replace

import numpy as np

import hyperflex as hf
from hyperflex.planning.feasibility import check_feasibility
from hyperflex.planning.outcome import verify_cast
from hyperflex.planning.problem import Problem
from hyperflex.planning.search.contact_phase import WindingScores, simulate_contact
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.search.strikes import Strikes, simulate_strikes
from hyperflex.planning.throw import Throw
from hyperflex.planning.wind.cast_plan import CastPlan
from hyperflex.planning.wind.planner import failure

PEG = hf.Peg(1.36 * np.sin(-0.66), -1.36 * np.cos(-0.66), 0.04, 0.3)
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
WINDS = Throw(
    side=-1,
    strokes=np.array([3.06615922, 3.14159265, 2.59880107, 3.14159265, 3.14159265, 3.14159265]),
    rests=np.array([0.48174255, 0.5316878, 0.38773031, 0.83420069, 0.57362063, 0.35918262]),
    end=-np.pi / 2,
    rest=0.26252455672143254,
    speed=1.0,
    count=6,
)
SHORT = Throw(-1, np.array([1.0]), np.array([0.1]), -1.0, 0.1, 1.0, 1)  # does not strike anything


def problem() -> Problem:
    return Problem(CABLE, hf.Arm(length=0.105), hf.MotorLimits())


@functools.cache
def planned(winds: bool = True) -> CastPlan:
    """Return a plan that stands, or one whose throw misses."""
    begin = time.monotonic()
    who, throw = problem(), WINDS if winds else SHORT
    cast = verify_cast(who, PEG, throw.motion(who.limits))
    finer = cast if winds else None  # the run with finer links is not what is tested here
    seconds = time.monotonic() - begin
    return CastPlan(who, PEG, check_feasibility(who, PEG), throw, cast, finer, failure(cast, finer, False), 1, seconds)


@functools.cache
def late() -> CastPlan:
    """Return a plan for a target in reach, whose verification took longer than it might."""
    who = problem()
    cast = verify_cast(who, PEG, WINDS.motion(who.limits), time_budget=1e-9)
    return CastPlan(who, PEG, check_feasibility(who, PEG), WINDS, cast, None, failure(cast, None, False), 4321, 61.2)


def stopped(throw: Throw | None = WINDS) -> CastPlan:
    """Return a plan for a target in reach, that Ctrl-C ended before anything was verified."""
    who = problem()
    return CastPlan(
        who, PEG, check_feasibility(who, PEG), throw, None, None, failure(None, None, True), 4321, 12.3, True
    )


def simulated_strikes(problem: Problem, peg: hf.Peg, throws: list[Throw]) -> Strikes:
    return simulate_strikes(problem, peg, [throw.motion(problem.limits) for throw in throws])


def contact_scores(problem: Problem, peg: hf.Peg, throws: list[Throw], state: tuple) -> WindingScores:
    """Return the scores of throws that are simulated in contact from their states (t, q, qd)."""
    t, q, qd = state
    motions = [throw.motion(problem.limits).shifted(-start) for throw, start in zip(throws, t, strict=True)]
    batch = RolloutBatch([problem.rope] * len(throws), [peg] * len(throws), motions, q, qd)
    return simulate_contact(batch, t, replace(problem, clearance=-np.inf))


def unreachable() -> CastPlan:
    return hf.plan_cast(CABLE, hf.Arm(length=0.105), hf.Peg(2.5, 0.0, 0.03))
