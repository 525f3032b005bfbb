"""A whip that is known to meet its target, for tests of tables, reports and commands: it needs no search."""

import functools
import math

import numpy as np

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.planning import MotorLimits, Moves, Problem, TipFeasibility, TipTarget, WhipPlan, plan_whip
from hyperflex.planning.tasks.tip import Aim
from hyperflex.planning.tasks.whip import WhipTask, verify_whip

ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=8, radius=0.0025, friction=5e-4, name="short rope")
ARM = hf.Arm(length=0.1)
MOVES = Moves(-1, np.array([1.4, 0.2, -0.9]), np.array([0.05, 0.3, 0.25]))
NEAR = 1.9  # s, when its tip is fast


@functools.cache
def planned_whip(meets: bool = True, any_direction: bool = False) -> WhipPlan:
    """Return a plan that succeeds, or one whose peak is 30 mm away from the target."""
    problem = Problem(ROPE, ARM, MotorLimits(), 4.0)
    peak = verify_whip(problem, TipTarget(0.0, 0.0, 0.0, 1.0), MOVES.motion(problem.limits), NEAR)
    place = peak.place + ([0.0004, 0.0003] if meets else [0.018, 0.024])
    way = {"direction": float(np.arctan2(*peak.velocity[::-1])) + 0.1, "angle_tolerance": 0.3}
    target = TipTarget(*place, least_speed=0.9 * peak.speed, **({} if any_direction else way))
    aim = Aim(MOVES, 1.0, peak.t, residuals=np.zeros(2), place=place, std=0.004)
    found = WhipTask(problem, target).verify(aim, Budget(math.inf))
    known = TipFeasibility(float(np.hypot(*place)), 0.01, "")
    made = problem, target, known, MOVES, found.outcome, found.finer_outcome, found.message, 1, 0.5
    return WhipPlan(*made, position_std=0.004, decided=True)


def far_whip() -> WhipPlan:
    """Return the plan for a target that is out of reach."""
    return plan_whip(ROPE, ARM, TipTarget(2.5, 0.0, 0.0))
