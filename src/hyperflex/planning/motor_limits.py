"""What the motor can do, and the shortest time in which it makes a move."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput


@dataclass(frozen=True)
class MotorLimits:
    """Limits that a cast keeps to; by default those of the paper's half turn in 0.73 s (bang-bang).

    Parameters
    ----------
    speed : float
        Greatest speed of the arm, rad/s.
    acceleration : float
        Greatest acceleration of the arm, rad/s^2.
    torque : float
        Greatest torque at the shaft, N m; inf if it does not matter.
    angles : (float, float)
        Least and greatest arm angle, rad; 0 hangs down.

    Raises
    ------
    InvalidInput
        If a limit is not positive, or the angles leave no room to move.

    Examples
    --------
    >>> times, ramps = MotorLimits(speed=5.0, acceleration=20.0).fastest([1.0, 3.0])
    >>> times.round(3).tolist(), ramps.round(3).tolist()
    ([0.447, 0.85], [0.5, 0.294])
    """

    speed: float = 2.0 * math.pi / 0.73
    acceleration: float = 4.0 * math.pi / 0.73**2
    torque: float = math.inf
    angles: tuple[float, float] = (-math.pi, math.pi)

    def __post_init__(self) -> None:
        for name, unit in (("speed", "rad/s"), ("acceleration", "rad/s^2")):
            value = checks.number(f"motor {name}", getattr(self, name), sign="positive", unit=unit)
            object.__setattr__(self, name, value)
        torque = checks.number("motor torque", self.torque, sign="positive", unit="N m", infinite=True)
        least, greatest = checks.array("motor angles", self.angles, (2,), unit="rad").tolist()
        if greatest - least < 0.1:
            raise InvalidInput(
                "motor angles leave no room to move", got=[least, greatest], allowed="(least, greatest), 0.1 rad apart"
            )
        object.__setattr__(self, "torque", torque)
        object.__setattr__(self, "angles", (least, greatest))

    def start(self, side: int) -> float:
        """Return the arm angle at which a cast begins, rad: a quarter turn, or what the motor's angles allow of it.

        Parameters
        ----------
        side : {-1, 1}
            Left or right.
        """
        return float(np.clip(side * 0.5 * np.pi, *self.angles))

    def fastest(self, ways: npt.ArrayLike, speed: npt.ArrayLike = 1.0) -> tuple[Array, Array]:
        """Return time and ramp of the fastest moves, as :func:`hyperflex.moves` takes them.

        Parameters
        ----------
        ways : (k,) array_like
            Angles to turn through, rad, other than 0.
        speed : float or (k,) array_like
            Part of the motor's speed that may be used, 0 to 1; of its acceleration the square of that.

        Returns
        -------
        durations : (k,) float64
            s.
        ramps : (k,) float64
            Part of the time for speeding up; 0.5 where the greatest speed is not reached.
        """
        way, part = np.abs(np.asarray(ways, dtype=np.float64)), np.asarray(speed, dtype=np.float64)
        top, rise = part * self.speed, part**2 * self.acceleration
        short = way * rise <= top**2
        durations = np.where(short, 2.0 * np.sqrt(way / rise), way / top + top / rise)
        return durations, np.where(short, 0.5, np.minimum(0.5, top / rise / durations))
