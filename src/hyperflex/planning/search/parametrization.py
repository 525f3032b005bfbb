"""Throws as points of the space that the search moves in: numbers of about one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import swing_period
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.wind.throw import Throw

STROKE, LAST = 0.95 * np.pi, 4  # rad, stroke that a search starts from; numbers of the last move
MOST = 2  # strokes after the strike
KEEPING_STEP = 0.54  # part of a period, from stroke to stroke, that keeps step with a swing
SPREAD, END_SPREAD = 0.15, 0.5  # of strokes and rests, and of the last move, at the start of a search


@dataclass(frozen=True)
class Genes:
    """How points (2 k + 4,) stand for throws of a thrower with k strokes.

    The first k are strokes in half turns, the next k rests in periods of a swing, the last four what comes after the
    strike: strokes that are still made (the whole part of it, up to MOST), then a last move: its end in half turns, the
    rest before it in periods, and its speed as part of the motor's.
    """

    thrower: Thrower
    side: int

    @property
    def strokes(self) -> int:
        """Strokes that the time allows, at least one."""
        rhythm = self.stroke_time + self.rest
        return max(1, int(np.ceil(self.thrower.time / rhythm)) + 1)

    @property
    def period(self) -> float:
        """Period of a small swing, s."""
        return swing_period(self.thrower.rope)

    @property
    def stroke_time(self) -> float:
        """Time of the usual stroke, s."""
        return float(self.thrower.limits.fastest([self._usual_stroke])[0][0])

    @property
    def rest(self) -> float:
        """Usual rest, s."""
        return max(0.02 * self.period, KEEPING_STEP * self.period - self.stroke_time)

    @property
    def _usual_stroke(self) -> float:
        least, greatest = self.thrower.limits.angles
        return min(STROKE, greatest - least)

    def centre(self) -> Array:
        """Point that a search starts from: steady pumping, the last move to hanging down."""
        k = self.strokes
        return np.concatenate(
            [np.full(k, self._usual_stroke / np.pi), np.full(k, self.rest / self.period), [0.5, 0.0, 0.05, 0.9]]
        )

    def point(self, strokes: Sequence[float], rests: Sequence[float], rest: float) -> Array:
        """Return the point that begins with given strokes, rad, and rests, s, and after a rest, s, goes on as usual."""
        x, k = self.centre(), min(self.strokes, len(strokes))
        x[:k] = np.array(strokes[:k]) / np.pi
        x[self.strokes : self.strokes + k] = np.array(rests[:k]) / self.period
        if k < self.strokes:
            x[self.strokes + k] = rest / self.period
        return x

    def spreads(self) -> Array:
        """Standard deviations (2 k + 4,) at the start of a search."""
        return np.concatenate([np.full(2 * self.strokes, SPREAD), [0.5, END_SPREAD, 0.1, 0.2]])

    def throw(self, x: Array) -> Throw:
        """Return the throw that a point stands for, with all its strokes."""
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
            int(np.clip(np.floor(more), 0, MOST)),
        )
