"""Noise levels found from innovations: by Fisher scoring on their likelihood."""

from __future__ import annotations

import math

import numpy as np

from hyperflex.checks import Array

LEAST, MOST = 1e-4, 1e4  # times the first guess of a noise level
LONGEST = 1.0  # largest change of a logarithm in one frame


class NoiseLevel:
    """One standard deviation, corrected frame by frame.

    Parameters
    ----------
    value : float
        First guess.
    memory : float
        Number of frames after which what was seen counts exp(-1).
    doubt : float
        Standard deviation of the first guess's logarithm.

    Notes
    -----
    Innovations nu have the covariance S. Where log(variance) of this noise changes, S changes by T, and the prediction
    by m. The score is ``nu' S^-1 m + (nu' S^-1 T S^-1 nu - tr S^-1 T) / 2`` and its information ``m' S^-1 m +
    tr (S^-1 T)^2 / 2``.
    """

    def __init__(self, value: float, memory: float = 60.0, doubt: float = 2.0) -> None:
        self._first, self.value, self._keep = value, value, math.exp(-1.0 / memory)
        self._information = self._prior = 1.0 / (2.0 * doubt) ** 2

    def see(self, whitened: Array, part: Array, moved: Array | None = None) -> None:
        """Correct the level.

        Parameters
        ----------
        whitened : (m,) float64
            The innovation over its standard deviation.
        part : (m, m) float64
            ``S^-1/2 T S^-T/2``.
        moved : (m,) float64, optional
            ``S^-1/2 m``, where that counts.
        """
        score = 0.5 * (whitened @ part @ whitened - np.trace(part))
        information = 0.5 * float((part * part).sum())
        if moved is not None:
            score += whitened @ moved
            information += float(moved @ moved)
        self._information = self._keep * self._information + information
        change = min(max(score / (self._information + self._prior), -LONGEST), LONGEST)
        self.value = min(max(self.value * math.exp(0.5 * change), LEAST * self._first), MOST * self._first)
