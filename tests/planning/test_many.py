"""Casts for many targets: searches start from what stands near by."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.planning import CastPlan, Problem, Throw, check_feasibility
from hyperflex.planning.search.throw_search import ThrowSearch
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
    who = Problem(CORD, ARM, hf.MotorLimits())
    return CastPlan(who, target, check_feasibility(who, target), WINDS, message=message)


def test_a_search_that_starts_from_a_plan_near_by_need_not_swing() -> None:
    beside = replace(PEG, x=PEG.x + 0.01)
    given = {"side": -1, "contact": 0.0, "time_budget": 300.0}
    plan = hf.plan_cast(CORD, ARM, beside, start_from=[planned(PEG)], on_plan=lambda _: True, **given)  # type: ignore[arg-type]
    assert plan.success, plan.message
    assert plan.runs < 50  # with none to start from, hundreds of swings
    assert plan.throw is not None
    assert plan.throw.strokes[:4] == pytest.approx(WINDS.strokes, abs=1e-4)


def test_given_throws_are_tried_within_the_time_of_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    left: list[float] = []

    def try_throws(self: ThrowSearch, throws: list) -> None:
        assert throws == [WINDS]
        assert self.left is not None
        left.append(self.left())

    monkeypatch.setattr(ThrowSearch, "try_throws", try_throws)
    hf.plan_cast(CORD, ARM, PEG, side=-1, start_from=[planned(PEG)], time_budget=1e-3)
    assert len(left) == 1
    assert left[0] < 1e-3


def test_targets_near_others_are_planned_from_these_and_told_as_they_were_given(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[float, list[float]]] = []

    def plan_cast(
        rope: hf.Rope, arm: hf.Arm, target: hf.Peg, limits: object, *, start_from: list, seed: int
    ) -> CastPlan:
        assert seed == 3
        asked.append((target.x, [one.target.x for one in start_from]))
        return planned(target, "fails" if target.x == -0.3 else "")

    monkeypatch.setattr(many, "plan_cast", plan_cast)
    places = [0.0, 0.9, 0.2, 0.3, -0.3, -0.2, 0.1]
    plans = hf.plan_casts(CORD, ARM, [replace(PEG, x=x) for x in places], seed=3)
    assert [plan.target.x for plan in plans] == places
    assert [x for x, _ in asked] == [0.0, 0.9, 0.3, -0.3, 0.2, -0.2, 0.1]  # those apart by 0.24 m, then the others
    assert [near for _, near in asked] == [[], [], [], [], [0.3, 0.0], [0.0], [0.0, 0.3]]  # -0.3 fails
    assert hf.plan_casts(CORD, ARM, []) == []
    with pytest.raises(InvalidInput, match="targets"):
        hf.plan_casts(CORD, ARM, PEG)  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match="target is not of its class"):
        hf.plan_casts(CORD, ARM, [PEG, (0.5, -0.6)])  # type: ignore[list-item]


def stands(plan: CastPlan) -> bool:
    return plan.success


def test_an_executor_changes_no_plan() -> None:
    targets = [replace(PEG, x=x) for x in (-0.45, -3.0, -0.44)]
    given = {
        "side": -1,
        "contact": 0.0,
        "time_budget": 300.0,
        "on_plan": stands,
        "threads": 1,
        "start_from": [planned(PEG)],
    }
    here = hf.plan_casts(CORD, ARM, targets, **given)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = hf.plan_casts(CORD, ARM, targets, executor=pool, chunk_size=2, **given)
    assert [plan.success for plan in here] == [True, False, True]
    assert [plan.message for plan in there] == [plan.message for plan in here]
    for one, other in zip(here[::2], there[::2], strict=True):
        assert one.throw is not None
        assert other.throw is not None
        assert other.throw.strokes.tobytes() == one.throw.strokes.tobytes()
        assert other.runs == one.runs


def test_a_reach_map_tells_what_is_wound_and_reads_back_equal(tmp_path: Path) -> None:
    reach = hf.build_reach_map(
        CORD,
        ARM,
        x=[-0.45],
        obstacles=[hf.Ground(0.0, -3.0)],
        y=[-1.6, -0.5],
        radius=PEG.radius,
        mu=PEG.mu,
        side=-1,
        contact=0.0,
        turns=1.3,
        settle=1.1,
        seed=3,
        holding_force=0.01,
        time_budget=15.0,
        start_from=[planned(PEG)],
    )
    assert (reach.problem.turns, reach.problem.settle) == (1.3, 1.1)
    assert reach.status.tolist() == [[1], [0]]
    assert reach.wound.tolist() == [[False], [True]]
    assert np.isnan(reach.turns[0, 0])
    assert reach.turns[1, 0] > 1.3
    reach.to_netcdf(tmp_path / "reach.nc")
    again = hf.read_reach_map(tmp_path / "reach.nc")
    assert again.problem == reach.problem
    assert (again.time_budget, again.holding_force, again.seed) == (15.0, 0.01, 3)
    for name in ("x", "y", "radius", "mu", "status", "turns", "contact_angle", "seconds"):
        np.testing.assert_array_equal(getattr(again, name), getattr(reach, name))
    assert reach.plot().axes[0].get_title("left").endswith("1 of 1 feasible ones wound, 15 s each (simulated)")
    hf.simulate(CORD, duration=0.1).to_netcdf(tmp_path / "run.nc")
    with pytest.raises(InvalidInput, match="not a reach map"):
        hf.read_reach_map(tmp_path / "run.nc")
    with pytest.raises(InvalidInput, match="increasing"):
        hf.build_reach_map(CORD, ARM, x=[0.2, 0.1])
    with pytest.raises(InvalidInput, match="begins with a rope that hangs"):
        hf.build_reach_map(CORD, ARM, cells=1, state0=hf.State(0.0, np.zeros(CORD.n_links), np.zeros(CORD.n_links)))


def test_rows_of_a_reach_map_are_heights_and_columns_are_x(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def plan_cast(rope: hf.Rope, arm: hf.Arm, target: hf.Peg, *_: object, **__: object) -> CastPlan:
        return replace(planned(target), seconds=target.x + 10.0 * target.y)

    monkeypatch.setattr(many, "plan_cast", plan_cast)
    x, y = [0.1, 0.5, 0.9], [-0.8, 0.3]
    reach = hf.build_reach_map(CORD, ARM, x=x, y=y)
    reach.to_netcdf(tmp_path / "reach.nc")
    for each in (reach, hf.read_reach_map(tmp_path / "reach.nc")):
        assert each.seconds == pytest.approx(np.array(x) + 10.0 * np.array(y)[:, None])
    for damaged in (replace(reach, status=reach.status * np.nan), replace(reach, x=reach.x[::-1])):
        damaged.to_netcdf(tmp_path / "damaged.nc")
        with pytest.raises(InvalidInput, match=r"status|increasing"):
            hf.read_reach_map(tmp_path / "damaged.nc")
    usual = hf.build_reach_map(CORD, hf.Arm(length=0.2, pivot=(1.0, 2.0)), cells=2)
    assert usual.x == pytest.approx([1.35, 2.05])
    assert usual.y == pytest.approx([0.95, 1.65, 2.35, 3.05])


@pytest.mark.parametrize("partial", [None, "plan"])
def test_an_interrupt_leaves_the_plans_until_then(monkeypatch: pytest.MonkeyPatch, partial: str | None) -> None:
    done: list[CastPlan] = []

    def plan_cast(rope: hf.Rope, arm: hf.Arm, target: hf.Peg, *_: object, **__: object) -> CastPlan:
        if done:
            raise Interrupted(replace(planned(target, "interrupted"), interrupted=True) if partial else None)
        done.append(planned(target))
        return done[0]

    monkeypatch.setattr(many, "plan_cast", plan_cast)
    with pytest.raises(Interrupted) as stop:
        hf.plan_casts(CORD, ARM, [PEG, replace(PEG, x=-0.4), replace(PEG, x=-0.3)])
    assert [one.message for one in stop.value.partial] == ["", *(["interrupted"] if partial else [])]
    done.clear()
    with pytest.raises(Interrupted) as stop:
        hf.build_reach_map(CORD, ARM, x=[-0.45], y=[-0.5, -0.45, -0.4])
    reach = stop.value.partial
    assert reach.status.ravel().tolist() == [0, -1, -1]
    assert not reach.complete
    assert "interrupted" in repr(reach)
