"""Disk cache of compiled kernels.

There is one file for each kernel and argument types, in one folder for each state of the sources of all kernels:
numba's own cache does not detect an edit in *another* file. A file is written completely or not at all, and is read
only if its checksum is right. A cache that is read-only, full, damaged or filled by several processes at once therefore
costs time but never gives a wrong run. Damaged files and failed writes are reported on standard error.

``HYPERFLEX_CACHE_DIR`` names the cache; without it, it is ``hyperflex`` in the user's cache folder.
"""

import functools
import hashlib
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numba
import numpy as np

_PACKAGE = __name__.partition(".")[0]
_CHECKSUM = hashlib.sha256().digest_size


def _source_hash() -> str:
    config = [getattr(numba.config, name, None) for name in ("OPT", "BOUNDSCHECK", "LOOP_VECTORIZE", "SLP_VECTORIZE")]
    digest = hashlib.sha256(repr((numba.__version__, np.__version__, sys.version, config)).encode())
    core = Path(__file__).parent
    for path in sorted(core.rglob("*.py")):
        digest.update(path.relative_to(core).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


SOURCE_HASH = _source_hash()  # of all kernels and of their compiler


def folder() -> Path:
    """Return the folder of all compiled kernels; it may not exist."""
    chosen, caches = os.environ.get("HYPERFLEX_CACHE_DIR"), Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:
        if chosen:
            return Path(chosen).expanduser()
        return (caches if caches.is_absolute() else Path.home() / ".cache") / _PACKAGE
    except RuntimeError:  # a user without a home folder
        return Path(os.devnull, "no home folder")


def kernels_folder() -> Path:
    """Return the folder of the kernels for their present sources."""
    return folder() / f"kernels-{SOURCE_HASH}"


def compiled(kernels: Sequence[tuple[str, str]]) -> int:
    """Return the number of kernels (module and function) that have been compiled for any arguments."""
    place = kernels_folder()
    there = {path.name.rsplit("-", 2)[0] for path in place.glob("*.nbc")} if place.is_dir() else set()
    return sum(f"{module}.{name}" in there for module, name in kernels)


def load(name: str, key: str) -> bytes | None:
    """Return the content saved for a kernel under a key; None if it is missing or damaged.

    Damage is reported once on standard error.
    """
    path, head = _place(name, key)
    try:
        content = path.read_bytes()
    except OSError:
        return None
    whole = content[:_CHECKSUM] == hashlib.sha256(content[_CHECKSUM:]).digest()
    if not whole:
        _report_damage(folder())
    return content[_CHECKSUM + len(head) :] if whole and content.startswith(head, _CHECKSUM) else None


def save(name: str, key: str, content: bytes) -> None:
    """Save the content of a kernel under a key, or report once on standard error that nothing can be saved."""
    path, head = _place(name, key)
    try:
        _write(path, hashlib.sha256(head + content).digest() + head + content)
    except OSError as error:
        _complain(f"{folder()}: {error.strerror}")


def _place(name: str, key: str) -> tuple[Path, bytes]:
    """Return the file of a kernel, and the beginning of its content after the checksum."""
    head = f"{SOURCE_HASH} {name} {key}\n".encode()
    return kernels_folder() / f"{name}-{hashlib.sha256(head).hexdigest()[:16]}.nbc", head


def _write(path: Path, content: bytes) -> None:
    """Write a file completely or not at all, and make its folder."""
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
def _report_damage(place: Path) -> None:
    sys.stderr.write(f"hyperflex: compiled kernels in {place} are damaged; they are compiled again.\n")
