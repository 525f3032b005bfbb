"""The validation gate: which places can be those of their markers."""

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array

GATE = 23.0  # squared Mahalanobis distance of a place, exceeded once in 100,000 (chi square, 2 degrees of freedom)
PERSISTENT = 2  # frames in a row in which a place is outside of its gate: then it is believed
ENOUGH = 3  # places that are seen: where most of them are outside, all are believed at once


class ValidationGate:
    """Tells which of K places are near enough to where they should be.

    Notes
    -----
    Where most of several places are outside of their gates, all are believed, and so is one that has been outside for
    some frames: then it is the state that is wrong (Bar-Shalom, Fortmann, *Tracking and Data Association*, 1988). One
    or two places alone do not say which of both is: they wait.
    """

    def __init__(self, count: int) -> None:
        self._outside = np.zeros(count, dtype=np.int64)

    def reset(self) -> None:
        """Begin anew."""
        self._outside[:] = 0

    def holds(self, off: Array, covariances: Array) -> npt.NDArray[np.bool_]:
        """Return which places are believed (K,), from their differences (K, 2), NaN: not seen, and the covariances."""
        seen, left = ~np.isnan(off[:, 0]), np.nan_to_num(off)
        far = np.einsum("kc,kc->k", left, np.linalg.solve(covariances, left[:, :, None])[:, :, 0])
        good = far < GATE
        self._outside = np.where(good | ~seen, 0, self._outside + 1)
        good |= self._outside >= PERSISTENT
        outside = int((seen & ~good).sum())
        return np.ones_like(good) if seen.sum() >= ENOUGH and 2 * outside > seen.sum() else good
