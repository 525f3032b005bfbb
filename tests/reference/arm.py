"""The paper's arm, worked out anew: bang-bang swings between -pi/2 and pi/2, as stretches of constant acceleration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853

from tests.reference.dense import Real


class Stretch(NamedTuple):
    """From time `start` to `end` the arm turns with constant acceleration from `angle` and `rate`."""

    start: float
    end: float
    angle: float
    rate: float
    acceleration: float

    def at(self, t: float) -> tuple[float, float, float]:
        """Angle, rate and acceleration of the arm at time t."""
        s = t - self.start
        return self.angle + s * (self.rate + s * self.acceleration / 2), self.rate + s * self.acceleration, self.acceleration

    def base(self, t: float, arm_length: float) -> Real:
        """The first joint's motion (7,) as the chain takes it: the tip of an arm on a fixed pivot at the origin."""
        angle, rate, alpha = self.at(t)
        along, across = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
        push = arm_length * (alpha * across - rate**2 * along)
        return np.array([*push, alpha, rate, angle, *(arm_length * rate * across)])


def bang_bang_swings(t_move: float, t_rest: float, until: float, *, over: bool = False) -> Iterator[Stretch]:
    """Stretches from 0 to `until`: half of each move speeds up, half slows down; then a rest; then back."""
    t, angle, turn = 0.0, -np.pi / 2, -np.pi if over else np.pi
    while t < until:
        push = 4 * turn / t_move**2
        half = t_move / 2
        yield Stretch(t, t + half, angle, 0.0, push)
        yield Stretch(t + half, t + t_move, angle + turn / 2, push * half, -push)
        yield Stretch(t + t_move, t + t_move + t_rest, angle + turn, 0.0, 0.0)
        t, angle, turn = t + t_move + t_rest, angle + turn, -turn


Rate = Callable[[float, Real], Real]


def integrate(rate: Rate, y: Real, start: float, end: float, rtol: float, atol: float) -> Real:
    """Dormand and Prince's eighth-order method from `start` to `end`, where `rate` must be smooth."""
    solver = DOP853(rate, start, y, end, rtol=rtol, atol=atol)
    while solver.status == "running":
        solver.step()
    if solver.status != "finished":
        raise RuntimeError(f"the reference failed at {solver.t} s")
    return np.asarray(solver.y)
