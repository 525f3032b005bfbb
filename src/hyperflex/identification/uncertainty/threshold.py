"""Thresholds of the profile likelihood, also near bounds (Feldman and Cousins).

Away from bounds the rise over the residual variance follows F(1, freedom). Beside a bound it does not: an estimate
that noise would push beyond stays at the bound. There the distribution is that of the linear problem with the bounds,
taken at the very value that is tested, so that intervals contain the truth as often as stated, whether the truth lies
at the bound, near it or far off (the construction of Feldman and Cousins 1998, doi:10.1103/PhysRevD.57.3873).
"""

import functools

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array

NEAR = 4.0  # std: a bound so far off is not felt
DRAWS = 4000  # their chance error is mostly cancelled by that of the F quantile on the same draws
SWEEPS = 300  # of coordinate descent, at most
SETTLED = 1e-4  # std
SEED = 1
Mask = npt.NDArray[np.bool_]


def quantile(level: float, freedom: float) -> float:
    """Return the quantile of F(1, freedom): the square of Student's."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 * (1.0 + level))) ** 2


def near_bounds(covariance: Array, above: Array) -> Mask:
    """Return which parameters (P,) are less than NEAR standard deviations `above` their bounds (P,), inf for none."""
    std = np.sqrt(np.diag(covariance))
    return np.asarray((above < NEAR * std) & (std > 0.0))


def threshold(level: float, freedom: float, which: int, covariance: Array, above: Array) -> float:
    """Return the rise, over the residual variance, at which the value of parameter `which` is refused at a `level`.

    `freedom` is of the residual variance; covariance (P, P) as it would be without bounds; above (P,) the distances
    above the bounds, at the tested value and the others' estimates there, inf where there is no bound. The others are
    at their estimates, not at the truth: the level is reached nearly, not exactly. About 1 ms a bound that is near.
    """
    usual = quantile(level, freedom)
    chosen = np.flatnonzero(near_bounds(covariance, above))
    others = chosen[chosen != which]
    if chosen.size == 0:
        return usual
    index = np.append(which, others)
    part = covariance[np.ix_(index, index)]
    std = np.sqrt(np.diag(part))
    scaled = part / np.outer(std, std)
    normal, size = _draws(index.size, freedom)
    values, vectors = np.linalg.eigh(scaled)
    shifted = normal @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    inverse = np.linalg.pinv(scaled, rcond=1e-10, hermitian=True)
    limit = np.where(np.isfinite(above[index]), -above[index] / std, -np.inf)
    rise = _rise(shifted, inverse, limit, tested=True) - _rise(shifted, inverse, limit, tested=False)
    plain = shifted[:, 0] ** 2
    return usual * float(np.quantile(rise / size, level) / np.quantile(plain / size, level))


@functools.lru_cache(maxsize=8)
def _draws(count: int, freedom: float) -> tuple[Array, Array]:
    """Return normal draws (DRAWS, count), and of the residual variance over its mean (DRAWS,)."""
    random = np.random.default_rng(SEED)
    half = random.standard_normal((DRAWS // 2, count))
    size = random.chisquare(min(freedom, 1e6), DRAWS // 2) / min(freedom, 1e6)
    return np.concatenate([half, -half]), np.concatenate([size, size])


def _rise(points: Array, inverse: Array, limit: Array, *, tested: bool) -> Array:
    """Return the least (v - u)^T H (v - u) over v >= limit for each u (N, k); with v[0] = 0 where it is `tested`.

    By coordinate descent, of those alone that the bounds change.
    """
    away = np.zeros_like(points)  # v - u
    if tested:
        away[:, 0] = -points[:, 0]
        away[:, 1:] = np.outer(points[:, 0], np.linalg.pinv(inverse[1:, 1:], hermitian=True) @ inverse[1:, 0])
    first = int(tested)
    crossing = (points + away < limit)[:, first:].any(axis=1)
    some, own = away[crossing], limit - points[crossing]
    for _ in range(SWEEPS):
        before = some.copy()
        for j in range(first, limit.size):
            some[:, j] = np.maximum(some[:, j] - some @ inverse[:, j] / inverse[j, j], own[:, j])
        if np.abs(some - before).max(initial=0.0) < SETTLED:
            break
    away[crossing] = some
    return np.asarray(np.einsum("ni,ij,nj->n", away, inverse, away))
