"""Decorators of kernels: the one place with numba's options."""

import functools
import hashlib
import sys
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.extending import register_jitable

from hyperflex.core import cache

try:
    from hyperflex.core import compiler
except (ImportError, AttributeError):
    compiler = None  # type: ignore[assignment]

_F = TypeVar("_F", bound=Callable[..., Any])

# contract: fused multiply-add; arcp: x / c as x * (1 / c); nsz: the sign of zero may change.
# Not "reassoc" (the argument reduction of sincos relies on the order of its operations) and not "nnan" (isnan works).
_FASTMATH = {"contract", "arcp", "nsz"}


KERNELS: list[tuple[str, str]] = []  # module and name of each kernel of the modules that have been imported

# numba's minor versions with the insides that `compiler` uses; pyproject.toml ends there too
_KNOWN = range(66, 69)


def _source_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    core = Path(__file__).parent
    for path in sorted(core.rglob("*.py")):
        digest.update(path.relative_to(core).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


SOURCE_HASH = _source_hash()  # of all kernels, to tell apart what was measured with them


@functools.cache
def _is_known() -> bool:
    """Whether this is a numba that :mod:`hyperflex.core.compiler` knows; if not, say so."""
    if compiler is not None and tuple(map(int, numba.__version__.split(".")[:2])) in {(0, minor) for minor in _KNOWN}:
        return True
    sys.stderr.write(
        f"hyperflex: compiled kernels are not kept with numba {numba.__version__}, and each process takes minutes to "
        f"compile its own. Install numba 0.{_KNOWN[-1]}.\n"
    )
    return False


def kernel(function: _F) -> _F:
    """Compile a kernel on its first call and keep the machine code for later processes (GIL released)."""
    return _compiled(function)


def non_allocating(function: _F) -> _F:
    """Compile a kernel that makes no arrays: it counts no references, which costs small kernels half of their time.

    Its arrays are its callers'. It returns numbers alone, and assigns to slices no more than numbers.
    """
    return _compiled(function, counts=False)


def absorbed(function: _F) -> _F:
    """Compile a kernel as :func:`non_allocating` does, and copy it into its callers.

    A call hands arrays over word by word, and many of them cost more than what a small step of a long one does.
    """
    return _compiled(function, counts=False, forceinline=True)


def summing(function: _F) -> _F:
    """Compile a kernel whose sums are taken in any order, so that they turn into SIMD code. It must call no sines."""
    return _compiled(function, more={"reassoc"})


def _compiled(function: _F, counts: bool = True, more: AbstractSet[str] = frozenset(), **how: bool) -> _F:
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": _FASTMATH | more, "nogil": True, **how}
    if numba.config.DISABLE_JIT:
        return function
    KERNELS.append((function.__module__, function.__qualname__))
    compiled = compiler.door(function, options, counts) if _is_known() else numba.njit(**options)(function)
    return compiled  # type: ignore[no-any-return]


def inlined(function: _F) -> _F:
    """Mark a leaf that is copied into its callers, so that loops over lanes around it turn into SIMD code."""
    return numba.njit(error_model="numpy", fastmath=_FASTMATH, inline="always")(function)  # type: ignore[no-any-return]


def shared(function: _F) -> _F:
    """Mark a leaf that is copied into kernels as an inlined one is, and that numpy arrays can go through as well."""
    options = {"error_model": "numpy", "fastmath": _FASTMATH}
    return register_jitable(inline="always", **options)(function)  # type: ignore[no-any-return]


def _constant(array: Any) -> Any:
    """Return an array that a kernel has made as one of the kind that its callers give: not to be written to."""
    return array


if numba.config.DISABLE_JIT:
    constant = _constant
else:
    constant = shared(_constant) if compiler is None else compiler.read_only


@functools.cache
def _announce() -> None:
    """Say on standard error, once a process, that kernels are being compiled."""
    there, loaded = cache.compiled(KERNELS), len(KERNELS)
    known = f"{there} of the {loaded} loaded were compiled before{', for other arguments' if there == loaded else ''}"
    if not there:
        known = "about 20 s for a first simulation"
    sys.stderr.write(
        f"hyperflex: compiling kernels for this machine, once; {known} (hyperflex warm compiles all of them in "
        "advance) ...\n"
    )
    sys.stderr.flush()


_TIMER = None if compiler is None else compiler.Timer(_announce)


def compiling() -> float:
    """Return the time that this process has spent on compiling until now, s."""
    return 0.0 if _TIMER is None else _TIMER.spent
