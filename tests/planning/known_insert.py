"""An insertion that is known to succeed, for tests of files, reports and commands: it needs no search."""

import functools
import math

import numpy as np

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.planning import InsertPlan, MotorLimits, Moves, Problem, Slot, SuccessProbability, TipFeasibility
from hyperflex.planning.planner import Candidate
from hyperflex.planning.tasks.insert import InsertTask

ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=16, radius=0.0025, friction=5e-4, name="short rope")
ARM = hf.Arm(length=0.1)
SLOT = Slot(-0.35, -0.85, -2.4, width=0.025, depth=0.04)
MOVES = Moves(-1, np.array([2.45465621, -2.32870724]), np.array([0.33377423, 0.001]))
NEAR = 2.0  # s, when the tip is inside


@functools.cache
def planned_insert(enters: bool = True) -> InsertPlan:
    """Return a plan that succeeds, or one whose rope touches a wall."""
    problem = Problem(ROPE, ARM, MotorLimits(), 4.0)
    slot = SLOT if enters else Slot(-0.355, -0.845, -2.4, width=0.025, depth=0.04)
    found = InsertTask(problem, slot).verify(Candidate(MOVES, 1.0, NEAR), Budget(math.inf))
    known, probability = TipFeasibility(0.98, 0.02, ""), None if found.message else SuccessProbability(45, 50)
    made = problem, slot, known, MOVES, found.outcome, found.finer_outcome, found.message, 1, 0.5
    return InsertPlan(*made, success_probability=probability, position_std=0.004, decided=True)


def far_insert() -> InsertPlan:
    """Return the plan for a slot that is out of reach."""
    return hf.plan_insert(ROPE, ARM, Slot(1.2, 0.0, 0.0))
