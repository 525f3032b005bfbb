"""Options of the planners: no field is accepted unchecked."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from hyperflex.planning import (
    Conditions,
    FollowOptions,
    MotorLimits,
    SearchOptions,
    TargetGrid,
    Uncertainty,
    WindCriteria,
)
from hyperflex.planning.outcome import evaluate_cast
from tests.planning.known import PEG, planned
from tests.refusals import refuses

UNCHECKED = {"executor", "chunk_size", "x", "y"}  # where they are used


@pytest.mark.parametrize("kind", [MotorLimits, WindCriteria, SearchOptions, TargetGrid, FollowOptions])
def test_each_option_refuses_what_it_cannot_use(kind):
    for name in {each.name for each in fields(kind)} - UNCHECKED:
        refuses(name, kind, **{name: [3]})


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (SearchOptions, "batch", 0),
        (SearchOptions, "rests", -1),
        (SearchOptions, "speeds", ()),
        (SearchOptions, "speeds", (1.5,)),
        (SearchOptions, "deviations", (0.1,)),
        (SearchOptions, "width", 1.5),
        (SearchOptions, "seed", -1),
        (SearchOptions, "threads", 0),
        (WindCriteria, "turns", 0.4),
        (WindCriteria, "settle", 11.0),
        (WindCriteria, "contact", -1.0),
        (Conditions, "clearance", -1.0),
        *((Uncertainty, name, -0.1) for name in ("length", "mass", "friction", "mu", "lag", "timing")),
        (Uncertainty, "length", math.nan),
    ],
)
def test_options_out_of_range_are_refused(kind, name, value):
    refuses(name, kind, **{name: value})


def test_a_search_may_be_told_that_nothing_limits_it():
    found = SearchOptions(deviations=(math.inf, math.inf), coarse=math.inf, members=0, speeds=np.array([1.0]))
    assert (found.deviations, found.coarse, found.speeds) == ((math.inf, math.inf), math.inf, (1.0,))


def test_a_watch_is_at_least_as_long_as_forces_are_averaged():
    refuses("watch is too short", WindCriteria, watch=0.001)
    plan, short = planned(), WindCriteria(settle=2.9, watch=0.1)
    found = evaluate_cast(replace(plan.problem, criteria=short), PEG, plan.run, plan.motion.breaks[-1])
    assert found.success
    assert 0.0 < found.load_ratio < 1.0
