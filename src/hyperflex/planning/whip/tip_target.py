"""The target of a whip's tip, and the cost of peaks of the tip's speed."""

import math
from dataclasses import MISSING, dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks, options
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.options import option
from hyperflex.planning.problem import Problem

ANGLE_MARGIN, SPEED_MARGIN = 0.6, 1.05  # of the allowed angle and the asked speed, at which a search aims
ANGLE_COST, SPEED_COST = 0.3, 1.0  # m/rad; m per missing fraction of the speed
EARLIER_COST = 0.5  # m per fraction by which a peak is lower than an earlier one
BLOCKED_COST = 3.0  # m per m that the rope went through an obstacle before; 1 finds fewer
TIME_COST = 0.004  # m/s: of equal whips the sooner one is less uncertain


@dataclass(frozen=True)
class TipTarget:
    """A point that the tip shall pass at a peak of its speed.

    Parameters
    ----------
    x, y : float
        m.
    direction : float, optional
        Direction of the tip's velocity there, rad, counterclockwise from the x axis; by default any, and then
        `angle_tolerance` is pi.
    least_speed : float
        Of the tip there, m/s, > 0.
    angle_tolerance : float
        Greatest angle between velocity and direction, rad, > 0 and at most pi; pi: any direction.

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign.
    """

    x: float = option(MISSING, "place of the target, to the right", unit="m")
    y: float = option(MISSING, "place of the target, up", unit="m")
    direction: float = option(  # None becomes 0 when it is made
        None, "direction of the tip's velocity there: 0 is +x, pi/2 is up", unit="rad", shown="any"
    )
    least_speed: float = option(5.0, "least speed of the tip there", unit="m/s", sign="positive")
    angle_tolerance: float = option(
        math.radians(20.0), "greatest angle between velocity and direction, at most pi", unit="rad", sign="positive"
    )

    def __post_init__(self) -> None:
        if self.direction is None:
            object.__setattr__(self, "direction", 0.0)
            object.__setattr__(self, "angle_tolerance", float(np.pi))
        options.check(self, "target")
        for name, unit in (("x", "m"), ("y", "m"), ("direction", "rad")):
            checks.meant(f"target {name}", getattr(self, name), unit)
        if self.angle_tolerance > np.pi:
            raise InvalidInput("target angle_tolerance is too large", got=self.angle_tolerance, allowed="<= pi, in rad")

    @classmethod
    def at(
        cls, point: npt.ArrayLike, direction: npt.ArrayLike | None, least_speed: float, angle_tolerance: float = np.pi
    ) -> "TipTarget":
        """Return a target at a `point` (2,), m, with a `direction` given as a vector of any length but 0; None: any.

        `least_speed` and `angle_tolerance` as of the class, m/s and rad.
        """
        x, y = checks.array("point", point, (2,), unit="m")
        if direction is None:
            return cls(float(x), float(y), least_speed=least_speed)
        vector = checks.array("direction", direction, (2,))
        if not np.hypot(*vector) > 0.0:
            raise InvalidInput("direction is zero", got=vector.tolist(), allowed="a vector with a length")
        return cls(float(x), float(y), float(np.arctan2(vector[1], vector[0])), least_speed, angle_tolerance)

    @property
    def any_direction(self) -> bool:
        """Whether any direction is allowed."""
        return self.angle_tolerance == np.pi

    def allowed_angle(self, fraction: float) -> float:
        """Return a `fraction` of the angle tolerance, rad; all of it if any direction is allowed."""
        return self.angle_tolerance if self.any_direction else fraction * self.angle_tolerance

    @property
    def point(self) -> Array:
        """The point (2,), m."""
        return np.array([self.x, self.y])

    def angle_error(self, velocity: Array) -> Array:
        """Return the signed angle (...) from the direction to a `velocity` (..., 2), m/s, in rad."""
        turn = np.arctan2(velocity[..., 1], velocity[..., 0]) - self.direction
        return np.asarray((turn + np.pi) % (2.0 * np.pi) - np.pi)


class Peaks(NamedTuple):
    """Peaks of the tip's speed in several swings (P,), interpolated between samples.

    `row` is the number of the swing, `t` in s; `place`, m, and `velocity`, m/s, (P, 2) are those of the tip. `highest`
    is the speed of the highest peak of the swing until then, this one included, m/s. `blocked` is by how much, m, the
    rope came too near an obstacle before, or through it.
    """

    row: npt.NDArray[np.int64]
    t: Array
    place: Array
    velocity: Array
    speed: Array
    highest: Array
    blocked: Array


def tip_velocity(problem: Problem, q: Array, qd: Array, angle: Array, rate: Array) -> Array:
    """Velocity of the tip (..., 2), m/s, from q, qd (..., n) and the arm's angle and rate (...), rad and rad/s."""
    spin, arm = problem.rope.length * qd, problem.arm.length * rate
    vx = (spin * np.cos(q)).sum(axis=-1) + arm * np.cos(angle)
    vy = (spin * np.sin(q)).sum(axis=-1) + arm * np.sin(angle)
    return np.stack([vx, vy], axis=-1)


def find_peaks(t: Array, tip: Array, velocity: Array, blocked: Array | None = None) -> Peaks:
    """Find the peaks of the tip's speed in samples at evenly spaced times t (T,), s.

    `tip`, m, and `velocity`, m/s, are (M, T, 2), NaN if a run failed; `blocked` (M, T), m, as of :class:`Peaks`, by
    default 0.
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
    highest = np.maximum.accumulate(tops, axis=1)[row, at]
    until = np.zeros(at.size) if blocked is None else blocked[row, at + 1]
    whole = np.isfinite(place).all(axis=1) & np.isfinite(v).all(axis=1)
    return Peaks(*(each[whole] for each in (row, t[at + 1] + step * part, place, v, speed, highest, until)))


def peak_costs(target: TipTarget, peaks: Peaks) -> Array:
    """Cost of peaks (P,), m: distance from the target, and more if direction or speed are not as asked.

    A peak after a higher one costs more, so does a late one, and one before which the rope passes through an obstacle.
    """
    return np.asarray(
        np.hypot(*(peaks.place - target.point).T)
        + ANGLE_COST * np.maximum(np.abs(target.angle_error(peaks.velocity)) - target.allowed_angle(ANGLE_MARGIN), 0.0)
        + SPEED_COST * np.maximum(1.0 - peaks.speed / (SPEED_MARGIN * target.least_speed), 0.0)
        + EARLIER_COST * (1.0 - peaks.speed / np.maximum(peaks.highest, 1e-9))
        + TIME_COST * peaks.t
        + BLOCKED_COST * peaks.blocked
    )


def cheapest_peaks(cost: Array, row: npt.NDArray[np.int64], count: int) -> npt.NDArray[np.int64]:
    """Number of the cheapest peak of each of `count` swings (count,); -1 for a swing without a peak."""
    result = np.full(count, -1, dtype=np.int64)
    for k in np.argsort(-cost):
        result[row[k]] = k
    return result
