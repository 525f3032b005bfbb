"""The task of every contestant: the paper's cast of a cable by a prescribed arm."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

import hyperflex as hf
from hyperflex.checks import Array

LENGTH, MASS, RADIUS = 2.0, 0.125, 0.0025  # m, kg, m: the paper's cable
FRICTION = 5e-4  # N m s/rad a joint, at PAPER_LINKS links
PAPER_LINKS = 50


@dataclass(frozen=True)
class Stretch:
    """A time interval without a switch of the motion: contestants restart at its ends."""

    start: float
    end: float
    acceleration: float  # of the arm, rad/s^2; constant, for the motion is bang-bang
    output: bool  # whether the tip is wanted at its end


@dataclass(frozen=True)
class Cast:
    """A rope that hangs at rest, an arm, its bang-bang motion, and the times (T,) at which the tip is compared, s."""

    rope: hf.Rope
    arm: hf.Arm
    motion: hf.Motion
    times: Array

    @property
    def duration(self) -> float:
        """Simulated time, s."""
        return float(self.times[-1])

    def stretches(self) -> Iterator[Stretch]:
        """Intervals of constant arm acceleration, also divided at the output times."""
        cuts = np.unique(np.round(np.concatenate([self.motion.switches(0.0, self.duration), self.times]), 12))
        start = 0.0
        for end in cuts[cuts > 0.0]:
            middle = float(self.motion.acceleration(0.5 * (start + end)))
            yield Stretch(start, float(end), middle, bool(np.abs(self.times - end).min() < 1e-9))
            start = float(end)

    def base(self, t: Array, acceleration: float) -> tuple[Array, Array]:
        """Acceleration (T, 2) of the arm's end, m/s^2, and the arm's rate (T,), rad/s, within an interval."""
        angle, rate = self.motion.angle(t), self.motion.rate(t)
        sin, cos = np.sin(angle), np.cos(angle)
        along = np.stack([cos * acceleration - sin * rate**2, sin * acceleration + cos * rate**2], axis=-1)
        return self.arm.length * along, rate

    def tip(self, t: float, q: Array) -> Array:
        """Tip (2,), m, at time t with the absolute link angles q (n,)."""
        angle = np.append(float(self.motion.angle(t)), q)
        length = np.append(self.arm.length, self.rope.length)
        return np.array([np.sum(length * np.sin(angle)), -np.sum(length * np.cos(angle))])

    def reference(self) -> Array:
        """Tip (T, 2) by explicit Runge-Kutta with steps of 0.1 ms, independent of the methods that are compared."""
        return hf.simulate(
            self.rope,
            self.motion,
            arm=self.arm,
            duration=self.duration,
            t_eval=self.times,
            step=1e-4,
        ).tip


@dataclass(frozen=True)
class Contestant:
    """One setting of one simulator; `run` simulates the whole cast and returns the tip (T, 2).

    Settings of one `method` differ only in step or tolerance, so that a plot can join them by a line.
    """

    simulator: str
    method: str
    setting: str
    run: Callable[[], Array]
    adaptive: bool = False  # whether it chooses its own steps


def cable(n_links: int, *, scaled: bool = False) -> hf.Rope:
    """Return the paper's cable cut into n links.

    With `scaled` the friction of a joint grows with n, so that friction times link length, the resistance of the
    continuous cable to a rate of bending, stays that of the paper's 50 links.
    """
    friction = FRICTION * (n_links / PAPER_LINKS if scaled else 1.0)
    return hf.Rope.uniform(length=LENGTH, mass=MASS, n_links=n_links, radius=RADIUS, friction=friction)


def paper_cast(
    n_links: int = PAPER_LINKS, times: tuple[float, ...] = (2.0, 5.0, 10.0), *, scaled: bool = False
) -> Cast:
    """Return the cast of Fig. 9 with t_a = 0.73 s and t_c = 0.53 s."""
    motion = hf.arm_swings(t_move=0.73, t_rest=0.53)
    return Cast(cable(n_links, scaled=scaled), hf.Arm(length=0.105), motion, np.array(times))


def distance_mm(tip: Array, true: Array) -> Array:
    """Distance (T,) between two tips (T, 2), mm; inf where one is not a number."""
    gap = np.hypot(*(tip - true).T) * 1e3
    return np.where(np.isfinite(gap), gap, math.inf)
