"""Costs of pairs of a marker and a blob."""

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
        Expected positions of the markers, and their joint covariance.
    unseen : (M,) float64
        Added to the squared Mahalanobis distance and the logarithm of the determinant.
    gate, none : float
        Squared distance above which a pair is excluded, and the cost of an excluded pair.
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
