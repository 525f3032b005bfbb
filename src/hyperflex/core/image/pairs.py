"""Costs of pairs of a marker and a blob, and of two markers that swap their blobs."""

import numpy as np

from hyperflex.core.jit import kernel


@kernel
def pair_costs(places, covariances, mean, prior, unseen, gate, none, out):  # type: ignore[no-untyped-def]
    """Set the costs (K, M) of K markers for each of M blobs.

    Parameters
    ----------
    places, covariances : (M, 2), (M, 2, 2) float64
        Of the blobs, px, px^2.
    mean, prior : (K, 2), (2 K, 2 K) float64
        Where markers are expected, and the covariance of all together.
    unseen : (M,) float64
        Added to the squared Mahalanobis distance and the logarithm of the determinant.
    gate, none : float
        Squared distance from which a pair is none, and the cost of that.
    """
    for k in range(mean.shape[0]):
        for j in range(places.shape[0]):
            a = prior[2 * k, 2 * k] + covariances[j, 0, 0]
            b = prior[2 * k, 2 * k + 1] + covariances[j, 0, 1]
            d = prior[2 * k + 1, 2 * k + 1] + covariances[j, 1, 1]
            u, v = places[j, 0] - mean[k, 0], places[j, 1] - mean[k, 1]
            determinant = a * d - b * b
            squared = (d * u * u - 2.0 * b * u * v + a * v * v) / determinant
            out[k, j] = none if squared > gate else squared + np.log(determinant) + unseen[j]


def swap_costs(places, precision, pull):  # type: ignore[no-untyped-def]
    """By how much dearer it is (F, F), above the diagonal, that two of F markers have each other's blob; else inf.

    `places` (F, 2) are the blobs', px; `precision` (2 F, 2 F) is the inverse of the innovation's covariance, `pull`
    (2 F,) that times the innovation.
    """
    count = places.shape[0]
    blocks = precision.reshape(count, 2, count, 2).swapaxes(1, 2)
    own, pull = blocks[np.diag_indices(count)], pull.reshape(count, 2)
    way = places[None] - places[:, None]
    stiff = own[:, None] + own[None] - blocks - blocks.swapaxes(0, 1)
    dearer = ((2.0 * (pull[:, None] - pull[None]) + np.einsum("abij,abj->abi", stiff, way)) * way).sum(axis=2)
    return np.where(np.triu(np.ones((count, count)), 1) > 0.0, dearer, np.inf)
