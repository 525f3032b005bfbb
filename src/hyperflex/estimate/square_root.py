"""Covariances by their square roots: prediction, measurement update and log-likelihood by QR factorisation.

A covariance P is kept as an upper triangular S with P = S^T S. It stays symmetric and positive whatever rounding does
(Bierman 1977, Factorization Methods for Discrete Sequential Estimation; Kailath, Sayed and Hassibi 2000, section 12).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from hyperflex.checks import Array


class Innovation(NamedTuple):
    """How a measurement compares with its prediction.

    Attributes
    ----------
    whitened : (m,) float64
        The innovation divided by its standard deviation: independent, of variance 1, if the model is right.
    log_likelihood : float
        Of the measurement, given the prediction.
    """

    whitened: Array
    log_likelihood: float


def triangular(rows: Array) -> Array:
    """Return the upper triangular S (n, n) with S^T S = rows^T rows, for rows (m, n), m >= n."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def predicted(factor: Array, transition: Array, noise: Array) -> Array:
    """Return the factor of F P F^T + Q, for F (n, n) and rows `noise` (r, n) with Q = noise^T noise."""
    return triangular(np.concatenate([factor @ transition.T, noise]))


def updated(factor: Array, jacobian: Array, std: Array) -> Array:
    """Return the factor after a measurement with derivatives H (m, n) and independent noise `std` (m,)."""
    m, n = jacobian.shape
    both = np.zeros((m + n, m + n))
    both[range(m), range(m)] = std
    both[m:, :m] = factor @ jacobian.T
    both[m:, m:] = factor
    return triangular(both)[m:, m:]


def whitened_gain(factor: Array, jacobian: Array, std: Array) -> tuple[Array, Array]:
    """Return S H^T (H P H^T + R)^-1, (n, m), and the upper factor of H P H^T + R, (m, m), for noise `std` (m,).

    ``S^T`` times the first is the Kalman gain.
    """
    across = factor @ jacobian.T
    upper = triangular(np.concatenate([across, np.diag(std)]))
    half = solve_triangular(upper, across.T, trans="T", check_finite=False)
    return np.asarray(solve_triangular(upper, half, check_finite=False).T), upper


def compared(upper: Array, innovation: Array) -> Innovation:
    """Return a whitened innovation (m,) and its log-likelihood, for the upper factor of its covariance."""
    whitened = np.asarray(solve_triangular(upper, innovation, trans="T", check_finite=False))
    size = math.log(2.0 * math.pi) * innovation.size + 2.0 * np.log(np.abs(np.diag(upper))).sum()
    return Innovation(whitened, float(-0.5 * (whitened @ whitened + size)))
