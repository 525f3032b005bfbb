"""Autoregressive model of the residuals as noise, its order chosen by BIC."""

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
    # further terms in a row that BIC does not ask for before the search ends
    max_worse_terms: int = 2
    # greatest size of a partial autocorrelation: beyond it noise would almost never return to 0
    near_one: float = 0.995
    # greatest size of all partial autocorrelations but the first: beyond it terms make a tone that hardly dies away,
    # which is no noise, and whose size rounding decides
    later: float = 0.95
    # by which autocorrelations may miss those of the residuals before no process explains them
    agrees: float = 0.05
    # part of the sum of squared misses of autocorrelations that a step must gain for another one to follow
    least_gain: float = 0.01
    # autocorrelation of neighbours from which a line bridges a gap well
    smooth: float = 0.8


NOISE = NoiseOptions()


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
    """Return the a_j (k,) of r_t = sum of a_j r_(t - j) + white noise for the residuals, and whether it explains them.

    The process is stationary, one for all channels and windows; k, often 0, is chosen by BIC. Partial autocorrelations,
    bounded, are found by least squares, so that the process, less what the fit absorbs, has the residuals'
    autocorrelations. If none has, the terms are those of Yule and Walker for the residuals as they are. Times are taken
    as even. Cost: a few Fourier transforms (m, C K) a window.
    """
    longest = _longest(pieces)
    observed = _lagged_products(pieces, min(longest - 1, NOISE.most_terms))
    most = min(NOISE.most_terms, longest // 4)
    if observed[0] <= 0.0 or most == 0:
        return np.zeros(0), True
    target = observed / observed[0]
    count = max(2.0, float(sum(piece.seen.sum() - piece.basis.shape[2] for piece in pieces)))
    response = expected_products(pieces, most)
    plain = partial_correlations(target[: most + 1] * _of_pairs(pieces, most))
    parts = chosen = np.zeros(0)
    least, passed, gap = 0.0, 0, 0.0
    for k in range(1, most + 1):
        parts, misfit = _fit_correlations(response[: k + 1], target[1 : k + 1], np.append(parts, plain[k - 1]))
        if np.abs(parts[1:]).max(initial=0.0) > NOISE.later:
            break
        criterion = count * float(np.log(1.0 - parts**2).sum()) + parts.size * float(np.log(count))  # BIC
        passed += 1
        if criterion < least:
            passed, least, chosen, gap = 0, criterion, parts, misfit
        if passed == NOISE.max_worse_terms:
            break
    agrees = gap <= NOISE.agrees
    return ar_coefficients(chosen if agrees else plain[: chosen.size]), agrees


def partial_correlations(correlation: Array) -> Array:
    """Return the partial autocorrelations (k,) of autocorrelations (k + 1,), by Levinson's recursion."""
    parts, left = np.zeros(0), 1.0
    for k in range(1, correlation.size):
        terms = ar_coefficients(parts)
        part = (correlation[k] - terms @ correlation[k - 1 : 0 : -1]) / left
        parts = np.append(parts, np.clip(part, -NOISE.near_one, NOISE.near_one))
        left *= 1.0 - float(parts[-1]) ** 2
    return parts


def ar_coefficients(parts: Array) -> Array:
    """Return the autoregression (k,) of partial autocorrelations (k,); stationary if all are smaller than 1."""
    terms = np.zeros(0)
    for part in parts:
        terms = np.append(terms - part * terms[::-1], part)
    return terms


def correlations(terms: Array, count: int) -> Array:
    """Return the first autocorrelations (count,) of an autoregression (k,).

    The first k by Yule and Walker's equations, all others by the autoregression.
    """
    from scipy.linalg import hankel, toeplitz
    from scipy.signal import lfilter, lfiltic

    if not terms.size:
        return np.asarray(np.eye(1, count)[0])
    before, after = toeplitz(np.append(0.0, terms[:-1]), np.zeros(terms.size)), hankel(np.append(terms[1:], 0.0))
    first = np.append(1.0, np.linalg.solve(np.eye(terms.size) - before - after, terms))
    one, back = np.ones(1), np.append(1.0, -terms)
    return np.append(first, lfilter(one, back, np.zeros(count), zi=lfiltic(one, back, first[::-1]))[0])[:count]


def noise_memory(pieces: Sequence[Piece]) -> tuple[Array, bool]:
    """Return the autocorrelations (longest,) of the residuals' noise by lag, and whether they explain the residuals.

    Those of an autoregression. Gaps of smooth residuals are bridged by straight lines: the many terms of such residuals
    depend on differences of neighbours, which gaps blur.
    """
    longest = _longest(pieces)
    if longest > 1 and min(piece.seen.min() for piece in pieces) == 0.0 and _autocorrelations(pieces)[1] > NOISE.smooth:
        pieces = [_bridged(piece) for piece in pieces]
    terms, agrees = autoregression(pieces)
    return correlations(terms, longest), agrees


def _bridged(piece: Piece) -> Piece:
    """Return a window with a straight line through each gap of a channel; gaps at its ends stay.

    The fit's directions are bridged as well, each then scaled to the length it had: they absorb no more than before.
    """
    from scipy.interpolate import make_interp_spline

    both, seen = np.concatenate([piece.residual[:, :, None], piece.basis], axis=2), piece.seen.copy()
    for c in range(seen.shape[1]):
        known = np.flatnonzero(piece.seen[:, c])
        if known.size > 1:
            inside = np.arange(known[0], known[-1] + 1)
            both[inside, c] = make_interp_spline(known, both[known, c], k=1)(inside)
            seen[inside, c] = 1.0
    basis = both[:, :, 1:]
    before, now = (np.sqrt((each**2).sum(axis=(0, 1))) for each in (piece.basis, basis))
    return Piece(both[:, :, 0], seen, basis * np.divide(before, now, out=np.zeros_like(now), where=now > 0.0))


def correlated(memory: Array, values: Array) -> Array:
    """Return R values (m, ...): R (m, m) holds the autocorrelations `memory`, by lag."""
    from scipy.linalg import matmul_toeplitz

    if not memory[1:].any():
        return values
    m = values.shape[0]
    return np.asarray(matmul_toeplitz(memory[:m], values.reshape(m, -1), check_finite=False)).reshape(values.shape)


def channel_correlation(parts: Sequence[Piece], memory: Array) -> Array:
    """Return the covariance (C, C) of the channels' noise, over its mean variance.

    It is drawn to equal, independent channels as far as chance explains what differs from these: by the weight that
    makes its expected squared error least (Ledoit and Wolf 2004, doi:10.1016/S0047-259X(03)00096-4).
    """
    found = _channel_covariance(parts)
    seen = np.sum([part.seen.sum(axis=0) for part in parts], axis=0)
    mean = float(np.diag(found) @ seen) / max(float(seen.sum()), 1.0)
    if mean <= 0.0:
        return np.eye(len(found))
    found, own = found / mean, np.diag(found) / mean
    count = float(seen.mean()) / max(1.0, 2.0 * float(memory @ memory) - 1.0)
    chance = float((np.outer(own, own) + found**2).sum()) / max(count, 1.0)
    away = float(((found - np.eye(len(found))) ** 2).sum())
    part = min(1.0, chance / away) if away > 0.0 else 1.0
    return (1.0 - part) * found + part * np.eye(len(found))


def autocorrelation(pieces: Sequence[Piece]) -> float:
    """Return the integrated autocorrelation time (samples, >= 1) of the residuals, pooled over windows.

    1 + 2 sum of the autocorrelations up to the first below 0.05, each of the pairs of samples that are there.
    """
    part = _autocorrelations(pieces)
    end = int(np.argmax(np.append(part, 0.0) < 0.05))
    return max(1.0, float(1.0 + 2.0 * part[1:end].sum()))


def _autocorrelations(pieces: Sequence[Piece]) -> Array:
    """Return the residuals' own autocorrelations (longest,) over the pairs of samples that there are."""
    sums = _lagged_products(pieces, _longest(pieces) - 1)
    if sums[0] <= 0.0:
        return np.asarray(np.eye(1, sums.size)[0])
    return np.asarray(sums / sums[0] * _of_pairs(pieces, sums.size - 1))


def _of_pairs(pieces: Sequence[Piece], most: int) -> Array:
    """Return what sums of products (most + 1,) miss for gaps: the pairs there would be without any, over those seen."""
    seen, every = np.zeros((2, most + 1))
    for piece in pieces:
        m, channels = piece.seen.shape
        seen += _lagged(piece.seen, most)
        every += piece.seen.mean() * np.maximum(m - np.arange(most + 1), 0) * channels
    return every / np.maximum(seen, 1.0)


def expected_products(pieces: Sequence[Piece], most: int) -> Array:
    """Return the matrix (most + 1, m) from autocorrelations (m,) to expected `_lagged_products` (most + 1,).

    For noise of variance 1: the trace over lags of (1 - Q Q^T) R (1 - Q Q^T), Q the basis. R holds each autocorrelation
    on two diagonals, whose sums are products of Fourier transforms.
    """
    longest = max(most + 1, _longest(pieces))
    result = np.zeros((most + 1, longest))
    for piece in pieces:
        basis, pairs, m = piece.basis, _lagged(piece.seen, most), piece.residual.shape[0]
        spectrum = np.fft.rfft(basis, 2 * m, axis=0)
        crossed = spectrum.conj().swapaxes(1, 2) @ spectrum
        for lag in range(min(most + 1, m)):
            inner = np.einsum("tck,tcl->kl", basis[: m - lag], basis[lag:])
            near = piece.seen[:, :, None] * 2.0 * _neighbours(basis, lag)
            total = np.einsum("fkl,kl->f", crossed, inner)
            total -= np.einsum("fck,fck->f", np.fft.rfft(near, 2 * m, axis=0).conj(), spectrum)
            sums = np.fft.irfft(total, 2 * m)
            result[lag, 0] += sums[0]
            result[lag, 1:m] += sums[1:m] + sums[:m:-1]
            result[lag, lag] += pairs[lag]
    return result


def _fit_correlations(response: Array, target: Array, start: Array) -> tuple[Array, float]:
    """Return partial autocorrelations (k,) whose residuals show those target (k,), and the greatest miss."""
    from scipy.optimize import leastsq

    def miss(z: Array) -> Array:
        sums = response @ correlations(ar_coefficients(NOISE.near_one * np.tanh(z)), response.shape[1])
        return sums[1:] / max(float(sums[0]), 1e-300) - target

    z = np.arctanh(np.clip(start / NOISE.near_one, -0.99, 0.99))
    z = leastsq(miss, z, ftol=NOISE.least_gain)[0]
    return NOISE.near_one * np.tanh(z), float(np.abs(miss(z)).max())


def _longest(pieces: Sequence[Piece]) -> int:
    return max(len(piece.residual) for piece in pieces)


def _lagged_products(pieces: Sequence[Piece], most: int) -> Array:
    """Return the sums (most + 1,) of products of residuals so many samples apart."""
    return np.asarray(sum(_lagged(piece.residual, most) for piece in pieces))


def _lagged(values: Array, most: int) -> Array:
    """Return the sums (most + 1,) of products of values (m, C) 0 to `most` samples apart."""
    raise_if_cancelled()
    m = len(values)
    spectrum = np.fft.rfft(values, m + min(most, m), axis=0)  # zeros, so that no product joins the end to the beginning
    sums = np.fft.irfft((spectrum.real**2 + spectrum.imag**2).sum(axis=1), m + min(most, m))[: most + 1]
    return np.append(sums[:m], np.zeros(max(most + 1 - m, 0)))


CHANCE = 1e-3  # of residuals so coloured if noise were white: one false alarm in a thousand fits
LAGS = 10  # samples, or a quarter of the shortest window


def whiteness(parts: Sequence[Piece]) -> float:
    """Return the p-value of the residuals' autocorrelation under white noise; 1 where they are too few.

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
        mean, varies = _moments(part, spread, lags)
        away += _lagged(part.residual, lags.size)[1:] - mean
        covariance += varies
    statistic = float(away @ np.linalg.pinv(covariance, hermitian=True) @ away)
    return float(gammaincc(0.5 * lags.size, 0.5 * statistic))


def _channel_covariance(parts: Sequence[Piece]) -> Array:
    """Return the covariance (C, C) of the channels' noise."""
    products = sum(part.residual.T @ part.residual for part in parts)
    pairs = sum(part.seen.T @ part.seen for part in parts)
    taken = sum(float((part.basis**2).sum()) for part in parts)
    values = sum(float(part.seen.sum()) for part in parts)
    return products / np.maximum(pairs, 1.0) * values / max(1.0, values - taken)


def _moments(part: Piece, spread: Array, lags: Array) -> tuple[Array, Array]:
    """Return mean (K,) and covariance (K, K) of a window's sums of products, were its noise white.

    The residuals' covariance is M B M with M = 1 - Q Q^T, and B the channels' covariance at each instant:
    B + U D U^T with U = [Q, B Q].
    """

    def spreading(values: Array) -> Array:
        return np.asarray(part.seen[:, :, None] * np.einsum("cd,mdk->mck", spread, part.seen[:, :, None] * values))

    basis, one, size = part.basis, np.eye(part.basis.shape[2]), part.residual.size
    moved = spreading(basis)
    both, inner = np.concatenate([basis, moved], axis=2), np.einsum("mck,mcl->kl", basis, moved)
    middle = np.block([[inner, -one], [-one, np.zeros_like(one)]])
    shifted = [_neighbours(both, int(k)) for k in lags]
    turned = np.stack([(spreading(each) @ middle).ravel() for each in shifted])
    flat = np.stack([each.ravel() for each in shifted])
    through = middle @ (both.reshape(size, -1).T @ flat.reshape(lags.size, size, -1))  # D U^T A U
    together = [part.seen[k:] * part.seen[:-k] for k in lags]
    covariance = np.diag([float((spread**2 * (each.T @ each)).sum()) for each in together])
    covariance += 4.0 * turned @ flat.T
    covariance += 2.0 * np.einsum("aij,bji->ab", through, through)
    return np.trace(through, axis1=1, axis2=2), 0.5 * (covariance + covariance.T)


def _neighbours(values: Array, lag: int) -> Array:
    """Return half the sum of the values `lag` samples before and after each (m, ...), 0 beyond the ends."""
    result, m = np.zeros_like(values), len(values)
    result[lag:] += 0.5 * values[: m - lag]
    result[: m - lag] += 0.5 * values[lag:]
    return result
