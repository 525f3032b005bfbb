"""A child process of this program: its start, its answers, its errors and its end; and records in memory of both."""

import gc
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.interruption import leave_terminal

START = 120.0  # s that a child may take to start: imports, and perhaps kernels that are compiled
ANSWER = 2.0  # s within which it answers a request, or ends after a signal


class Child:
    """A process that runs a function in a new interpreter. It ends with this program, however that ends.

    A program that starts one needs ``if __name__ == "__main__":``. Signals of the terminal do not reach it.

    Parameters
    ----------
    name : str
        As in "The emulator ended with code 1."
    error : type
        Raised if the process does not start, does not answer, or has ended; an error that it sends is raised as it is.
    function : callable
        Of a module. It is called in the process with its end of the link, then `arguments`; it sends pairs of a
        request's number, 0 for what was not requested, and a value. Its HyperflexError is sent as well.
    """

    def __init__(self, name: str, error: type[HyperflexError], function: Callable[..., None], *arguments: Any) -> None:
        self.name, self.error, self._call = name, error, (function, *arguments)
        self.code: int | None = 0  # with which the last process ended; None: it did not
        self._process: Any = None
        self._cause: Exception | None = None  # the error that it has sent: of several threads one alone receives it
        self._number = 0
        self._reading, self._sending = threading.RLock(), threading.Lock()
        self._ending = threading.Lock()  # two threads that wait lose an exit code

    def launch(self) -> None:
        """Start the process."""
        context = multiprocessing.get_context("spawn")
        self.link, theirs = context.Pipe()
        process: Any = context.Process(target=_run, args=(theirs, *self._call), name=self.name, daemon=True)
        process.start()
        self._process, self.code, self._cause = process, None, None
        theirs.close()

    def start(self, patience: float = START) -> Any:
        """Start the process, and return what it sends first within `patience`, s."""
        self.launch()
        try:
            return self.receive(patience)
        except BaseException:
            self.end()
            raise

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return int(self._running().pid)

    def ask(self, *request: Any, patience: float = ANSWER) -> Any:
        """Send a request, and return its answer within `patience`, s. For any thread."""
        with self._reading:
            self._running()
            self._number += 1
            self.send(*request, number=self._number)
            return self.receive(patience, self._number)

    def send(self, *request: Any, number: int = 0) -> None:
        """Send a request; nothing happens if the process has ended: why is received. For any thread."""
        with self._sending, suppress(OSError):
            self.link.send((number, *request))

    def receive(self, patience: float | None, number: int = 0) -> Any:
        """Return the next value with a request's number; answers to earlier requests, which came late, are dropped."""
        until = None if patience is None else time.monotonic() + patience
        with self._reading:
            self._running()
            while self.link.poll(until and max(0.0, until - time.monotonic())):
                answered, value = self._take()
                if answered == number:
                    return value
        raise self.error(f"{self.name} has not answered for {patience:g} s.")

    def raise_if_ended(self) -> None:
        """Raise what ended the process, if it has ended. For any thread."""
        self._running()
        if self._reading.acquire(blocking=False):  # else another thread receives it
            try:
                while self.link.poll():  # a late answer, or why it has ended
                    self._take()
            finally:
                self._reading.release()

    def _running(self) -> Any:
        if self._process is None:
            raise InvalidInput(f"{self.name} does not run".lower(), fix="Use it within its with block")
        return self._process

    def _take(self) -> tuple[int, Any]:
        """Return the next answer and the number of its request; raise an error that was sent, or the end."""
        try:
            number, value = self.link.recv()
        except (EOFError, OSError):
            code = self._wait(self._process, ANSWER)
            how = f"by signal {-code}" if code and code < 0 else f"with code {code}"
            raise (self._cause or self.error(f"{self.name} ended {how}.")) from None
        if isinstance(value, Exception):
            self._cause = value
            raise value
        return number, value

    def stop(self) -> int | None:
        """Send SIGTERM, and return the exit code; None if the process has not ended in time. For any thread."""
        if (process := self._process) is not None:
            with self._ending:
                process.terminate()
            self.code = self._wait(process, ANSWER)
        return self.code

    def _wait(self, process: Any, patience: float) -> int | None:
        if not wait([process.sentinel], patience):
            return None
        with self._ending:
            process.join()
            return int(process.exitcode)

    def end(self, patience: float = 0.0) -> HyperflexError | None:
        """End the process, if it runs; return an error that it has sent meanwhile.

        If it does not end by itself within `patience`, s, it gets SIGTERM, and if that does not help, SIGKILL.
        """
        process, error = self._process, None
        if process is None:
            return None
        code = self._wait(process, patience)
        for hasten in (process.terminate, process.kill):
            if code is None:
                hasten()
                code = self._wait(process, ANSWER)
        with self._reading, self.link:  # readers have noticed the end
            with suppress(EOFError, OSError):
                while self.link.poll():
                    _, value = self.link.recv()
                    error = value if isinstance(value, HyperflexError) else error
            self.code, self._process = code, None
        return error


def _run(link: Connection, function: Callable[..., None], *arguments: Any) -> None:
    leave_terminal()
    with suppress(ConnectionError, EOFError):  # the parent has ended
        try:
            function(link, *arguments)
        except HyperflexError as error:
            link.send((0, error))


def serve(link: Connection, answers: Mapping[str, Callable[..., Any]]) -> bool:
    """Answer a request of the parent, if there is one; return False if it requests the "end", or has ended itself."""
    try:
        if not link.poll():
            return True
        number, kind, *values = link.recv()
    except (EOFError, OSError):
        return False
    if kind == "end":
        return False
    link.send((number, answers[kind](*values)))
    return True


def run_in_real_time() -> None:
    """Let nothing delay this process: no garbage collection, and real-time priority if it has the right to it."""
    gc.collect()
    gc.freeze()
    gc.disable()
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))


class Records:
    """The newest records in memory that processes share: one writes, others read.

    Parameters
    ----------
    count : int
        Records that are kept.
    kind : dtype_like
        Type of a record; a number of columns stands for a row of so many float64.
    """

    def __init__(self, count: int, kind: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._kind = np.dtype((np.float64, (kind,)) if isinstance(kind, int) else kind)
        self._data, self._written = context.RawArray("B", count * self._kind.itemsize), context.RawValue("q", 0)

    @property
    def written(self) -> int:
        """Records written so far."""
        return int(self._written.value)

    @property
    def _all(self) -> npt.NDArray[Any]:
        return np.frombuffer(self._data, self._kind)

    def write(self, record: Any) -> None:
        """Write a record."""
        records = self._all
        records[self.written % len(records)] = record
        self._written.value += 1

    def read(self, newest: int | None = None) -> npt.NDArray[Any]:
        """Return a copy of the `newest` records, or of all; the oldest of all may be overwritten meanwhile."""
        records, written = self._all, self.written
        first = max(0, written - (len(records) - 1 if newest is None else newest))
        return records[np.arange(first, written) % len(records)]
