"""Whole motions against the dense equations of motion, integrated by another method at another tolerance."""

import numpy as np
import pytest

import hyperflex as hf
from tests.reference import dense
from tests.reference.arm import bang_bang_swings, cast, links_of, still


def tangled(n: int, friction_model: str, **changes: object) -> hf.Rope:
    """A short chain with all joint properties and different links."""
    grow = np.linspace(1.0, 1.6, n)
    rope = hf.Rope(
        length=0.25 * grow,
        mass=0.05 / grow,
        com=0.1 * grow,
        inertia=2e-4 * grow,
        friction=2e-3 * grow,
        dry_friction=3e-3 / grow,
        stiffness=0.03 * grow,
        rest_angle=0.2 * grow,
        tip_mass=0.02,
        gravity=(1.0, -9.0),
        friction_model=friction_model,
    )
    return rope.replace(**changes)


@pytest.mark.parametrize(("n", "friction_model"), [(1, "printed"), (2, "relative"), (3, "printed")])
def test_a_cast_of_a_short_chain(n, friction_model):
    """Every switch of the arm within two and a half swings: springs, dry friction and a tip mass on the way."""
    rope = tangled(n, friction_model)
    stretches = list(bang_bang_swings(0.4, 0.3, 1.7))
    q0, w0 = 0.3 * np.ones(n), np.zeros(n)
    want = cast(links_of(rope), 0.105, stretches, q0, w0)
    times = np.array([stretch.end for stretch in stretches])
    run = hf.simulate(
        rope, hf.arm_swings(0.4, 0.3), arm=hf.Arm(length=0.105), duration=1.7, q0=q0, t_eval=times, tol=1e-11
    )
    # 1e-11 m a step, a few hundred steps, links of 0.25 m: 1e-8 rad leaves a factor of two or three.
    np.testing.assert_allclose(run.q, want[:, :n], rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.qd, want[:, n:], rtol=0, atol=1e-6)  # rates vary over some 0.01 s
    for k, stretch in enumerate(stretches):
        angle, rate, _ = stretch.at(stretch.end)
        start = 0.105 * np.array([np.sin(angle), -np.cos(angle)])
        joints = dense.joint_positions(links_of(rope), run.q[k], start)
        np.testing.assert_allclose(run.joints[k], joints, rtol=0, atol=1e-13)  # sums of four lengths
        base_speed = 0.105 * rate * np.array([np.cos(angle), np.sin(angle)])
        across = dense.directions(run.q[k])[1]
        tip_speed = base_speed + (rope.length * run.qd[k]) @ across
        np.testing.assert_allclose(run.tip_velocity[k], tip_speed, rtol=0, atol=1e-12)


def test_the_readings_of_friction_differ_where_they_should():
    """If the test above compared a run with itself, this would show: the readings move apart by much more than 1e-8."""
    ends = []
    for friction_model in ("relative", "printed"):
        rope = tangled(3, friction_model)
        run = hf.simulate(rope, hf.arm_swings(0.4, 0.3), arm=hf.Arm(length=0.105), duration=1.7, tol=1e-9)
        ends.append(run.q[-1])
    assert np.abs(ends[0] - ends[1]).max() > 1e-2


def test_a_free_double_pendulum():
    """Two rods without friction, let go from high up: 3 s, over which errors grow some hundredfold."""
    rope = hf.Rope(length=[0.5, 0.4], mass=[0.2, 0.1])
    q0 = np.array([2.0, 2.5])
    want = cast(links_of(rope), 0.0, still(3.0), q0, np.zeros(2), tol=1e-13)
    run = hf.simulate(rope, duration=3.0, q0=q0, t_eval=[3.0], tol=1e-12)
    # 1e-12 m a step, some thousand steps, a hundredfold growth: 1e-7 rad.
    np.testing.assert_allclose(run.q[-1], want[-1, :2], rtol=0, atol=1e-7)


@pytest.mark.parametrize("over", [False, True], ids=["under", "over"])
def test_the_arm_goes_its_way(over):
    """Under the bottom or over the top: place and speed of the arm's tip at the middle of a swing."""
    motion = hf.arm_swings(0.73, 0.53, path="over" if over else "under")
    rope = tangled(2, "relative")
    run = hf.simulate(rope, motion, arm=hf.Arm(length=0.105, pivot=(0.3, 0.1)), duration=1.0, t_eval=[0.365, 0.9])
    middle, end = (-np.pi, -1.5 * np.pi) if over else (0.0, 0.5 * np.pi)
    # Half a turn in 0.73 s with full acceleration: the middle is passed at 2 * pi / 0.73 rad/s. Exact but for rounding.
    rate = (-2 if over else 2) * np.pi / 0.73
    np.testing.assert_allclose(run.arm_angle, [middle, end], rtol=0, atol=1e-13)
    np.testing.assert_allclose(run.arm_rate, [rate, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.joints[0, 0], [0.3, 0.1 + (0.105 if over else -0.105)], rtol=0, atol=1e-13)
    np.testing.assert_allclose(run.base_velocity[0], [2 * np.pi / 0.73 * 0.105, 0.0], rtol=0, atol=1e-12)
    joints = run.joints
    lengths = np.linalg.norm(np.diff(joints, axis=1), axis=2)
    np.testing.assert_allclose(lengths, np.tile(rope.length, (2, 1)), rtol=1e-14)  # links keep their length


def test_a_moving_point_drags_the_chain():
    """The point that the chain hangs from moves along a parabola: in its frame gravity is tilted, no more."""
    rope = tangled(3, "relative")
    t = np.linspace(0.0, 2.0, 201)
    push = np.array([2.0, 1.5])
    # A clamped cubic spline through a parabola from rest is the parabola until shortly before its end.
    path = 0.5 * push * t[:, None] ** 2
    dragged = hf.simulate(rope, hf.moving_pivot(t, *path.T), duration=1.0, q0=[0.1, 0.2, 0.3], t_eval=[1.0], tol=1e-11)
    tilted = rope.replace(gravity=rope.gravity - push)
    still_run = hf.simulate(tilted, duration=1.0, q0=[0.1, 0.2, 0.3], t_eval=[1.0], tol=1e-11)
    # The spline's error falls off as 0.27 a knot from its clamped end: 1e-50 at 1 s. What is left is 1e-8 as above.
    np.testing.assert_allclose(dragged.q, still_run.q, rtol=0, atol=1e-8)
    np.testing.assert_allclose(dragged.tip - still_run.tip, [0.5 * push], rtol=0, atol=1e-8)
