"""Whips: peaks between samples, costs, obstacles, verified runs, plans from end to end, clear errors."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.budget import Budget
from hyperflex.model import obstacle_gaps
from hyperflex.planning import (
    Conditions,
    MotorLimits,
    Moves,
    Problem,
    TipTarget,
    WhipMap,
    build_whip_map,
    check_whip_feasibility,
    plan_whip,
)
from hyperflex.planning.planner import Candidate
from hyperflex.planning.tasks.tip import OPTIONS, Aim, coarse_flights, random_swings
from hyperflex.planning.tasks.whip import WhipTask, find_peaks, simulate_impact, verify_whip
from tests.planning.known_whip import ARM, MOVES, NEAR, ROPE, planned_whip
from tests.refusals import refuses

LIMITS = MotorLimits()
PROBLEM = Problem(ROPE, ARM, LIMITS, 4.0)
WALL = hf.Wall(0.25, -1.5, 0.25, 0.5)


@pytest.fixture(scope="module")
def known() -> WhipMap:
    return build_whip_map(PROBLEM, swings=96)


def test_a_peak_is_found_between_samples():
    """Round a circle of 1 m with speed 4 + cos(3 (t - 1)): the peak is at t = 1."""
    t = np.arange(0.013, 2.0, 0.02)
    angle, rate = 4.0 * t + np.sin(3.0 * (t - 1.0)) / 3.0, 4.0 + np.cos(3.0 * (t - 1.0))
    tip = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    velocity = rate[:, None] * np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    found = find_peaks(t, tip[None], velocity[None])
    assert found.t.size == 1
    assert found.t[0] == pytest.approx(1.0, abs=1e-4)  # the parabola's error is of the fourth order in the step
    # 5 m/s times that, and the third order of a way of 7 ms: 5e-6 m; without the acceleration it were 6e-4 m
    np.testing.assert_allclose(found.place[0], [np.cos(4.0), np.sin(4.0)], atol=2e-4)
    assert found.speed[0] == found.highest[0] == pytest.approx(5.0, abs=5e-3)
    np.testing.assert_allclose(found.velocity[0], [-5.0 * np.sin(4.0), 5.0 * np.cos(4.0)], atol=5e-3)


def test_aims_know_residuals_and_the_uncertainty_of_the_place():
    """A peak at the target has none; the standard deviation is that of central differences."""
    task = WhipTask(PROBLEM, TipTarget(0.3, -0.9, least_speed=1.0))
    budget = Budget(math.inf)
    (aim,) = task.aims([MOVES], [NEAR], budget)
    at = WhipTask(PROBLEM, TipTarget(*aim.place, least_speed=1.0))
    (there,) = at.aims([MOVES], [NEAR], budget)
    assert there.residuals == pytest.approx(0.0, abs=1e-9)
    assert there.good
    aimed = at.aimed(there, budget)
    h, count, total = 1e-4, MOVES.ends.size, 0.0
    longer, stiffer = (
        [ROPE.replace(**{name: part**power * getattr(ROPE, name) for name, power in changed.items()}) for part in both]
        for both in [(1.0 + h, 1.0 - h)]
        for changed in ({"length": 1, "com": 1, "inertia": 2}, {"friction": 1})
    )
    steps = h * np.eye(2 * count)[count:]
    pairs = [([MOVES.varied(step), MOVES.varied(-step)], (), OPTIONS.timing_std) for step in steps]
    pairs += [([MOVES] * 2, longer, OPTIONS.length_std), ([MOVES] * 2, stiffer, OPTIONS.friction_std)]
    for moves, some, std in pairs:
        plus, minus = at.aims(moves, [there.t] * 2, budget, some)
        total += float((((plus.place - minus.place) / (2.0 * h)) ** 2).sum()) * std**2
    # a peak's time comes from a parabola through samples 2 ms apart
    assert aimed.std == pytest.approx(math.sqrt(total), rel=0.05)


@pytest.fixture(scope="module")
def fine_map() -> WhipMap:
    """With 24 links: eight describe too little of a rope's shape for half their length to do the same."""
    rope = hf.Rope.uniform(length=1.0, mass=0.06, n_links=24, radius=0.0025, friction=5e-4)
    return build_whip_map(Problem(rope, ARM, LIMITS, 4.0), swings=48)


@pytest.mark.parametrize("directed", [True, pytest.param(False, marks=pytest.mark.nightly)])
def test_a_plan(fine_map, directed):
    """A target near a peak of the map is met, as the verified run shows in its own samples."""
    peak = fine_map.peaks
    k = int(np.argmax(np.where((peak.speed >= peak.highest) & (peak.t < 1.5), peak.speed, 0.0)))
    direction = float(np.arctan2(*peak.velocity[k][::-1])) if directed else None
    target = TipTarget(*(peak.place[k] + [0.01, 0.02]), direction, least_speed=0.9 * peak.speed[k])
    plan = plan_whip(fine_map.problem.rope, ARM, target, whip_map=fine_map, time_budget=60.0)
    assert plan.success, plan.message
    run = plan.outcome.run
    about = np.abs(run.t - plan.outcome.t) < 0.15
    speed = np.hypot(*run.tip_velocity[about].T)
    at = run.tip[about][speed.argmax()]
    assert speed.max() >= 0.9 * peak.speed[k]
    assert np.hypot(*(at - target.point)) < 1e-3 + 1e-3 * speed.max()  # samples lie 2 ms apart: half of it away
    assert plan.finer_outcome.miss < max(3e-3, plan.position_std)


def test_gaps_of_a_wall_are_signed():
    """Through a wall: along it to its nearer end, or the rope's end beyond it."""
    begin = np.array([[0.2, 0.0], [0.2, 0.4], [0.2, 0.2]])[:, None]
    end = np.array([[0.3, 0.0], [0.3, 0.4], [0.26, 0.2]])[:, None]
    found = obstacle_gaps([WALL], begin, end)[:, 0, 0]
    assert found == pytest.approx([-0.05, -0.05, -0.01])  # half of a link is beyond, of the third 10 mm
    beyond = end + np.array([1.0, 0.0])
    both = np.concatenate([begin, end], axis=1), np.concatenate([end, beyond], axis=1)
    assert obstacle_gaps([WALL], *both)[:2, 0, 0] == pytest.approx([-0.5, -0.1])  # half a meter below the upper end


def test_peaks_behind_an_obstacle_cost_more():
    walled, moves = replace(PROBLEM, obstacles=(WALL,)), [MOVES, replace(MOVES, side=1, ends=-MOVES.ends)]
    target = TipTarget(0.6, -0.6, least_speed=1.0)
    free, there = (
        WhipTask(each, target).score(next(coarse_flights(each, moves, Budget()))) for each in (PROBLEM, walled)
    )
    assert max(cost for cost, _ in free) < max(cost for cost, _ in there)


def test_swings_begin_on_the_side_that_is_free():
    right, left = hf.Wall(0.05, -0.6, 0.5, -0.6), hf.Wall(-0.05, -0.6, -0.5, -0.6)
    assert {each.side for each in random_swings(PROBLEM, 16)} == {-1, 1}
    for wall, side in ((right, -1), (left, 1)):
        assert {each.side for each in random_swings(replace(PROBLEM, obstacles=(wall,)), 16)} == {side}
        assert {each.side for each in random_swings(PROBLEM, 16, [wall])} == {side}
    begun = MOVES.motion(LIMITS)  # on the left
    assert verify_whip(replace(PROBLEM, obstacles=(left,)), TipTarget(0.0, 0.0), begun, NEAR) is None


def test_feasibility_by_the_map(known):
    assert "ends 0.40 m short" in check_whip_feasibility(known, TipTarget(1.5, 0.0, 0.0)).message
    assert "m/s at most" in check_whip_feasibility(known, TipTarget(0.2, -1.0, 0.0, 50.0)).message
    assert "no peak so near" in check_whip_feasibility(known, TipTarget(0.0, 1.0, 0.0)).message
    target = TipTarget(0.3, -0.9, least_speed=1.0)
    free = check_whip_feasibility(known, target)
    assert free.feasible
    walled = replace(known, problem=replace(PROBLEM, obstacles=(WALL,)))
    assert check_whip_feasibility(walled, target) == free  # a search may find swings past the wall
    inside = replace(known, problem=replace(PROBLEM, obstacles=(hf.Peg(0.3, -0.9, 0.05),)))
    assert check_whip_feasibility(inside, target).message == "the target lies in the peg at (0.3, -0.9) m"
    near = replace(known, problem=replace(PROBLEM, obstacles=(hf.Wall(0.295, -1.2, 0.295, -0.5),), clearance=0.003))
    message = check_whip_feasibility(near, target).message
    assert message.startswith("the target is 5.0 mm from the wall at")
    assert message.endswith("the rope needs 5.5 mm")


def test_finer_links_may_move_the_peak_by_its_std_or_three_tolerances():
    """The target is at the peak as planned."""
    plan = planned_whip()
    apart = float(np.hypot(*(plan.outcome.place - plan.finer_outcome.place)))
    misses = f"misses the target by {1e3 * apart:.1f} mm"
    for part, std, words in ((1.01, 0.0, ""), (0.99, 0.0, misses), (0.5, 1.01, "")):
        x, y = plan.outcome.place
        target = replace(plan.target, x=float(x), y=float(y), tolerance=part * apart / 3.0)
        aim = Aim(MOVES, 1.0, plan.outcome.t, residuals=np.zeros(2), place=target.point, std=std * apart)
        found = WhipTask(plan.problem, target).verify(aim, Budget(math.inf))
        assert words in found.message
        assert bool(found.message) == bool(words)
        assert found.finer_outcome.n_links == 2 * found.outcome.n_links


def test_a_motor_that_is_too_weak_is_a_reason():
    plan = planned_whip()
    torque, candidate = plan.outcome.torque, Candidate(MOVES, 1.0, plan.outcome.t)
    for part, words in ((1.001, ""), (0.99, f"it needs {torque:.3g} N m of a motor that gives {0.99 * torque:.3g}")):
        weak = replace(plan.problem, limits=MotorLimits(torque=part * torque))
        message = WhipTask(weak, plan.target).verify(candidate, Budget(math.inf)).message
        assert message == words or (not words and message.startswith("with shorter links"))


def free_strike() -> tuple[hf.Trajectory, float, TipTarget, np.ndarray]:
    """Return a run without obstacles, the time of its peak, a target there, and the velocity."""
    seen = verify_whip(PROBLEM, TipTarget(0.0, 0.0, least_speed=1.0), MOVES.motion(LIMITS), NEAR)
    return seen.run, seen.t, TipTarget(*seen.place, least_speed=1.0), seen.velocity


def test_the_rope_may_touch_an_obstacle_after_the_peak_only():
    run, t, target, _ = free_strike()
    for late in (0.04, 0.0, -0.02, -0.14):
        place = run.tip[int(np.searchsorted(run.t, t + late))]
        way = run.tip[int(np.searchsorted(run.t, t + 0.04))] - target.point
        across = 0.05 * np.array([-way[1], way[0]]) / np.hypot(*way)
        wall = hf.Wall(*(place - across), *(place + across))
        seen = verify_whip(replace(PROBLEM, obstacles=(wall,)), target, MOVES.motion(LIMITS), t)
        assert seen.message.startswith("the rope touches") == (late <= 0.0)
        if late > 0.0:
            assert (seen.message, seen.miss < 1e-4) == ("", True)
            assert float(seen.touches_later.split()[-2]) == pytest.approx(t + 0.04, abs=0.02)


def test_a_switch_just_before_a_wall_is_struck():
    """A wall that the tip touches 2 ms after the peak does not move the peak."""
    _, t, target, velocity = free_strike()
    way = velocity / np.hypot(*velocity)
    place, across = target.point + 0.005 * way, 0.004 * np.array([-way[1], way[0]])
    beyond = hf.Wall(*(place - across), *(place + across))  # 5 mm less the rope's radius, at 1.3 m/s
    seen = verify_whip(replace(PROBLEM, obstacles=(beyond,)), target, MOVES.motion(LIMITS), t)
    assert (seen.message, seen.miss) == ("", pytest.approx(0.0, abs=1e-5))
    assert seen.touches_later.startswith("the wall at")
    assert seen.clearance == pytest.approx(0.0025, abs=5e-4)


def test_short_touches_are_touches():
    """Small pegs off which the rope bounces between samples."""
    run, t, target, _ = free_strike()
    for row in np.searchsorted(run.t, t + np.linspace(0.03, 0.12, 4)):
        side = np.array([-run.tip_velocity[row, 1], run.tip_velocity[row, 0]])
        peg = hf.Peg(*(run.tip[row] + 0.001 * side / np.hypot(*side)), 0.003, restitution=1.0)
        seen = verify_whip(replace(PROBLEM, obstacles=(peg,)), target, MOVES.motion(LIMITS), t)
        moved = np.hypot(*(seen.run.tip[-1] - run.tip[-1]))
        assert seen.touches_later or moved < 0.005
    for row in np.searchsorted(run.t, t - np.linspace(0.03, 0.12, 3)):
        peg = hf.Peg(*run.tip[row], 0.03)  # on which the rope lies more heavily later
        seen = verify_whip(replace(PROBLEM, obstacles=(peg,)), target, MOVES.motion(LIMITS), t)
        assert seen.message.startswith("the rope touches the peg at")
        assert seen.clearance <= 0.0


def test_ctrl_c_while_the_map_is_made_is_a_plan(monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("hyperflex.planning.tasks.whip.random_swings", stop)
    with pytest.raises(hf.Interrupted) as stopped:
        plan_whip(ROPE, ARM, TipTarget(0.3, -0.9, 0.0), conditions=Conditions(time_limit=1.0))
    plan = stopped.value.partial
    assert plan.interrupted
    assert plan.message == "interrupted before the random swings were simulated"
    assert plan.moves is None
    assert plan.feasibility.distance == pytest.approx(np.hypot(0.3, 0.9))


def test_without_time_the_best_is_not_verified(known):
    peak = int(known.peaks.speed.argmax())
    target = TipTarget(*known.peaks.place[peak], least_speed=1.0)
    plan = plan_whip(ROPE, ARM, target, whip_map=known, time_budget=1e-6)
    assert not plan.success
    assert plan.outcome is None
    assert (plan.status, "the time budget ended" in plan.message) == ("out of time", True)
    far = plan_whip(ROPE, ARM, replace(target, y=0.9, least_speed=20.0), time_budget=1e-6)
    assert (far.status, "the time budget ended" in far.message) == ("out of time", True)


def test_a_search_that_comes_to_its_end_has_failed_also_without_an_outcome(monkeypatch):
    monkeypatch.setattr(WhipTask, "aimed", lambda *_: None)  # no swing can be aimed
    few = build_whip_map(replace(PROBLEM, time=1.0), swings=2)
    target = TipTarget(*few.peaks.place[int(few.peaks.speed.argmax())], least_speed=0.3)
    plan = plan_whip(ROPE, ARM, target, whip_map=few, time_budget=math.inf)
    assert (plan.status, plan.outcome, plan.moves) == ("failed", None, None)
    assert plan.message == "no motion was found that brings the tip there"


def test_a_map_has_the_swings_that_there_was_time_for():
    problem, count = replace(PROBLEM, time=0.5), OPTIONS.batch
    whole = build_whip_map(problem, swings=2 * count + 6)
    ticks = iter([0.0, 1.0, 3.0, 3.0, 3.0])
    part = build_whip_map(problem, swings=2 * count + 6, time_budget=Budget(2.0, clock=lambda: next(ticks)))
    assert (len(part.moves), len(whole.moves)) == (2 * count, 2 * count + 6)
    same = whole.peaks.row < 2 * count
    assert (~same).any()
    for one, other in zip(part.peaks, whole.peaks, strict=True):
        np.testing.assert_array_equal(one, other[same])


def test_a_map_must_be_of_the_same_problem(known):
    target = TipTarget(1.5, 0.0, 0.0)
    again = hf.Rope.from_table(ROPE.table())
    assert "out of reach" in plan_whip(again, ARM, target, whip_map=known).message
    assert "out of reach" in plan_whip(ROPE, ARM, target, whip_map=known, conditions=Conditions(time_limit=4.0)).message
    for rope, limits, conditions in (
        (ROPE.replace(mass=0.01), None, None),
        (ROPE, MotorLimits(speed=1.0), None),
        (ROPE, None, Conditions(time_limit=1.5)),
        (ROPE, None, Conditions(obstacles=[hf.Wall(0.5, -1.5, 0.5, 0.5)])),
    ):
        refuses("another rope", plan_whip, rope, ARM, target, limits, whip_map=known, conditions=conditions)


def test_bad_input():
    good = {"x": 0.3, "y": -0.9, "direction": 0.0}
    wrong = {"x": np.nan, "direction": np.inf, "least_speed": 0.0, "angle_tolerance": 4.0, "tolerance": 0}
    for name, value in wrong.items():
        refuses(name, TipTarget, **good | {name: value})
    short = Conditions(time_limit=0.005)
    refuses(r"too short.*0[.]005", plan_whip, ROPE, ARM, TipTarget(0.3, -0.9), conditions=short)
    refuses("not uniform", WhipTask, replace(PROBLEM, rope=ROPE.replace(com=0.05)), TipTarget(0.0, 0.0))
    state = hf.RopeState(0.0, np.zeros(8), np.zeros(8))
    refuses("rope that hangs", plan_whip, ROPE, ARM, TipTarget(0.3, -0.9), conditions=Conditions(state0=state, side=1))


def turning(run: hf.Trajectory) -> np.ndarray:
    """Angular momentum about the first joint, which rests, (T,), N m s."""
    rope = run.setup.rope
    arms = run.joints[:, :-1] - run.base[:, None] + rope.com[:, None] * np.stack([np.sin(run.q), -np.cos(run.q)], -1)
    spin = rope.length * run.qd
    ends = np.cumsum(np.stack([spin * np.cos(run.q), spin * np.sin(run.q)], -1), axis=1)
    starts = np.concatenate([np.zeros_like(ends[:, :1]), ends[:, :-1]], axis=1)
    speeds = starts + (ends - starts) * (rope.com / rope.length)[:, None]
    orbit = rope.mass * (arms[..., 0] * speeds[..., 1] - arms[..., 1] * speeds[..., 0])
    return np.asarray((orbit + rope.inertia * run.qd).sum(axis=1))


def test_impact_is_what_turns_the_rope():
    """Without friction in the joints, gravity and the blow alone turn the rope about its first joint, which rests."""
    rope, radius = ROPE.replace(friction=0.0), 0.01
    problem = Problem(rope, ARM, LIMITS, 3.0)
    motion = Moves(1, np.array([-1.4]), np.array([0.1])).motion(LIMITS)
    free = hf.simulate(rope, motion, arm=ARM, duration=3.0, t_eval=np.arange(0.0, 3.0, 2e-3), tol=1e-7)
    peak = find_peaks(free.t, free.tip[None], free.tip_velocity[None])
    k = int(np.where(peak.t > motion.breaks[-1] + 0.1, peak.speed, 0.0).argmax())
    point, direction = peak.place[k], float(np.arctan2(peak.velocity[k, 1], peak.velocity[k, 0]))
    blow = simulate_impact(problem, point, direction, motion, peak.t[k])
    assert blow.t == pytest.approx(peak.t[k], abs=0.02)
    assert blow.link == ROPE.n_links - 1
    assert blow.success
    assert blow.energy > 0.0
    assert blow.impulse_along > 0.9 * blow.impulse  # the peg takes up what comes along the required direction
    x, y = point + (radius + rope.radius) * np.array([np.cos(direction), np.sin(direction)])
    t = np.array([0.0, *np.arange(blow.t - 0.002, blow.t + 0.05, 1e-3)])
    run = hf.simulate(rope, motion, arm=ARM, duration=float(t[-1]), t_eval=t, pegs=[hf.Peg(x, y, radius)], refine=False)
    arms = run.joints[:, :-1] + rope.com[:, None] * np.stack([np.sin(run.q), -np.cos(run.q)], -1)
    weight = 9.81 * (rope.mass * (arms[..., 0] - run.base[:, :1])).sum(axis=1)
    gained = turning(run)[-1] - turning(run)[1] + np.trapezoid(weight[1:], run.t[1:])
    lever = float(np.hypot(*(point - run.base[-1])))
    # the blow comes along the tip's path, nearly across the line from the joint; the rope lies within 1 cm of the mark
    assert abs(gained) == pytest.approx(blow.impulse * lever, rel=0.1)


@pytest.mark.parametrize(
    ("point", "max_bend", "words"),
    [
        ((-0.101, -0.6), np.inf, "lies on the peg from the start"),
        ((0.0, -0.5), np.inf, "link 3 touches the peg first, at"),  # it swings into it with its middle
        ((0.34, -0.996), np.inf, "the tip touches the peg already at"),
        ((0.9, 0.9), np.inf, "does not touch the peg"),
        ((2.5, 2.5), 0.3, "does not touch the peg"),  # a joint at its limit loses energy as a blow does
    ],
)
def test_a_peg_that_the_tip_does_not_strike_first_has_no_impact(point, max_bend, words):
    motion = Moves(-1, np.array([1.4, -1.4]), np.array([0.05, 0.1])).motion(LIMITS)
    rope = ROPE.replace(max_bend=np.array([np.inf, *7 * [max_bend]]))
    blow = simulate_impact(Problem(rope, ARM, LIMITS, 3.0), np.array(point), 0.0, motion, 1.9)
    assert not blow.success
    assert words in blow.message
    assert (blow.impulse, blow.impulse_along, blow.energy) == (0.0, 0.0, 0.0)
    assert not blow.t > 1.0
