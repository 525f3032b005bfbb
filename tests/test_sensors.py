"""What a camera, an encoder or a torque sensor would show, and its derivatives, against the simulator's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.sensors import Angles, Markers, Measurement, MotorTorque

ROPE = hf.Rope(
    length=[0.2, 0.25, 0.15],
    mass=[0.02, 0.03, 0.01],
    inertia=[1e-4, 2e-4, 5e-5],
    friction=[3e-4, 2e-4, 1e-4],
    stiffness=0.01,
    tip_mass=0.01,
)
ARM = hf.Arm(0.1, inertia=1e-3, mass=0.1, com=0.03, friction=2e-3, pivot=(0.3, -0.2))
X = np.array([0.4, 0.3, 0.5, 0.9, 1.5, 1.0, -2.0, 0.5])  # arm angle, q, arm rate, qd


def state(x: Array) -> hf.State:
    return hf.State(0.0, x[1:4], x[5:], arm_angle=x[0], arm_rate=x[4])


def check_differences(measure: Callable[[Array], Measurement], atol: float) -> None:
    found, step = measure(X), 1e-5
    for k, e in enumerate(step * np.eye(X.size)):
        change = (measure(X + e).y - measure(X - e).y) / (2.0 * step)
        np.testing.assert_allclose(found.H[:, k], change, rtol=0, atol=atol)


def test_angles_are_the_states() -> None:
    found = Angles().measure(ROPE, ARM, state(X))
    np.testing.assert_array_equal(found.y, X[1:4])
    check_differences(lambda x: Angles().measure(ROPE, ARM, state(x)), 1e-10)
    assert found.D.shape == (3, 1)


def test_markers_are_where_the_rope_is() -> None:
    """At the joints, a third along a link and beyond the tip; the camera sees the origin elsewhere."""
    joints = hf.forward_kinematics(ROPE, X[1:4], arm=ARM, arm_angle=X[0])
    seen = Markers([0.0, 0.2, 0.2 + 0.25 / 3, 0.6, 0.63], origin=(0.02, 0.01))
    places = seen.measure(ROPE, ARM, state(X)).y.reshape(-1, 2) - [0.02, 0.01]
    third = joints[1] + (joints[2] - joints[1]) / 3
    beyond = joints[3] + 0.2 * (joints[3] - joints[2])
    np.testing.assert_allclose(places, [joints[0], joints[1], third, joints[3], beyond], rtol=0, atol=1e-15)
    check_differences(lambda x: seen.measure(ROPE, ARM, state(x)), 1e-10)
    with pytest.raises(InvalidInput, match="arc_lengths is empty"):
        Markers([])


def test_torque_is_the_simulators() -> None:
    motion = hf.move_arm(0.4, 1.4, 0.5)
    run = hf.simulate(ROPE, motion, arm=ARM, duration=0.2, q0=X[1:4], qd0=X[5:])
    for k in (0, 7, 15):
        at = hf.State(run.t[k], run.q[k], run.qd[k], arm_angle=run.arm_angle[k], arm_rate=run.arm_rate[k])
        found = MotorTorque(ARM).measure(ROPE, at, float(motion.acceleration(run.t[k])))
        assert found.y[0] == pytest.approx(run.motor_torque[k], abs=1e-10)


def test_torques_derivatives_are_those_of_differences() -> None:
    """Both are central differences, of 1e-5, or chained from them: 1e-10 of third derivatives of some hundreds."""
    check_differences(lambda x: MotorTorque(ARM).measure(ROPE, state(x), 3.0), 1e-6)
    ends = [MotorTorque(ARM).measure(ROPE, state(X), u) for u in (3.0, 5.0)]
    assert ends[0].D[0, 0] == pytest.approx((ends[1].y[0] - ends[0].y[0]) / 2.0, rel=1e-8)  # linear in it


def test_torque_and_acceleration_are_inverse() -> None:
    """The torque that a prescribed arm asks for drives a free one with the same acceleration."""
    found = MotorTorque(ARM).measure(ROPE, state(X), 3.0)
    stepper, dt = hf.Stepper(ROPE, arm=ARM, command="torque", tol=1e-10), 1e-5
    begin = stepper.start(X[1:4], X[5:], arm_angle=X[0], arm_rate=X[4])
    end = stepper.step(begin, float(found.y[0]), dt)
    assert (end.arm_rate - X[4]) / dt == pytest.approx(3.0, abs=1e-2)  # to first order in dt
