"""A clock for time budgets that does not count the compiling of kernels."""

import time

from hyperflex.core.jit import compiling


class OutOfTime(Exception):
    """Raised where a search has no time left in the middle of something; never leaves the planner."""


class Clock:
    """Time since the clock was made, with and without compiling."""

    def __init__(self) -> None:
        self._begin, self._compiled = time.monotonic(), compiling()

    @property
    def spent(self) -> float:
        """Time without compiling, s."""
        return self.elapsed - (compiling() - self._compiled)

    @property
    def elapsed(self) -> float:
        """Time with compiling, s."""
        return time.monotonic() - self._begin
