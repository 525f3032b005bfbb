"""CMA-ES (Hansen 2016, arXiv:1604.00772) as each search here runs it: quiet, with random numbers of its own."""

from __future__ import annotations

from typing import Any

import numpy as np

from hyperflex.checks import Array


def evolution(centre: Array, size: float, spreads: Array, members: int, random: np.random.Generator) -> Any:
    """Return a search by CMA-ES, with ``ask`` and ``tell``; numpy's global generator is left alone.

    Parameters
    ----------
    centre : (k,) float64
        Where it begins.
    size : float
        Of its first spread, in parts of `spreads`.
    spreads : (k,) float64
        Standard deviations of the coordinates beside each other.
    members : int
        Points of a generation.
    random : Generator
        Where its random numbers come from.
    """
    import cma

    options = {"popsize": members, "verbose": -9, "CMA_stds": spreads, "seed": np.nan}
    options["randn"] = lambda *shape: random.standard_normal(shape)
    return cma.CMAEvolutionStrategy(centre, size, options)
