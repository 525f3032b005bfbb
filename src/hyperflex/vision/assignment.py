"""Joint assignment of identical markers in a frame to their predicted places, with the ambiguity that remains."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.core.image import pairs
from hyperflex.vision.markers import Blobs

Indices = npt.NDArray[np.int64]

GATE = -2.0 * math.log(0.001)  # squared Mahalanobis distance of a marker's own blob, exceeded once in 1000
CLEAR = 12.0  # difference of squared distances from which a pair is unambiguous: odds of e^6
UNSURE = 6.0  # difference below which two markers may be swapped: odds of e^3
SLACK = 0.02  # relative stretch of the rope in a picture that is allowed
ODDS = math.log(0.8 / 0.2)  # prior odds that a marker is seen
SPARSE = 1e-6  # 1/px^2, density of clutter: one blob of the colour in a picture of a megapixel
_FORBIDDEN = 1e9  # cost of a pair that is excluded


class Assignment(NamedTuple):
    """Which blob is which of K markers.

    Attributes
    ----------
    indices : (K,) int
        Of the blob; -1: not seen.
    places : (K, 2) float64
        px; NaN: not seen. If two markers may be swapped, the mean of both explanations.
    covariances : (K, 2, 2) float64
        Of the places, px^2; they include the spread of both explanations.
    distances : (K,) float64
        Squared Mahalanobis distance from the prediction; NaN: not seen.
    swappable : (K,) bool
        Whether it may be swapped with another marker.
    """

    indices: Indices
    places: Array
    covariances: Array
    distances: Array
    swappable: npt.NDArray[np.bool_]


def assign_markers(
    seen: Blobs,
    predicted: Array,
    covariance: Array,
    *,
    gate: float = GATE,
    reach: Array | None = None,
    clutter: float | Array = SPARSE,
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
    reach : (K - 1,) float64, optional
        Greatest distance between markers k and k + 1, px: the rope between them, times the scale. Pairs that are
        further apart than that, and 2 %, are not both taken.
    clutter : float or (M,) float64
        Density of blobs of the colour that are no markers where each was seen, 1/px^2; see :class:`ClutterMap`. A blob
        is taken if a marker there is likelier than clutter, which it is not if the prediction is wide.

    Notes
    -----
    Least sum of squared Mahalanobis distances plus logarithms of determinants (scipy's linear_sum_assignment), compared
    with a marker that is not seen and a blob of clutter (a marker is seen with a probability of 0.8). The clearest
    pairs are settled first, and the prediction of the others is conditioned on them. Two markers for which the swapped
    pair is nearly as likely get the mean and covariance over both explanations (a joint probabilistic data association
    of pairs; Bar-Shalom, Fortmann 1988).
    """
    problem = _Problem(seen, predicted, covariance, gate, clutter)
    while True:
        indices = problem.best()
        found = np.flatnonzero(indices >= 0)
        distances = problem.distances(indices, found)
        if reach is None or (k := _too_far(seen, indices, found, reach, distances)) < 0:
            break
        problem.forbidden[k, indices[k]] = True
    places, covariances = np.full((len(indices), 2), np.nan), np.full((len(indices), 2, 2), np.nan)
    places[found], covariances[found] = seen.places[indices[found]], seen.covariances[indices[found]]
    swappable = np.zeros(len(indices), bool)
    for one, two, share in problem.swaps(indices, found):
        step = seen.places[indices[two]] - seen.places[indices[one]]
        spread = share * (1.0 - share) * np.outer(step, step)
        for k, side in ((one, share), (two, -share)):
            swappable[k] = True
            places[k] = seen.places[indices[k]] + side * step
            covariances[k] = seen.covariances[indices[k]] + spread
    return Assignment(indices, places, covariances, distances, swappable)


class _Problem:
    """Blobs and predictions of one frame, and the costs of assigning one to the other."""

    def __init__(self, seen: Blobs, mean: Array, prior: Array, gate: float, clutter: float | Array) -> None:
        self.mean, self.prior, self._gate = np.ascontiguousarray(mean), np.ascontiguousarray(prior), gate
        self.places, self.wide = np.ascontiguousarray(seen.places), np.ascontiguousarray(seen.covariances)
        count, many = len(mean), len(self.places)
        density = np.broadcast_to(np.asarray(clutter, dtype=np.float64), many)
        self.unseen = 2.0 * np.log(density) - 2.0 * ODDS + 2.0 * math.log(2.0 * math.pi)
        self.forbidden = np.zeros((count, many), bool)
        off = self.prior.reshape(count, 2, count, 2).copy()
        off[np.arange(count), :, np.arange(count)] = 0.0
        self._correlated = bool(off.any())

    def best(self) -> Indices:
        """Return the blob (K,) of each marker, or -1.

        If no pair is clear at first, each blob that the most certain marker may have is tried, and the assignment kept
        that explains all markers together best.
        """
        cost = self._costs(self.mean, self.prior)
        possible = cost < _FORBIDDEN
        greedy = self._settled(cost)
        if not possible.any() or _margins(cost)[possible].max() > UNSURE or not self._correlated:
            return greedy
        widths = np.diag(self.prior).reshape(-1, 2).sum(axis=1)
        surest, attempts = int(np.argmin(np.where(possible.any(axis=1), widths, np.inf))), [greedy]
        for j in np.flatnonzero(possible[surest]):
            given = np.full_like(cost, _FORBIDDEN)
            given[surest, j] = -_FORBIDDEN  # settled before all others
            attempts.append(self._settled(given))
        return min(attempts, key=self._joint_cost)

    def distances(self, indices: Indices, found: Indices) -> Array:
        """Return squared Mahalanobis distances (K,) of the markers found from their own predictions."""
        result, count = np.full(len(indices), np.nan), len(indices)
        off = self.places[indices[found]] - self.mean[found]
        S = self.prior.reshape(count, 2, count, 2)[found, :, found] + self.wide[indices[found]]
        result[found] = (off * np.linalg.solve(S, off[:, :, None])[:, :, 0]).sum(axis=1)
        return result

    def swaps(self, indices: Indices, found: Indices) -> list[tuple[int, int, float]]:
        """Return pairs of markers that may be swapped, and the probability that they are."""
        if found.size < 2:
            return []
        off, S, _ = self._innovation(self.mean, self.prior, indices, found)
        precision, dearer = np.linalg.inv(S), np.full((found.size, found.size), np.inf)
        pairs.swap_costs(self.places[indices[found]], precision, precision @ off, dearer)
        return [
            (int(found[a]), int(found[b]), 1.0 / (1.0 + math.exp(0.5 * max(float(dearer[a, b]), 0.0))))
            for a, b in np.argwhere(dearer < UNSURE).tolist()
        ]

    def _settled(self, cost: Array) -> Indices:
        """Return the blob (K,) of each marker, or -1; the clearest first, the others conditioned on them.

        `cost` (K, M) is that of the first round.
        """
        from scipy.optimize import linear_sum_assignment

        (count, many), mean, prior = cost.shape, self.mean, self.prior
        indices, taken = np.full(count, -1), np.zeros(many, bool)
        while (cost < _FORBIDDEN).any():
            full = np.full((count, many + count), _FORBIDDEN)
            full[:, :many] = cost
            full[np.arange(count), many + np.arange(count)] = 0.0  # not seen
            rows, columns = linear_sum_assignment(full)
            rows, columns = rows[columns < many], columns[columns < many]
            if not rows.size:
                break
            margins = _margins(cost)[rows, columns]
            clear = margins > CLEAR if margins.max() > CLEAR else [int(np.argmax(margins))]
            k, j = rows[clear], columns[clear]
            indices[k], taken[j] = j, True
            if (indices >= 0).all() or taken.all():
                break
            if self._correlated:
                off, S, own = self._innovation(mean, prior, indices, k)
                gain = np.linalg.solve(S, prior[own]).T
                mean, prior = mean + (gain @ off).reshape(-1, 2), prior - gain @ prior[own]
            cost = self._costs(mean, prior)
            cost[indices >= 0] = _FORBIDDEN
            cost[:, taken] = _FORBIDDEN
        return indices

    def _costs(self, mean: Array, prior: Array) -> Array:
        """Return the cost (K, M) of each pair relative to marker unseen and blob of clutter."""
        cost = np.empty(self.forbidden.shape)
        pairs.pair_costs(self.places, self.wide, mean, prior, self.unseen, self._gate, _FORBIDDEN, cost)
        cost[self.forbidden] = _FORBIDDEN
        return cost

    def _joint_cost(self, indices: Indices) -> float:
        """Return the cost of all pairs together relative to nothing but clutter being seen."""
        found = np.flatnonzero(indices >= 0)
        if not found.size:
            return 0.0
        off, S, _ = self._innovation(self.mean, self.prior, indices, found)
        return float(off @ np.linalg.solve(S, off) + np.linalg.slogdet(S)[1] + self.unseen[indices[found]].sum())

    def _innovation(
        self, mean: Array, prior: Array, indices: Indices, found: Indices
    ) -> tuple[Array, Array, npt.NDArray[np.intp]]:
        """Return the innovation (2 F,) of the markers found, its covariance (2 F, 2 F), and its rows of the prior."""
        rows, count = np.asarray(2 * found[:, None] + [0, 1], np.intp).ravel(), np.arange(found.size)
        S = prior[np.ix_(rows, rows)]
        S.reshape(found.size, 2, found.size, 2)[count, :, count] += self.wide[indices[found]]
        return (self.places[indices[found]] - mean[found]).ravel(), S, rows


def _margins(cost: Array) -> Array:
    """Return by how much each pair (K, M) is better than the next one of its marker or blob, or than none."""
    others = np.zeros_like(cost)
    for each, best in ((cost, others), (cost.T, others.T)):
        if len(each) > 1:
            least, second = np.partition(each, 1, axis=0)[:2]
            np.minimum(best, np.where(each > least, least, second), out=best)
    return np.asarray(others - cost)


def _too_far(seen: Blobs, indices: Indices, found: Indices, reach: Array, distances: Array) -> int:
    """Return which marker is to be given up because the rope is too short for it; -1 if none."""
    along = np.concatenate([[0.0], np.cumsum(reach)])[found]
    apart = np.linalg.norm(np.diff(seen.places[indices[found]], axis=0), axis=1)
    variances = np.trace(seen.covariances[indices[found]], axis1=1, axis2=2)
    beyond = apart > (1.0 + SLACK) * np.diff(along) + 3.0 * np.sqrt(variances[1:] + variances[:-1])
    if not beyond.any():
        return -1
    one, two = found[np.argmax(beyond) :][:2]
    return int(one if distances[one] > distances[two] else two)
