"""Sampled scenarios: their spread, their validity, and the motor's motion in them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import files
from hyperflex.errors import InvalidInput
from hyperflex.motion import arm_moves
from hyperflex.planning import MotorLimits, Moves, Problem, Uncertainty
from hyperflex.planning.uncertainty import MOVES, Scenario, scaled_rope
from tests.refusals import refuses

ROPE = hf.Rope.uniform(length=1.0, mass=0.1, n_links=6, radius=0.003, friction=1e-3, tip_mass=0.02)
CAST_SETUP = Problem(ROPE, hf.Arm(length=0.1), MotorLimits())
PEG = hf.Peg(0.5, -0.6, 0.03, 0.3)
NONE = Uncertainty(length=0.0, mass=0.0, friction=0.0, mu=0.0, lag=0.0, timing=0.0, tilt=0.0)
THROW = Moves(-1, np.array([1.43, -1.07, 1.93, 0.0]), np.array([0.1, 0.3, 0.0, 0.2]), np.array([1.0, 1.0, 1.0, 0.5]))


def test_the_spread_is_as_requested_and_nothing_becomes_negative():
    wide = Uncertainty(length=0.05, mass=0.1, friction=0.6, mu=0.3, lag=0.02, timing=0.005)
    draws = wide.sample(1500, CAST_SETUP, PEG)
    seen = {
        "length": [d.rope.total_length for d in draws],
        "mass": [d.rope.total_mass / 0.12 for d in draws],
        "friction": [d.rope.friction[2] / 1e-3 for d in draws],
        "mu": [d.peg.mu / 0.3 for d in draws],
    }
    for name, values in seen.items():
        std = getattr(wide, name)
        # 1500 draws tell a mean within 0.026 std and a deviation within 2 %, a skew one within 4 %: three of each.
        assert np.std(values) == pytest.approx(std, rel=0.12), name
        assert np.mean(values) == pytest.approx(1.0, abs=0.08 * std), name
        assert min(values) > 0.0
    lags = [d.lag for d in draws]
    assert min(lags) >= 0.0
    assert np.sqrt(np.mean(np.square(lags))) == pytest.approx(0.02, rel=0.1)
    assert np.std([d.delays for d in draws]) == pytest.approx(0.005, rel=0.03)


def test_a_draw_is_the_same_whatever_their_number_and_another_with_another_seed():
    few, many, other = (Uncertainty().sample(n, CAST_SETUP, PEG, seed=s) for n, s in ((2, 5), (4, 5), (2, 6)))
    assert few[1].rope == many[1].rope
    assert few[1].peg == many[1].peg
    assert few[1].rope != other[1].rope
    assert few[0].rope != few[1].rope


def test_a_scaled_rope_swings_as_its_length_says():
    """Without friction the shape of a swing depends on length alone: its time goes with the root."""
    free = ROPE.replace(friction=0.0)
    longer = scaled_rope(free, 1.21, 1.7, 1.0)
    start = np.full(6, 0.3)
    one = hf.simulate(free, duration=1.0, q0=start, t_eval=[1.0], tol=1e-9)
    two = hf.simulate(longer, duration=1.1, q0=start, t_eval=[1.1], tol=1e-9)
    np.testing.assert_allclose(two.q, one.q, atol=1e-6)  # tol of 1e-9 m, some hundred times that after a second


def test_without_uncertainty_the_motor_follows_its_command():
    (draw,) = NONE.sample(1, CAST_SETUP, PEG)
    assert draw.executed_motion(THROW.motion(CAST_SETUP.limits)) == THROW.motion(CAST_SETUP.limits)
    assert draw.rope == ROPE


def test_moves_start_late_but_not_before_the_last_one_has_ended():
    asked = THROW.motion(CAST_SETUP.limits)
    late = np.zeros(MOVES)
    late[:4] = [-0.5, 0.03, -0.02, 0.0]  # the third move has no rest before it; it cannot be early
    done = Scenario(ROPE, PEG, 0.0, late).executed_motion(asked)
    rests, times = np.array(asked.spec["rests"]), np.array(asked.spec["durations"])
    starts = np.cumsum(rests) + np.cumsum(times) - times
    new = np.array(done.spec["rests"])
    begun = np.cumsum(new) + np.cumsum(times) - times
    ended = begun + times
    np.testing.assert_allclose(begun, [0.0, starts[1] + 0.03, ended[1], starts[3]], atol=1e-12)
    assert done.spec["angles"] == asked.spec["angles"]
    settles = Scenario(ROPE, PEG, 0.0, late).executed_motion(THROW.waiting(1.5).motion(CAST_SETUP.limits))
    assert settles.end == pytest.approx(done.end + 1.5)
    assert settles.rate(settles.end - 1.0) == 0.0


def test_a_lag_makes_the_arm_late():
    asked = THROW.motion(CAST_SETUP.limits)
    done = Scenario(ROPE, PEG, 0.01, np.zeros(MOVES)).executed_motion(asked)
    t = np.linspace(0.3, 0.6, 7)  # during the first stroke: late by the lag, except for the effect of its acceleration
    behind = (asked.angle(t) - done.angle(t)) / asked.rate(t)
    np.testing.assert_allclose(behind, 0.01, rtol=0.15)
    refuses("not made of moves", Scenario(ROPE, PEG, 0.0, np.zeros(MOVES)).executed_motion, hf.hold_arm(0.0))
    with pytest.raises(InvalidInput, match="not made of moves"):
        Scenario(ROPE, PEG, 0.0, np.zeros(MOVES)).executed_motion(arm_moves([0.0, 1.0], [0.1], [0.5]).shifted(0.1))


def test_ropes_are_drawn_from_a_fit_and_the_rest_as_usual():
    told = {"std": {"friction": np.full(6, 2e-4)}, "values": {}}
    told |= {"covariance": np.array([[4e-8]]), "length_covariance": np.zeros(2)}
    fit = SimpleNamespace(rope=ROPE, parameters=("friction:shared",), **told)
    known = Uncertainty.from_identification(fit)
    assert Uncertainty.from_identification(fit, length=0.02).length == 0.02
    assert (known.length, known.mass, known.friction, known.mu) == (0.0, 0.0, 0.0, Uncertainty().mu)
    draws = known.sample(1500, CAST_SETUP, PEG)
    assert np.std([d.rope.friction[0] for d in draws]) == pytest.approx(2e-4, rel=0.06)  # 3 deviations of one from 1500
    assert all(d.rope.total_length == ROPE.total_length for d in draws[:9])
    assert np.std([d.peg.mu for d in draws]) == pytest.approx(0.03, rel=0.06)
    for other in (hf.Rope.uniform(length=1.0, mass=0.1, n_links=5, friction=0.0), scaled_rope(ROPE, 0.8, 1.0, 1.0)):
        refuses("of another rope", known.sample, 1, replace(CAST_SETUP, rope=other), PEG)
    thick = replace(CAST_SETUP, rope=ROPE.replace(radius=2.0 * ROPE.radius + 1e-3))
    (drawn,) = known.sample(1, thick, PEG, seed=np.int64(3))
    assert drawn.rope.radius == thick.rope.radius
    refuses("no RopePosterior", Uncertainty, posterior=fit)


def test_a_rope_file_tells_what_it_can_and_the_rest_is_as_usual(tmp_path):
    ROPE.to_toml(tmp_path / "plain.toml")
    usual = Uncertainty.from_rope_file(tmp_path / "plain.toml")
    assert usual.describe() == Uncertainty().describe()
    assert "typical of an identification" in usual.describe()
    assert "length 1 %, mass 2 %, friction 20 %, mu 10 %, lag 10 ms, timing 2 ms, tilt 1 degrees" in usual.describe()
    told = {"parameters": ["length[0]", "tip_mass"], "covariance": [[1e-6, 0.0], [0.0, 1e-8]], "values": {}}
    files.write_toml(tmp_path / "fitted.toml", {"rope": ROPE.table(), "identification": told})
    known = Uncertainty.from_rope_file(tmp_path / "fitted.toml")
    assert (known.length, known.mass, known.friction) == (0.0, 0.02, 0.2)
    assert known.describe().startswith("length, tip_mass by the covariance in the rope's file; typical")
    assert "length 1 %" not in known.describe()
    assert np.std([d.rope.length[0] for d in known.sample(500, CAST_SETUP, PEG)]) == pytest.approx(1e-3, rel=0.1)


def test_what_a_fit_could_not_tell_is_as_uncertain_as_usual(tmp_path):
    """A length that did not show and whose row of the covariance is 0: not known exactly, but not at all."""
    told = {"parameters": ["length:factor", "friction:shared"], "covariance": [[0.0, 0.0], [0.0, 4e-8]]}
    told |= {"values": {"length:factor": 1.0}, "std": {"length:factor": "unknown", "friction": [2e-4] * 6}}
    files.write_toml(tmp_path / "fitted.toml", {"rope": ROPE.table(), "identification": told})
    known = Uncertainty.from_rope_file(tmp_path / "fitted.toml")
    assert (known.length, known.mass, known.friction) == (0.01, 0.0, 0.0)
    assert "not fully determined by the fit: length; typical of an identification: length 1 %" in known.describe()
    draws = known.sample(500, CAST_SETUP, PEG)
    assert np.std([d.rope.total_length for d in draws]) == pytest.approx(0.01, rel=0.1)  # 3 deviations of one from 500


def test_a_target_that_is_not_quite_in_its_place():
    draws = replace(NONE, place=0.01).sample(400, CAST_SETUP, PEG)
    off = np.array([[d.peg.x - PEG.x, d.peg.y - PEG.y] for d in draws])
    np.testing.assert_allclose(off.std(axis=0), 0.01, rtol=0.1)  # 400 draws tell it within 3.5 %
    assert abs(np.corrcoef(off.T)[0, 1]) < 0.15
    assert NONE.sample(1, CAST_SETUP, PEG)[0].peg == PEG
    assert "place 10 mm" in replace(NONE, place=0.01).describe()
