"""Decorators of kernels, with all options of numba."""

import functools
import sys
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from typing import Any, ClassVar, TypeVar

import numba
import numpy as np
from numba import types
from numba.extending import overload

from hyperflex.core import cache, compiler

_F = TypeVar("_F", bound=Callable[..., Any])

# contract: fused multiply-add; arcp: x / c as x * (1 / c); nsz: the sign of zero may change.
# Not "reassoc" (the argument reduction of sincos relies on the order of its operations) and not "nnan" (isnan works).
_FASTMATH = {"contract", "arcp", "nsz"}


KERNELS: list[tuple[str, str]] = []  # module and name of each kernel of the modules that have been imported


def kernel(function: _F) -> _F:
    """Compile a kernel on its first call and keep the machine code for later processes (GIL released)."""
    return _compiled(function)


def non_allocating(function: _F) -> _F:
    """Compile a kernel that makes no arrays, without reference counts, which take half of the time of small kernels.

    Its arrays belong to its callers. It returns only numbers, and assigns only numbers to slices.
    """
    return _compiled(function, counts=False)


def absorbed(function: _F) -> _F:
    """Compile a kernel as :func:`non_allocating` does, and copy it into its callers.

    A call passes arrays word by word, which for many arrays costs more than a small step of a long run.
    """
    return _compiled(function, counts=False, forceinline=True)


def summing(function: _F) -> _F:
    """Compile a kernel whose sums may be reordered, so that they become SIMD code. It must not compute sines."""
    return _compiled(function, more={"reassoc"})


def _compiled(function: _F, counts: bool = True, more: AbstractSet[str] = frozenset(), **how: bool) -> _F:
    if numba.config.DISABLE_JIT:
        return function
    KERNELS.append((function.__module__, function.__qualname__))
    options = {"error_model": "numpy", "fastmath": _FASTMATH | more, "nogil": True, "nopython": True, **how}
    inner = {"boundscheck": None, "no_cfunc_wrapper": True, "_nrt": counts}
    return compiler.Door(function, targetoptions=options | inner)


class _Inlined:
    """A function whose body numba copies into kernels; numba uses only these attributes."""

    targetoptions: ClassVar = {"inline": "always"}
    _numba_type_ = types.Dummy("inlined")

    def __init__(self, function: Callable[..., Any]) -> None:
        self.py_func = function
        functools.update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        return self.py_func(*arguments)


def inlined(function: _F) -> _F:
    """Copy a function into the kernels that call it, so that surrounding loops over lanes become SIMD code.

    Python calls the plain function, with numbers or numpy arrays.
    """
    return function if numba.config.DISABLE_JIT else _Inlined(function)  # type: ignore[return-value]


def _constant(array: Any) -> Any:
    """Return a kernel's own array with the read-only type of its callers' arrays."""
    return array


def zeros(*shapes: Any) -> Any:
    """Return an array of zeros of each shape, in Python and in kernels."""
    return tuple(map(np.zeros, shapes))


@overload(zeros)
def _zeros_in_kernels(*shapes):  # type: ignore[no-untyped-def]
    if not shapes:
        return lambda *shapes: ()
    return lambda *shapes: (np.zeros(shapes[0]), *zeros(*shapes[1:]))


def _read(row: Any, width: int, at: int, slots: tuple[int, ...]) -> tuple[Any, ...]:
    """Return the numbers in some slots of a row of lanes: those at ``at + slot * width``."""
    return tuple(row[at + slot * width] for slot in slots)


def _write(row: Any, width: int, at: int, slots: tuple[int, ...], values: tuple[Any, ...]) -> None:
    """Write numbers to slots, as :func:`_read` reads them."""
    for slot, value in zip(slots, values, strict=True):
        row[at + slot * width] = value


if numba.config.DISABLE_JIT:
    constant, read, write = _constant, _read, _write
else:
    constant, read, write = compiler.read_only, compiler.read_slots, compiler.write_slots


@functools.cache
def _announce() -> None:
    """Report on standard error, once per process, that kernels are being compiled."""
    there, loaded = cache.compiled(KERNELS), len(KERNELS)
    known = f"{there} of the {loaded} loaded were compiled before{', for other arguments' if there == loaded else ''}"
    if not there:
        known = "10 to 30 s for a first simulation"
    sys.stderr.write(
        f"hyperflex: compiling kernels for this machine, once; {known} (hyperflex warm compiles all of them in "
        "advance) ...\n"
    )
    sys.stderr.flush()


_TIMER = compiler.Timer(_announce)


def compiling() -> float:
    """Return the time that this process has spent on compiling so far, s."""
    return _TIMER.spent
