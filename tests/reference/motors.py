"""A pendulum of one or two links with motors in its joints, in closed form, and its run by Runge-Kutta steps.

Lagrange's equations of the double pendulum in absolute angles, written out: no matrix, no recursion, nothing in common
with the package.
"""

from collections.abc import Callable
from itertools import pairwise
from math import cos, sin, tanh
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array

GRAVITY = 9.81
STILL = 1e-3  # rad/s, within which dry friction changes its sense: smooth, where the package has stick and slip


class Pendulum(NamedTuple):
    """Two links (length, mass, com, inertia) and their drives (viscous and dry friction, rotor inertia); SI units."""

    length: tuple[float, float]
    mass: tuple[float, float]
    com: tuple[float, float]
    inertia: tuple[float, float]
    viscous: tuple[float, float] = (0.0, 0.0)
    dry: tuple[float, float] = (0.0, 0.0)
    rotor: tuple[float, float] = (0.0, 0.0)

    def accelerations(self, q: Array, w: Array, torque: Array) -> Array:
        """Return the links' accelerations at angles q, rates w and the motors' torques, each (2,)."""
        (l1, _), (m1, m2), (a1, a2), (i1, i2), (r1, r2) = self.length, self.mass, self.com, self.inertia, self.rotor
        (q1, q2), (w1, w2) = (float(q[0]), float(q[1])), (float(w[0]), float(w[1]))
        t1 = float(torque[0]) - self.viscous[0] * w1 - self.dry[0] * tanh(w1 / STILL)
        t2 = float(torque[1]) - self.viscous[1] * (w2 - w1) - self.dry[1] * tanh((w2 - w1) / STILL)
        mixed = m2 * l1 * a2
        one = t1 - t2 - mixed * sin(q1 - q2) * w2 * w2 - (m1 * a1 + m2 * l1) * GRAVITY * sin(q1)
        two = t2 + mixed * sin(q1 - q2) * w1 * w1 - m2 * a2 * GRAVITY * sin(q2)
        first, cross = i1 + m1 * a1 * a1 + m2 * l1 * l1 + r1 + r2, mixed * cos(q1 - q2) - r2
        second = i2 + m2 * a2 * a2 + r2
        size = first * second - cross * cross
        return np.array([(second * one - cross * two) / size, (first * two - cross * one) / size])

    def run(self, t: Array, torque: Callable[[float], Array], q: Array, w: Array, step: float = 1e-3) -> Array:
        """Return angles and rates (T, 4) at times t (T,), s, from q and w (2,) at t[0]: classical Runge-Kutta steps.

        `torque` returns the motors' torques (2,), N m. No step goes over one of the times, so samples of the torque at
        these times cost no order.
        """

        def rate(s: float, y: Array) -> Array:
            return np.concatenate([y[2:], self.accelerations(y[:2], y[2:], torque(s))])

        y, found = np.concatenate([q, w]), [np.concatenate([q, w])]
        for begin, end in pairwise(t):
            count = max(1, round((end - begin) / step))
            h = (end - begin) / count
            for k in range(count):
                s = begin + k * h
                one = rate(s, y)
                two = rate(s + h / 2, y + h / 2 * one)
                three = rate(s + h / 2, y + h / 2 * two)
                four = rate(s + h, y + h * three)
                y = y + h / 6 * (one + 2 * two + 2 * three + four)
            found.append(y)
        return np.array(found)


def single(length: float, mass: float, com: float, inertia: float, **drive: float) -> Pendulum:
    """Return a pendulum of one link: the second link has no mass, and a moment of inertia that nothing feels."""
    drives = {name: (value, 0.0) for name, value in drive.items()}
    return Pendulum((length, 1.0), (mass, 0.0), (com, 0.0), (inertia, 1.0), **drives)
