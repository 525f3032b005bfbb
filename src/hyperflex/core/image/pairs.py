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


@kernel
def swap_costs(places, precision, pull, out):  # type: ignore[no-untyped-def]
    """Set by how much dearer it is (F, F), above the diagonal, that two of F markers have each other's blob.

    `places` (F, 2) are the blobs', px; `precision` (2 F, 2 F) is the inverse of the innovation's covariance, `pull`
    (2 F,) that times the innovation.
    """
    for a in range(places.shape[0]):
        for b in range(a + 1, places.shape[0]):
            i, j = 2 * a, 2 * b
            u, v = places[b, 0] - places[a, 0], places[b, 1] - places[a, 1]
            xx = precision[i, i] + precision[j, j] - 2.0 * precision[i, j]
            xy = precision[i, i + 1] + precision[j, j + 1] - precision[i, j + 1] - precision[j, i + 1]
            yy = precision[i + 1, i + 1] + precision[j + 1, j + 1] - 2.0 * precision[i + 1, j + 1]
            pulled = (pull[i] - pull[j]) * u + (pull[i + 1] - pull[j + 1]) * v
            out[a, b] = 2.0 * pulled + xx * u * u + 2.0 * xy * u * v + yy * v * v
