"""Actions of an environment and the resulting motion of the arms: an acceleration, or half turns on a command."""

import math
from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from hyperflex.checks import Array, Indices
from hyperflex.errors import InvalidInput
from hyperflex.planning import MotorLimits

QUARTER = 0.5 * math.pi  # rad; arms begin at -QUARTER, and half turns go to and fro below the shaft


class Actuator(ABC):
    """Turns actions of many members into accelerations of their arms within the motor's limits.

    `limits` are those of the motor, `dt`, s, is the interval of an action, `count` the number of members.
    """

    space: spaces.Space[np.generic] | spaces.Box  # of one member's action

    def __init__(self, limits: MotorLimits, dt: float, count: int) -> None:
        self.limits, self.dt, self.count = limits, dt, count
        self.remaining = np.zeros(count, dtype=np.int64)  # intervals of the move that is being made

    @abstractmethod
    def accelerations(self, actions: npt.NDArray[np.generic], angle: Array, rate: Array) -> Array:
        """Return accelerations (M,), rad/s^2, of arms at an angle (M,), rad, with a rate (M,), rad/s."""

    def begin(self, which: Indices) -> None:
        """Forget the moves of some members."""
        self.remaining[which] = 0


class AccelerationActuator(Actuator):
    """An action (M, 1) is the arm's acceleration as a part of the motor's greatest, -1 to 1.

    It is reduced where the arm would exceed the motor's speed, or could no longer brake before the end of its range.
    """

    space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def accelerations(self, actions: npt.NDArray[np.generic], angle: Array, rate: Array) -> Array:
        """Return accelerations (M,), rad/s^2."""
        most, dt, speed = self.limits.acceleration, self.dt, self.limits.speed
        wanted = most * np.clip(np.asarray(actions, dtype=np.float64).reshape(self.count), -1.0, 1.0)
        half, middle = 0.5 * most * dt, angle + 0.5 * dt * rate
        room = middle - self.limits.angles[0], self.limits.angles[1] - middle
        low, high = (np.sqrt(half**2 + 2.0 * most * np.maximum(way, 0.0)) - half for way in room)
        given = np.clip(wanted, (-np.minimum(low, speed) - rate) / dt, (np.minimum(high, speed) - rate) / dt)
        return np.clip(given, -most, most)


class TimingActuator(Actuator):
    """An action (M,) of 1 starts a half turn of an arm that rests; 0 waits. While the arm moves both do nothing.

    A half turn goes below the shaft to the other side, half of it at a constant acceleration and half of it at the
    opposite one, as quickly as the motor allows in an even number of intervals.
    """

    space = spaces.Discrete(2)

    def __init__(self, limits: MotorLimits, dt: float, count: int) -> None:
        super().__init__(limits, dt, count)
        if limits.angles[0] > -QUARTER or limits.angles[1] < QUARTER:
            raise InvalidInput("motor angles leave no room for half turns", got=limits.angles, allowed="-pi/2 to pi/2")
        shortest = max(math.sqrt(math.pi / limits.acceleration), math.pi / limits.speed)
        self.half = math.ceil(shortest / dt - 1e-9)  # intervals
        self._sense = np.ones(count)

    def accelerations(self, actions: npt.NDArray[np.generic], angle: Array, rate: Array) -> Array:
        """Return accelerations (M,), rad/s^2."""
        starts = (self.remaining == 0) & (np.asarray(actions).reshape(self.count) == 1)
        self._sense = np.where(starts, np.where(angle < 0.0, 1.0, -1.0), self._sense)
        self.remaining[starts] = 2 * self.half
        sign = np.where(self.remaining > self.half, self._sense, np.where(self.remaining > 0, -self._sense, 0.0))
        self.remaining = np.maximum(self.remaining - 1, 0)
        return math.pi / (self.half * self.dt) ** 2 * sign


ACTUATORS: dict[str, type[Actuator]] = {"acceleration": AccelerationActuator, "timing": TimingActuator}
