"""Claim C1, as a motion: an arm driven by the torque that (3) recovers moves as the arm that was led; rope and all."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import hyperflex as hf
from hyperflex.core.chain.drive import TORQUE
from hyperflex.dynamics import partial_linearization, torque_from_input
from hyperflex.motion.piecewise import CHANNELS, POWERS

pytestmark = pytest.mark.claims

ARM = hf.Arm(length=0.105, inertia=2e-3, mass=0.1, com=0.05, friction=1e-3)
END = 1.5  # s


def cable(friction_model: str) -> hf.Rope:
    return hf.Rope.uniform(
        length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4, friction_model=friction_model
    )


def smooth_torque(t: np.ndarray, torque: np.ndarray, bend: float) -> hf.Motion:
    """A torque through its samples as two cubic splines that meet at `bend`, without a restart at each sample."""
    k = int(np.searchsorted(t, bend - 1e-9))
    parts = [CubicSpline(t[: k + 1], torque[: k + 1]), CubicSpline(t[k:], torque[k:])]
    coef = np.zeros((t.size - 1, CHANNELS, POWERS))
    coef[:, TORQUE, :4] = np.concatenate([part.c[::-1].T for part in parts])
    switch = np.zeros(t.size, dtype=bool)
    switch[[0, k, -1]] = True
    return hf.Motion(t, coef, switch)


@pytest.mark.parametrize("friction_model", ["relative", "printed"])
def test_replaying_the_recovered_torque_gives_the_same_motion(friction_model):
    rope = cable(friction_model)
    motion = hf.move_arm(-1.2, 1.3, 0.9, "minimum-jerk")  # no jump of the acceleration, so the torque is smooth
    t = np.linspace(0.0, END, 3001)
    led = hf.simulate(rope, motion, arm=ARM, duration=END, t_eval=t, tol=1e-9)
    u = motion.acceleration(t)
    torque = np.array(
        [
            torque_from_input(
                partial_linearization(rope, ARM, led.q[k], led.qd[k], led.arm_angle[k], led.arm_rate[k]), u[k]
            )
            for k in range(t.size)
        ]
    )
    np.testing.assert_allclose(torque, led.motor_torque, rtol=0, atol=1e-9 * np.abs(torque).max())
    late = t[::300]
    driven = hf.simulate(
        rope, arm=ARM, torque=smooth_torque(t, torque, 0.9), duration=END, arm_angle0=-1.2, t_eval=late, tol=1e-9
    )
    # The spline through 0.5 ms samples is good to (0.5 ms / 20 ms)^4 = 4e-7 of the torque; where the torque's third
    # derivative jumps (start and end of the move) it is second order there. The pendulum hangs, so nothing grows.
    np.testing.assert_allclose(driven.arm_angle, led.arm_angle[::300], rtol=0, atol=1e-6)
    np.testing.assert_allclose(driven.tip, led.tip[::300], rtol=0, atol=1e-6)
    # And the energies: both books must agree on what the motor did for arm and rope together.
    own = 0.5 * (ARM.inertia + ARM.mass * ARM.com**2) * driven.arm_rate**2 - 9.81 * ARM.mass * ARM.com * np.cos(
        driven.arm_angle
    )
    whole = driven.kinetic_energy + driven.potential_energy
    np.testing.assert_allclose(whole - own, (led.kinetic_energy + led.potential_energy)[::300], rtol=0, atol=1e-6)
