"""The one place with numba's options, and where compiled code is kept.

Numba's own cache does not notice an edit in *another* file, so compiled code is kept in a folder whose name is a hash
of all of core's sources: an edit anywhere in core starts a fresh folder. Only hyperflex's kernels go there; the cache
of other packages stays where it is. ``HYPERFLEX_CACHE_DIR`` moves it.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.extending import register_jitable

_F = TypeVar("_F", bound=Callable[..., Any])

# contract: fused multiply-add; arcp: x / c as x * (1 / c); nsz: the sign of zero may change.
# Not "reassoc" (the argument reduction of sincos relies on the order of its operations) and not "nnan" (isnan works).
_FASTMATH = {"contract", "arcp", "nsz"}


def _source_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    core = Path(__file__).parent
    for path in sorted(core.rglob("*.py")):
        digest.update(path.relative_to(core).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> str:
    if chosen := os.environ.get("HYPERFLEX_CACHE_DIR"):
        root = Path(chosen)
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hyperflex"
    folder = root / f"kernels-{SOURCE_HASH}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return str(folder)
    except OSError:
        return tempfile.mkdtemp(prefix="hyperflex-kernels-")


SOURCE_HASH = _source_hash()
CACHE_FOLDER = _cache_folder()


class _Locator(_CacheLocator):  # type: ignore[misc]
    """Tells numba to keep a kernel in :data:`CACHE_FOLDER`, valid for as long as core's sources are the same."""

    def __init__(self, py_func: Callable[..., Any]) -> None:
        self._line = py_func.__code__.co_firstlineno

    def get_cache_path(self) -> str:
        return CACHE_FOLDER

    def get_source_stamp(self) -> str:
        return SOURCE_HASH

    def get_disambiguator(self) -> str:
        return str(self._line)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], _file: str) -> _Locator:
        return cls(py_func)


class _CacheImpl(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _Cache(FunctionCache):  # type: ignore[misc]
    _impl_class = _CacheImpl


def kernel(function: _F) -> _F:
    """Compile a kernel on its first call and keep the machine code for later processes (GIL released)."""
    compiled = numba.njit(error_model="numpy", fastmath=_FASTMATH, nogil=True)(function)
    if not numba.config.DISABLE_JIT:
        compiled._cache = _Cache(function)
    return compiled  # type: ignore[no-any-return]


def lean(function: _F) -> _F:
    """Compile a kernel that makes no arrays: it counts no references, which costs small kernels half of their time.

    Its arrays are its callers'. It returns numbers alone, and assigns to slices no more than numbers.
    """
    compiled = numba.njit(error_model="numpy", fastmath=_FASTMATH, nogil=True, _nrt=False)(function)
    if not numba.config.DISABLE_JIT:
        compiled._cache = _Cache(function)
    return compiled  # type: ignore[no-any-return]


def inlined(function: _F) -> _F:
    """Mark a leaf that is copied into its callers, so that loops over lanes around it turn into SIMD code."""
    return numba.njit(error_model="numpy", fastmath=_FASTMATH, inline="always")(function)  # type: ignore[no-any-return]


def shared(function: _F) -> _F:
    """Mark a leaf that is copied into kernels as an inlined one is, and that numpy arrays can go through as well."""
    options = {"error_model": "numpy", "fastmath": _FASTMATH}
    return register_jitable(inline="always", **options)(function)  # type: ignore[no-any-return]


class _Timer(event.Listener):  # type: ignore[misc]
    """Adds up the time that the compiler takes; it compiles one function at a time, and what that calls within it."""

    def __init__(self) -> None:
        self.spent, self._depth, self._since = 0.0, 0, 0.0

    def on_start(self, _event: event.Event) -> None:
        if self._depth == 0:
            self._since = time.monotonic()
        self._depth += 1

    def on_end(self, _event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.spent += time.monotonic() - self._since


_TIMER = _Timer()
event.register("numba:compile", _TIMER)


def compiling() -> float:
    """Return the time that this process has spent on compiling until now, s."""
    return _TIMER.spent


@functools.cache
def announce_compilation() -> None:
    """Say on standard error, once a process, that kernels are about to be compiled (nothing if they are cached)."""
    if not numba.config.DISABLE_JIT and not any(Path(CACHE_FOLDER).glob("*.nbi")):
        sys.stderr.write("hyperflex: compiling the rope kernels for this machine (once, about half a minute) ...\n")
        sys.stderr.flush()
