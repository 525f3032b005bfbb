"""Strokes that are added to a swing, the order of starts and searches, and what an insertion's residuals count."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hyperflex.planning import MotorLimits, Problem, Strokes
from hyperflex.planning.insert.entry import BESIDE, DEEPER, MARGIN, SLACK, Entry, entry_residuals
from hyperflex.planning.insert.search import insert_candidates
from hyperflex.planning.insert.task import FREE, MORE, InsertTask
from hyperflex.planning.tip import planner as tip_planner
from hyperflex.planning.tip.aim import aim_strokes
from hyperflex.planning.tip.planner import TipPlanner
from hyperflex.planning.tip.strokes import MIN_STROKE, SHORT_STROKE
from hyperflex.planning.tip.swings import GENERATIONS, StrokeSearch
from hyperflex.planning.tip.task import AFTER, NEVER, TipCandidate
from tests.planning.known_insert import ARM, NEAR, ROPE, SLOT, STROKES

LIMITS = MotorLimits()
WHO = Problem(ROPE, ARM, LIMITS, 3.0)


def test_strokes_added_in_rests_leave_the_others_where_they_are() -> None:
    few = Strokes(1, np.array([-1.4, 1.0]), np.array([0.05, 0.9]))
    more = few.with_more(3, 1.2, LIMITS)
    assert more.ends.tolist() == [-1.4, -1.4 + SHORT_STROKE, 1.0]  # the other way than the stroke before it
    assert SHORT_STROKE > MIN_STROKE  # else its end could not vary
    assert more.starts(LIMITS)[[0, 2]] == pytest.approx(few.starts(LIMITS))
    assert more.rests[1] == pytest.approx(more.rests[2])
    assert few.with_more(3, few.stops(LIMITS) + 2.0, LIMITS).ends.tolist() == [-1.4, 1.0, 1.0 - SHORT_STROKE]
    first = Strokes(1, np.array([-1.4]), np.array([0.9])).with_more(2, 0.0, LIMITS)
    assert first.ends.tolist() == [0.5 * np.pi + SHORT_STROKE, -1.4]  # the other way than the stroke after it
    step = Strokes(-1, np.array([1.5, 1.5 - SHORT_STROKE, -1.4]), np.array([0.3, 0.9, 0.1])).with_more(4, 0.0, LIMITS)
    assert step.ends[:3] == pytest.approx([1.5, 1.5 + SHORT_STROKE, 1.5 - SHORT_STROKE])  # else the next had no way


def test_no_stroke_is_added_where_there_is_no_time_for_it() -> None:
    duration = float(LIMITS.fastest_moves([SHORT_STROKE])[0][0])
    few = Strokes(1, np.array([-1.4, 1.0]), np.array([0.05, 1.9 * duration]))
    assert few.with_more(9, few.stops(LIMITS), LIMITS) is few
    assert few.with_more(2, few.stops(LIMITS) + 3.0, LIMITS) is few


def test_an_instant_that_would_be_far_off_is_not_tried() -> None:
    """Where the tip's instant depends on nearly nothing, a step changes it by any time."""
    nears: list[float] = []

    class Task:
        problem, close, runs = WHO, 1e-9, 0

        def find(self, strokes: Strokes, near: float) -> SimpleNamespace:
            nears.append(near)
            return SimpleNamespace(strokes=strokes, t=near, dt=np.full(2 * strokes.ends.size, 1e6))

        def residuals(self, found: SimpleNamespace) -> tuple[np.ndarray, np.ndarray]:
            return np.array([1.0]), np.ones((1, found.dt.size))

    few = Strokes(1, np.array([-1.4, 1.0]), np.array([0.05, 0.9]))
    assert aim_strokes(Task(), TipCandidate(0.1, 2.4, few)).t == 2.4  # type: ignore[arg-type, union-attr]
    assert nears == [2.4]


def test_a_search_about_an_entry_has_strokes_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """More of them each time, unless the tip does not go through after them."""
    task, long = InsertTask(WHO, SLOT, []), Strokes(-1, np.array([1.5, -1.4, 1.0]), np.array([0.3, 0.9, 2.0]))
    monkeypatch.setattr(task, "score", lambda strokes, _, until: (np.full(1, 0.3), np.full(1, until - AFTER + 0.02)))
    for number in range(2):
        more = task.freed(TipCandidate(0.1, 2.4, long), number)
        assert (more.cost, more.t) == (0.3, pytest.approx(2.42))
        assert more.strokes.ends.size == FREE + number * MORE
        assert set(long.ends[:2]) < set(more.strokes.ends)  # the third begins after the entry
    monkeypatch.setattr(task, "score", lambda *_: (np.full(1, NEVER), np.full(1, np.nan)))
    same = task.freed(TipCandidate(0.1, 2.4, long), 0)
    assert (same.cost, same.t, same.strokes.ends.tolist()) == (0.1, 2.4, [1.5, -1.4])
    assert task.runs == 3


def test_starts_differ_in_side_and_strokes_first() -> None:
    swings = insert_candidates(WHO, SLOT, lambda: math.inf, 1)
    starts = list(InsertTask(WHO, SLOT, swings).starts())
    assert sorted(id(each) for each in starts) == sorted(id(each) for each in swings)

    def kind(one: TipCandidate) -> tuple[int, int]:
        cut = one.strokes.cut(one.t + 0.12, LIMITS)
        return cut.side, cut.ends.size

    kinds = {kind(each) for each in swings}
    assert len(kinds) > 3
    first = starts[: len(kinds)]
    assert {kind(each) for each in first} == kinds
    assert [each.cost for each in first] == sorted(each.cost for each in first)
    assert starts[0] is swings[0]


class Asked:
    """A task that notes until when its swings are to be simulated, and finds none cheaper."""

    problem, ready, runs = WHO, 0.02, 0

    def __init__(self) -> None:
        self.until: list[float] = []

    def score(self, strokes: list[Strokes], _: int | None, until: float) -> tuple[Any, Any]:
        self.until.append(until)
        return np.full(len(strokes), 0.5), np.full(len(strokes), 1.0)


def test_a_search_simulates_until_just_after_the_entry() -> None:
    task: Any = Asked()
    search = StrokeSearch(task, TipCandidate(0.3, 1.5, STROKES))
    assert search.run(lambda: 1.0).cost == 0.3
    assert task.until == [1.5 + AFTER] * GENERATIONS
    assert StrokeSearch(task, TipCandidate(0.01, 1.5, STROKES)).run(lambda: 1.0).cost == 0.01
    assert len(task.until) == GENERATIONS
    sooner = InsertTask(WHO, SLOT, [])
    assert sooner.score([STROKES], 1, 1.0)[0][0] > 0.2 > sooner.score([STROKES], 1, math.inf)[0][0]


def test_the_cheapest_search_goes_on_while_it_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    """Costs of three starts after each of their rounds; the third is ready after one."""
    costs = {0: [0.2, 0.1, 0.095, 0.0], 1: [0.15, 0.12, 0.08, 0.06], 2: [0.01]}
    aimed: list[tuple[int, float]] = []

    class Search:
        def __init__(self, _: Any, begin: TipCandidate, __: int, ___: int | None) -> None:
            self.begin = begin

        def run(self, _: Any) -> TipCandidate:
            strokes: Any = self.begin.strokes
            return TipCandidate(costs[strokes[0]][strokes[1] - 1], 1.0, strokes)

    def freed(found: TipCandidate, number: int) -> TipCandidate:
        strokes: Any = found.strokes
        return found._replace(strokes=(strokes[0], number + 1))  # type: ignore[arg-type]

    def starts() -> Iterator[TipCandidate]:
        for number in range(7):
            yield TipCandidate(0.5, 1.0, (number, 0) if number in costs else (2, 0))  # type: ignore[arg-type]

    def aim(_: Any, found: TipCandidate, __: Any) -> None:
        strokes: Any = found.strokes
        aimed.append((strokes if isinstance(strokes, int) else strokes[0], found.cost))

    task: Any = SimpleNamespace(
        direct=2,
        ready=0.02,
        rounds=4,
        starts=starts,
        freed=freed,
        runs=0,
        candidates=lambda: [TipCandidate(0.5, 1.0, -k) for k in range(1, 5)],  # type: ignore[arg-type]
    )
    monkeypatch.setattr(tip_planner, "StrokeSearch", Search)
    monkeypatch.setattr(tip_planner, "aim_strokes", aim)
    TipPlanner(task, math.inf, 0, 1).run(None)
    assert aimed[:2] == [(-1, 0.5), (-2, 0.5)]
    assert aimed[2:] == [
        *[(0, 0.2), (-3, 0.5)],
        *[(1, 0.15), (0, 0.1), (-4, 0.5)],  # after each search begun the cheapest of those before
        *[(2, 0.01), (0, 0.095)],  # and gained too little
        *[(2, 0.01), (1, 0.12)],
        *[(2, 0.01), (1, 0.08)],
        *[(2, 0.01), (1, 0.06)],  # its last round
        (2, 0.01),
    ]


def entry(**change: Any) -> Entry:
    """An entry that fails in nothing: its derivatives by three parameters name what they are of."""
    right = Entry(
        STROKES,
        NEAR,
        np.zeros(3),
        1e-3,
        offset=np.array([1e-3, -2e-3, 0.5e-3]),
        depth=DEEPER * SLOT.depth + 1e-3,
        gaps=np.array([BESIDE + 1e-3, BESIDE + 2e-3]),
        doffset=np.array([[1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]]),
        ddepth=np.array([0, 4.0, 0]),
        dgaps=np.array([[0, 0, 5.0], [0, 0, 6.0]]),
        beside=np.full(2, BESIDE),
        clearance=1.0,
        speed=1.0,
    )
    return replace(right, **change)


def test_residuals_of_an_entry_that_lacks_nothing_are_its_offsets() -> None:
    residuals, jacobian = entry_residuals(WHO, SLOT, entry())
    assert residuals.tolist() == [1e-3, -2e-3, 0.5e-3]
    assert jacobian.tolist() == entry().doffset.tolist()


def test_what_an_entry_lacks_counts_before_small_offsets() -> None:
    slack = SLACK * (1.0 - MARGIN) * (0.5 * SLOT.width - ROPE.radius)
    assert slack > 2e-3
    near = entry(depth=DEEPER * SLOT.depth - 3e-3, gaps=np.array([BESIDE - 4e-3, BESIDE + 1e-3]))
    residuals, jacobian = entry_residuals(WHO, SLOT, near)
    assert residuals == pytest.approx([0.0, 0.0, 0.0, -3e-3, -4e-3])
    assert jacobian.tolist() == [*np.zeros((3, 3)).tolist(), [0, 4.0, 0], [0, 0, 5.0]]
    aside = replace(near, offset=np.array([slack + 1e-3, 0.0, -slack - 2e-3]))
    residuals, jacobian = entry_residuals(WHO, SLOT, aside)
    assert residuals == pytest.approx([1e-3, 0.0, -2e-3, -3e-3, -4e-3])
    assert jacobian[:3].tolist() == [[1.0, 0, 0], [0, 0, 0], [3.0, 0, 0]]
