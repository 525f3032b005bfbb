"""Which blob is which marker: joint assignment to predictions, the order in a first frame, and clutter."""

import math
import operator
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array, Flags, Integers
from hyperflex.core.image import pairs
from hyperflex.errors import InvalidInput
from hyperflex.vision.markers import Blobs, Gate

GATE = -2.0 * math.log(0.001)  # squared Mahalanobis distance of a marker's own blob, exceeded once in 1000
SLACK = 0.02  # relative stretch of the rope in a picture that is allowed
_CLEAR = 12.0  # difference of squared distances from which a pair is unambiguous: odds of e^6
_UNSURE = 6.0  # with less for every pair, nothing is clear at first: odds of e^3
_ODDS = math.log(0.8 / 0.2)  # prior odds that a marker is seen
_FORBIDDEN = 1e9  # cost of a pair that is excluded


class Assignment(NamedTuple):
    """Which blob is which of K markers.

    Attributes
    ----------
    indices : (K,) int
        Of the blob; -1: not seen.
    places : (K, 2) float64
        px; NaN: not seen.
    covariances : (K, 2, 2) float64
        Of the places, px^2.
    """

    indices: Integers
    places: Array
    covariances: Array


def assign_markers(
    seen: Blobs,
    predicted: Array,
    covariance: Array,
    *,
    gate: float = GATE,
    clutter: float | Array = 1e-6,
) -> Assignment:
    """Assign blobs to markers that a model predicts.

    Parameters
    ----------
    seen : Blobs
        M blobs, clutter among them.
    predicted : (K, 2) float64
        Where the markers are expected, px.
    covariance : (2 K, 2 K) float64
        Of all predictions together, px^2: a marker that is recognised corrects the expectation of the others, so that a
        whole rope that is off by more than a gate is still recognised.
    gate : float
        Squared Mahalanobis distance beyond which a blob is not the marker's.
    clutter : float or (M,) float64
        Density of blobs of the colour that are no markers where each was seen, 1/px^2, by default one in a megapixel;
        see :class:`ClutterMap`. A blob is taken if a marker there is likelier than clutter, which it is not if the
        prediction is wide.

    Notes
    -----
    Least sum of squared Mahalanobis distances plus logarithms of determinants (scipy's linear_sum_assignment), compared
    with a marker that is not seen and a blob of clutter (a marker is seen with a probability of 0.8). The clearest
    pairs are settled first, and the prediction of the others is conditioned on them.
    """
    mean, prior, at, wide = map(np.ascontiguousarray, (predicted, covariance, seen.places, seen.covariances))
    density = np.broadcast_to(np.asarray(clutter, dtype=np.float64), len(at))
    unseen = 2.0 * np.log(density) - 2.0 * _ODDS + 2.0 * math.log(2.0 * math.pi)

    def costs(m: Array, P: Array) -> Array:
        """Return the cost (K, M) of each pair relative to a marker that is not seen and a blob of clutter."""
        cost = np.empty((len(m), len(at)))
        pairs.pair_costs(at, wide, m, P, unseen, gate, _FORBIDDEN, cost)
        return cost

    def settled(k: Integers, j: Integers) -> tuple[float, Integers]:
        """Return the cost of all pairs together, and the blob (K,) of each marker, or -1, from the first pairs on."""
        m, P, total = mean, prior, 0.0
        indices, taken = np.full(len(m), -1), np.zeros(len(at), bool)
        while k.size:
            indices[k], taken[j] = j, True
            rows, each = np.asarray(2 * k[:, None] + [0, 1], np.intp).ravel(), np.arange(k.size)
            S, off = P[np.ix_(rows, rows)], (at[j] - m[k]).ravel()
            S.reshape(k.size, 2, k.size, 2)[each, :, each] += wide[j]
            total += float(off @ np.linalg.solve(S, off) + np.linalg.slogdet(S)[1] + unseen[j].sum())
            if taken.all() or (indices >= 0).all():
                break
            gain = np.linalg.solve(S, P[rows]).T
            m, P = m + (gain @ off).reshape(-1, 2), P - gain @ P[rows]
            cost = costs(m, P)
            cost[indices >= 0], cost[:, taken] = _FORBIDDEN, _FORBIDDEN
            k, j = _clear_pairs(cost)
        return total, indices

    cost = costs(mean, prior)
    starts, possible = [_clear_pairs(cost)], cost < _FORBIDDEN
    if possible.any() and _margins(cost)[possible].max() <= _UNSURE:  # try each blob that the surest marker may have
        widths = np.where(possible.any(axis=1), np.diag(prior).reshape(-1, 2).sum(axis=1), np.inf)
        surest = np.array([np.argmin(widths)])
        starts += [(surest, np.array([j])) for j in np.flatnonzero(possible[surest[0]])]
    indices = min((settled(*start) for start in starts), key=operator.itemgetter(0))[1]
    found = indices >= 0
    places, covariances = np.full((len(indices), 2), np.nan), np.full((len(indices), 2, 2), np.nan)
    places[found], covariances[found] = at[indices[found]], wide[indices[found]]
    return Assignment(indices, places, covariances)


def _clear_pairs(cost: Array) -> tuple[Integers, Integers]:
    """Return the pairs of the least sum of costs (K, M) that are unambiguous; the clearest one if none is."""
    from scipy.optimize import linear_sum_assignment

    count, many = cost.shape
    full = np.full((count, many + count), _FORBIDDEN)
    full[:, :many] = cost
    full[np.arange(count), many + np.arange(count)] = 0.0  # not seen
    rows, columns = linear_sum_assignment(full)
    rows, columns = rows[columns < many], columns[columns < many]
    margins = _margins(cost)[rows, columns]
    clear = margins >= min(_CLEAR, margins.max(initial=-np.inf))
    return rows[clear], columns[clear]


def _margins(cost: Array) -> Array:
    """Return by how much each pair (K, M) is better than the next one of its marker or blob, or than none."""
    others = np.zeros_like(cost)
    for each, best in ((cost, others), (cost.T, others.T)):
        if len(each) > 1:
            least, second = np.partition(each, 1, axis=0)[:2]
            np.minimum(best, np.where(each > least, least, second), out=best)
    return others - cost


CERTAIN = 4.0  # cost by which the next best order must be worse
_SHORT, _TURN = 0.08, 0.6  # scales of missing chord over arc, and of the turn from chord to chord, rad
_MISSING, _CLUTTER = 5.0, 2.5  # costs of a marker not seen, and of a blob that is no marker
_ELSEWHERE, _AWAY = 6.0, 10.0  # costs of a rope that does not begin at the origin, and of each rope's length from there
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
    anchored : bool
        Whether the rope may begin at the origin.
    """

    indices: Integers
    certain: bool
    margin: float
    anchored: bool = True


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
    (heavy tails, for the few sharp bends of a rope), and fixed costs for missing markers and clutter. A rope that does
    not begin at the origin has a further cost, which grows with the distance: it is less than that of an order whose
    markers are all one off. Beam search.
    """
    z, (first, second) = places[:, 0] + 1j * places[:, 1], origin
    taken, costs = np.zeros((2, 0), np.int64), np.array([0.0, _ELSEWHERE])  # of each path
    place, start, direction = np.full(2, first + 1j * second), np.zeros(2), np.zeros(2, complex)  # its end so far
    anchored, free = np.array([True, False]), np.array([False, True])  # free: it has not begun, and may do so anywhere
    for arc in arc_lengths:
        chord, rope = z - place[:, None], (arc - start)[:, None]
        length = np.maximum(np.abs(chord), 1e-9)
        short = np.maximum(0.0, 1.0 - length / rope) / np.hypot(_SHORT, slack)
        turn = np.angle(chord * direction.conj()[:, None]) / _TURN
        dearer = np.log1p(short**2) + np.log1p(turn**2)
        used = (taken[:, :, None] == np.arange(len(z))).any(axis=1)
        beyond = length - (1.0 + SLACK + slack) * rope - 4.0 * noise
        dearer[beyond > 0.0] = np.inf
        dearer[free] = _AWAY * np.maximum(beyond[free], 0.0) / arc_lengths[-1]
        dearer[used] = np.inf
        choices = (costs[:, None] + np.column_stack([dearer, np.full(len(costs), _MISSING)])).ravel()
        best = np.argsort(choices, kind="stable")[:_BEAM]
        best = best[np.isfinite(choices[best])]
        row, column = np.divmod(best, len(z) + 1)
        seen = column < len(z)
        taken, costs = np.column_stack([taken[row], np.where(seen, column, -1)]), choices[best]
        place, start, direction, anchored = place[row], start[row], direction[row], anchored[row]
        place[seen], start[seen] = z[column[seen]], arc
        direction[seen] = np.where(free[row[seen]], 0.0, chord[row[seen], column[seen]])
        free = free[row] & ~seen
    costs += _CLUTTER * (len(z) - (taken >= 0).sum(axis=1))
    order = np.argsort(costs, kind="stable")
    other = (taken[order] != taken[order[0]]).any(axis=1)  # the same order may begin at the origin or not
    margin = float(costs[order[other]].min(initial=np.inf) - costs[order[0]])
    known = margin > CERTAIN and bool((taken[order[0]] >= 0).any())
    return Ordering(taken[order[0]], known, margin, bool(anchored[order[0]]))


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


class ClutterMap:
    """Learns from blobs that were no markers how likely another such blob is at a place.

    Parameters
    ----------
    image_size : (int, int)
        Width and height, px.

    Notes
    -----
    Clutter is a uniform density, at least one blob a picture, plus the places at which something was seen that was no
    marker: where that was seen n times and missed m times, it is there again with probability n / (n + m + 1).
    """

    NEAR = 2.0  # px: a blob that near to a known one is the same, at rest
    MEMORY = 30.0  # frames over which the number of blobs that are no markers is averaged
    STILL = 3  # frames at the same place, from which a blob counts as one at rest and is not forgotten
    FORGOTTEN = 2  # frames after which a blob seen less often is forgotten
    WITHIN = 3.0  # standard deviations of a gate that were certainly searched

    def __init__(self, image_size: tuple[int, int]) -> None:
        self._area, self._mean, self._frame = float(image_size[0] * image_size[1]), 0.0, 0
        # known places; how often something was seen there and missed there, and when last (the first one is none)
        self._places, self._counts = np.full((1, 2), np.inf), np.array([[0.0, 0.0, np.inf]])

    def density(self, seen: Blobs) -> Array:
        """Return the density of clutter where each of M blobs was seen (M,), 1/px^2."""
        nearest, known = self._known(seen.places)
        n, m, _ = self._counts[nearest].T
        at_rest = known * n / (n + m + 1.0) / (2.0 * np.pi * np.sqrt(np.linalg.det(seen.covariances)))
        return np.asarray((1.0 + self._mean) / self._area + at_rest)

    def still(self, seen: Blobs) -> Flags:
        """Return which of M blobs lie where something was seen in `self.STILL` frames or more (M,)."""
        nearest, known = self._known(seen.places)
        return np.asarray(known & (self._counts[nearest, 0] >= self.STILL))

    def learn(self, seen: Blobs, markers: Flags, gates: Sequence[Gate] | None = None) -> None:
        """Learn from a frame's blobs, some of them `markers` (M,); searched in `gates`, or as a whole (None)."""
        self._frame += 1
        nearest, known = self._known(seen.places)
        missed = np.ones(len(self._places), bool)
        if gates is not None:
            off = np.abs(self._places[:, None] - np.array([gate.centre for gate in gates]).reshape(-1, 2))
            wide = np.array([gate.covariance for gate in gates]).reshape(-1, 2, 2)
            reach = self.WITHIN * np.sqrt(np.diagonal(wide, axis1=1, axis2=2))
            missed = (off < reach).all(axis=2).any(axis=1)
        missed[nearest[known]] = False
        self._counts[missed, 1] += 1.0
        again, new = known & ~markers, seen.places[~known & ~markers]
        self._places[nearest[again]] = seen.places[again]
        self._counts[nearest[again], 0] += 1.0
        self._counts[nearest[again], 2] = self._frame
        self._mean += (len(new) - self._mean) / min(self.MEMORY, self._frame)
        kept = (self._counts[:, 0] >= self.STILL) | (self._frame - self._counts[:, 2] < self.FORGOTTEN)
        self._places = np.concatenate([self._places[kept], new])
        self._counts = np.concatenate([self._counts[kept], np.tile([1.0, 0.0, float(self._frame)], (len(new), 1))])

    def _known(self, places: Array) -> tuple[Integers, Flags]:
        """Return the nearest known place of each blob (M,), and whether the blob is there (M,)."""
        apart = np.linalg.norm(places[:, None] - self._places, axis=2)
        return apart.argmin(axis=1), apart.min(axis=1) < self.NEAR
