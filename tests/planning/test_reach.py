"""What is said of a target before any search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.planning import MotorLimits, Problem, check_feasibility
from hyperflex.planning.problem import MIN_TURNS
from hyperflex.planning.wind.feasibility import GAIN, HANGING, MARGIN, MIN_ENERGY, WIDEST

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
CAST_SETUP = Problem(CABLE, hf.Arm(length=0.105), MotorLimits())


def at(far: float, aside: float, radius: float = 0.03) -> hf.Peg:
    return hf.Peg(far * np.sin(aside), -far * np.cos(aside), radius)


@pytest.mark.parametrize(("far", "aside"), [(0.9, 0.46), (1.2, -1.1), (1.0, 0.1)])
def test_the_energy_is_that_of_rods(far: float, aside: float) -> None:
    """By quadrature along the rope, in place of sums over links."""
    slope, length = abs(aside), 2.0
    pendulum = 2.0 * length / 3.0  # of a rod
    wide = min(slope - np.arcsin(0.0325 / far) + GAIN * 0.21 / pendulum, WIDEST[0])
    drop = quad(lambda s: s * (np.cos(slope) - np.cos(wide)), 0.0, length)[0]
    share = quad(lambda s: s**2, far, length)[0] / quad(lambda s: s**2, 0.0, length)[0]
    lift = quad(lambda s: (s - far) * (1.0 + np.cos(slope)), far, length)[0]
    # Links of 40 mm as points, one of which straddles the peg; their own inertia moves the pendulum by 1e-4.
    assert check_feasibility(CAST_SETUP, at(far, aside)).energy_ratio == pytest.approx(share * drop / lift, rel=0.04)


def test_a_target_below_leaves_no_room_to_swing() -> None:
    """Of two targets the one right below gets much less energy, which grows with the square of what a stroke adds."""
    beside, below = (check_feasibility(CAST_SETUP, at(1.0, aside)).energy_ratio for aside in (0.1, 0.0))
    assert below < 0.3 * beside


@pytest.mark.parametrize(
    ("peg", "told"),
    [
        (at(2.5, 0.3), "ends 0.36 m short"),
        (at(2.0, 0.8), "with all of the rope round the target it makes 0.76"),
        (at(1.8, 0.8), "turns is left beyond"),
        (at(0.08, 1.0), "inside the arm's circle"),
        (at(0.9, 0.0), "too little energy"),
        (at(0.6, 2.5), "too little energy: it is higher than the rope swings"),
    ],
)
def test_what_is_out_of_reach_is_told_why(peg: hf.Peg, told: str) -> None:
    known = check_feasibility(CAST_SETUP, peg)
    assert not known.feasible
    assert told in known.message


def test_a_slow_motor_is_told_from_little_energy() -> None:
    slow = replace(CAST_SETUP, limits=MotorLimits(speed=0.5, acceleration=5.0))
    assert check_feasibility(CAST_SETUP, at(0.9, 0.46)).feasible
    assert "motor is too slow" in check_feasibility(slow, at(0.9, 0.46)).message
    told = check_feasibility(slow, at(0.9, 1.5))
    assert told.energy_ratio < 0.0
    assert "motor is too slow" in told.message
    assert "higher than the rope swings" in told.message


@pytest.mark.parametrize(("tip", "widest"), [(0.0, WIDEST[0]), (0.02, WIDEST[1]), (0.5, WIDEST[1])])
def test_a_rope_with_a_weight_at_its_end_swings_less_far_beyond_level(tip: float, widest: float) -> None:
    """Just below the widest swing there is energy left, just above it there is none."""
    who = replace(CAST_SETUP, rope=CABLE.replace(tip_mass=tip))
    assert check_feasibility(who, at(1.0, widest - 0.01)).energy_ratio > 0.0
    assert check_feasibility(who, at(1.0, widest + 0.01)).energy_ratio < 0.0


def test_a_motor_that_cannot_hold_the_hanging_rope_is_refused_before_a_search() -> None:
    asked = 0.125 * 9.81 * 0.105  # N m, weight times arm
    weak = replace(CAST_SETUP, limits=MotorLimits(torque=0.99 * asked))
    told = check_feasibility(weak, at(0.9, 0.46))
    assert told.impossible
    assert "too weak" in told.message
    assert "0.129 N m" in told.message
    assert check_feasibility(replace(CAST_SETUP, limits=MotorLimits(torque=1.01 * asked)), at(0.9, 0.46)).feasible
    low = MotorLimits(torque=0.99 * asked, angles=(-1.0, 3.0))  # on the left the arm begins 1 rad from hanging
    assert check_feasibility(replace(CAST_SETUP, limits=low), at(0.9, 0.46)).feasible


def test_the_pull_borne_is_that_of_the_end_that_hangs() -> None:
    """With a fourth of the mass in its outer half, of which the end is a part, it bears a fourth."""
    mass = np.repeat([1.0, 0.25], 25) * 0.0025
    light = hf.Rope(length=np.full(50, 0.04), mass=mass, friction=np.full(50, 5e-4), radius=0.0025)
    assert check_feasibility(replace(CAST_SETUP, rope=light), at(1.5, 0.9)).holding_force == pytest.approx(
        0.25 * check_feasibility(CAST_SETUP, at(1.5, 0.9)).holding_force
    )


def test_a_wider_swing_reaches_more() -> None:
    energies = [check_feasibility(CAST_SETUP, at(1.0, a)).energy_ratio for a in (0.1, 0.3, 0.6, 0.9)]
    assert np.all(np.diff(energies) > 0.0)
    assert energies[0] < MIN_ENERGY < energies[-1]


def wound(far: float, aside: float, axis: float, more: int, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Length (k,) and turns (k,) of a rope drawn as a polyline: from the shaft to a peg, counterclockwise round it with
    `more` whole turns and, from its left side, down with ends (k,) of several lengths."""
    centre = far * np.array([np.sin(aside), -np.cos(aside)])
    first = np.arctan2(*-centre[::-1]) + np.arccos(axis / far)
    angles = np.linspace(first, np.pi + 2.0 * np.pi * more, 20001)
    points = np.concatenate([-centre[None], axis * np.stack([np.cos(angles), np.sin(angles)], axis=-1)])
    around = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
    tips = points[-1] - np.stack([np.zeros_like(ends), ends], axis=-1)
    swing = np.arctan2(tips[:, 1], tips[:, 0]) % (2.0 * np.pi) - np.pi
    turns = (around[-1] - around[0] + swing) / (2.0 * np.pi)
    return np.hypot(*np.diff(points, axis=0).T).sum() + ends, turns if angles[-1] > first else np.zeros_like(ends)


@pytest.mark.parametrize("aside", [0.0, 0.5, 0.9, 1.1, 1.6])
@pytest.mark.parametrize("radius", [0.03, 0.05])
def test_the_room_needed_is_that_of_a_rope_wound_and_hanging(aside: float, radius: float) -> None:
    far, axis = 1.0, radius + 0.0025
    ends = axis * np.linspace(HANGING, 40.0, 20001)
    drawn = [wound(far, aside, axis, more, ends) for more in (0, 1, 2)]
    rooms = [(length[turns >= MIN_TURNS + MARGIN] - far + axis).min(initial=np.inf) for length, turns in drawn]
    needed = min(rooms) / (2.0 * np.pi * axis)
    assert check_feasibility(CAST_SETUP, at(far, aside, radius)).needed_turns == pytest.approx(
        needed, abs=1e-3
    )  # ends 0.002 radii apart


def test_the_hold_asked_for_counts() -> None:
    """The capstan equation on ropes drawn with one turn more or less, of which the one that bears most counts."""
    peg, weight = at(1.36, 0.66, 0.04), 0.125 * 9.81 / 2.0
    known, bears = check_feasibility(CAST_SETUP, peg), []
    for more in (1, 2):
        (bare,), (turns,) = wound(1.36, 0.66, 0.0425, more, np.zeros(1))
        contact = 2.0 * np.pi * turns - np.arccos(0.0425 / 1.36)
        bears.append(weight * (2.0 - bare) * np.exp(0.3 * contact))
    assert known.holding_force == pytest.approx(max(bears), rel=1e-6)  # the polyline's arc is shorter by 1e-9
    assert check_feasibility(CAST_SETUP, peg, holding_force=0.9 * known.holding_force).feasible
    assert "asked" in check_feasibility(CAST_SETUP, peg, holding_force=1.1 * known.holding_force).message


def test_what_is_down_is_where_gravity_points() -> None:
    """Gravity along x: the same target turned by a right angle."""
    turned = Problem(CABLE.replace(gravity=(9.81, 0.0)), CAST_SETUP.arm, CAST_SETUP.limits)
    there, here = (
        check_feasibility(turned, hf.Peg(0.9, 0.4, 0.03)),
        check_feasibility(CAST_SETUP, hf.Peg(-0.4, -0.9, 0.03)),
    )
    assert there == here


@pytest.mark.parametrize("links", [1, 3])
def test_a_rope_of_few_links_is_refused(links: int) -> None:
    rope = hf.Rope.uniform(length=2.0, mass=0.125, n_links=links, radius=0.0025)
    with pytest.raises(InvalidInput, match="too few links"):
        Problem(rope, CAST_SETUP.arm, CAST_SETUP.limits)
