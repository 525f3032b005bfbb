"""What is asked of a whip, and how well peaks of a tip's speed meet it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.search.batch_rollout import finished
from hyperflex.simulation import simulate_batch

SAMPLE_TIME, COARSE_TOL = 0.02, 1e-3  # s, m: looks at a swing in a search, and its tolerance
SPARE_ANGLE, SPARE_SPEED = 0.6, 1.05  # parts of what is allowed and asked that a search aims at
ANGLE_COST, SPEED_COST, EARLIER_COST = 0.3, 1.0, 0.5  # m/rad; m per part of the speed that is missing, and too much
TIME_COST = 0.004  # m/s: of equal whips the sooner one is less uncertain
NEVER = 10.0  # m, cost of a swing without a peak


@dataclass(frozen=True)
class Mark:
    """A point that the tip shall pass at a peak of its speed.

    Parameters
    ----------
    x, y : float
        m.
    direction : float
        Direction of the tip's velocity there, rad, counterclockwise from the x axis.
    speed : float
        Least speed, m/s, > 0.
    within : float
        Greatest angle between velocity and direction, rad, > 0 and at most pi; pi: any direction will do.

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign.
    """

    x: float
    y: float
    direction: float
    speed: float = 5.0
    within: float = float(np.radians(20.0))

    def __post_init__(self) -> None:
        for name, unit in (("x", "m"), ("y", "m"), ("direction", "rad")):
            object.__setattr__(self, name, checks.number(f"target {name}", getattr(self, name), unit=unit))
        for name, unit in (("speed", "m/s"), ("within", "rad")):
            value = checks.number(f"target {name}", getattr(self, name), sign="positive", unit=unit)
            object.__setattr__(self, name, value)
        if self.within > np.pi:
            raise InvalidInput("target within is too large", got=self.within, allowed="at most pi")

    @classmethod
    def at(cls, point: npt.ArrayLike, direction: npt.ArrayLike, speed: float, within: float) -> Mark:
        """Return a mark at a point (2,), m, with a direction (2,), a vector of any length but 0."""
        x, y = checks.array("point", point, (2,), unit="m")
        way = checks.array("direction", direction, (2,))
        if not np.hypot(*way) > 0.0:
            raise InvalidInput("direction is zero", got=way.tolist(), allowed="a vector with a length")
        return cls(float(x), float(y), float(np.arctan2(way[1], way[0])), speed, within)

    @classmethod
    def anyway(cls, point: npt.ArrayLike, speed: float) -> Mark:
        """Return a mark at a point (2,), m, that may be passed in any direction."""
        return cls.at(point, (1.0, 0.0), speed, float(np.pi))

    @property
    def anyhow(self) -> bool:
        """Whether any direction will do."""
        return self.within == np.pi

    def allowed(self, part: float) -> float:
        """Return `part` of the angle that is allowed, rad; all of it where any direction will do."""
        return self.within if self.anyhow else part * self.within

    @property
    def point(self) -> Array:
        """The point (2,), m."""
        return np.array([self.x, self.y])

    def off(self, velocity: Array) -> Array:
        """Signed angle from the direction to velocities (..., 2), rad."""
        turn = np.arctan2(velocity[..., 1], velocity[..., 0]) - self.direction
        return np.asarray((turn + np.pi) % (2.0 * np.pi) - np.pi)


class Peaks(NamedTuple):
    """Peaks of the tip's speed in several swings (P,), each refined between samples.

    Attributes
    ----------
    row : (P,) int64
        Swing.
    t : (P,) float64
        s.
    place, velocity : (P, 2) float64
        m, m/s.
    speed : (P,) float64
        m/s.
    before : (P,) float64
        Speed of the greatest peak of the swing until then, this one too, m/s.
    """

    row: npt.NDArray[np.int64]
    t: Array
    place: Array
    velocity: Array
    speed: Array
    before: Array


def swung(
    thrower: Thrower, motions: Sequence[Motion], t: Array, *, tol: float = COARSE_TOL, threads: int | None = None
) -> tuple[Array, Array]:
    """Tip (M, T, 2), m, and its velocity (M, T, 2), m/s, of ropes that swing freely from rest at t = 0.

    Parameters
    ----------
    thrower : Thrower
    motions : (M,) sequence of Motion
    t : (T,) float64
        s.
    tol : float
        m.
    threads : int, optional

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C cut the batch short.
    """
    runs = simulate_batch(
        thrower.rope,
        list(motions),
        arm=thrower.arm,
        duration=float(t[-1]),
        t_eval=t,
        tol=tol,
        keep=("tip", "q", "qd"),
        threads=threads,
    )
    batch = finished(runs)
    q, spin = batch.q, thrower.rope.length * batch.qd
    angle, rate = (np.stack([f(t) for f in fs]) for fs in zip(*((m.angle, m.rate) for m in motions), strict=True))
    swing = thrower.arm.length * rate
    vx = (spin * np.cos(q)).sum(axis=2) + swing * np.cos(angle)
    vy = (spin * np.sin(q)).sum(axis=2) + swing * np.sin(angle)
    return batch.tip, np.stack([vx, vy], axis=-1)


def peaks(t: Array, tip: Array, velocity: Array) -> Peaks:
    """Find the peaks of the tip's speed.

    Parameters
    ----------
    t : (T,) float64
        Evenly spaced, s.
    tip, velocity : (M, T, 2) float64
        m, m/s; NaN where a run failed.
    """
    step = float(t[1] - t[0])
    square = np.nan_to_num((velocity**2).sum(axis=2))
    row, at = np.nonzero((square[:, 1:-1] > square[:, :-2]) & (square[:, 1:-1] >= square[:, 2:]))
    low, mid, high = (square[row, at + k] for k in range(3))
    slow, v, fast = (velocity[row, at + k] for k in range(3))
    part = np.clip(0.5 * (low - high) / (low - 2.0 * mid + high), -0.5, 0.5)
    late = part[:, None]
    place = tip[row, at + 1] + step * late * (v + late * (fast - slow) / 4.0)
    v = v + late * (0.5 * (fast - slow) + 0.5 * late * (fast - 2.0 * v + slow))
    speed = np.sqrt(np.maximum(mid - 0.25 * (low - high) * part, 0.0))
    tops = np.zeros_like(square[:, 1:-1])
    tops[row, at] = speed
    before = np.maximum.accumulate(tops, axis=1)[row, at]
    whole = np.isfinite(place).all(axis=1) & np.isfinite(v).all(axis=1)
    return Peaks(*(each[whole] for each in (row, t[at + 1] + step * part, place, v, speed, before)))


def costs(mark: Mark, found: Peaks) -> Array:
    """What peaks cost (P,), m: distance from the target, and more where direction or speed are not what is asked.

    A peak that comes after a greater one costs more, and so does a late one.
    """
    return np.asarray(
        np.hypot(*(found.place - mark.point).T)
        + ANGLE_COST * np.maximum(np.abs(mark.off(found.velocity)) - mark.allowed(SPARE_ANGLE), 0.0)
        + SPEED_COST * np.maximum(1.0 - found.speed / (SPARE_SPEED * mark.speed), 0.0)
        + EARLIER_COST * (1.0 - found.speed / np.maximum(found.before, 1e-9))
        + TIME_COST * found.t
    )


def cheapest(cost: Array, row: npt.NDArray[np.int64], count: int) -> npt.NDArray[np.int64]:
    """Number of the cheapest peak of each of `count` swings (count,); -1 where there is none."""
    result = np.full(count, -1, dtype=np.int64)
    for k in np.argsort(-cost):
        result[row[k]] = k
    return result
