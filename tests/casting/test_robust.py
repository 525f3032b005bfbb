"""The race in common worlds, from outcomes made up for the purpose, and a refinement that keeps the better throw."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from hyperflex.casting import Uncertainty, flights
from hyperflex.casting.genes import Genes
from hyperflex.casting.landing import Landings
from hyperflex.casting.robust import HEATS, JUDGED, POOL, Hardening, _apart, worth
from hyperflex.casting.search import Landing
from tests.casting.test_landing import PEG, THROWER, WINDS


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


def hardening(**changes: int) -> Hardening:
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


def test_all_runners_meet_the_same_worlds_and_each_generation_fresh_ones(made_up: list[int]) -> None:
    work = hardening()
    work.race([landing(1.0), landing(1.0 + 1e-3), landing(1.03)])
    assert len(work.order) == 2  # of points that are alike one is enough
    assert work.order[0].wins[: HEATS[0]] == work.order[1].wins[: HEATS[0]]


def test_a_refinement_takes_the_place_only_if_it_is_better(made_up: list[int]) -> None:
    work = hardening()
    genes = work.genes[-1]
    x = genes.centre()
    x[-3] = 0.2  # end of 0.6 rad
    start = Landing(1.0, 2.0, -1, x, genes.throw(x))
    work.race([start])
    means = [work.champion.mean]
    for _ in range(12):
        work.refine()
        means.append(float(np.mean(work.champion.worth[:JUDGED])))
    assert all(b >= a for a, b in pairwise(means))
    assert work.champion.landing.throw.end > start.throw.end
    assert sum(work.champion.wins) > sum(next(one for one in work.order if one.landing is start).wins)


def test_worth_is_a_win_and_a_little_for_the_score() -> None:
    found = Landings(np.array([3.0, 9.0, -4.0, 0.0]), np.array([1.25, 2.0, 0.0, 1.24]))
    assert worth(found) == pytest.approx([1.2, 1.2, -0.2, 0.0])


def test_throws_that_wind_are_raced_first_and_at_most_so_many() -> None:
    many = [landing(0.1 * k, score=float(k), turns=2.0 * (k % 2)) for k in range(3 * POOL)]
    chosen = _apart(many)
    assert len(chosen) == POOL
    assert all(one.turns >= 1.25 for one in chosen)
    assert chosen[0].score == 3 * POOL - 1
