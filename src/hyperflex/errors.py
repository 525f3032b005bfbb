"""Exceptions of hyperflex. Every message states the mistake, the value, the allowed values and the remedy."""

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from hyperflex.status import Status

LISTED = 12  # largest number of names or numbers in a line


class HyperflexError(Exception):
    """Base class of all intended exceptions of hyperflex."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the data from which pickle restores the error in another process, without its constructor."""
        return type(self).__new__, (type(self), *self.args), vars(self)


class InvalidInput(HyperflexError, ValueError):
    """An argument or the content of a file cannot be used.

    Parameters
    ----------
    what : str
        The problem, as a sentence without a full stop ("rope mass is negative").
    got : object, optional
        The offending value, shown with ``repr`` (long ones are cut).
    allowed : str, optional
        The accepted values.
    fix : str, optional
        Advice for the user.
    """

    def __init__(self, what: str, *, got: object = None, allowed: str = "", fix: str = "") -> None:
        self.what, self.got, self.allowed, self.fix = what, got, allowed, fix
        parts = [_bounded(what) if got is None else f"{_bounded(what)}: got {_short(got)}"]
        if allowed:
            parts.append(f"Allowed: {_bounded(allowed)}")
        if fix:
            parts.append(_bounded(fix))
        super().__init__(" ".join(part if part.endswith(("?", "..")) else f"{part.rstrip('.')}." for part in parts))


@contextmanager
def located(where: str, words: Callable[[str], str] = str) -> Iterator[None]:
    """Begin each InvalidInput of the block with `where`, mostly a file's name, unless it names it already.

    `words` converts its text to the terms of that place.
    """
    try:
        yield
    except InvalidInput as error:
        what, allowed, fix = map(words, (error.what, error.allowed, error.fix))
        what = what if where in what else f"{where}: {what}"
        raise InvalidInput(what, got=error.got, allowed=allowed, fix=fix) from None


class FileProblem(HyperflexError, OSError):
    """A file cannot be read or written (missing, truncated, no space left). An earlier file is unchanged."""


class MissingPackage(HyperflexError, ImportError):
    """A package of an extra of hyperflex is not installed; the message names the command that installs it."""


class SimulationError(HyperflexError, RuntimeError):
    """A rollout could not be finished within its tolerance.

    Parameters
    ----------
    message : str
        The problem, and advice.
    status : Status
        How the run ended.
    time : float
        Simulated time at which it stopped, s.
    """

    def __init__(self, message: str, *, status: Status, time: float) -> None:
        self.status, self.time = status, time
        super().__init__(message)


class IdentificationError(HyperflexError, RuntimeError):
    """A fit was impossible, or did not converge to a result that may be reported."""


class WorkerLost(HyperflexError, RuntimeError):
    """Workers of an executor died each time they ran a part of the work; the message names the part."""


class DriveError(HyperflexError, RuntimeError):
    """A drive cannot be reached, is in fault, or received a request that its guards refuse; its torque is off."""


class EstimatorLost(HyperflexError, RuntimeError):
    """The process that estimates a rope's state has ended or stalled, or has seen nothing for too long."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C ended a long computation. It ends the program like KeyboardInterrupt, unless it is caught.

    Parameters
    ----------
    partial : Any
        The partial result, or a function without arguments that makes it on first access.
    """

    def __init__(self, partial: Any = None) -> None:
        self._partial = partial
        super().__init__("interrupted")

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the data from which pickle restores it in another process, including the partial result."""
        return type(self), (self.partial,)

    @functools.cached_property
    def partial(self) -> Any:
        """Partial result, of the type that the interrupted function returns; None if there is none."""
        return self._partial() if callable(self._partial) else self._partial


def listed(names: Sequence[str], most: int = LISTED) -> str:
    """Return names separated by commas; of many names the first ones and the number of the others."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def _bounded(text: str, head: int = 400, tail: int = 180) -> str:
    """Return a text without its middle if it is long, for example a column's name in a damaged file."""
    return text if len(text) <= head + tail else f"{text[:head]} ... {text[-tail:]}"


def _short(value: object, limit: int = 120) -> str:
    if isinstance(value, (list, tuple, str, bytes)):
        value = value[:limit]
    try:
        text = " ".join(repr(value).split())
    except Exception:  # noqa: BLE001 nested too deep, more digits than Python writes, or a faulty class of a user
        text = f"a value of type {type(value).__name__} that cannot be shown"
    return text if len(text) <= limit else text[: limit - 3] + "..."
