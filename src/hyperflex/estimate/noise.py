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
    With innovations nu of covariance S, of which this noise alone makes the part T, the score of log(variance) is
    ``(nu' S^-1 T S^-1 nu - tr S^-1 T) / 2`` and its information ``tr (S^-1 T)^2 / 2``.
    """

    def __init__(self, value: float, memory: float = 60.0, doubt: float = 2.0) -> None:
        self._first, self.value, self._keep = value, value, math.exp(-1.0 / memory)
        self._information = self._prior = 1.0 / (2.0 * doubt) ** 2

    def see(self, whitened: Array, part: Array) -> None:
        """Correct the level.

        Parameters
        ----------
        whitened : (m,) float64
            The innovation over its standard deviation.
        part : (m, m) float64
            ``S^-1/2 T S^-T/2``: what part of its variance this noise makes.
        """
        score = 0.5 * (whitened @ part @ whitened - np.trace(part))
        self._information = self._keep * self._information + 0.5 * float((part * part).sum())
        change = min(max(score / (self._information + self._prior), -LONGEST), LONGEST)
        self.value = min(max(self.value * math.exp(0.5 * change), LEAST * self._first), MOST * self._first)
