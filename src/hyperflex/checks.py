"""Checks of user arguments, shared by all modules.

Each returns the value in the form that the package works with, or raises :class:`hyperflex.errors.InvalidInput`.
"""

import difflib
import functools
import inspect
import math
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Literal, ParamSpec, TypeVar

import numpy as np
import numpy.typing as npt

from hyperflex.errors import InvalidInput

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.int64]
Indices = npt.NDArray[np.intp]
ByName = dict[str, Any]  # values of any kind
Sign = Literal["any", "positive", "nonnegative"]
T = TypeVar("T")
_derived = ContextVar("_derived", default=False)
_P = ParamSpec("_P")

MOST_THREADS = 1024
LARGEST = 1e100  # of any quantity in SI units; squares and products of larger ones overflow

# By unit: what a rope or an arm hardly exceeds, and the unit in which such a value is most likely meant
_SLIPS = {
    "m": (100.0, "mm", 1e-3),
    "rad": (40.0, "degrees", math.pi / 180.0),
    "s": (100.0, "ms", 1e-3),
    "kg/m": (50.0, "g/m", 1e-3),  # a steel rope as thick as an arm
}

# How users make what functions expect, by the name of its class; the advice for a value of another kind
_MADE_BY = {
    "Arm": "Write hyperflex.Arm(0.2) for an arm of 0.2 m",
    "Motion": "hyperflex.sampled_motion(t, angle) makes one from samples, hyperflex.arm_moves(...) from moves",
    "Peg": "Write hyperflex.Peg(x, y, radius)",
    "Recording": "Read the file with read_recording, or write hyperflex.Recording(t, angles)",
    "Rope": "hyperflex.Rope.uniform(length, mass, n_links, friction=...) makes one, Rope.from_toml(file) reads one",
    "Setup": "Write hyperflex.Setup(rope, motion, arm), or read it by Setup.from_toml(file)",
    "Trajectory": "hyperflex.simulate(...) makes one, read_trajectory(file) reads one",
}

_ALLOWED = {"any": "finite", "positive": "finite and > 0", "nonnegative": "finite and >= 0"}


def number(name: str, value: object, *, sign: Sign = "any", unit: str = "", infinite: bool = False) -> float:
    """Return `value` as a finite float of the required sign (``infinite=True`` lets +inf pass)."""
    result, got = math.nan, value
    try:
        if isinstance(value, (str, bytes, bool)):
            raise TypeError
        result = got = float(value.item() if isinstance(value, np.ndarray) and value.size == 1 else value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        wrong = "is not a number"
    except OverflowError:
        wrong = "is too large"
    else:
        if not math.isfinite(result) and not (infinite and result > 0.0):
            wrong = "is not finite"
        elif LARGEST < abs(result) < math.inf:
            wrong = f"is larger than {LARGEST:g} in size"
        elif (sign == "positive" and result <= 0.0) or (sign == "nonnegative" and result < 0.0):
            wrong = "has the wrong sign"
        else:
            return result
    allowed = f"a number, {_ALLOWED[sign]}" + (" (or inf)" if infinite else "") + (f", in {unit}" if unit else "")
    raise InvalidInput(f"{name} {wrong}", got=got, allowed=allowed) from None


def positive(name: str, value: object, unit: str = "", *, infinite: bool = False) -> float:
    """Return `value` as a finite float > 0 (``infinite=True`` lets inf pass)."""
    return number(name, value, sign="positive", unit=unit, infinite=infinite)


def meant(name: str, value: npt.ArrayLike, unit: str, *, most: float | None = None) -> None:
    """Warn (UserWarning, at the caller's line) of a value beyond `most`, SI, most likely given in a smaller unit."""
    limit, smaller, factor = _SLIPS[unit]
    flat = np.ravel(value)
    largest = float(flat[np.abs(flat).argmax()]) if flat.size else 0.0
    if abs(largest) > (most or limit) and not _derived.get():
        level, frame = 2, sys._getframe(1)
        while frame.f_back and frame.f_globals.get("__name__", "").startswith("hyperflex."):
            level, frame = level + 1, frame.f_back
        likely = f"{largest:.6g} {smaller} are {factor * largest:.4g}"
        text = f"{name} is {largest:.6g} {unit}: is it meant in {smaller}? Give it in {unit}; {likely}."
        warnings.warn(text, UserWarning, stacklevel=level)


@contextmanager
def derived() -> Iterator[None]:
    """Do not ask in a block, or in the function that is decorated, what is meant: its values are no user's."""
    token = _derived.set(True)
    try:
        yield
    finally:
        _derived.reset(token)


def count(name: str, value: object, *, least: int = 1, most: int | None = None) -> int:
    """Return `value` as an integer of at least `least` and at most `most`."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    whole |= isinstance(value, (float, np.floating)) and float(value).is_integer()
    if not whole or value < least or (most is not None and value > most):  # type: ignore[operator]
        allowed = f"a whole number >= {least}" if most is None else f"a whole number from {least} to {most}"
        raise InvalidInput(f"{name} is not a usable count", got=value, allowed=allowed)
    return int(value)  # type: ignore[call-overload, no-any-return]


def array(
    name: str,
    value: object,
    shape: tuple[int, ...] | None,
    *,
    sign: Sign = "any",
    unit: str = "",
    scalar: bool = False,
    gaps: bool = False,
    infinite: bool = False,
) -> Array:
    """Return `value` as a fresh read-only float64 array of the given shape, in C order.

    Parameters
    ----------
    shape : tuple of int, or None
        Required shape; -1 leaves that axis free, None all.
    sign : {"any", "positive", "nonnegative"}
        Sign that every element must have.
    scalar : bool
        Let a single number stand for all elements.
    gaps : bool
        Let NaN pass (a missing sample).
    infinite : bool
        Let +inf pass.

    Raises
    ------
    InvalidInput
        Naming the first bad element with its index.
    """
    sizes = "x".join("any" if k < 0 else str(k) for k in shape or ())
    want = "numbers" if shape is None else f"numbers, shape {sizes}" if shape else "a number"
    try:
        if np.asarray(value).dtype.kind not in "fiubO":  # numpy would read texts, drop imaginary parts, count times
            raise ValueError
        result = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError, RecursionError):
        what = "an array of numbers" if shape != () else "a number"
        raise InvalidInput(f"{name} is not {what}", got=value, allowed=want) from None
    if shape is None:
        shape = result.shape
    if scalar and result.ndim == 0 and -1 not in shape:
        result = np.full(shape, result)
    if result.ndim != len(shape) or any(w >= 0 and w != s for w, s in zip(shape, result.shape, strict=True)):
        got = result.shape if result.ndim else float(result)
        allowed = "a list of numbers" if shape == (-1,) else f"shape {sizes}"
        raise InvalidInput(f"{name} has the wrong shape", got=got, allowed=allowed)
    bad = ~(np.abs(result) <= LARGEST)  # also what is not a number
    if gaps:
        bad &= ~np.isnan(result)
    if infinite:
        bad &= result != np.inf
    if sign == "positive":
        bad |= result <= 0.0
    elif sign == "nonnegative":
        bad |= result < 0.0
    if bad.any():
        index = tuple(int(k) for k in np.argwhere(bad)[0])
        also = " (NaN marks a gap)" if gaps else " (or inf)" if infinite else ""
        allowed = f"{_ALLOWED[sign]}, up to {LARGEST:g} in size{also}" + (f", in {unit}" if unit else "")
        raise InvalidInput(f"{name}{list(index) or ''} cannot be used", got=float(result[index]), allowed=allowed)
    result.setflags(write=False)
    return result


def times(name: str, value: object, *, least: int = 1) -> Array:
    """Return time stamps as a strictly increasing, finite array (T,), in seconds."""
    t = array(name, value, (-1,), unit="s")
    if t.size < least:
        raise InvalidInput(f"{name} has too few samples", got=t.size, allowed=f"at least {least}")
    steps = np.diff(t)
    if (steps <= 0.0).any():
        k = int(np.argmax(steps <= 0.0))
        what = "repeats a time" if steps[k] == 0.0 else "goes back in time"
        raise InvalidInput(
            f"{name} {what} at sample {k + 1}",
            got=[float(t[k]), float(t[k + 1])],
            allowed="strictly increasing times in s",
            fix="Sort the samples by time and drop repeated ones",
        )
    return t


def keys(
    what: str,
    given: Iterable[str],
    known: Iterable[str],
    *,
    needed: Iterable[str] = (),
    elsewhere: Mapping[str, Iterable[str]] = MappingProxyType({}),
) -> None:
    """Refuse names that are not known, or that `what` lacks; `elsewhere` says which names are known in other places."""
    known, given = sorted(set(known)), list(given)
    for key in given:
        if key in known:
            continue
        places = [place for place, names in elsewhere.items() if key in names]
        close = difflib.get_close_matches(key[:80], known, 1, 0.7) or [each for each in known if key.startswith(each)]
        advice = [f"perhaps {close[0]!r} is meant"] if close else []
        advice += [f"it belongs {' or '.join(places)}"] if places else []
        fix = ", or ".join(advice) or "correct its name, or remove it"
        fix = fix[0].upper() + fix[1:]
        raise InvalidInput(f"{what} does not know this key", got=key, allowed=", ".join(known), fix=fix)
    if missing := [key for key in needed if key not in given]:
        raise InvalidInput(f"{what} lacks {', '.join(missing)}", got=given, allowed=", ".join(known), fix="Add it")


def mapping(name: str, value: object) -> Mapping[str, Any]:
    """Return `value` if it is a mapping whose keys are text."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise InvalidInput(f"{name} is not a table", got=value, allowed="a mapping of names to values")
    return value


def sequence(name: str, value: object, allowed: str) -> list[Any]:
    """Return the entries of `value` if it is a sequence, not a text; `allowed` says what it may hold."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise InvalidInput(f"{name} is not a sequence", got=value, allowed=allowed)
    try:
        return list(value)
    except TypeError:  # an array without an axis
        raise InvalidInput(f"{name} is not a sequence", got=value, allowed=allowed) from None


def flag(name: str, value: object) -> bool:
    """Return `value` if it is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidInput(f"{name} is neither true nor false", got=value, allowed="True or False")
    return bool(value)


def text(name: str, value: object) -> str:
    """Return `value` if it is text."""
    if not isinstance(value, str):
        raise InvalidInput(f"{name} is not text", got=value, allowed="text (str)")
    return value


def instance(name: str, value: object, kind: type[T], module: str = "hyperflex") -> T:
    """Return `value` if it is of a class, such as Rope, that users import from a module."""
    if not isinstance(value, kind):
        own = type(value)
        if own.__module__.startswith("hyperflex."):
            fix = f"A {own.__name__} is given: check the order of the arguments, or name them"
        else:
            fix = _MADE_BY.get(kind.__name__, "")
        raise InvalidInput(f"{name} is no {kind.__name__}", got=value, allowed=f"{module}.{kind.__name__}", fix=fix)
    return value


def choice(name: str, value: object, options: Sequence[str], *, also: str = "") -> str:
    """Return `value` if it is one of the named options; `also` is allowed beside them, and checked by the caller."""
    if not isinstance(value, str) or value not in options:
        allowed = [*map(repr, options), *([also] if also else [])]
        raise InvalidInput(f"{name} is not known", got=value, allowed=", ".join(allowed))
    return value


def arguments(**parts: type[Any]) -> Callable[[Callable[_P, T]], Callable[_P, T]]:
    """Decorate a function: arguments that it lacks are refused; those of its `parts`, dataclasses, with their place.

    Arguments for these parts are refused if they are of another class.
    """

    def decorate(function: Callable[_P, T]) -> Callable[_P, T]:
        known = inspect.signature(function).parameters
        elsewhere = {f"to {part}={of.__name__}(...)": [each.name for each in fields(of)] for part, of in parts.items()}

        @functools.wraps(function)
        def call(*values: _P.args, **named: _P.kwargs) -> T:
            keys(f"{function.__name__}()", named, known, elsewhere=elsewhere)
            for name, value in {**dict(zip(known, values, strict=False)), **named}.items():
                if name in parts and (value is not None or known[name].default is inspect.Parameter.empty):
                    instance(name, value, parts[name])
            return function(*values, **named)

        return call

    return decorate


def named(elsewhere: Mapping[str, Iterable[str]]) -> Callable[[type[T]], type[T]]:
    """Decorate a dataclass: arguments that it lacks are refused, with what is meant where `elsewhere` says so."""

    def decorate(kind: type[T]) -> type[T]:
        construct, known = kind.__init__, [each.name for each in fields(kind)]  # type: ignore[arg-type]

        @functools.wraps(construct)
        def init(self: T, *values: Any, **given: Any) -> None:
            keys(f"{kind.__name__}()", given, known, elsewhere=elsewhere)
            construct(self, *values, **given)

        kind.__init__ = init  # type: ignore[assignment]
        return kind

    return decorate
