"""Whips past obstacles: gaps of a swing that passes through them, their derivatives, and a switch behind an edge."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hyperflex as hf
from hyperflex.model import Obstacle
from hyperflex.planning import MotorLimits, Problem, build_whip_map, check_whip_feasibility
from hyperflex.planning.clearance import obstacle_gaps, sampled_obstacle_gaps
from hyperflex.planning.insert.entry import find_entry
from hyperflex.planning.tip.aim import WINDOW, swing_derivatives
from hyperflex.planning.tip.joint_motion import JointMotion
from hyperflex.planning.tip.obstacle_gaps import BESIDE, SLANT, SpareGaps, least_spare_gaps, margins, signed_gaps
from hyperflex.planning.tip.swings import random_swings
from hyperflex.planning.whip.aim import find_peak
from hyperflex.planning.whip.outcome import verify_whip
from hyperflex.planning.whip.search import simulate_peaks
from hyperflex.planning.whip.task import WhipTask
from hyperflex.planning.whip.tip_target import BLOCKED_COST, TipTarget, peak_costs
from tests.planning import known_insert
from tests.planning.known_whip import NEAR, ROPE, STROKES

ARM, LIMITS = hf.Arm(length=0.1), MotorLimits()
WHO = Problem(ROPE, ARM, LIMITS, 4.0)
WALL, POST, FLOOR = hf.Wall(0.2, -0.4, 0.5, 0.6), hf.Peg(0.1, 0.2, 0.15), hf.Ground(0.3, -0.2, nx=0.6, ny=0.8)


def links(count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    begin = np.random.default_rng(seed).uniform(-0.8, 0.8, (count, 1, 2))
    return begin, begin + np.random.default_rng(seed + 1).uniform(-0.3, 0.3, (count, 1, 2))


def test_gaps_outside_are_distances() -> None:
    begin, end = links(500, 1)
    apart, gaps = obstacle_gaps((WALL, POST, FLOOR), begin, end), signed_gaps((WALL, POST, FLOOR), begin, end)
    assert (apart > 0.0).all(axis=1).sum() > 50
    np.testing.assert_array_equal(gaps[apart > 0.0], apart[apart > 0.0])
    assert (gaps[:, 0] < 0.0).any()  # of links through the wall, which have no distance
    assert (apart[:, 0] >= 0.0).all()


def test_a_link_through_a_wall_is_as_deep_as_the_nearest_end_is_far() -> None:
    """The wall's or the rope's, by points of both, 0.1 mm apart."""
    begin, end = links(1200, 3)
    gaps = signed_gaps((WALL,), begin, end)[:, 0, 0]
    part = np.linspace(0.0, 1.0, 4001)[:, None]
    first, last = np.array([WALL.x, WALL.y]), np.array([WALL.x2, WALL.y2])
    wall, seen = first + part * (last - first), [0, 0, 0]
    for k in np.flatnonzero(gaps < 0.0):
        link = begin[k, 0] + part * (end[k, 0] - begin[k, 0])
        normal = np.array([last[1] - first[1], first[0] - last[0]])
        at = link[np.abs((link - first) @ normal).argmin()]  # where it crosses
        assert np.hypot(*(wall - at).T).min() < 2e-4
        # a link that is nearly along the wall crosses at a place that its points tell less well
        ways = [np.hypot(*(at - place)) for place in (end[k, 0], first, last)]
        assert -gaps[k] == pytest.approx(min(ways), abs=2e-3)
        seen[int(np.argmin(ways))] += 1
    assert min(seen) > 2
    more = signed_gaps((WALL,), np.concatenate([begin, end], axis=1), np.concatenate([end, end + 9.0], axis=1))[:, 0, 0]
    assert (more <= gaps).all()  # where the rope goes on, its end is farther


@pytest.mark.parametrize("obstacle", [WALL, POST, FLOOR], ids=["wall", "post", "floor"])
def test_derivatives_of_gaps(obstacle: Obstacle) -> None:
    """Against central differences, by both coordinates of a link of fixed length and its angle."""
    problem: Any = SimpleNamespace(rope=SimpleNamespace(radius=0.0), obstacles=(obstacle,), clearance=2.0)
    begin, end = links(400, 5)
    h, kinds = 1e-6, set[bool]()
    for each in np.concatenate([begin, end], axis=1):
        (x, y), along = each[1] - each[0], np.zeros((2, 2, 3))
        along[:, 0, 0] = along[:, 1, 1] = 1.0
        along[1, :, 2] = -y, x
        motion: Any = SimpleNamespace(
            places=each[None], changes=lambda _, along=along: along, run=SimpleNamespace(dtip=np.zeros((1, 2, 3)))
        )
        (gap,), (change,), (asked,) = least_spare_gaps(problem, motion, 1, np.full(1, BESIDE))
        assert asked == min(BESIDE, max(gap, 0.0))  # no more than at the start
        kinds.add(bool(gap + 2.0 < 0.0))
        moved = each[None, None] + h * np.array([1.0, -1.0])[:, None, None, None] * np.moveaxis(along, 2, 0)
        plus, minus = signed_gaps((obstacle,), moved[:, :, :1], moved[:, :, 1:])[..., 0, 0]
        if isinstance(obstacle, hf.Wall) and gap + 2.0 < 0.0:
            wall = np.array([obstacle.x2 - obstacle.x, obstacle.y2 - obstacle.y])
            if abs(wall[0] * y - wall[1] * x) < 1.01 * SLANT * np.hypot(*wall) * np.hypot(x, y):
                assert np.abs(change).max() < 2.0 / SLANT  # nearly along the wall, where it is bounded
                continue
        np.testing.assert_allclose(change, (plus - minus) / (2.0 * h), atol=1e-4 * max(1.0, np.abs(change).max()))
    assert kinds == {False, True}


def test_gaps_count_once_for_each_time_that_the_rope_comes_near() -> None:
    x = np.array([0.5, 0.004, 0.002, 0.5, 0.003, 0.5, 0.001])
    places = np.stack([np.stack([x, 0.0 * x], axis=-1), np.stack([x, 0.0 * x - 0.1], axis=-1)], axis=1)
    motion: Any = SimpleNamespace(
        places=places, changes=lambda row: np.full((2, 2, 1), row), run=SimpleNamespace(dtip=np.zeros((7, 2, 1)))
    )
    who: Any = SimpleNamespace(rope=SimpleNamespace(radius=0.0), obstacles=(hf.Wall(0.0, -1.0, 0.0, 1.0),), clearance=0)
    assert BESIDE < 0.5
    asked = np.full(1, 0.004)
    found = least_spare_gaps(who, motion, 6, asked)
    assert found.spare == pytest.approx([0.002, 0.003])
    assert found.change[:, 0] == pytest.approx([2.0, 4.0])
    assert found.beside == pytest.approx([0.004, 0.004])
    who.clearance = 0.0025
    assert least_spare_gaps(who, motion, 7, asked).spare == pytest.approx([-0.0005, 0.0005, -0.0015])
    last = (places[0] + [0.1, 0.0], np.full((2, 2, 1), 9.0))  # at a later end the rope is away again
    assert least_spare_gaps(who, motion, 6, asked, last).spare == pytest.approx([-0.0005, 0.0005])
    last = (places[0] - [0.4985, 0.0], np.full((2, 2, 1), 9.0))
    assert least_spare_gaps(who, motion, 6, asked, last).spare == pytest.approx([-0.0005, 0.0005, -0.001])
    assert least_spare_gaps(who, motion, 6, asked, last).change[-1, 0] == pytest.approx(9.0)
    places[0, :, 0] = 0.0035  # the rope begins nearer than is asked
    assert least_spare_gaps(who, motion, 6, asked).beside == pytest.approx([0.001, 0.001])
    who.obstacles = ()
    assert least_spare_gaps(who, motion, 7, np.zeros(0)).spare.size == 0


def test_derivatives_of_gaps_by_strokes() -> None:
    """Of a wall that the rope passes through, one that it passes by, and a post, by central differences of swings."""
    run = hf.simulate(
        rope=ROPE, motion=STROKES.motion(LIMITS), arm=ARM, t_eval=np.linspace(0.0, NEAR, 96), duration=NEAR
    )
    near = run.tip[int(np.argmax(run.tip[:, 0]))]
    some = (
        hf.Wall(near[0] - 0.05, near[1] - 0.2, near[0] - 0.05, near[1] + 0.02),
        hf.Peg(near[0] + 0.02, near[1], 0.01),
    )
    who = replace(WHO, obstacles=(*some, hf.Wall(near[0] + 0.008, near[1] - 0.3, near[0] + 0.008, near[1] + 0.3)))
    aim = find_peak(who, STROKES, NEAR)
    assert aim is not None
    assert aim.gaps.spare.size >= 3
    assert aim.gaps.spare.min() < -0.01
    assert aim.gaps.spare.max() > 0.0
    h, size = 1e-5, STROKES.parameters.size
    for k in range(size):
        change = np.zeros(size)
        change[k] = h
        plus, minus = (find_peak(who, STROKES.varied(s * change), aim.t) for s in (1.0, -1.0))
        assert plus is not None
        assert minus is not None
        by = (plus.gaps.spare - minus.gaps.spare) / (2.0 * h)
        np.testing.assert_allclose(aim.gaps.change[:, k], by, rtol=1e-3, atol=1e-3)


def test_derivatives_of_joints_by_the_length_of_the_rope() -> None:
    """All joints, by central differences of ropes that are longer and shorter."""
    t, h = np.linspace(0.1, 1.5, 15), 1e-5
    run = swing_derivatives(WHO, STROKES, t)
    assert run is not None
    motion = JointMotion(ROPE, run)
    both = []
    for f in (1.0 + h, 1.0 - h):
        rope = ROPE.replace(length=f * ROPE.length, com=f * ROPE.com, inertia=f**2 * ROPE.inertia)
        both.append(
            hf.simulate(rope=rope, motion=STROKES.motion(LIMITS), arm=ARM, t_eval=t, duration=1.5, tol=1e-9).joints
        )
    by = (both[0] - both[1]) / (2.0 * h)
    found = np.array([motion.changes(row)[..., -2] for row in range(t.size)])
    np.testing.assert_allclose(found, by, rtol=0.0, atol=2e-3 * np.abs(by).max())  # AIM_TOL and both runs' errors


def test_what_a_whip_lacks_beside_obstacles() -> None:
    """A gap counts as it lacks to BESIDE while it is aimed, and fails where there is none."""
    task = WhipTask(SimpleNamespace(problem=WHO), TipTarget(0.3, -0.9, least_speed=1.0))  # type: ignore[arg-type]
    aim: Any = SimpleNamespace(speed=9.0, place=np.array([0.3, -0.9]), velocity=np.array([9.0, 0.0]))
    aim.dplace = aim.dvelocity = np.zeros((2, 4))
    spare = np.array([-0.004, 0.003, BESIDE + 0.001])
    aim.gaps = SpareGaps(spare, np.arange(12.0).reshape(3, 4), np.full(3, BESIDE))
    residuals, jacobian = task.residuals(aim)
    assert residuals == pytest.approx([0.0, 0.0, -0.004 - BESIDE, 0.003 - BESIDE])
    assert jacobian[2:].tolist() == aim.gaps.change[:2].tolist()
    assert task.shortfall(aim) == pytest.approx(0.004)
    aim.gaps = SpareGaps(*(each[1:] for each in aim.gaps))
    assert task.shortfall(aim) == 0.0


def test_peaks_behind_an_obstacle_cost_more() -> None:
    walled = replace(WHO, obstacles=(hf.Wall(0.25, -1.5, 0.25, 0.5),))
    strokes = [STROKES, replace(STROKES, side=1, ends=-STROKES.ends)]
    free, there = (simulate_peaks(each, strokes) for each in (WHO, walled))
    assert not free.blocked.any()
    np.testing.assert_array_equal(there.t, free.t)  # what is simulated is the same
    assert (free.place[:, 0] > 0.26).any()
    assert (there.blocked[free.place[:, 0] > 0.26] > 0.0).all()
    for row in range(2):
        assert (np.diff(there.blocked[there.row == row]) >= 0.0).all()  # what was touched before stays touched
    target = TipTarget(0.6, -0.6, least_speed=1.0)
    more = peak_costs(target, there) - peak_costs(target, free)
    assert more == pytest.approx(BLOCKED_COST * there.blocked)
    kept = replace(walled, clearance=0.02)
    lacks = simulate_peaks(kept, strokes).blocked
    touched = there.blocked > 0.0
    assert lacks[touched] == pytest.approx(there.blocked[touched] + 0.02)


def test_margins_are_half_of_what_the_target_leaves() -> None:
    who = replace(WHO, obstacles=(hf.Wall(0.3, -1.2, 0.3, -0.5), hf.Ground(0.0, -2.0)), clearance=0.004)
    place = np.array([[0.3 + ROPE.radius + 0.004 + 0.006, -0.9]])
    assert margins(who, place) == pytest.approx([0.003, BESIDE])
    assert margins(who, np.append(place, [[0.2, -1.995]], axis=0)) == pytest.approx([0.003, 0.0])
    assert WhipTask(SimpleNamespace(problem=who), TipTarget(*place[0])).beside[0] == pytest.approx(0.003)  # type: ignore[arg-type]


def test_the_rope_may_touch_an_obstacle_after_the_peak_only() -> None:
    free = verify_whip(WHO, TipTarget(0.0, 0.0, least_speed=1.0), STROKES.motion(LIMITS), NEAR)
    assert free is not None
    assert free.run is not None
    target = TipTarget(*free.place, least_speed=1.0)
    after = int(np.searchsorted(free.run.t, free.t + 0.04))
    way, place = free.run.tip[after] - free.place, free.run.tip[after]
    across = 0.05 * np.array([-way[1], way[0]]) / np.hypot(*way)
    beyond = hf.Wall(*(place - across), *(place + across))
    assert (
        sampled_obstacle_gaps(
            ROPE, [beyond], *(each[free.run.t <= free.t] for each in (free.run.q, free.run.base))
        ).min()
        > 0
    )
    seen = verify_whip(replace(WHO, obstacles=(beyond,)), target, STROKES.motion(LIMITS), free.t)
    assert seen is not None
    assert seen.message == ""
    assert seen.miss < 1e-4
    assert seen.t == pytest.approx(free.t, abs=1e-3)
    assert seen.touches_later.startswith("the wall at")
    assert float(seen.touches_later.split()[-2]) == pytest.approx(free.t + 0.04, abs=0.02)
    assert free.touches_later == ""
    for sooner in (0.0, 0.004, 0.01, 0.02, 0.04, 0.08, 0.14):  # s; at the peak itself the tip must not be in the wall
        place = free.run.tip[int(np.searchsorted(free.run.t, free.t - sooner))]
        before = hf.Wall(*(place - across), *(place + across))
        seen = verify_whip(replace(WHO, obstacles=(before,)), target, STROKES.motion(LIMITS), free.t)
        assert seen is not None
        assert seen.message.startswith("the rope touches the wall at"), sooner


def test_a_switch_just_before_a_wall_is_struck() -> None:
    """A wall that the tip touches 2 ms after the peak does not move the peak."""
    free = verify_whip(WHO, TipTarget(0.0, 0.0, least_speed=1.0), STROKES.motion(LIMITS), NEAR)
    assert free is not None
    assert free.run is not None
    way = free.velocity / free.speed
    place, across = free.place + 0.005 * way, 0.004 * np.array([-way[1], way[0]])
    beyond = hf.Wall(*(place - across), *(place + across))  # 5 mm less the rope's radius, at 1.3 m/s
    target = TipTarget(*free.place, least_speed=1.0)
    seen = verify_whip(replace(WHO, obstacles=(beyond,)), target, STROKES.motion(LIMITS), free.t)
    assert seen is not None
    assert (seen.message, seen.miss) == ("", pytest.approx(0.0, abs=1e-5))
    assert seen.touches_later.startswith("the wall at")
    assert seen.clearance == pytest.approx(0.0025, abs=5e-4)


def test_short_touches_are_touches() -> None:
    """Of small pegs off which the rope bounces between samples."""
    free = verify_whip(WHO, TipTarget(0.0, 0.0, least_speed=1.0), STROKES.motion(LIMITS), NEAR)
    assert free is not None
    assert free.run is not None
    target, missed = TipTarget(*free.place, least_speed=1.0), 0
    for row in np.searchsorted(free.run.t, free.t + np.linspace(0.03, 0.12, 19)):
        side = np.array([-free.run.tip_velocity[row, 1], free.run.tip_velocity[row, 0]])
        peg = hf.Peg(*(free.run.tip[row] + 0.001 * side / np.hypot(*side)), 0.003, restitution=1.0)
        seen = verify_whip(replace(WHO, obstacles=(peg,)), target, STROKES.motion(LIMITS), free.t)
        assert seen is not None
        assert seen.t == pytest.approx(free.t, abs=1e-4)
        assert seen.run is not None
        moved = np.hypot(*(seen.run.tip[-1] - free.run.tip[-1]))
        missed += bool(moved > 0.005 and not seen.touches_later)
    assert missed == 0
    for row in np.searchsorted(free.run.t, free.t - np.linspace(0.03, 0.12, 19)):
        peg = hf.Peg(*free.run.tip[row], 0.03)  # on which the rope lies more heavily later
        seen = verify_whip(replace(WHO, obstacles=(peg,)), target, STROKES.motion(LIMITS), free.t)
        assert seen is not None
        assert seen.message.startswith("the rope touches the peg at")
        assert seen.clearance <= 0.0
        gaps = sampled_obstacle_gaps(ROPE, [peg], free.run.q, free.run.base)
        first = free.run.t[int((gaps <= 0.0).argmax())]
        assert float(seen.message.split()[-2]) == pytest.approx(first, abs=0.011)  # when it first does, to 10 ms


def test_derivatives_of_a_gap_at_the_peak_itself() -> None:
    """Of a wall that the tip still nears when its speed peaks: the gap is that at the peak, which moves."""
    free = find_peak(WHO, STROKES, NEAR)
    assert free is not None
    way = free.velocity / free.speed
    place, across = free.place + (0.004 + ROPE.radius) * way, 0.002 * np.array([-way[1], way[0]])
    who = replace(WHO, obstacles=(hf.Wall(*(place - across), *(place + across)),))
    aim = find_peak(who, STROKES, NEAR)
    assert aim is not None
    assert aim.gaps.spare == pytest.approx([0.004], abs=2e-4)
    np.testing.assert_allclose(aim.gaps.change[0], -way @ aim.dplace, atol=0.03 * np.abs(aim.dplace).max())


def test_the_peak_before_a_touch_counts_where_it_is_expected_then() -> None:
    """A swing whose tip has two peaks 0.1 s apart, the second of which is higher, and a post in between."""
    strokes = random_swings(WHO, 217)[216]
    peaks = simulate_peaks(WHO, [strokes])
    k = int(np.abs(peaks.t - 3.405).argmin())
    assert peaks.speed[k + 1] > peaks.speed[k]
    assert peaks.t[k + 1] - peaks.t[k] < 0.12
    motion = strokes.motion(LIMITS)
    t = np.array([0.0, 0.5 * (peaks.t[k] + peaks.t[k + 1])])
    between = hf.simulate(rope=ROPE, motion=motion, arm=ARM, t_eval=t, duration=float(t[-1])).tip[-1]
    who = replace(WHO, obstacles=(hf.Peg(*between, 0.004),))
    first, second = (
        verify_whip(who, TipTarget(*peaks.place[j], least_speed=0.5), motion, peaks.t[j]) for j in (k, k + 1)
    )
    assert first is not None
    assert first.message == ""
    assert first.t == pytest.approx(peaks.t[k], abs=0.01)
    assert first.miss < 0.01
    assert first.touches_later.startswith("the peg at")
    assert second is not None
    assert second.message.startswith("the rope touches the peg at")


def test_insertions_are_aimed_past_obstacles() -> None:
    """Beyond the gaps of its walls, an entry has those of what the rope comes near on its way."""
    who = Problem(known_insert.ROPE, known_insert.ARM, LIMITS, 4.0)
    free = find_entry(who, known_insert.SLOT, known_insert.STROKES, known_insert.NEAR)
    assert free is not None
    run = hf.simulate(
        rope=who.rope,
        motion=known_insert.STROKES.motion(LIMITS),
        arm=who.arm,
        t_eval=np.linspace(0.0, 1.8, 181),
        duration=1.8,
    )
    lowest = float(run.joints[..., 1].min())
    floor = hf.Ground(0.0, lowest + 0.03 - who.rope.radius)
    seen = find_entry(replace(who, obstacles=(floor,)), known_insert.SLOT, known_insert.STROKES, known_insert.NEAR)
    assert seen is not None
    assert seen.gaps.size == seen.beside.size > free.gaps.size
    assert seen.gap == pytest.approx(-0.03, abs=2e-3)
    assert seen.dgaps.shape == (seen.gaps.size, free.dgaps.shape[1])
    inwards, aside = known_insert.SLOT.axes
    past = (
        known_insert.SLOT.point + 0.01 * inwards - 0.0195 * aside
    )  # where the free rope comes after its walls stop it
    post = replace(who, obstacles=(hf.Peg(*past, 0.004),))
    found = find_entry(post, known_insert.SLOT, known_insert.STROKES, known_insert.NEAR)
    assert found is not None
    assert found.gap >= 0.0


def test_a_switch_behind_an_edge() -> None:
    """The tip comes over a wall and down behind it; what stands is seen in the plan's own run, and in a free one."""
    rope = hf.Rope.uniform(length=1.0, mass=0.06, n_links=32, radius=0.0025, friction=2e-4)
    wall, point = hf.Wall(0.334, -1.5, 0.334, -0.89), np.array([0.416, -1.015])
    plan = hf.plan_whip(rope, hf.Arm(length=0.105), point, obstacles=[wall], least_speed=3.0, seed=1, time_budget=60.0)
    assert plan.success, plan.message
    assert plan.outcome is not None
    assert plan.motion is not None
    assert plan.outcome.clearance > 0.0
    t = np.arange(0.0, plan.outcome.t, 1e-3)
    free = hf.simulate(rope=rope, motion=plan.motion, arm=hf.Arm(length=0.105), t_eval=t, duration=float(t[-1]))
    assert np.hypot(*(free.tip[-1] - point)) < 0.01  # 1 ms before the peak or less
    assert sampled_obstacle_gaps(rope, [wall], free.q, free.base).min() > 0.0


def test_swings_begin_on_the_side_that_is_free() -> None:
    """A wall below the arm of one side is no reason to stop with an error."""
    right = hf.Wall(0.05, -0.6, 0.5, -0.6)
    assert {each.side for each in random_swings(WHO, 16)} == {-1, 1}
    assert {each.side for each in random_swings(replace(WHO, obstacles=(right,)), 16)} == {-1}
    left = replace(right, x=-0.05, x2=-0.5)
    assert {each.side for each in random_swings(replace(WHO, obstacles=(left,)), 16)} == {1}
    assert {each.side for each in random_swings(WHO, 16, [right])} == {-1}
    begun = STROKES.motion(LIMITS)  # on the left
    assert verify_whip(replace(WHO, obstacles=(left,)), TipTarget(0.0, 0.0), begun, NEAR) is None
    plan = hf.plan_whip(ROPE, ARM, (-0.3, -0.9), obstacles=[left], least_speed=1.0, time_limit=2.0, time_budget=2.0)
    assert plan.strokes is None or plan.strokes.side == 1


def test_a_target_too_near_an_obstacle_is_refused_at_once() -> None:
    wall, target = hf.Wall(0.3, -1.2, 0.3, -0.5), TipTarget(0.305, -0.9, least_speed=1.0)
    known = build_whip_map(replace(WHO, obstacles=(wall,)), swings=64)
    assert check_whip_feasibility(known, target).message == ""
    asked = replace(known, problem=replace(known.problem, clearance=0.003))
    message = check_whip_feasibility(asked, target).message
    assert message.startswith("the target is 5.0 mm from the wall at")
    assert message.endswith("with its radius and clearance the rope needs 5.5 mm")


def test_what_is_in_reach_does_not_depend_on_obstacles() -> None:
    """A search may find swings past a wall that those of the map pass through; a target in it cannot be met."""
    wall, target = hf.Wall(0.25, -1.5, 0.25, 0.5), TipTarget(0.3, -0.9, least_speed=1.0)
    alone, beside = (build_whip_map(replace(WHO, obstacles=walls), swings=64) for walls in ((), (wall,)))
    free, seen = check_whip_feasibility(alone, target), check_whip_feasibility(beside, target)
    assert free.feasible
    assert (seen.cost, seen.message) == (free.cost, "")
    assert beside.candidates(target)[0].cost > alone.candidates(target)[0].cost
    inside = build_whip_map(replace(WHO, obstacles=(hf.Peg(0.3, -0.9, 0.05),)), swings=64)
    assert check_whip_feasibility(inside, target).message == "the target lies in the peg at (0.3, -0.9) m"


def test_no_peak_far_from_its_time_is_taken() -> None:
    """With obstacles the whole swing is looked at, and still only peaks about the time asked count."""
    far, peaks = replace(WHO, obstacles=(hf.Ground(0.0, -3.0),)), simulate_peaks(WHO, [STROKES]).t
    longest = int(np.diff(peaks).argmax())
    between = float(peaks[longest : longest + 2].mean())
    assert np.abs(peaks - between).min() > WINDOW + 0.02  # s, an interval of coarse samples
    assert find_peak(WHO, STROKES, between) is None
    assert find_peak(far, STROKES, between) is None
    assert find_peak(far, STROKES, float(peaks[longest])) is not None


def test_strokes_are_not_changed_by_obstacles_far_away() -> None:
    far = replace(WHO, obstacles=(hf.Ground(0.0, -3.0),))
    alone, beside = find_peak(WHO, STROKES, NEAR), find_peak(far, STROKES, NEAR)
    assert alone is not None
    assert beside is not None
    assert beside.t == pytest.approx(alone.t, abs=1e-5)
    np.testing.assert_allclose(beside.place, alone.place, atol=1e-5)
    np.testing.assert_allclose(beside.dplace, alone.dplace, atol=1e-3)
    assert beside.gaps.spare.size == 0
