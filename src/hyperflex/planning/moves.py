"""Moves of the arm: strokes to and fro, each after a rest, as fast as the motor allows or slower."""

from dataclasses import dataclass, field, replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import MotorLimits
from hyperflex.motion import Motion, arm_moves

MIN_MOVE = 0.05  # rad: shorter moves are made so long, so that each has a direction
MIN_REST = 1e-3  # s; there is always a rest, so that it can vary
PUMPING = 0.54  # periods from stroke to stroke that keep step with a swing


@dataclass(frozen=True, eq=False)
class Moves:
    """Moves of the arm, each after a rest, from an arm that points to one side.

    Attributes
    ----------
    side : {-1, 1}
        Whether the arm starts on the left or on the right.
    ends : (k,) float64
        Arm angle after each move, rad; clipped to the motor's range.
    rests : (k,) float64
        Rest before each move, s; at least MIN_REST.
    speeds : (k,) float64, optional
        Fraction of the motor's speed that each move uses, and the square of that of its acceleration; by default all.
    dwell : float
        Rest after the last move, s, with which the motion ends: a wound rope comes to rest meanwhile.
    """

    side: int
    ends: Array
    rests: Array
    speeds: Array = field(default_factory=lambda: np.ones(0))
    dwell: float = 0.0

    def __post_init__(self) -> None:
        if not self.speeds.size:
            object.__setattr__(self, "speeds", np.ones(self.ends.size))

    @property
    def parameters(self) -> Array:
        """Parameters (2 k,): the ends, rad, then the rests, s."""
        return np.concatenate([self.ends, self.rests])

    def angles(self, limits: MotorLimits) -> Array:
        """Return the arm angles at the start and after each move (k + 1,), rad."""
        least, greatest = limits.angles
        angles = [limits.start_angle(self.side)]
        for end in np.clip(self.ends, least, greatest):
            way = end - angles[-1]
            if abs(way) < MIN_MOVE:
                up = way >= 0.0 if least < angles[-1] + np.copysign(MIN_MOVE, way) < greatest else way < 0.0
                end = angles[-1] + (MIN_MOVE if up else -MIN_MOVE)
            angles.append(float(end))
        return np.array(angles)

    def timing(self, limits: MotorLimits) -> tuple[Array, Array, Array]:
        """Return the rest before each move, s, its duration, s, and the fraction of that which speeds up, (k,) each."""
        ways = np.diff(self.angles(limits))
        return np.maximum(self.rests, MIN_REST), *limits.fastest_moves(ways, self.speeds)

    def motion(self, limits: MotorLimits, since: float = 0.0) -> Motion:
        """Return the motion of the arm from a time on, s, at which its own time begins; it stays where it ends."""
        rests, durations, ramps = self.timing(limits)
        stops: Array = np.append(0.0, np.cumsum(rests + durations))
        made = min(int((stops <= since).sum()), rests.size) - 1  # moves that have ended; one is left
        angles = self.angles(limits)[made:]
        waits = [self.dwell] if self.dwell else []
        whole = arm_moves(angles, [*rests[made:], *waits], durations[made:], ramps[made:])
        return whole.shifted(float(stops[made]) - since) if since else whole

    def starts(self, limits: MotorLimits) -> Array:
        """Return the start of each move (k,), s."""
        rests, durations, _ = self.timing(limits)
        return np.cumsum(rests) + np.cumsum(durations) - durations

    def stops(self, limits: MotorLimits) -> float:
        """Return the time at which the arm stops, s."""
        rests, durations, _ = self.timing(limits)
        return float(rests.sum() + durations.sum())

    def cut(self, t: float, limits: MotorLimits) -> "Moves":
        """Return the moves that start before time t, s, at least one."""
        count = max(1, int((self.starts(limits) < t).sum()))
        return self.first(count)

    def first(self, count: int) -> "Moves":
        """Return the first moves, `count` of them."""
        return Moves(self.side, self.ends[:count], self.rests[:count], self.speeds[:count])

    def begins_with(self, others: "Moves") -> bool:
        """Whether the first moves are the same as all of some others."""
        count = others.ends.size
        mine, same = self.first(count), self.side == others.side and self.ends.size >= count
        return same and np.array_equal([*mine.parameters, *mine.speeds], [*others.parameters, *others.speeds])

    def then(self, end: float, rest: float, speed: float = 1.0) -> "Moves":
        """Return the same moves and one more to arm angle `end`, rad, after a rest, s, at a fraction of full speed."""
        ends, rests, speeds = np.append(self.ends, end), np.append(self.rests, rest), np.append(self.speeds, speed)
        return replace(self, ends=ends, rests=rests, speeds=speeds, dwell=0.0)

    def waiting(self, more: float) -> "Moves":
        """Return the same moves with so much longer a dwell, s."""
        return replace(self, dwell=self.dwell + more)

    def varied(self, change: Array) -> "Moves":
        """Return moves whose `parameters` differ by `change` (2 k,)."""
        ends, rests = np.split(self.parameters + change, 2)
        return replace(self, ends=ends, rests=rests)
