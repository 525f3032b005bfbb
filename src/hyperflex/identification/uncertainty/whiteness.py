"""Whiteness of residuals: a portmanteau test and the correlogram."""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.uncertainty.noise import Piece
from hyperflex.interruption import raise_if_cancelled

CHANCE = 1e-3  # of residuals so coloured if noise were white: one false alarm in a thousand fits
LAGS = 10  # samples, or a quarter of the shortest window


def whiteness(parts: Sequence[Piece]) -> float:
    """Return the p-value of the residuals' autocorrelation under white noise; 1 where they are too few to tell.

    Portmanteau test: products of residuals k samples apart, k = 1..10, summed over channels and windows, are compared
    with their mean and covariance under white noise (Ljung and Box 1978, doi:10.1093/biomet/65.2.297; for several
    channels Hosking 1980, doi:10.1080/01621459.1980.10477520). Channels may be correlated with each other. The moments
    are those of noise projected as the fit projects it, since that alone makes residuals negatively correlated.
    """
    from scipy.special import gammaincc

    shortest = min(part.residual.shape[0] for part in parts)
    if shortest < 2 or not any(part.residual.any() for part in parts):
        return 1.0
    lags = np.arange(1, max(1, min(LAGS, shortest // 4)) + 1)
    spread = _channel_covariance(parts)
    away, covariance = np.zeros(lags.size), np.zeros((lags.size, lags.size))
    for part in parts:
        raise_if_cancelled()
        mean, varies = _moments(part, spread, lags)
        away += np.array([float((part.residual[k:] * part.residual[:-k]).sum()) for k in lags]) - mean
        covariance += varies
    statistic = float(away @ np.linalg.pinv(covariance, hermitian=True) @ away)
    return float(gammaincc(0.5 * lags.size, 0.5 * statistic))


def _channel_covariance(parts: Sequence[Piece]) -> Array:
    """Return the covariance (C, C) of the channels' noise."""
    products = sum(part.residual.T @ part.residual for part in parts)
    pairs = sum(part.seen.T @ part.seen for part in parts)
    taken = sum(float((part.basis**2).sum()) for part in parts)
    values = sum(float(part.seen.sum()) for part in parts)
    return np.asarray(products / np.maximum(pairs, 1.0) * values / max(1.0, values - taken))


def _moments(part: Piece, spread: Array, lags: Array) -> tuple[Array, Array]:
    """Return mean (K,) and covariance (K, K) of a window's sums of products, were its noise white.

    The residuals' covariance is M B M with M = 1 - Q Q^T, and B the channels' covariance at each instant:
    B + U D U^T with U = [Q, B Q].
    """
    basis = part.basis
    moved = part.seen[:, :, None] * np.einsum("cd,mdk->mck", spread, part.seen[:, :, None] * basis)
    both = np.concatenate([basis, moved], axis=2)
    count = basis.shape[2]
    inner = np.einsum("mck,mcl->kl", basis, moved)
    one = np.eye(count)
    middle = np.block([[inner, -one], [-one, np.zeros((count, count))]])
    flat = both.reshape(part.residual.size, -1)
    shifted = [_neighbours(both, int(k)) for k in lags]
    through = [flat.T @ each.reshape(flat.shape) for each in shifted]  # U^T A U
    mean = np.array([float((middle * each).sum()) for each in through])
    covariance = np.zeros((lags.size, lags.size))
    for a, k in enumerate(lags):
        together = part.seen[k:] * part.seen[:-k]
        covariance[a, a] += float((spread**2 * (together.T @ together)).sum())
        turned = part.seen[:, :, None] * np.einsum("cd,mdk->mck", spread, part.seen[:, :, None] * shifted[a])
        for b in range(lags.size):
            cross = turned.reshape(flat.shape).T @ shifted[b].reshape(flat.shape)
            covariance[a, b] += 4.0 * float((middle * cross).sum())
            covariance[a, b] += 2.0 * float(((middle @ through[a]) * (middle @ through[b]).T).sum())
    return mean, 0.5 * (covariance + covariance.T)


def _neighbours(values: Array, lag: int) -> Array:
    """Return half the sum of the values `lag` samples before and after each (m, ...), 0 beyond the ends."""
    result = np.zeros_like(values)
    result[lag:] += 0.5 * values[:-lag]
    result[:-lag] += 0.5 * values[lag:]
    return result


FILLED = 20  # a clock with more ticks than this for each sample would be nearly empty: neighbours are counted instead


def correlogram(t: Array, residuals: Array, lags: int) -> tuple[Array, Array, Array]:
    """Return the autocorrelation of residuals, gaps left out: lags, correlations, and a 95 % band of white noise.

    Parameters
    ----------
    t : (m,) array, s
        Increasing.
    residuals : (m, C) array
        NaN in gaps.
    lags : int
        The greatest lag, in samples.

    Returns
    -------
    lag (L,) s, from one (usual) step between samples on; correlation (L, C), NaN where no two samples are so far apart;
    band (L, C). Where a grid of the usual step would stay nearly empty, lags count samples.
    """
    step = float(np.median(np.diff(t)))
    tick = np.round((t - t[0]) / step).astype(int)
    if tick[-1] > FILLED * t.size or np.unique(tick).size < t.size:
        tick = np.arange(t.size)
    laid = np.full((tick[-1] + 1, residuals.shape[1]), np.nan)
    laid[tick] = residuals
    known = ~np.isnan(laid)
    filled = np.where(known, laid - np.nanmean(laid, axis=0), 0.0)
    variance = (filled**2).sum(axis=0) / known.sum(axis=0)
    number = np.arange(1, min(lags, tick[-1] // 2) + 1)
    pairs = np.array([(known[k:] & known[:-k]).sum(axis=0) for k in number]).reshape(number.size, -1)
    sums = np.array([(filled[k:] * filled[:-k]).sum(axis=0) for k in number]).reshape(number.size, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = sums / pairs / variance
        band = 1.96 / np.sqrt(pairs)
    return step * number, np.where(pairs > 0, correlation, np.nan), np.where(pairs > 0, band, np.nan)
