"""Strokes of the arm from angle to angle: what a whip is made of, and how its motion changes with each number of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.motion import Motion, moves
from hyperflex.motion.variation import variation
from hyperflex.planning.motor_limits import MotorLimits

LEAST_WAY = 0.05  # rad of a stroke
LEAST_REST = 1e-3  # s; there is always one, so that it can vary


@dataclass(frozen=True, eq=False)
class Strokes:
    """Strokes at the motor's full speed, each after a rest, from an arm that points to one side.

    Attributes
    ----------
    side : {-1, 1}
        Whether the arm starts on the left or on the right.
    ends : (k,) float64
        Arm angle after each stroke, rad; cut at the motor's least and greatest angle.
    rests : (k,) float64
        Rest before each stroke, s; at least LEAST_REST.
    """

    side: int
    ends: Array
    rests: Array

    @property
    def numbers(self) -> Array:
        """What may vary (2 k,): the ends, rad, then the rests, s."""
        return np.concatenate([self.ends, self.rests])

    def angles(self, limits: MotorLimits) -> Array:
        """Arm angles at the start and after each stroke (k + 1,), rad."""
        least, greatest = limits.angles
        angles = [limits.start(self.side)]
        for end in np.clip(self.ends, least, greatest):
            way = end - angles[-1]
            if abs(way) < LEAST_WAY:
                up = way >= 0.0 if least < angles[-1] + np.copysign(LEAST_WAY, way) < greatest else way < 0.0
                end = angles[-1] + (LEAST_WAY if up else -LEAST_WAY)
            angles.append(float(end))
        return np.array(angles)

    def motion(self, limits: MotorLimits) -> Motion:
        """Return what the arm does; it stays where the last stroke ends."""
        angles = self.angles(limits)
        durations, ramps = limits.fastest(np.diff(angles))
        return moves(angles, np.maximum(self.rests, LEAST_REST), durations, ramps)

    def starts(self, limits: MotorLimits) -> Array:
        """When each stroke starts (k,), s."""
        durations, _ = limits.fastest(np.diff(self.angles(limits)))
        return np.asarray(np.cumsum(np.maximum(self.rests, LEAST_REST)) + np.cumsum(durations) - durations)

    def cut(self, t: float, limits: MotorLimits) -> Strokes:
        """Return the strokes that start before time t, s, at least one."""
        count = max(1, int((self.starts(limits) < t).sum()))
        return Strokes(self.side, self.ends[:count], self.rests[:count])

    def varied(self, change: Array) -> Strokes:
        """Return strokes whose `numbers` differ by `change` (2 k,)."""
        ends, rests = np.split(self.numbers + change, 2)
        return Strokes(self.side, ends, rests)

    def variations(self, limits: MotorLimits) -> list[dict[str, Array]]:
        """How breaks and coefficients of the motion change with each of `numbers`: a list of 2 k.

        Those of an end beyond the motor's angles, or of a rest that is as short as may be, are 0.
        """
        motion, angles = self.motion(limits), self.angles(limits)
        ways = np.diff(angles)
        count, top = ways.size, limits.speed
        durations, ramps = limits.fastest(ways)
        full = ramps < 0.5
        by_way = np.where(full, 1.0 / top, 0.5 * durations / np.abs(ways)) * np.sign(ways)
        shorter = np.where(full, -ramps / durations * by_way, 0.0)

        def of(name: str) -> tuple[Array, Array]:
            return variation(motion, name)

        # of each way alone: the time that it takes, and the part of it that speeds up
        timing = []
        for k in range(count):
            breaks, coef = (by_way[k] * part for part in of(f"durations[{k}]"))
            if full[k]:
                more = of(f"ramps[{k}]")
                breaks, coef = breaks + shorter[k] * more[0], coef + shorter[k] * more[1]
            timing.append((breaks, coef))
        found = []
        for k in range(count):
            breaks, coef = of(f"angles[{k + 1}]")
            breaks, coef = breaks + timing[k][0], coef + timing[k][1]
            if k + 1 < count:
                breaks, coef = breaks - timing[k + 1][0], coef - timing[k + 1][1]
            free = float(abs(self.ends[k] - angles[k + 1]) < 1e-12)
            found.append({"breaks": free * breaks, "coef": free * coef})
        for k in range(count):
            breaks, coef = of(f"rests[{k}]")
            free = float(self.rests[k] > LEAST_REST)
            found.append({"breaks": free * breaks, "coef": free * coef})
        return found
