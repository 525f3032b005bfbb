"""Limits of the motor that turns an arm, for plans and for the goals of a drive."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.options import check, option


@dataclass(frozen=True)
class MotorLimits:
    """Limits of the motor for a plan. The defaults allow the paper's half turn in 0.73 s (bang-bang).

    Parameters
    ----------
    speed : float
        Greatest speed of the arm, rad/s.
    acceleration : float
        Greatest acceleration of the arm, rad/s^2.
    torque : float
        Greatest torque at the shaft, N m; inf for no limit.
    angles : (float, float)
        Least and greatest arm angle, rad; 0 hangs down, pi/2 points along +x.

    Raises
    ------
    InvalidInput
        If a limit is not positive, or the angles are less than 0.1 rad apart.

    Examples
    --------
    >>> times, ramps = MotorLimits(speed=5.0, acceleration=20.0).fastest_moves([1.0, 3.0])
    >>> times.round(3).tolist(), ramps.round(3).tolist()
    ([0.447, 0.85], [0.5, 0.294])
    """

    speed: float = option(2.0 * math.pi / 0.73, "Greatest speed of the arm.", "rad/s", sign="positive")
    acceleration: float = option(
        4.0 * math.pi / 0.73**2, "Greatest acceleration of the arm.", "rad/s^2", sign="positive"
    )
    torque: float = option(
        math.inf, "Greatest torque at the shaft.", "N m", sign="positive", infinite=True, shown="not limited"
    )
    angles: tuple[float, float] = option((-math.pi, math.pi), "Least and greatest arm angle; 0 hangs down.", "rad")

    def __post_init__(self) -> None:
        check(self, "motor")
        least, greatest = self.angles
        checks.meant("motor angles", self.angles, "rad")
        if greatest - least < 0.1:
            allowed = "(least, greatest), 0.1 rad apart"
            raise InvalidInput("motor angles leave no room to move", got=[least, greatest], allowed=allowed)

    def start_angle(self, side: int) -> float:
        """Return the arm angle at t = 0, rad: a quarter turn to `side` (-1: left), clipped to the motor's range."""
        return float(np.clip(side * 0.5 * np.pi, *self.angles))

    def fastest_moves(self, angles: ArrayLike, speed: ArrayLike = 1.0) -> tuple[Array, Array]:
        """Return duration (k,), s, and ramp (k,) of the fastest moves, as :func:`hyperflex.arm_moves` takes them.

        `angles` (k,) are the angles to move through, rad, not 0. `speed`, a number or (k,), is the usable fraction of
        the motor's speed, 0 to 1; the usable fraction of its acceleration is the square of `speed`. A ramp of 0.5 does
        not reach the greatest speed.
        """
        way, part = np.abs(np.asarray(angles, dtype=np.float64)), np.asarray(speed, dtype=np.float64)
        top, rise = part * self.speed, part**2 * self.acceleration
        short = way * rise <= top**2
        durations = np.where(short, 2.0 * np.sqrt(way / rise), way / top + top / rise)
        return durations, np.where(short, 0.5, np.minimum(0.5, top / rise / durations))
