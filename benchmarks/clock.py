"""Timing on a machine that may be busy.

The reported time is the processor time of the one thread on which each contestant runs: on an idle machine it equals
elapsed time, on a busy one it excludes waiting, which would affect long runs more than those that fit into one time
slice of the scheduler. Elapsed time is kept as well. Contestants alternate, so that a slow minute affects all of them.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

NOTE = (
    "Times are processor times of one thread, medians of alternating runs: on an idle machine they equal elapsed "
    "times, on a busy one they exclude waiting. The JSON file has the elapsed times, too."
)
SHORTEST = 0.02  # s; shorter runs are repeated until they have taken this long
WARM = 0.3  # s; a first call that takes longer needs no warm-up, and counts


@dataclass
class Times:
    """Seconds per call, one entry for each round."""

    processor: list[float] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)
    result: Any = None  # of the first call

    @property
    def median(self) -> float:
        """Median of the processor time, s."""
        return statistics.median(self.processor)

    def scaled(self, factor: float) -> dict[str, object]:
        """Median and spread of the processor time and median of the elapsed time, times `factor`, for a JSON file."""
        return {
            "median": self.median * factor,
            "least": min(self.processor) * factor,
            "most": max(self.processor) * factor,
            "clock": statistics.median(self.clock) * factor,
            "rounds": len(self.processor),
        }


def once(run: Callable[[], object], times: Times, calls: int = 1) -> object:
    """Add one round of `calls` calls and return the result of the last."""
    clock, processor = time.perf_counter(), time.process_time()
    for _ in range(calls):
        result = run()
    times.processor.append((time.process_time() - processor) / calls)
    times.clock.append((time.perf_counter() - clock) / calls)
    return result


def alternately(runs: Sequence[Callable[[], object]], repeats: int, budget: float) -> list[Times]:
    """Time all runs in alternation.

    Parameters
    ----------
    runs : sequence of callables
        The first call of each is a warm-up, unless it takes too long to need one.
    repeats : int
        Rounds.
    budget : float
        Processor time, s, after which a run is not repeated.
    """
    results = [Times() for _ in runs]
    calls = []
    for run, times in zip(runs, results, strict=True):
        times.result = once(run, times)
        seconds = times.processor[0]
        calls.append(max(1, round(SHORTEST / max(seconds, 1e-9))) if seconds < SHORTEST else 1)
        if seconds < WARM:
            times.processor.clear()
            times.clock.clear()
    for _ in range(repeats):
        for run, times, count in zip(runs, results, calls, strict=True):
            if len(times.processor) < repeats and sum(times.processor) * count < budget:
                once(run, times, count)
    return results
