"""Whips: peaks between samples, exact derivatives of strokes and peaks, a plan from end to end, clear answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import InvalidInput
from hyperflex.motion import Motion
from hyperflex.planning import (
    IMPACT_RADIUS,
    MotorLimits,
    Problem,
    Strokes,
    WhipMap,
    build_whip_map,
    check_whip_feasibility,
    plan_whip,
)
from hyperflex.planning.tip.obstacle_gaps import SpareGaps
from hyperflex.planning.whip import planner
from hyperflex.planning.whip.aim import ANGLE_MARGIN, find_peak
from hyperflex.planning.whip.impact import IMPACT_TIME, simulate_impact
from hyperflex.planning.whip.task import WhipTask
from hyperflex.planning.whip.tip_target import TipTarget, find_peaks, peak_costs

ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=8, radius=0.0025, friction=5e-4)
ARM = hf.Arm(length=0.1)
LIMITS = MotorLimits()


@pytest.fixture(scope="module")
def known() -> WhipMap:
    return build_whip_map(Problem(ROPE, ARM, LIMITS, 4.0), swings=96)


def swing(side: int = 1) -> Strokes:
    """A long stroke that reaches the greatest speed, and two short ones that do not."""
    return Strokes(side, side * np.array([-1.4, -0.2, 0.9]), np.array([0.05, 0.3, 0.25]))


def test_a_peak_is_found_between_samples() -> None:
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
    assert found.speed[0] == found.highest[0] == pytest.approx(5.0, abs=1e-4)
    np.testing.assert_allclose(found.velocity[0], [-5.0 * np.sin(4.0), 5.0 * np.cos(4.0)], atol=5e-3)


def test_what_a_peak_costs() -> None:
    """At the target, along and fast it costs its lateness alone; each fault adds to it."""
    t = np.linspace(0.0, 2.0, 201)
    velocity = np.stack([5.5 * np.exp(-((t - 1.0) ** 2)), 0.0 * t], axis=-1)
    found = find_peaks(t, np.zeros((1, t.size, 2)), velocity[None])
    place = found.place[0]
    fair = peak_costs(TipTarget(*place, direction=0.0), found)[0]
    assert fair < 0.01
    for worse in (
        TipTarget(place[0] + 0.3, place[1] + 0.4, direction=0.0),
        TipTarget(*place, direction=1.0),
        TipTarget(*place, direction=-1.0),
        TipTarget(*place, direction=0.0, least_speed=7.0),
    ):
        assert peak_costs(worse, found)[0] > fair + 0.15
    assert peak_costs(TipTarget(place[0] + 0.3, place[1] + 0.4, direction=0.0), found)[0] == pytest.approx(fair + 0.5)


def test_variations_of_strokes() -> None:
    """A motion moved along each variation is the varied strokes' motion, to second order."""
    strokes = swing()
    motion, t, h = strokes.motion(LIMITS), np.linspace(0.0, 3.0, 301), 1e-6
    for k, part in enumerate(strokes.variations(LIMITS)):
        change = np.zeros(6)
        change[k] = h
        moved = Motion(motion.breaks + h * part["breaks"], motion.coef + h * part["coef"], motion.switch, motion.loop)
        true = strokes.varied(change).motion(LIMITS)
        assert np.abs(true.angle(t) - motion.angle(t)).max() > 0.3 * h  # rad: each does something
        np.testing.assert_allclose(moved.angle(t), true.angle(t), rtol=0.0, atol=1e-9)


def test_a_stroke_that_hardly_reaches_full_speed_varies() -> None:
    """Its ramps are 5e-7 less than half of it: no way at full speed is left that could vary."""
    speed, acceleration = LIMITS.speed, LIMITS.acceleration
    way = speed**2 / acceleration * (1.0 + 1e-6)
    strokes = Strokes(1, np.array([LIMITS.start_angle(1) - way]), np.array([0.05]))
    (ramp,) = strokes.timing(LIMITS)[2]
    assert 0.5 - 1e-6 < ramp < 0.5
    assert all(np.isfinite(part["coef"]).all() for part in strokes.variations(LIMITS))


def test_strokes_keep_to_the_motor() -> None:
    strokes = replace(swing(), ends=np.array([-9.0, -9.0, 9.0]))
    motion = strokes.motion(LIMITS)
    t = np.linspace(0.0, 5.0, 5001)
    assert np.abs(motion.angle(t)).max() <= np.pi + 1e-12
    assert np.abs(motion.rate(t)).max() <= LIMITS.speed * (1.0 + 1e-9)
    assert np.abs(motion.acceleration(t)).max() <= LIMITS.acceleration * (1.0 + 1e-9)


def test_derivatives_of_a_peak(known: WhipMap) -> None:
    """Against central differences of peaks that are found anew."""
    found = known.candidates(TipTarget(0.3, -0.9, 0.0, 3.0))[0]
    strokes = found.strokes.cut(found.t, LIMITS)
    aim = find_peak(known.problem, strokes, found.t)
    assert aim is not None
    h, size = 1e-4, strokes.parameters.size
    for k in range(size):
        change = np.zeros(size)
        change[k] = h
        plus, minus = (find_peak(known.problem, strokes.varied(s * change), aim.t) for s in (1.0, -1.0))
        assert plus is not None
        assert minus is not None
        by = (plus.place - minus.place) / (2.0 * h)
        # a peak's time comes from a parabola through samples 2 ms apart, its derivative from differences of them
        np.testing.assert_allclose(aim.dplace[:, k], by, rtol=0.0, atol=0.03 * np.abs(aim.dplace).max())


def test_residuals_count_from_the_shaft_wherever_it_is(known: WhipMap) -> None:
    """A direction that is 0.5 rad off counts as if the tip were off by that angle as seen from the shaft."""
    target = TipTarget(0.0, 0.0, direction=0.0, angle_tolerance=0.1)
    setup = replace(known.problem, arm=hf.Arm(length=0.1, pivot=(0.0, 1.5)))
    task = WhipTask(SimpleNamespace(problem=setup), target)  # type: ignore[arg-type]
    aim = SimpleNamespace(speed=9.0, place=np.zeros(2), velocity=9.0 * np.array([np.cos(0.5), np.sin(0.5)]))
    aim.dplace = aim.dvelocity = np.zeros((2, 4))
    aim.gaps = SpareGaps(np.zeros(0), np.zeros((0, 4)), np.zeros(0))
    residuals, _ = task.residuals(aim)  # type: ignore[arg-type]
    assert residuals == pytest.approx([0.0, 0.0, 1.5 * (0.5 - ANGLE_MARGIN * 0.1)])


def test_a_plan() -> None:
    """A target beside a peak of the map is met, and the verified run says so in its own samples.

    With 24 links and an early peak: eight leave too little of a rope's shape for half their length to do the same.
    """
    rope = hf.Rope.uniform(length=1.0, mass=0.06, n_links=24, radius=0.0025, friction=5e-4)
    known = build_whip_map(Problem(rope, ARM, LIMITS, 4.0), swings=48)
    peak = known.peaks
    k = int(np.argmax(np.where((peak.speed >= peak.highest) & (peak.t < 1.5), peak.speed, 0.0)))
    way = peak.velocity[k] / peak.speed[k]
    plan = plan_whip(
        rope, ARM, peak.place[k] + [0.01, 0.02], way, least_speed=0.9 * peak.speed[k], whip_map=known, time_budget=20.0
    )
    assert plan.success, plan.message
    assert plan.outcome is not None
    run = plan.outcome.run
    about = np.abs(run.t - plan.outcome.t) < 0.15
    speed = np.hypot(*run.tip_velocity[about].T)
    at = run.tip[about][speed.argmax()]
    assert speed.max() >= 0.9 * peak.speed[k]
    assert np.hypot(*(at - plan.target.point)) < 1e-3 + 1e-3 * speed.max()  # samples lie 2 ms apart: half of it away
    assert plan.finer_outcome is not None
    assert plan.finer_outcome.miss < max(3e-3, plan.position_std)


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


def test_impact_is_what_turns_the_rope() -> None:
    """Without friction in the joints, gravity and the blow alone turn the rope about its first joint, which rests."""
    rope = ROPE.replace(friction=0.0)
    problem = Problem(rope, ARM, LIMITS, 3.0)
    motion = Strokes(1, np.array([-1.4]), np.array([0.1])).motion(LIMITS)
    free = hf.simulate(rope, motion, arm=ARM, duration=3.0, t_eval=np.arange(0.0, 3.0, 2e-3), tol=1e-7)
    peak = find_peaks(free.t, free.tip[None], free.tip_velocity[None])
    k = int(np.where(peak.t > motion.breaks[-1] + 0.1, peak.speed, 0.0).argmax())
    mark = TipTarget(*peak.place[k], direction=float(np.arctan2(peak.velocity[k, 1], peak.velocity[k, 0])))
    blow = simulate_impact(problem, mark, motion, peak.t[k])
    assert blow.t == pytest.approx(peak.t[k], abs=0.02)
    assert blow.link == ROPE.n_links - 1
    assert blow.success
    assert blow.energy > 0.0
    assert blow.impulse_along > 0.9 * blow.impulse  # the peg takes up what comes along the asked direction
    x, y = mark.point + (IMPACT_RADIUS + rope.radius) * np.array([np.cos(mark.direction), np.sin(mark.direction)])
    t = np.array([0.0, *np.arange(blow.t - 0.002, blow.t + IMPACT_TIME, 1e-3)])
    run = hf.simulate(
        rope, motion, arm=ARM, duration=float(t[-1]), t_eval=t, pegs=[hf.Peg(x, y, IMPACT_RADIUS)], refine=False
    )
    arms = run.joints[:, :-1] + rope.com[:, None] * np.stack([np.sin(run.q), -np.cos(run.q)], -1)
    weight = 9.81 * (rope.mass * (arms[..., 0] - run.base[:, :1])).sum(axis=1)
    gained = turning(run)[-1] - turning(run)[1] + np.trapezoid(weight[1:], run.t[1:])
    lever = float(np.hypot(*(mark.point - run.base[-1])))
    # the blow comes along the tip's path, nearly across the line from the joint; the rope lies within 1 cm of the mark
    assert abs(gained) == pytest.approx(blow.impulse * lever, rel=0.1)


@pytest.mark.parametrize(
    ("point", "direction", "words"),
    [
        ((-0.101, -0.6), 0.0, "lies on the peg from the start"),
        ((0.0, -0.5), 0.0, "link 4 touches the peg first, at"),  # it swings into it with its middle, and stays there
        ((0.9, 0.9), 0.0, "does not touch the peg"),
    ],
)
def test_a_peg_that_the_tip_does_not_strike_first_has_no_impact(
    point: tuple[float, float], direction: float, words: str
) -> None:
    """What the rope's middle does to it long before the tip comes near is no impact of the whip."""
    motion = Strokes(-1, np.array([1.4, -1.4]), np.array([0.05, 0.1])).motion(LIMITS)
    blow = simulate_impact(Problem(ROPE, ARM, LIMITS, 3.0), TipTarget(*point, direction=direction), motion, 1.9)
    assert not blow.success
    assert words in blow.message
    assert (blow.impulse, blow.impulse_along, blow.energy) == (0.0, 0.0, 0.0)
    assert not blow.t > 1.0


@pytest.mark.parametrize(
    ("point", "direction", "words"),
    [
        ([np.nan, -1.0], [1.0, 0.0], "point"),
        ([0.3, -0.9], [0.0, 0.0], "direction is zero"),
        ([0.3, -0.9], [np.inf, 0.0], "direction"),
        ([0.3, -0.9, 1.0], [1.0, 0.0], "point has the wrong shape"),
    ],
)
def test_bad_input(point: list[float], direction: list[float], words: str, known: WhipMap) -> None:
    with pytest.raises(InvalidInput, match=words):
        plan_whip(ROPE, ARM, point, direction, whip_map=known)


def test_speed_of_zero_is_refused(known: WhipMap) -> None:
    with pytest.raises(InvalidInput, match="speed"):
        plan_whip(ROPE, ARM, [0.3, -0.9], [1.0, 0.0], least_speed=0.0, whip_map=known)


def test_a_map_without_the_obstacles_is_refused(known: WhipMap) -> None:
    with pytest.raises(InvalidInput, match="other obstacles"):
        plan_whip(ROPE, ARM, [0.3, -0.9], whip_map=known, obstacles=[hf.Wall(0.5, -1.5, 0.5, 0.5)])


def test_a_map_of_another_rope_is_refused(known: WhipMap) -> None:
    for rope, limits in ((ROPE.replace(mass=0.01), None), (ROPE, MotorLimits(speed=1.0))):
        with pytest.raises(InvalidInput, match="another rope"):
            plan_whip(rope, ARM, [0.3, -0.9], [1.0, 0.0], limits, whip_map=known)


def test_a_target_without_a_direction_takes_any() -> None:
    free = TipTarget(0.3, -2.0)
    assert free.any_direction
    assert free == TipTarget.at((0.3, -2.0), None, 5.0)
    assert not TipTarget(0.3, -2.0, 0.0).any_direction


def test_any_direction_costs_nothing(known: WhipMap) -> None:
    """Without a direction the cost of the cheapest peak is that of the best of many directions, or less."""
    point, speed = known.peaks.place[np.argmax(known.peaks.speed)] + [0.03, -0.02], 2.0
    free = known.candidates(TipTarget.at(point, None, speed))[0].cost
    asked = [
        known.candidates(TipTarget(*point, direction=a, least_speed=speed))[0].cost
        for a in np.arange(-np.pi, np.pi, 0.2)
    ]
    # 0.2 rad apart and 0.21 rad free of cost: one of them is within it, and asks for nothing then
    assert free == pytest.approx(min(asked), abs=1e-12)
    plan = plan_whip(ROPE, ARM, point, least_speed=speed, whip_map=known, time_budget=10.0)
    assert plan.success, plan.message
    assert plan.target.any_direction


def test_out_of_reach(known: WhipMap) -> None:
    far = plan_whip(ROPE, ARM, [1.5, 0.0], [0.0, 1.0], whip_map=known)
    assert not far.success
    assert far.motion is None
    assert "ends 0.40 m short" in far.message
    with pytest.raises(InvalidInput, match="holds no outcome"):
        far.impact()
    for mark, words in (
        (TipTarget(0.2, -1.0, 0.0, 50.0), "m/s at most"),
        (TipTarget(0.0, 1.0, 0.0), "no peak so near"),
    ):
        assert words in check_whip_feasibility(known, mark).message


def test_one_bar_stands_over_the_whole_of_a_plan(known: WhipMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """Map and planner, in the time of both."""
    seen: list[str] = []

    @contextmanager
    def bar(begin: float, end: float, wanted: bool, what: str) -> Iterator[Callable[[float], None]]:
        seen.append("begins")
        yield lambda t: seen.append("late" if t > 0.5 * end else "early")
        seen.append("ends")

    def build(*_: object, **__: object) -> WhipMap:
        seen.append("map")
        return known

    class Clock:
        spent = elapsed = 60.0

    monkeypatch.setattr(planner, "progress_bar", bar)
    monkeypatch.setattr(planner, "build_whip_map", build)
    monkeypatch.setattr(planner, "Clock", Clock)
    monkeypatch.setattr(planner.TipPlanner, "run", lambda _, report: report())
    plan_whip(ROPE, ARM, known.peaks.place[0], least_speed=0.1, time_budget=100.0, skip_feasibility=True, progress=True)
    assert seen == ["begins", "map", "late", "ends"]


def test_a_joint_at_its_limit_touches_no_peg() -> None:
    """It loses energy as a blow on a peg does, a metre away from this one."""
    motion = Strokes(-1, np.array([1.4, -1.4]), np.array([0.05, 0.1])).motion(LIMITS)
    stiff = Problem(ROPE.replace(max_bend=np.array([np.inf, *7 * [0.3]])), ARM, LIMITS, 3.0)
    blow = simulate_impact(stiff, TipTarget(2.5, 2.5, direction=0.0), motion, 1.9)
    assert blow.message == "the rope does not touch the peg"
    assert np.isnan(blow.t)
    assert blow.link == -1
