"""The map of a whip: peaks of the tip's speed in random swings, and the feasibility check by it."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.planning.clearance import gap_of, holds, named
from hyperflex.planning.problem import Problem
from hyperflex.planning.routing import refuse_behind
from hyperflex.planning.tip.obstacle_gaps import blocked
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.swings import random_swings, simulate_swings
from hyperflex.planning.tip.task import TipCandidate
from hyperflex.planning.whip.tip_target import Peaks, TipTarget, cheapest_peaks, find_peaks, peak_costs, tip_velocity

SAMPLE_TIME = 0.02  # s: of swings in a search
SWINGS = 512  # of a map
TOGETHER = 64  # swings of a map between two looks at the time
MIN_TIME = 2.0 * SAMPLE_TIME  # s; a peak needs three samples
MAX_COST = 0.12  # m, cost of the cheapest peak of the map up to which a target is feasible
AROUND = 0.25  # m, within which the highest speed is reported


@dataclass(frozen=True, eq=False)
class WhipMap:
    """Peaks of the tip's speed in random swings: roughly what is feasible.

    Attributes
    ----------
    problem : Problem
    strokes : tuple of Strokes
        Of each swing.
    peaks : Peaks
    """

    problem: Problem
    strokes: tuple[Strokes, ...]
    peaks: Peaks

    def candidates(self, target: TipTarget) -> list[TipCandidate]:
        """Return the cheapest peak of each swing for a `target`, the cheapest first."""
        cost, t = peak_costs(target, self.peaks), self.peaks.t
        best = cheapest_peaks(cost, self.peaks.row, len(self.strokes))
        found = [TipCandidate(float(cost[k]), float(t[k]), self.strokes[self.peaks.row[k]]) for k in best if k >= 0]
        return sorted(found, key=lambda one: one.cost)


@dataclass(frozen=True)
class WhipFeasibility:
    """Result of the feasibility check of a target.

    `distance` is that from the arm's pivot, m. `cost`, m, is that of the cheapest peak of the map, were there no
    obstacles: its distance from the target, and more if its speed or direction are not as asked. `message` tells why
    the target is not feasible.
    """

    distance: float
    cost: float
    message: str

    @property
    def feasible(self) -> bool:
        """Whether the target is feasible."""
        return not self.message


def pivot_distance(problem: Problem, target: TipTarget) -> float:
    """Distance of a target from the arm's pivot, m."""
    return math.hypot(target.x - problem.arm.pivot[0], target.y - problem.arm.pivot[1])


def check_whip_feasibility(whip_map: WhipMap, target: TipTarget) -> WhipFeasibility:
    """Check whether a target is close enough to a peak of a map; swings of a search may pass by obstacles."""
    problem = whip_map.problem
    distance = pivot_distance(problem, target)
    short = distance - problem.rope.total_length - problem.arm.length
    if short > 0.0:
        return WhipFeasibility(distance, math.inf, f"out of reach: the rope ends {short:.2f} m short of the target")
    for each in problem.obstacles:
        if holds(each, target.x, target.y):
            return WhipFeasibility(distance, math.inf, f"the target lies in {named(each)}")
        gap, least = gap_of(each, target.x, target.y), problem.rope.radius + max(problem.clearance, 0.0)
        if gap <= least:
            near = f"the target is {1e3 * gap:.1f} mm from {named(each)}"
            return WhipFeasibility(
                distance, math.inf, f"{near}: with its radius and clearance the rope needs {1e3 * least:g} mm"
            )
    peaks = whip_map.peaks
    free = peaks._replace(blocked=np.zeros_like(peaks.blocked))
    cost = float(peak_costs(target, free).min(initial=math.inf))
    if cost <= MAX_COST:
        return WhipFeasibility(distance, cost, "")
    fast = peaks.speed[np.hypot(*(peaks.place - target.point).T) < AROUND]
    message = (
        f"out of reach: the tip is not that fast so near to it, {fast.max():.1f} m/s at most, or not in that direction"
        if fast.size
        else "out of reach: the tip's speed has no peak so near to it"
    )
    return WhipFeasibility(distance, cost, message)


def simulate_peaks(problem: Problem, strokes: list[Strokes], threads: int | None = None) -> Peaks:
    """Simulate free swings from rest and find the peaks of the tip's speed."""
    t, batch, angle, rate = simulate_swings(problem, strokes, SAMPLE_TIME, threads)
    lacks = blocked(problem, batch.q, problem.arm.tip(angle))
    return find_peaks(t, batch.tip, tip_velocity(problem, batch.q, batch.qd, angle, rate), lacks)


@interruptible()
def build_whip_map(
    problem: Problem,
    swings: int = SWINGS,
    threads: int | None = None,
    *,
    left: Callable[[], float] = lambda: math.inf,
) -> WhipMap:
    """Simulate random swings, the same ones each time, and find the peaks of the tip's speed.

    Parameters
    ----------
    problem : Problem
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
    refuse_behind(problem.behind, "a whip")
    if problem.time < MIN_TIME:
        raise InvalidInput(
            "time_limit is too short for any whip",
            got=problem.time,
            allowed=f"at least {MIN_TIME:g} s; three periods of the rope's swing are usual",
        )
    strokes = random_swings(problem, swings)
    found: list[Peaks] = []
    for low in range(0, swings, TOGETHER):
        if found and left() < 0.0:
            strokes = strokes[:low]
            break
        some = simulate_peaks(problem, strokes[low : low + TOGETHER], threads)
        found.append(some._replace(row=some.row + low))
    return WhipMap(problem, tuple(strokes), Peaks(*map(np.concatenate, zip(*found, strict=True))))
