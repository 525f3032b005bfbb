"""A result that cannot be written where it should goes to a fallback folder, which the message names."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from hyperflex.errors import FileProblem

Answer = TypeVar("Answer")


def rescued(write: Callable[[Path], Answer], path: Path) -> Answer:
    """Call ``write(path)``; where that fails, write to a new folder of the user's state or of temporary files.

    Parameters
    ----------
    write : callable
        Writes a file or a folder to the path that it is given, wholly or not at all.
    path : pathlib.Path
        Where it should be.

    Raises
    ------
    FileProblem
        It is not where it should be; the message says where it is instead.
    """
    try:
        return write(path)
    except FileProblem as error:
        place = next(filter(None, (_written(write, base, path) for base in _fallbacks())), None)
        if place is None:
            raise
        raise FileProblem(f"{error} The result is in {place} instead.") from error


def _written(write: Callable[[Path], object], base: Path, path: Path) -> Path | None:
    """Write to a new folder in `base`, under the name of `path`; return the place, None where that fails, too."""
    try:
        base.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix="hyperflex-", dir=base))
    except OSError:
        return None
    try:
        place = folder / (path.resolve().name or "result")
        write(place)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError):  # FileProblem is one
            return None
        raise
    return place


def _fallbacks() -> Iterator[Path]:
    """Yield folders that may take what another one did not: of the user's state, then of temporary files."""
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    with suppress(RuntimeError):  # a user without a home folder
        yield (state if state.is_absolute() else Path.home() / ".local" / "state") / "hyperflex"
    with suppress(OSError):  # no folder takes temporary files
        yield Path(tempfile.gettempdir())
