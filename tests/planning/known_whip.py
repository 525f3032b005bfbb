"""A whip that is known to meet its target: what tests of tables, report and commands show, without a search."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

import hyperflex as hf
from hyperflex.model import divided
from hyperflex.planning import (
    MotorLimits,
    Problem,
    Strokes,
    TipTarget,
    WhipFeasibility,
    WhipMap,
    WhipPlan,
    build_whip_map,
    plan_whip,
)
from hyperflex.planning.whip.outcome import verify_whip
from hyperflex.planning.whip.task import FINER, failure

ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=8, radius=0.0025, friction=5e-4, name="short rope")
STROKES = Strokes(-1, np.array([1.4, 0.2, -0.9]), np.array([0.05, 0.3, 0.25]))
NEAR = 1.9  # s, when its tip is fast


@functools.cache
def planned_whip(meets: bool = True, any_direction: bool = False) -> WhipPlan:
    """Return a plan that stands, or one whose peak is 30 mm away from the target."""
    who = Problem(ROPE, hf.Arm(length=0.1), MotorLimits(), 4.0)
    motion = STROKES.motion(who.limits)
    peak = verify_whip(who, TipTarget(0.0, 0.0, 0.0, 1.0), motion, NEAR)
    assert peak is not None
    place = peak.place + ([0.0004, 0.0003] if meets else [0.018, 0.024])
    direction = float(np.arctan2(*peak.velocity[::-1])) + 0.1
    mark = TipTarget(*place, direction=direction, least_speed=0.9 * peak.speed, angle_tolerance=0.3)
    if any_direction:
        mark = TipTarget.at(place, None, 0.9 * peak.speed)
    seen = verify_whip(who, mark, motion, peak.t)
    finer = verify_whip(replace(who, rope=divided(ROPE, FINER)), mark, motion, peak.t)
    known = WhipFeasibility(float(np.hypot(*place)), 0.01, "")
    return WhipPlan(who, mark, known, STROKES, seen, finer, 0.004, failure(who, seen, finer, 0.004), 1, 0.5)


def far_whip() -> WhipPlan:
    """Return the plan for a target that is out of reach."""
    return plan_whip(ROPE, hf.Arm(length=0.1), (2.5, 0.0), (1.0, 0.0), whip_map=_map())


@functools.cache
def _map() -> WhipMap:
    return build_whip_map(Problem(ROPE, hf.Arm(length=0.1), MotorLimits(), 2.0), swings=8)
