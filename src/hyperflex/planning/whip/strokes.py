"""Strokes of the arm from angle to angle, and the derivatives of their motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.motion import Motion, arm_moves
from hyperflex.motion.variation import variation
from hyperflex.planning.cast_setup import MotorLimits

MIN_STROKE = 0.05  # rad
MIN_REST = 1e-3  # s; there is always one, so that it can vary


@dataclass(frozen=True, eq=False)
class Strokes:
    """Strokes at the motor's full speed, each after a rest, from an arm that points to one side.

    Attributes
    ----------
    side : {-1, 1}
        Whether the arm starts on the left or on the right.
    ends : (k,) float64
        Arm angle after each stroke, rad; clipped to the motor's range.
    rests : (k,) float64
        Rest before each stroke, s; at least MIN_REST.
    """

    side: int
    ends: Array
    rests: Array

    @property
    def parameters(self) -> Array:
        """Parameters (2 k,): the ends, rad, then the rests, s."""
        return np.concatenate([self.ends, self.rests])

    def angles(self, limits: MotorLimits) -> Array:
        """Arm angles at the start and after each stroke (k + 1,), rad."""
        least, greatest = limits.angles
        angles = [limits.start_angle(self.side)]
        for end in np.clip(self.ends, least, greatest):
            way = end - angles[-1]
            if abs(way) < MIN_STROKE:
                up = way >= 0.0 if least < angles[-1] + np.copysign(MIN_STROKE, way) < greatest else way < 0.0
                end = angles[-1] + (MIN_STROKE if up else -MIN_STROKE)
            angles.append(float(end))
        return np.array(angles)

    def motion(self, limits: MotorLimits) -> Motion:
        """Return the motion of the arm; it stays where the last stroke ends."""
        angles = self.angles(limits)
        durations, ramps = limits.fastest_moves(np.diff(angles))
        return arm_moves(angles, np.maximum(self.rests, MIN_REST), durations, ramps)

    def starts(self, limits: MotorLimits) -> Array:
        """Start of each stroke (k,), s."""
        durations, _ = limits.fastest_moves(np.diff(self.angles(limits)))
        return np.asarray(np.cumsum(np.maximum(self.rests, MIN_REST)) + np.cumsum(durations) - durations)

    def cut(self, t: float, limits: MotorLimits) -> Strokes:
        """Return the strokes that start before time t, s, at least one."""
        count = max(1, int((self.starts(limits) < t).sum()))
        return Strokes(self.side, self.ends[:count], self.rests[:count])

    def varied(self, change: Array) -> Strokes:
        """Return strokes whose `parameters` differ by `change` (2 k,)."""
        ends, rests = np.split(self.parameters + change, 2)
        return Strokes(self.side, ends, rests)

    def variations(self, limits: MotorLimits) -> list[dict[str, Array]]:
        """Return the derivatives of the motion's breaks and coefficients by each of `parameters`: a list of 2 k.

        Those by an end outside the motor's range, or by a rest of MIN_REST, are 0.
        """
        motion, angles = self.motion(limits), self.angles(limits)
        ways = np.diff(angles)
        count, top = ways.size, limits.speed
        durations, ramps = limits.fastest_moves(ways)
        full = ramps < 0.5
        by_way = np.where(full, 1.0 / top, 0.5 * durations / np.abs(ways)) * np.sign(ways)
        shorter = np.where(full, -ramps / durations * by_way, 0.0)

        def of(name: str) -> tuple[Array, Array]:
            return variation(motion, name)

        # by each stroke's size alone: its duration, and the fraction of that which speeds up
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
            free = float(self.rests[k] > MIN_REST)
            found.append({"breaks": free * breaks, "coef": free * coef})
        return found
