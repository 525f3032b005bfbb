"""What the residuals are like as noise: how they hang together in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array

MOST_TERMS = 8  # of the autoregression
ROUNDS = 8  # of giving back what the fit has absorbed
NEAR_ONE = 0.995  # greatest size of a partial autocorrelation: beyond it noise would hardly ever return to 0


@dataclass(frozen=True)
class Piece:
    """One window's residuals.

    residual (m, C): weighted; seen (m, C): 0 in gaps, else 1; basis (m, C, K): orthonormal over m C, what fitted states
    and parameters can absorb.
    """

    residual: Array
    seen: Array
    basis: Array


def autoregression(pieces: Sequence[Piece]) -> Array:
    """Return the coefficients (k,) of r_t = sum of a_j r_(t - j) + white noise that the residuals show; often k = 0.

    All channels and windows are taken as pieces of one stationary process. Its autocorrelations are those which, after
    the fit has absorbed its part, leave the residuals' own; k is chosen by BIC. Lags count samples: times are taken as
    even. Cost: a few products of (m, m) and (m, C K) a window.
    """
    observed = _lagged(pieces)
    longest = max(piece.residual.shape[0] for piece in pieces)
    terms = min(MOST_TERMS, longest // 4)
    if observed[0] <= 0.0 or terms == 0:
        return np.zeros(0)
    wanted = observed[: terms + 1] / observed[0]
    count = float(sum(piece.seen.sum() - piece.basis.shape[2] for piece in pieces))
    white = _expected(pieces, np.zeros(0), terms)
    start = np.clip(wanted[1:] - white[1:] / white[0], -NEAR_ONE, NEAR_ONE)
    order = _order(np.append(1.0, start), max(count, 2.0))
    correlation = start[:order]
    found = levinson(np.append(1.0, correlation))[0]
    for _ in range(ROUNDS if order else 0):
        expected = _expected(pieces, found, order)
        correlation = correlation + wanted[1 : order + 1] - expected[1:] / expected[0]
        found = levinson(np.append(1.0, correlation))[0]
        correlation = correlations(found, order + 1)[1:]
    return found


def levinson(correlation: Array) -> tuple[Array, Array]:
    """Return the autoregression (k,) of autocorrelations (k + 1,), and what each further term leaves (k + 1,) of 1."""
    terms, left = np.zeros(0), [1.0]
    for k in range(1, correlation.size):
        part = (correlation[k] - terms @ correlation[k - 1 : 0 : -1]) / left[-1]
        part = float(np.clip(part, -NEAR_ONE, NEAR_ONE))
        terms = np.append(terms - part * terms[::-1], part)
        left.append(left[-1] * (1.0 - part**2))
    return terms, np.array(left)


def correlations(terms: Array, count: int) -> Array:
    """Return the first autocorrelations (count,) of an autoregression (k,)."""
    k = terms.size
    result = np.zeros(count)
    result[0] = 1.0
    if k:
        matrix, right = np.eye(k), terms.copy()
        for lag in range(1, k + 1):
            for j in range(1, k + 1):
                if j != lag:
                    matrix[lag - 1, abs(lag - j) - 1] -= terms[j - 1]
        first = np.linalg.solve(matrix, right)
        result[1 : k + 1] = first[: count - 1]
        for lag in range(k + 1, count):
            result[lag] = terms @ result[lag - k : lag][::-1]
    return result


def coloured(terms: Array, values: Array) -> Array:
    """Return R values (m, ...): R (m, m) are the autocorrelations of an autoregression."""
    if terms.size == 0:
        return values
    m = values.shape[0]
    lags = np.abs(np.subtract.outer(np.arange(m), np.arange(m)))
    result: Array = np.tensordot(correlations(terms, m)[lags], values, axes=1)
    return result


def autocorrelation(residuals: Sequence[Array]) -> float:
    """Return the integrated autocorrelation time (samples, >= 1) of residuals [(m, n), ..], pooled over windows.

    1 + 2 sum of the autocorrelations up to the first below 0.05.
    """
    longest = max(r.shape[0] for r in residuals)
    sums = np.zeros(longest)
    for r in residuals:
        for lag in range(r.shape[0]):
            sums[lag] += float((r[lag:] * r[: r.shape[0] - lag]).sum())
    if sums[0] <= 0.0:
        return 1.0
    part = sums / sums[0]
    low = np.flatnonzero(part < 0.05)
    end = int(low[0]) if low.size else longest
    return max(1.0, float(1.0 + 2.0 * part[1:end].sum()))


def _order(correlation: Array, count: float) -> int:
    """Return how many terms BIC asks for."""
    left = levinson(correlation)[1]
    terms = np.arange(left.size)
    return int(np.argmin(count * np.log(left) + terms * np.log(count)))


def _lagged(pieces: Sequence[Piece]) -> Array:
    """Return the sums of products of residuals so many samples apart."""
    longest = max(piece.residual.shape[0] for piece in pieces)
    sums = np.zeros(min(longest, MOST_TERMS + 1))
    for piece in pieces:
        for lag in range(min(sums.size, piece.residual.shape[0])):
            sums[lag] += _apart(piece.residual, piece.residual, lag)
    return sums


def _apart(first: Array, second: Array, lag: int) -> float:
    """Return the sum of products of values `lag` samples apart; of what is (m, C) or (m, C, K)."""
    return float((first[lag:] * second[: second.shape[0] - lag]).sum())


def _expected(pieces: Sequence[Piece], terms: Array, most: int) -> Array:
    """Return what `_lagged` would be on average (most + 1,), for noise of variance 1 with such autocorrelations.

    The trace over lags of (1 - Q Q^T) R (1 - Q Q^T), Q the basis.
    """
    sums = np.zeros(most + 1)
    for piece in pieces:
        basis, shape = piece.basis, piece.residual.shape
        own = correlations(terms, max(shape[0], most + 1))
        turned = coloured(terms, basis) * piece.seen[:, :, None]
        inner = np.einsum("mck,mcl->kl", basis, turned)
        twice = basis @ inner
        for lag in range(min(most + 1, shape[0])):
            sums[lag] += own[lag] * _apart(piece.seen, piece.seen, lag) + _apart(basis, twice, lag)
            sums[lag] -= _apart(basis, turned, lag) + _apart(turned, basis, lag)
    return sums
