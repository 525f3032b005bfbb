"""CMA-ES (Hansen 2016, arXiv:1604.00772): an evolution strategy that learns the covariance of its steps."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array

LONGEST_STEP = 1.0  # greatest natural logarithm by which the step size grows in a generation


class CmaEs:
    """CMA-ES with active update (table 1 of the tutorial); alternate ``ask`` and ``tell`` to minimize a loss.

    It starts at `centre` (k,) with a step `size` in units of `spreads` (k,), the standard deviations of the coordinates
    relative to each other; `members` are the points of a generation. `random` draws them.
    """

    def __init__(
        self, centre: npt.ArrayLike, size: float, spreads: npt.ArrayLike, members: int, random: np.random.Generator
    ) -> None:
        self.mean, self.size = np.array(centre, dtype=np.float64), size
        self._spreads, self._members, self._random = np.asarray(spreads, dtype=np.float64), members, random
        n = self.mean.size
        self._set_weights(n, members)
        self._covariance, self._axes, self._scales = np.eye(n), np.eye(n), np.ones(n)
        self._size_path, self._path, self._told = np.zeros(n), np.zeros(n), 0

    def _set_weights(self, n: int, members: int) -> None:
        """Weights of the points of a generation, best first, and learning rates: equations (49) to (58)."""
        raw = np.log(0.5 * (members + 1.0)) - np.log(np.arange(1.0, members + 1.0))
        good, bad = np.maximum(raw, 0.0), np.minimum(raw, 0.0)
        self._mass = good.sum() ** 2 / (good**2).sum()
        lost = bad.sum() ** 2 / (bad**2).sum()
        self._size_rate = (self._mass + 2.0) / (n + self._mass + 5.0)
        self._damping = 1.0 + 2.0 * max(0.0, np.sqrt((self._mass - 1.0) / (n + 1.0)) - 1.0) + self._size_rate
        self._path_rate = (4.0 + self._mass / n) / (n + 4.0 + 2.0 * self._mass / n)
        self._one = 2.0 / ((n + 1.3) ** 2 + self._mass)
        rank = 2.0 * (0.25 + self._mass + 1.0 / self._mass - 2.0) / ((n + 2.0) ** 2 + self._mass)
        self._many = min(1.0 - self._one, rank)
        least = min(
            1.0 + self._one / self._many,
            1.0 + 2.0 * lost / (self._mass + 2.0),
            (1.0 - self._one - self._many) / (n * self._many),
        )
        self._weights = good / good.sum() + least * bad / max(-bad.sum(), 1e-300)
        self._usual = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n**2))  # length of a normal step

    def ask(self) -> list[Array]:
        """Return the points (k,) of a generation."""
        steps = self._random.standard_normal((self._members, self.mean.size)) * self._scales @ self._axes.T
        return list(self.mean + self.size * self._spreads * steps)

    def tell(self, points: Sequence[Array], losses: Sequence[float]) -> None:
        """Update from the points of the last generation and their losses (to be minimized)."""
        n = self.mean.size
        order = np.argsort(losses, kind="stable")
        steps = (np.array(points)[order] - self.mean) / (self.size * self._spreads)
        white = steps @ self._axes / self._scales  # as drawn, up to a rotation
        good = np.maximum(self._weights, 0.0)
        step = good @ steps
        self.mean = self.mean + self.size * self._spreads * step
        self._told += 1
        self._size_path *= 1.0 - self._size_rate
        share = np.sqrt(self._size_rate * (2.0 - self._size_rate) * self._mass)
        self._size_path += share * (self._axes @ (good @ white))
        length = float(np.linalg.norm(self._size_path))
        since = np.sqrt(1.0 - (1.0 - self._size_rate) ** (2 * self._told))
        steady = length / since < (1.4 + 2.0 / (n + 1.0)) * self._usual
        rate = self._path_rate * (2.0 - self._path_rate)
        self._path = (1.0 - self._path_rate) * self._path + steady * np.sqrt(rate * self._mass) * step
        scale = np.where(self._weights >= 0.0, 1.0, n / np.maximum((white**2).sum(axis=1), 1e-300))
        kept = 1.0 - self._one * (1.0 - (not steady) * rate) - self._many * self._weights.sum()
        self._covariance = kept * self._covariance + self._one * np.outer(self._path, self._path)
        self._covariance += self._many * (steps.T * (self._weights * scale)) @ steps
        self.size *= np.exp(min(LONGEST_STEP, self._size_rate / self._damping * (length / self._usual - 1.0)))
        values, self._axes = np.linalg.eigh(0.5 * (self._covariance + self._covariance.T))
        self._scales = np.sqrt(np.maximum(values, 1e-20))
