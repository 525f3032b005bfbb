"""The search for rests that pump soonest, on a short rope of few links."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.control import PumpingPlan, SwingModel, optimize_pumping
from tests.refusals import left_by, refuses

ROPE = hf.Rope.uniform(length=1.0, mass=0.1, n_links=6, radius=0.003, friction=1e-3)
ARM = hf.Arm(length=0.08)
MODEL = SwingModel(ROPE, ARM, t_move=0.5)
WANTED = 0.75  # m: the best constant rest needs 2.6 s


@pytest.fixture(scope="module")
def plan() -> PumpingPlan:
    return optimize_pumping(MODEL, WANTED, longest=8.0, rounds=12)


def arrives(rests: np.ndarray) -> float:
    """Time at which the tip reaches ``|x|`` = WANTED, s, in a separate run, by an event."""
    motion = MODEL.motion(np.cumsum(np.append(0.0, np.asarray(rests) + 0.5)))
    found = []
    for side in (-1.0, 1.0):
        line = hf.tip_crosses((side * WANTED, 0.0), (1.0, 0.0), sense=0)
        run = hf.simulate(ROPE, motion, arm=ARM, duration=8.0, t_eval=[8.0], tol=1e-7, until=line)
        found.append(np.inf if run.event is None else run.event[1])
    return min(found)


def test_the_best_constant_rest_is_the_best_of_all(plan: PumpingPlan) -> None:
    # In steps of 10 ms; rests as long as half a period need not be tried, so its neighbours and a coarse sweep will do.
    near = plan.constant_rest + 0.01 * np.arange(-3, 4)
    swept = [arrives(np.full(16, max(rest, 0.0))) for rest in (*near, *np.arange(0.0, 0.8, 0.1))]
    # planned with samples of 20 ms and a tolerance of 1e-4 m: the way from sample to sample is 20 mm and near straight
    assert plan.constant_arrival_time == pytest.approx(arrives(np.full(16, plan.constant_rest)), abs=5e-3)
    assert min(swept) > plan.constant_arrival_time - 5e-3


def test_free_rests_are_sooner_and_arrive_when_they_say(plan):
    assert plan.arrival_time < plan.constant_arrival_time - 0.04  # LEAST_GAIN
    # After the arrival the plan's rests are followed by default ones.
    assert arrives(plan.rests) == pytest.approx(plan.arrival_time, abs=5e-3)
    assert plan.rollouts > 60
    assert (plan.rests >= 0.0).all()


def test_the_same_seed_finds_the_same_plan():
    one, same, other = (optimize_pumping(MODEL, WANTED, longest=8.0, rounds=2, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.rests, same.rests)
    assert not np.array_equal(one.rests, other.rests)


def test_no_rounds_keep_the_constant_rest():
    plan = optimize_pumping(MODEL, WANTED, longest=8.0, rounds=0)
    assert plan.arrival_time == plan.constant_arrival_time
    np.testing.assert_array_equal(plan.rests, plan.constant_rest)


def test_ctrl_c_leaves_the_best_so_far(monkeypatch):
    looks = []

    def predict(self, *arguments):
        looks.append(0)
        if len(looks) == 4:
            raise KeyboardInterrupt
        return true(self, *arguments)

    true = SwingModel.predict
    monkeypatch.setattr(SwingModel, "predict", predict)
    plan = left_by(lambda: optimize_pumping(MODEL, WANTED, longest=8.0, rounds=12))
    assert plan.arrival_time == plan.constant_arrival_time
    assert plan.interrupted


def test_what_no_constant_rest_reaches_is_refused():
    refuses("no constant rest pumps the rope up so far", optimize_pumping, MODEL, 1.07, longest=3.0)
