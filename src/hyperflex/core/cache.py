"""Disk cache of compiled kernels.

One file for each kernel and argument types, in a folder for each state of its sources.

Numba's own cache does not notice an edit in *another* file. Here a kernel's folder is named by a hash of its module and
of every module of this package which that one imports, directly or through others: an edit recompiles what depends on
it, and nothing else, and checkouts that differ share one cache. A file is written whole or not at all, and is read
only if its checksum is right. So a cache that is read-only, full, damaged or filled by several processes at once costs
time and never a wrong run; damage and what cannot be kept are told on standard error.

``HYPERFLEX_CACHE_DIR`` names the cache; without it, it is ``hyperflex`` in the user's cache folder.
"""

import ast
import functools
import hashlib
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numba
import numpy as np

_PACKAGE = __name__.partition(".")[0]
_ROOT = Path(__file__).parents[__name__.count(".")]  # the folder that holds the package
_CHECKSUM = hashlib.sha256().digest_size


def folder() -> Path:
    """Return the folder of all compiled kernels; it need not be there."""
    chosen, caches = os.environ.get("HYPERFLEX_CACHE_DIR"), Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:
        if chosen:
            return Path(chosen).expanduser()
        return (caches if caches.is_absolute() else Path.home() / ".cache") / _PACKAGE
    except RuntimeError:  # a user without a home folder
        return Path(os.devnull, "no home folder")


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


def module_folder(module: str) -> Path:
    """Return the folder of the kernels of a module, as its sources are now."""
    return folder() / f"{module.removeprefix(f'{_PACKAGE}.')}-{source_hash(module)}"


def files(kernels: Iterable[tuple[str, str]]) -> Iterator[tuple[str, Path]]:
    """Yield the files of compiled kernels, each with its kernel's name; `kernels` are modules and functions."""
    for module in dict.fromkeys(module for module, _ in kernels):
        place = module_folder(module)
        for path in place.glob("*.nbc") if place.is_dir() else ():
            yield f"{module}.{path.name.partition('-')[0]}", path


def compiled(kernels: Sequence[tuple[str, str]]) -> int:
    """Return how many kernels have been compiled, for whatever arguments."""
    there = {name for name, _ in files(kernels)}
    return sum(f"{module}.{name}" in there for module, name in kernels)


def load(place: Path, name: str, key: str) -> bytes | None:
    """Return what was kept of a kernel under a key, None if there is nothing, or nothing that is whole.

    Of damage it is said once on standard error that kernels are compiled again for it.
    """
    path, head = _place(place, name, key)
    try:
        content = path.read_bytes()
    except OSError:
        return None
    whole = content[:_CHECKSUM] == hashlib.sha256(content[_CHECKSUM:]).digest()
    if not whole:
        _tell_damage(folder())
    return content[_CHECKSUM + len(head) :] if whole and content.startswith(head, _CHECKSUM) else None


def save(place: Path, name: str, key: str, content: bytes) -> None:
    """Keep what was made of a kernel under a key, or say once on standard error that nothing can be kept."""
    path, head = _place(place, name, key)
    try:
        _write(path, hashlib.sha256(head + content).digest() + head + content)
    except OSError as error:
        _complain(f"{folder()}: {error.strerror}")


def _place(place: Path, name: str, key: str) -> tuple[Path, bytes]:
    """Return the file of a kernel, and how its content begins after the checksum."""
    head = f"{place.name} {name} {key}\n".encode()
    return place / f"{name}-{hashlib.sha256(head).hexdigest()[:16]}.nbc", head


def _write(path: Path, content: bytes) -> None:
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
        f"hyperflex: cannot keep compiled kernels in {reason}. Each process compiles its own. "
        "HYPERFLEX_CACHE_DIR names another folder.\n"
    )


@functools.cache
def _tell_damage(place: Path) -> None:
    sys.stderr.write(f"hyperflex: compiled kernels in {place} are damaged; they are made again.\n")


def fingerprint(modules: Iterable[str]) -> str:
    """Return a hash of all kernels of modules, as their sources are now."""
    return hashlib.sha256("".join(sorted(map(source_hash, set(modules)))).encode()).hexdigest()[:16]
