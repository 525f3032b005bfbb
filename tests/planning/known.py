"""A throw that is known to wind: what tests of tables, report and commands show, without a search."""

import functools
import time

import numpy as np

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.planning import HoldingForce
from hyperflex.planning.feasibility import check_feasibility
from hyperflex.planning.moves import Moves
from hyperflex.planning.outcome import verify_cast
from hyperflex.planning.plan import CastPlan
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import RolloutBatch, Strikes, fly_to_strikes
from hyperflex.planning.verification import CAST_ACCURACY

PEG = hf.Peg(1.36 * np.sin(-0.66), -1.36 * np.cos(-0.66), 0.04, 0.3)
CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
WINDS = Moves(
    side=-1,
    ends=np.array([1.49536289, -1.64622976, 0.95257131, -2.18902134, 0.95257131, -2.18902134, -np.pi / 2]),
    rests=np.array([0.48174255, 0.5316878, 0.38773031, 0.83420069, 0.57362063, 0.35918262, 0.26252456]),
)
SHORT = Moves(-1, np.array([-0.57, -1.0]), np.array([0.1, 0.1]))  # does not strike anything


def problem() -> Problem:
    return Problem(CABLE, hf.Arm(length=0.105), hf.MotorLimits())


@functools.cache
def planned(winds: bool = True) -> CastPlan:
    """Return a plan that succeeds, or one whose rope misses."""
    begin, who, moves = time.monotonic(), problem(), WINDS if winds else SHORT
    cast = verify_cast(who, PEG, moves.motion(who.limits), accuracy=CAST_ACCURACY)
    finer = cast if winds else None  # the run with finer links is not what is tested here
    seconds = time.monotonic() - begin
    return CastPlan(who, PEG, check_feasibility(who, PEG), moves, cast, finer, cast.message, 1, seconds, margin=0.5)


@functools.cache
def held() -> HoldingForce | None:
    """Return what a tug at the wound rope of the plan that succeeds shows."""
    return planned().measure_holding_force()


@functools.cache
def late() -> CastPlan:
    """Return a plan for a target in reach whose verification took longer than allowed."""
    who = problem()
    cast = verify_cast(who, PEG, WINDS.motion(who.limits), time_budget=1e-9)
    return CastPlan(who, PEG, check_feasibility(who, PEG), WINDS, cast, None, cast.message, 4321, 61.2)


def stopped(moves: Moves | None = WINDS) -> CastPlan:
    """Return a plan for a target in reach that Ctrl-C ended before anything was verified."""
    who, words = problem(), "interrupted before any moves were verified"
    return CastPlan(who, PEG, check_feasibility(who, PEG), moves, None, None, words, 4321, 12.3, True)


def simulated_strikes(problem: Problem, peg: hf.Peg, moves: list[Moves]) -> Strikes:
    """Return the first strikes of moves in free flight."""
    motions, count = [one.motion(problem.limits) for one in moves], len(moves)
    batch = RolloutBatch.from_start(problem, [problem.rope] * count, [peg] * count, motions)
    return fly_to_strikes(problem, peg, batch, Budget(threads=1))


def unreachable() -> CastPlan:
    return hf.plan_cast(CABLE, hf.Arm(length=0.105), hf.Peg(2.5, 0.0, 0.03))
