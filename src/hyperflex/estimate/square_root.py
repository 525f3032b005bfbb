"""Covariances by their square roots: prediction, measurement update and log-likelihood by QR factorisation.

A covariance P (n, n) is kept as rows S (r, n) with P = S^T S. It stays symmetric and positive despite rounding
(Bierman 1977, Factorization Methods for Discrete Sequential Estimation; Kailath, Sayed and Hassibi 2000, section 12).
A rope's joints soon damp motion that is not smooth: a few rows then represent all that is not negligible, and only
those are propagated through its equations (Verlaan and Heemink 1997, Stochastic Hydrology and Hydraulics 11).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dgeqrf, dpotrs, dpstrf, dtrtrs

from hyperflex.checks import Array

SHORTEST = 1e-2  # part of a Gauss-Newton step
CLOSE = 0.03  # of a standard deviation: an update has converged


class Innovation(NamedTuple):
    """Comparison of a measurement with its prediction.

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
    """Return the upper triangular R (n, n), its diagonal not negative, with R^T R = rows^T rows, for rows (m, n)."""
    upper = np.asarray(np.triu(dgeqrf(rows)[0][: rows.shape[1]]))
    return upper * np.where(np.diag(upper) < 0.0, -1.0, 1.0)[:, None]


def solved(upper: Array, right: Array, *, transposed: bool = False) -> Array:
    """Return U^-1 B, or U^-T B, for an upper triangular U (m, m) without zeros on its diagonal (LAPACK's dtrtrs)."""
    return np.asarray(dtrtrs(upper, right, trans=int(transposed))[0])


def compressed(rows: Array, least: Array) -> Array:
    """Return r <= n rows S (r, n) with S^T S = rows^T rows up to negligible differences.

    Parameters
    ----------
    rows : (m, n) float64
    least : (n,) float64
        Negligible standard deviation of each state, > 0.

    Notes
    -----
    A Cholesky factorisation with pivoting (LAPACK's dpstrf) of the covariance over `least` gives rows of decreasing
    size, and ends when no remaining variance of a state is above 1. Squares lose half of the digits, which is
    sufficient for that. It takes a third of the time of a QR factorisation of the rows.
    """
    even = rows / least
    upper, pivots, rank, _ = dpstrf(even.T @ even, tol=1.0, overwrite_a=True)
    result = np.zeros((max(1, rank), rows.shape[1]))
    result[:rank, pivots - 1] = np.triu(upper[:rank])
    return result * least


def updated(factor: Array, across: Array, upper: Array) -> Array:
    """Return the factor S after a measurement, for A and U of :func:`innovation_factor`.

    S - A (U + 1)^-1 U^-T A^T S (Andrews 1968, AIAA Journal 6(6), 1165).
    """
    half = solved(upper, across.T @ factor, transposed=True)
    return factor - across @ solved(upper + np.eye(len(upper)), half)


def innovation_factor(factor: Array, jacobian: Array) -> tuple[Array, Array]:
    """Return A = S H^T (r, m), and the upper triangular U (m, m) with U^T U = H P H^T + 1.

    `jacobian` are the derivatives H (m, n) of a measurement of unit noise.
    """
    across = factor @ jacobian.T
    return across, triangular(np.concatenate([across, np.eye(len(jacobian))]))


def weighted(upper: Array, right: Array) -> Array:
    """Return (U^T U)^-1 B for an upper triangular U (m, m)."""
    return np.asarray(dpotrs(upper, right)[0])


def compared(upper: Array, innovation: Array) -> Innovation:
    """Return a whitened innovation (m,) and its log-likelihood, for the upper factor of its covariance."""
    whitened = solved(upper, innovation, transposed=True)
    size = math.log(2.0 * math.pi) * innovation.size + 2.0 * np.log(np.abs(np.diag(upper))).sum()
    return Innovation(whitened, float(-0.5 * (whitened @ whitened + size)))


def iterated_update(
    before: Array,
    factor: Array,
    compared: Callable[[Array], tuple[Array, Array]],
    rounds: int,
    first: tuple[Array, Array, Array, Array],
) -> tuple[Array, Array]:
    """Return the mode of the posterior, by Gauss-Newton with a line search, and rows of the covariance about it.

    Parameters
    ----------
    before : (N,) float64
        The state before.
    factor : (r, N) float64
        Rows of its covariance.
    compared : callable
        Of a state, returns whitened differences (m,) and the whitened derivatives (m, N).
    rounds : int
        At most.
    first : (m,), (m, N), (r, m), (m, m) float64
        What `compared` returns of the state before, and :func:`innovation_factor` of these derivatives.

    Notes
    -----
    A step that does not reduce the cost is halved; if no part of it does, the state is not changed.
    Bell, Cathey 1993, IEEE Transactions on Automatic Control 38, 294-297: the iterated extended Kalman filter.
    """
    u, x, (left, jacobian, across, upper) = np.zeros(len(factor)), before, first  # the state is before + factor' u
    cost = float(left @ left)
    for _ in range(rounds):
        step, part = across @ weighted(upper, left + jacobian @ (x - before)) - u, 1.0
        while part >= SHORTEST:
            tried = before + factor.T @ (u + part * step)
            there = compared(tried)
            now = float(((u + part * step) ** 2).sum() + (there[0] ** 2).sum())
            if now <= cost:
                break
            part *= 0.5
        else:  # rounding, or what is seen is not smooth: nothing better is near
            break
        x, u, cost, (left, jacobian) = tried, u + part * step, now, there
        across, upper = innovation_factor(factor, jacobian)
        if part * np.abs(step).max() < CLOSE:
            break
    return x, updated(factor, across, upper)
