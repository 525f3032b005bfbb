"""What is said of a target before any search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import hyperflex as hf
from hyperflex.casting import MotorLimits, Thrower, reach
from hyperflex.casting.targets import ENERGY, GAIN, HANGING, WIDEST
from hyperflex.errors import InvalidInput

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
THROWER = Thrower(CABLE, hf.Arm(length=0.105), MotorLimits())


def at(far: float, aside: float, radius: float = 0.03) -> hf.Peg:
    return hf.Peg(far * np.sin(aside), -far * np.cos(aside), radius)


@pytest.mark.parametrize(("far", "aside"), [(0.9, 0.46), (1.2, -1.1), (1.0, 0.1)])
def test_the_energy_is_that_of_rods(far: float, aside: float) -> None:
    """By quadrature along the rope, in place of sums over links."""
    slope, length = abs(aside), 2.0
    pendulum = 2.0 * length / 3.0  # of a rod
    wide = min(slope - np.arcsin(0.0325 / far) + GAIN * 0.21 / pendulum, WIDEST)
    drop = quad(lambda s: s * (np.cos(slope) - np.cos(wide)), 0.0, length)[0]
    share = quad(lambda s: s**2, far, length)[0] / quad(lambda s: s**2, 0.0, length)[0]
    lift = quad(lambda s: (s - far) * (1.0 + np.cos(slope)), far, length)[0]
    # Links of 40 mm as points, one of which straddles the peg; their own inertia moves the pendulum by 1e-4.
    assert reach(THROWER, at(far, aside)).energy == pytest.approx(share * drop / lift, rel=0.04)


@pytest.mark.parametrize(
    ("peg", "told"),
    [
        (at(2.5, 0.3), "ends 0.36 m short"),
        (at(1.9, 0.8), "turns is left beyond"),
        (at(0.08, 1.0), "inside the arm's circle"),
        (at(0.9, 0.0), "too little energy"),
        (at(0.6, 2.5), "too little energy"),
    ],
)
def test_what_is_out_of_reach_is_told_why(peg: hf.Peg, told: str) -> None:
    known = reach(THROWER, peg)
    assert not known.within
    assert told in known.reason


def test_a_slow_motor_is_told_from_little_energy() -> None:
    slow = replace(THROWER, limits=MotorLimits(speed=0.5, acceleration=5.0))
    assert reach(THROWER, at(0.9, 0.46)).within
    assert "motor is too slow" in reach(slow, at(0.9, 0.46)).reason


def test_a_wider_swing_reaches_more() -> None:
    energies = [reach(THROWER, at(1.0, a)).energy for a in (0.1, 0.3, 0.6, 0.9)]
    assert np.all(np.diff(energies) > 0.0)
    assert energies[0] < ENERGY < energies[-1]


def test_the_needed_turns_are_those_a_hanging_end_can_make() -> None:
    """From below, the rope ends half a turn less the target's angle, and whole turns, from where it came."""
    for aside in (0.0, 0.5, 1.2):
        turns = reach(THROWER, at(1.0, aside)).needed - HANGING
        assert (turns - 0.5 + aside / (2.0 * np.pi)) % 1.0 == pytest.approx(0.0, abs=1e-12)
        assert 1.3 <= turns < 2.3


def test_the_hold_asked_for_counts() -> None:
    known = reach(THROWER, at(1.36, 0.66, 0.04))
    weight_per_m, axis = 0.125 * 9.81 / 2.0, 0.0425
    turns = known.needed - HANGING
    hanging = 2.0 - 1.36 + axis - turns * 2.0 * np.pi * axis
    assert known.hold == pytest.approx(weight_per_m * hanging * np.exp(0.3 * 2.0 * np.pi * turns))
    assert reach(THROWER, at(1.36, 0.66, 0.04), hold=0.9 * known.hold).within
    assert "asked" in reach(THROWER, at(1.36, 0.66, 0.04), hold=1.1 * known.hold).reason


def test_what_is_down_is_where_gravity_points() -> None:
    """Gravity along x: the same target turned by a right angle."""
    turned = Thrower(CABLE.replace(gravity=(9.81, 0.0)), THROWER.arm, THROWER.limits)
    there, here = reach(turned, hf.Peg(0.9, 0.4, 0.03)), reach(THROWER, hf.Peg(-0.4, -0.9, 0.03))
    assert there == here


@pytest.mark.parametrize("links", [1, 3])
def test_a_rope_of_few_links_is_refused(links: int) -> None:
    rope = hf.Rope.uniform(length=2.0, mass=0.125, n_links=links, radius=0.0025)
    with pytest.raises(InvalidInput, match="too few links"):
        Thrower(rope, THROWER.arm, THROWER.limits)
