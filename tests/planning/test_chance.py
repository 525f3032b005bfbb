"""Stated success: its interval against scipy's, and draws of throws that are known to win and to lose."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.robust_page import probability_difference
from scipy.stats import binomtest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.planning import SuccessProbability, Uncertainty, estimate_success_probability
from hyperflex.planning.problem import MIN_TURNS
from hyperflex.planning.robust import scenario_rollouts
from hyperflex.planning.robust.scenario_rollouts import first_strikes, nominal_strike_times, scenario_scores
from hyperflex.planning.search.contact_phase import WindingScores
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.simulation import Deadline
from tests.planning.known import contact_scores, planned, simulated_strikes
from tests.planning.test_landing import CAST_SETUP, PEG, WINDS
from tests.planning.test_uncertainty import NONE


@pytest.mark.parametrize(("won", "draws"), [(0, 1), (1, 1), (0, 40), (40, 40), (1, 40), (17, 40), (333, 1000)])
def test_the_interval_is_wilsons(won: int, draws: int) -> None:
    reference = binomtest(won, draws).proportion_ci(0.95, method="wilson")
    found = SuccessProbability(won, draws)
    assert found.estimate == won / draws
    np.testing.assert_allclose(found.interval, (reference.low, reference.high), atol=1e-12)  # rounding


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
def test_the_interval_of_a_difference_is_newcombes(
    one: tuple[int, int], other: tuple[int, int], interval: tuple[float, float]
) -> None:
    """As printed in Newcombe (1998), Statistics in Medicine 17, 873, table II, method 10."""
    assert probability_difference(SuccessProbability(*one), SuccessProbability(*other)) == pytest.approx(
        interval, abs=5.1e-5
    )  # printed to four digits


def test_what_is_no_count_is_refused() -> None:
    for won, draws in ((2, 1), (-1, 4), (1, 0)):
        with pytest.raises(InvalidInput):
            SuccessProbability(won, draws)
    with pytest.raises(InvalidInput, match="samples"):
        estimate_success_probability(CAST_SETUP, PEG, WINDS, samples=0)


def test_without_samples_nothing_is_known() -> None:
    none = SuccessProbability(0, 0)
    assert np.isnan(none.estimate)
    assert none.interval == (0.0, 1.0)
    assert str(none) == "not estimated, no time was left"


def test_an_executor_counts_the_same_samples() -> None:
    want = estimate_success_probability(CAST_SETUP, PEG, WINDS, samples=6)
    with ThreadPoolExecutor(2) as pool:
        for size in (None, 4):
            found = estimate_success_probability(CAST_SETUP, PEG, WINDS, samples=6, executor=pool, chunk_size=size)
            assert (found.successes, found.samples) == (want.successes, 6)


def test_in_the_expected_world_a_throw_ends_as_the_search_saw_it_end() -> None:
    strikes = simulated_strikes(CAST_SETUP, PEG, [WINDS])
    seen = contact_scores(CAST_SETUP, PEG, [WINDS], (strikes.t, strikes.q, strikes.qd))
    found = scenario_scores(CAST_SETUP, [(WINDS, draw) for draw in NONE.sample(1, CAST_SETUP, PEG)])
    assert nominal_strike_times(CAST_SETUP, PEG, [WINDS]) == pytest.approx(strikes.t)
    assert found.turns == pytest.approx(seen.turns)  # the same runs
    assert found.score == pytest.approx(seen.score)


def test_a_rope_that_comes_too_near_its_arm_while_it_winds_has_not_won() -> None:
    worlds = NONE.sample(1, CAST_SETUP, PEG)
    near = scenario_scores(replace(CAST_SETUP, clearance=0.5), [(WINDS, world) for world in worlds])
    clear = scenario_scores(CAST_SETUP, [(WINDS, world) for world in worlds])
    assert near.turns[0] < MIN_TURNS < clear.turns[0]
    assert near.score[0] < clear.score[0]
    assert np.isnan(nominal_strike_times(replace(CAST_SETUP, clearance=0.5), PEG, [WINDS])[0])  # nor has it struck


def test_a_rope_that_touches_an_obstacle_before_its_strike_or_after_has_not_won() -> None:
    run, worlds = planned().run, NONE.sample(1, CAST_SETUP, PEG)
    assert run is not None
    x, strike = run.joints[..., 0], float(nominal_strike_times(CAST_SETUP, PEG, [WINDS])[0])
    # Walls that the rope is 20 mm into at most: on the right before the strike alone, on the left after it alone
    right, left = float(x.max()) - 0.02, float(x.min()) + 0.02
    assert x[run.t > strike].max() < right - 0.1
    assert x[run.t < strike].min() > left + 0.01
    turns = []
    for wall in (hf.Ground(right, 0.0, -1.0, 0.0), hf.Ground(left, 0.0, 1.0, 0.0)):
        found = scenario_scores(replace(CAST_SETUP, obstacles=[wall]), [(WINDS, world) for world in worlds])
        turns += found.turns.tolist()
    assert turns[0] == 0.0  # as without a strike
    assert 0.0 < turns[1] < MIN_TURNS


def test_until_when_a_throw_may_strike_does_not_depend_on_others_beside_it() -> None:
    """A rope that swings down on a peg after its time is over, alone and beside one whose arm moves for longer."""
    n, still = CAST_SETUP.rope.n_links, hf.arm_moves([0.0, 1e-3], [0.0], [0.01])
    swings = replace(CAST_SETUP, time=0.1, side=-1, q0=(1.0,) * n, qd0=(0.0,) * n)
    length = CAST_SETUP.rope.total_length
    peg = hf.Peg(-0.2 * length, -0.75 * length, 0.03)
    moves = [still, hf.arm_moves([0.0, 1e-3], [4.0], [0.01])]
    batch = RolloutBatch.from_start(swings, [CAST_SETUP.rope] * 2, [peg] * 2, moves)
    t = first_strikes(batch, swings)[0]
    assert t[1] > 0.51
    assert np.isnan(t[0])
    assert np.isnan(first_strikes(batch.select([0]), swings)[0][0])


def test_a_flight_that_fails_after_its_strike_has_struck(monkeypatch: pytest.MonkeyPatch) -> None:
    throw = [(WINDS, world) for world in NONE.sample(1, CAST_SETUP, PEG)]
    strike = float(nominal_strike_times(CAST_SETUP, PEG, [WINDS])[0])
    flight = scenario_rollouts.free_flight
    for failed, hits in ((strike + 0.1, True), (strike - 0.1, False)):

        def fails(*given: object, failed: float = failed, **how: object) -> tuple:
            t, q, qd = flight(*given, **how)
            q[:, t > failed] = np.nan
            return t, q, qd

        monkeypatch.setattr(scenario_rollouts, "free_flight", fails)
        assert np.isfinite(nominal_strike_times(CAST_SETUP, PEG, [WINDS])[0]) == hits
    assert scenario_scores(CAST_SETUP, throw).turns[0] == 0.0


def test_no_flight_of_a_scenario_goes_on_when_no_time_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a rope with joint limits, which is simulated in contact steps from the start: it does not come to a strike."""
    stiff = replace(CAST_SETUP, rope=CAST_SETUP.rope.replace(max_bend=2.0))
    pairs = [(WINDS, world) for world in NONE.sample(1, stiff, PEG)]
    struck: list[int] = []

    def simulate_contact(batch: RolloutBatch, *_: object, **__: object) -> WindingScores:
        struck.append(len(batch))
        return WindingScores(np.ones(len(batch)), np.ones(len(batch)))

    monkeypatch.setattr(scenario_rollouts, "simulate_contact", simulate_contact)
    for left in (1e9, -1.0):
        scenario_scores(stiff, pairs, time_budget=Deadline(np.inf, lambda left=left: left))  # type: ignore[misc]
    assert struck == [1]


def test_throws_that_win_and_that_never_strike_are_told_apart() -> None:
    idle = replace(WINDS, strokes=np.full(6, 0.06), rests=np.full(6, 1.0), rest=1.0)
    worlds = Uncertainty().sample(2, CAST_SETUP, PEG, seed=3)
    found = scenario_scores(CAST_SETUP, [(throw, world) for throw in (WINDS, idle) for world in worlds])
    assert (found.turns >= MIN_TURNS).tolist() == [True, True, False, False]
    stated = estimate_success_probability(CAST_SETUP, PEG, idle, samples=2)
    assert (stated.successes, stated.samples) == (0, 2)
    assert "0 of 2" in str(stated)
