"""A throw that is known to wind: what tests of tables, report and commands show, without a search."""

from __future__ import annotations

import functools
import time

import numpy as np

import hyperflex as hf
from hyperflex.planning.cast_plan import CastPlan
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.planner import why_not
from hyperflex.planning.wind.outcome import verify
from hyperflex.planning.wind.reachability import reach
from hyperflex.planning.wind.throw import Throw

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


def thrower() -> Thrower:
    return Thrower(CABLE, hf.Arm(length=0.105), hf.MotorLimits())


@functools.cache
def planned(winds: bool = True) -> CastPlan:
    """Return a plan that stands, or one whose throw misses."""
    begin = time.monotonic()
    who, throw = thrower(), WINDS if winds else SHORT
    cast = verify(who, PEG, throw.motion(who.limits))
    finer = cast if winds else None  # the run with finer links is not what is tested here
    seconds = time.monotonic() - begin
    return CastPlan(who, PEG, reach(who, PEG), throw, cast, finer, why_not(cast, finer, False), 1, seconds)


@functools.cache
def late() -> CastPlan:
    """Return a plan for a target in reach, whose verification took longer than it might."""
    who = thrower()
    cast = verify(who, PEG, WINDS.motion(who.limits), patience=1e-9)
    return CastPlan(who, PEG, reach(who, PEG), WINDS, cast, None, why_not(cast, None, False), 4321, 61.2)


def stopped(throw: Throw | None = WINDS) -> CastPlan:
    """Return a plan for a target in reach, that Ctrl-C ended before anything was verified."""
    who = thrower()
    return CastPlan(who, PEG, reach(who, PEG), throw, None, None, why_not(None, None, True), 4321, 12.3, True)


def unreachable() -> CastPlan:
    return hf.plan_cast(CABLE, hf.Arm(length=0.105), hf.Peg(2.5, 0.0, 0.03))
