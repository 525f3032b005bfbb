"""Time budget of a run: processor time, what is left to do, and Ctrl-C."""

import time
from collections.abc import Callable
from typing import NamedTuple

from hyperflex import checks
from hyperflex.core.jit import compiling
from hyperflex.errors import SimulationError

OUT_OF_TIME = "time budget exceeded"  # status of a run that took too long
INTERRUPTED = "interrupted"  # and of one that Ctrl-C ended
# s of processor time: of a run without a time budget, and after which it is judged whether it will keep to that
LONGEST, JUDGED = 1800.0, 10.0


class TimeBudgetExceeded(Exception):
    """Raised within a run when its time budget is spent; never leaves the library."""


class Deadline(NamedTuple):
    """Time budget of one of several runs that share a time: its own processor time, s, and the time that is left.

    `left` returns the time that is left for all of them by the clock, s; a busy machine does not lengthen it.
    """

    processor: float
    left: Callable[[], float]


def enforce_budget(
    report: Callable[[float], None] | None, seconds: float | Deadline | None, span: tuple[float, float]
) -> Callable[[float], None]:
    """Return what a run over a `span`, s, reports to: `report`, and TimeBudgetExceeded once its time is over.

    That is so once its thread has worked for `seconds`. If these are None it is judged every JUDGED s of work, and over
    if the whole would take more than LONGEST s, going on as on the whole or, if that was faster, as since the judgment
    before. A Deadline ends the run as well once no time is left by the clock.

    What passes between two reports does not count if kernels were compiled meanwhile: that is no fault of the run.

    `report` is called with the simulated time. `seconds` are of processor time, so that a busy machine ends no run.
    """
    most, left = seconds if isinstance(seconds, Deadline) else (seconds, None)
    if most is not None:
        most = checks.number("time_budget", most, sign="positive", unit="s", infinite=True)
    worked, last, compiled = 0.0, time.thread_time(), compiling()
    judged = 0.0, span[0]  # work and simulated time at the last judgment, s

    def heard(t: float) -> None:
        nonlocal worked, last, compiled, judged
        if report is not None:
            report(t)
        now, before, compiled = time.thread_time(), compiled, compiling()
        if compiled == before:
            worked += now - last
        last = now
        if most is not None:
            over = worked > most or (left is not None and left() < 0.0)
        elif over := worked - judged[0] > JUDGED:
            rate = max((t - span[0]) / worked, (t - judged[1]) / (worked - judged[0]))
            over, judged = rate * worked + span[1] - t > rate * LONGEST, (worked, t)
        if over and (t < span[1] or left is not None):  # a run that came to its end by itself is kept
            raise TimeBudgetExceeded

    return heard


def budget_error(t: float, seconds: float | Deadline | None) -> SimulationError:
    """Return the error of a run that had come to `t`, s, when its time budget of `seconds` was over."""
    if seconds is None:
        return endless(t, "; or let it take its time: time_budget=inf")
    shared = isinstance(seconds, Deadline) and seconds.left() < 0.0
    over = "the time that it shares with other runs was over by the clock" if shared else "its processor time was over"
    return _error(t, f"{over}. Allow more, or loosen tol")


def endless(t: float, otherwise: str = "") -> SimulationError:
    """Return the error of a run that had come to `t`, s, when it was judged to take too long."""
    advice = f"Check units and gravity, loosen tol, or make it shorter{otherwise}"
    return _error(t, f"it would take more than {LONGEST / 60.0:g} minutes in all. {advice}")


def _error(t: float, why: str) -> SimulationError:
    return SimulationError(f"stopped at t = {t:.6g} s ({OUT_OF_TIME}): {why}.", status=OUT_OF_TIME, time=t)
