"""Sampled scenarios: their spread, ropes drawn from what a fit says, and how often a throw succeeds in them."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.robust_page import probability_difference

import hyperflex as hf
from hyperflex import files
from hyperflex.budget import Budget
from hyperflex.errors import InvalidInput
from hyperflex.model import divided, with_links
from hyperflex.motion import arm_moves
from hyperflex.planning import (
    MotorLimits,
    Moves,
    Problem,
    SearchOptions,
    SuccessProbability,
    Uncertainty,
    estimate_success_probability,
)
from hyperflex.planning.rollouts import RolloutBatch, WindingScores, winding_scores
from hyperflex.planning.uncertainty import MOVES, RopePosterior, Scenario, scaled_rope
from tests.planning.known import PEG as POST
from tests.planning.known import WINDS, planned, problem, simulated_strikes
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


LINKS = hf.Rope.uniform(length=1.0, mass=0.1, n_links=4, radius=0.003, friction=1e-3, stiffness=2e-3, tip_mass=0.02)
COUNT = 1500  # draws: a deviation is determined within 1.8 %, a covariance within some 4 % of the product of deviations


def fitted(covariance: list[list[float]], *labels: str, **factors: float) -> RopePosterior:
    return RopePosterior(
        LINKS, labels, np.array(covariance), {f"{name}:factor": value for name, value in factors.items()}
    )


def drawn_ropes(one: RopePosterior, count: int = COUNT) -> list[hf.Rope]:
    return [one.sample(np.random.default_rng([1, m])) for m in range(count)]


def test_what_hangs_together_is_drawn_together():
    covariance = np.array([[4e-8, 3e-8], [3e-8, 4e-8]])
    drawn = drawn_ropes(fitted(covariance.tolist(), "friction[1]", "stiffness:shared"))
    x = np.array([[rope.friction[1], rope.stiffness[3]] for rope in drawn])
    np.testing.assert_allclose(np.cov(x.T), covariance, rtol=0.15)
    np.testing.assert_allclose(x.mean(axis=0), [1e-3, 2e-3], rtol=0.02)
    assert all(rope.friction[0] == 1e-3 for rope in drawn[:9])  # link 0 was not fitted
    assert all(np.ptp(rope.stiffness[1:]) == 0.0 for rope in drawn[:9])


def test_factors_and_tapers_act_on_all_links():
    """A factor fitted as 2 +- 0.2 leaves a rope whose friction is known within 10 %."""
    drawn = drawn_ropes(fitted([[0.04]], "friction:factor", friction=2.0))
    assert np.std(np.log([rope.friction[2] / 1e-3 for rope in drawn])) == pytest.approx(0.1, rel=0.06)
    drawn = drawn_ropes(fitted([[0.09]], "friction:taper"))
    growth = [np.log(rope.friction[3] / rope.friction[1]) for rope in drawn]  # half the rope apart
    assert np.std(growth) == pytest.approx(0.15, rel=0.06)


def test_masses_stay_above_0_and_friction_does_not_fall_below():
    drawn = drawn_ropes(fitted([[1e-3, 0, 0], [0, 1e-5, 0], [0, 0, 1e-3]], "mass[0]", "friction:shared", "tip_mass"))
    assert min(rope.mass[0] for rope in drawn) > 0.0
    assert min(rope.friction[0] for rope in drawn) == 0.0
    assert min(rope.tip_mass for rope in drawn) == 0.0


def test_what_is_known_of_several_stays_known_where_one_meets_its_bound():
    """A link's own inertia poorly determined, its inertia about the joint well determined: half of the draws are
    clipped."""
    rod = hf.Rope(length=[0.3], mass=[0.1], com=[0.15], inertia=[1e-5])
    root = np.array([[4e-5, 0.0], [-4e-5 / 0.03, 1e-6 / 0.03]])  # J = I + m a^2, dJ = dI + 0.03 kg m da
    one = RopePosterior(rod, ("inertia[0]", "com[0]"), root @ root.T, {})
    drawn = drawn_ropes(one, 400)
    assert 0.3 < np.mean([rope.inertia[0] < 1e-15 for rope in drawn]) < 0.5  # below -0.25 standard deviations: 40 %
    moments = np.array([rope.inertia[0] + rope.mass[0] * rope.com[0] ** 2 for rope in drawn]) - 2.26e-3
    # second order adds m da^2, 2e-7 on average; each drawn number cut for itself leaves 2e-5
    assert np.std(moments) == pytest.approx(1e-6, rel=0.15)
    assert abs(np.mean(moments)) < 4e-7


def test_a_drawn_length_leaves_a_rope_that_can_be_cut():
    (one,) = drawn_ropes(fitted([[1e-4]], "length:factor", length=1.0), 1)
    assert divided(one, 2).n_links == 8
    np.testing.assert_allclose(one.inertia, 0.025 * (3.0 * 0.003**2 + one.length**2) / 12.0, rtol=1e-12)
    assert one.total_length != LINKS.total_length
    (one,) = drawn_ropes(fitted([[1e-4, 0], [0, 1e-9]], "length:factor", "com[1]", length=1.0), 1)
    np.testing.assert_allclose(np.delete(one.com / one.length, 1), 0.5, rtol=1e-12)  # as in the fit, link by link
    assert abs(one.com[1] - 0.125) < 5 * 3.2e-5


@pytest.mark.parametrize(
    ("std", "row", "unknown"),
    [
        ({"friction": np.array([0.0, 1e-4, np.inf, 0.0])}, 1e-8, ("friction[2]",)),
        ({"friction": [0.0, "unknown", 1e-4, 0.0]}, 1e-8, ("friction[1]",)),
        ({"friction": [0.0, 1e-4, 1e-4, 0.0]}, 0.0, ("friction[2]",)),
        ({}, 1e-8, ()),
    ],
)
def test_what_a_fit_could_not_tell_is_known(std, row, unknown):
    """An infinite deviation, its text in a file, or a row of 0: the possible descriptions of an omitted direction."""
    names = ("friction[1]", "friction[2]")
    fit = SimpleNamespace(
        rope=LINKS, parameters=names, covariance=np.diag([1e-8, row]), values={}, std=std, length_covariance=np.zeros(3)
    )
    found = RopePosterior.from_identification(fit)
    assert found.undetermined == unknown
    assert found.undetermined_properties == (("friction",) if unknown else ())


def test_what_is_none_of_the_rope_s_is_left():
    one = fitted([[1e-4, 0], [0, 1.0]], "gravity_angle", "delay")
    assert drawn_ropes(one, 2) == [LINKS, LINKS]
    assert one.fitted_properties == ()


def test_a_file_contains_the_findings_of_the_fit(tmp_path):
    told = {"parameters": ["friction:factor", "mass[2]"], "covariance": [[0.04, 1e-5], [1e-5, 1e-6]]}
    told |= {"length_covariance": [1e-3, 1e-6, 1e-4], "values": {"friction:factor": 2.0, "mass": LINKS.mass.tolist()}}
    arrays = {name: np.array(told[name]) for name in ("covariance", "length_covariance")}
    values = {name: np.array(value) for name, value in told["values"].items()}
    std = {"friction:factor": np.array(0.2), "mass": np.array([0.0, 0.0, 1e-3, 0.0])}
    fit = SimpleNamespace(rope=LINKS, parameters=tuple(told["parameters"]), values=values, std=std, **arrays)
    path = tmp_path / "rope.toml"
    files.write_toml(path, {"rope": LINKS.table(), "identification": told})
    read = RopePosterior.from_toml(path)
    assert drawn_ropes(read, 5) == drawn_ropes(RopePosterior.from_identification(fit), 5)
    assert read.fitted_properties == ("friction", "mass", "length")
    lengths = np.log([rope.total_length for rope in drawn_ropes(read, 400)])
    assert np.std(lengths) == pytest.approx(0.01, rel=0.15)  # 400 draws tell it to 3.5 %
    LINKS.to_toml(path)
    assert RopePosterior.from_toml(path) is None
    for wrong in ({"values": {}}, {"covariance": [[1.0]]}, {"covariance": [["a", 1.0], [1.0, 1.0]]}):
        files.write_toml(path, {"rope": LINKS.table(), "identification": told | wrong})
        with pytest.raises(InvalidInput):
            RopePosterior.from_toml(path)


WOUND = problem()


def scenario_scores(problem: Problem, pairs: list) -> WindingScores:
    """Return the scores of moves in scenarios."""
    motions = [scenario.executed_motion(moves.motion(problem.limits)) for moves, scenario in pairs]
    ropes, pegs = [each.rope for _, each in pairs], [each.peg for _, each in pairs]
    return winding_scores(problem, RolloutBatch.from_start(problem, ropes, pegs, motions), Budget())


def test_the_interval_is_wilsons():
    """In closed form, by the 97.5 % quantile of the normal distribution."""
    found, part, z = SuccessProbability(17, 40), 17 / 40, 1.959964
    middle, half = part + z**2 / 80.0, z * np.sqrt(part * (1.0 - part) / 40.0 + z**2 / 6400.0)
    assert found.estimate == part
    assert found.interval == pytest.approx([(middle + sign * half) / (1.0 + z**2 / 40.0) for sign in (-1.0, 1.0)])


@pytest.mark.parametrize(
    ("one", "other", "interval"),
    [
        ((56, 70), (48, 80), (0.0524, 0.3339)),
        ((9, 10), (3, 10), (0.1705, 0.8090)),
        ((5, 56), (0, 29), (-0.0381, 0.1926)),
        ((0, 10), (0, 20), (-0.1611, 0.2775)),
        ((10, 10), (0, 20), (0.6791, 1.0)),
    ],
)
def test_the_interval_of_a_difference_is_newcombes(one, other, interval):
    """As printed in Newcombe (1998), Statistics in Medicine 17, 873, table II, method 10."""
    assert probability_difference(SuccessProbability(*one), SuccessProbability(*other)) == pytest.approx(
        interval, abs=5.1e-5
    )  # printed to four digits


def test_what_is_no_count_is_refused():
    for won, draws in ((2, 1), (-1, 4), (1, 0)):
        refuses("successes", SuccessProbability, won, draws)
    refuses("samples", estimate_success_probability, WOUND, POST, WINDS, samples=0)


def test_without_samples_nothing_is_known():
    none = SuccessProbability(0, 0)
    assert np.isnan(none.estimate)
    assert none.interval == (0.0, 1.0)
    assert str(none) == "not estimated, no time was left"


def test_links_that_are_long_for_the_peg_are_cut_in_scenarios():
    """Links of 0.1 m, three of which meet round a peg of 42.5 mm: as they are, they do not wind."""
    long = replace(WOUND, rope=with_links(WOUND.rope, 20))
    assert estimate_success_probability(long, POST, WINDS, NONE, samples=1).successes == 1


def test_an_executor_counts_the_same_samples():
    want = estimate_success_probability(WOUND, POST, WINDS, samples=6)
    with ThreadPoolExecutor(2) as pool:
        for size in (None, 4):
            options = SearchOptions(executor=pool, chunk_size=size)
            found = estimate_success_probability(WOUND, POST, WINDS, samples=6, options=options)
            assert (found.successes, found.samples) == (want.successes, 6)


def test_a_rope_that_comes_too_near_its_arm_while_it_winds_fails():
    (world,) = NONE.sample(1, WOUND, POST)
    near, clear = (scenario_scores(each, [(WINDS, world)]) for each in (replace(WOUND, clearance=0.5), WOUND))
    assert near.turns[0] < 1.25 < clear.turns[0]
    assert near.score[0] < clear.score[0]
    assert np.isnan(simulated_strikes(replace(WOUND, clearance=0.5), POST, [WINDS]).t[0])  # nor has it struck


def test_a_rope_that_touches_an_obstacle_before_its_strike_or_after_fails():
    run, (world,) = planned().run, NONE.sample(1, WOUND, POST)
    x, strike = run.joints[..., 0], float(simulated_strikes(WOUND, POST, [WINDS]).t[0])
    # Walls that the rope is 20 mm into at most: on the right before the strike alone, on the left after it alone
    right, left = float(x.max()) - 0.02, float(x.min()) + 0.02
    assert x[run.t > strike].max() < right - 0.1
    assert x[run.t < strike].min() > left + 0.01
    turns = []
    for wall in (hf.Ground(right, 0.0, -1.0, 0.0), hf.Ground(left, 0.0, 1.0, 0.0)):
        turns += scenario_scores(replace(WOUND, obstacles=[wall]), [(WINDS, world)]).turns.tolist()
    assert turns[0] == 0.0  # as without a strike
    assert 0.0 < turns[1] < 1.25


def test_successful_throws_and_throws_without_a_strike_are_distinguished():
    idle = replace(WINDS, ends=np.full(7, -1.5), rests=np.ones(7))
    worlds = Uncertainty().sample(2, WOUND, POST, seed=3)
    found = scenario_scores(WOUND, [(throw, world) for throw in (WINDS, idle) for world in worlds])
    assert (found.turns >= 1.25).tolist() == [True, True, False, False]
    stated = estimate_success_probability(WOUND, POST, idle, samples=2)
    assert (stated.successes, stated.samples) == (0, 2)
    assert "0 of 2" in str(stated)
