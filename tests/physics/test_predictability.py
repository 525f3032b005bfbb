"""How fast small errors grow, by closed forms and dense equations; until when a run agrees with tighter ones."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import simulation
from hyperflex.simulation.sensitivity import _displaced, _first_nudges
from tests.reference.arm import cast, links_of, still
from tests.refusals import refuses

MASS, COM, ABOUT_JOINT = 0.3, 0.4, 0.02 + 0.3 * 0.4**2
ROD = hf.Rope(length=[1.0], mass=[MASS], com=[COM], inertia=[0.02])
RODS = hf.Rope(length=[0.5, 0.4], mass=[0.2, 0.1])
HIGH = np.array([2.0, 2.5])


def test_an_upright_rod_falls_at_the_rate_of_its_saddle():
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
    rope, start, tiny, duration = RODS, np.concatenate([HIGH, np.zeros(2)]), 1e-6, 0.8

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


def test_errors_made_late_count_as_well():
    """A nudge that first shrinks to a tenth and then grows again: whatever is made in between grows eightfold."""
    found = hf.Predictability(np.array([0.0, 1.0, 2.0]), np.array([[1.0, 0.1, 1.0]]), np.array([[1.0, 0.1, 0.8]]), 1e-3)
    np.testing.assert_allclose(found.growth, [1.0, 0.1, 0.8], rtol=1e-15)
    np.testing.assert_allclose(found.amplification, [1.0, 1.0, 8.0], rtol=1e-15)
    # From 1 to 8 by powers: 2 after a third of the way. Rounding of logarithms.
    assert found.horizon(2e-3) == pytest.approx(1.0 + 1.0 / 3.0, rel=1e-12)
    assert found.exponent(1.0) == pytest.approx(math.log(10.0), rel=1e-12)


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
    refuses("duration is missing", hf.predictability, ROD)
    refuses("nudges", hf.predictability, setup, nudges=0)
    found = hf.predictability(setup, nudges=1)
    refuses("no time lies between", found.exponent, 0.5, 0.5)
    refuses("allowed", found.horizon, 0.0)


def drawn(number):
    """A rope of 2 to 40 links, with or without friction, that falls or is swung for 6 s; tolerances of 1 to 100 um."""
    rng = np.random.default_rng([54, number])
    friction = 0.0 if number % 2 else 10.0 ** rng.uniform(-6.0, -2.5)
    size = {"length": rng.uniform(0.3, 3.0), "mass": rng.uniform(0.02, 0.5), "n_links": int(rng.integers(2, 40))}
    swings = hf.arm_swings(t_move=rng.uniform(0.5, 0.9), t_rest=rng.uniform(0.2, 0.7))
    how = (
        {"q0": rng.uniform(0.3, 3.0)}
        if number % 3
        else {"motion": swings, "arm": hf.Arm(length=rng.uniform(0.05, 0.3))}
    )
    return hf.Setup(
        hf.Rope.uniform(**size, friction=friction), duration=6.0, tol=10.0 ** rng.uniform(-6.0, -4.0), **how
    )


def parted(run, other):
    """Time, s, at which a joint of one run is more than 1 % of the length from that of the other."""
    beyond = np.linalg.norm(run.joints - other.joints, axis=2).max(axis=1) > 0.01 * run.setup.rope.total_length
    return float(run.t[beyond.argmax()]) if beyond.any() else math.inf


def test_a_run_reports_until_when_it_agrees_with_tighter_ones():
    """Compared with runs at a hundredth of the tolerance, from which horizons are not computed.

    Of 130 other draws 89 were tangles; their horizons were 0.79 to 1.14 of when the runs part. No other one had any.
    """
    tangles = 0
    for number in range(10):
        setup = drawn(number)
        run, other = hf.simulate(setup), hf.simulate(setup.replace(tol=0.01 * setup.tol))
        when, until = parted(run, other), run.predictable_until
        assert when == until == math.inf or when / 1.5 < until < 1.5 * when
        assert (run.warning() == "") == (when == math.inf)
        tangles += when < math.inf
    assert 2 < tangles < 9


def test_a_tangle_reports_it_and_a_right_run_does_not(tmp_path):
    cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    how = {"motion": hf.arm_swings(), "arm": hf.Arm(length=0.105), "duration": 6.0}
    tame, wild = hf.simulate(cable, **how), hf.simulate(cable.replace(friction=0.0), **how)
    assert (str(tame), tame.predictable_until) == (repr(tame), math.inf)
    assert str(wild).endswith(f"not predictable after {wild.predictable_until:.4g} s, {wild.warning().split(', ')[1]}")
    assert wild.success
    # Few samples, a continued run, and files: the second run begins where the first one began.
    late = hf.simulate(wild.setup, t_eval=[0.5, 6.0])
    late.to_netcdf(tmp_path / "run.nc")
    again = hf.read_trajectory(tmp_path / "run.nc")
    assert again.predictable_until == late.predictable_until == 0.5
    np.testing.assert_array_equal(again.error_estimate, wild.error_estimate[[50, 600]])
    rest = hf.simulate(wild.setup.replace(duration=1.0), state=wild.state)
    assert rest.predictable_until > 6.0
    assert hf.simulate(wild.setup, t_eval=[6.0]).predictable_until == 0.0
    refuses("allowed", wild.agrees_until, 0.0)


def test_where_no_tighter_run_can_be_made_a_run_is_not_vouched_for(monkeypatch):
    setup = hf.Setup(RODS, q0=HIGH, duration=1.0)
    run, part = hf.simulate(setup), hf.simulate(setup.replace(duration=0.5))
    monkeypatch.setattr(simulation, "tighter_run", lambda _: part)
    assert run.predictable_until == 0.5
    assert run.warning().endswith("a run with a tenth of the tolerance fails or takes too long")


def test_a_run_in_contact_shows_its_error_as_well():
    rope = hf.Rope.uniform(length=1.0, mass=0.06, n_links=20, radius=0.0025, friction=2e-4)
    run = hf.simulate(rope, q0=2.0, duration=1.0, pegs=[hf.Peg(0.0, -0.5, 0.02)])
    assert np.abs(run.contact_force).sum() > 0.0
    assert (run.predictable_until, run.warning()) == (math.inf, "")
    finer = hf.simulate(run.setup.replace(tol=0.1 * run.setup.tol, contact_step=0.5 * run.setup.contact_step))
    apart = np.linalg.norm(run.joints - finer.joints, axis=2).max(axis=1)
    np.testing.assert_allclose(run.error_estimate, apart, rtol=1e-3, atol=1e-9)  # roundings grow in contact
    assert 1e-6 < apart[-1] < 2e-3


def test_steps_without_a_tolerance_are_halved():
    run = hf.simulate(RODS, duration=1.0, q0=HIGH, step=2e-3)
    half = hf.simulate(RODS, duration=1.0, q0=HIGH, step=1e-3)
    apart = np.linalg.norm(run.joints - half.joints, axis=2).max(axis=1)
    np.testing.assert_allclose(run.error_estimate, apart, rtol=1e-6)  # roundings: the last steps end a rounding apart
