"""Claim C1: partial linearisation, equations (2) and (3), on the paper's own cast."""

from functools import cache

import numpy as np

from hyperflex.checks import Array
from hyperflex.dynamics import bias, input_from_torque, mass_matrix, partial_linearization, torque_from_input
from hyperflex.model import Arm
from hyperflex.motion import arm_swings, torque_profile
from hyperflex.paper.casting import T_MOVE, T_REST, TOL, Reading, cable
from hyperflex.paper.results import Claim
from hyperflex.simulation import simulate

ARM = Arm(length=0.105, inertia=1e-3, friction=1e-3)  # the paper names no inertia; kg m^2 and N m s/rad of our own
SPAN = 2.0 * (T_MOVE + T_REST["success"])  # s, one whole swing there and back
RATE = 2000  # torque samples per second
_BEFORE = 1e-7  # s, the torque is also sampled this long before each of its jumps


@cache
def replay(reading: Reading) -> tuple[float, float]:
    """Recover the motor torque of one swing by (3) and drive the arm with it.

    Returns
    -------
    acceleration_error : float
        Greatest difference between the input u and the arm's acceleration under the recovered torque, by a dense solve
        of (1), over the greatest u.
    tip_error : float
        Greatest distance between the tips under the prescribed motion and under the torque, open loop, m.
    """
    rope = cable(reading.friction)
    motion = arm_swings(T_MOVE, T_REST["success"], path=reading.path)
    t = _sample_times(motion.switches(0.0, SPAN))
    led = simulate(rope, motion, arm=ARM, duration=SPAN, t_eval=t, tol=TOL)
    u = motion.acceleration(t)
    torque, errors = np.empty_like(t), np.empty_like(t)
    for k, (q, qd, angle, rate) in enumerate(zip(led.q, led.qd, led.arm_angle, led.arm_rate, strict=True)):
        linear = partial_linearization(rope, ARM, q, qd, angle, rate)
        torque[k] = torque_from_input(linear, u[k])
        errors[k] = abs(input_from_torque(linear, torque[k]) - u[k])
        if k % 100 == 0:  # the dense solve is slow; a few dozen instants of the swing tell as much
            load = -bias(rope, q, qd, arm=ARM, arm_angle=angle, arm_rate=rate)
            load[0] += torque[k]
            own = np.linalg.solve(mass_matrix(rope, q, arm=ARM, arm_angle=angle), load)[0]
            errors[k] = max(errors[k], abs(own - u[k]))
    driven = simulate(
        rope, torque=torque_profile(t, torque), arm=ARM, arm_angle0=led.arm_angle[0], duration=SPAN, t_eval=t, tol=TOL
    )
    distance = np.linalg.norm(driven.tip - led.tip, axis=1)
    return float(errors.max() / np.abs(u).max()), float(distance.max())


def linearized(reading: Reading) -> Claim:
    """C1: with u from (3) the arm's acceleration equals u, and the torque recovered from u reproduces the motion."""
    error, distance = replay(reading)
    note = f"the recovered torque, replayed open loop for one swing, leads the tip back within {1e3 * distance:.2g} mm"
    statement = "u of (3) is the arm's acceleration: relative error"
    return Claim("C1", statement, reading, error, 1e-9, note, "<=")


def _sample_times(switches: Array) -> Array:
    """Return a grid over the span with each switch, and an instant just before it, in place of its neighbours."""
    inside = switches[(switches > 0.0) & (switches < SPAN)]
    grid = np.linspace(0.0, SPAN, round(SPAN * RATE) + 1)
    free = np.abs(grid[:, None] - inside).min(axis=1) > 10.0 * _BEFORE
    return np.unique(np.concatenate([grid[free], inside - _BEFORE, inside]))
