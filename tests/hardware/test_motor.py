"""The simulated servo: its lag, its delay, its torque and its encoder, each against what its equation says."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hyperflex.errors import InvalidInput
from hyperflex.hardware import SimulatedMotor
from hyperflex.interfaces import Motor
from hyperflex.motion import hold_arm, move_arm
from tests.refusals import refuses

FINE = 10**9  # steps of an encoder that hides nothing
RAMP = move_arm(0.0, 4.0, duration=2.0, profile="ramp", ramp=0.1)  # 4 / 1.8 rad/s in between
SPEED = 4.0 / 1.8


def read(motor: Motor, times) -> np.ndarray:
    return np.array([motor.angle(float(t)) for t in times])


def test_at_constant_speed_it_is_late_by_its_lag_and_its_latency():
    motor = SimulatedMotor(lag=0.02, latency=0.03, counts=FINE)
    motor.set_motion(RAMP, 0.0)
    # The latency holds the first effect back; a motion on absolute time is then caught up with.
    assert read(motor, [0.02, 1.0])[0] == 0.0
    expected = float(RAMP.angle(1.0)) - SPEED * 0.02
    assert motor.angle(1.0) == pytest.approx(expected, abs=1e-6)  # what began late has faded by exp(-100)


def test_it_moves_as_its_equation_says():
    motor = SimulatedMotor(lag=0.05, counts=FINE)
    motor.set_motion(RAMP, 0.0)
    w = 2.0 / 0.05
    true = solve_ivp(
        lambda t, y: [y[1], w**2 * (float(RAMP.angle(t)) - y[0]) - 2.0 * w * y[1]],
        (0.0, 2.5),
        [0.0, 0.0],
        t_eval=np.linspace(0.1, 2.4, 12),
        rtol=1e-8,
        max_step=0.01,
    )
    # First order in steps of 0.25 ms: an error of about a step's way in the acceleration phase, 2.2 rad/s 0.25 ms.
    np.testing.assert_allclose(read(motor, true.t), true.y[0], atol=6e-4)


def test_a_weak_one_falls_behind_by_what_its_torque_allows():
    motor = SimulatedMotor(lag=0.01, counts=FINE, torque=0.05, inertia=0.01)  # 5 rad/s^2 at most
    motor.set_motion(hold_arm(3.0), 0.0)
    assert motor.angle(0.4) == pytest.approx(0.5 * 5.0 * 0.4**2, rel=2e-3)  # a step of 400 and more


def test_the_encoder_has_whole_steps():
    motor = SimulatedMotor(lag=0.01, counts=100)
    motor.set_motion(RAMP, 0.0)
    step = 2.0 * math.pi / 100
    t = np.linspace(0.0, 1.0, 57)
    shown = read(motor, t) / step
    np.testing.assert_allclose(shown, np.round(shown), atol=1e-9)
    same = SimulatedMotor(lag=0.01, counts=FINE)
    same.set_motion(RAMP, 0.0)
    error = read(same, t) - step * shown
    assert error.min() > -1e-6
    assert step > error.max() > 0.5 * step


def test_what_it_did_is_a_motion_and_a_change_comes_through_after_the_latency():
    motor = SimulatedMotor(lag=0.01, latency=0.1, counts=FINE)
    motor.set_motion(hold_arm(1.0), 0.0)
    motor.angle(0.5)
    motor.set_motion(hold_arm(0.0), 0.5)
    angles = read(motor, [0.59, 1.0])
    np.testing.assert_allclose(angles, [1.0, 0.0], atol=1e-4)
    done = motor.motion()
    np.testing.assert_allclose(done.angle([0.05, 0.59, 0.99]), [0.0, 1.0, 0.0], atol=1e-3)


def test_times_do_not_go_back_and_limits_are_checked():
    motor = SimulatedMotor()
    motor.angle(0.5)
    refuses("time goes back", motor.angle, 0.4)
    refuses("time goes back", motor.set_motion, RAMP, 0.1)
    refuses("motion is no Motion", motor.set_motion, "now", 1.0)
    for wrong in ({"lag": 0.0}, {"torque": -1.0}, {"counts": 0}, {"inertia": math.nan}, {"latency": -0.1}):
        with pytest.raises(InvalidInput):
            SimulatedMotor(**wrong)
