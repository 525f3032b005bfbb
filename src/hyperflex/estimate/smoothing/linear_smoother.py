"""The fixed-interval smoother of a linear model, in square-root form: orthogonal transformations only."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from hyperflex.checks import Array
from hyperflex.estimate import square_root as sr


class Step(NamedTuple):
    """From one frame to the next: ``x+ = F x + c + N^T w`` with w of mean 0 and covariance 1.

    Attributes
    ----------
    transition : (N, N) float64
        F.
    offset : (N,) float64
        c.
    noise : (r, N) float64
        N.
    """

    transition: Array
    offset: Array
    noise: Array


class Measurement(NamedTuple):
    """What is seen in a frame: ``z = H x + e`` with e of mean 0 and covariance 1; m may be 0.

    Attributes
    ----------
    z : (m,) float64
    jacobian : (m, N) float64
        H.
    """

    z: Array
    jacobian: Array


class Smoothed(NamedTuple):
    """The posterior of all frames, given all measurements.

    Attributes
    ----------
    means : (T, N) float64
    rows : list of (r, N) float64
        Of each frame; their squares are its covariance.
    priors : list of tuple of (N,) float64 and (r, N) float64
        Mean and rows of each frame, given those before it alone.
    coordinates : list of (r,) float64
        v of each state over its prior: ``x = mean + rows^T v``.
    noises : list of (r,) float64
        Of the steps: w.
    log_likelihoods : (T,) float64
        Of each frame's measurement, given those before.
    """

    means: Array
    rows: list[Array]
    priors: list[tuple[Array, Array]]
    coordinates: list[Array]
    noises: list[Array]
    log_likelihoods: Array

    def without_first(self) -> "Smoothed":
        """Return the same of all frames but the first."""
        priors, coordinates = self.priors[1:], self.coordinates[1:]
        return Smoothed(self.means[1:], self.rows[1:], priors, coordinates, self.noises[1:], self.log_likelihoods[1:])


class _Filtered(NamedTuple):
    """The filter's pass at one frame: x = mean + rows^T v, v normal with mean `at` and rows `spread`."""

    mean: Array
    rows: Array
    at: Array
    spread: Array


def smooth_linear(mean: Array, rows: Array, steps: Sequence[Step], measurements: Sequence[Measurement]) -> Smoothed:
    """Return the posterior of the states of T frames.

    Parameters
    ----------
    mean, rows : (N,), (r, N) float64
        Prior of the first state: its mean, and rows whose squares are its covariance, which may be singular.
    steps : sequence of T - 1 Step
        Their noise may be singular, too.
    measurements : sequence of T Measurement

    Notes
    -----
    The states are written in coordinates v that are standard normal before their frame is seen, x = m + R^T v. One QR
    factorisation a frame, ``[L R F^T; N] = Q [R+; 0]``, takes the coordinates that are left (z, w) to those of the next
    frame and a rest e that no later frame tells of: (z, w) = Q (v+, e). Backwards the same Q gives the smoothed z and w
    of v+. No covariance is inverted. The result is that of Rauch, Tung and Striebel (1965, AIAA Journal 3(8), 1445), by
    the elimination of Paige and Saunders (1977, SIAM J. Numer. Anal. 14(2), 180); cost O(T N^3).
    """
    passes: list[_Filtered] = []
    turns: list[Array] = []
    likelihoods = np.zeros(len(measurements))
    for k, seen in enumerate(measurements):
        at, spread, likelihoods[k] = _updated(mean, rows, seen)
        passes.append(_Filtered(mean, rows, at, spread))
        if k < len(steps):
            step = steps[k]
            mean = step.transition @ (mean + rows.T @ at) + step.offset
            turn, upper = np.linalg.qr(np.concatenate([spread @ rows @ step.transition.T, step.noise]), mode="complete")
            rows = upper[: min(upper.shape)]
            turns.append(turn)
    return _backward(passes, turns, likelihoods)


def _updated(mean: Array, rows: Array, seen: Measurement) -> tuple[Array, Array, float]:
    """Return mean and rows of v after a measurement, and the measurement's log-likelihood."""
    r, m = len(rows), len(seen.z)
    if not m:
        return np.zeros(r), np.eye(r), 0.0
    both = np.eye(m + r)
    both[m:, :m] = rows @ seen.jacobian.T
    upper = sr.triangular(both)
    whitened = solve_triangular(upper[:m, :m], seen.z - seen.jacobian @ mean, trans="T", check_finite=False)
    size = math.log(2.0 * math.pi) * m + 2.0 * np.log(np.abs(np.diag(upper)[:m])).sum()
    return upper[:m, m:].T @ whitened, upper[m:, m:], float(-0.5 * (whitened @ whitened + size))


def _backward(passes: list[_Filtered], turns: list[Array], likelihoods: Array) -> Smoothed:
    """Go back from the last frame, of which all is known, to the first."""
    v, spread = passes[-1].at, passes[-1].spread
    coordinates, means, rows, noises = [v], [_mean(passes[-1], v)], [spread @ passes[-1].rows], []
    for each, turn in zip(passes[-2::-1], turns[::-1], strict=True):
        left, known = len(each.spread), v.size
        noises.append(turn[left:, :known] @ v)
        rest = np.concatenate([spread @ turn[:left, :known].T, turn[:left, known:].T])
        v, spread = each.at + each.spread.T @ (turn[:left, :known] @ v), sr.triangular(rest @ each.spread)
        coordinates.append(v)
        means.append(_mean(each, v))
        rows.append(spread @ each.rows)
    priors = [(each.mean, each.rows) for each in passes]
    return Smoothed(np.array(means[::-1]), rows[::-1], priors, coordinates[::-1], noises[::-1], likelihoods)


def _mean(each: _Filtered, v: Array) -> Array:
    return each.mean + each.rows.T @ v
