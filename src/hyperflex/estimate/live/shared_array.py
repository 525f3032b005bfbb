"""The newest of a series of arrays, shared between processes that never wait for each other."""

import zlib
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import HyperflexError

_HEAD = 4  # int64 of a slot: number of the write, checksum, length, nothing
_TRIES = 1000


class SharedArray:
    """An array of numbers in shared memory that one process writes and others read.

    Parameters
    ----------
    size : int
        Most numbers in it.
    name : str, optional
        Of one that another process has made; left out: make it. The process that made it is to :meth:`close` it last.

    Notes
    -----
    Two slots take turns, each with the number of its write and a checksum. A writer that dies within a write leaves the
    other slot as it was; a reader that was overtaken sees that number and sum do not fit, and reads again. The memory
    holds numbers alone: nothing in it is executed or unpickled.

    Examples
    --------
    >>> shared = SharedArray(3)
    >>> shared.write(np.array([1.0, 2.0]))
    >>> shared.read()
    (1, array([1., 2.]))
    >>> shared.close()
    """

    def __init__(self, size: int, name: str | None = None) -> None:
        self.size, self._mine = size, name is None
        width = 8 * (_HEAD + size)
        self._memory = SharedMemory(name=name, create=self._mine, size=8 + 2 * width)
        self._last = np.ndarray((1,), np.int64, self._memory.buf)
        self._heads = [np.ndarray((_HEAD,), np.int64, self._memory.buf, 8 + k * width) for k in (0, 1)]
        self._data = [np.ndarray((size,), np.float64, self._memory.buf, 8 + k * width + 8 * _HEAD) for k in (0, 1)]

    @property
    def name(self) -> str:
        """Under which another process finds it."""
        return self._memory.name

    def write(self, values: Array) -> None:
        """Make `values` (m,), m <= size, the newest."""
        number = int(self._last[0]) + 1
        head, data = self._heads[number % 2], self._data[number % 2]
        head[0] = 0
        data[: values.size] = values
        head[1], head[2] = _checksum(number, values), values.size
        head[0] = number
        self._last[0] = number

    def read(self) -> tuple[int, Array] | None:
        """Return the newest and the number of its write, 1, 2, ..; None before the first."""
        for _ in range(_TRIES):
            number = int(self._last[0])
            if number == 0:
                return None
            head = self._heads[number % 2]
            checksum, length = int(head[1]), int(head[2])
            values = self._data[number % 2][: min(max(length, 0), self.size)].copy()
            if head[0] == number and _checksum(number, values) == checksum:
                return number, values
        raise HyperflexError(
            "Shared memory is damaged: no slot of it is whole. Start the process that writes it again."
        )

    def clear(self) -> None:
        """Forget what was written; only where no other process writes."""
        self._last[0] = 0

    def close(self) -> None:
        """Let go of the memory; whoever made it also removes it."""
        self._last, self._heads, self._data = np.zeros(1, np.int64), [], []
        self._memory.close()
        if self._mine:
            self._mine = False
            self._memory.unlink()


def _checksum(number: int, values: Array) -> int:
    return zlib.crc32(values.tobytes(), number & 0xFFFFFFFF)
