"""The place nearest to a target that is in reach, or for which a throw is at hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Peg
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.search.search import Search
from hyperflex.planning.wind.reachability import ENERGY, Reach, reach

if TYPE_CHECKING:
    from hyperflex.planning.cast_plan import CastPlan

RINGS, RAYS = 40, 60  # of the first grid about the shaft, on the target's side
ZOOM, LEVELS, ACROSS = 4.0, 4, 9  # each finer grid has cells so much smaller, and so many places a side
RADII = (0.01, 0.02, 0.035, 0.05, 0.075, 0.1)  # of the rings about a target where throws at hand are tried, in lengths
AROUND, HELD = 8, 6  # places of a ring, and throws tried at each


@dataclass(frozen=True, eq=False)
class Nearest:
    """The nearest place for which there is, or should be, a throw.

    Attributes
    ----------
    peg : Peg
        A target like the one asked for, elsewhere.
    away : float
        Its distance from the target, m.
    plan : CastPlan or None
        A plan for it that stands; None where it is only expected, by the criterion of reach.
    tried : int
        Nearer places that were planned for in vain.
    """

    peg: Peg
    away: float
    plan: CastPlan | None = None
    tried: int = 0


def spare(known: Reach, hold: float = 0.0) -> float:
    """Return the part by which a target has more than the criterion asks, of what is scarcest; below 0 out of reach."""
    parts = [known.room / known.needed, known.energy / ENERGY]
    if hold > 0.0:
        parts.append(known.hold / hold)
    return -1.0 if known.impossible else min(parts) - 1.0


def nearest(thrower: Thrower, peg: Peg, *, hold: float = 0.0, more: float = 0.0) -> Nearest | None:
    """Find the nearest place at which the criterion calls a peg in reach.

    Parameters
    ----------
    thrower : Thrower
    peg : Peg
    hold : float
        Pull that the wound rope should bear, N.
    more : float
        What it should have to spare, as :func:`spare` tells it.

    Returns
    -------
    Nearest or None
        None if there is no such place.

    Notes
    -----
    A polar grid about the shaft, on the target's side, and finer ones about the nearest place found: within a
    thousandth of the rope's length of the nearest one, but for what hides between the places of the first grid.
    """

    def good(place: Array) -> bool:
        known = reach(thrower, _at(peg, place))
        return known.within and spare(known, hold) >= more

    unit = 10.0 ** math.floor(math.log10(1e-3 * thrower.rope.total_length))
    asked: Array = np.array([peg.x, peg.y])
    found = _first(_polar(thrower, asked), asked, unit, good)
    cell = thrower.rope.total_length / RINGS
    for _ in range(LEVELS):
        if found is None:
            return None
        side: Array = np.linspace(-cell, cell, ACROSS)
        around = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        found = _first(np.concatenate([found + around, found[None]]), asked, unit, good)
        cell /= ZOOM
    return None if found is None else Nearest(_at(peg, found), float(np.hypot(*(found - asked))))


def _polar(thrower: Thrower, asked: Array) -> Array:
    """Places (k, 2) that the rope might reach, on the target's side of the vertical through the shaft."""
    arm, gravity = thrower.arm, thrower.rope.gravity
    down = np.array(gravity) / math.hypot(*gravity)
    right = np.array([-down[1], down[0]])
    side = math.copysign(1.0, float((asked - arm.pivot) @ right))
    far = arm.length + thrower.rope.total_length * (np.arange(RINGS) + 0.5) / RINGS
    angle: Array = np.linspace(0.0, np.pi, RAYS)
    rays = np.cos(angle)[:, None] * down + side * np.sin(angle)[:, None] * right
    return np.asarray((far[:, None, None] * rays + np.array(arm.pivot)).reshape(-1, 2))


def _first(places: Array, asked: Array, unit: float, good: Callable[[Array], bool]) -> Array | None:
    """Return the place nearest to what was asked that is good, in whole units; None if none is."""
    places = unit * np.round(places / unit)
    order = np.argsort(np.hypot(*(places - asked).T), kind="stable")
    return next((places[k] for k in order if good(places[k])), None)


def _at(peg: Peg, place: Array) -> Peg:
    return replace(peg, x=round(float(place[0]), 9) + 0.0, y=round(float(place[1]), 9) + 0.0)


def around(search: Search) -> Iterator[Search]:
    """Try the best throws of a search on pegs about its own, nearest first.

    Yields
    ------
    Search
        Beside each place in turn, with the throws that strike the peg there and how they ended.
    """
    best, thrower = search.landings[:HELD], search.thrower
    for radius in RADII:
        for angle in 2.0 * np.pi * np.arange(AROUND) / AROUND:
            way = radius * thrower.rope.total_length * np.array([np.cos(angle), np.sin(angle)])
            peg = _at(search.peg, np.array([search.peg.x, search.peg.y]) + way)
            if reach(thrower, peg).impossible:
                continue
            beside = Search(thrower, peg, search.seed, search.threads, search.hold)
            for side in beside.genes:
                points = [one.x for one in best if one.side == side]
                if points:
                    beside.land(side, points)
            yield beside
