"""When a run ends early: its budget is spent, the user interrupts it, or it would take too long."""

import time
from collections.abc import Callable

from hyperflex.budget import Budget
from hyperflex.errors import SimulationError
from hyperflex.interruption import OutOfTime
from hyperflex.status import Status

# s of processor time: allowed to a run without a time budget, and spent before the whole is predicted
LONGEST, PREDICTED = 1800.0, 10.0


class Endless(OutOfTime):
    """Raised in a run without a time budget that would take more than LONGEST seconds."""


class Watch:
    """Called between the steps of a run with the time it has reached, s; ends the run by an exception.

    Parameters
    ----------
    given : float, Budget or None
        Time of the run, s; without one, the run ends once its progress predicts more than LONGEST s for the whole.
    span : (float, float)
        Simulated time at which the run begins and ends, s.
    report : callable, optional
        Called with the time reached, s.
    """

    def __init__(
        self,
        given: float | Budget | None,
        span: tuple[float, float],
        report: Callable[[float], None] | None = None,
    ) -> None:
        self.budget, (self._begin, self._end) = Budget.of(given), span
        self.report = report or (lambda t: None)
        self._work = Budget(clock=time.thread_time) if given is None else None  # a busy machine ends no run

    def __call__(self, t: float) -> None:
        """Report the time reached, t, s, and raise OutOfTime or KeyboardInterrupt if the run has to end there."""
        self.report(t)
        self.budget.check()
        if self._work is not None and (work := self._work.elapsed) > PREDICTED:
            done = (t - self._begin) / (self._end - self._begin)
            if work > LONGEST * done:
                raise Endless


def out_of_time(t: float, cause: BaseException | None, otherwise: str = "") -> SimulationError:
    """Return the error of a run that was ended by OutOfTime, its `cause`, at simulated time t, s."""
    why = "its time budget is over. Allow more, or loosen tol"
    if isinstance(cause, Endless):
        why = f"it would take more than {LONGEST / 60.0:g} minutes in all. Check units and gravity, loosen tol, or "
        why += f"make it shorter{otherwise}"
    return SimulationError(
        f"stopped at t = {t:.6g} s ({Status.OUT_OF_TIME}): {why}.", status=Status.OUT_OF_TIME, time=t
    )
