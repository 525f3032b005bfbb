"""Casts that begin with a swinging rope and the arm at rest, with the state from a tracker."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import winding
from hyperflex.interfaces import RopeState
from hyperflex.model import cuts, divided, refine_rope
from hyperflex.planning import CastPlan, Problem
from hyperflex.planning.rollouts import RolloutBatch, free_sides
from hyperflex.planning.verification import verified_setup

CORD = hf.Rope.uniform(length=1.2, mass=0.06, n_links=12, radius=0.004, friction=1e-3)
ARM = hf.Arm(length=0.2)
PEG = hf.Peg(-0.45, -0.5, 0.04, 0.4)
BEFORE = 0.3  # s from what is seen to the motion's begin
SEEN = RopeState(-BEFORE, np.linspace(0.3, 0.5, 12), np.full(12, -0.5))
SWINGS = Problem(CORD, ARM, hf.MotorLimits(), side=-1, q0=tuple(SEEN.q), qd0=tuple(SEEN.qd))


def test_a_plan_from_a_swinging_rope_winds_in_a_run_from_what_was_seen(tmp_path):
    """With links that the planner did not use. The first successful plan ends the search on request."""
    heard: list[CastPlan] = []

    def on_plan(found):
        heard.append(found)
        return True

    conditions = hf.Conditions(state0=SEEN, side=-1)
    criteria = hf.WindCriteria(contact=0.0)
    plan = hf.plan_cast(CORD, ARM, PEG, conditions=conditions, criteria=criteria, time_budget=300.0, on_plan=on_plan)
    assert plan.success, plan.message
    assert [one.moves for one in heard] == [plan.moves]
    stop = BEFORE + float(plan.motion.breaks[-1])
    motion = hf.hold_arm(float(plan.motion.angle(0.0))).then(plan.motion.shifted(BEFORE), BEFORE)
    start = {"q0": np.repeat(SEEN.q, 2), "qd0": np.repeat(SEEN.qd, 2)}
    run = hf.simulate(divided(CORD, 2), motion, arm=ARM, duration=stop + 3.0, pegs=[PEG], **start)
    assert np.abs(winding.turns(run, PEG)[run.t > stop + 1.0]).min() >= 1.25
    rest = hf.simulate(replace(plan.setup(), q0=None, qd0=None), t_eval=[0.5])
    assert np.abs(rest.q[-1] - hf.simulate(plan.setup(), t_eval=[0.5]).q[-1]).max() > 0.1  # the swing matters
    plan.to_toml(tmp_path / "cast.toml")
    assert hf.read_plan(tmp_path / "cast.toml").problem == plan.problem
    assert plan.problem.q0


def test_a_start_is_that_of_the_same_rope_with_shorter_links():
    assert np.array_equal(SWINGS.cut(3).start[0], np.repeat(SEEN.q, 3))
    fine = refine_rope(CORD, [PEG], arm=ARM)
    q, _ = SWINGS.cut(cuts(CORD, [PEG], arm=ARM)).start
    assert q.size == fine.n_links > CORD.n_links
    assert fine.joints(q, np.zeros(2))[-1] == pytest.approx(CORD.joints(SEEN.q, np.zeros(2))[-1], abs=1e-12)
    setup = verified_setup(SWINGS, hf.hold_arm(-np.pi / 2), 1.0, (PEG,))
    assert np.array_equal(setup.q0, q)
    assert verified_setup(replace(SWINGS, q0=(), qd0=()), hf.hold_arm(0.0), 1.0).q0 is None


def test_all_swings_of_a_search_begin_there():
    assert free_sides(SWINGS, [PEG]) == [-1]
    batch = RolloutBatch.from_start(SWINGS, [CORD] * 2, [], [hf.hold_arm(0.0)] * 2)
    assert np.array_equal(batch.q, [SEEN.q] * 2)
    assert np.array_equal(batch.qd, [SEEN.qd] * 2)
    assert free_sides(replace(SWINGS, q0=(), qd0=(), side=1), [PEG]) == [1]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"side": 0}, "side of the arm at the start"),
        ({"side": 2}, "side of the arm at the start"),
        ({"state0": RopeState(0.1, SEEN.q, SEEN.qd)}, "after the motion's begin"),
        ({"state0": "swings"}, "no rope state"),
        ({"state0": RopeState(0.0, SEEN.q[1:], SEEN.qd[1:])}, "q0"),
        ({"state0": RopeState(0.0, SEEN.q, np.full(12, np.nan))}, "qd0"),
    ],
)
def test_a_start_that_cannot_be_is_refused(change, told):
    given: dict[str, object] = {"state0": SEEN, "side": -1} | change
    with pytest.raises(hf.InvalidInput, match=told):
        hf.plan_cast(CORD, ARM, PEG, conditions=hf.Conditions(**given), time_budget=0.01)


def test_a_rope_that_touches_something_before_the_motion_begins_is_not_cast():
    """SEEN swings to the left, past its hanging position, to a wall that it does not touch at first."""
    held = hf.hold_arm(-np.pi / 2)
    tips = hf.simulate(CORD, held, arm=ARM, duration=2.0, q0=SEEN.q, qd0=SEEN.qd).tip
    least = float(tips[:, 0].min())
    wall = hf.Wall(0.5 * (least - 0.2), -1.5, 0.5 * (least - 0.2), -0.8)
    assert tips[0, 0] > wall.x + 0.1
    seen = RopeState(-2.0, SEEN.q, SEEN.qd)
    plan = hf.plan_cast(
        CORD, ARM, PEG, conditions=hf.Conditions(state0=seen, side=-1, obstacles=[wall]), time_budget=60.0
    )
    assert not plan.success
    assert plan.feasibility.impossible
    assert "the rope touches the wall at" in plan.message
    assert "before the motion begins" in plan.message
    assert plan.runs == 0
