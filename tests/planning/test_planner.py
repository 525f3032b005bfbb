"""The planner's loop, on a task of numbers and a clock that the task itself moves on; shooting on known residuals."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from hyperflex.budget import Budget, OutOfTime
from hyperflex.planning.moves import Moves
from hyperflex.planning.planner import Candidate, Planner, Task, Verified
from hyperflex.planning.shooting import shoot

COST = {"sample": 1.0, "rollout": 2.0, "verify": 4.0}  # s


class Numbers(Task):
    """Samples are 0, 1, 2, ...; a rollout is good from `good` on, and succeeds if `succeeds` says so."""

    batch = 2

    def __init__(self, good: int, succeeds: Callable[[int], bool], enough: float = 1.0, last: int = 10_000) -> None:
        self.good, self.succeeds, self.enough, self.last = good, succeeds, enough, last
        self.now, self.calls, self.next = 0.0, list[tuple[str, int]](), 0

    def _work(self, name: str, number: int, budget: Budget) -> None:
        self.now += COST[name]
        self.calls.append((name, number))
        budget.check()

    def sample(self, found: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        self._work("sample", self.next, budget)
        self.next += 1
        moves = Moves(1, np.array([float(self.next - 1)]), np.zeros(1))
        return [] if self.next > self.last else [Candidate(moves, float(self.next), 0.0)]

    def rollout(self, some: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        self._work("rollout", len(some), budget)
        return [Candidate(one.moves, one.score, 0.0, number(one) >= self.good) for one in some]

    def alike(self, one: Candidate, other: Candidate) -> bool:
        return number(one) // 10 == number(other) // 10

    def verify(self, one: Candidate, budget: Budget) -> Verified:
        self._work("verify", number(one), budget)
        success = self.succeeds(number(one))
        return Verified(one, None, None, "" if success else "fails", number(one) / 100.0 if success else -1.0)


def number(one: Candidate) -> int:
    return int(one.moves.ends[0])


def planner(task: Numbers, seconds: float = 1_000.0, improve: float = 0.25, heard=None) -> Planner:
    found = Planner(task, Budget(seconds, threads=1, clock=lambda: task.now), improve, heard)
    found.run()
    return found


def spent(task: Numbers, name: str) -> float:
    return COST[name] * sum(each == name for each, _ in task.calls)


def test_each_level_gets_an_equal_share_of_the_time():
    class Unlike(Numbers):
        def alike(self, one: Candidate, other: Candidate) -> bool:
            return False

    task = Unlike(100, lambda _: False)
    task.verify = lambda one, budget: Verified(one, None, None, "", 0.0)  # takes no time
    assert planner(task, 300.0, improve=math.inf).succeeds
    assert [spent(task, name) for name in ("sample", "rollout")] == pytest.approx([150.0] * 2, abs=4.0)


def test_a_search_ends_with_a_margin_or_some_time_after_its_first_plan():
    task = Numbers(5, lambda k: k >= 20, enough=0.2)
    assert planner(task).best.margin >= 0.2  # the first that succeeds has it
    task = Numbers(0, lambda k: k >= 2, enough=10.0)
    found = planner(task, improve=0.5)
    first = next(k for k, (name, one) in enumerate(task.calls) if name == "verify" and one >= 2)
    at = sum(COST[name] for name, _ in task.calls[: first + 1])
    assert 1.5 * at - COST["verify"] <= task.now <= 1.5 * at  # another verification would end later
    assert found.best.margin == max(one / 100.0 for name, one in task.calls if name == "verify")


def test_a_candidate_unlike_those_that_failed_is_verified_at_once():
    task = Numbers(0, lambda _: False, last=40)
    planner(task)
    calls = task.calls
    for ten in range(4):
        k = next(k for k, (name, one) in enumerate(calls) if name == "verify" and one // 10 == ten)
        assert calls[k - 1][0] == "rollout"


def test_a_better_plan_is_reported_and_may_end_the_search():
    heard: list[float] = []
    task = Numbers(0, lambda k: k >= 3, enough=10.0)
    found = Planner(
        task,
        Budget(500.0, threads=1, clock=lambda: task.now),
        9.0,
        lambda: heard.append(found.best.margin) or len(heard) == 3,
    )
    found.run()
    assert len(heard) == 3
    assert sorted(heard) == heard
    assert task.now < 500.0


def test_candidates_like_those_that_failed_are_verified_last():
    task = Numbers(0, lambda _: False, last=30)
    planner(task)
    tens = [one // 10 for name, one in task.calls if name == "verify"]
    assert len(tens) == 30
    assert max(np.bincount(tens[-9:], minlength=3)) <= 6


def test_no_time_and_nothing_to_try_end_a_search():
    task = Numbers(0, lambda _: False, last=3)
    found = planner(task)
    assert len(found.rolled) == 3
    assert not found.succeeds
    assert task.now < 100.0
    assert planner(Numbers(0, lambda _: True), 0.5).best is None  # the first sample took longer


def test_the_best_rollout_is_verified_to_show_why_it_fails_if_there_is_time():
    found = planner(Numbers(9, lambda _: False, last=3))  # none is good
    assert found.best is None
    found.explain(Budget(0.0))
    assert found.best is None
    found.explain(Budget())
    assert (found.best.candidate, found.best.message) == (found.rolled[0], "fails")


def test_candidates_like_those_that_failed_get_less_and_less_of_the_time():
    task = Numbers(0, lambda _: False)
    task.alike = lambda one, other: True
    assert not planner(task, 600.0).succeeds
    shares = [spent(task, name) for name in COST]
    assert shares[0] == pytest.approx(shares[1], abs=4.0)
    assert 0.0 < shares[2] < 0.5 * shares[1]


def test_a_plan_with_half_of_the_margin_is_improved_for_half_as_long():
    class HalfSpare(Numbers):
        def verify(self, one, budget):
            return replace(super().verify(one, budget), margin=0.5)

    task = HalfSpare(10, lambda _: True)
    assert planner(task, improve=1.0).best.margin == 0.5
    first = next(k for k, (name, _) in enumerate(task.calls) if name == "verify")
    at = sum(COST[name] for name, _ in task.calls[: first + 1])
    assert 1.5 * at - COST["verify"] <= task.now <= 1.5 * at


class Point(NamedTuple):
    x: np.ndarray
    t: float
    residuals: np.ndarray


def at(x: np.ndarray) -> Point:
    """Two residuals that are curved, and badly scaled, in three parameters; the time is the first of them."""
    return Point(x, float(x[0]), np.array([x[0] + 0.1 * x[1] ** 2 - 1.0, 100.0 * (x[1] - 0.02 * x[2])]))


def fly(one: Point, changes: Sequence[np.ndarray], later: Sequence[float]) -> list[Point | None]:
    for change, late in zip(changes, later, strict=True):
        assert late == pytest.approx(change[0] if late else 0.0, abs=1e-3)  # the time is predicted
    found = [at(one.x + change) for change in changes]
    return [each if each.x[0] < 0.9 else None for each in found]  # there is none beyond


def test_residuals_are_reduced_and_failed_flights_are_passed_over():
    scale, begin = np.array([0.1, 0.1, 5.0]), at(np.array([0.0, 0.5, 0.0]))
    best, varied = shoot(begin, scale, fly, close=1e-6, rounds=60, difference=1e-4, budget=Budget())
    assert np.linalg.norm(best.residuals) < 0.2 * np.linalg.norm(begin.residuals)
    assert best.x[0] < 0.9
    assert [np.flatnonzero(each.x - best.x).tolist() for each in varied] in ([[0], [1], [2]], [[], [1], [2]])
    (first, _), (none, _) = (
        shoot(begin, scale, fly, close=close, rounds=1, difference=1e-4, budget=Budget()) for close in (0.0, math.inf)
    )
    assert np.abs(first.x - begin.x).max() / scale.max() <= 0.6
    assert none is begin


def test_no_step_is_made_without_time():
    with pytest.raises(OutOfTime):
        shoot(at(np.zeros(3)), np.ones(3), fly, close=0.0, rounds=9, difference=1e-4, budget=Budget(1e-9))


def test_a_search_that_hardly_gains_ends():
    def floor(one: Point, changes: Sequence[np.ndarray], _: Sequence[float]) -> list[Point | None]:
        return [Point(x, 0.0, np.append(x, 10.0)) for x in (one.x + each for each in changes)]

    begin = Point(np.ones(2), 0.0, np.array([1.0, 1.0, 10.0]))
    best, varied = shoot(begin, 0.1 * np.ones(2), floor, rounds=60, difference=1e-4, budget=Budget())
    assert 0.9 < best.x[0] < 1.0  # one step
    assert np.abs([each.x - best.x for each in varied]).max() == pytest.approx(1e-5)
