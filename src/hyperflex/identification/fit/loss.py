"""Loss functions of residuals: squares, Huber and Cauchy."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from hyperflex.checks import Array

LossName = Literal["squares", "huber", "cauchy"]
LOSSES: tuple[LossName, ...] = ("squares", "huber", "cauchy")
# Where large begins, in standard deviations: 95 % as good as squares where there are no outliers (Holland and Welsch
# 1977, doi:10.1080/03610927708827533)
TUNING = {"huber": 1.345, "cauchy": 2.385}
NORMAL = 1.4826  # standard deviation over the median of absolute values, of a normal distribution


class Loss:
    """Costs and weights of residuals; `scale` is their standard deviation without the outliers."""

    def __init__(self, name: LossName = "squares", scale: float = 1.0, *, fixed: bool = False) -> None:
        self.name, self.scale, self.fixed = name, scale, fixed

    def scaled(self, residuals: Sequence[Array]) -> "Loss":
        """Return the same loss with the scale that these residuals show, unless it is fixed."""
        if self.name == "squares" or self.fixed:
            return self
        sizes = np.abs(np.concatenate(residuals))
        sizes = sizes[sizes > 0.0]
        return Loss(self.name, max(NORMAL * float(np.median(sizes)), 1e-300) if sizes.size else 1.0)

    def cost(self, residual: Array) -> float:
        """Return what residuals (m,) cost: their squares while they are small."""
        if self.name == "squares":
            return float(residual @ residual)
        limit = TUNING[self.name] * self.scale
        if self.name == "cauchy":
            return float(limit**2 * np.log1p((residual / limit) ** 2).sum())
        size = np.abs(residual)
        return float(np.where(size <= limit, size**2, 2.0 * limit * size - limit**2).sum())

    def weight(self, residual: Array) -> Array:
        """Return the roots of the weights (m,) that make squares of these costs (iterated least squares)."""
        if self.name == "squares":
            return np.ones(residual.size)
        ratio = np.abs(residual) / (TUNING[self.name] * self.scale)
        weight = 1.0 / (1.0 + ratio**2) if self.name == "cauchy" else 1.0 / np.maximum(ratio, 1.0)
        return np.sqrt(weight)

    def influence(self, residual: Array) -> Array:
        """Return psi (m,), half the slope of the cost: the residuals themselves while they are small."""
        return np.asarray(self.weight(residual) ** 2 * residual)

    def sensitivity(self, residual: Array) -> Array:
        """Return d psi / d residual (m,): 1 while residuals are small."""
        if self.name == "squares":
            return np.ones(residual.size)
        ratio = np.abs(residual) / (TUNING[self.name] * self.scale)
        if self.name == "cauchy":
            return np.asarray((1.0 - ratio**2) / (1.0 + ratio**2) ** 2)
        return np.where(ratio <= 1.0, 1.0, 0.0)
