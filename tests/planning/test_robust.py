"""The race in common worlds, from outcomes made up for the purpose, and a refinement that keeps the better throw."""

from __future__ import annotations

from dataclasses import replace
from itertools import count, pairwise
from typing import Any

import numpy as np
import pytest

from hyperflex.planning import Uncertainty
from hyperflex.planning.robust import scenarios as flights
from hyperflex.planning.robust.refinement import EACH, HEATS, JUDGED, POOL, WORLDS, Hardening, Runner, _apart, worth
from hyperflex.planning.search.candidates import Landing
from hyperflex.planning.search.contact_phase import Landings
from hyperflex.planning.search.parametrization import Genes
from tests.planning.test_landing import PEG, THROWER, WINDS


def landing(end: float, score: float = 1.0, turns: float = 2.0) -> Landing:
    """A throw told from others by the end of its last move, and by its point."""
    return Landing(score, turns, -1, np.full(10, end), replace(WINDS, end=end))


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Let a throw win in a world if its end exceeds a number that belongs to the world; return sizes of batches."""
    sizes: list[int] = []

    def ends(batch: list[tuple], *_, **__) -> Landings:
        sizes.append(len(batch))
        hard = np.array([abs(float(world.late[0])) / 0.002 for _, world in batch])  # half-normal
        ends = np.array([throw.end for throw, _ in batch])
        return Landings(np.full(len(batch), 1.5), np.where(ends > hard, 2.0, 0.0))

    monkeypatch.setattr(flights, "from_rest", lambda thrower, pairs: pairs)
    monkeypatch.setattr(flights, "ends", ends)
    monkeypatch.setattr(flights, "strike", lambda thrower, peg, throws, threads=None: np.full(len(throws), np.nan))
    return sizes


def near_centre(work: Hardening, end: float) -> Landing:
    """A throw that can be refined: that of the centre of what is searched, with another end."""
    x = work.genes[-1].centre()
    x[-3] = end / 3.0
    return Landing(1.0, 2.0, -1, x, work.genes[-1].throw(x))


def hardening(**changes: Any) -> Hardening:
    return Hardening(THROWER, PEG, {s: Genes(THROWER, s) for s in (-1, 1)}, Uncertainty(), **changes)


def test_the_race_finds_the_throw_that_wins_most_often(made_up: list[int]) -> None:
    work = hardening()
    found = [landing(end, score=3.0 - end) for end in (0.1, 2.9, 0.7, 1.4)]  # scores tell the opposite
    work.race(found)
    assert work.champion.landing is found[1]
    assert len(work.champion.wins) == sum(HEATS)
    assert sum(made_up) == 4 * HEATS[0] + 2 * HEATS[1] + 1 * HEATS[2]
    assert len(work.order) == 4
    assert len(set(map(id, work.order))) == 4


def test_all_runners_meet_the_same_worlds(made_up: list[int]) -> None:
    work = hardening()
    work.race([landing(1.0), landing(1.0 + 1e-3), landing(1.03)])
    assert len(work.order) == 2  # of points that are alike one is enough
    assert work.order[0].wins[: HEATS[0]] == work.order[1].wins[: HEATS[0]]


def test_each_generation_meets_fresh_worlds_and_challengers_the_common_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    work, met = hardening(), []
    start = Landing(1.0, 2.0, -1, work.genes[-1].centre(), WINDS)

    def meet(runners: list[Runner], worlds: list) -> None:
        met.append({world.rope.total_length for world in worlds})
        for one in runners:
            one.wins += [False] * len(worlds)
            one.worth += [0.0] * len(worlds)

    monkeypatch.setattr(work, "meet", meet)
    monkeypatch.setattr(work, "landings", lambda side, points: [start._replace(x=x) for x in points])
    work.race([start])
    met.clear()
    work.refine()
    work.refine()
    common = {world.rope.total_length for world in work.worlds[:JUDGED]}
    first, challenged, second, again = met  # no challenger wins, so none has to be confirmed
    assert (len(first), len(second), len(challenged)) == (WORLDS, WORLDS, JUDGED)
    assert challenged == again == common
    assert not first & second
    assert not (first | second) & common


def test_a_challenger_that_wins_by_luck_does_not_take_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    work = hardening()
    start = Landing(1.0, 2.0, -1, work.genes[-1].centre(), WINDS)
    common = {world.rope.total_length for world in work.worlds}

    def meet(runners: list[Runner], worlds: list) -> None:
        """The champion wins in half of all worlds; the others in all common ones, and in no other."""
        for one in runners:
            mine = [k % 2 == 0 if one.landing is start else w.rope.total_length in common for k, w in enumerate(worlds)]
            one.wins += mine
            one.worth += [float(won) for won in mine]

    monkeypatch.setattr(work, "meet", meet)
    monkeypatch.setattr(work, "landings", lambda side, points: [start._replace(x=x) for x in points])
    work.race([start])
    work.refine()
    assert work.champion.landing is start


def test_a_refinement_takes_the_place_only_if_it_is_better(made_up: list[int]) -> None:
    work = hardening()
    start = near_centre(work, 0.6)
    work.race([start])
    means = [work.champion.mean]
    for _ in range(12):
        work.refine()
        means.append(float(np.mean(work.champion.worth[:JUDGED])))
    assert all(b >= a for a, b in pairwise(means))
    assert work.champion.landing.throw.end > start.throw.end
    first = next(one for one in work.order if one.landing is start)
    assert np.mean(work.champion.wins) > np.mean(first.wins)


def test_nothing_is_begun_that_would_end_too_late(made_up: list[int]) -> None:
    """Each look at the clock is a second."""
    seconds = count(0.0, -1.0)
    work = hardening(left=lambda: next(seconds))
    work.race([landing(end) for end in (0.1, 0.5, 0.9)])
    assert made_up == [3 * HEATS[0]]  # one heat must be
    work.go()
    assert work.generations == 0
    seconds = count(2.0, -1.0)
    work.order = [Runner(near_centre(work, 0.1))]
    work.go()  # it begins with 2 s left and takes one; the next would begin with none
    assert work.generations == 1


def test_a_race_of_nothing_has_no_champion(made_up: list[int]) -> None:
    work = hardening()
    work.race([])
    work.go()
    assert (work.order, made_up) == ([], [])


def test_the_best_are_of_other_swings_and_have_met_the_common_worlds(made_up: list[int]) -> None:
    work = hardening()
    first, second, other = (near_centre(work, end) for end in (2.4, 2.3, 0.6))
    other.x[0] += 0.5  # another stroke
    work.race([first, second, other])
    assert [one.landing for one in work.order] == [first, second, other]
    assert [one.landing for one in work.best(2)] == [first, other]
    assert [one.landing for one in work.best(3)] == [first, other, second]
    assert len({len(one.worth) for one in work.best(3)}) == 1
    assert len(work.order[2].worth) == JUDGED


def test_what_is_dropped_is_refined_no_more(made_up: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    work = hardening()
    work.race([near_centre(work, 0.3), near_centre(work, 2.4)])
    second = work.order[1]
    work.refine()  # about the first
    first = work.champion
    work.drop([one for one in work.order if one is not second])
    assert work.champion is second
    points: list[np.ndarray] = []
    landings = work.landings
    monkeypatch.setattr(work, "landings", lambda side, some: points.extend(some) or landings(side, some))
    work.refine()
    mean = np.mean([x[-3] for x in points])
    assert abs(mean - second.landing.x[-3]) < abs(mean - first.landing.x[-3])  # about what is left
    assert first not in work.order


def test_worth_is_a_win_and_a_little_for_the_score() -> None:
    found = Landings(np.array([3.0, 9.0, -4.0, 0.0]), np.array([1.25, 2.0, 0.0, 1.24]))
    assert worth(found) == pytest.approx([1.2, 1.2, -0.2, 0.0])


def test_throws_that_wind_are_raced_first_and_at_most_so_many() -> None:
    many = [landing(0.1 * k, score=float(k), turns=2.0 * (k % 2)) for k in range(3 * POOL)]
    chosen = _apart(many)
    assert len(chosen) == POOL
    assert all(one.turns >= 1.25 for one in chosen)
    assert chosen[0].score == 3 * POOL - 1


def test_swings_that_fail_together_are_not_the_whole_field() -> None:
    """Throws of one swing differ in what comes after its strokes alone."""
    better = [landing(1.0, score=9.0 - 0.1 * k) for k in range(8)]
    better = [one._replace(x=np.append(one.x[:-1], 1.0 + 0.1 * k)) for k, one in enumerate(better)]
    others = [landing(2.0 + 0.3 * k, score=1.0 - 0.1 * k) for k in range(6)]
    fail = [landing(5.0 + 0.3 * k, score=0.5 - 0.1 * k, turns=1.0) for k in range(2 * POOL)]
    chosen = [one.score for one in _apart(better + others + fail)]
    assert chosen[:EACH] == [one.score for one in better[:EACH]]
    assert chosen[EACH : EACH + 6] == [one.score for one in others]
    assert chosen[EACH + 6 : EACH + 10] == [one.score for one in better[EACH:]]  # before any that does not wind
    assert chosen[EACH + 10 :] == [0.5, 0.4]
    assert len(chosen) == POOL
    assert _apart(better + others + fail, fail[-1:])[0] is fail[-1]  # as is asked
    assert len(_apart(fail + fail, fail[:1])) == POOL
