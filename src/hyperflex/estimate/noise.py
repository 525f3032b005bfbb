"""Noise levels found from innovations: by Fisher scoring on their likelihood."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dposv

from hyperflex.checks import Array
from hyperflex.estimate import square_root as sr

MOST = 1e4  # times the first guess of a noise level
QUIET = 0.02  # least process noise over its first guess: a rope at rest gives no information about it
AT_REST = 0.5  # least noise of places over the declared one: at rest, errors are the same in each frame
TINY = 1e-2  # ridge of dependent rows, relative to what is negligible, squared


class NoiseLevel:
    """Standard deviations, adapted frame by frame.

    Parameters
    ----------
    value : (c,) array_like or float
        First guess.
    doubt : float
        Standard deviation of the first guess's logarithm.
    least : float
        Smallest value relative to the first guess.

    Attributes
    ----------
    first : (c,) float64
        The first guess.

    Notes
    -----
    Innovations nu have the covariance S. The derivatives of S and of the prediction by log(variance) of a noise are T
    and m. The score is ``nu' S^-1 m + (nu' S^-1 T S^-1 nu - tr S^-1 T) / 2``, and the information of noises i and j
    ``m_i' S^-1 m_j + tr (S^-1 T_i S^-1 T_j) / 2``.
    """

    MEMORY = 60.0  # frames after which observations have a weight of exp(-1)
    LATELY = 10.0  # frames over which the information of one is averaged: it falls with the level
    LONGEST = 1.0  # largest change of a logarithm in one frame

    def __init__(self, value: ArrayLike, *, doubt: float = 2.0, least: float) -> None:
        self.first = np.atleast_1d(np.asarray(value, dtype=np.float64))
        self._values, self._single = self.first.copy(), np.ndim(value) == 0
        self._prior = np.eye(self.first.size) / (2.0 * doubt) ** 2
        self._least = least * self.first
        self._information, self._weight, self._count = np.zeros_like(self._prior), 0.0, 0.0
        self._known = self._prior

    @property
    def value(self) -> Any:
        """The standard deviation, a float or (c,) like the first guess."""
        return float(self._values[0]) if self._single else self._values

    @property
    def log_std(self) -> Any:
        """Standard deviation of the value's logarithm, from recent observations; float or (c,)."""
        found = 0.5 * np.sqrt(np.diag(np.linalg.inv(self._known)))
        return float(found[0]) if self._single else found

    def see(self, whitened: Array, parts: Array, moved: Array | None = None) -> None:
        """Adapt the levels to an innovation.

        Parameters
        ----------
        whitened : (m,) float64
            The innovation over its standard deviation.
        parts : (c, m, m) float64
            ``S^-1/2 T S^-T/2`` of each noise.
        moved : (c, m) float64, optional
            ``S^-1/2 m`` of each noise, if it has an effect.
        """
        score = 0.5 * (whitened @ parts @ whitened - np.trace(parts, axis1=1, axis2=2))
        flat = parts.reshape(len(parts), -1)
        information = 0.5 * (flat @ flat.T)
        if moved is not None:
            score += moved @ whitened
            information += moved @ moved.T
        keep = math.exp(-1.0 / self.LATELY)
        self._information, self._weight = keep * self._information + information, keep * self._weight + 1.0
        self._count = math.exp(-1.0 / self.MEMORY) * self._count + 1.0
        self._known = self._count * self._information / self._weight + self._prior
        change = np.clip(np.linalg.solve(self._known, score), -self.LONGEST, self.LONGEST)
        self._values = np.clip(self._values * np.exp(0.5 * change), self._least, MOST * self.first)


class NoiseDerivatives:
    """Derivatives of a filter's state and covariance by log(variance) of each kind of process noise.

    The innovation and its covariance depend on the noise of all steps before; their derivatives follow those of the
    filter's own recursion (Gupta and Mehra 1974, IEEE Transactions on Automatic Control 19, 774-783).

    They are propagated like the filter's covariance, as rows whose squares add up.

    Parameters
    ----------
    kinds : int
    size : int
        Of the state, N.
    """

    def __init__(self, kinds: int, size: int) -> None:
        self._x, self._covariance = np.zeros((kinds, size)), [np.zeros((0, size))] * kinds

    @property
    def rows(self) -> list[Array]:
        """Rows to propagate: (r, N) of each kind's covariance, and those of the state (kinds, N)."""
        return [*self._covariance, self._x]

    def shares(self, factor: Array, least: Array) -> Array:
        """Return C (sum of r, s), for which C factor are the `rows` up to negligible differences.

        All noise is part of the filter's covariance, so that they are combinations of its rows (s, N).
        """
        even = factor / least
        grown = even @ even.T
        grown.flat[:: len(grown) + 1] += TINY
        return np.asarray(dposv(grown, even @ (np.concatenate(self.rows) / least).T)[1].T)

    def predict(self, carried: Sequence[Array], noises: Sequence[Array], least: Array) -> None:
        """Predict.

        Parameters
        ----------
        carried : list of arrays
            The `rows`, propagated to the new time.
        noises : list of (r, N) arrays
            Rows of each kind of noise.
        least : (N,) float64
            Negligible standard deviations.
        """
        *covariance, self._x = carried
        self._covariance = [sr.compressed(np.concatenate(each), least) for each in zip(covariance, noises, strict=True)]

    def update(self, jacobian: Array, gain: Array, upper: Array, whitened: Array) -> tuple[Array, Array]:
        """Correct; return `parts` and `moved` as :meth:`NoiseLevel.see` takes them.

        Parameters
        ----------
        jacobian : (m, N) float64
            Derivatives H of the observations.
        gain : (N, m) float64
            Kalman gain K.
        upper : (m, m) float64
            Factor of the innovation's covariance.
        whitened : (m,) float64
            The innovation over its standard deviation.
        """
        half = sr.solved(upper, jacobian, transposed=True)
        seen = [rows @ half.T for rows in self._covariance]
        moved = self._x @ half.T
        shifted = self._x + np.stack([(a @ whitened) @ rows for a, rows in zip(seen, self._covariance, strict=True)])
        self._x = shifted - (shifted @ jacobian.T) @ gain.T
        self._covariance = [rows - (rows @ jacobian.T) @ gain.T for rows in self._covariance]
        return np.stack([each.T @ each for each in seen]), moved
