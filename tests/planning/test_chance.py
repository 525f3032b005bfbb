"""Stated success: its interval, and draws of throws that are known to succeed and to fail."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.robust_page import probability_difference

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.model import with_links
from hyperflex.planning import Problem, SearchOptions, SuccessProbability, Uncertainty, estimate_success_probability
from hyperflex.planning.rollouts import RolloutBatch, WindingScores, winding_scores
from tests.planning.known import PEG, WINDS, planned, problem, simulated_strikes
from tests.planning.test_uncertainty import NONE
from tests.refusals import refuses

CAST_SETUP = problem()


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
    refuses("samples", estimate_success_probability, CAST_SETUP, PEG, WINDS, samples=0)


def test_without_samples_nothing_is_known():
    none = SuccessProbability(0, 0)
    assert np.isnan(none.estimate)
    assert none.interval == (0.0, 1.0)
    assert str(none) == "not estimated, no time was left"


def test_links_that_are_long_for_the_peg_are_cut_in_scenarios():
    """Links of 0.1 m, three of which meet round a peg of 42.5 mm: as they are, they do not wind."""
    long = replace(CAST_SETUP, rope=with_links(CAST_SETUP.rope, 20))
    assert estimate_success_probability(long, PEG, WINDS, NONE, samples=1).successes == 1


def test_an_executor_counts_the_same_samples():
    want = estimate_success_probability(CAST_SETUP, PEG, WINDS, samples=6)
    with ThreadPoolExecutor(2) as pool:
        for size in (None, 4):
            options = SearchOptions(executor=pool, chunk_size=size)
            found = estimate_success_probability(CAST_SETUP, PEG, WINDS, samples=6, options=options)
            assert (found.successes, found.samples) == (want.successes, 6)


def test_a_rope_that_comes_too_near_its_arm_while_it_winds_fails():
    (world,) = NONE.sample(1, CAST_SETUP, PEG)
    near, clear = (scenario_scores(each, [(WINDS, world)]) for each in (replace(CAST_SETUP, clearance=0.5), CAST_SETUP))
    assert near.turns[0] < 1.25 < clear.turns[0]
    assert near.score[0] < clear.score[0]
    assert np.isnan(simulated_strikes(replace(CAST_SETUP, clearance=0.5), PEG, [WINDS]).t[0])  # nor has it struck


def test_a_rope_that_touches_an_obstacle_before_its_strike_or_after_fails():
    run, (world,) = planned().run, NONE.sample(1, CAST_SETUP, PEG)
    x, strike = run.joints[..., 0], float(simulated_strikes(CAST_SETUP, PEG, [WINDS]).t[0])
    # Walls that the rope is 20 mm into at most: on the right before the strike alone, on the left after it alone
    right, left = float(x.max()) - 0.02, float(x.min()) + 0.02
    assert x[run.t > strike].max() < right - 0.1
    assert x[run.t < strike].min() > left + 0.01
    turns = []
    for wall in (hf.Ground(right, 0.0, -1.0, 0.0), hf.Ground(left, 0.0, 1.0, 0.0)):
        turns += scenario_scores(replace(CAST_SETUP, obstacles=[wall]), [(WINDS, world)]).turns.tolist()
    assert turns[0] == 0.0  # as without a strike
    assert 0.0 < turns[1] < 1.25


def test_successful_throws_and_throws_without_a_strike_are_distinguished():
    idle = replace(WINDS, ends=np.full(7, -1.5), rests=np.ones(7))
    worlds = Uncertainty().sample(2, CAST_SETUP, PEG, seed=3)
    found = scenario_scores(CAST_SETUP, [(throw, world) for throw in (WINDS, idle) for world in worlds])
    assert (found.turns >= 1.25).tolist() == [True, True, False, False]
    stated = estimate_success_probability(CAST_SETUP, PEG, idle, samples=2)
    assert (stated.successes, stated.samples) == (0, 2)
    assert "0 of 2" in str(stated)
