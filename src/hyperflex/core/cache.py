"""Compiled kernels on disk: one file for each kernel and types of arguments, in a folder for each state of its sources.

Numba's own cache does not notice an edit in *another* file. Here a kernel's folder is named by a hash of its module and
of every module of this package which that one imports, directly or through others: an edit recompiles what depends on
it, and nothing else, and checkouts that differ share one cache. A file is written whole or not at all, and is read
only if its checksum is right. So a cache that is read-only, full, damaged or filled by several processes at once costs
time and never a wrong run.

``HYPERFLEX_CACHE_DIR`` names the cache; without it, it is ``hyperflex`` in the user's cache folder.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import os
import pickle
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np

_PACKAGE = __name__.partition(".")[0]
_ROOT = Path(__file__).parents[__name__.count(".")]  # the folder that holds the package
_CHECKSUM = hashlib.sha256().digest_size


def folder() -> Path:
    """Return the folder of all compiled kernels; it need not be there."""
    if chosen := os.environ.get("HYPERFLEX_CACHE_DIR"):
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / _PACKAGE


def source_hash(module: str, root: Path = _ROOT) -> str:
    """Return a hash of a module and of all it imports from its package, and of what compiles them.

    Parameters
    ----------
    module : str
        Its full name.
    root : Path
        The folder that holds the package.
    """
    found: dict[str, bytes] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name], imported = _source(name, root)
            waiting += imported
    config = [getattr(numba.config, name, None) for name in ("OPT", "BOUNDSCHECK", "LOOP_VECTORIZE", "SLP_VECTORIZE")]
    digest = hashlib.sha256(repr((numba.__version__, np.__version__, sys.version, config)).encode())
    for name, content in sorted(found.items()):
        digest.update(name.encode() + b"\0" + content + b"\0")
    return digest.hexdigest()[:16]


@functools.cache
def _source(module: str, root: Path) -> tuple[bytes, tuple[str, ...]]:
    """Return the source of a module and the names of what it imports from its own package."""
    path = _path(module, root)
    if path is None:
        return b"", ()
    content = path.read_bytes()
    here = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    named: list[str] = []
    for node in ast.walk(ast.parse(content)):
        if isinstance(node, ast.Import):
            named += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            named += [source, *(f"{source}.{alias.name}" for alias in node.names)]
    package = module.partition(".")[0]
    return content, tuple(name for name in named if name.partition(".")[0] == package and _path(name, root))


def _path(module: str, root: Path) -> Path | None:
    """Return the file of a module, or None if there is no such module."""
    place = root.joinpath(*module.split("."))
    return next((path for path in (place / "__init__.py", place.with_name(f"{place.name}.py")) if path.is_file()), None)


class KernelCache:
    """What numba asks for the machine code of one kernel, and gives it to after it has compiled it.

    Parameters
    ----------
    function : callable
        The kernel as written, a function of a module (not within another function).
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._module, self._name = function.__module__, function.__qualname__

    @functools.cached_property
    def cache_path(self) -> Path:
        """Where this kernel's files are, each for other types of arguments."""
        return folder() / f"{self._module.removeprefix(f'{_PACKAGE}.')}-{source_hash(self._module)}"

    def _file(self, types: Any, codegen: Any) -> tuple[Path, str]:
        key = repr((types, codegen.magic_tuple()))
        return self.cache_path / f"{self._name}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.nbc", key

    def load_overload(self, types: Any, context: Any) -> Any:
        """Return the compiled kernel for such types of arguments, None if there is none that can be used."""
        from numba.core.compiler import CompileResult

        context.refresh()
        path, key = self._file(types, context.codegen())
        try:
            content = path.read_bytes()
        except OSError:
            return None
        payload = content[_CHECKSUM:]
        if hashlib.sha256(payload).digest() != content[:_CHECKSUM]:
            return None
        written, parts = pickle.loads(payload)
        return CompileResult._rebuild(context, *parts) if written == key else None

    def save_overload(self, types: Any, compiled: Any) -> None:
        """Keep a compiled kernel; where that fails it is compiled again by the next process."""
        from numba.core.serialize import dumps

        path, key = self._file(types, compiled.codegen)
        payload = dumps((key, compiled._reduce()))
        try:
            write(path, hashlib.sha256(payload).digest() + payload)
        except OSError as error:
            _complain(str(error))


def write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, and make its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


@functools.cache
def _complain(reason: str) -> None:
    sys.stderr.write(
        f"hyperflex: cannot keep compiled kernels ({reason}), so each process compiles its own. "
        "HYPERFLEX_CACHE_DIR names another folder.\n"
    )
