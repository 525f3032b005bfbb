"""CMA-ES (Hansen 2016, arXiv:1604.00772) without output, with random numbers of its own."""

from typing import Any

import numpy as np

from hyperflex.checks import Array


def cma_es(centre: Array, size: float, spreads: Array, members: int, random: np.random.Generator) -> Any:
    """Return a CMA-ES optimizer with ``ask`` and ``tell``; numpy's global generator is left alone.

    It starts at `centre` (k,) with a step `size` in units of `spreads` (k,), the standard deviations of the coordinates
    relative to each other; `members` are the points of a generation.
    """
    import cma

    options = {"popsize": members, "verbose": -9, "CMA_stds": spreads, "seed": np.nan}
    options["randn"] = lambda *shape: random.standard_normal(shape)
    return cma.CMAEvolutionStrategy(centre, size, options)
