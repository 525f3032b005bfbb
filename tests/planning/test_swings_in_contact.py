"""Swings through contact, for targets that stop each free swing."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.planning import MotorLimits, Problem, SearchOptions, plan_cast
from hyperflex.planning.clearance import sampled_obstacle_gaps
from hyperflex.planning.feasibility import longest_time
from hyperflex.planning.moves import Moves
from hyperflex.planning.planner import Verified
from hyperflex.planning.swings import Strike
from hyperflex.planning.swings_in_contact import SwingsInContact
from hyperflex.planning.tasks.wind import WindTask
from tests.refusals import refuses

ROPE, ARM = hf.Rope.uniform(0.8, 0.04, 20, 0.003, friction=1e-4), hf.Arm(length=0.08)
PEG = hf.Peg(0.05, -0.36, 0.025, 0.3)  # beside the rope that hangs


def search(problem: Problem, seed: int = 0) -> SwingsInContact:
    options = SearchOptions(threads=1)
    return SwingsInContact((problem, problem.cut(2)), PEG, [-1, 1], np.random.default_rng(seed), options)


@pytest.fixture(scope="module")
def problem() -> Problem:
    problem = Problem(ROPE, ARM, MotorLimits())
    return replace(problem, time=longest_time(problem))


def swung(problem: Problem, moves: Moves, step: float) -> hf.Trajectory:
    """Simulate moves from rest, in one run, until the last swing is over."""
    motion, limits = moves.motion(problem.limits), problem.limits
    until = moves.stops(limits) + SearchOptions().watched * problem.period
    rope = {"q0": problem.start[0], "pegs": [PEG], "refine": False}
    return hf.simulate(ROPE, motion, arm=ARM, duration=until, contact_step=step, **rope)


def test_strokes_in_contact_wind_a_rope_as_one_run_of_all_of_them(problem):
    """Strokes begin from states of coarse runs; the run has a tenth of their steps, and a hundredth of their error."""
    found, one = [], search(problem)
    while not found or found[0].score < 1.25:
        found = one.extend(Budget(60.0))
    best = found[0]
    run = swung(problem, best.moves, 2e-4)
    assert np.abs(hf.winding.turns(run, PEG)).max() == pytest.approx(best.score, abs=0.1)
    assert np.abs(run.q[np.abs(run.t - best.t).argmin()] - best.states[0].q).max() < 0.02  # rad, after 13 strokes
    assert best.through_contact
    assert best.t < best.moves.stops(problem.limits) + problem.period
    assert [each.t for each in best.states] == [best.t] * 2
    assert [each.q.size for each in best.states] == [ROPE.n_links, 2 * ROPE.n_links]


def test_swings_that_touch_an_obstacle_are_not_continued(problem):
    wall = hf.Peg(-0.2, -0.65, 0.05)
    behind, one = replace(problem, obstacles=(wall,)), search(replace(problem, obstacles=(wall,)))
    free = search(problem)
    for each in (one, free):
        for _ in range(4):
            each.extend(Budget(60.0))
    gaps = []
    for each in (one, free):
        least = np.inf
        for swing in each._lanes[0].swings:
            run = swung(behind, swing.moves, 2e-4)
            before = run.t < swing.moves.stops(problem.limits)
            joints = ARM.tip(swing.moves.motion(problem.limits).angle(run.t))
            least = min(least, sampled_obstacle_gaps(ROPE, [wall], run.q[before], joints[before]).min())
        gaps.append(least)
    assert gaps[0] > 0.0 >= gaps[1]  # the obstacle is in the way of swings that do not know of it


def test_runs_that_fail_or_begin_too_near_the_arm_are_no_strikes(problem):
    options = SearchOptions(nearly=0.0, speeds=(0.5, 1.0))
    one = SwingsInContact((problem, problem.cut(2)), PEG, [1], np.random.default_rng(0), options)
    one.problem = replace(problem, clearance=0.2)
    one.chains = tuple(replace(each, clearance=0.2) for each in one.chains)
    assert one.extend(Budget(60.0)) == []  # the arm's tip is nearer than that to the shaft
    free = search(problem)
    free.extend(Budget(60.0))
    assert all(swing.moves.speeds.tolist() == [1.0] for swing in free._lanes[0].swings)


def test_a_rope_that_was_measured_is_not_cast_from_rest(problem):
    state = hf.RopeState(1.0, np.zeros(20), np.zeros(20))
    seen = [(Moves(1, np.array([-1.5]), np.array([0.1])), state)]
    for anew in (True, False):
        task = WindTask(problem, PEG, SearchOptions(threads=1), seen=seen, anew=anew)
        task.search.passes = 1
        assert task._stopped == anew


@pytest.mark.parametrize("dear", ["draw", "verification"])
def test_free_swings_and_those_through_contact_get_the_same_time(problem, monkeypatch, dear):
    """What is dear takes 30 s through contact, all else 1 s."""
    free, pumped = (Strike(Moves(1, np.full(1, -1.5), np.full(1, 0.1)), 1.0, 1.0, through_contact=k) for k in (0, 1))
    now, spent = [0.0], {free: 0.0, pumped: 0.0}

    def step(one, what):
        seconds = 30.0 if one is pumped and what == dear else 1.0
        now[0] += seconds
        spent[one] += seconds
        return [one] if what == "draw" else Verified(one, None, None, "it comes off", -1.0)

    monkeypatch.setattr(WindTask, "_free", lambda *given: step(free, "draw"))
    monkeypatch.setattr(WindTask, "_through_contact", lambda *given: step(pumped, "draw"))
    monkeypatch.setattr("hyperflex.planning.tasks.wind.verify_members", lambda *given: step(given[3], "verification"))
    task, budget = WindTask(problem, PEG, SearchOptions(threads=1)), Budget(1e6, clock=lambda: now[0])
    assert [task.sample([], budget) for _ in range(50)] == [[free]] * 50  # the target does not stop free swings
    task.search.passes, spent[free], drawn = 1, 0.0, []
    for _ in range(500):
        drawn += task.sample([], budget)
        task.verify(drawn[-1], budget)
    assert free in drawn[:3]  # the time before does not count
    assert spent[pumped] / spent[free] == pytest.approx(1.0, rel=0.1)


@pytest.fixture(scope="module")
def plan() -> hf.CastPlan:
    coarse = hf.Rope.uniform(0.8, 0.04, 10, 0.003, friction=1e-4)
    return plan_cast(coarse, ARM, PEG, options=SearchOptions(threads=1), time_budget=60.0)


def test_a_target_that_stops_each_free_swing_is_wound(plan):
    assert plan.success
    assert plan.outcome.strike_time > plan.outcome.touch_time + plan.problem.period


def test_a_search_begins_with_a_plan_that_swings_on_through_contact(plan):
    task = WindTask(plan.problem, PEG, SearchOptions(threads=1), start=[plan.moves])
    found = task.rollout(task.sample([], Budget(60.0)), Budget(60.0))
    assert [one.good for one in found] == [True]
    assert not task._winds_freely


def test_a_rope_that_comes_off_and_strikes_after_the_time_limit_fails(plan):
    late = plan.outcome.strike_time - 0.1
    one = Strike(plan.moves, 1.0, late, through_contact=True)
    task = WindTask(plan.problem, PEG, SearchOptions(threads=1), longest=late)
    assert task.verify(one, Budget(60.0)).message.startswith("it strikes at")


def test_a_plan_that_swings_on_through_contact_is_not_followed(plan):
    refuses("must not touch the target before", hf.planning.follow_plan, plan, None)
