"""How much of a residual its neighbours in time already tell."""

from __future__ import annotations

import numpy as np

from hyperflex.checks import Array

FILLED = 20  # a clock with more ticks than this for each sample would be nearly empty: neighbours are counted instead


def correlogram(t: Array, residuals: Array, lags: int) -> tuple[Array, Array, Array]:
    """Return the autocorrelation of residuals, gaps left out.

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
    lag : (L,) array, s
        From one (usual) step between samples on, at most `lags` of them.
    correlation : (L, C) array
        NaN where no two samples are so far apart.
    band : (L, C) array
        95 % of the correlations of white residuals lie within plus and minus this.

    Notes
    -----
    Samples are put on a clock of the usual step; with steps so uneven that it would stay nearly empty, the lag counts
    samples.
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
