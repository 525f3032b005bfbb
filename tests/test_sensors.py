"""What sensors would show, and its derivatives, against the simulator's own."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex import dynamics
from hyperflex.checks import Array
from hyperflex.sensors import Accelerometer, Angles, Markers, Measurement, MotorTorque
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
    assert found.D.shape == (3, 1)


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


def test_torque_is_the_simulators():
    motion = hf.move_arm(0.4, 1.4, 0.5)
    run = hf.simulate(ROPE, motion, arm=ARM, duration=0.2, q0=X[1:4], qd0=X[5:])
    for k in (0, 7, 15):
        at = hf.State(run.t[k], run.q[k], run.qd[k], arm_angle=run.arm_angle[k], arm_rate=run.arm_rate[k])
        found = MotorTorque(ARM).measure(ROPE, ARM, at, float(motion.acceleration(run.t[k])))
        assert found.y[0] == pytest.approx(run.motor_torque[k], abs=1e-10)


def test_torques_derivatives_are_those_of_differences():
    """Both are central differences, of 1e-5, or chained from them: 1e-10 of third derivatives of some hundreds."""
    check_differences(lambda x: MotorTorque(ARM).measure(ROPE, ARM, state(x), 3.0), 1e-6)
    ends = [MotorTorque(ARM).measure(ROPE, ARM, state(X), u) for u in (3.0, 5.0)]
    assert ends[0].D[0, 0] == pytest.approx((ends[1].y[0] - ends[0].y[0]) / 2.0, rel=1e-8)  # linear in it


PLACES = [(0, 0.0), (0, 0.15), (1, 0.2), (1, 0.3), (2, 0.45), (2, 0.6)]  # (link, m): joints, the tip, and between


def dry(rope: hf.Rope) -> hf.Rope:
    """Return the rope with enough dry friction for its second joint to stick if its links rotate together."""
    return rope.replace(dry_friction=[1e-3, 1.0, 1e-3])


def test_pendulum_at_rest_reads_g_along_the_link():
    """Gravity from the side: the rope and its accelerometers hang askew. A bias adds to the reading."""
    for gravity in ((0.0, -9.81), (3.0, -4.0)):
        rope = ROPE.replace(gravity=gravity)
        still = hf.State(0.0, np.full(3, rope.hanging_angle), np.zeros(3), arm_angle=rope.hanging_angle, arm_rate=0.0)
        for link, s in PLACES:
            found = Accelerometer(link, s, bias=(0.1, -0.2)).measure(rope, ARM, still)
            np.testing.assert_allclose(found.y, [0.1, np.hypot(*gravity) - 0.2], rtol=0, atol=1e-12)


def test_acceleration_is_that_of_a_marker_in_a_run():
    """Second differences of the places in a run, 1 ms apart: h^2 / 12 of the fourth derivative, some 1e5 m/s^4."""
    h, motion = 1e-3, hf.move_arm(0.4, 1.4, 0.5)
    t = 0.1 + h * np.arange(-1, 2)
    run = hf.simulate(ROPE, motion, arm=ARM, q0=X[1:4], qd0=X[5:], t_eval=t, duration=0.2, tol=1e-11)
    states = [
        hf.State(t[k], run.q[k], run.qd[k], arm_angle=run.arm_angle[k], arm_rate=run.arm_rate[k]) for k in range(3)
    ]
    for link, s in PLACES:
        places = [Markers([s]).measure(ROPE, ARM, at).y for at in states]
        proper = (places[0] - 2.0 * places[1] + places[2]) / h**2 - ROPE.gravity
        cos, sin = np.cos(run.q[1, link]), np.sin(run.q[1, link])
        found = Accelerometer(link, s).measure(ROPE, ARM, states[1], float(motion.acceleration(t[1])))
        np.testing.assert_allclose(found.y, np.array([[cos, sin], [-sin, cos]]) @ proper, rtol=0, atol=0.05)


@pytest.mark.parametrize("rope", [ROPE, dry(ROPE)], ids=["viscous", "dry"])
def test_accelerations_derivatives_are_those_of_differences(rope):
    """Central differences of 1e-5 of values to some hundreds: rounding and third derivatives leave some 1e-7."""
    for link, s in PLACES:
        sensor = Accelerometer(link, s, bias=(0.1, 0.2))
        check_differences(lambda x, sensor=sensor: sensor.measure(rope, ARM, state(x), 3.0), 1e-5)
        ends = [sensor.measure(rope, ARM, state(X), u) for u in (3.0, 5.0)]
        np.testing.assert_allclose(ends[0].D[:, 0], (ends[1].y - ends[0].y) / 2.0, rtol=0, atol=1e-11)  # linear in it


def test_accelerations_derivatives_by_the_sensors_values():
    sensor, step = Accelerometer(1, 0.3, bias=(0.1, 0.2)), 1e-4
    found = sensor.value_jacobian(ROPE, ARM, state(X), 3.0)
    for k, e in enumerate(step * np.eye(3)):
        ends = [sensor.with_values(sensor.values + d).measure(ROPE, ARM, state(X), 3.0).y for d in (e, -e)]
        np.testing.assert_allclose(found[:, k], (ends[0] - ends[1]) / (2.0 * step), rtol=0, atol=1e-9)  # linear in them


def test_stuck_joint_makes_two_links_one():
    """Links that dry friction holds together read what one rigid link of both reads."""
    stuck = dry(ROPE).replace(stiffness=[0.0, 0.0, 0.0])
    at = hf.State(0.0, np.array([0.3, 0.3, 0.9]), np.array([1.0, 1.0, 0.5]), arm_angle=0.4, arm_rate=1.5)
    ends = {}
    for rope in (stuck, ROPE):
        by_place = [
            Accelerometer(*at_place).value_jacobian(rope, ARM, at, 3.0)[:, 2] for at_place in ((0, 0.1), (1, 0.3))
        ]
        ends[rope is stuck] = by_place[0] - by_place[1]
    np.testing.assert_allclose(ends[True], 0.0, rtol=0, atol=1e-9)
    assert np.abs(ends[False]).max() > 1.0


def test_acceleration_under_a_torque_follows_by_the_chain_rule():
    """As the docstring says: H + D A[n + 1] and D B[n + 1]."""
    sensor, tau = Accelerometer(2, 0.5), 0.2

    def seen(x, u):
        a, b = hf.linearize(ROPE, ARM, x[1:4], x[5:], x[0], x[4], command="torque", u=u)
        linear = dynamics.partial_linearization(ROPE, ARM, x[1:4], x[5:], x[0], x[4])
        found = sensor.measure(ROPE, ARM, state(x), dynamics.input_from_torque(linear, u))
        return Measurement(found.y, found.H + found.D @ a[4:5], found.D @ b[4:5])

    check_differences(lambda x: seen(x, tau), 1e-5)
    change = (seen(X, tau + 1e-3).y - seen(X, tau - 1e-3).y) / 2e-3
    np.testing.assert_allclose(seen(X, tau).D[:, 0], change, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("link", "s", "match"),
    [
        (-1, 0.1, "link"),
        (3, 0.55, "link is not of this rope"),
        (1, 0.1, "arc_length is not on link 1"),
        (2, 0.61, "on link 2"),
    ],
)
def test_accelerometer_refuses_places_that_are_not_on_its_link(link, s, match):
    refuses(match, lambda: Accelerometer(link, s).measure(ROPE, ARM, state(X)))


@pytest.mark.parametrize(
    "sensor", [Angles(), Markers([0.5]), Accelerometer(0, 0.5 * float(ROPE.length[0])), MotorTorque(ARM)]
)
def test_every_sensor_measures_by_the_same_call_and_refuses_what_cannot_be(sensor):
    found = sensor.measure(ROPE, ARM, state(X), acceleration=0.5)
    assert found.H.shape == (found.y.size, 2 * ROPE.n_links + 2)
    assert found.D.shape == (found.y.size, 1)
    for wrong in (np.nan, "x"):
        refuses("state arm_angle", sensor.measure, ROPE, ARM, replace(state(X), arm_angle=wrong))
    refuses("acceleration", sensor.measure, ROPE, ARM, state(X), np.nan)
    refuses("a rope on an arm", sensor.measure, ARM, ROPE, state(X))
    refuses("a rope on an arm", sensor.measure, ROPE, ARM, None)
