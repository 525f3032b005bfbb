"""Routing of a rope behind pegs: how far it runs from each of them on its way from the arm to the target."""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Peg, Rope
from hyperflex.winding import TOUCH, closest_points


def way_gaps(rope: Rope, target: Peg, behind: Sequence[Peg], q: Array, joints: Array) -> Array:
    """Return how far the rope's way to a target is from each of w pegs (T, w), m; infinite where it has no such way.

    Samples of link angles q (T, n), rad, and joints (T, n + 1, 2), m. The way begins at the arm and ends at the first
    touch of the target, or at the rope's end where it does not touch that.
    """
    begins = np.cumsum(rope.length) - rope.length
    place, _, gap = closest_points(rope, target, q, joints)
    first = np.where(gap < TOUCH, begins + place, np.inf).min(axis=1)[:, None]
    found = np.full((len(q), len(behind)), np.inf)
    for k, each in enumerate(behind):
        place, _, gap = closest_points(rope, each, q, joints)
        found[:, k] = np.where(begins + place < first, gap, np.inf).min(axis=1)
    return found


def runs_behind(rope: Rope, target: Peg, behind: Sequence[Peg], q: Array, joints: Array) -> tuple[bool, ...]:
    """Return for each of w pegs whether the rope touches it on its way to the target in all samples.

    Arguments are those of :func:`way_gaps`.
    """
    touched = way_gaps(rope, target, behind, q, joints) < TOUCH
    return tuple(bool(each.all()) for each in touched.T)
