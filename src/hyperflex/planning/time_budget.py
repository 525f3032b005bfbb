"""A clock for patience: what compiling kernels takes is not counted."""

from __future__ import annotations

import time

from hyperflex.core.jit import compiling


class Clock:
    """Time by the clock since it was made, but for that on which kernels were compiled.

    Parameters
    ----------
    begin : float, optional
        When it began, on the monotonic clock, s; by default now.
    """

    def __init__(self, begin: float | None = None) -> None:
        self.begin = time.monotonic() if begin is None else begin
        self._compiled = compiling()

    @property
    def spent(self) -> float:
        """Time since it began, but for compiling, s: what patience is compared with."""
        return self.passed - (compiling() - self._compiled)

    @property
    def passed(self) -> float:
        """Time since it began, compiling too, s."""
        return time.monotonic() - self.begin
