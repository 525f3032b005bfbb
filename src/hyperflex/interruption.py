"""Interruption: how Ctrl-C, and SIGTERM on the command line, end a running call and keep its partial result.

The first signal raises KeyboardInterrupt in the main thread and is remembered. If a library suppresses that exception,
or if other threads do the work, the next call of :func:`raise_if_cancelled` raises it again, at the latest when the
public call ends. Code with a partial result to keep runs its work in :func:`stoppable`; the public call then raises
:class:`~hyperflex.errors.Interrupted` with the partial result. A second signal ends the work on the partial result.
"""

import functools
import os
import signal
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType, TracebackType
from typing import Any, ParamSpec, TypeVar

from hyperflex.errors import Interrupted
from hyperflex.status import Status

_P = ParamSpec("_P")
_R = TypeVar("_R")
_USUAL: dict[int, object] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}


def leave_terminal() -> None:
    """Give this process a separate session, so that keys of the terminal (Ctrl-C, Ctrl-Z) reach only its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(AttributeError, OSError):  # Windows has no sessions
        os.setsid()


class OutOfTime(Exception):
    """Raised when the time of a budget is over; :func:`stoppable` catches it, and it never leaves the library."""


class _State:
    """Signals received in this process."""

    number = 0  # of the first signal; 0: none
    pending = False  # whether it is still pending
    count = 0  # of all signals
    deferred = 0  # blocks that defer signals
    compilers = False  # whether numba's compiler events are received


# ``handled``: the count of signals at the last one that this thread has handled
_thread = threading.local()


def _notice(number: int, frame: FrameType | None) -> None:
    """Handle a signal. Python ignores exceptions in finalisers; there the signal stays pending."""
    _State.number, _State.pending, _State.count = _State.number or number, True, _State.count + 1
    if not (_State.deferred or _ending(frame)):
        raise KeyboardInterrupt


def _ending(frame: FrameType | None) -> bool:
    """Return whether a frame belongs to a finaliser, a weak reference's callback, or the end of `handle_signals`."""
    while frame is not None:
        code, ends = frame.f_code, handle_signals.__exit__.__code__
        if code is ends or code.co_name == "__del__" or code.co_filename == weakref.__file__:
            return True
        frame = frame.f_back
    return False


def number() -> int:
    """Return the number of the signal that ended the last interrupted call; SIGINT if no signal was noticed."""
    return _State.number or signal.SIGINT


def raise_if_cancelled() -> None:
    """Raise KeyboardInterrupt, in any thread, if a signal was received that this thread has not handled yet."""
    if _State.pending and not _State.deferred and getattr(_thread, "handled", 0) != _State.count:
        raise KeyboardInterrupt


class handle_signals:
    """Context in which signals are handled: Ctrl-C, and further `numbers`.

    A signal received in the block is raised at its end if it is still pending, also instead of another error, because a
    library may report the interrupt as one. Signals belong to the main thread; signals with other handlers are left to
    them.
    """

    def __init__(self, *numbers: int) -> None:
        self._numbers = (signal.SIGINT, *numbers)
        self._before: dict[int, Any] = {}

    def __enter__(self) -> None:
        defer_while_compiling()
        if threading.current_thread() is not threading.main_thread():
            return
        free = {each: _USUAL[each] for each in self._numbers if signal.getsignal(each) is _USUAL[each]}
        if signal.SIGINT in free:  # nobody notices yet
            _State.number, _State.pending, _State.deferred = 0, False, 0
        self._before = free
        _State.deferred += 1  # signals received in the meantime are raised by the first poll, or at the end
        for each in free:
            signal.signal(each, _notice)
        _State.deferred -= 1

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        pending = _State.pending
        for each, handler in self._before.items():
            signal.signal(each, handler)
        if self._before:
            pending, _State.pending = _State.pending, False
        if pending and not _State.deferred and (kind is None or issubclass(kind, Exception)):
            raise KeyboardInterrupt from error


@contextmanager
def deferred() -> Iterator[None]:
    """Defer interrupts to the end of a short block, for example one that puts files in place."""
    with handle_signals():
        own = threading.current_thread() is threading.main_thread()
        _State.deferred += own
        try:
            yield
        finally:
            _State.deferred -= own


def defer_while_compiling() -> None:
    """Defer interrupts to the end of numba's compiler, if it is loaded: its incomplete tables would fail later."""
    if not _State.compilers and (numba := sys.modules.get("numba.core.event")):
        _State.compilers = True
        numba.Listener.register(_Compiling)
        numba.register("numba:compiler_lock", _Compiling())


class _Compiling:
    """Receives numba's events: signals during a compilation in the main thread are deferred."""

    def __init__(self) -> None:
        self._stack: list[Any] = []

    def notify(self, event: Any) -> None:
        """Defer signals from the start of an event, which may contain others, to its end."""
        if threading.current_thread() is not threading.main_thread():
            return
        if event.is_start:
            self._stack.append(deferred())
            self._stack[-1].__enter__()
            return
        self._stack.pop().__exit__(None, None, None)


class Stop:
    """Whether a :func:`stoppable` block was ended early, and why.

    Attributes
    ----------
    status : Status or None
        INTERRUPTED or OUT_OF_TIME; None if the block came to its end.
    error : BaseException or None
        The exception that ended it.
    """

    status: Status | None = None
    error: BaseException | None = None

    @property
    def received(self) -> bool:
        """Whether the user interrupted the block."""
        return self.status is Status.INTERRUPTED

    @property
    def partial(self) -> Any:
        """Partial result of the call that was interrupted in the block; None if it left none."""
        return getattr(self.error, "partial", None)

    def deliver(self, result: _R) -> _R:
        """Return a result; if the user interrupted the block, raise Interrupted with it instead."""
        if self.received:
            raise Interrupted(result)
        return result


@contextmanager
def stoppable() -> Iterator[Stop]:
    """Catch the end of a budget and interrupts of the block, also if a library reports an interrupt as another error.

    Code after the block may work on the partial result without a time limit. The block must not return from its
    function: an interrupt at its end would be lost.
    """
    stop = Stop()
    try:
        yield stop
        raise_if_cancelled()
    except (KeyboardInterrupt, Exception) as error:
        if _State.pending or isinstance(error, KeyboardInterrupt):
            stop.status, _thread.handled = Status.INTERRUPTED, _State.count
            if threading.current_thread() is threading.main_thread():  # other threads end on their own
                _State.pending = False
        elif isinstance(error, OutOfTime):
            stop.status = Status.OUT_OF_TIME
        else:
            raise
        stop.error = error


def interruptible(kind: type | None = None) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Decorate a function that may take long, so that an interrupt leaves it as Interrupted.

    Its ``partial`` is the result of type `kind` that the function gave to :meth:`Stop.deliver`, or None.
    """

    def decorate(function: Callable[_P, _R]) -> Callable[_P, _R]:
        @functools.wraps(function)
        def call(*args: _P.args, **named: _P.kwargs) -> _R:
            done: list[_R] = []
            try:
                with handle_signals():
                    done.append(function(*args, **named))
            except KeyboardInterrupt as stop:
                raise Interrupted(done[0] if done else functools.partial(_own, stop, kind)) from None
            return done[0]

        return call

    return decorate


def _own(stop: KeyboardInterrupt, kind: type | None) -> Any:
    """Return the partial result of an interrupted call if it is of this kind: an inner call may have left another."""
    partial = getattr(stop, "partial", None)
    return partial if kind is not None and isinstance(partial, kind) else None
