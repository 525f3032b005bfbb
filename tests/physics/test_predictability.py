"""How fast small errors grow: closed forms, and the same question put to the dense equations of motion."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.simulation.sensitivity import _displaced, _first_nudges
from tests.reference.arm import cast, links_of, still

MASS, COM, ABOUT_JOINT = 0.3, 0.4, 0.02 + 0.3 * 0.4**2
ROD = hf.Rope(length=[1.0], mass=[MASS], com=[COM], inertia=[0.02])
RODS = hf.Rope(length=[0.5, 0.4], mass=[0.2, 0.1])
HIGH = np.array([2.0, 2.5])


def test_a_rod_that_stands_on_its_head_falls_at_the_rate_of_its_saddle():
    found = hf.predictability(ROD, duration=3.0, q0=[np.pi])
    exact = math.sqrt(MASS * 9.81 * COM / ABOUT_JOINT)
    # From 1 s on the falling part is e^(2 * 4.2) = 4000 times the other.
    assert found.exponent(begin=1.0) == pytest.approx(exact, rel=1e-3)
    assert found.growth[-1] == pytest.approx(0.5 * math.exp(exact * 3.0), rel=1.0)  # at most twice, from both halves


def test_a_damped_pendulum_forgets():
    eta = 0.05
    decay = eta / ABOUT_JOINT / 2.0
    period = 2.0 * np.pi / math.sqrt(MASS * 9.81 * COM / ABOUT_JOINT - decay**2)
    found = hf.predictability(ROD.replace(friction=[eta]), duration=4.0 * period, sample_time=period / 24)
    # A whole number of periods apart a nudge has the same phase. The runs' own errors are 0.03 % of the nudge in each
    # of 72 stretches: 2 % over 4.5 s, or 0.005 /s.
    assert found.exponent(period, 4.0 * period) == pytest.approx(-decay, abs=0.005)
    assert found.amplification[-1] < 2.0
    assert found.horizon(1e-3) == math.inf


def test_growth_is_that_of_the_dense_equations():
    """Nudge each angle and rate alone in Dormand and Prince's method; put the same random nudges together from that."""
    rope, start, tiny, duration = RODS, np.concatenate([HIGH, np.zeros(2)]), 1e-6, 1.5

    def end(state):
        return cast(links_of(rope), 0.0, still(duration), state[:2], state[2:], tol=1e-12)[-1]

    straight = end(start)
    spread = np.array([(end(start + tiny * e) - end(start - tiny * e)) / (2.0 * tiny) for e in np.eye(4)]).T
    found = hf.predictability(rope, duration=duration, q0=HIGH, nudges=3, seed=5)
    setup = hf.Setup(rope, duration=duration, q0=HIGH)
    for m, nudge in enumerate(_first_nudges(setup, 3, np.random.default_rng(5))):
        moved, hastened = _displaced(setup, straight[:2], (spread @ nudge.ravel()).reshape(2, 2))
        # Derivatives of a run with a tolerance of 1e-9, and differences of 1e-6 of another.
        assert found.size[m, -1] == pytest.approx(max(moved, hastened), rel=1e-4)
        assert found.displacement[m, -1] == pytest.approx(moved, rel=1e-4)


def test_long_chaos_neither_saturates_nor_stops():
    """Over 20 s errors grow more than any run could show at once; each half grows at about the rate of the whole."""
    found = hf.predictability(RODS, duration=20.0, q0=HIGH)
    assert found.growth[-1] > 1e8
    # Finite-time exponents scatter: a factor of two.
    assert 0.5 < found.exponent(10.0, 20.0) / found.exponent() < 2.0


@pytest.mark.parametrize("late", [0.0, 0.5, 0.9])
def test_an_error_of_tol_stays_within_bounds_up_to_the_horizon(late):
    tol, allowed = 1e-6, 1e-4
    horizon = hf.predictability(RODS, duration=4.0, q0=HIGH, tol=tol).horizon(allowed)
    assert 0.9 < horizon < 4.0
    t = [late, horizon] if late > 0.0 else [horizon]
    run = hf.simulate(RODS, duration=4.0, q0=HIGH, tol=1e-10, t_eval=t)
    q, qd = (run.q[0], run.qd[0]) if late > 0.0 else (HIGH, np.zeros(2))
    for change in ([1.0, -1.0], [1.0, 0.5], [0.2, 1.0]):
        nudged = np.array(change) * tol / 0.9  # the tip is at most 0.9 m away, so it moves by tol at most
        state = hf.State(late, q + nudged, qd)
        other = hf.simulate(RODS, duration=4.0 - late, state=state, tol=1e-10, t_eval=[horizon])
        # The worst of three random nudges is within some tens of percent of the worst there is.
        assert np.linalg.norm(other.tip - run.tip[-1:], axis=1).max() < 1.5 * allowed


@pytest.mark.parametrize(("friction", "tame"), [(5e-4, True), (0.0, False)])
def test_friction_makes_the_papers_cast_predictable(friction, tame):
    cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=friction)
    found = hf.predictability(cable, hf.arm_swings(), arm=hf.Arm(length=0.105), duration=6.0)
    # Measured: 6 with friction, over 15 s; without it more than 1e6 in 5 s. The bounds are far from both.
    assert (found.amplification[-1] < 50.0) == tame
    assert (found.amplification[-1] > 1e5) == (not tame)
    assert (found.horizon(1e-3) == math.inf) == tame


def test_errors_made_late_count_as_well():
    """A nudge that first shrinks to a tenth and then grows again: whatever is made in between grows eightfold."""
    found = hf.Predictability(np.array([0.0, 1.0, 2.0]), np.array([[1.0, 0.1, 1.0]]), np.array([[1.0, 0.1, 0.8]]), 1e-3)
    np.testing.assert_allclose(found.growth, [1.0, 0.1, 0.8], rtol=1e-15)
    np.testing.assert_allclose(found.amplification, [1.0, 1.0, 8.0], rtol=1e-15)
    # From 1 to 8 by powers: 2 after a third of the way. Rounding of logarithms.
    assert found.horizon(2e-3) == pytest.approx(1.0 + 1.0 / 3.0, rel=1e-12)
    assert found.exponent(1.0) == pytest.approx(math.log(10.0), rel=1e-12)


def test_horizons_grow_with_what_is_allowed():
    found = hf.predictability(RODS, duration=3.0, q0=HIGH, tol=1e-5)
    horizons = [found.horizon(allowed) for allowed in (1e-6, 1e-5, 1e-4, 1e-3, 1e6)]
    assert horizons == sorted(horizons)
    assert horizons[0] == 0.0
    assert horizons[-1] == math.inf


def test_a_torque_driven_arm_is_a_link_like_any_other():
    arm = hf.Arm(length=0.5, inertia=0.2 * 0.5**2 / 12, mass=0.2, com=0.25)
    rope = hf.Rope(length=[0.4], mass=[0.1])
    setup = hf.Setup(rope, arm=arm, torque=hf.torque_profile([0.0, 1.0], [0.0, 0.0]), arm_angle0=2.0, q0=[2.5])
    driven = hf.predictability(setup, duration=3.0)
    alone = hf.predictability(RODS, duration=3.0, q0=HIGH)
    # The same two rods; the unit is that of another length and the nudges are others, so by a factor of some: 1 /s.
    assert driven.exponent() == pytest.approx(alone.exponent(), abs=1.0)
    assert driven.growth[-1] > 20.0


def test_what_cannot_be_measured_is_refused():
    setup = hf.Setup(ROD, duration=1.0)
    with pytest.raises(InvalidInput, match="duration is missing"):
        hf.predictability(ROD)
    with pytest.raises(InvalidInput, match="nudges"):
        hf.predictability(setup, nudges=0)
    found = hf.predictability(setup, nudges=1)
    with pytest.raises(InvalidInput, match="no time lies between"):
        found.exponent(0.5, 0.5)
    with pytest.raises(InvalidInput, match="allowed"):
        found.horizon(0.0)
