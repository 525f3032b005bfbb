"""Order of identical markers along the rope in a frame without a prediction: a short, smooth path from the origin."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.vision.assignment import SLACK

CERTAIN = 4.0  # cost by which the next best order must be worse
_SHORT, _TURN = 0.08, 0.6  # scales of missing chord over arc, and of the turn from chord to chord, rad
_MISSING, _CLUTTER = 5.0, 2.5  # costs of a marker not seen, and of a blob that is no marker
_BEAM = 600  # paths that are kept


class Ordering(NamedTuple):
    """The order of markers along a rope.

    Attributes
    ----------
    indices : (K,) int
        Of the places; -1: not seen.
    certain : bool
        Whether no other order explains the frame nearly as well; if not, try another frame.
    margin : float
        Cost by which the next best order is worse.
    """

    indices: npt.NDArray[np.int64]
    certain: bool
    margin: float


class _Paths(NamedTuple):
    """Beginnings of B paths."""

    taken: npt.NDArray[np.int64]  # (B, k) place of each marker so far, or -1
    cost: Array  # (B,)
    place: Array  # (B, 2) of the last marker seen
    arc: Array  # (B,) of that
    direction: Array  # (B, 2) of the last chord, 0 before the first


def order_markers(
    places: Array, arc_lengths: Array, origin: Array, *, noise: float = 0.003, slack: float = 0.0
) -> Ordering:
    """Find which of the places is which marker, from the places alone.

    Parameters
    ----------
    places : (M, 2) float64
        In the swing plane, m; clutter may be among them, and markers may be missing.
    arc_lengths : (K,) float64
        Of the markers from the origin, m, increasing.
    origin : (2,) float64
        Where the rope begins (the first joint), m.
    noise : float
        Standard deviation of the places, m.
    slack : float
        Relative error of lengths that the scale or the arc lengths may have, in addition to 2 %.

    Notes
    -----
    Two markers cannot be further apart than the rope between them. Among the paths that obey this, the one of least
    cost is taken: a term log(1 + x^2) for each chord that is shorter than its arc and for each turn from chord to chord
    (heavy tails, for the few sharp bends of a rope), and fixed costs for missing markers and clutter. Beam search.
    """
    paths = _Paths(np.zeros((1, 0), np.int64), np.zeros(1), np.asarray(origin)[None], np.zeros(1), np.zeros((1, 2)))
    for arc in arc_lengths:
        paths = _extended(paths, places, float(arc), noise, slack)
    cost = paths.cost + _CLUTTER * (len(places) - (paths.taken >= 0).sum(axis=1))
    order = np.argsort(cost, kind="stable")
    best = paths.taken[order[0]]
    margin = float(cost[order[1]] - cost[order[0]]) if order.size > 1 else np.inf
    return Ordering(best, margin > CERTAIN and bool((best >= 0).any()), margin)


def check_increasing(arc_lengths: Array) -> None:
    """Raise InvalidInput if arc lengths (K,), m, do not increase."""
    falling = np.flatnonzero(np.diff(arc_lengths) <= 0.0)
    if falling.size:
        one, two = arc_lengths[falling[0] : falling[0] + 2].tolist()
        raise InvalidInput(
            f"arc lengths of markers do not increase: {two:g} m comes after {one:g} m",
            got=arc_lengths.tolist(),
            allowed="increasing ones, from the first joint to the tip, each once",
            fix="Measure each marker along the rope from where it hangs, and give them in that order",
        )


def _extended(paths: _Paths, seen: Array, arc: float, noise: float, slack: float) -> _Paths:
    """Return the best paths that continue to a marker at an arc length, m: to each place, or without it."""
    chord = seen[None] - paths.place[:, None]  # (B, M, 2)
    length = np.maximum(np.linalg.norm(chord, axis=2), 1e-9)
    rope = (arc - paths.arc)[:, None]
    short = np.maximum(0.0, 1.0 - length / rope)
    direction, before = chord / length[:, :, None], paths.direction[:, None]
    sine = before[..., 0] * direction[..., 1] - before[..., 1] * direction[..., 0]
    turn = np.arctan2(sine, (before * direction).sum(axis=2))
    cost = paths.cost[:, None] + np.log1p((short / np.hypot(_SHORT, slack)) ** 2) + np.log1p((turn / _TURN) ** 2)
    used = (paths.taken[:, :, None] == np.arange(len(seen))).any(axis=1)
    cost[used | (length > (1.0 + SLACK + slack) * rope + 4.0 * noise)] = np.inf
    costs = np.concatenate([cost, paths.cost[:, None] + _MISSING], axis=1).ravel()
    best = np.argsort(costs, kind="stable")[:_BEAM]
    best = best[np.isfinite(costs[best])]
    row, column = np.divmod(best, len(seen) + 1)
    missing = column == len(seen)
    # a last column for "not seen": the path stays where it is
    ends = np.concatenate([np.broadcast_to(seen, (len(cost), *seen.shape)), paths.place[:, None]], axis=1)
    directions = np.concatenate([direction, paths.direction[:, None]], axis=1)
    return _Paths(
        np.column_stack([paths.taken[row], np.where(missing, -1, column)]),
        costs[best],
        ends[row, column],
        np.where(missing, paths.arc[row], arc),
        directions[row, column],
    )
