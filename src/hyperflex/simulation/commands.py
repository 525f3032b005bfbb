"""Commands of the arm in an interval: acceleration, angle or motor torque."""

from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import ANGLE, TORQUE, Drive
from hyperflex.core.tangent.extrapolation import Directions
from hyperflex.errors import InvalidInput
from hyperflex.model import Setup
from hyperflex.motion import torque_profile
from hyperflex.simulation.sensitivity.directions import ParameterDirections

COMMANDS = ("acceleration", "angle", "torque")


def setup_for(command: str, setup: Setup) -> Setup:
    """Return a set-up with an arm that a stepper can command, without a motion or a torque of its own."""
    if setup.arm is None:
        fix = "Give Arm(length=0.0) for a rope that hangs from the motor's shaft itself"
        fix = "" if command == "torque" else fix
        raise InvalidInput("a stepper needs an arm to command", allowed="arm=Arm(...)", fix=fix)
    torque = torque_profile([0.0, 1.0], [0.0, 0.0]) if command == "torque" else None
    angle, rate = setup.arm_angle0, setup.arm_rate0
    if setup.motion is not None:
        angle, rate = float(setup.motion.angle(0.0)), float(setup.motion.rate(0.0))
    return replace(setup, motion=None, torque=torque, arm_angle0=angle, arm_rate0=rate, control=None, control_rate=None)


def arm_polynomials(command: str, dt: float) -> tuple[Array, Array]:
    """Return what the arm does in an interval, in proportion to its angle and rate at the beginning and the command.

    Returns
    -------
    powers : (3, 6) float64
        Coefficients of the arm's angle, or of the motor's torque, in powers of the time since the interval began.
    ends : (3, 2) float64
        Angle and rate of a prescribed arm at its end.
    """
    powers, ends = np.zeros((3, 6)), np.zeros((3, 2))
    if command == "torque":
        powers[2, 0] = 1.0
        return powers, ends
    powers[0, 0] = powers[1, 1] = 1.0
    if command == "acceleration":
        powers[2, 2] = 0.5
        ends[:] = [[1.0, 0.0], [dt, 1.0], [0.5 * dt * dt, dt]]
        return powers, ends
    powers[:, 2] = -2.0 / dt**2, -2.0 / dt, 2.0 / dt**2
    powers[:, 3] = 1.0 / dt**3, 1.0 / dt**2, -1.0 / dt**3
    ends[:] = [[0.0, -1.0 / dt], [0.0, 0.0], [1.0, 1.0 / dt]]
    return powers, ends


def state_directions(command: str, chain: Chain, drive: Drive) -> tuple[Array, Directions]:
    """Return the directions of x = (arm angle, q, arm rate, qd) and of the command (:func:`set_commands`).

    Returns
    -------
    start : (2 N, p) float64
        Derivatives of the angles and rates of the chain's N links, p even: nothing changes in the last direction if the
        number of the others is odd.
    seeds : Directions
        What else changes.
    """
    n, by = chain.length.size, {"coef": np.ones((1, 4, 6))}
    q, qd = ([{name: row} for row in np.eye(n)] for name in ("q0", "qd0"))
    parts = [*q, *qd, by] if command == "torque" else [by, *q, by, *qd, by]
    varied = ParameterDirections(tuple(map(str, range(len(parts)))), tuple(parts))
    return varied.start(n), varied.directions(chain, drive._replace(coef=by["coef"]))  # all that may ever move


def set_commands(command: str, seeds: Directions, powers: Array) -> None:
    """Set directions to those of an interval, whose `powers` are as :func:`arm_polynomials` gives them."""
    rows, channel = (powers[2:], TORQUE) if command == "torque" else (powers, ANGLE)
    seeds.coef[:] = 0.0
    seeds.coef[: len(rows), 0, channel] = rows
