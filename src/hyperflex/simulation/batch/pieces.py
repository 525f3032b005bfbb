"""Batches in pieces: chunks of members on an executor, and their results put together."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.executor import run_chunks
from hyperflex.interruption import Stop, stoppable
from hyperflex.model import Setup
from hyperflex.progress import progress_bar
from hyperflex.simulation.time_budget import INTERRUPTED

LOST = "worker lost"  # status of members whose chunk killed each worker that ran it


def run_pieces(
    run: Callable[[list[Setup]], Any], setups: Sequence[Setup], executor: Executor, size: int, progress: bool
) -> tuple[dict[str, Array], list[str], Array, Stop]:
    """Run chunks of `size` members on an executor; Ctrl-C keeps those that are finished.

    `run` simulates the members of a list of set-ups; what it returns has values, status and reached of a batch.

    Returns
    -------
    values : dict of str to (M, T, ...) float64
        What was kept; NaN of members that did not run, and beyond the links that a rope has.
    names : (M,) list of str
        "ok", the name of the failure, INTERRUPTED or LOST.
    reached : (M,) float64
        Time that each member reached, s.
    stop : Stop
    """
    count = len(setups)
    found: dict[int, Any] = {}
    names: list[str] = [INTERRUPTED] * count
    reached = np.zeros(count)
    with stoppable() as stop, progress_bar(0, count, progress, unit="members") as report:

        def done(low: int, part: Any) -> None:
            found[low] = part
            high = low + len(part.status)
            names[low:high], reached[low:high] = part.status, part.reached
            if report is not None:
                report(high)

        for each in run_chunks(run, setups, executor, size, done):
            names[each.start : each.stop] = [LOST] * len(each)
    values: dict[str, Array] = {}
    for name in next(iter(found.values())).values if found else ():
        shapes = [part.values[name].shape[1:] for part in found.values()]
        values[name] = np.full((count, *np.max(shapes, axis=0)), np.nan)
        for low, part in found.items():
            value = part.values[name]
            values[name][(slice(low, low + len(value)), *(slice(0, width) for width in value.shape[1:]))] = value
    return values, names, reached, stop
