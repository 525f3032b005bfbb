"""Assignment of identical markers in a frame to where a model expects them, jointly, with what is not sure said."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.image import pairs
from hyperflex.errors import InvalidInput
from hyperflex.vision.markers import Observations

CLEAR = 12.0  # difference of squared distances from which a pair needs no second look: odds of e^6
UNSURE = 6.0  # below which two markers may be swapped: odds of e^3
SLACK = 0.02  # by which a rope may look longer than it is
ODDS = math.log(0.8 / 0.2)  # that a marker is seen, before one has looked
SPARSE = 1e-6  # 1/px^2, of clutter: one blob of the colour in a picture of a megapixel
_FORBIDDEN = 1e9


class Assignment(NamedTuple):
    """Which observation is which of K markers.

    Attributes
    ----------
    indices : (K,) int
        Of the observation; -1: not seen.
    places : (K, 2) float64
        px; NaN: not seen. Where two markers may be swapped, the mean of both explanations.
    covariances : (K, 2, 2) float64
        Of the places, px^2; they hold the spread of both explanations.
    distances : (K,) float64
        Squared Mahalanobis distance from the prediction; NaN: not seen.
    swappable : (K,) bool
        Whether another marker may well be this one.
    """

    indices: npt.NDArray[np.int64]
    places: Array
    covariances: Array
    distances: Array
    swappable: npt.NDArray[np.bool_]


def assign_markers(
    seen: Observations,
    predicted: npt.ArrayLike,
    covariance: npt.ArrayLike,
    *,
    gate_probability: float = 0.999,
    reach: npt.ArrayLike | None = None,
    clutter: npt.ArrayLike = SPARSE,
) -> Assignment:
    """Assign what is seen to markers that a model predicts.

    Parameters
    ----------
    seen : Observations
        M blobs, clutter among them.
    predicted : (K, 2) array_like
        Where the markers are expected, px.
    covariance : (K, 2, 2) or (2 K, 2 K) array_like
        Of the prediction, px^2: of each marker, or of all together. With all, a marker that is recognised moves the
        expectation of the others along: a whole rope that is off by more than a gate is still told.
    gate_probability : float
        With which a marker's own observation lies in its gate.
    reach : (K - 1,) array_like, optional
        Greatest distance between markers k and k + 1, px: the rope between them, times the scale. Pairs that are
        further apart than that, and 2 %, are not both taken.
    clutter : float or (M,) array_like
        How dense blobs of the colour that are no markers are where each was seen, 1/px^2; see :class:`ClutterMap`. A
        blob is taken where a marker there is likelier than that, which it is not where the prediction is wide.

    Returns
    -------
    Assignment

    Notes
    -----
    Least sum of squared Mahalanobis distances plus logarithms of determinants (scipy's linear_sum_assignment), against
    a marker that is not seen and a blob of clutter (a marker is seen with a probability of 0.8); the clearest pairs are
    settled first, and the prediction of the others is conditioned on them. Two markers for which the
    swapped pair is nearly as likely get the mean and covariance over both explanations (a joint probabilistic data
    association of pairs; Bar-Shalom, Fortmann 1988).
    """
    mean = checks.array("predicted", predicted, (-1, 2), unit="px").copy()
    count = mean.shape[0]
    places, covariances = (np.array(each, np.float64, order="C") for each in (seen.places, seen.covariances))
    seen = seen._replace(places=places, covariances=covariances)
    prior = _joint(covariance, count)
    p = checks.number("gate_probability", gate_probability, sign="positive")
    if p >= 1.0:
        raise InvalidInput("gate_probability is none", got=p, allowed="between 0 and 1")
    limits = None if reach is None else checks.array("reach", reach, (max(count - 1, 0),), sign="positive", unit="px")
    density = np.broadcast_to(checks.array("clutter", np.atleast_1d(clutter), (-1,), sign="positive"), len(seen.places))
    unseen = 2.0 * np.log(density) - 2.0 * ODDS + 2.0 * math.log(2.0 * math.pi)
    forbidden = np.zeros((count, len(seen.places)), bool)
    while True:
        indices = _best(seen, mean, prior, -2.0 * math.log(1.0 - p), unseen, forbidden)
        distances, worst = _check_reach(seen, indices, mean, prior, limits)
        if worst < 0:
            break
        forbidden[worst, indices[worst]] = True
    places, covariances = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
    found = indices >= 0
    places[found], covariances[found] = seen.places[indices[found]], seen.covariances[indices[found]]
    swappable = _spread_swaps(seen, indices, mean, prior, places, covariances)
    return Assignment(indices, places, covariances, distances, swappable)


def _joint(covariance: npt.ArrayLike, count: int) -> Array:
    """Return the covariance of all predictions together (2 K, 2 K)."""
    given = np.array(covariance, dtype=np.float64, order="C")
    if given.shape == (2 * count, 2 * count):
        return given
    each = checks.array("covariance", given, (count, 2, 2), unit="px^2")
    result = np.zeros((count, 2, count, 2))
    result[np.arange(count), :, np.arange(count)] = each
    return result.reshape(2 * count, 2 * count)


def _best(
    seen: Observations, mean: Array, prior: Array, gate: float, unseen: Array, forbidden: npt.NDArray[np.bool_]
) -> npt.NDArray[np.int64]:
    """Return the observation (K,) of each marker, or -1.

    Where no pair is clear to begin with, each that the surest marker may have is tried, and the one kept that explains
    all markers together best.
    """
    if not forbidden.size:
        return np.full(len(mean), -1)

    def costs(mean: Array, P: Array) -> Array:
        """Return the cost (K, M) of each pair that is not forbidden."""
        return np.where(forbidden, _FORBIDDEN, _costs(seen, mean, P, gate, unseen))

    cost = costs(mean, prior)
    greedy = _settle(seen, mean, prior, cost, costs)
    if not (cost < _FORBIDDEN).any() or _margins(cost)[cost < _FORBIDDEN].max() > UNSURE or not _correlated(prior):
        return greedy
    widths = np.array([prior[2 * k, 2 * k] + prior[2 * k + 1, 2 * k + 1] for k in range(len(mean))])
    widths[(cost >= _FORBIDDEN).all(axis=1)] = np.inf
    surest, tries = int(np.argmin(widths)), [greedy]
    for j in np.flatnonzero(cost[surest] < _FORBIDDEN):
        given = np.full_like(cost, _FORBIDDEN)  # a pair that is settled before all others
        given[surest, j] = -_FORBIDDEN
        tries.append(_settle(seen, mean, prior, given, costs))
    return min(tries, key=lambda indices: _joint_cost(seen, mean, prior, unseen, indices))


def _correlated(prior: Array) -> bool:
    """Whether markers tell of each other at all."""
    count = len(prior) // 2
    off = prior.reshape(count, 2, count, 2).copy()
    off[np.arange(count), :, np.arange(count)] = 0.0
    return bool(off.any())


def _joint_cost(seen: Observations, mean: Array, prior: Array, unseen: Array, indices: npt.NDArray[np.int64]) -> float:
    """Return the cost of all pairs together against nothing but clutter being seen."""
    found = np.flatnonzero(indices >= 0)
    if not found.size:
        return 0.0
    off, S, _ = _innovation(seen, mean, prior, indices, found)
    return float(off @ np.linalg.solve(S, off) + np.linalg.slogdet(S)[1] + unseen[indices[found]].sum())


def _innovation(
    seen: Observations, mean: Array, prior: Array, indices: npt.NDArray[np.int64], found: npt.NDArray[np.intp]
) -> tuple[Array, Array, npt.NDArray[np.intp]]:
    """Return the innovation (2 F,) of the markers found, its covariance (2 F, 2 F), and its rows of the prior."""
    rows, count = np.asarray(2 * found[:, None] + [0, 1], np.intp).ravel(), np.arange(found.size)
    S = prior[np.ix_(rows, rows)]
    S.reshape(found.size, 2, found.size, 2)[count, :, count] += seen.covariances[indices[found]]
    return (seen.places[indices[found]] - mean[found]).ravel(), S, rows


def _settle(
    seen: Observations, mean: Array, prior: Array, cost: Array, costs: Callable[[Array, Array], Array]
) -> npt.NDArray[np.int64]:
    """Return the observation (K,) of each marker, or -1; the clearest first, the others conditioned on them.

    `costs` returns the cost (K, M) of each pair for a mean and its covariance; that of the first round is given.
    """
    from scipy.optimize import linear_sum_assignment

    count, many = cost.shape
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
        if _correlated(prior):
            off, S, own = _innovation(seen, mean, prior, indices, k)
            gain = np.linalg.solve(S, prior[own]).T
            mean, prior = mean + (gain @ off).reshape(-1, 2), prior - gain @ prior[own]
        cost = costs(mean, prior)
        cost[indices >= 0] = _FORBIDDEN
        cost[:, taken] = _FORBIDDEN
    return indices


def _costs(seen: Observations, mean: Array, P: Array, gate: float, unseen: Array) -> Array:
    """Return the cost (K, M) of each pair against marker unseen and blob of clutter; outside the gate: forbidden."""
    cost = np.empty((len(mean), len(seen.places)))
    pairs.pair_costs(seen.places, seen.covariances, mean, P, unseen, gate, _FORBIDDEN, cost)
    return cost


def _margins(cost: Array) -> Array:
    """Return by how much each pair (K, M) is better than the next one of its marker or observation, or than none."""
    others = np.zeros_like(cost)
    for each, best in ((cost, others), (cost.T, others.T)):
        if len(each) > 1:
            least, second = np.partition(each, 1, axis=0)[:2]
            np.minimum(best, np.where(each > least, least, second), out=best)
    return np.asarray(others - cost)


def _check_reach(
    seen: Observations, indices: npt.NDArray[np.int64], mean: Array, prior: Array, limits: Array | None
) -> tuple[Array, int]:
    """Return squared distances (K,), and which marker is to be given up since the rope is too short for it (or -1)."""
    count, found = len(indices), np.flatnonzero(indices >= 0)
    distances = np.full(count, np.nan)
    off = seen.places[indices[found]] - mean[found]
    S = prior.reshape(count, 2, count, 2)[found, :, found] + seen.covariances[indices[found]]
    distances[found] = (off * np.linalg.solve(S, off[:, :, None])[:, :, 0]).sum(axis=1)
    if limits is None:
        return distances, -1
    along = np.concatenate([[0.0], np.cumsum(limits)])[found]
    apart = np.linalg.norm(np.diff(seen.places[indices[found]], axis=0), axis=1)
    variances = np.trace(seen.covariances[indices[found]], axis1=1, axis2=2)
    beyond = apart > (1.0 + SLACK) * np.diff(along) + 3.0 * np.sqrt(variances[1:] + variances[:-1])
    if not beyond.any():
        return distances, -1
    one, two = found[np.argmax(beyond) :][:2]
    return distances, int(one if distances[one] > distances[two] else two)


def _spread_swaps(
    seen: Observations,
    indices: npt.NDArray[np.int64],
    mean: Array,
    prior: Array,
    places: Array,
    covariances: Array,
) -> npt.NDArray[np.bool_]:
    """Mark markers that may be swapped; their places and covariances become those over both explanations."""
    found = np.flatnonzero(indices >= 0)
    swappable = np.zeros(len(indices), bool)
    if found.size < 2:
        return swappable
    off, S, _ = _innovation(seen, mean, prior, indices, found)
    precision, dearer = np.linalg.inv(S), np.full((found.size, found.size), np.inf)  # the swapped pair than this one
    there = seen.places[indices[found]]
    pairs.swap_costs(there, precision, precision @ off, dearer)
    for a, b in np.argwhere(dearer < UNSURE).tolist():
        one, two, step = found[a], found[b], there[b] - there[a]
        swappable[[one, two]] = True
        share = 1.0 / (1.0 + math.exp(0.5 * max(float(dearer[a, b]), 0.0)))  # probability of the swapped pair
        spread = share * (1.0 - share) * np.outer(step, step)
        for k, side in ((one, 1.0), (two, -1.0)):
            places[k] = seen.places[indices[k]] + side * share * step
            covariances[k] = seen.covariances[indices[k]] + spread
    return swappable
