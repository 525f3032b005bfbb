"""Order of identical markers along the rope in a frame without a prediction: a short, smooth path from the origin."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput

SLACK = 0.02  # by which a rope may look longer than it is
CERTAIN = 4.0  # cost by which the next order must be worse
_SHORT, _TURN = 0.08, 0.6  # scales of missing chord over arc, and of the turn from chord to chord, rad
_MISSING, _CLUTTER = 5.0, 2.5  # costs of a marker not seen, and of something seen that is no marker
_BEAM = 600


class Ordering(NamedTuple):
    """The order of markers along a rope.

    Attributes
    ----------
    indices : (K,) int
        Of what is seen; -1: not seen.
    certain : bool
        Whether no other order explains the frame nearly as well.
    margin : float
        Cost by which the next best order is worse.
    """

    indices: npt.NDArray[np.int64]
    certain: bool
    margin: float


class _Paths(NamedTuple):
    """Beginnings of paths: what was taken for each marker so far, its cost, and where each has got to."""

    taken: npt.NDArray[np.int64]  # (B, k)
    cost: Array
    place: Array  # (B, 2)
    arc: Array  # (B,)
    direction: Array  # (B, 2), 0 before the first chord


def order_markers(
    places: npt.ArrayLike,
    arc_lengths: npt.ArrayLike,
    origin: npt.ArrayLike,
    *,
    noise: float = 0.003,
    slack: float = 0.0,
) -> Ordering:
    """Find which of the things seen is which marker, from their places alone.

    Parameters
    ----------
    places : (M, 2) array_like
        In the swing plane, m; clutter may be among them, and markers may be missing.
    arc_lengths : (K,) array_like
        Of the markers from the origin, m, increasing.
    origin : (2,) array_like
        Where the rope begins (the first joint), m.
    noise : float
        Standard deviation of the places, m.
    slack : float
        By which part lengths may look longer or shorter where scale or lengths are not known, beside the usual 2 %.

    Returns
    -------
    Ordering
        Ask for another frame where it is not `certain`.

    Raises
    ------
    InvalidInput
        If the arc lengths do not increase.

    Notes
    -----
    Two markers cannot be further apart than the rope between them. Among the paths that obey this, that of least cost
    is taken: a term log(1 + x^2) for each chord that is shorter than its arc and for each turn from chord to chord
    (heavy tails, for the few sharp bends of a rope), and fixed costs for what is missing or left over. Beam search.
    """
    seen = checks.array("places", places, (-1, 2), unit="m")
    arcs = checks.array("arc_lengths", arc_lengths, (-1,), sign="positive", unit="m")
    check_increasing(arcs)
    start = checks.array("origin", origin, (2,), unit="m")
    paths = _Paths(np.zeros((1, 0), np.int64), np.zeros(1), start[None], np.zeros(1), np.zeros((1, 2)))
    for arc in arcs:
        paths = _extended(paths, seen, float(arc), noise, slack)
    left_over = seen.shape[0] - (paths.taken >= 0).sum(axis=1)
    cost = paths.cost + _CLUTTER * left_over
    order = np.argsort(cost, kind="stable")
    best = order[0]
    margin = float(cost[order[1]] - cost[best]) if order.size > 1 else np.inf
    return Ordering(paths.taken[best], margin > CERTAIN and bool((paths.taken[best] >= 0).any()), margin)


def check_increasing(arc_lengths: Array) -> None:
    """Refuse arc lengths (K,), m, of which one is no greater than the one before."""
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
    """Return the best paths that go on to a marker at an arc length, m: to each thing seen, or without it."""
    chord = seen[None] - paths.place[:, None]  # (B, M, 2)
    length = np.maximum(np.linalg.norm(chord, axis=2), 1e-9)
    rope = (arc - paths.arc)[:, None]
    short = np.maximum(0.0, 1.0 - length / rope)
    direction = chord / length[:, :, None]
    before = paths.direction[:, None]
    turn = np.arctan2(
        before[..., 0] * direction[..., 1] - before[..., 1] * direction[..., 0], (before * direction).sum(axis=2)
    )
    cost = paths.cost[:, None] + np.log1p((short / np.hypot(_SHORT, slack)) ** 2) + np.log1p((turn / _TURN) ** 2)
    used = (paths.taken[:, :, None] == np.arange(len(seen))).any(axis=1)
    cost[used | (length > (1.0 + SLACK + slack) * rope + 4.0 * noise)] = np.inf
    costs = np.concatenate([cost, paths.cost[:, None] + _MISSING], axis=1).ravel()
    best = np.argsort(costs, kind="stable")[:_BEAM]
    best = best[np.isfinite(costs[best])]
    row, column = np.divmod(best, len(seen) + 1)
    missing = column == len(seen)
    taken = np.where(missing, -1, column)
    if not len(seen):
        return _Paths(np.column_stack([paths.taken[row], taken]), costs[best], *paths[2:])
    column = np.minimum(column, len(seen) - 1)
    return _Paths(
        np.column_stack([paths.taken[row], taken]),
        costs[best],
        np.where(missing[:, None], paths.place[row], seen[column]),
        np.where(missing, paths.arc[row], arc),
        np.where(missing[:, None], paths.direction[row], direction[row, column]),
    )
