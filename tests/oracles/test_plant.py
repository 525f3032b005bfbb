"""MuJoCo's accelerations under the torques that an emulated motor applied."""

import numpy as np

import hyperflex as hf
from hyperflex.hardware import Goal
from hyperflex.hardware.emulate import MotorModel, Plant
from hyperflex.model import unit_along
from tests.oracles.mujoco_chain import HingeChain
from tests.reference.arm import integrate


def test_arm_and_rope_of_an_emulated_motor_in_a_throw():
    step, rope = 2e-3, hf.Rope.uniform(length=1.0, mass=0.06, n_links=8, radius=0.0025, friction=1e-3)
    arm = hf.Arm(length=0.15, inertia=1e-4, mass=0.05, com=0.07, friction=1e-3)
    model = MotorModel(inertia=5e-4, friction=2e-3, max_torque=0.25)
    plant = Plant(model, rope, arm, step=step)
    # the rotor turns with the arm about the same axis, and the frictions add up
    oracle = HingeChain(
        rope, (arm.length, arm.mass, arm.com, arm.inertia + model.inertia, arm.friction + model.friction)
    )
    n, motion = oracle.n, hf.arm_moves([0.0, -1.5, 1.5], [0.0, 0.0], [0.4, 0.4])
    plant.set_enabled(True)
    y, torques = np.zeros(2 * n), []
    for k in range(500):
        t = np.array([k * step])
        plant.set_goal(Goal(float(motion.angle(t)[0]), float(motion.rate(t)[0])))
        plant.advance((k + 1) * step)
        torques.append(plant.torque)

        def rate(t, y, torque=plant.torque):
            return np.append(y[n:], oracle.acceleration(y[:n], y[n:], torque=torque))

        y = integrate(rate, y, k * step, (k + 1) * step, 1e-9, 1e-9)
    assert np.abs(torques).max() == 0.25  # the limit counts as well
    joints = arm.tip(plant.arm_angle) + np.cumsum(rope.length[:, None] * unit_along(plant.rope_state()[0]), axis=0)
    oracle.put(y[:n], y[n:])
    # steps of 2 ms are far finer than the plant's 1e-5 m asks for: the tolerance of the reference is left, 1e-9 each
    np.testing.assert_allclose(joints, oracle.joints()[1:], rtol=0, atol=1e-7)
    np.testing.assert_allclose(plant.arm_angle, y[0], rtol=0, atol=1e-7)
    assert np.ptp(joints[:, 0]) > 0.2  # it was no rope at rest
