"""Moves of the arm, a throw (strokes to and fro, then a last move) and the parameters by which a search varies it."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hyperflex.checks import Array
from hyperflex.motion import Motion, arm_moves
from hyperflex.planning.options import MotorLimits
from hyperflex.planning.problem import Problem

MIN_STROKE = 0.05  # rad
MIN_REST = 1e-4  # s; shorter rests are left out
MIN_SPEED = 0.3  # fraction of the motor's speed
STROKE = 0.95 * np.pi  # rad, initial stroke of a search
LAST = 4  # parameters of the last move
MAX_MORE = 2  # strokes after the strike
KEEPING_STEP = 0.54  # periods from stroke to stroke that keep step with a swing
SPREAD, END_SPREAD = 0.15, 0.5  # initial standard deviations: strokes and rests; end of the last move


class Moves(ABC):
    """Moves of the arm, each after a rest, from an arm that points to one side. `limits` are those of the motor."""

    side: int

    @abstractmethod
    def angles(self, limits: MotorLimits) -> Array:
        """Arm angles (k + 1,) at the start and after each of k moves, rad."""

    @abstractmethod
    def timing(self, limits: MotorLimits) -> tuple[Array, Array, Array]:
        """Rest before each move, s, its duration, s, and the fraction of that which speeds up, (k,) each."""

    def motion(self, limits: MotorLimits) -> Motion:
        """Return the motion of the arm; it stays where the last move ends."""
        return arm_moves(self.angles(limits), *self.timing(limits))

    def starts(self, limits: MotorLimits) -> Array:
        """Start of each move (k,), s."""
        rests, durations, _ = self.timing(limits)
        return np.asarray(np.cumsum(rests) + np.cumsum(durations) - durations)

    def stops(self, limits: MotorLimits) -> float:
        """Time at which the arm stops, s."""
        rests, durations, _ = self.timing(limits)
        return float(rests.sum() + durations.sum())


# Last moves: strokes still made after the strike, the move's end, in half turns towards the target's side, and the
# rest before it, in periods, in which a short tail comes to rest before it must hold. Of 461 swings that struck 43
# targets 100 wound soundly with any of fifteen moves without a rest: 53 with the first, 63 with the first two and 95
# with all eight of these. Which swings wind hardly depends on their scores
LONG_REST = 2.0
MOVES = (
    ((2.5, 0.5, 0.0), (0.5, 1.0, 0.0)),
    ((0.5, 0.5, 0.0), (0.5, 0.5, LONG_REST)),
    ((1.5, 0.5, 0.0), (0.5, -0.5, LONG_REST)),
    ((2.5, 1.0, 0.0), (0.5, -1.0, 0.0)),
    ((0.5, 1.0, LONG_REST), (0.5, -1.0, LONG_REST)),
    ((2.5, -0.5, 0.0), (1.5, -0.5, 0.0)),
)


@dataclass(frozen=True, eq=False)
class Throw(Moves):
    """Strokes with rests before them, and a last move.

    Attributes
    ----------
    side : {-1, 1}
        Whether the arm starts on the left or on the right; the strokes go to and fro from there.
    strokes : (k,) float64
        Angles to turn through, rad, > 0; clipped to the motor's range.
    rests : (k,) float64
        Rest before each stroke, s.
    end : float
        Arm angle after the last move, rad.
    rest : float
        Rest before the last move, s.
    speed : float
        Fraction of the motor's speed that the last move uses.
    count : int
        Strokes before the last move; the others are left out.
    more : int
        Strokes made after the strike on the target, if the throw is cut there.
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
        """Arm angles (count + 2,) at the start and after each stroke and the last move, rad."""
        least, greatest = limits.angles
        angles = [limits.start_angle(self.side)]

        def move_to(target: float) -> None:
            target = float(np.clip(target, least, greatest))
            if abs(target - angles[-1]) < MIN_STROKE:
                target = angles[-1] + (MIN_STROKE if angles[-1] < 0.5 * (least + greatest) else -MIN_STROKE)
            angles.append(target)

        sense = -self.side
        for stroke in self.strokes[: self.count]:
            move_to(angles[-1] + sense * max(float(stroke), MIN_STROKE))
            sense = -sense
        move_to(self.end)
        return np.array(angles)

    def cut(self, t: float, limits: MotorLimits) -> "Throw":
        """Return the throw without the strokes that start after time t, s, except `more`; the last move waits until t.

        The arm moves as before until t, so a strike at t is the same one, and the last move comes after it.
        """
        begun = int((self.starts(limits)[:-1] < t).sum())
        shorter = replace(self, count=min(max(1, begun) + self.more, self.count), more=0)
        ready = float(shorter.starts(limits)[-1]) - abs(self.rest)
        return replace(shorter, rest=abs(self.rest) + max(0.0, t - ready))

    def timing(self, limits: MotorLimits) -> tuple[Array, Array, Array]:
        """Rest, s, duration, s, and ramp of each stroke and of the last move, (count + 1,) each."""
        speed = np.append(np.ones(self.count), np.clip(self.speed, MIN_SPEED, 1.0))
        rests = np.append(np.abs(self.rests[: self.count]), abs(self.rest))
        return np.where(rests < MIN_REST, 0.0, rests), *limits.fastest_moves(np.diff(self.angles(limits)), speed)


@dataclass(frozen=True)
class ThrowParametrization:
    """Throws with k strokes as points x (2 k + 4,) whose entries are of order one.

    The first k entries are strokes in half turns, the next k rests in swing periods. The last four are: strokes after
    the strike (integer part, up to MAX_MORE); then of the last move its end in half turns, the rest before it in
    periods, and its speed as a fraction of the motor's.

    The arm starts on a side, -1 or 1.
    """

    problem: Problem
    side: int

    @cached_property
    def strokes(self) -> int:
        """Number of strokes k that the time allows, at least one."""
        return max(1, int(np.ceil(self.problem.time / (self.stroke_time + self.rest))) + 1)

    @property
    def period(self) -> float:
        """Period of a small swing, s."""
        return self.problem.period

    @cached_property
    def stroke_time(self) -> float:
        """Duration of the initial stroke, s."""
        return float(self.problem.limits.fastest_moves([self._initial_stroke])[0][0])

    @cached_property
    def rest(self) -> float:
        """Initial rest, s."""
        return max(0.02 * self.period, KEEPING_STEP * self.period - self.stroke_time)

    @cached_property
    def _initial_stroke(self) -> float:
        least, greatest = self.problem.limits.angles
        return min(STROKE, greatest - least)

    def centre(self) -> Array:
        """Initial point of a search (2 k + 4,): steady pumping, the last move to hanging down."""
        k = self.strokes
        return np.concatenate(
            [np.full(k, self._initial_stroke / np.pi), np.full(k, self.rest / self.period), [0.5, 0.0, 0.05, 0.9]]
        )

    def point(self, strokes: Sequence[float], rests: Sequence[float], rest: float) -> Array:
        """Return the initial point with its first strokes, rad, and rests, s, replaced; the next rest is `rest`, s."""
        x, k = self.centre(), min(self.strokes, len(strokes))
        x[:k] = np.array(strokes[:k]) / np.pi
        x[self.strokes : self.strokes + k] = np.array(rests[:k]) / self.period
        if k < self.strokes:
            x[self.strokes + k] = rest / self.period
        return x

    def repeated(self, throw: Throw) -> Array:
        """Return the initial point (2 k + 4,) with the strokes of a throw; the next one comes a period later."""
        return self.point(throw.strokes[: throw.count].tolist(), throw.rests[: throw.count].tolist(), self.period)

    def spreads(self) -> Array:
        """Initial standard deviations of a search (2 k + 4,)."""
        return np.concatenate([np.full(2 * self.strokes, SPREAD), [0.5, END_SPREAD, 0.1, 0.2]])

    def throw(self, x: Array) -> Throw:
        """Return the throw of a point (2 k + 4,), with all its strokes."""
        k = self.strokes
        more, end, rest, speed = (float(value) for value in x[2 * k :])
        return Throw(
            self.side,
            np.pi * np.minimum(np.abs(x[:k]), 1.0),
            self.period * np.abs(x[k : 2 * k]),
            np.pi * end,
            self.period * abs(rest),
            min(abs(speed), 1.0),
            k,
            int(np.clip(np.floor(more), 0, MAX_MORE)),
        )
