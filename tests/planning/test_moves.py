"""Moves of the arm, the motor's limits, and throws made of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.motion import from_spec, to_spec
from hyperflex.planning import Throw
from hyperflex.planning.throw import MIN_STROKE

LIMITS = hf.MotorLimits(speed=6.0, acceleration=25.0)
THROW = Throw(-1, np.array([3.0, 1.0, 3.0]), np.array([0.1, 0.0, 0.4]), end=0.4, rest=0.05, speed=0.5, count=3)


def test_moves_go_where_they_are_sent_and_rest_there() -> None:
    motion = hf.arm_moves([-1.0, 2.0, 0.5], rests=[0.2, 0.3], durations=[0.5, 0.4], ramps=[0.5, 0.2])
    assert motion.angle([0.0, 0.2, 0.7, 1.0, 1.4, 9.0]) == pytest.approx([-1.0, -1.0, 2.0, 2.0, 0.5, 0.5], abs=1e-14)
    # Half of the way in half of the time, by symmetry; the ramp's speed is way / (time - ramp).
    assert motion.angle([0.45, 1.2]) == pytest.approx([0.5, 1.25], abs=1e-14)
    assert motion.rate([1.2]) == pytest.approx([-1.5 / (0.4 * 0.8)], rel=1e-14)


def test_moves_come_back_from_a_file_s_table() -> None:
    motion = hf.arm_moves([-1.0, 2.0, 0.5], rests=[0.0, 0.3], durations=[0.5, 0.4], ramps=[0.5, 0.2])
    assert from_spec(to_spec(motion)) == motion


@pytest.mark.parametrize(
    ("angles", "rests", "durations", "ramps", "told"),
    [
        ([1.0], [], [], 0.5, "there is no move"),
        ([0.0, 1.0], [-0.1], [0.5], 0.5, "rests"),
        ([0.0, 1.0], [0.1], [0.0], 0.5, "durations"),
        ([0.0, 1.0], [0.1], [0.5], 0.6, "ramps"),
        ([0.0, np.nan], [0.1], [0.5], 0.5, "angles"),
        ([0.0, 1.0], [0.1, 0.1], [0.5], 0.5, "rests"),
    ],
)
def test_moves_refuse_what_cannot_be(angles, rests, durations, ramps, told) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InvalidInput, match=told):
        hf.arm_moves(angles, rests, durations, ramps)


@pytest.mark.parametrize("way", [0.01, 0.5, 1.44, 1.45, 3.0, 6.0])
@pytest.mark.parametrize("part", [1.0, 0.4])
def test_the_fastest_move_uses_the_limits_and_keeps_them(way: float, part: float) -> None:
    durations, ramps = LIMITS.fastest_moves([way], part)
    motion = hf.arm_moves([0.0, way], [0.0], durations, ramps)
    t = np.linspace(0.0, float(durations[0]), 4001)
    speed, rise = np.abs(motion.rate(t)).max(), np.abs(motion.acceleration(t[1:-1])).max()
    assert speed <= part * 6.0 * (1 + 1e-12)
    assert rise == pytest.approx(part**2 * 25.0, rel=1e-9)
    # The optimum of a double integrator: full acceleration, and full speed if there is way enough for it.
    assert speed == pytest.approx(min(part * 6.0, part * np.sqrt(way * 25.0)), rel=1e-3)  # samples 1/4000 apart


@pytest.mark.parametrize(
    "bad",
    [{"speed": 0.0}, {"acceleration": 0.0}, {"torque": 0.0}, {"speed": np.nan}, {"angles": (1.0, 1.0)}],
)
def test_limits_of_nothing_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match=next(iter(bad))):
        hf.MotorLimits(**bad)  # type: ignore[arg-type]


def test_a_throw_goes_to_and_fro_within_the_motor_s_angles() -> None:
    angles = THROW.angles(LIMITS)
    assert angles == pytest.approx([-np.pi / 2, 3.0 - np.pi / 2, 2.0 - np.pi / 2, np.pi, 0.4])  # the third is cut
    motion = THROW.motion(LIMITS)
    assert motion.angle([0.0, THROW.stops(LIMITS)]) == pytest.approx([angles[0], angles[-1]])
    assert THROW.stops(LIMITS) == pytest.approx(float(motion.breaks[-1]))
    starts = THROW.starts(LIMITS)
    assert motion.angle(starts) == pytest.approx(angles[:-1])


def test_a_throw_that_goes_nowhere_is_made_to_move() -> None:
    still = replace(THROW, strokes=np.zeros(3), end=-np.pi / 2)
    assert np.abs(np.diff(still.angles(LIMITS))).min() >= MIN_STROKE * (1 - 1e-12)


def test_a_cut_throw_is_the_same_until_then_and_waits() -> None:
    t = float(THROW.starts(LIMITS)[1]) + 0.4  # the second stroke is over, the third has not begun
    cut = THROW.cut(t, LIMITS)
    assert cut.count == 2
    assert cut.starts(LIMITS)[-1] >= t
    before = np.linspace(0.0, t, 200)
    assert cut.motion(LIMITS).angle(before) == pytest.approx(THROW.motion(LIMITS).angle(before), abs=1e-12)
    within = THROW.cut(float(THROW.starts(LIMITS)[1]) + 0.01, LIMITS)  # in the second stroke: it is ended
    assert within.count == 2
    assert within.rest == pytest.approx(THROW.rest)
