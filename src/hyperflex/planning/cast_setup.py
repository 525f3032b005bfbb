"""Who throws: a rope on an arm, the motor's limits, and the time that a cast may take."""

from __future__ import annotations

from dataclasses import dataclass

from hyperflex import checks
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Rope
from hyperflex.planning.motor_limits import MotorLimits

PERIODS = 5.0  # periods of a small swing that a cast may take by default
LEAST_LINKS, LEAST_TIME = 4, 0.1  # links, s


@dataclass(frozen=True)
class Thrower:
    """A rope on an arm, as a planner knows them.

    Parameters
    ----------
    rope, arm : Rope, Arm
    limits : MotorLimits
    time : float
        Within which the rope must strike, s, at least LEAST_TIME; by default, and with 0, PERIODS periods of the
        rope's swing.
    """

    rope: Rope
    arm: Arm
    limits: MotorLimits
    time: float = 0.0

    def __post_init__(self) -> None:
        for name, kind in (("rope", Rope), ("arm", Arm), ("limits", MotorLimits)):
            if not isinstance(getattr(self, name), kind):
                raise InvalidInput(f"{name} is not of its class", got=getattr(self, name), allowed=kind.__name__)
        if self.rope.n_links < LEAST_LINKS:
            raise InvalidInput(
                "rope has too few links to wind round anything",
                got=self.rope.n_links,
                allowed=f"at least {LEAST_LINKS}; 25 to 60 are usual",
                fix="Give the rope more, shorter links",
            )
        time = checks.number("time", self.time, sign="nonnegative", unit="s")
        if 0.0 < time < LEAST_TIME:
            raise InvalidInput("time is too short for any cast", got=time, allowed=f"{LEAST_TIME:g} s or more, or 0")
        object.__setattr__(self, "time", time or PERIODS * swing_period(self.rope))
