"""A throw: strokes of the arm to and fro, and a last move that winds or holds; what the search varies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.motion import Motion, moves
from hyperflex.planning.motor_limits import MotorLimits

LEAST_STROKE = 0.05  # rad
LEAST_REST = 1e-4  # s; a shorter one is none
SLOWEST = 0.3  # part of the motor's speed


@dataclass(frozen=True, eq=False)
class Throw:
    """Strokes with rests before them, and a last move.

    Attributes
    ----------
    side : {-1, 1}
        Whether the arm starts on the left or on the right; the strokes go to and fro from there.
    strokes : (k,) float64
        Angles to turn through, rad, > 0; cut at the motor's least and greatest angle.
    rests : (k,) float64
        Rest before each stroke, s.
    end : float
        Arm angle after the last move, rad.
    rest : float
        Rest before the last move, s.
    speed : float
        Part of the motor's speed with which the last move is made.
    count : int
        Strokes that are made before the last move; the others are left out.
    more : int
        Strokes that are made after the strike on the target, if the throw is cut there.
    """

    side: int
    strokes: Array
    rests: Array
    end: float
    rest: float
    speed: float
    count: int
    more: int = 0

    def angles(self, limits: MotorLimits) -> Array:
        """Arm angles (count + 2,) at the start and after each move, rad."""
        least, greatest = limits.angles
        angles = [limits.start(self.side)]
        sense = -self.side
        for stroke in self.strokes[: self.count]:
            target = float(np.clip(angles[-1] + sense * max(float(stroke), LEAST_STROKE), least, greatest))
            if abs(target - angles[-1]) < LEAST_STROKE:
                target = angles[-1] + (LEAST_STROKE if angles[-1] < 0.5 * (least + greatest) else -LEAST_STROKE)
            angles.append(target)
            sense = -sense
        end = float(np.clip(self.end, least, greatest))
        if abs(end - angles[-1]) < LEAST_STROKE:
            end = angles[-1] + (LEAST_STROKE if angles[-1] < 0.5 * (least + greatest) else -LEAST_STROKE)
        return np.array([*angles, end])

    def motion(self, limits: MotorLimits) -> Motion:
        """Return what the arm does."""
        angles, rests, durations, ramps = self._moves(limits)
        return moves(angles, rests, durations, ramps)

    def starts(self, limits: MotorLimits) -> Array:
        """When each move starts, the last one too (count + 1,), s."""
        _, rests, durations, _ = self._moves(limits)
        return np.asarray(np.cumsum(rests) + np.cumsum(durations) - durations)

    def stops(self, limits: MotorLimits) -> float:
        """When the arm stops, s."""
        _, rests, durations, _ = self._moves(limits)
        return float(rests.sum() + durations.sum())

    def cut(self, t: float, limits: MotorLimits) -> Throw:
        """Return the throw without the strokes that start after time t, s, but for `more`; the last move waits until t.

        Thus what the arm does until t is the same, and the last move answers to what happens then.
        """
        begun = int((self.starts(limits)[:-1] < t).sum())
        shorter = replace(self, count=min(max(1, begun) + self.more, self.count), more=0)
        ready = float(shorter.starts(limits)[-1]) - abs(self.rest)
        return replace(shorter, rest=abs(self.rest) + max(0.0, t - ready))

    def _moves(self, limits: MotorLimits) -> tuple[Array, Array, Array, Array]:
        angles = self.angles(limits)
        speed = np.append(np.ones(self.count), np.clip(self.speed, SLOWEST, 1.0))
        durations, ramps = limits.fastest(np.diff(angles), speed)
        rests = np.append(np.abs(self.rests[: self.count]), abs(self.rest))
        return angles, np.where(rests < LEAST_REST, 0.0, rests), durations, ramps
