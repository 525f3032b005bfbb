"""The course of a whip's plan: patience, Ctrl-C at any time, maps of equal ropes, what a verified whip must meet."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.core import jit
from hyperflex.errors import InvalidInput
from hyperflex.model import divided
from hyperflex.planning import MotorLimits, Problem, TipTarget, WhipMap, build_whip_map, plan_whip, time_budget
from hyperflex.planning.search import rollouts
from hyperflex.planning.tip import planner as tip_planner
from hyperflex.planning.tip.obstacle_gaps import SpareGaps
from hyperflex.planning.tip.planner import PLANS, TipPlanner
from hyperflex.planning.tip.task import Verified
from hyperflex.planning.whip import planner
from hyperflex.planning.whip.task import WhipTask, failure
from tests.faults.interrupting import left_by
from tests.planning.known_whip import ROPE, planned_whip

ARM = hf.Arm(length=0.1)
FAR = ([1.5, 0.0], [0.0, 1.0])  # no rope gets there: what is asked of the map is answered at once


@pytest.fixture(scope="module")
def known() -> WhipMap:
    return build_whip_map(Problem(ROPE, ARM, MotorLimits(), 2.0), swings=4)


def seen_as(*found: tuple[float, float]) -> list[Any]:
    """Whips of some misses and doubts, m, by what the search makes of them."""
    gaps = SpareGaps(np.zeros(0), np.zeros((0, 2)), np.zeros(0))
    there = {"velocity": np.array([5.0, 0.0]), "speed": 5.0, "gaps": gaps}
    return [SimpleNamespace(place=np.array([miss, 0.0]), position_std=doubt, **there) for miss, doubt in found]


def course(known: WhipMap, patience: float = 1.0) -> TipPlanner:
    return TipPlanner(WhipTask(known, TipTarget(0.0, 0.0, 0.0)), patience, 0, 1)


def test_compiling_uses_up_no_patience(known: WhipMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three swings, each tried as it is and once more after a search; each try waits 10 s for the compiler."""
    now, tried = [0.0], []
    monkeypatch.setattr(time_budget.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(
        WhipMap, "candidates", lambda *_: [SimpleNamespace(cost=0.0, t=1.0, strokes=planned_whip().strokes)] * 3
    )

    def slow(*_: object) -> None:
        tried.append(now[0])
        now[0] += 10.0
        monkeypatch.setattr(jit._TIMER, "spent", jit._TIMER.spent + 10.0)

    monkeypatch.setattr(tip_planner, "aim_strokes", slow)
    work = course(known)
    work.run(None)
    assert len(tried) == 6
    assert (work.clock.spent, work.clock.elapsed) == (0.0, 60.0)
    now[0] += 1.5
    assert work.clock.spent == 1.5
    assert work._add(iter([None, None]), None)  # the time is over


def test_ctrl_c_while_the_map_is_made_is_a_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """A batch that is cut short keeps its finished members and marks the others; half a map is no map."""
    whole = rollouts.simulate_batch

    def cut(*args: Any, **options: Any) -> Any:
        batch = whole(*args, **options)
        raise hf.Interrupted(replace(batch, status=(*batch.status[:-1], "interrupted")))

    monkeypatch.setattr(rollouts, "simulate_batch", cut)
    monkeypatch.setattr(planner, "build_whip_map", lambda problem, **_: build_whip_map(problem, swings=2))
    plan = left_by(lambda: plan_whip(ROPE, ARM, [0.3, -0.9], [1.0, 0.0], time_limit=1.0))
    assert plan.interrupted
    assert not plan.success
    assert plan.message == "interrupted before the map of swings was made"
    assert plan.strokes is None
    assert plan.feasibility.distance == pytest.approx(np.hypot(0.3, 0.9))


def test_a_map_of_an_equal_rope_will_do(known: WhipMap) -> None:
    again = hf.Rope.from_table(ROPE.table())
    assert again is not ROPE
    plan = plan_whip(again, ARM, *FAR, whip_map=known, time_limit=2.0)
    assert "out of reach" in plan.message


@pytest.mark.parametrize(("limit", "words"), [(-3.0, "time_limit"), (np.nan, "time_limit"), (1.5, "another rope")])
def test_a_time_limit_beside_a_map_is_looked_at(known: WhipMap, limit: float, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        plan_whip(ROPE, ARM, *FAR, whip_map=known, time_limit=limit)


def test_a_time_in_which_no_tip_peaks_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"too short.*0[.]005"):
        plan_whip(ROPE, ARM, *FAR, time_limit=0.005)


def test_a_rope_that_cannot_be_cut_is_refused_before_the_search(known: WhipMap) -> None:
    other = replace(known, problem=replace(known.problem, rope=ROPE.replace(com=0.05)))
    with pytest.raises(InvalidInput, match="not uniform"):
        course(other)


@pytest.mark.parametrize(
    ("stands", "meet", "taken", "looks"),
    [
        ((True, True, True), 3, 0, 1),
        ((False, True, True), 3, 1, 2),
        ((False, False, True), 3, 2, 3),
        ((False, False, False), 3, 0, 3),
        ((False, True, True), 1, 0, 1),  # the others miss even in the search
    ],
)
def test_whips_are_verified_until_one_stands(
    known: WhipMap,
    monkeypatch: pytest.MonkeyPatch,
    stands: tuple[bool, ...],
    meet: int,
    taken: int,
    looks: int,
) -> None:
    work, looked = course(known), []
    work.aims = seen_as(*[(0.0 if k < meet else 0.1, 0.001 * k) for k in range(PLANS + 1)])

    def verify(task: WhipTask, aim: Any, _: object) -> Verified:
        assert task.finer.rope == divided(ROPE, 2)
        looked.append(aim)
        return Verified(aim, None, None, "" if stands[len(looked) - 1] else f"fault {len(looked)}")

    monkeypatch.setattr(WhipTask, "verify", verify)
    work.verify()
    best = work.best
    assert best is not None
    assert best.aim is work.aims[taken]
    assert len(looked) == looks
    assert bool(best.message) == (not stands[taken])


@pytest.mark.parametrize(("good", "tried"), [(2, 3), (4, 6), (99, 7)])
def test_more_whips_are_aimed_where_those_verified_fail(
    known: WhipMap, monkeypatch: pytest.MonkeyPatch, good: int, tried: int
) -> None:
    """PLANS at a time, until one succeeds or all swings were aimed."""
    aims, looked = seen_as(*[(0.0, 0.001 * k) for k in range(7)]), []
    work = course(known)
    monkeypatch.setattr(work, "_aimed", lambda: iter(aims))

    def verify(_: WhipTask, aim: Any, __: object) -> Verified:
        looked.append(aim)
        return Verified(aim, None, None, "" if good < 7 and aim is aims[good] else "it misses")

    monkeypatch.setattr(WhipTask, "verify", verify)
    work.run(None)
    assert len(work.aims) == tried
    assert list(map(id, looked)) == list(map(id, aims[: min(good + 1, 7)]))
    assert work.succeeds == (good < 7)
    assert work.best is not None
    assert work.best.aim is aims[good if good < 7 else 0]


@pytest.mark.parametrize("after", [0, 1])
def test_ctrl_c_while_whips_are_verified_keeps_the_best(
    known: WhipMap, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    work, looked = course(known), []
    work.aims = seen_as((0.0, 0.001), (0.0, 0.002))

    def verify(_: WhipTask, aim: Any, __: object) -> Verified:
        if len(looked) == after:
            raise KeyboardInterrupt
        looked.append(aim)
        return Verified(aim, None, None, "it misses")

    monkeypatch.setattr(WhipTask, "verify", verify)
    with pytest.raises(KeyboardInterrupt):
        work.verify()
    best = work.best
    assert best is not None
    assert best.aim is work.aims[0]
    assert best.message == ("it misses" if after else "interrupted before it was verified")


def test_no_whip_is_none(known: WhipMap) -> None:
    work = course(known)
    work.verify()
    assert work.best is None


def test_a_motor_that_is_too_weak_is_a_reason() -> None:
    plan = planned_whip()
    assert plan.outcome is not None
    asked = np.abs(plan.outcome.run.motor_torque).max()
    for part, words in ((1.001, ""), (0.99, f"it asks {asked:.3g} N m of a motor that gives {0.99 * asked:.3g}")):
        who = replace(plan.problem, limits=MotorLimits(torque=part * asked))
        assert failure(who, plan.outcome, plan.finer_outcome, plan.position_std) == words


@pytest.mark.parametrize(
    ("miss", "doubt", "words"),
    [
        (2.9e-3, 1e-4, ""),
        (3.1e-3, 1e-4, "with links of half the length it misses by 3.1 mm, 3.0 allowed"),
        (7.9e-3, 8e-3, ""),
        (8.1e-3, 8e-3, "with links of half the length it misses by 8.1 mm, 8.0 allowed"),
    ],
)
def test_finer_links_may_move_the_peak_by_its_doubt_or_3_mm(miss: float, doubt: float, words: str) -> None:
    plan = planned_whip()
    assert plan.finer_outcome is not None
    assert failure(plan.problem, plan.outcome, replace(plan.finer_outcome, miss=miss), doubt) == words
    assert "no peak there" in failure(plan.problem, plan.outcome, None, doubt)
