"""Autoregressive model of the residuals as noise, its order chosen by BIC, and a test of whether they are white."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.interruption import raise_if_cancelled


@dataclass(frozen=True)
class NoiseOptions:
    """Order and fit of the autoregression."""

    # of the autoregression
    most_terms: int = 8
    # further terms in a row that do not improve BIC before the search ends
    max_worse_terms: int = 2
    # greatest size of a partial autocorrelation: beyond it noise would hardly ever return to 0
    near_one: float = 0.995
    # greatest size of all partial autocorrelations but the first: tones that hardly die away are no noise
    later: float = 0.95
    # largest difference from the autocorrelations of the residuals for which a process explains them
    agrees: float = 0.05
    # relative change of the sum of squared differences at which the search for a process ends
    settled: float = 0.01
    # autocorrelation of neighbours from which a line bridges a gap well
    smooth: float = 0.8


NOISE = NoiseOptions()
NEGLIGIBLE = 0.05  # an autocorrelation below it, and all at longer lags, do not count


@dataclass(frozen=True)
class Piece:
    """One window's residuals.

    residual (m, C): weighted; seen (m, C): 0 in gaps, else 1; basis (m, C, K): orthonormal over m C, what fitted states
    and parameters can absorb.
    """

    residual: Array
    seen: Array
    basis: Array


def autoregression(pieces: Sequence[Piece]) -> tuple[Array, bool]:
    """Return the partial autocorrelations (k,) of the residuals' noise, and whether it explains the residuals.

    The noise is an autoregression, stationary, one for all channels and windows; k, often 0, is chosen by BIC. The
    partial autocorrelations, bounded, are those with which the process, less what the fit absorbs, comes nearest to the
    residuals' autocorrelations. If none comes near, they are those of the residuals as they are. Times are taken as
    even. Cost: a few Fourier transforms (m, C K) a window.
    """
    longest = _longest(pieces)
    most = min(NOISE.most_terms, longest // 4)
    observed = np.array([_lagged_products(pieces, lag) for lag in range(most + 1)])
    if observed[0] <= 0.0 or most == 0:
        return np.zeros(0), True
    target = observed / observed[0]
    count = max(2.0, float(sum(piece.seen.sum() - piece.basis.shape[2] for piece in pieces)))
    parts, agrees = _nearest_process(expected_products(pieces, most), target, count)
    return (parts if agrees else _nearest_process(np.eye(most + 1, longest), target, count)[0]), agrees


def _nearest_process(response: Array, target: Array, count: float) -> tuple[Array, bool]:
    """Return the process whose autocorrelations, times `response`, are nearest to a target (L,), and whether near.

    `count`: of the values that the target comes from.
    """
    from scipy.optimize import least_squares

    def differences(parts: Array) -> Array:
        sums = response[: parts.size + 1] @ correlations(parts, response.shape[1])
        return np.asarray(sums[1:] / max(float(sums[0]), 1e-300) - target[1 : parts.size + 1])

    parts, least, worse, chosen, gap = np.zeros(0), 0.0, 0, np.zeros(0), 0.0
    for k in range(1, target.size):
        bound = np.append(NOISE.near_one, np.full(k - 1, NOISE.later))
        found = least_squares(differences, np.append(parts, 0.0), bounds=(-bound, bound), ftol=NOISE.settled)
        parts = found.x
        bic = count * float(np.log(1.0 - parts**2).sum()) + k * float(np.log(count))
        worse = 0 if bic < least else worse + 1
        if worse == 0:
            least, chosen, gap = bic, parts, float(np.abs(found.fun).max())
        if worse == NOISE.max_worse_terms:
            break
    return chosen, gap <= NOISE.agrees


def correlations(parts: Array, count: int) -> Array:
    """Return the first autocorrelations (count,) of an autoregression with partial autocorrelations (k,).

    By Levinson's recursion; the process is stationary if all of them are smaller than 1.
    """
    terms, left, result = np.zeros(0), 1.0, np.ones(count)
    for lag in range(1, count):
        result[lag] = terms @ result[lag - terms.size : lag][::-1]
        if lag <= parts.size:
            part = parts[lag - 1]
            result[lag] += part * left
            terms = np.append(terms - part * terms[::-1], part)
            left *= 1.0 - part**2
    return result


def noise_memory(pieces: Sequence[Piece]) -> tuple[Array, bool]:
    """Return the autocorrelations (longest,) of the residuals' noise by lag, and whether they explain the residuals.

    Those of an autoregression. Gaps of smooth residuals are bridged for it by straight lines: its many terms follow
    from differences of neighbours, which gaps blur.
    """
    gaps = min(piece.seen.min() for piece in pieces) == 0.0
    if gaps and _longest(pieces) > 1 and _autocorrelations(pieces)[1] > NOISE.smooth:
        pieces = [_bridged(piece) for piece in pieces]
    parts, agrees = autoregression(pieces)
    return correlations(parts, _longest(pieces)), agrees


def _bridged(piece: Piece) -> Piece:
    """Return a window with a straight line through each gap of a channel; gaps at its ends stay.

    The fit's directions are bridged as well, each then scaled to the length it had: they absorb no more than before.
    """
    from scipy.interpolate import make_interp_spline

    both, seen = np.concatenate([piece.residual[:, :, None], piece.basis], axis=2), piece.seen.copy()
    for c, known in enumerate(map(np.flatnonzero, piece.seen.T)):
        if known.size > 1:
            inside = np.arange(known[0], known[-1] + 1)
            both[inside, c] = make_interp_spline(known, both[known, c], k=1)(inside)
            seen[inside, c] = 1.0
    basis = both[:, :, 1:]
    before, now = (np.sqrt((each**2).sum(axis=(0, 1))) for each in (piece.basis, basis))
    return Piece(both[:, :, 0], seen, basis * np.divide(before, now, out=np.zeros_like(now), where=now > 0.0))


def correlated(memory: Array, values: Array) -> Array:
    """Return R values (m, ...): R (m, m) holds the autocorrelations `memory`, by lag."""
    if not memory[1:].any():
        return values
    m = values.shape[0]
    lags = np.abs(np.subtract.outer(np.arange(m), np.arange(m)))
    return np.asarray(np.tensordot(memory[lags], values, axes=1))


def autocorrelation(pieces: Sequence[Piece]) -> float:
    """Return the integrated autocorrelation time (samples, >= 1) of the residuals, pooled over windows.

    1 + 2 sum of the autocorrelations up to the first below 0.05, each of the pairs of samples that are there.
    """
    part = _autocorrelations(pieces)
    low = np.flatnonzero(part < NEGLIGIBLE)
    return max(1.0, float(1.0 + 2.0 * part[1 : low[0] if low.size else None].sum()))


def _autocorrelations(pieces: Sequence[Piece]) -> Array:
    """Return the residuals' own autocorrelations (longest,) over the pairs of samples that there are.

    Sums of products lack some pairs where there are gaps: they are scaled to the pairs there would be without any.
    """
    sums, pairs, every = np.zeros((3, _longest(pieces)))
    for piece in pieces:
        raise_if_cancelled()
        m = len(piece.seen)
        sums[:m] += [_lagged_product(piece.residual, lag) for lag in range(m)]
        pairs[:m] += [_lagged_product(piece.seen, lag) for lag in range(m)]
        every[:m] += piece.seen.mean() * (m - np.arange(m)) * piece.seen.shape[1]
    return np.asarray(sums / max(sums[0], 1e-300) * every / np.maximum(pairs, 1.0))


def expected_products(pieces: Sequence[Piece], most: int) -> Array:
    """Return the matrix (most + 1, m) from autocorrelations (m,) to expected products of residuals (most + 1,).

    For noise of variance 1: the trace over lags of (1 - Q Q^T) R (1 - Q Q^T), Q the basis. R holds each autocorrelation
    on two diagonals, whose sums are products of Fourier transforms.
    """
    result = np.zeros((most + 1, max(most + 1, _longest(pieces))))
    for piece in pieces:
        raise_if_cancelled()
        basis, seen, m = piece.basis, piece.seen, piece.residual.shape[0]
        spectrum = np.fft.rfft(basis, 2 * m, axis=0)
        crossed = spectrum.conj().swapaxes(1, 2) @ spectrum
        for lag in range(min(most + 1, m)):
            near = _neighbours(basis, lag)
            total = np.einsum("fkl,kl->f", crossed, np.einsum("tck,tcl->kl", basis, near))
            seen_near = np.fft.rfft(seen[:, :, None] * near, 2 * m, axis=0)
            sums = np.fft.irfft(total - 2.0 * np.einsum("fck,fck->f", seen_near.conj(), spectrum), 2 * m)
            result[lag, 0] += sums[0]
            result[lag, 1:m] += sums[1:m] + sums[:m:-1]
            result[lag, lag] += _lagged_product(seen, lag)
    return result


def _longest(pieces: Sequence[Piece]) -> int:
    return max(len(piece.residual) for piece in pieces)


def _lagged_products(pieces: Sequence[Piece], lag: int) -> float:
    """Return the sum of products of all residuals `lag` samples apart."""
    return sum(_lagged_product(piece.residual, lag) for piece in pieces)


def _lagged_product(values: Array, lag: int) -> float:
    """Return the sum of products of values (m, C) `lag` samples apart."""
    return float((values[lag:] * values[: max(values.shape[0] - lag, 0)]).sum())


def _neighbours(values: Array, lag: int) -> Array:
    """Return half the sum of the values `lag` samples before and after each (m, ...), 0 beyond the ends."""
    result, m = np.zeros_like(values), values.shape[0]
    result[lag:] += 0.5 * values[: m - lag]
    result[: m - lag] += 0.5 * values[lag:]
    return result


CHANCE = 1e-3  # of residuals so coloured if noise were white: one false alarm in a thousand fits
LAGS = 10  # samples, or a quarter of the shortest window


def whiteness(pieces: Sequence[Piece]) -> float:
    """Return the p-value of the residuals' autocorrelation under white noise; 1 where they are too few to tell.

    Portmanteau test: products of residuals k samples apart, k = 1..10, summed over channels and windows, are compared
    with their mean and variance under white noise (Ljung and Box 1978, doi:10.1093/biomet/65.2.297; for several
    channels Hosking 1980, doi:10.1080/01621459.1980.10477520). Channels may be correlated with each other. The mean is
    that of noise projected as the fit projects it, since that alone makes residuals negatively correlated.
    """
    from scipy.special import gammaincc

    shortest = min(len(piece.residual) for piece in pieces)
    if shortest < 2 or not any(piece.residual.any() for piece in pieces):
        return 1.0
    lags = range(max(1, min(LAGS, shortest // 4)) + 1)
    products = np.array([_lagged_products(pieces, k) for k in lags])
    expected = expected_products(pieces, lags[-1])[:, 0]
    pairs = np.array([sum(piece.seen[k:].T @ piece.seen[: len(piece.seen) - k] for piece in pieces) for k in lags])
    channels = sum(piece.residual.T @ piece.residual for piece in pieces) / np.maximum(pairs[0], 1.0)
    away, variance = products - products[0] * expected / expected[0], (channels**2 * pairs).sum(axis=(1, 2))
    return float(gammaincc(0.5 * lags[-1], 0.5 * float((away[1:] ** 2 / variance[1:]).sum())))


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
    known, filled = (~np.isnan(laid)).astype(np.float64), np.nan_to_num(laid - np.nanmean(laid, axis=0))
    number = np.arange(1, min(lags, tick[-1] // 2) + 1)
    shape = (number.size, residuals.shape[1])
    pairs, sums = (np.reshape([(e[k:] * e[:-k]).sum(axis=0) for k in number], shape) for e in (known, filled))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = sums / pairs / (filled**2).sum(axis=0) * known.sum(axis=0)
        band = 1.96 / np.sqrt(pairs)
    return step * number, np.where(pairs > 0, correlation, np.nan), np.where(pairs > 0, band, np.nan)
