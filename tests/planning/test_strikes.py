"""First strikes of free swings, and what they promise, by brute force and closed forms."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.planning import MotorLimits, Problem
from hyperflex.planning.clearance import sampled_clearance, sampled_obstacle_gaps, samples_clear_of_arm
from hyperflex.planning.rollouts import MODEL, NEVER, RolloutBatch, find_strikes, first_contact, tail_energy

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
CAST_SETUP = Problem(CABLE, hf.Arm(length=0.105), MotorLimits())


def test_the_gap_is_that_of_many_points_along_the_rope():
    random = np.random.default_rng(3)
    q = random.uniform(-np.pi, np.pi, (4, 1, 6)).repeat(3, axis=1)
    base, length = np.zeros((4, 3, 2)), random.uniform(0.1, 0.3, 6)
    peg = hf.Peg(0.3, -0.5, 0.02)
    _, _, least = first_contact(q, base, np.tile(length, (4, 1)), [peg] * 4, 0.01)
    steps = np.stack([np.sin(q[:, 0]), -np.cos(q[:, 0])], axis=-1) * length[:, None]
    joints = np.concatenate([np.zeros((4, 1, 2)), np.cumsum(steps, axis=1)], axis=1)
    part = np.linspace(0.0, 1.0, 2001)[:, None]
    for k in range(4):
        points = np.concatenate([joints[k, i] + part * steps[k, i] for i in range(6)])
        gap = np.hypot(*(points - [0.3, -0.5]).T).min() - 0.03
        assert least[k] == pytest.approx(max(gap, 0.0), abs=1e-6)  # points 0.15 mm apart: (7.5e-5)^2 / 2 / gap


def test_a_link_that_passes_between_two_samples_is_seen():
    angle = np.array([0.0, -0.6, 0.6])  # a rod that swings through a peg below it
    q, base = angle[None, :, None], np.zeros((1, 3, 2))
    at, link, _ = first_contact(q, base, np.array([[1.0]]), [hf.Peg(0.0, -0.8, 0.001)], 0.0)
    assert (at.tolist(), link.tolist()) == ([2], [0])
    at, _, least = first_contact(q[:, :2], base[:, :2], np.array([[1.0]]), [hf.Peg(0.5, -0.8, 0.001)], 0.0)
    assert at.tolist() == [0]
    assert least[0] > MODEL.near


def test_a_rope_that_hangs_near_the_peg_leaves_it_before_it_strikes():
    angle = np.array([0.0, -0.01, -0.3, -0.5, -0.3, 0.0, 0.3])  # a rod, 12 mm from the peg at the start
    peg, base = hf.Peg(0.022, -0.8, 0.01), np.zeros((1, 7, 2))
    at, _, _ = first_contact(angle[None, :, None], base, np.array([[1.0]]), [peg], 0.0)
    assert at.tolist() == [5]
    at, _, _ = first_contact(angle[None, :5, None], base[:, :5], np.array([[1.0]]), [peg], 0.0)
    assert at.tolist() == [0]


def test_the_clearance_from_the_arm_is_that_from_a_wall_and_a_peg():
    """A wall in place of the arm, of its thickness, and a peg for the shaft, without the links that hang from the
    arm. A link that crosses the arm is as deep as both are thick, one that crosses a wall as its end is beyond it."""
    random, arm = np.random.default_rng(6), hf.Arm(length=0.2, pivot=(0.1, -0.2), radius=0.004, shaft_radius=0.012)
    rope = hf.Rope.uniform(1.2, 0.06, 12, 0.003, friction=0.0)
    pivot, shaft = np.array(arm.pivot), hf.Peg(*arm.pivot, arm.shaft_radius)
    for _ in range(40):
        angle, q = random.uniform(-np.pi, np.pi), random.uniform(-np.pi, np.pi, (1, 12))
        tip = pivot + 0.2 * np.array([np.sin(angle), -np.cos(angle)])
        whole = float(sampled_obstacle_gaps(rope, [shaft], q, tip[None])[0])
        begin = tip + 0.1 * np.array([np.sin(q[0, 0]), -np.cos(q[0, 0])])  # one link hangs from it
        rest = hf.Rope.uniform(1.1, 0.055, 11, 0.003, friction=0.0)
        wall = hf.Wall(*arm.pivot, *tip)
        away = float(sampled_obstacle_gaps(rest, [wall], q[:, 1:], begin[None])[0]) - arm.radius
        away = max(away, -(rope.radius + arm.radius))
        assert sampled_clearance(rope, arm, q, tip[None])[0] == pytest.approx(min(whole, away), abs=1e-12)


def test_samples_clear_of_the_arm_are_those_before_the_first_that_is_not():
    """All links at all samples, compared with only those that may be near; none is looked at from `until` on."""
    random, arm, rope = np.random.default_rng(5), hf.Arm(length=0.15), hf.Rope.uniform(1.2, 0.06, 12, 0.003, friction=0)
    q = np.cumsum(random.normal(0.0, 0.4, (40, 60, 12)), axis=1) + random.uniform(-np.pi, np.pi, (40, 1, 12))
    base = arm.tip(random.uniform(-np.pi, np.pi, (40, 60)))
    for clearance in (0.0, 0.05):
        found = samples_clear_of_arm(rope, arm, q, base, clearance)
        near = np.array([sampled_clearance(rope, arm, *each) <= clearance for each in zip(q, base, strict=True)])
        assert found.tolist() == np.where(near.any(axis=1), near.argmax(axis=1), 60).tolist()
        assert (samples_clear_of_arm(rope, arm, q, base, clearance, np.maximum(found - 1, 0)) == 60).all()


def test_a_flight_that_failed_strikes_nothing_from_there_on():
    angle = np.array([-0.5, -0.4, np.nan, np.nan])  # a rod near the peg, and unknown angles
    at, _, least = first_contact(
        angle[None, :, None], np.zeros((1, 4, 2)), np.array([[1.0]]), [hf.Peg(0.0, -0.8, 0.01)], 0.0
    )
    assert at.tolist() == [0]
    assert least[0] == pytest.approx(0.8 * np.sin(0.4) - 0.01)
    t, none = np.array([0.02, 0.04]), np.full((1, 2, CABLE.n_links), np.nan)
    peg, start = hf.Peg(0.5, -1.0, 0.03), np.zeros((1, CABLE.n_links))
    batch = RolloutBatch([CABLE], [peg], [hf.hold_arm(0.0)], start, start)
    lost = find_strikes(CAST_SETUP, peg, batch, t, none, none)
    assert np.isnan(lost.t[0])
    assert lost.score[0] == pytest.approx(NEVER - CABLE.total_length)


def test_a_swing_that_goes_through_its_arm_does_not_strike():
    """A rope that folds over the shaft, and strikes the peg on the other side of it."""
    t: np.ndarray = np.arange(0.0, 0.6, 0.02)
    turn = np.linspace(0.0, 1.9 * np.pi, t.size)[:, None]
    rope, arm = hf.Rope.uniform(1.2, 0.06, 12, 0.003, friction=0.0), hf.Arm(length=0.2, shaft_radius=0.03)
    q, motion = np.broadcast_to(0.3 + turn, (t.size, 12))[None], hf.hold_arm(0.5 * np.pi)
    strike = {}
    for clearance in (0.0, -np.inf):
        problem = Problem(rope, arm, MotorLimits(), clearance=clearance)
        peg = hf.Peg(-0.5, -0.3, 0.02)
        batch = RolloutBatch([rope], [peg], [motion], q[:, 0], q[:, 0])
        found = find_strikes(problem, peg, batch, t, q, np.ones_like(q))
        strike[clearance] = float(found.t[0]), float(found.score[0])
    assert np.isnan(strike[0.0][0])
    assert strike[0.0][1] < NEVER
    assert strike[-np.inf][0] > 0.0


def test_a_rod_near_the_peg_that_swings_through_it_strikes():
    """It is near the peg before, and has not left it."""
    base, length, peg = np.zeros((1, 3, 2)), np.array([[1.0]]), hf.Peg(0.0, -0.5, 0.001)
    for angles, strike in (([0.03, -0.03, -0.06], 1), ([0.03, 0.001, 0.03], 1), ([0.03, 0.02, 0.03], 0)):
        at, _, _ = first_contact(np.array(angles)[None, :, None], base, length, [peg], 0.0)
        assert at[0] == strike


def test_what_a_turning_rod_promises():
    """Straight, from the peg on, at the rate w: energy w^2 m s^2 / 6, and m g s / 2 (1 + cos q) lifts its centre."""
    peg, w, slope = hf.Peg(0.0, -1.0, 0.01), 4.0, 0.7
    q = np.where(np.arange(50) < 25, 0.0, slope)  # the upper half hangs to the peg, the lower one is the tail
    qd = np.where(np.arange(50) < 25, 0.0, w)
    ratio, turns = tail_energy(CABLE, peg, q, qd, np.zeros(2), np.zeros(2), 25)
    s = 1.0
    expected = (w**2 * s**2 / 6.0) / (9.81 * 0.5 * s * (1.0 + np.cos(slope)))
    assert ratio == pytest.approx(expected, rel=1e-3)  # links as points: (1/25)^2 / 4 of the inertia is missing
    assert turns == pytest.approx(s / (2.0 * np.pi * 0.0125))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_tail_that_turns_away_from_the_peg_does_not_wind(side):
    q, qd = np.zeros(50), np.where(np.arange(50) < 25, 0.0, 4.0)  # counterclockwise, to the right
    ratio, _ = tail_energy(CABLE, hf.Peg(side * 0.0125, -1.0, 0.01), q, qd, np.zeros(2), np.zeros(2), 25)
    assert ratio * side > 0.1


def test_a_weight_at_the_tip_counts():
    peg, w = hf.Peg(0.0, -1.0, 0.01), 4.0
    q, qd = np.zeros(50), np.where(np.arange(50) < 25, 0.0, w)
    ratio, _ = tail_energy(CABLE.replace(tip_mass=1e5), peg, q, qd, np.zeros(2), np.zeros(2), 25)
    assert ratio == pytest.approx(0.5 * w**2 / (2.0 * 9.81), rel=1e-5)  # a point: the rope is 1e-6 of it
