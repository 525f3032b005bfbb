"""The race in common worlds, from outcomes made up for the purpose, and a refinement that keeps the better throw."""

from __future__ import annotations

from dataclasses import replace
from itertools import count, pairwise
from typing import Any

import numpy as np
import pytest

from hyperflex.planning import Uncertainty
from hyperflex.planning.robust import refinement
from hyperflex.planning.robust.refinement import (
    COMMON,
    EACH,
    HALVING,
    POOL,
    SCENARIOS,
    RobustCandidate,
    RobustRefinement,
    _pool,
    robust_values,
)
from hyperflex.planning.search.candidates import Candidate
from hyperflex.planning.search.contact_phase import WindingScores
from hyperflex.planning.search.throw_search import ThrowSearch
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
        refinement, "nominal_strike_times", lambda cast_setup, peg, throws, threads=None: np.full(len(throws), np.nan)
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
    assert len(work.incumbent.successes) == sum(HALVING)
    assert sum(made_up) == 4 * HALVING[0] + 2 * HALVING[1] + 1 * HALVING[2]
    assert len(work.order) == 4
    assert len(set(map(id, work.order))) == 4


def test_all_runners_meet_the_same_worlds(made_up: list[int]) -> None:
    work = hardening()
    work.halve([landing(1.0), landing(1.0 + 1e-3), landing(1.03)])
    assert len(work.order) == 2  # of points that are alike one is enough
    assert work.order[0].successes[: HALVING[0]] == work.order[1].successes[: HALVING[0]]


def test_each_generation_meets_fresh_worlds_and_challengers_the_common_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    work, met = hardening(), []
    start = Candidate(1.0, 2.0, -1, work.search.parametrizations[-1].centre(), WINDS)

    def evaluate(runners: list[RobustCandidate], worlds: list) -> None:
        met.append({world.rope.total_length for world in worlds})
        for one in runners:
            one.successes += [False] * len(worlds)
            one.values += [0.0] * len(worlds)

    monkeypatch.setattr(work, "evaluate", evaluate)
    monkeypatch.setattr(work, "candidates", lambda side, points: [start._replace(x=x) for x in points])
    work.halve([start])
    met.clear()
    work.evolve()
    work.evolve()
    common = {world.rope.total_length for world in work.common[:COMMON]}
    first, challenged, second, again = met  # no challenger wins, so none has to be confirmed
    assert (len(first), len(second), len(challenged)) == (SCENARIOS, SCENARIOS, COMMON)
    assert challenged == again == common
    assert not first & second
    assert not (first | second) & common


def test_a_challenger_that_wins_by_luck_does_not_take_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    work = hardening()
    start = Candidate(1.0, 2.0, -1, work.search.parametrizations[-1].centre(), WINDS)
    common = {world.rope.total_length for world in work.common}

    def evaluate(runners: list[RobustCandidate], worlds: list) -> None:
        """The champion wins in half of all worlds; the others in all common ones, and in no other."""
        for one in runners:
            mine = [
                k % 2 == 0 if one.candidate is start else w.rope.total_length in common for k, w in enumerate(worlds)
            ]
            one.successes += mine
            one.values += [float(won) for won in mine]

    monkeypatch.setattr(work, "evaluate", evaluate)
    monkeypatch.setattr(work, "candidates", lambda side, points: [start._replace(x=x) for x in points])
    work.halve([start])
    work.evolve()
    assert work.incumbent.candidate is start


def test_a_refinement_takes_the_place_only_if_it_is_better(made_up: list[int]) -> None:
    work = hardening()
    start = near_centre(work, 0.6)
    work.halve([start])
    means = [work.incumbent.mean]
    for _ in range(12):
        work.evolve()
        means.append(float(np.mean(work.incumbent.values[:COMMON])))
    assert all(b >= a for a, b in pairwise(means))
    assert work.incumbent.candidate.throw.end > start.throw.end
    first = next(one for one in work.order if one.candidate is start)
    assert np.mean(work.incumbent.successes) > np.mean(first.successes)


def test_nothing_is_begun_that_would_end_too_late(made_up: list[int]) -> None:
    """Each look at the clock is a second."""
    seconds = count(0.0, -1.0)
    work = hardening(left=lambda: next(seconds))
    work.halve([landing(end) for end in (0.1, 0.5, 0.9)])
    assert made_up == [3 * HALVING[0]]  # one heat must be
    work.run()
    assert work.generations == 0
    seconds = count(5.0, -1.0)
    work.order = [RobustCandidate(near_centre(work, 0.1))]
    work.run()  # it begins with 5 s left and takes some; the next would begin with fewer
    assert work.generations == 1


def test_a_race_of_nothing_has_no_champion(made_up: list[int]) -> None:
    work = hardening()
    work.halve([])
    work.run()
    assert (work.order, made_up) == ([], [])


def test_the_best_are_of_other_swings_and_have_met_the_common_worlds(made_up: list[int]) -> None:
    work = hardening()
    first, second, other = (near_centre(work, end) for end in (2.4, 2.3, 0.6))
    other.x[0] += 0.5  # another stroke
    work.halve([first, second, other])
    assert [one.candidate for one in work.order] == [first, second, other]
    assert [one.candidate for one in work.best(2)] == [first, other]
    assert [one.candidate for one in work.best(3)] == [first, other, second]
    assert len({len(one.values) for one in work.best(3)}) == 1
    assert len(work.order[2].values) == COMMON


def test_what_is_dropped_is_refined_no_more(made_up: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    work = hardening()
    work.halve([near_centre(work, 0.3), near_centre(work, 2.4)])
    second = work.order[1]
    work.evolve()  # about the first
    first = work.incumbent
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
    assert robust_values(found) == pytest.approx([1.2, 1.2, -0.2, 0.0])


def test_throws_that_wind_are_raced_first_and_at_most_so_many() -> None:
    many = [landing(0.1 * k, score=float(k), turns=2.0 * (k % 2)) for k in range(3 * POOL)]
    chosen = _pool(many)
    assert len(chosen) == POOL
    assert all(one.turns >= 1.25 for one in chosen)
    assert chosen[0].score == 3 * POOL - 1


def test_swings_that_fail_together_are_not_the_whole_field() -> None:
    """Throws of one swing differ in what comes after its strokes alone."""
    better = [landing(1.0, score=9.0 - 0.1 * k) for k in range(8)]
    better = [one._replace(x=np.append(one.x[:-1], 1.0 + 0.1 * k)) for k, one in enumerate(better)]
    others = [landing(2.0 + 0.3 * k, score=1.0 - 0.1 * k) for k in range(6)]
    fail = [landing(5.0 + 0.3 * k, score=0.5 - 0.1 * k, turns=1.0) for k in range(2 * POOL)]
    chosen = [one.score for one in _pool(better + others + fail)]
    assert chosen[:EACH] == [one.score for one in better[:EACH]]
    assert chosen[EACH : EACH + 6] == [one.score for one in others]
    assert chosen[EACH + 6 : EACH + 10] == [one.score for one in better[EACH:]]  # before any that does not wind
    assert chosen[EACH + 10 :] == [0.5, 0.4]
    assert len(chosen) == POOL
    assert _pool(better + others + fail, fail[-1:])[0] is fail[-1]  # as is asked
    assert len(_pool(fail + fail, fail[:1])) == POOL
