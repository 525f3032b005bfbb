"""The race in common worlds, from outcomes made up for the purpose, and a refinement that keeps the better throw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count, pairwise
from typing import Any

import numpy as np
import pytest

from hyperflex.planning import MIN_TURNS, Uncertainty
from hyperflex.planning.robust import refinement
from hyperflex.planning.robust.refinement import (
    COMMON,
    DOUBT,
    EACH,
    GENERATION_ROUNDS,
    MEMBERS,
    POOL,
    POOL_ROUNDS,
    RACE,
    RobustCandidate,
    RobustRefinement,
    _pool,
    robust_values,
)
from hyperflex.planning.search.candidates import Candidate
from hyperflex.planning.search.contact_phase import WindingScores
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.time_budget import OutOfTime
from tests.planning.test_landing import CAST_SETUP, PEG, WINDS


def landing(end: float, score: float = 1.0, turns: float = 2.0) -> Candidate:
    """A throw told from others by the end of its last move, and by its point."""
    return Candidate(score, turns, -1, np.full(10, end), replace(WINDS, end=end))


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Let a throw win in a world if its end exceeds a number that belongs to the world; return sizes of batches."""
    sizes: list[int] = []

    def scenario_scores(_, batch: list[tuple], **__) -> WindingScores:
        sizes.append(len(batch))
        hard = np.array([abs(float(world.delays[0])) / 0.002 for _, world in batch])  # half-normal
        ends = np.array([throw.end for throw, _ in batch])
        return WindingScores(np.full(len(batch), 1.5), np.where(ends > hard, 2.0, 0.0))

    monkeypatch.setattr(refinement, "scenario_scores", scenario_scores)
    monkeypatch.setattr(
        refinement, "nominal_strike_times", lambda problem, peg, throws, **_: np.full(len(throws), np.nan)
    )
    return sizes


def near_centre(work: RobustRefinement, end: float) -> Candidate:
    """A throw that can be refined: that of the centre of what is searched, with another end."""
    x = work.search.parametrizations[-1].centre()
    x[-3] = end / 3.0
    return Candidate(1.0, 2.0, -1, x, work.search.parametrizations[-1].throw(x))


def hardening(**changes: Any) -> RobustRefinement:
    return RobustRefinement(ThrowSearch(CAST_SETUP, PEG), Uncertainty(), **changes)


def test_the_race_finds_the_throw_that_wins_most_often(made_up: list[int]) -> None:
    work = hardening()
    found = [landing(end, score=3.0 - end) for end in (0.1, 2.9, 0.7, 1.4)]  # scores tell the opposite
    work.halve(found)
    assert work.incumbent.candidate is found[1]
    assert len(work.incumbent.successes) == sum(POOL_ROUNDS)
    assert sum(made_up) == 4 * POOL_ROUNDS[0] + 2 * POOL_ROUNDS[1] + 1 * POOL_ROUNDS[2]
    assert len(work.order) == 4
    assert len(set(map(id, work.order))) == 4


def test_all_runners_meet_the_same_worlds(made_up: list[int]) -> None:
    work = hardening()
    work.halve([landing(1.0), landing(1.0 + 1e-3), landing(1.03)])
    assert len(work.order) == 2  # of points that are alike one is enough
    assert work.order[0].successes[: POOL_ROUNDS[0]] == work.order[1].successes[: POOL_ROUNDS[0]]


def valued(work: RobustRefinement, monkeypatch: pytest.MonkeyPatch, value: Callable[..., float]) -> list[set[float]]:
    """Let the first candidate and others have values in worlds, by their place among the common ones; return those met.

    That place is -1 for other worlds.
    """
    met: list[set[float]] = []
    places = {world.rope.total_length: place for place, world in enumerate(work.common)}
    start = Candidate(1.0, 2.0, -1, work.search.parametrizations[-1].centre(), WINDS)

    def evaluate(runners: list[RobustCandidate], worlds: list) -> None:
        met.extend([{world.rope.total_length for world in worlds}] if worlds else [])
        for one in runners:
            mine = [value(one.candidate is start, places.get(world.rope.total_length, -1)) for world in worlds]
            one.successes += [each >= 1.0 for each in mine]
            one.values += mine

    monkeypatch.setattr(work, "evaluate", evaluate)
    monkeypatch.setattr(work, "candidates", lambda side, points: [start._replace(x=x) for x in points])
    work.halve([start])
    met.clear()
    return met


def test_each_generation_meets_fresh_worlds_and_challengers_the_common_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    work = hardening()
    met = valued(work, monkeypatch, lambda first, place: 0.5 * first)
    work.evolve()
    work.evolve()
    common = {world.rope.total_length for world in work.common}
    rounds, few = len(GENERATION_ROUNDS), {world.rope.total_length for world in work.common[: RACE[0]]}
    first, second = met[: len(met) // 2], met[len(met) // 2 :]
    for generation in (first, second):
        assert [len(some) for some in generation[:rounds]] == list(GENERATION_ROUNDS)
        assert generation[rounds:] == [few, few]  # of the best and of the mean, which are given up there
    fresh, again = (set().union(*generation[:rounds]) for generation in (first, second))
    assert len(fresh) == len(again) == sum(GENERATION_ROUNDS)
    assert not fresh & again
    assert not (fresh | again) & common
    assert len(work.order) == 1


@pytest.mark.parametrize(("value", "taken"), [(0.7, True), (0.5, False), (0.3, False)])
def test_a_challenger_takes_the_place_if_it_is_better_in_common_worlds(
    monkeypatch: pytest.MonkeyPatch, value: float, taken: bool
) -> None:
    work = hardening()
    met = valued(work, monkeypatch, lambda first, place: 0.5 if first else value if place >= 0 else 0.0)
    before = work.incumbent
    work.evolve()
    assert (work.incumbent is not before) == taken
    assert len(work.incumbent.values) == (COMMON if value >= 0.5 else sum(POOL_ROUNDS))
    assert (max(map(len, met[len(GENERATION_ROUNDS) :])) == RACE[0]) == (value < 0.5)


def test_a_challenger_is_compared_in_the_worlds_that_both_have_met(monkeypatch: pytest.MonkeyPatch) -> None:
    """The incumbent's mean value is 0.2 in the first worlds, where a challenger's is 0.5, and 0.55 in those after."""
    work = hardening()
    met = valued(work, monkeypatch, lambda first, place: (0.2 if place < RACE[0] else 0.9) if first else 0.5)
    before = work.incumbent
    work.evolve()
    assert [len(some) for some in met[len(GENERATION_ROUNDS) :]] == 2 * [RACE[0], RACE[1] - RACE[0]]
    assert work.incumbent is before


def test_the_strategy_is_told_members_best_first(made_up: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    work, told = hardening(), []
    work.halve([near_centre(work, 1.2)])
    monkeypatch.setattr(refinement.CmaEs, "tell", lambda self, points, losses: told.append((points, list(losses))))
    work.evolve()
    ((points, losses),) = told
    ends = [x[-3] for x in points]
    assert losses == sorted(losses)
    assert len(ends) == MEMBERS
    assert min(ends[: MEMBERS // 4]) > np.mean(ends)  # a throw wins the more often, the greater its end
    assert np.mean(ends[: MEMBERS // 2]) > np.mean(ends[MEMBERS // 2 :])


def test_throws_that_strike_too_late_are_no_plans(made_up: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second one of a generation; they are told as the worst, and so is the mean."""
    work, told, late = hardening(), [], CAST_SETUP.time + 0.1
    met: list[RobustCandidate] = []
    evaluate = work.evaluate

    def strike_times(problem: object, peg: object, throws: list, **_: object) -> np.ndarray:
        return np.array([late if k % 2 or len(throws) == 1 else 0.9 * CAST_SETUP.time for k in range(len(throws))])

    monkeypatch.setattr(refinement, "nominal_strike_times", strike_times)
    monkeypatch.setattr(refinement.CmaEs, "tell", lambda self, points, losses: told.append((points, list(losses))))
    monkeypatch.setattr(work, "evaluate", lambda some, worlds: (met.extend(some), evaluate(some, worlds)))
    work.halve([near_centre(work, 1.2)])
    before, met[:] = work.incumbent, []
    work.evolve()
    assert {one.candidate.t for one in met if one is not before} == {0.9 * CAST_SETUP.time}
    ((points, losses),) = told
    assert (len(points), losses) == (MEMBERS, list(range(MEMBERS)))
    assert not {tuple(x) for x in points[MEMBERS // 2 :]} & {tuple(one.candidate.x) for one in met}


@pytest.mark.parametrize(("until", "generations"), [(0.0, 1), (24.0 / (COMMON + DOUBT), 2), (0.75, 3), (np.inf, 4)])
def test_a_run_ends_with_an_incumbent_that_is_good_enough_or_always_succeeds(
    monkeypatch: pytest.MonkeyPatch, until: float, generations: int
) -> None:
    work, wins = hardening(), iter((20, 24, 28, COMMON))

    def evolve() -> None:
        count = next(wins)
        won = [m < count for m in range(COMMON)]
        work.order.insert(0, RobustCandidate(landing(1.0), won, [float(each) for each in won]))
        work.generations += 1

    monkeypatch.setattr(work, "evolve", evolve)
    work.order = [RobustCandidate(landing(1.0), COMMON // 2 * [True], COMMON // 2 * [1.0])]  # in too few scenarios
    work.run(until)
    assert work.generations == generations
    work.run(until=0.0)
    assert work.generations == min(generations + 1, 4)


def test_nothing_is_lost_where_the_time_runs_out(monkeypatch: pytest.MonkeyPatch, made_up: list[int]) -> None:
    late = hardening(left=lambda: -1.0)
    late.halve([landing(0.5), landing(0.9)])
    late.promote(late.order)
    assert (len(late.order), late.in_time) == (2, False)
    work = hardening()
    work.halve([landing(0.5), landing(0.9)])
    known = list(work.order)

    def evolve() -> None:
        raise OutOfTime

    monkeypatch.setattr(work, "evolve", evolve)
    assert work.in_time
    work.run()
    assert (work.order, work.in_time) == (known, False)


def test_few_scenarios_are_doubted(made_up: list[int]) -> None:
    work = hardening()
    lucky, known, poor = (
        RobustCandidate(landing(1.0), n * [True], n * [v]) for n, v in ((4, 1.1), (28, 0.9), (16, 0.3))
    )
    work.order = [lucky, poor, known]
    work.promote([])
    assert work.order == [known, lucky, poor]


def test_a_refinement_takes_the_place_only_if_it_is_better(made_up: list[int]) -> None:
    work = hardening()
    start = near_centre(work, 0.6)
    work.halve([start])
    means = []
    for _ in range(12):
        work.evolve()
        means.append(work.incumbent.mean)
    assert all(b >= a for a, b in pairwise(means))
    assert work.incumbent.candidate.throw.end > start.throw.end
    first = next(one for one in work.order if one.candidate is start)
    assert len(first.values) == COMMON
    assert np.mean(work.incumbent.successes) > np.mean(first.successes)


def test_nothing_is_begun_that_would_end_too_late(made_up: list[int]) -> None:
    """Each look at the clock is a second."""
    seconds = count(0.0, -1.0)
    work = hardening(left=lambda: next(seconds))
    work.halve([landing(end) for end in (0.1, 0.5, 0.9)])
    assert made_up == [3 * POOL_ROUNDS[0]]  # one heat must be
    work.run()
    assert work.generations == 0
    seconds = count(20.0, -1.0)
    work.order = [RobustCandidate(near_centre(work, 0.1))]
    work.run()  # it begins with 20 s left and takes some; the next would begin with fewer
    assert work.generations == 1


def test_a_race_of_nothing_has_no_champion(made_up: list[int]) -> None:
    work = hardening()
    work.halve([])
    work.run()
    assert (work.order, made_up) == ([], [])


def test_the_best_are_of_other_swings(made_up: list[int]) -> None:
    work = hardening()
    first, second, other = (near_centre(work, end) for end in (2.4, 2.3, 0.6))
    other.x[0] += 0.5  # another stroke
    work.halve([first, second, other])
    assert [one.candidate for one in work.order] == [first, second, other]
    assert [one.candidate for one in work.best(2)] == [first, other]
    assert [one.candidate for one in work.best(3)] == [first, other, second]


def test_what_is_dropped_is_refined_no_more(made_up: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    work = hardening()
    work.halve([near_centre(work, 0.3), near_centre(work, 2.4)])
    second = work.order[1]
    work.evolve()  # about the first
    first = work.incumbent
    strategy = work._optimizer
    work.drop([])
    assert work._optimizer is strategy
    work.drop([one for one in work.order if one is not second])
    assert work.incumbent is second
    points: list[np.ndarray] = []
    landings = work.candidates
    monkeypatch.setattr(work, "candidates", lambda side, some: points.extend(some) or landings(side, some))
    work.evolve()
    mean = np.mean([x[-3] for x in points])
    assert abs(mean - second.candidate.x[-3]) < abs(mean - first.candidate.x[-3])  # about what is left
    assert first not in work.order


def test_worth_is_a_win_and_a_little_for_the_score() -> None:
    found = WindingScores(np.array([3.0, 9.0, -4.0, 0.0]), np.array([1.25, 2.0, 0.0, 1.24]))
    assert robust_values(found, CAST_SETUP) == pytest.approx([1.2, 1.2, -0.2, 0.0])


def test_throws_that_wind_are_raced_first_and_at_most_so_many() -> None:
    many = [landing(0.1 * k, score=float(k), turns=2.0 * (k % 2)) for k in range(3 * POOL)]
    chosen = _pool(many, MIN_TURNS)
    assert len(chosen) == POOL
    assert all(one.turns >= 1.25 for one in chosen)
    assert chosen[0].score == 3 * POOL - 1


def test_swings_that_fail_together_are_not_the_whole_field() -> None:
    """Throws of one swing differ in what comes after its strokes alone."""
    better = [landing(1.0, score=9.0 - 0.1 * k) for k in range(8)]
    better = [one._replace(x=np.append(one.x[:-1], 1.0 + 0.1 * k)) for k, one in enumerate(better)]
    others = [landing(2.0 + 0.3 * k, score=1.0 - 0.1 * k) for k in range(6)]
    fail = [landing(5.0 + 0.3 * k, score=0.5 - 0.1 * k, turns=1.0) for k in range(2 * POOL)]
    chosen = [one.score for one in _pool(better + others + fail, MIN_TURNS)]
    assert chosen[:EACH] == [one.score for one in better[:EACH]]
    assert chosen[EACH : EACH + 6] == [one.score for one in others]
    assert chosen[EACH + 6 : EACH + 10] == [one.score for one in better[EACH:]]  # before any that does not wind
    assert chosen[EACH + 10 :] == [0.5, 0.4]
    assert len(chosen) == POOL
    assert _pool(better + others + fail, MIN_TURNS, fail[-1:])[0] is fail[-1]  # as is asked
    assert len(_pool(fail + fail, MIN_TURNS, fail[:1])) == POOL
