"""Until when a run agrees with tighter ones."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import simulation
from hyperflex.errors import InvalidInput

RODS = hf.Rope(length=[0.5, 0.4], mass=[0.2, 0.1])
HIGH = np.array([2.0, 2.5])


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


def test_a_run_says_until_when_it_agrees_with_tighter_ones():
    """Compared with runs at a hundredth of the tolerance, from which horizons are not computed.

    Of 130 other draws 89 were tangles; their horizons were 0.79 to 1.14 of when the runs part. No other one had any.
    """
    tangles = 0
    for number in range(20):
        setup = drawn(number)
        run, other = hf.simulate(setup), hf.simulate(setup.replace(tol=0.01 * setup.tol))
        when, until = parted(run, other), run.predictable_until
        assert when == until == math.inf or when / 1.5 < until < 1.5 * when
        assert (run.warning() == "") == (when == math.inf)
        tangles += when < math.inf
    assert 4 < tangles < 17


def test_a_tangle_says_so_and_a_right_run_does_not(tmp_path):
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
    with pytest.raises(InvalidInput, match="allowed"):
        wild.agrees_until(0.0)


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
    run = hf.simulate(RODS, duration=1.0, q0=HIGH, method="rk4", step=2e-3)
    half = hf.simulate(RODS, duration=1.0, q0=HIGH, method="rk4", step=1e-3)
    apart = np.linalg.norm(run.joints - half.joints, axis=2).max(axis=1)
    np.testing.assert_allclose(run.error_estimate, apart, rtol=1e-6)  # roundings: the last steps end a rounding apart
