"""What sensors would show, and its derivatives, against the simulator's own."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.sensors import Angles, Markers, Measurement
from tests.refusals import refuses

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


def test_angles_are_the_states():
    found = Angles().measure(ROPE, ARM, state(X))
    np.testing.assert_array_equal(found.y, X[1:4])
    check_differences(lambda x: Angles().measure(ROPE, ARM, state(x)), 1e-10)


def test_markers_are_where_the_rope_is():
    """At the joints, a third along a link and beyond the tip; the camera sees the origin elsewhere."""
    joints = hf.forward_kinematics(ROPE, X[1:4], arm=ARM, arm_angle=X[0])
    seen = Markers([0.0, 0.2, 0.2 + 0.25 / 3, 0.6, 0.63], origin=(0.02, 0.01))
    places = seen.measure(ROPE, ARM, state(X)).y.reshape(-1, 2) - [0.02, 0.01]
    third = joints[1] + (joints[2] - joints[1]) / 3
    beyond = joints[3] + 0.2 * (joints[3] - joints[2])
    np.testing.assert_allclose(places, [joints[0], joints[1], third, joints[3], beyond], rtol=0, atol=1e-15)
    check_differences(lambda x: seen.measure(ROPE, ARM, state(x)), 1e-10)
    refuses("arc_lengths is empty", Markers, [])


@pytest.mark.parametrize("sensor", [Angles(), Markers([0.5])])
def test_every_sensor_refuses_what_cannot_be(sensor):
    for wrong in (np.nan, "x"):
        refuses("state arm_angle", sensor.measure, ROPE, ARM, replace(state(X), arm_angle=wrong))
    refuses("rope is no Rope", sensor.measure, ARM, ROPE, state(X))
    refuses("state is no State", sensor.measure, ROPE, ARM, None)
