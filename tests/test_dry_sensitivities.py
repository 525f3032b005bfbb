"""Derivatives of rollouts whose joints stick and slip: against differences along frozen steps, and closed forms."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.core.integrate.rollout import JOINT, MODES
from tests.frozen import check

DURATION = 1.4
BEFORE_A_GRAZE = {5: 0.84}  # later a joint of five only just comes to rest, and beside it does not: no difference there
MOVE: dict[str, Any] = {"start": -0.5, "end": 1.0, "duration": 0.8, "profile": "minimum-jerk"}


def rope(n: int, **changes: Any) -> hf.Rope:
    """A rope whose joints, each with its own dry friction, stick and slip several times in a second."""
    rng = np.random.default_rng(n)
    weight = 9.81 * 0.05 * 0.4 * (1.0 - np.arange(n) / n) ** 2
    fields: dict[str, Any] = {
        "length": 0.4 / n * rng.uniform(0.7, 1.3, n),
        "mass": 0.05 / n * rng.uniform(0.7, 1.3, n),
        "friction": 2e-4 * rng.uniform(0.5, 1.5, n),
        "dry_friction": 0.06 * weight * rng.uniform(0.7, 1.3, n),
        "stiffness": 2e-3 * rng.uniform(0.5, 1.5, n),
        "tip_mass": 0.005,
        "radius": 0.01,
    }
    return hf.Rope(**fields).replace(**changes) if changes else hf.Rope(**fields)


def setup(n: int, **changes: Any) -> hf.Setup:
    rng = np.random.default_rng(10 + n)
    start = {"q0": rng.normal(0.0, 0.3, n), "qd0": rng.normal(0.0, 1.0, n)}
    duration = BEFORE_A_GRAZE.get(n, DURATION)
    return replace(hf.Setup(rope(n), hf.move_arm(**MOVE), hf.Arm(), duration=duration, tol=1e-4, **start), **changes)


def changed(n: int, name: str, link: int) -> tuple[Callable[[float], hf.Setup], float]:
    """Set-ups in which a property of one link differs, and a spacing."""
    base, unit = rope(n), np.eye(n)[link]
    values = getattr(base, name)
    size = {"inertia": 3e-2, "length": 1e-3}.get(name, 3e-3) * (1.0 if name == "rest_angle" else abs(values[link]))
    return lambda x: setup(n, rope=base.replace(**{name: values + x * unit})), size


@pytest.mark.parametrize(
    ("n", "name", "link"),
    [(1, "dry_friction", 0), (5, "dry_friction", 4)]
    + [(3, name, 1) for name in ("length", "mass", "friction", "stiffness", "rest_angle")]
    + [(5, name, 1) for name in ("com", "inertia", "dry_friction")],
)
def test_rope_parameter_of_one_link(n, name, link):
    run = check(changed(n, name, link)[0], f"{name}[{link}]", changed(n, name, link)[1])
    log = run.log
    ends = log[log[:, JOINT] >= 0.0]
    freed = [row[MODES + int(row[JOINT])] == 0.0 for row in ends]
    assert len(ends) >= 4  # joints do come to rest on the way, and come loose
    assert any(freed) or n == 1
    assert not all(freed)


@pytest.mark.parametrize(("name", "link"), [("q0", 0), ("q0", 2), ("qd0", 0), ("qd0", 2)])
def test_start(name, link):
    it, unit = setup(3), np.eye(3)[link]
    check(lambda x: replace(it, **{name: getattr(it, name) + x * unit}), f"{name}[{link}]", 2e-4)


WHOLE: dict[str, tuple[Callable[[float], hf.Setup], float]] = {
    "dry_friction": (lambda x: setup(3, rope=rope(3, dry_friction=rope(3).dry_friction + x)), 5e-7),
    "tip_mass": (lambda x: setup(3, rope=rope(3, tip_mass=0.005 + x)), 1e-5),
    "gravity[0]": (lambda x: setup(3, rope=rope(3, gravity=(x, -9.81))), 2e-3),
    "arm.length": (lambda x: setup(3, arm=hf.Arm(length=0.105 + x)), 1e-4),
    "motion.delay": (lambda x: setup(3, motion=hf.move_arm(**MOVE).shifted(0.05 + x)), 1e-4),
}


@pytest.mark.parametrize("name", WHOLE)
def test_what_belongs_to_no_link(name):
    check(*WHOLE[name][:1], name, WHOLE[name][1])


@pytest.mark.parametrize("name", ["start", "end", "duration"])
def test_motion(name):
    check(lambda x: setup(3, motion=hf.move_arm(**{**MOVE, name: MOVE[name] + x})), f"motion.{name}", 2e-4)


def differences(make: Callable[[float], hf.Setup], times: Array, size: float) -> tuple[Array, Array]:
    """Differences forwards and backwards of whole runs, which choose their own steps and events."""
    here, more, less = (
        np.concatenate([run.q, run.qd], axis=1)
        for run in (hf.simulate(replace(make(x), tol=1e-12), t_eval=times) for x in (0.0, size, -size))
    )
    return (more - here) / size, (here - less) / size


def test_a_stuck_joint_takes_a_little_rate_as_a_blow():
    """Two links at rest whose second joint sticks: to either side, a little rate of one moves both."""
    base = rope(2, dry_friction=[1e-4, 5e-3], stiffness=0.0, rest_angle=0.0)
    times = np.array([0.0, 0.02, 0.05, 0.1, 0.15])
    for link in range(2):

        def make(x, link=link):
            return hf.Setup(base, duration=0.15, q0=[0.6, 0.7], qd0=[2.0, 2.0] + x * np.eye(2)[link])

        got = hf.sensitivities(replace(make(0.0), tol=1e-12), t_eval=times, wrt=f"qd0[{link}]")
        assert (np.ptp(hf.simulate(make(0.0), t_eval=times).qd, axis=1) == 0.0).all()
        np.testing.assert_array_equal(got.dqd[0, :, 0], np.eye(2)[link])  # the start itself is what it is
        dy = np.concatenate([got.dq, got.dqd], axis=1)[1:, :, 0]
        assert np.abs(dy[:, 2] - dy[:, 3]).max() <= 1e-12
        for want in differences(make, times, 3e-6):
            # the spacing times a second derivative: the joint slips for x / 100 rad/s^2, 3e-8 s, beside 0.02 s; and
            # rates of runs that choose their own steps differ by some 2e-11 rad/s
            np.testing.assert_allclose(dy, want[1:], rtol=0.0, atol=3e-5)


def test_a_stuck_first_joint_turns_with_the_arm():
    """Where the motion's parameter changes the arm's rate, that of a stuck link changes by as much."""
    base = rope(2, dry_friction=0.5)
    motion = hf.move_arm(start=0.0, end=0.3, duration=1.0, profile="minimum-jerk")
    times = np.array([0.3, 0.55, 0.8])
    got = hf.sensitivities(base, motion, arm=hf.Arm(), duration=0.8, t_eval=times, wrt=["motion.end", "qd0[0]"])
    swing = motion.angle(times) / 0.3
    rate = motion.rate(times) / 0.3
    # both links follow rigidly; the products and sums of 20 steps
    np.testing.assert_allclose(got.dq[:, :, 0], np.stack([swing, swing], axis=1), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(got.dqd[:, :, 0], np.stack([rate, rate], axis=1), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(got.dq[:, :, 1], 0.0)


def test_no_dry_friction_yet_is_differentiated_towards_more():
    """Each time that a joint turns back its torque changes sign: a difference to one side, of runs with a little."""
    base, times = rope(3, dry_friction=0.0), np.array([0.2, 0.5, 0.9, 1.3])
    it = setup(3, rope=base, tol=1e-12)
    got = hf.sensitivities(it, t_eval=times, wrt="dry_friction[:]")
    np.testing.assert_allclose(got.q, hf.simulate(it, t_eval=times).q, rtol=0.0, atol=1e-9)
    for link in range(3):
        unit = np.eye(3)[link]
        want, _ = differences(lambda x, u=unit: setup(3, rope=base.replace(dry_friction=x * u * (x > 0))), times, 1e-8)
        size = np.abs(want[:, :3]).max()
        # the spacing times a second derivative: 1e-8 of a friction that matters at 1e-4 of it
        np.testing.assert_allclose(got.dq[:, :, link], want[:, :3], rtol=0.0, atol=2e-3 * size)
