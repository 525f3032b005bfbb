"""An insertion that is known to succeed: what tests of files, report and commands show, without a search."""

from __future__ import annotations

import functools

import numpy as np

import hyperflex as hf
from hyperflex.planning import InsertFeasibility, InsertPlan, MotorLimits, Problem, Slot, Strokes, SuccessProbability
from hyperflex.planning.insert.outcome import verify_insert
from hyperflex.planning.insert.task import InsertTask, failure

ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=16, radius=0.0025, friction=5e-4, name="short rope")
ARM = hf.Arm(length=0.1)
SLOT = Slot(-0.35, -0.85, -2.4, width=0.025, depth=0.04)
STROKES = Strokes(-1, np.array([2.45465621, -2.32870724]), np.array([0.33377423, 0.001]))
NEAR = 2.0  # s, when the tip is inside


@functools.cache
def planned_insert(enters: bool = True) -> InsertPlan:
    """Return a plan that stands, or one whose rope touches a wall."""
    who = Problem(ROPE, ARM, MotorLimits(), 4.0)
    slot = SLOT if enters else Slot(-0.355, -0.845, -2.4, width=0.025, depth=0.04)
    motion = STROKES.motion(who.limits)
    seen, finer = (verify_insert(each, slot, motion, NEAR) for each in (who, InsertTask(who, slot, []).finer))
    known, message = InsertFeasibility(0.98, 0.02, ""), failure(seen, finer)
    chance = None if message else SuccessProbability(45, 50)
    return InsertPlan(who, slot, known, STROKES, seen, finer, 0.004, chance, message, 1, 0.5)


def far_insert() -> InsertPlan:
    """Return the plan for a slot that is out of reach."""
    return hf.plan_insert(ROPE, ARM, Slot(1.2, 0.0, 0.0))
