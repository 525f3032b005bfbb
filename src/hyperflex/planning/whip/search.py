"""The search for a whip: a map of the peaks of random swings, the feasibility check by it, and CMA-ES from a peak."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.search.evolution import CmaEs
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.whip.strokes import Strokes
from hyperflex.planning.whip.tip_target import (
    NEVER,
    Peaks,
    TipTarget,
    cheapest_peaks,
    find_peaks,
    peak_costs,
    tip_velocity,
)

SAMPLE_TIME, COARSE_TOL = 0.02, 1e-3  # s, m: of swings in a search
SWINGS, SEED = 512, 1  # of a map
TOGETHER = 64  # swings of a map between two looks at the time
STROKES, STEPS = (0.3, 1.1), (0.35, 0.65)  # half turns; periods from stroke to stroke: means of a map's swings
SPREAD_ENDS, SPREAD_RESTS = 0.15, 0.06  # half turns, periods: standard deviations in a swing of the map
MEMBERS = 16  # of a generation
MIN_TIME = 2.0 * SAMPLE_TIME  # s; a peak needs three samples
NARROW = 0.3  # step size of CMA-ES about a peak, relative to the map's standard deviations
MAX_COST = 0.12  # m, cost of the cheapest peak of the map up to which a target is feasible
AROUND = 0.25  # m, within which the highest speed is reported


class WhipCandidate(NamedTuple):
    """Strokes with their cost, m, and the time of their peak, s."""

    cost: float
    t: float
    strokes: Strokes


@dataclass(frozen=True, eq=False)
class WhipMap:
    """Peaks of the tip's speed in random swings: roughly what is feasible.

    Attributes
    ----------
    cast_setup : CastSetup
    strokes : tuple of Strokes
        Of each swing.
    peaks : Peaks
    """

    cast_setup: CastSetup
    strokes: tuple[Strokes, ...]
    peaks: Peaks

    def candidates(self, target: TipTarget) -> list[WhipCandidate]:
        """Return the cheapest peak of each swing for a `target`, the cheapest first."""
        cost, t = peak_costs(target, self.peaks), self.peaks.t
        best = cheapest_peaks(cost, self.peaks.row, len(self.strokes))
        found = [WhipCandidate(float(cost[k]), float(t[k]), self.strokes[self.peaks.row[k]]) for k in best if k >= 0]
        return sorted(found, key=lambda one: one.cost)


@dataclass(frozen=True)
class WhipFeasibility:
    """Result of the feasibility check of a target.

    `distance` is that from the arm's pivot, m. `cost`, m, is that of the cheapest peak of the map: its distance from
    the target, and more if its speed or direction are not as asked. `message` tells why the target is not feasible.
    """

    distance: float
    cost: float
    message: str

    @property
    def feasible(self) -> bool:
        """Whether the target is feasible."""
        return not self.message


def pivot_distance(cast_setup: CastSetup, target: TipTarget) -> float:
    """Distance of a target from the arm's pivot, m."""
    return math.hypot(target.x - cast_setup.arm.pivot[0], target.y - cast_setup.arm.pivot[1])


def check_whip_feasibility(whip_map: WhipMap, target: TipTarget) -> WhipFeasibility:
    """Check whether a target is close enough to a peak of a map."""
    cast_setup = whip_map.cast_setup
    distance = pivot_distance(cast_setup, target)
    short = distance - cast_setup.rope.total_length - cast_setup.arm.length
    if short > 0.0:
        return WhipFeasibility(distance, math.inf, f"out of reach: the rope ends {short:.2f} m short of the target")
    near = whip_map.candidates(target)
    cost = near[0].cost if near else math.inf
    if cost <= MAX_COST:
        return WhipFeasibility(distance, cost, "")
    fast = whip_map.peaks.speed[np.hypot(*(whip_map.peaks.place - target.point).T) < AROUND]
    message = (
        f"out of reach: the tip is not that fast so near to it, {fast.max():.1f} m/s at most, or not in that direction"
        if fast.size
        else "out of reach: the tip's speed has no peak so near to it"
    )
    return WhipFeasibility(distance, cost, message)


def simulate_peaks(cast_setup: CastSetup, strokes: list[Strokes], threads: int | None = None) -> Peaks:
    """Simulate free swings from rest and find the peaks of the tip's speed."""
    t = np.asarray(SAMPLE_TIME * np.arange(round(cast_setup.time / SAMPLE_TIME) + 1.0))
    motions = [each.motion(cast_setup.limits) for each in strokes]
    swings = RolloutBatch.from_start(cast_setup, [cast_setup.rope] * len(motions), [], motions)
    batch = swings.run(cast_setup.arm, t, tol=COARSE_TOL, keep=("tip", "q", "qd"), threads=threads)
    angle, rate = (np.stack(each) for each in zip(*((m.angle(t), m.rate(t)) for m in motions), strict=True))
    return find_peaks(t, batch.tip, tip_velocity(cast_setup, batch.q, batch.qd, angle, rate))


@interruptible()
def build_whip_map(
    cast_setup: CastSetup,
    swings: int = SWINGS,
    threads: int | None = None,
    *,
    left: Callable[[], float] = lambda: math.inf,
) -> WhipMap:
    """Simulate random swings, the same ones each time, and find the peaks of the tip's speed.

    Parameters
    ----------
    cast_setup : CastSetup
    swings : int
    threads : int, optional
        One a processor by default.
    left : callable
        Returns the time that is left, s; without any the map is of the first swings alone, TOGETHER at least.

    Raises
    ------
    InvalidInput
        If the time of the set-up is too short for a peak.
    """
    if cast_setup.time < MIN_TIME:
        raise InvalidInput(
            "time_limit is too short for any whip",
            got=cast_setup.time,
            allowed=f"at least {MIN_TIME:g} s; three periods of the rope's swing are usual",
        )
    rng, limits, period = np.random.default_rng(SEED), cast_setup.limits, swing_period(cast_setup.rope)
    strokes = []
    for number in range(swings):
        side = 1 if number % 2 else -1
        stroke, step = np.pi * rng.uniform(*STROKES), period * rng.uniform(*STEPS)
        rest = max(0.0, step - float(limits.fastest_moves([stroke])[0][0]))
        count = max(1, int(np.ceil(cast_setup.time / step)))
        ends = 0.5 * side * np.pi - side * stroke * (np.arange(count) % 2 == 0)
        ends = ends + np.pi * SPREAD_ENDS * rng.standard_normal(count)
        rests = np.abs(rest + period * SPREAD_RESTS * rng.standard_normal(count))
        strokes.append(Strokes(side, ends, rests))
    found: list[Peaks] = []
    for low in range(0, swings, TOGETHER):
        if found and left() < 0.0:
            strokes = strokes[:low]
            break
        some = simulate_peaks(cast_setup, strokes[low : low + TOGETHER], threads)
        found.append(some._replace(row=some.row + low))
    return WhipMap(cast_setup, tuple(strokes), Peaks(*map(np.concatenate, zip(*found, strict=True))))


class WhipSearch:
    """CMA-ES over strokes, about a swing that nearly meets a target; keeps the best and counts the runs."""

    def __init__(
        self, cast_setup: CastSetup, target: TipTarget, begin: WhipCandidate, seed: int = 0, threads: int | None = None
    ) -> None:
        self.cast_setup, self.target, self.threads = cast_setup, target, threads
        self.best, self.runs = begin, 0
        k = begin.strokes.ends.size
        self._scale = np.repeat([np.pi, swing_period(cast_setup.rope)], k)
        spread = np.repeat([SPREAD_ENDS, SPREAD_RESTS], k)
        random = np.random.default_rng([SEED, seed])
        self._optimizer = CmaEs(begin.strokes.parameters / self._scale, NARROW, spread, MEMBERS, random)

    def step(self) -> float:
        """Simulate one generation; return the least cost so far, m."""
        points = self._optimizer.ask()
        strokes = [self._strokes(x) for x in points]
        peaks = simulate_peaks(self.cast_setup, strokes, self.threads)
        each = peak_costs(self.target, peaks)
        best = cheapest_peaks(each, peaks.row, len(points))
        cost = np.where(best >= 0, each[best], NEVER)
        self._optimizer.tell(points, list(cost))
        self.runs += len(points)
        k = int(cost.argmin())
        if cost[k] < self.best.cost:
            self.best = WhipCandidate(float(cost[k]), float(peaks.t[best[k]]), strokes[k])
        return self.best.cost

    def _strokes(self, x: Array) -> Strokes:
        ends, rests = np.split(np.asarray(x, dtype=np.float64) * self._scale, 2)
        return Strokes(self.best.strokes.side, ends, np.abs(rests))
