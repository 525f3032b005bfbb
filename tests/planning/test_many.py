"""Casts for many targets: searches start from what stands near by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.planning import CastPlan, CastSetup, Throw, check_feasibility
from hyperflex.planning.wind import many

CORD = hf.Rope.uniform(length=1.2, mass=0.06, n_links=12, radius=0.004, friction=1e-3)
ARM = hf.Arm(length=0.2)
PEG = hf.Peg(-0.45, -0.5, 0.04, 0.4)
WINDS = Throw(
    side=-1,
    strokes=np.array([2.3237, 2.7272, 2.7693, 3.1416]),
    rests=np.array([0.1277, 0.1598, 0.3121, 0.1743]),
    end=-np.pi / 2,
    rest=0.0897,
    speed=1.0,
    count=4,
)


def planned(target: hf.Peg, message: str = "") -> CastPlan:
    who = CastSetup(CORD, ARM, hf.MotorLimits())
    return CastPlan(who, target, check_feasibility(who, target), WINDS, message=message)


def test_a_search_that_starts_from_a_plan_near_by_need_not_swing() -> None:
    beside = replace(PEG, x=PEG.x + 0.01)
    given = {"side": -1, "contact": 0.0, "time_budget": 300.0}
    plan = hf.plan_cast(CORD, ARM, beside, start_from=[planned(PEG)], on_plan=lambda _: True, **given)  # type: ignore[arg-type]
    assert plan.success, plan.message
    assert plan.runs < 50  # with none to start from, hundreds of swings
    assert plan.throw is not None
    assert plan.throw.strokes[:4] == pytest.approx(WINDS.strokes, abs=1e-4)


def test_targets_are_planned_from_one_to_the_next_and_told_as_they_were_given(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[float, list[float]]] = []

    def plan_cast(
        rope: hf.Rope, arm: hf.Arm, target: hf.Peg, limits: object, *, start_from: list, seed: int
    ) -> CastPlan:
        assert seed == 3
        asked.append((target.x, [one.target.x for one in start_from]))
        return planned(target, "fails" if target.x == -0.2 else "")

    monkeypatch.setattr(many, "plan_cast", plan_cast)
    places = [0.0, 0.9, -0.2, 0.1, 0.15, -0.3, 0.05]
    plans = hf.plan_casts(CORD, ARM, [replace(PEG, x=x) for x in places], seed=3)
    assert [plan.target.x for plan in plans] == places
    assert [x for x, _ in asked] == [0.0, 0.05, 0.1, 0.15, -0.2, -0.3, 0.9]
    assert [near for _, near in asked] == [
        [],
        [0.0],
        [0.05, 0.0],
        [0.1, 0.05, 0.0],  # three at most
        [0.0],  # those at most a fifth of the rope away
        [],  # the one near by fails
        [],
    ]
    assert hf.plan_casts(CORD, ARM, []) == []
    with pytest.raises(InvalidInput, match="targets"):
        hf.plan_casts(CORD, ARM, PEG)  # type: ignore[arg-type]


@pytest.mark.parametrize("partial", [None, "plan"])
def test_an_interrupt_leaves_the_plans_until_then(monkeypatch: pytest.MonkeyPatch, partial: str | None) -> None:
    done: list[CastPlan] = []

    def plan_cast(rope: hf.Rope, arm: hf.Arm, target: hf.Peg, *_: object, **__: object) -> CastPlan:
        if done:
            raise Interrupted(planned(target, "interrupted") if partial else None)
        done.append(planned(target))
        return done[0]

    monkeypatch.setattr(many, "plan_cast", plan_cast)
    with pytest.raises(Interrupted) as stop:
        hf.plan_casts(CORD, ARM, [PEG, replace(PEG, x=-0.4), replace(PEG, x=-0.3)])
    assert [one.message for one in stop.value.partial] == ["", *(["interrupted"] if partial else [])]
