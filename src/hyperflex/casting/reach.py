"""Whether a target can be wound at all: length left, hold and energy, told before any search."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hyperflex import checks
from hyperflex.casting.thrower import Thrower
from hyperflex.model import Peg

GAIN = 0.35  # rad
ENERGY = 0.3


@dataclass(frozen=True)
class Reach:
    """What can be said of a target before a search."""

    turns: float
    energy: float
    hold: float
    impossible: bool
    reason: str

    @property
    def within(self) -> bool:
        """Whether the target is in reach."""
        return not self.reason


def reach(thrower: Thrower, peg: Peg, *, hold: float = 0.0) -> Reach:
    """Placeholder, to be calibrated."""
    rope, arm = thrower.rope, thrower.arm
    asked = checks.number("hold", hold, sign="nonnegative", unit="N")
    far = math.hypot(peg.x - arm.pivot[0], peg.y - arm.pivot[1])
    axis = peg.radius + rope.radius
    left = rope.total_length + arm.length - (far - axis)
    if left <= 0.0:
        return Reach(0.0, 0.0, 0.0, True, f"out of reach: the rope ends {-left:.2f} m short of the target")
    if far - peg.radius <= arm.length:
        return Reach(0.0, 0.0, 0.0, True, "out of reach: the arm would strike the target")
    return Reach(left / (2 * math.pi * axis), 1.0, asked, False, "")
