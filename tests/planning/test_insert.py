"""Insertions: entries in closed form, residuals, a complete plan, scenarios, definition of a touch."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.planning import Moves, estimate_insert_probability
from hyperflex.planning.clearance import obstacle_clearance
from hyperflex.planning.ensemble import COUNTED
from hyperflex.planning.planner import Candidate
from hyperflex.planning.tasks.insert import (
    InsertTask,
    _Estimate,
    evaluate_insert,
    find_entries,
    insert_scenarios,
    next_entry,
    usual_uncertainty,
    verify_insert,
)
from hyperflex.planning.tasks.tip import OPTIONS, Flights, coarse_flights, random_swings
from tests.planning.known_insert import ARM, MOVES, NEAR, ROPE, SLOT

LIMITS = hf.MotorLimits()
ONE = hf.SearchOptions(threads=1)
DOWN = hf.Slot(0.1, -0.5, -0.5 * np.pi, width=0.02, depth=0.05, wall=0.1)  # its left is +x


@pytest.fixture(autouse=True, scope="module")
def _first_plan_ends_a_search():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(InsertTask, "improve", 0.0)
        yield


@functools.cache
def planned() -> hf.InsertPlan:
    plan = hf.plan_insert(ROPE, ARM, SLOT, options=ONE, time_budget=200.0, samples=30)
    assert plan.success, plan.message
    return plan


def near() -> float:
    outcome = planned().outcome
    return outcome.t


def aside(slot: hf.Slot, way: float) -> hf.Slot:
    """The slot moved to the left of the way in, m."""
    x, y = slot.point + way * slot.axes[1]
    return replace(slot, x=float(x), y=float(y))


def test_walls_leave_the_gap_free_and_a_tube_begins_at_its_edges():
    walls = replace(DOWN, tube=0.07).walls
    assert walls[:2] == DOWN.walls
    assert [(w.x, w.y, w.x2, w.y2) for w in walls] == [
        pytest.approx((0.11, -0.5, 0.21, -0.5)),
        pytest.approx((0.09, -0.5, -0.01, -0.5)),
        pytest.approx((0.11, -0.5, 0.11, -0.57)),
        pytest.approx((0.09, -0.5, 0.09, -0.57)),
    ]


def swing(problem: hf.Problem, moves: Moves) -> Flights:
    """Return a coarse flight of one swing."""
    return next(coarse_flights(problem, [moves], Budget()))


@pytest.mark.parametrize(
    ("x", "slant", "offset", "gap"),
    [
        (0.104, 0.0, 0.004, 0.006),  # in the gap, 6 mm from its left edge
        (0.098, 0.0, -0.002, 0.008),
        (0.113, 0.0, 0.013, -0.003),  # in the left wall, 3 mm from the gap
        (0.2, 0.0, 0.1, -0.01),  # in the wall, 10 mm from its outer end
        (0.218, 0.0, 0.118, 0.008),  # past its outer end
        (0.1, 1.0, 0.0, 0.01 / np.sqrt(2.0)),  # askew it is nearer to the edges
    ],
)
def test_an_entry_of_a_straight_rope(x, slant, offset, gap):
    """It is pushed in along itself at 1 m/s; then once more, so that the first entry's links count as others."""
    along, t = np.array([-0.3, -0.1, 0.1]), np.arange(-0.2, 0.06, 0.01)
    joints = np.stack([x + slant * (along + t[:, None]), -0.5 - along - t[:, None]], axis=-1)
    (entry,) = find_entries(DOWN, 0.002, t, joints)
    assert entry.offsets == pytest.approx(np.full(3, offset))
    assert entry.t == pytest.approx(-0.05)
    assert entry.depth == pytest.approx(0.15)
    assert entry.speed == pytest.approx(np.hypot(1.0, slant))
    assert not np.isfinite(entry.gaps).any()
    both = np.concatenate([joints, joints])
    second = find_entries(DOWN, 0.002, np.append(t, t + 0.26), both)[1]
    assert second.gaps[: t.size].min() == pytest.approx(gap - 0.002)
    tube = find_entries(replace(DOWN, tube=0.07), 0.002, t, joints)[0]
    assert tube.offsets[3:] == pytest.approx(offset + slant * np.array([0.025, 0.05]))


def test_ways_of_a_tip_beyond_the_walls():
    """A straight rope along the way in whose tip goes in and out; rows of the way and times are those of its depth."""
    depth, t = np.array([0.1, -0.1, 0.2, 0.4, 0.3, -0.1, 0.5, 0.9]), np.arange(8.0)
    joints = np.stack([np.full((8, 2), 0.1), -0.5 - depth[:, None] + [1.0, 0.0]], axis=-1)
    for required, ends in ((0.4, [3, 6]), (0.6, [3, 7])):  # the first never comes so deep: where it is deepest
        found = find_entries(replace(DOWN, depth=required), 0.002, t, joints)
        assert [(each.begin, each.end, each.last) for each in found] == [(2, ends[0], 5), (6, ends[1], 8)]
        assert [each.t_enter for each in found] == pytest.approx([1.0 + 1.0 / 3.0, 5.0 + 1.0 / 6.0])
        assert [each.depth for each in found] == pytest.approx([0.4, 0.9])
    assert find_entries(DOWN, 0.002, t[:2], joints[:2]) == []  # it begins there


def test_a_tip_that_passes_near_the_walls_does_not_go_through_the_slot():
    """The way through the gap counts, though that past the outer end of a wall is nearer in time."""
    t, x = np.arange(8.0), np.repeat([0.1, 0.25], 4)
    depth = np.tile([-0.1, 0.02, 0.06, 0.03], 2)
    joints = np.stack([np.stack([x, x], axis=-1), -0.5 - depth[:, None] + [1.0, 0.0]], axis=-1)
    assert [each.begin for each in find_entries(DOWN, 0.002, t, joints)] == [1, 5]
    assert next_entry(DOWN, 0.002, t, joints, 6.0).begin == 1
    assert next_entry(aside(DOWN, 0.05), 0.002, t, joints, 6.0) is None


def test_a_plan_goes_through_by_its_own_samples():
    plan = planned()
    assert plan.runs > 0
    for seen in (plan.outcome, plan.finer_outcome):
        run, until = seen.run, seen.run.t <= seen.t
        assert run.setup.pegs == SLOT.walls
        assert not np.abs(run.contact_force[until]).any()
        assert SLOT.frame(run.tip)[0].max() >= SLOT.depth
        assert seen.depth >= SLOT.depth
        assert seen.t_enter < seen.t
        ends = np.array([[(w.x, w.y), (w.x2, w.y2)] for w in SLOT.walls])
        part = np.linspace(0.0, 1.0, 400)[:, None]
        wall = np.concatenate([a + part * (b - a) for a, b in ends])
        links = (
            run.joints[until, :-1, None]
            + np.linspace(0.0, 1.0, 9)[:, None] * np.diff(run.joints[until], axis=1)[:, :, None]
        )
        sampled = min(np.hypot(*np.moveaxis(row.reshape(-1, 1, 2) - wall, -1, 0)).min() for row in links[::4])
        # points lie at most 8 mm apart along links and 0.25 mm along walls
        assert sampled - ROPE.radius > seen.wall_clearance - 1e-9
    assert plan.finer_outcome.n_links == 40
    assert plan.success_probability is not None


def test_moves_that_hardly_ever_succeed_in_their_scenarios_are_no_plan():
    plan = planned()
    one = Candidate(plan.required(plan.moves, "moves"), 0.0, near())
    usual, lost = usual_uncertainty(), replace(usual_uncertainty(), place=0.3)  # a place 15 gaps off, by chance
    found = [InsertTask(plan.problem, SLOT, known, 20).verify(one, Budget(math.inf)) for known in (usual, lost)]
    assert not found[0].message
    assert "of 20 sampled scenarios only" in found[1].message
    assert found[0].probability.samples == 20
    few = InsertTask(plan.problem, SLOT, lost, 5).verify(one, Budget(math.inf))
    assert not few.message  # none of five says little
    astray = Candidate(replace(MOVES, ends=-MOVES.ends), 1.0, NEAR)
    failed = InsertTask(plan.problem, SLOT).verify(astray, Budget(math.inf))
    assert failed.message
    assert failed.finer_outcome is None  # a failure ends the verification


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_slot_that_is_not_there_is_touched(side):
    plan = planned()
    motion = plan.required(plan.motion, "motion")
    narrow = aside(SLOT, side * 0.4 * SLOT.width)
    off, on = (verify_insert(plan.problem, replace(narrow, touching=may), motion, near()) for may in (False, True))
    assert "touches a wall at" in off.message
    assert max(off.wall_clearance, on.wall_clearance) <= 0.0
    assert on.message == "" or "mm deep" in on.message
    deeper = verify_insert(plan.problem, replace(SLOT, depth=0.5), motion, near())
    assert "mm deep, 500 mm required" in deeper.message or "touches" in deeper.message


def test_a_plan_into_a_tube_keeps_clear_of_its_sides():
    tube = replace(SLOT, tube=0.05)
    plan = hf.plan_insert(ROPE, ARM, tube, options=ONE, time_budget=200.0, samples=4)
    assert plan.success, plan.message
    run, until = plan.outcome.run, plan.outcome.run.t <= plan.outcome.t
    assert run.setup.pegs == tube.walls
    depth, offset = tube.frame(run.joints[until])
    inside = (depth > 0.0) & (depth < tube.tube) & (np.abs(offset) < 0.1)
    assert inside.any()
    assert np.abs(offset[inside]).max() + ROPE.radius < 0.5 * tube.width


def test_a_touch_of_an_obstacle_is_no_touch_of_a_wall():
    plan, seen = planned(), planned().outcome
    run, row = seen.run, int(np.searchsorted(seen.run.t, seen.t_enter - 0.3))
    force = np.zeros_like(run.contact_force)
    force[row, 8] = 0.0, 0.1
    pushed = replace(run, contact_force=force)
    post = hf.Peg(*(run.joints[row, 8] - [0.0, 0.02]), 0.01)
    beside, alone = (
        evaluate_insert(replace(plan.problem, obstacles=there), SLOT, pushed, seen.t) for there in ([post], ())
    )
    assert beside.wall_clearance == seen.wall_clearance > 0.0
    assert alone.wall_clearance == 0.0


def test_a_tip_that_is_too_fast_inside_fails():
    plan, motion = planned(), planned().required(planned().motion, "motion")
    speed = plan.outcome.speed
    for most, message in ((1.01 * speed, ""), (0.9 * speed, f"the tip has {speed:.2f} m/s there")):
        seen = verify_insert(plan.problem, replace(SLOT, max_speed=most), motion, near())
        assert seen.message.startswith(message)
        assert bool(seen.message) is bool(message)


def test_a_floor_that_the_rope_would_touch_is_kept_clear_of():
    lowest = float(planned().outcome.run.joints[..., 1].min())
    who = replace(planned().problem, obstacles=(hf.Ground(0.0, lowest + 0.01),))
    motion = planned().required(planned().motion, "motion")
    seen = verify_insert(who, SLOT, motion, near())
    assert seen is None or "touches the ground" in seen.message
    free, blocked = (
        InsertTask(each, SLOT).score(swing(each, planned().moves))[0][0] for each in (planned().problem, who)
    )
    assert free < 0.1
    assert blocked > free + 0.03  # three times the depth in the floor, with the radius


def test_free_swings_agree_with_runs_near_the_walls():
    """In each of some scenarios, half of which fail: the slot is 6 mm off."""
    plan = planned()
    moves = plan.required(plan.moves, "moves")
    wide = replace(usual_uncertainty(), place=6e-3)
    count = 12
    told, seen = _Estimate(plan.problem, near()), []
    for each in insert_scenarios(plan.problem, SLOT, moves, wide, count, [7001, 0]):
        found = verify_insert(replace(plan.problem, rope=each[0]), *each[1:], near())
        seen.append(found is not None and not found.message)
        assert told([each]) == seen[-1]
    assert 0 < sum(seen) < count


def certain(problem: hf.Problem, slot: hf.Slot = SLOT) -> int:
    """Successes in three scenarios that are all as planned."""
    none = replace(usual_uncertainty(), place=0.0, timing=0.0)
    return estimate_insert_probability(problem, slot, MOVES, NEAR, none, samples=3).successes


def test_a_scenario_fails_where_a_run_with_as_many_links_does():
    """The tip is too fast, the slot elsewhere, or arm, shaft or obstacle 1 mm nearer than allowed, not 1 mm less."""
    who = hf.Problem(ROPE, ARM, LIMITS, 4.0)
    seen = verify_insert(InsertTask(who, SLOT).finer, SLOT, MOVES.motion(who.limits), NEAR)
    for part, successes in ((1.02, 3), (0.98, 0)):
        assert certain(who, replace(SLOT, max_speed=part * seen.speed)) == successes
    assert certain(who, aside(SLOT, 0.03)) == 0
    lowest = float(seen.run.joints[..., 1].min()) - ROPE.radius
    shaft = 0.01 + obstacle_clearance(seen.run, [hf.Peg(0.0, 0.0, 0.01)]).value
    for more, successes in ((-1e-3, 3), (1e-3, 0)):
        assert certain(replace(who, clearance=seen.clearance + more)) == successes
        assert certain(replace(who, arm=hf.Arm(length=0.1, shaft_radius=shaft + more))) == successes
        assert certain(replace(who, obstacles=(hf.Ground(0.0, lowest + more),))) == successes


def test_out_of_reach_is_reported_before_any_search():
    far = hf.plan_insert(ROPE, ARM, hf.Slot(1.2, 0.0, 0.0))
    assert (far.success, far.status) == (False, "infeasible")
    assert "the rope ends 0.15 m short of the target" in far.message
    up = hf.plan_insert(ROPE, ARM, hf.Slot(0.0, 0.3, 0.5 * np.pi), conditions=hf.Conditions(time_limit=0.5))
    assert (up.success, up.status) == (False, "infeasible")
    assert "in no swing does the tip go through" in up.message
    late = hf.plan_insert(ROPE, ARM, hf.Slot(0.0, 0.3, 0.5 * np.pi), time_budget=1e-6)
    assert (late.success, late.status) == (False, "out of time")


def test_no_swing_begins_at_a_wall():
    x = ARM.length + ROPE.radius - 2e-4  # the rope hangs to the arm's right, 0.2 mm deep in the end of a wall
    slot = hf.Slot(x + 0.11, -0.5, -0.5 * np.pi, width=0.02, wall=0.1)
    task = InsertTask(hf.Problem(ROPE, ARM, LIMITS, 0.5), slot)
    task.prepare(Budget(threads=1))
    assert {each.moves.side for each in task.swings} <= {-1}
    assert {each.side for each in random_swings(task.problem, 8, slot.walls)} == {-1}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"width": 0.014}, r"too narrow for the rope.*0.015 m, 3 diameters"),
        ({"width": 0.0}, "slot width has the wrong sign"),
        ({"depth": np.inf}, "slot depth is not finite"),
        ({"direction": "down"}, "slot direction is not a number"),
        ({"tube": -0.1}, "slot tube has the wrong sign"),
        ({"max_speed": 0.0}, "slot max_speed has the wrong sign"),
        ({"touching": "yes"}, "slot touching is neither true nor false"),
    ],
)
def test_slots_that_are_refused(change, words):
    with pytest.raises(hf.InvalidInput, match=words):
        hf.plan_insert(ROPE, ARM, hf.Slot(**{"x": 0.2, "y": -0.8, "direction": 0.0} | change))


def test_residuals_are_offsets_and_what_an_entry_lacks():
    """An obstacle 30 mm in the rope's way adds to them; an entry that fails says by how much."""
    problem = hf.Problem(ROPE, ARM, LIMITS, 4.0)
    (free,) = InsertTask(problem, SLOT).aims([MOVES], [NEAR], Budget(math.inf))
    assert free.good
    assert free.residuals[3] > -0.1 * SLOT.depth  # what it lacks to a tenth more than the required depth
    assert free.residuals[4:] == pytest.approx(0.0)
    lowest = float(swing(replace(problem, time=1.8), MOVES).joints[..., 1].min())
    floor = hf.Ground(0.0, lowest + 0.03 - ROPE.radius)
    (seen,) = InsertTask(replace(problem, obstacles=(floor,)), SLOT).aims([MOVES], [NEAR], Budget(math.inf))
    assert -seen.score == pytest.approx(0.03, abs=2e-3)
    assert seen.residuals[4:].min() == pytest.approx(-0.03 - OPTIONS.spare - InsertTask.close, abs=1e-3)
    (deeper,) = InsertTask(problem, replace(SLOT, depth=0.5)).aims([MOVES], [NEAR], Budget(math.inf))
    assert deeper.score < -0.1


def test_an_estimate_does_not_outlast_its_time():
    given = (hf.Problem(ROPE, ARM, LIMITS, 4.0), SLOT, MOVES, NEAR)
    ticks = iter(np.arange(0.0, 100.0, 1.0))
    budget = Budget(8.0, clock=lambda: float(next(ticks)), threads=1)
    found = estimate_insert_probability(*given, samples=100, time_budget=budget)
    assert found.samples % COUNTED == 0
    assert 0 < found.samples < 100
    assert estimate_insert_probability(*given, time_budget=1e-9).samples == 0


@pytest.mark.parametrize(
    ("given", "now", "touches"),
    [
        (0.6e-3, 0.2e-3, True),
        (0.1e-3, 3.2e-3, True),
        (0.4e-3, 0.5e-3, False),  # both runs agree
        (0.8e-3, 2.4e-3, False),  # far enough
    ],
)
def test_runs_that_differ_by_more_than_the_distance_from_the_walls_fail(given, now, touches):
    plan = planned()
    first, finer = (replace(plan.outcome, wall_clearance=gap) for gap in (given, now))
    for touching in (False, True):
        task = InsertTask(plan.problem, replace(SLOT, touching=touching))
        assert bool(task.failure(Candidate(MOVES, 1.0, NEAR), finer, first)) == (touches and not touching)
