"""Casts past obstacles, which the rope must not touch: distances, the search's view of them, and verified runs."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.planning import check_feasibility, check_whip_feasibility, verify_cast
from hyperflex.planning.clearance import FINE, obstacle_clearance, sampled_obstacle_gaps
from hyperflex.planning.rollouts import RolloutBatch, simulate_contact
from hyperflex.planning.verification import verified_setup
from tests.planning.known import CABLE, PEG, WINDS, planned, problem, simulated_strikes
from tests.refusals import refuses

FLOOR, POST, WALL = hf.Ground(0.0, -2.5, 0.3, 1.0), hf.Peg(1.2, -1.2, 0.2), hf.Wall(-1.6, -1.8, -1.3, -0.4)


def distance(obstacle: hf.Peg | hf.Wall | hf.Ground, points: np.ndarray) -> np.ndarray:
    """Distances of points (..., 2) from an obstacle, by another way than the library's."""
    if isinstance(obstacle, hf.Peg):
        return np.linalg.norm(points - [obstacle.x, obstacle.y], axis=-1) - obstacle.radius
    if isinstance(obstacle, hf.Ground):
        out = np.array([obstacle.nx, obstacle.ny])
        return (points - [obstacle.x, obstacle.y]) @ (out / np.linalg.norm(out))
    begin, end = (complex(*place) for place in ((obstacle.x, obstacle.y), (obstacle.x2, obstacle.y2)))
    along = (points[..., 0] + 1j * points[..., 1] - begin) / (end - begin)  # the wall lies from 0 to 1
    return np.abs(end - begin) * np.abs(along - np.clip(along.real, 0.0, 1.0))


@pytest.mark.parametrize("obstacle", [FLOOR, POST, WALL], ids=["floor", "post", "wall"])
def test_distances_are_those_of_many_points_of_the_rope(obstacle):
    rope = CABLE.replace(radius=0.01)
    for q in np.random.default_rng(5).uniform(-1.2, 1.2, (8, rope.n_links)):
        joints = rope.joints(q[None], np.zeros((1, 2)))[0]
        share = np.linspace(0.0, 1.0, 41)[:, None, None]
        points = (joints[:-1] * (1.0 - share) + joints[1:] * share).reshape(-1, 2)
        there = sampled_obstacle_gaps(rope, [obstacle], q[None], np.zeros((1, 2)))[0]
        want = distance(obstacle, points).min() - rope.radius
        assert there == pytest.approx(want, abs=1e-3)  # the points are 1 mm apart
        for within in (0.5 * there, 2.0 * there):
            stated = sampled_obstacle_gaps(rope, [obstacle], q[None], np.zeros((1, 2)), within)[0]
            assert stated == there if there <= within else within <= stated <= there


def test_a_run_tells_which_obstacle_it_comes_near_and_when():
    run = planned().run
    k = int(np.argmin(distance(POST, run.tip)))
    near = replace(POST, radius=POST.radius + 0.9 * float(distance(POST, run.tip)[k]))
    found = obstacle_clearance(run, [FLOOR, near])
    assert found.what == "the peg at (1.2, -1.2) m"
    between = found.value - (float(sampled_obstacle_gaps(run.setup.rope, [near], run.q, run.base).min()) - 0.5 * FINE)
    assert -0.03 < between <= 1e-9  # samples are 10 ms apart: the rope comes nearer between two of them


def test_a_cast_that_touches_an_obstacle_fails_and_reports_which():
    run, motion = planned().run, WINDS.motion(problem().limits)
    aside = hf.Ground(float(run.tip[:, 0].max()) - 0.05, 0.0, -1.0, 0.0)
    seen = verify_cast(replace(problem(), obstacles=[aside]), PEG, motion)
    assert not seen.success
    assert seen.clearance <= 0.0
    assert "touches the ground" in seen.message
    blocked = verify_cast(replace(problem(), obstacles=[replace(aside, x=aside.x - 0.6)]), PEG, motion)
    assert not blocked.wound
    assert "; the rope touches the ground at" in blocked.message  # why it does not wind
    far = replace(aside, x=aside.x + 0.15)
    with_room = replace(problem(), obstacles=[far])
    seen = verify_cast(with_room, PEG, motion)
    assert seen.success
    room = obstacle_clearance(run, [far]).value
    assert seen.clearance == pytest.approx(min(room, planned().outcome.clearance), abs=1e-3)
    short = verify_cast(replace(with_room, clearance=room + 0.01), PEG, motion)
    assert f"comes within {1e3 * room:.0f}"[:-1] in short.message or "the arm" in short.message


def test_a_touch_between_two_samples_is_seen():
    who, motion = problem(), WINDS.motion(problem().limits)
    t = np.arange(0.0, 4.3, 0.01)
    for x, y in ((0.85778, -1.65443), (0.8414, -1.68562), (0.16175, -1.99088), (0.08262, -1.97463)):
        post = hf.Peg(x, y, 0.003, 0.1)
        setup = verified_setup(replace(who, obstacles=[post]), motion, 4.3)
        run = hf.simulate(setup, t_eval=t)
        assert run.attrs["contact_impacts"] > 0.0
        assert obstacle_clearance(run, [post]).value <= 0.0  # cubic interpolation alone passes it by 1 to 2 mm
        free = hf.simulate(replace(setup, pegs=()), t_eval=t)
        assert obstacle_clearance(free, [post]).value < -0.5e-3


def test_a_search_sees_what_lies_in_the_way():
    run = planned().run
    free = simulated_strikes(problem(), PEG, [WINDS])
    assert np.isfinite(free.t[0])
    before = run.tip[run.t < free.t[0]]
    aside = hf.Ground(float(before[:, 0].max()) - 0.05, 0.0, -1.0, 0.0)
    blocked = simulated_strikes(replace(problem(), obstacles=[aside]), PEG, [WINDS])
    assert np.isnan(blocked.t[0])
    assert blocked.clear[0] < free.clear[0]
    assert blocked.score[0] < 0.0
    motion = WINDS.motion(problem().limits).shifted(-free.t[0])
    one = RolloutBatch([CABLE], [PEG], [motion], free.q, free.qd)
    loose = replace(problem(), clearance=-np.inf)
    on = simulate_contact(loose, one, free.t, Budget(threads=1))
    after = run.joints[run.t > free.t[0] + 0.1].reshape(-1, 2)
    lowest = hf.Ground(0.0, float(after[:, 1].min()) + 0.02)
    off = simulate_contact(replace(loose, obstacles=[lowest]), one, free.t, Budget(threads=1))
    assert off.score[0] < on.score[0]
    assert off.turns[0] < on.turns[0]
    assert np.isinf(off.slip[0])  # it ended before it had settled
    assert np.isfinite(on.slip[0])


def test_obstacles_that_cannot_be_are_refused():
    refuses("turning arm hits the wall", replace, problem(), obstacles=[hf.Wall(0.05, -0.05, 0.05, 0.05)])
    with pytest.raises(hf.InvalidInput, match="past obstacles are not followed"):
        hf.follow_plan(replace(planned(), problem=replace(problem(), obstacles=[FLOOR])), None)


def test_a_start_or_target_in_an_obstacle_is_reported_before_a_search():
    arm, floor, post = hf.Arm(length=0.105), hf.Ground(0.0, -1.0), hf.Peg(-0.8, -1.1, 0.1)
    slot = hf.Slot(0.56, -1.9, -0.78)
    for plan in (
        lambda: hf.plan_cast(CABLE, arm, PEG, conditions=hf.Conditions(obstacles=[floor])),
        lambda: hf.plan_whip(CABLE, arm, hf.TipTarget(0.3, -2.05), conditions=hf.Conditions(obstacles=[floor])),
        lambda: hf.plan_insert(CABLE, arm, slot, conditions=hf.Conditions(obstacles=[floor])),
    ):
        refuses(r"the rope begins in the ground at \(0, -1\) m, whatever", plan)
    turned = CABLE.replace(gravity=(0.17, -9.81))
    for plan in (
        lambda: hf.plan_cast(turned, arm, PEG),
        lambda: hf.plan_whip(turned, arm, hf.TipTarget(0.3, -2.05)),
        lambda: hf.plan_insert(turned, arm, slot),
    ):
        refuses(r"gravity along -y; the rope has \(0.17, -9.81\) m/s\^2", plan)
    refuses("obstacles holds something else", hf.Conditions, obstacles=post)
    seen = hf.plan_cast(CABLE, arm, hf.Peg(-0.8, -1.1, 0.03), conditions=hf.Conditions(obstacles=[post]))
    assert (seen.status, seen.message) == ("infeasible", "the target lies in the peg at (-0.8, -1.1) m")
    whip_map = hf.build_whip_map(replace(problem(), obstacles=[post], time=1.0), swings=1)
    assert check_whip_feasibility(whip_map, hf.TipTarget(-0.8, -1.1)).message == seen.message


def test_a_target_that_the_rope_begins_in_is_not_feasible_and_others_are_planned_all_the_same():
    places = [hf.Peg(-0.105, -1.0, 0.03), hf.Peg(-0.8, 1.9, 0.03)]
    on, far = hf.plan_cast(CABLE, hf.Arm(length=0.105), places, conditions=hf.Conditions(side=-1))
    assert on.message.startswith("the rope begins in the target")
    assert (on.status, far.status) == ("infeasible", "infeasible")


@pytest.mark.nightly
def test_obstacles_that_leave_a_wound_rope_no_room_are_reported_before_a_search():
    """And places that they leave none are no fallback targets, and a remedy is one that makes room."""
    arm, room = hf.Arm(length=0.105), 2e3 * CABLE.radius
    near = hf.Wall(PEG.x - PEG.radius - 0.003, -1.5, PEG.x - PEG.radius - 0.003, -0.8)
    plan = hf.plan_cast(CABLE, arm, PEG, conditions=hf.Conditions(obstacles=[near]))
    said = f"out of reach: the wall at ({near.x:.4g}, -1.5) m is 3 mm from the target, the rope needs {room:.3g}"
    assert (plan.status, plan.message, plan.feasibility.impossible) == ("infeasible", said, False)
    assert plan.remedies == ("a peg of 37.9 mm radius",)
    assert plan.fallback.target.x - PEG.radius - near.x >= 2.0 * CABLE.radius
    assert plan.fallback.distance < 0.02
    between = hf.Wall(-0.7, -0.4, -0.2, -0.9)
    for obstacles in ([between], [hf.Peg(2.0, 0.0, 0.1), between]):
        behind = hf.plan_cast(CABLE, arm, PEG, conditions=hf.Conditions(obstacles=obstacles))
        assert behind.message == "out of reach: the wall at (-0.7, -0.4) m is between the arm and the target"
        there = behind.fallback.target
        sight = [np.linspace(tip, (there.x, there.y), 4001) for tip in arm.tip(np.linspace(-np.pi, np.pi, 25))]
        assert max(distance(between, way).min() for way in sight) > 0.0 or behind.fallback.distance > 0.2
    for free in (hf.Wall(-0.6, -1.2, -0.5, -1.0), hf.Peg(-0.3, -0.6, 0.05), hf.Ground(0.0, -2.5)):
        assert check_feasibility(replace(problem(), obstacles=[free]), PEG).feasible


def test_a_cast_is_found_near_a_wall_that_leaves_room():
    cord = hf.Rope.uniform(length=1.2, mass=0.06, n_links=15, radius=0.003, friction=5e-4)
    floor = hf.Conditions(obstacles=[hf.Ground(0.0, -1.4)])
    plan = hf.plan_cast(cord, hf.Arm(length=0.15), hf.Peg(0.5, -0.6, 0.03), conditions=floor, on_plan=lambda plan: True)
    assert plan.success, plan.message
    assert plan.clearance > 0.0
    assert plan.run.joints[..., 1].min() > -1.4
