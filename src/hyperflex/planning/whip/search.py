"""The search for a whip: a coarse map of where free swings peak, and CMA-ES from its nearest peaks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.search.evolution import evolution
from hyperflex.planning.whip.strokes import Strokes
from hyperflex.planning.whip.tip_target import NEVER, SAMPLE_TIME, Mark, Peaks, cheapest, costs, peaks, swung

SWINGS, SEED = 512, 1  # of a map
STROKES, STEPS = (0.3, 1.1), (0.35, 0.65)  # half turns; periods from stroke to stroke: what a map's swings begin with
SPREAD_ENDS, SPREAD_RESTS = 0.15, 0.06  # half turns, periods: how its strokes differ from each other
MEMBERS = 16  # of a generation
LEAST_TIME = 2.0 * SAMPLE_TIME  # s; a peak is seen between three looks
NARROW = 0.3  # spread of a search about a peak of the map, in parts of that of the map's swings
APART = 0.1  # half turns or periods by which swings differ if a search shall start from both


class Found(NamedTuple):
    """A whip that was found, its cost, m, and when its peak is, s."""

    cost: float
    t: float
    strokes: Strokes


@dataclass(frozen=True, eq=False)
class WhipMap:
    """Peaks of the tip's speed in random swings of a thrower: what is reachable, roughly.

    Attributes
    ----------
    thrower : Thrower
    strokes : tuple of Strokes
        Its swings.
    peaks : Peaks
    """

    thrower: Thrower
    strokes: tuple[Strokes, ...]
    peaks: Peaks

    def nearest(self, mark: Mark) -> list[Found]:
        """Return the best peak of each swing for a target, the cheapest first."""
        cost = costs(mark, self.peaks)
        best = cheapest(cost, self.peaks.row, len(self.strokes))
        found = [Found(float(cost[k]), float(self.peaks.t[k]), self.strokes[self.peaks.row[k]]) for k in best if k >= 0]
        return sorted(found, key=lambda one: one.cost)


def times(thrower: Thrower) -> Array:
    """When a search looks at a swing (T,), s."""
    return np.asarray(SAMPLE_TIME * np.arange(round(thrower.time / SAMPLE_TIME) + 1.0))


def whip_map(thrower: Thrower, swings: int = SWINGS, threads: int | None = None) -> WhipMap:
    """Swing a rope `swings` times, at random but always in the same way, and note the peaks of its tip's speed.

    Raises
    ------
    InvalidInput
        If the time within which the tip must be there is too short to look at any swing.
    KeyboardInterrupt
        If Ctrl-C comes meanwhile; part of a map is of no use.
    """
    if thrower.time < LEAST_TIME:
        raise InvalidInput(
            "time_limit is too short for any whip",
            got=thrower.time,
            allowed=f"at least {LEAST_TIME:g} s; three periods of the rope's swing are usual",
        )
    rng, limits, period = np.random.default_rng(SEED), thrower.limits, swing_period(thrower.rope)
    strokes = []
    for number in range(swings):
        side = 1 if number % 2 else -1
        stroke, step = np.pi * rng.uniform(*STROKES), period * rng.uniform(*STEPS)
        rest = max(0.0, step - float(limits.fastest([stroke])[0][0]))
        count = max(1, int(np.ceil(thrower.time / step)))
        ends = 0.5 * side * np.pi - side * stroke * (np.arange(count) % 2 == 0)
        ends = ends + np.pi * SPREAD_ENDS * rng.standard_normal(count)
        rests = np.abs(rest + period * SPREAD_RESTS * rng.standard_normal(count))
        strokes.append(Strokes(side, ends, rests))
    t = times(thrower)
    runs = swung(thrower, [each.motion(limits) for each in strokes], t, threads=threads)
    return WhipMap(thrower, tuple(strokes), peaks(t, *runs))


class WhipSearch:
    """CMA-ES on the strokes of a swing, about one that nearly meets a target.

    Parameters
    ----------
    thrower : Thrower
    mark : Mark
    begin : Found
        Where to start.
    seed : int
    threads : int, optional
    """

    def __init__(self, thrower: Thrower, mark: Mark, begin: Found, seed: int = 0, threads: int | None = None) -> None:
        self.thrower, self.mark, self.threads = thrower, mark, threads
        self.found, self.runs, self._side = begin, 0, begin.strokes.side
        k = begin.strokes.ends.size
        self._scale = np.repeat([np.pi, swing_period(thrower.rope)], k)
        spread = np.repeat([SPREAD_ENDS, SPREAD_RESTS], k)
        random = np.random.default_rng([SEED, seed])
        self._evolution = evolution(begin.strokes.numbers / self._scale, NARROW, spread, MEMBERS, random)

    def step(self) -> float:
        """One generation; returns the least cost so far, m."""
        points = self._evolution.ask()
        t, limits = times(self.thrower), self.thrower.limits
        strokes = [self._strokes(x) for x in points]
        seen = peaks(t, *swung(self.thrower, [each.motion(limits) for each in strokes], t, threads=self.threads))
        each = costs(self.mark, seen)
        best = cheapest(each, seen.row, len(points))
        cost = np.where(best >= 0, each[best], NEVER)
        self._evolution.tell(points, list(cost))
        self.runs += len(points)
        k = int(cost.argmin())
        if cost[k] < self.found.cost:
            self.found = Found(float(cost[k]), float(seen.t[best[k]]), strokes[k])
        return self.found.cost

    def _strokes(self, x: Array) -> Strokes:
        ends, rests = np.split(np.asarray(x, dtype=np.float64) * self._scale, 2)
        return Strokes(self._side, ends, np.abs(rests))
