"""Where a target would do, and what would do for it where it is: by the criterion, and with plans."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.planning import MotorLimits, Uncertainty, check_feasibility
from hyperflex.planning.search.candidates import Candidate
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.throw import ThrowParametrization
from hyperflex.planning.wind import casting, fallback_targets
from hyperflex.planning.wind.cast_plan import CastPlan
from hyperflex.planning.wind.planner import CastPlanner
from tests.faults.interrupting import left_by
from tests.planning.known import PEG, WINDS, late, planned, problem, stopped, unreachable

CAST_SETUP = problem()
FAR = hf.Peg(1.72 * np.sin(0.9), -1.72 * np.cos(0.9), 0.04)  # some 10 cm beyond what is in reach in its direction
SLOW, LAZY, WEAK = (replace(CAST_SETUP, limits=MotorLimits(*pair)) for pair in ((0.8, 8.0), (8.6, 0.5), (0.8, 1.0)))


def distance(one: hf.Peg, other: hf.Peg) -> float:
    return float(np.hypot(one.x - other.x, one.y - other.y))


def test_places_about_a_peg_are_tried_from_the_sides_that_are_clear_there() -> None:
    """A long arm, whose rope hangs where the target is moved to."""
    who = replace(CAST_SETUP, arm=hf.Arm(length=0.5))
    search = ThrowSearch(who, hf.Peg(0.56, -1.1, 0.03))
    search.candidates.append(Candidate(1.0, 1.0, 1, search.parametrizations[1].centre(), WINDS))
    assert any(list(beside.parametrizations) == [-1] for beside in fallback_targets.searches_near_by(search))


def test_a_plan_that_fails_says_where_one_should_do() -> None:
    plan = unreachable()
    assert plan.fallback is not None
    assert plan.fallback.plan is None
    assert check_feasibility(plan.problem, plan.fallback.target).feasible
    assert [text[:9] for text in plan.remedies] == ["a rope of"]


@pytest.mark.parametrize("made", [late, stopped, lambda: stopped(None)], ids=["clock", "ctrl-c", "no throw"])
def test_no_place_is_named_where_the_target_is_not_what_failed(made: Callable[[], CastPlan]) -> None:
    plan = made()
    assert plan.unfinished
    assert fallback_targets.expected_fallback(plan, 0.0) is None


@pytest.mark.parametrize(
    "made",
    [
        lambda: planned(winds=False),  # a throw that was run says so
        lambda: replace(
            stopped(None), target=FAR, feasibility=check_feasibility(CAST_SETUP, FAR)
        ),  # the criterion says so
    ],
    ids=["throw", "criterion"],
)
def test_a_place_is_named_where_the_target_is_what_failed(made: Callable[[], CastPlan]) -> None:
    plan = made()
    assert not plan.unfinished
    assert fallback_targets.expected_fallback(plan, 0.0) is not None


def test_a_plan_that_stands_is_finished() -> None:
    assert not planned().unfinished


def test_a_finer_run_that_took_too_long_is_not_the_targets_fault() -> None:
    assert replace(planned(), finer_outcome=late().outcome, message="with shorter links").unfinished


class Planner:
    """Plans for other places, of which the number `good` stands; remembers them."""

    def __init__(self, good: int) -> None:
        self.good, self.asked = good, []  # type: ignore[var-annotated]

    def __call__(self, peg: hf.Peg) -> CastPlan:
        self.asked.append(peg)
        if len(self.asked) == self.good:
            return replace(planned(), target=peg)
        return replace(planned(), target=peg, message="it slips")


def failed(peg: hf.Peg) -> CastPlan:
    return replace(planned(), target=peg, feasibility=check_feasibility(CAST_SETUP, peg), message="it slips")


@pytest.mark.parametrize("peg", [FAR, PEG])
def test_places_are_planned_for_until_one_stands(peg: hf.Peg) -> None:
    again = Planner(good=2)
    plan = fallback_targets.plan_fallback(failed(peg), ThrowSearch(CAST_SETUP, peg), 1.0, again)
    assert plan.fallback is not None
    assert plan.fallback.plan is not None
    assert plan.fallback.plan.target == plan.fallback.target == again.asked[1]
    assert plan.fallback.failed_plans == 1
    assert plan.message == "it slips"
    away = [distance(one, peg) for one in again.asked]
    assert 0.0 < away[0] < away[1] == pytest.approx(plan.fallback.distance)


def test_where_no_place_stands_the_next_one_is_expected() -> None:
    again = Planner(good=0)
    plan = fallback_targets.plan_fallback(failed(FAR), ThrowSearch(CAST_SETUP, FAR), 1.0, again)
    assert plan.fallback is not None
    assert (plan.fallback.plan, plan.fallback.failed_plans) == (None, 3)
    assert plan.fallback.target not in again.asked
    assert plan.fallback.distance > max(distance(one, FAR) for one in again.asked)


def test_no_place_is_planned_for_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fallback_targets, "MARGINS", (0.0, 0.0, 0.0, 0.0))
    again = Planner(good=0)
    plan = fallback_targets.plan_fallback(failed(FAR), ThrowSearch(CAST_SETUP, FAR), 1.0, again)
    assert len(again.asked) == 1
    assert plan.fallback is None


def test_a_throw_at_hand_counts_where_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Made up: nothing strikes or winds at the first places, one slips at the next, one stands at the last."""
    places = [replace(PEG, x=PEG.x + 0.01 * k) for k in (1, 2, 3, 4)]
    beside = [SimpleNamespace(problem=CAST_SETUP, peg=peg, candidates=[]) for peg in places]
    for one, turns in zip(beside[1:], (1.2, 1.3, 1.3), strict=True):
        one.candidates.append(SimpleNamespace(turns=turns))
    best: list[hf.Peg] = []  # of which a throw without a margin is verified, too
    monkeypatch.setattr(fallback_targets, "searches_near_by", lambda search, left: iter(beside))
    stands = replace(planned(), target=places[3])
    monkeypatch.setattr(
        fallback_targets,
        "CastPlanner",
        lambda search, *_, **__: SimpleNamespace(
            verify_new=lambda: None,
            verify_best=lambda: best.append(search.peg),
            plan=lambda known: failed(places[2]) if search.peg == places[2] else stands,
        ),
    )
    plan = fallback_targets.plan_fallback(failed(PEG), ThrowSearch(CAST_SETUP, PEG), 10.0, Planner(good=0))
    assert plan.fallback is not None
    assert plan.fallback.plan is stands
    assert plan.fallback.distance == pytest.approx(0.04)
    assert plan.fallback.failed_plans == 0
    assert best == places[2:]


def test_throws_at_hand_are_tried_until_half_of_the_time_and_verified_until_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Made up: each place takes 2 s, and its throw winds but does not stand."""
    clock, seen, verified = SimpleNamespace(spent=0.0), list[float](), list[tuple[float, float]]()

    def evaluate(self: ThrowSearch, points: list) -> None:
        assert self.left is not None
        seen.append(self.left())
        clock.spent += 2.0
        self.candidates.append(SimpleNamespace(turns=1.3))  # type: ignore[arg-type]

    monkeypatch.setattr(fallback_targets, "Clock", lambda: clock)
    monkeypatch.setattr(ThrowSearch, "evaluate", evaluate)
    monkeypatch.setattr(CastPlanner, "verify_new", lambda self: verified.append((self.time_budget, self.spent)))
    monkeypatch.setattr(CastPlanner, "verify_best", lambda self: None)
    monkeypatch.setattr(CastPlanner, "plan", lambda self, known: failed(PEG))
    search = ThrowSearch(CAST_SETUP, PEG)
    search.candidates.append(Candidate(1.0, 1.0, 1, np.zeros(3), WINDS))
    assert fallback_targets.plan_fallback(failed(PEG), search, 10.0, Planner(good=1)).fallback is not None
    assert seen == [5.0, 3.0, 1.0]
    assert verified == [(10.0, 2.0), (10.0, 4.0)]


def test_throws_at_hand_are_not_tried_where_they_would_be_no_robust_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def no_place(*_: object) -> None:
        raise AssertionError

    def plan_fallback(plan: CastPlan, *_: object, at_hand: bool) -> CastPlan:
        asked.append(at_hand)
        return plan

    monkeypatch.setattr(fallback_targets, "searches_near_by", no_place)
    again = Planner(good=1)
    plan = fallback_targets.plan_fallback(failed(PEG), ThrowSearch(CAST_SETUP, PEG), 10.0, again, at_hand=False)
    assert plan.fallback is not None
    assert plan.fallback.target == again.asked[0]
    monkeypatch.setattr(casting, "plan_fallback", plan_fallback)
    for uncertainty in (None, Uncertainty()):
        hf.plan_cast(CAST_SETUP.rope, CAST_SETUP.arm, FAR, fallback=True, uncertainty=uncertainty)
    assert asked == [True, False]


def test_an_interrupt_ends_the_search_for_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(casting, "plan_fallback", stop)
    plan = left_by(lambda: hf.plan_cast(CAST_SETUP.rope, CAST_SETUP.arm, FAR, fallback=True))
    assert plan.interrupted
    assert plan.fallback is not None
    assert plan.fallback.plan is None


def test_a_throw_at_hand_is_tried_on_pegs_near_by_and_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    """The throw that is known to wind, for a target 2 mm beside its own."""
    monkeypatch.setattr(fallback_targets, "RADII", (0.001,))
    genes = ThrowParametrization(CAST_SETUP, WINDS.side)
    x = genes.centre()
    x[:6], x[genes.strokes : genes.strokes + 6] = WINDS.strokes / np.pi, WINDS.rests / genes.period
    x[-4:] = 0.5, WINDS.end / np.pi, WINDS.rest / genes.period, WINDS.speed
    search = ThrowSearch(CAST_SETUP, replace(PEG, x=PEG.x - 0.002))
    search.candidates.append(Candidate(1.0, 1.0, WINDS.side, x, WINDS))
    again = Planner(good=1)
    plan = fallback_targets.plan_fallback(failed(search.peg), search, 1e3, again)
    assert again.asked == []
    assert plan.fallback is not None
    assert plan.fallback.plan is not None
    assert plan.fallback.distance == pytest.approx(0.002)
    cast = plan.fallback.plan.outcome
    assert cast is not None
    assert cast.success
    assert cast.run is not None
    assert plan.fallback.target in cast.run.setup.pegs


def test_throws_at_hand_are_tried_on_near_places_first(monkeypatch: pytest.MonkeyPatch) -> None:
    landed: list[int] = []
    monkeypatch.setattr(ThrowSearch, "evaluate", lambda self, points: landed.append(len(points)))
    search = ThrowSearch(CAST_SETUP, PEG)
    search.candidates += [Candidate(1.0, 1.0, side, np.zeros(3), WINDS) for side in (1, -1, 1, 1, 1, 1, 1, 1)]
    places: Iterator[ThrowSearch] = fallback_targets.searches_near_by(search)
    away = [distance(one.peg, PEG) for one in places]
    assert np.all(np.diff(away) > -1e-8)  # places are rounded to 1e-9 m
    assert away[0] == pytest.approx(0.02)
    assert landed[0] == 6  # the best six
    assert dataclasses.asdict(search.peg) == dataclasses.asdict(PEG)
