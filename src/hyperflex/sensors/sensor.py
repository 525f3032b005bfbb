"""Interface of all sensors: one call that returns the measured channels of a state, with derivatives."""

from typing import NamedTuple, Protocol

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Rope
from hyperflex.trajectory import State


class Measurement(NamedTuple):
    """Channels of a sensor in a state x = (arm angle, q, arm rate, qd), and their derivatives.

    Attributes
    ----------
    y : (C,) float64
        The channels: rad, m, N m or m/s^2.
    H : (C, 2 n + 2) float64
        Their derivatives with respect to x.
    D : (C, 1) float64
        With respect to the arm's acceleration, per rad/s^2.
    """

    y: Array
    H: Array
    D: Array


class Sensor(Protocol):
    """Sensor of a rope on an arm."""

    def measure(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Measurement:
        """Return the channels in one state, with derivatives.

        Parameters
        ----------
        rope, arm : Rope, Arm
        state : State
            Unknown (None) ``arm_angle`` and ``arm_rate`` count as 0.
        acceleration : float
            Of the arm, rad/s^2; it has no effect on places and angles.

        Raises
        ------
        InvalidInput
            If an argument cannot be used.
        """
        ...


def angles_and_rates(rope: Rope, arm: Arm, state: State) -> tuple[Array, Array]:
    """Return angles, rad, and rates, rad/s, (n + 1,) of the arm and all links, validated."""
    if not isinstance(rope, Rope) or not isinstance(arm, Arm) or not isinstance(state, State):
        got = [type(each).__name__ for each in (rope, arm, state)]
        raise InvalidInput("a sensor measures a rope on an arm", got=got, allowed="Rope, Arm, State")
    q, w = (checks.array(f"state {name}", getattr(state, name), (rope.n_links,)) for name in ("q", "qd"))
    angle = checks.number("state arm_angle", 0.0 if state.arm_angle is None else state.arm_angle, unit="rad")
    rate = checks.number("state arm_rate", 0.0 if state.arm_rate is None else state.arm_rate, unit="rad/s")
    return np.append(angle, q), np.append(rate, w)
