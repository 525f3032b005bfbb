"""Time budget of a run: processor time, and Ctrl-C."""

import time
from collections.abc import Callable
from typing import NamedTuple

from hyperflex import checks
from hyperflex.core.jit import compiling
from hyperflex.errors import SimulationError

OUT_OF_TIME = "time budget exceeded"  # status of a run that took too long
INTERRUPTED = "interrupted"  # and of one that Ctrl-C ended


class TimeBudgetExceeded(Exception):
    """Raised within a run when its time budget is spent; never leaves the library."""


class Deadline(NamedTuple):
    """Time budget of one of several runs that share a time: its own processor time, s, and the time that is left.

    `left` returns the time that is left for all of them by the clock, s; a busy machine does not lengthen it.
    """

    processor: float
    left: Callable[[], float]


def enforce_budget(
    report: Callable[[float], None] | None, seconds: float | Deadline | None
) -> Callable[[float], None] | None:
    """Return what a run reports to: `report`, and TimeBudgetExceeded once its thread has worked for `seconds`.

    What passes between two reports does not count if kernels were compiled meanwhile: that is no fault of the run.

    `report` is called with the simulated time. `seconds` are of processor time, so that a busy machine ends no run;
    None waits for ever. A Deadline ends the run as well once no time is left by the clock.
    """
    if seconds is None:
        return report
    end = seconds if isinstance(seconds, Deadline) else None
    left = end.processor if end else checks.number("time_budget", seconds, sign="positive", unit="s")
    last, compiled = time.thread_time(), compiling()

    def heard(t: float) -> None:
        nonlocal left, last, compiled
        if report is not None:
            report(t)
        now, before, compiled = time.thread_time(), compiled, compiling()
        if compiled == before:
            left -= now - last
        last = now
        if left < 0.0 or (end and end.left() < 0.0):
            raise TimeBudgetExceeded

    return heard


def budget_error(t: float) -> SimulationError:
    """Return the error of a run that had come to `t`, s, when its time was over."""
    message = f"stopped at t = {t:.6g} s ({OUT_OF_TIME}): its processor time was over. Allow more, or loosen tol."
    return SimulationError(message, status=OUT_OF_TIME, time=t)
