"""First strikes of free swings, and what they promise, by brute force and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.planning import MotorLimits, Problem
from hyperflex.planning.clearance import sampled_clearance, sampled_obstacle_gaps, samples_clear_of_arm
from hyperflex.planning.search.contact_phase import MIN_BUDGET, TIME_BUDGET, run_budget
from hyperflex.planning.search.known_strikes import moved_to
from hyperflex.planning.search.strikes import (
    FOLDED,
    NEAR,
    NEVER,
    Strikes,
    find_strikes,
    first_contact,
    samples_unfolded,
    simulate_strikes,
    tail_energy,
)
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.throw import ThrowParametrization
from tests.planning.known import simulated_strikes

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
CAST_SETUP = Problem(CABLE, hf.Arm(length=0.105), MotorLimits())


def test_the_gap_is_that_of_many_points_along_the_rope() -> None:
    random = np.random.default_rng(3)
    q = random.uniform(-np.pi, np.pi, (4, 1, 6)).repeat(3, axis=1)
    base, length = np.zeros((4, 3, 2)), random.uniform(0.1, 0.3, 6)
    peg = hf.Peg(0.3, -0.5, 0.02)
    _, _, least = first_contact(q, base, length, peg, 0.01)
    steps = np.stack([np.sin(q[:, 0]), -np.cos(q[:, 0])], axis=-1) * length[:, None]
    joints = np.concatenate([np.zeros((4, 1, 2)), np.cumsum(steps, axis=1)], axis=1)
    part = np.linspace(0.0, 1.0, 2001)[:, None]
    for k in range(4):
        points = np.concatenate([joints[k, i] + part * steps[k, i] for i in range(6)])
        gap = np.hypot(*(points - [0.3, -0.5]).T).min() - 0.03
        assert least[k] == pytest.approx(max(gap, 0.0), abs=1e-6)  # points 0.15 mm apart: (7.5e-5)^2 / 2 / gap


def test_a_link_that_passes_between_two_samples_is_seen() -> None:
    angle = np.array([0.0, -0.6, 0.6])  # a rod that swings through a peg below it
    q, base = angle[None, :, None], np.zeros((1, 3, 2))
    at, link, _ = first_contact(q, base, np.array([1.0]), hf.Peg(0.0, -0.8, 0.001), 0.0)
    assert (at.tolist(), link.tolist()) == ([2], [0])
    at, _, least = first_contact(q[:, :2], base[:, :2], np.array([1.0]), hf.Peg(0.5, -0.8, 0.001), 0.0)
    assert at.tolist() == [0]
    assert least[0] > NEAR


def test_a_rope_that_hangs_beside_the_peg_leaves_it_before_it_strikes() -> None:
    angle = np.array([0.0, -0.01, -0.3, -0.5, -0.3, 0.0, 0.3])  # a rod, 12 mm from the peg at the start
    peg, base = hf.Peg(0.022, -0.8, 0.01), np.zeros((1, 7, 2))
    at, _, _ = first_contact(angle[None, :, None], base, np.array([1.0]), peg, 0.0)
    assert at.tolist() == [5]
    at, _, _ = first_contact(angle[None, :5, None], base[:, :5], np.array([1.0]), peg, 0.0)
    assert at.tolist() == [0]


def test_the_clearance_from_the_arm_is_that_from_a_wall_and_a_peg() -> None:
    """A wall where the arm is, of its thickness, and a peg for the shaft; links that hang from the arm left out."""
    random, arm = np.random.default_rng(6), hf.Arm(length=0.2, pivot=(0.1, -0.2), radius=0.004, shaft_radius=0.012)
    rope = hf.Rope.uniform(1.2, 0.06, 12, 0.003)
    pivot, shaft = np.array(arm.pivot), hf.Peg(*arm.pivot, arm.shaft_radius)
    for _ in range(40):
        angle, q = random.uniform(-np.pi, np.pi), random.uniform(-np.pi, np.pi, (1, 12))
        tip = pivot + 0.2 * np.array([np.sin(angle), -np.cos(angle)])
        whole = float(sampled_obstacle_gaps(rope, [shaft], q, tip[None])[0])
        begin = tip + 0.1 * np.array([np.sin(q[0, 0]), -np.cos(q[0, 0])])  # one link hangs from it
        rest = hf.Rope.uniform(1.1, 0.055, 11, 0.003)
        wall = hf.Wall(*arm.pivot, *tip)
        away = float(sampled_obstacle_gaps(rest, [wall], q[:, 1:], begin[None])[0]) - arm.radius
        assert sampled_clearance(rope, arm, q, tip[None])[0] == pytest.approx(min(whole, away), abs=1e-12)


def test_samples_clear_of_the_arm_are_those_before_the_first_that_is_not() -> None:
    """All links at all samples, beside those alone that may be near."""
    random, arm, far = np.random.default_rng(5), hf.Arm(length=0.15), hf.Rope.uniform(1.2, 0.06, 12, 0.003)
    q = np.cumsum(random.normal(0.0, 0.4, (40, 60, 12)), axis=1) + random.uniform(-np.pi, np.pi, (40, 1, 12))
    angle = random.uniform(-np.pi, np.pi, (40, 60))
    base = 0.15 * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
    for clearance in (0.0, 0.05):
        found = samples_clear_of_arm(far, arm, q, base, clearance)
        near = np.array([sampled_clearance(far, arm, *each) <= clearance for each in zip(q, base, strict=True)])
        assert found.tolist() == np.where(near.any(axis=1), near.argmax(axis=1), 60).tolist()
        assert (found < 60).sum() > 5
    until = np.maximum(found - 1, 0)  # looked at no longer than to one sample before
    assert samples_clear_of_arm(far, arm, q, base, clearance, until).tolist() == 40 * [60]
    assert samples_clear_of_arm(far, arm, q, base, -np.inf).tolist() == 40 * [60]


def test_a_flight_that_failed_strikes_nothing_from_there_on() -> None:
    angle = np.array([-0.5, -0.4, np.nan, np.nan])  # a rod beside the peg, and angles that nobody knows
    at, _, least = first_contact(
        angle[None, :, None], np.zeros((1, 4, 2)), np.array([1.0]), hf.Peg(0.0, -0.8, 0.01), 0.0
    )
    assert at.tolist() == [0]
    assert least[0] == pytest.approx(0.8 * np.sin(0.4) - 0.01)
    t, none = np.array([0.02, 0.04]), np.full((1, 2, CABLE.n_links), np.nan)
    lost = find_strikes(CAST_SETUP, hf.Peg(0.5, -1.0, 0.03), [hf.hold_arm(0.0)], t, none, none)
    assert np.isnan(lost.t[0])
    assert lost.score[0] == pytest.approx(NEVER - CABLE.total_length)


def test_a_swing_that_goes_through_its_arm_does_not_strike() -> None:
    """A rope that folds over the shaft, and strikes the peg on the other side of it."""
    t: np.ndarray = np.arange(0.0, 0.6, 0.02)
    turn = np.linspace(0.0, 1.9 * np.pi, t.size)[:, None]
    rope, arm = hf.Rope.uniform(1.2, 0.06, 12, 0.003), hf.Arm(length=0.2, shaft_radius=0.03)
    q, motion = np.broadcast_to(0.3 + turn, (t.size, 12))[None], hf.hold_arm(0.5 * np.pi)
    strike = {}
    for clearance in (0.0, -np.inf):
        problem = Problem(rope, arm, MotorLimits(), clearance=clearance)
        found = find_strikes(problem, hf.Peg(-0.5, -0.3, 0.02), [motion], t, q, np.ones_like(q))
        strike[clearance] = float(found.t[0]), float(found.score[0])
    assert np.isnan(strike[0.0][0])
    assert strike[0.0][1] < NEVER
    assert strike[-np.inf][0] > 0.0


def test_a_swing_that_was_folded_flat_before_its_strike_is_worth_less() -> None:
    """What a rope does after it was folded depends on its contact with itself."""
    t = 0.02 * np.arange(1.0, 21.0)
    rope, n = hf.Rope.uniform(1.2, 0.06, 12, 0.003), 12
    problem, motion = Problem(rope, hf.Arm(length=0.2), MotorLimits()), hf.hold_arm(0.0)
    q = np.repeat(np.linspace(-0.8, 0.6, t.size)[None, :, None], n, axis=2)
    folded, afterwards = q.copy(), q.copy()
    folded[0, 2, -1] += 3.1  # the last link upon the one before
    afterwards[0, -1, -1] += 3.1
    found = [
        find_strikes(problem, hf.Peg(0.2, -1.0, 0.02), [motion], t, each, np.full_like(each, 5.0))
        for each in (q, folded, afterwards)
    ]
    assert 0.1 < found[0].t[0] < 0.35
    assert found[1].score[0] == pytest.approx(FOLDED * found[0].score[0])
    assert found[2].score[0] == found[0].score[0] > 0.0


def test_bends_count_from_rest() -> None:
    """A rope that hangs as it was made is folded nowhere, however it was made."""
    rope = hf.Rope.uniform(1.2, 0.06, 12, 0.003).replace(rest_angle=np.append(0.0, np.full(11, 0.3)), max_bend=0.25)
    at_rest = np.cumsum(rope.rest_angle)
    straight = np.zeros(12)
    assert samples_unfolded(rope, np.array([[at_rest, at_rest, straight]])).tolist() == [2]
    assert samples_unfolded(rope, np.array([[at_rest, at_rest, at_rest]])).tolist() == [3]


def test_strikes_are_looked_for_until_a_time() -> None:
    throws = ThrowParametrization(CAST_SETUP, 1)
    motion, peg = (
        throws.throw(throws.centre()).motion(CAST_SETUP.limits),
        hf.Peg(1.36 * np.sin(0.66), -1.36 * np.cos(0.66), 0.04),
    )
    whole = simulate_strikes(CAST_SETUP, peg, [motion])
    t = float(whole.t[0])
    assert 1.0 < t < CAST_SETUP.time - 1.0
    same, none = (simulate_strikes(CAST_SETUP, peg, [motion], until=until) for until in (t + 0.1, t - 0.1))
    assert same.t[0] == t
    np.testing.assert_allclose(same.q, whole.q, atol=1e-6)  # steps end at other times
    assert np.isnan(none.t[0])
    assert none.score[0] <= NEVER


def test_a_side_on_which_the_rope_starts_inside_the_peg_is_left_out() -> None:
    arm = hf.Arm(length=0.5)
    problem = Problem(CABLE, arm, MotorLimits())
    assert list(ThrowSearch(problem, hf.Peg(0.5, -0.6, 0.03)).parametrizations) == [-1]
    assert list(ThrowSearch(problem, hf.Peg(0.545, -0.6, 0.03)).parametrizations) == [-1, 1]
    wide = ThrowSearch(problem, hf.Peg(0.0, -1.0, 0.6))
    with pytest.raises(InvalidInput, match="on either side"):
        wide.evolve_swings()


def test_a_rod_beside_the_peg_that_swings_through_it_strikes() -> None:
    """It is near the peg before, and has not left it."""
    base, length, peg = np.zeros((1, 3, 2)), np.array([1.0]), hf.Peg(0.0, -0.5, 0.001)
    for angles, strike in (([0.03, -0.03, -0.06], 1), ([0.03, 0.001, 0.03], 1), ([0.03, 0.02, 0.03], 0)):
        at, _, _ = first_contact(np.array(angles)[None, :, None], base, length, peg, 0.0)
        assert at[0] == strike


def test_a_search_that_is_nearly_over_gives_no_run_much_time() -> None:
    """On two threads."""
    assert run_budget(None, 2 / 60) == TIME_BUDGET  # without an end
    for left, members, each in ((60.0, 60, TIME_BUDGET), (6.0, 60, 2.0), (0.0, 60, MIN_BUDGET), (-5.0, 4, MIN_BUDGET)):
        given = run_budget(lambda left=left: left, 2 / members)  # type: ignore[misc]
        assert given.processor == pytest.approx(each)  # type: ignore[union-attr]
        assert given.left() == left  # type: ignore[union-attr]


def test_what_a_turning_rod_promises() -> None:
    """Straight, from the peg on, at the rate w: energy w^2 m s^2 / 6, and m g s / 2 (1 + cos q) lifts its centre."""
    peg, w, slope = hf.Peg(0.0, -1.0, 0.01), 4.0, 0.7
    q = np.where(np.arange(50) < 25, 0.0, slope)[None]  # the upper half hangs to the peg, the lower one is the tail
    qd = np.where(np.arange(50) < 25, 0.0, w)[None]
    ratio, turns = tail_energy(CAST_SETUP, peg, (q, qd), (np.zeros((1, 2)), np.zeros((1, 2))), np.array([25]))
    s = 1.0
    expected = (w**2 * s**2 / 6.0) / (9.81 * 0.5 * s * (1.0 + np.cos(slope)))
    assert ratio[0] == pytest.approx(expected, rel=1e-3)  # links as points: (1/25)^2 / 4 of the inertia is missing
    assert turns[0] == pytest.approx(s / (2.0 * np.pi * 0.0125))


def test_a_weight_at_the_tip_counts() -> None:
    heavy = Problem(CABLE.replace(tip_mass=1e5), CAST_SETUP.arm, CAST_SETUP.limits)
    peg, w = hf.Peg(0.0, -1.0, 0.01), 4.0
    q, qd = np.zeros((1, 50)), np.where(np.arange(50) < 25, 0.0, w)[None]
    ratio, _ = tail_energy(heavy, peg, (q, qd), (np.zeros((1, 2)), np.zeros((1, 2))), np.array([25]))
    assert ratio[0] == pytest.approx(0.5 * w**2 / (2.0 * 9.81), rel=1e-5)  # a point: the rope is 1e-6 of it


def test_strikes_are_those_of_the_swing_itself() -> None:
    """The state before the strike is that of a single run, and the rope is at the peg a sample later."""
    peg = hf.Peg(1.36 * np.sin(-0.66), -1.36 * np.cos(-0.66), 0.04)
    genes = ThrowParametrization(CAST_SETUP, -1)
    throws = [genes.throw(genes.centre())]
    found = simulated_strikes(CAST_SETUP, peg, throws)
    t = float(found.t[0])
    motion = throws[0].motion(CAST_SETUP.limits)
    run = hf.simulate(CABLE, motion, arm=CAST_SETUP.arm, duration=t + 0.02, t_eval=[t, t + 0.02], tol=1e-3)
    assert np.abs(found.q[0] - run.q[0]).max() < 0.05  # two runs at a tolerance of 1 mm
    links = run.joints[:, :-1] + 0.5 * np.diff(run.joints, axis=1)
    gap = np.hypot(links[..., 0] - peg.x, links[..., 1] - peg.y).min(axis=1) - 0.0425
    assert gap[0] > 0.0
    assert gap[1] < NEAR + 0.005  # the middles of links, 40 mm apart, and a tolerance of 1 mm


def test_what_strikes_nothing_is_told_by_its_distance() -> None:
    found = simulated_strikes(
        CAST_SETUP,
        hf.Peg(1.9, 1.9, 0.03),
        [ThrowParametrization(CAST_SETUP, 1).throw(ThrowParametrization(CAST_SETUP, 1).centre())],
    )
    assert np.isnan(found.t[0])
    assert found.score[0] < -1.0


def test_a_state_is_moved_to_other_links_along_the_rope() -> None:
    """Their joints lie on the rope's own links, and move as they do; as a check, by finite differences."""
    random = np.random.default_rng(8)
    rope, other = (hf.Rope.uniform(1.2, 0.06, count, 0.003) for count in (36, 8))
    q = np.cumsum(random.normal(0.0, 0.3, (5, 36)), axis=1) + 7.0
    qd = np.cumsum(random.normal(0.0, 2.0, (5, 36)), axis=1)

    def moved(q: np.ndarray) -> Strikes:
        given = Strikes(*np.zeros((4, 5)), q, qd, np.zeros(5, np.int64))
        return moved_to(given, rope, other)

    found, small = moved(q), 1e-6
    assert (moved(q + small * qd).q - moved(q - small * qd).q) / (2.0 * small) == pytest.approx(found.qd, abs=1e-5)
    first = (np.exp(1j * q[:, :4]).sum(axis=1) + 0.5 * np.exp(1j * q[:, 4])) / 30.0  # to its second joint, 0.15 m along
    assert np.exp(1j * found.q[:, 0]) * np.abs(first) == pytest.approx(first, abs=1e-12)
    middle = q[:, ((np.arange(8) + 0.5) * 4.5).astype(int)]
    assert np.abs(found.q - middle).max() < np.pi  # on the same turn


def test_links_cut_and_put_together_again_are_as_before() -> None:
    q, qd = np.random.default_rng(9).normal(0.0, 4.0, (2, 3, CAST_SETUP.rope.n_links))
    finer = CAST_SETUP.cut(3).rope
    given = Strikes(*np.zeros((4, 3)), np.repeat(q, 3, axis=1), np.repeat(qd, 3, axis=1), np.zeros(3, np.int64))
    found = moved_to(given, finer, CAST_SETUP.rope)
    assert found.q == pytest.approx(q, abs=1e-12)
    assert found.qd == pytest.approx(qd, abs=1e-9)
    assert moved_to(given, finer, finer) is given


def test_a_link_that_is_folded_has_the_direction_of_its_middle() -> None:
    rope, other = hf.Rope.uniform(1.0, 0.05, 4, 0.003), hf.Rope.uniform(1.0, 0.05, 1, 0.003)
    q, qd = np.array([[0.0, 0.0, np.pi, np.pi]]), np.array([[1.0, 2.0, 3.0, 4.0]])
    found = moved_to(Strikes(*np.zeros((4, 1)), q, qd, np.zeros(1, np.int64)), rope, other)
    assert (found.q[0, 0], found.qd[0, 0]) == (np.pi, 3.0)
