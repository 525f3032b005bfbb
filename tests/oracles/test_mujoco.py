"""MuJoCo, an engine written by others, on the same chain: its accelerations, and motions that follow from them."""

import mujoco
import numpy as np
import pytest

import hyperflex as hf
from tests.core.helpers import sweep
from tests.oracles.mujoco_chain import HingeChain
from tests.reference.arm import Stretch, bang_bang_swings, integrate, links_of
from tests.reference.cases import State
from tests.reference.dense import Real

ARM_LENGTH = 0.105
# A led arm needs some inertia for MuJoCo to accept it; its motion is given, so the rope does not feel the figure.
LED = (ARM_LENGTH, 0.1, 0.05, 1e-3, 0.0)


def cable(n: int = 50, **changes: object) -> hf.Rope:
    """The paper's cable."""
    kept = {"length": 2.0, "mass": 0.125, "n_links": n, "radius": 0.0025, "friction": 5e-4, **changes}
    return hf.Rope.uniform(**kept)


def tapered(n: int) -> hf.Rope:
    grow = np.linspace(1.0, 1.7, n)
    return hf.Rope(
        length=0.2 / grow,
        mass=0.03 / grow**2,
        com=0.07 / grow,
        inertia=2e-4 / grow,
        friction=1e-3 / grow,
        stiffness=0.05 / grow,
        tip_mass=0.02,
    )


@pytest.mark.parametrize("n", [1, 2, 7])
def test_accelerations_of_a_led_chain(n):
    """Per-link parameters, damping, springs and a tip mass, on an arm that turns."""
    rope, oracle = tapered(n), HingeChain(tapered(n), LED)
    rng = np.random.default_rng(n)
    for _ in range(5):
        q, w = rng.uniform(-3, 3, n + 1), rng.uniform(-6, 6, n + 1)
        push = float(rng.uniform(-50, 50))
        want = oracle.acceleration(q, w, arm=push)[1:]
        base = Stretch(0.0, 1.0, float(q[0]), float(w[0]), push).base(0.0, ARM_LENGTH)
        got = sweep(links_of(rope), State(q[1:], w[1:], base)).alpha
        # MuJoCo works in relative angles and adds a point's inertia of 1e-14 to the tip: 1e-10 is what is left.
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-9 * np.abs(want).max())


def follow(oracle: HingeChain, stretch: Stretch, y: Real) -> Real:
    """State (2 n,) of the links at the end of a stretch of the led arm, with MuJoCo's accelerations."""
    n = oracle.n - 1

    def rate(t: float, y: Real) -> Real:
        angle, speed, push = stretch.at(t)
        return np.append(y[n:], oracle.acceleration(np.append(angle, y[:n]), np.append(speed, y[n:]), arm=push)[1:])

    return integrate(rate, y, stretch.start, stretch.end, 1e-10, 1e-10)


def test_the_papers_cast_of_fifty_links():
    rope, oracle = cable(), HingeChain(cable(), LED)
    stretches = [s._replace(end=2.0) if s.end > 2.0 else s for s in bang_bang_swings(0.73, 0.53, 2.0)]
    times = np.array([s.end for s in stretches])
    arm = hf.Arm(length=ARM_LENGTH)
    run = hf.simulate(rope, hf.arm_swings(), arm=arm, duration=2.0, t_eval=times, tol=1e-8)
    plain = hf.simulate(rope, hf.arm_swings(), arm=arm, duration=2.0, t_eval=times)
    y = np.zeros(100)
    for k, stretch in enumerate(stretches):
        y = follow(oracle, stretch, y)
        angle, speed, _ = stretch.at(stretch.end)
        oracle.put(np.append(angle, y[:50]), np.append(speed, y[50:]))
        # The project's goal is 1e-5 m at 2 s. At tol 1e-8 m a step, some hundred steps stay below 1e-6 m.
        np.testing.assert_allclose(run.joints[k], oracle.joints(), rtol=0, atol=1e-6)
        # By default, the error that `simulate` states for tol = 1e-5 m: about ten times that after some seconds.
        np.testing.assert_allclose(plain.joints[k], oracle.joints(), rtol=0, atol=10 * 1e-5)
    # And it is a cast that was compared, not a rope at rest.
    assert np.abs(run.tip[:, 0]).max() > 0.3


def test_a_free_swing_by_mujocos_own_integrator():
    """MuJoCo start to end: a rope let go from the side, by its fourth-order Runge-Kutta at 0.2 ms."""
    n, step = 10, 2e-4
    rope = cable(n, friction=2e-3)
    oracle = HingeChain(rope, timestep=step)
    q0 = np.linspace(1.0, 0.2, n)
    oracle.put(q0, np.zeros(n))
    tips = []
    for _ in range(3):
        for _ in range(2500):
            mujoco.mj_step(oracle.model, oracle.data)
        mujoco.mj_kinematics(oracle.model, oracle.data)
        tips.append(oracle.tip())
    run = hf.simulate(rope, duration=1.5, q0=q0, t_eval=[0.5, 1.0, 1.5], tol=1e-9)
    # RK4 at 0.2 ms where the shortest friction mode takes 10 ms: (0.02)^4 / 100 of a 2 m swing is 3e-9 m a mode time;
    # MuJoCo keeps its time step in the file as text and its state in doubles. A micrometre is safe.
    np.testing.assert_allclose(run.tip, tips, rtol=0, atol=1e-6)


def test_a_torque_driven_arm():
    """Arm with mass, inertia and friction under a torque that runs straight between its samples."""
    arm = hf.Arm(length=ARM_LENGTH, inertia=1e-3, mass=0.1, com=0.05, friction=2e-3)
    rope = cable(12)
    knots = np.array([0.0, 0.2, 0.5, 0.9, 1.2])
    pushes = np.array([0.0, 0.15, -0.2, 0.1, 0.0])
    oracle = HingeChain(rope, (arm.length, arm.mass, arm.com, arm.inertia, arm.friction))
    n = oracle.n

    def rate(t, y):
        return np.append(y[n:], oracle.acceleration(y[:n], y[n:], torque=float(np.interp(t, knots, pushes))))

    y = np.append(np.zeros(n), np.zeros(n))
    run = hf.simulate(rope, arm=arm, torque=hf.torque_profile(knots, pushes), duration=1.2, t_eval=knots[1:], tol=1e-9)
    for k in range(4):  # the torque bends at its knots
        y = integrate(rate, y, float(knots[k]), float(knots[k + 1]), 1e-10, 1e-10)
        oracle.put(y[:n], y[n:])
        assert run.arm_angle[k] == pytest.approx(y[0], abs=1e-7)
        # As above: some hundred steps of 1e-9 m, and 1e-10 of MuJoCo's own.
        np.testing.assert_allclose(run.tip[k], oracle.tip(), rtol=0, atol=1e-7)
    assert np.abs(run.arm_angle).max() > 0.3
