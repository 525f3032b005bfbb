"""CMA-ES (Hansen 2016, arXiv:1604.00772) without output, with random numbers of its own."""

from __future__ import annotations

from typing import Any

import numpy as np

from hyperflex.checks import Array


def cma_es(centre: Array, size: float, spreads: Array, members: int, random: np.random.Generator) -> Any:
    """Return a CMA-ES optimizer with ``ask`` and ``tell``; numpy's global generator is left alone.

    Parameters
    ----------
    centre : (k,) float64
        Initial point.
    size : float
        Initial step size, in units of `spreads`.
    spreads : (k,) float64
        Standard deviations of the coordinates relative to each other.
    members : int
        Points of a generation.
    random : Generator
        Source of its random numbers.
    """
    import cma

    options = {"popsize": members, "verbose": -9, "CMA_stds": spreads, "seed": np.nan}
    options["randn"] = lambda *shape: random.standard_normal(shape)
    return cma.CMAEvolutionStrategy(centre, size, options)
