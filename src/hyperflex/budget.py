"""Budget: how much time a piece of work may take, whether it was cancelled, its progress and its threads.

A public function makes one from what the user gave (:meth:`Budget.of`) and hands it down. Parts of the work get shares
of it. Code that may run long calls :meth:`Budget.check`, or asks for what is `remaining`.
"""

import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hyperflex import checks
from hyperflex.core.jit import compiling
from hyperflex.interruption import OutOfTime, raise_if_cancelled
from hyperflex.progress import progress_bar

__all__ = ["Budget", "OutOfTime", "one_thread"]

DEFAULT_TIME = 1800.0  # s, of a run or a fit whose user gives no time budget
PROCESSORS = os.cpu_count() or 1  # asked for once: it takes a hundredth of a short run


class Budget:
    """Time for a piece of work and its parts.

    The time of compiling kernels does not count: it is spent once, and a user does not plan for it.

    Parameters
    ----------
    seconds : float
        Time by the clock, s, from now on; infinite by default.
    threads : int, optional
        Threads that the work may use; all processors by default.
    clock : callable, optional
        Returns the time, s. Tests pass their own; ``time.process_time`` counts processor time.

    Examples
    --------
    >>> budget = Budget(10.0)
    >>> search, verification = budget.share(0.8), budget
    >>> search.expired, round(verification.remaining)
    (False, 10)
    """

    def __init__(
        self,
        seconds: float = math.inf,
        *,
        threads: int | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.seconds = seconds
        most = checks.MOST_THREADS
        self.threads = PROCESSORS if threads is None else checks.count("threads", threads, most=most)
        self._clock, self._parent, self._cancelled = clock, None, False
        self._report: Callable[..., None] | None = None
        self._begin, self._compiled, self._processor = clock(), compiling(), time.process_time()

    _parent: "Budget | None"

    @classmethod
    def of(cls, given: "float | Budget | None", name: str = "time_budget", *, threads: int | None = None) -> "Budget":
        """Return the budget of an argument: seconds, None for no limit, or a budget, which is returned as it is.

        With `threads` a budget that is given is not returned itself, but what remains of it, with so many threads.

        Raises
        ------
        InvalidInput
            If the seconds are not positive; `name` is the argument's name in the message.
        """
        if isinstance(given, Budget):
            if threads is None:
                return given
            part = given.limit(given.remaining)
            part.threads = threads
            return part
        seconds = math.inf if given is None else checks.positive(name, given, "s", infinite=True)
        return cls(seconds, threads=threads)

    @property
    def elapsed(self) -> float:
        """Time since the budget was made, s, without compiling."""
        return self._clock() - self._begin - (compiling() - self._compiled)

    @property
    def processor_share(self) -> float:
        """Processor time that this process took since the budget was made, over the time by the clock."""
        return (time.process_time() - self._processor) / max(self._clock() - self._begin, 1e-9)

    @property
    def remaining(self) -> float:
        """Time that remains to this part and to the whole, s; negative if it was exceeded, -inf if cancelled."""
        if self._cancelled:
            return -math.inf
        own = self.seconds - self.elapsed
        return own if self._parent is None else min(own, self._parent.remaining)

    @property
    def expired(self) -> bool:
        """Whether the time is over, or the work was cancelled by :meth:`cancel`."""
        return self.remaining <= 0.0

    def limit(self, seconds: float) -> "Budget":
        """Return a budget for a part: at most `seconds`, s, from now on, and never more than remains to the whole."""
        part = Budget(seconds, threads=self.threads, clock=self._clock)
        part._parent = self
        return part

    def share(self, fraction: float) -> "Budget":
        """Return a budget for a part: a fraction, 0 to 1, of what remains now."""
        return self.limit(fraction * max(0.0, self.remaining))

    def cancel(self) -> None:
        """End this part, and its parts, at their next check: the result is not needed any more."""
        self._cancelled = True

    def check(self) -> None:
        """Raise OutOfTime if the time is over, and KeyboardInterrupt if the user has interrupted the work."""
        raise_if_cancelled()
        if self.expired:
            raise OutOfTime

    def report(self, done: float | None = None, text: str | None = None) -> None:
        """Show how much is done of the part whose progress is shown, by default its time, s, and what is being done."""
        if self._report is not None:
            done = self.elapsed if done is None else done
            self._report(done) if text is None else self._report(done, text)
        elif self._parent is not None:
            self._parent.report(done, text)

    @contextmanager
    def progress(self, enabled: bool, text: str, total: float | None = None, unit: str = "s") -> Iterator[Any]:
        """Show the progress of the block on standard error if `enabled`: a bar from 0 to `total`, in `unit`.

        Without a total it is the time of the budget.
        """
        end = self.seconds if total is None else total
        with progress_bar(0.0, end, enabled and math.isfinite(end), text, unit) as bar:
            before, self._report = self._report, bar or self._report
            try:
                yield self
            finally:
                self._report = before


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep numpy's and scipy's linear algebra on one thread."""
    import scipy.linalg  # noqa: F401 its own library must be there to be limited
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield
