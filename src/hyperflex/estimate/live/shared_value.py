"""The newest of a series of values, shared between two processes that never wait for each other."""

import pickle
import zlib
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np

from hyperflex.errors import HyperflexError, InvalidInput

_HEAD = 3  # int64 of a slot: number of the write, checksum, length
_ATTEMPTS = 1000


class SharedValue:
    """A value in shared memory that one process writes and another one reads.

    Parameters
    ----------
    capacity : int
        Size of the largest pickled value, bytes.
    name : str, optional
        Name of the memory that another process has created; by default it is created. The process that created it
        calls :meth:`close` last.

    Notes
    -----
    Two slots alternate, each with the number of its write and a checksum. A writer that is killed within a write leaves
    the other slot intact; a reader that was overtaken notices that number and checksum do not match, and reads again.
    As the arguments of a process, values are pickled: the memory is accessible to the user who created it alone.

    Examples
    --------
    >>> shared = SharedValue(1000)
    >>> shared.write({"t": 1.0})
    >>> shared.read()
    (1, {'t': 1.0})
    >>> shared.close()
    """

    def __init__(self, capacity: int, name: str | None = None) -> None:
        self.capacity, self._created = capacity + -capacity % 8, name is None
        slot = 8 * _HEAD + self.capacity
        self._memory = SharedMemory(name=name, create=self._created, size=8 + 2 * slot)
        self._buffer: Any = self._memory.buf
        self._last = np.ndarray((1,), np.int64, self._buffer)
        self._heads = [np.ndarray((_HEAD,), np.int64, self._buffer, 8 + k * slot) for k in (0, 1)]
        self._starts = [8 + k * slot + 8 * _HEAD for k in (0, 1)]

    @property
    def name(self) -> str:
        """Name under which another process finds the memory."""
        return self._memory.name

    def write(self, value: Any) -> None:
        """Make `value` the newest; raises InvalidInput if it is too large."""
        data = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        if len(data) > self.capacity:
            allowed = f"at most {self.capacity} bytes when pickled"
            raise InvalidInput("the value is too long to be handed over", got=len(data), allowed=allowed)
        number = int(self._last[0]) + 1
        head, start = self._heads[number % 2], self._starts[number % 2]
        head[0] = 0
        self._buffer[start : start + len(data)] = data
        head[1], head[2] = zlib.crc32(data, number & 0xFFFFFFFF), len(data)
        head[0] = number
        self._last[0] = number

    def read(self) -> tuple[int, Any] | None:
        """Return the number of the newest write (1, 2, ...) and its value; None before the first."""
        for _ in range(_ATTEMPTS):
            number = int(self._last[0])
            if number == 0:
                return None
            head, start = self._heads[number % 2], self._starts[number % 2]
            checksum, length = int(head[1]), min(max(int(head[2]), 0), self.capacity)
            data = bytes(self._buffer[start : start + length])
            if head[0] == number and zlib.crc32(data, number & 0xFFFFFFFF) == checksum:
                return number, pickle.loads(data)
        raise HyperflexError("Shared memory is damaged: neither slot is complete. Restart the process that writes it.")

    def clear(self) -> None:
        """Forget what was written; only while no other process writes."""
        self._last[0] = 0

    def close(self) -> None:
        """Release the memory; the process that created it also removes it."""
        self._last, self._heads, self._buffer = np.zeros(1, np.int64), [], None
        self._memory.close()
        if self._created:
            self._created = False
            self._memory.unlink()
