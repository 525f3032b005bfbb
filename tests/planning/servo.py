"""A simulated servo for tests of the closed loop: it lags, its torque is limited, and it keeps what it was asked for."""

import math

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import TrueState
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, hold_arm, sampled_motion

STEP = 2.5e-4  # s
SAMPLE_TIME = 2e-3  # s, between the samples of its motion


class Servo:
    """A critically damped servo from rest at -pi/2; it refuses so many motions after the first one.

    With w = 2 / lag, angle y and command u: y'' = w^2 (u - y) - 2 w y', limited to `acceleration`, rad/s^2.
    """

    def __init__(self, refuses: int = 0, *, lag: float = 0.01, acceleration: float = math.inf) -> None:
        self.asked: list[tuple[float, Motion]] = []
        self.refuses, self.lag, self.acceleration = refuses, lag, acceleration
        self._command: Motion = hold_arm(-0.5 * np.pi)
        self._t, self._y, self._v = 0.0, -0.5 * np.pi, 0.0
        self._seen = [(0.0, self._y)]

    def set_motion(self, motion: Motion, at: float) -> bool:
        self.asked.append((at, motion))
        if 2 <= len(self.asked) < 2 + self.refuses:
            return False
        self.angle(at)
        self._command = motion
        return True

    def angle(self, t: float) -> float:
        """Take the steps that end by t, s (semi-implicit Euler), and return the angle, rad."""
        times: Array = self._t + STEP * np.arange(math.floor((t - self._t) / STEP + 1e-9))
        w = 2.0 / self.lag
        for begin, u in zip(times.tolist(), np.atleast_1d(self._command.angle(times)).tolist(), strict=True):
            pull = w**2 * (u - self._y) - 2.0 * w * self._v
            self._v += STEP * min(self.acceleration, max(-self.acceleration, pull))
            self._y += STEP * self._v
            self._t = begin + STEP
            if self._t >= self._seen[-1][0] + SAMPLE_TIME:
                self._seen.append((self._t, self._y))
        return self._y + self._v * (t - self._t)

    def motion(self) -> Motion:
        """Return what it has done."""
        return sampled_motion(*np.array(self._seen).T)


class OnServo:
    """True state of a rope on a servo, under the motion that the servo has made."""

    def __init__(self, rope: Rope, arm: Arm, servo: Servo) -> None:
        self.servo, self._true = servo, TrueState(rope, arm)

    def state(self, t: float, motion: Motion) -> RopeState:
        self.servo.angle(t)
        return self._true.state(t, motion if t < 2.0 * SAMPLE_TIME else self.servo.motion())
