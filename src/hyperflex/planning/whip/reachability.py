"""Whether a whip can meet a target at all: how near the peaks of a map come, told before any search."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.whip.search import WhipMap
from hyperflex.planning.whip.tip_target import Mark

NEAR = 0.12  # m, cost of the nearest peak of the map up to which a target is in reach
AROUND = 0.25  # m, within which the fastest peak is told


@dataclass(frozen=True)
class WhipReach:
    """What could be said of a target before searching.

    Attributes
    ----------
    distance : float
        From the arm's pivot, m.
    cost : float
        Of the nearest peak of the map, m: how far it is away, and more where its speed or direction are not as asked.
    reason : str
        Why the target is out of reach; empty if it is not.
    """

    distance: float
    cost: float
    reason: str

    @property
    def within(self) -> bool:
        """Whether the target is in reach."""
        return not self.reason


def distance(thrower: Thrower, mark: Mark) -> float:
    """Distance of a target from the arm's pivot, m."""
    return math.hypot(mark.x - thrower.arm.pivot[0], mark.y - thrower.arm.pivot[1])


def reach_whip(known: WhipMap, mark: Mark) -> WhipReach:
    """Tell whether a target is in reach: close enough to where the tip's speed peaks in the swings of a map.

    Parameters
    ----------
    known : WhipMap
        Of the thrower.
    mark : Mark
    """
    thrower = known.thrower
    away = distance(thrower, mark)
    short = away - thrower.rope.total_length - thrower.arm.length
    if short > 0.0:
        return WhipReach(away, math.inf, f"out of reach: the rope ends {short:.2f} m short of the target")
    near = known.nearest(mark)
    cost = near[0].cost if near else math.inf
    if cost <= NEAR:
        return WhipReach(away, cost, "")
    fast = [float(s) for s, p in zip(known.peaks.speed, known.peaks.place, strict=True) if _close(p, mark)]
    why = (
        f"out of reach: the tip is not that fast so near to it, {max(fast):.1f} m/s at most, or not in that direction"
        if fast
        else "out of reach: the tip's speed has no peak so near to it"
    )
    return WhipReach(away, cost, why)


def _close(place: Array, mark: Mark) -> bool:
    return float(np.hypot(*(place - mark.point))) < AROUND
