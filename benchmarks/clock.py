"""Timing on a machine that may have other work to do.

What is stated is processor time of the one thread that every contestant runs on: on a quiet machine it is the clock's
time, and on a busy one it leaves out the waiting, which would hit long runs and spare those that fit between two turns
of the scheduler. The clock's time is kept beside it. Contestants take turns, so that a slow minute hits all of them.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

NOTE = (
    "Times are processor time of one thread, medians of runs that took turns: on a quiet machine the same as the "
    "clock's, on a busy one without the waiting. The clock's are in the JSON file."
)
SHORTEST = 0.02  # s; what takes less is repeated until it has taken that long
WARM = 0.3  # s; a first call that takes longer than this has nothing left to warm up, and counts


@dataclass
class Times:
    """Seconds a call, one entry a round."""

    processor: list[float] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)
    result: Any = None  # of the first call

    @property
    def median(self) -> float:
        """Median of the processor time, s."""
        return statistics.median(self.processor)

    def scaled(self, factor: float) -> dict[str, object]:
        """Median and spread of the processor time and median of the clock's, times `factor`, for a JSON file."""
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
    """Time all runs in turns.

    Parameters
    ----------
    runs : sequence of callables
        The first call of each is a warm-up, unless it takes so long that there is nothing to warm up.
    repeats : int
        Rounds.
    budget : float
        Processor time, s, after which a run takes no further part.
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
