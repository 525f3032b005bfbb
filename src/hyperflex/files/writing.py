"""Writing wholly or not at all: temporary name in the same folder, forced to the disk, then renamed.

A result that cannot be written where it should goes to a fallback folder, which the message names.
"""

import errno
import glob
import os
import re
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal, TypeVar

from hyperflex.errors import FileProblem, HyperflexError, InvalidInput
from hyperflex.interruption import deferred
from hyperflex.memory import in_words

PathLike = str | os.PathLike[str]
Answer = TypeVar("Answer")

LEFT_BEHIND = 3600.0  # s without a change after which no process is writing any more
_TOKEN = "[0-9a-f]" * 8
_NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NO_SPACE_TEXT = re.compile(r"No space left|File too large|quota exceeded", re.IGNORECASE)


@contextmanager
def atomic_path(path: PathLike) -> Iterator[Path]:
    """Give a temporary path in the folder of `path` to write to; rename it to `path` when the block succeeds.

    For libraries that open files by name. A link is followed; the folder must exist. The file is empty at first, keeps
    the suffix of `path`, and is removed if the block raises anything, KeyboardInterrupt included.

    Raises
    ------
    FileProblem
        When the folder is missing, `path` is no regular file, the disk is full, or writing fails otherwise. The
        message says whether an earlier file is unchanged.
    """
    target = _target(path)
    part = target.with_name(f".{target.stem[:40]}.{secrets.token_hex(4)}.part{target.suffix}")
    remove_left_behind(target.parent, f".{glob.escape(target.stem[:40])}.{_TOKEN}.part{glob.escape(target.suffix)}")
    try:
        os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield part
        with deferred():
            _replace(part, target)
    except HyperflexError:
        raise
    except OSError as error:
        raise _write_problem(target, part, error) from error
    finally:
        with deferred(), suppress(OSError):  # a disk that takes no files lets none be removed; an error says so already
            part.unlink(missing_ok=True)


def remove_left_behind(folder: Path, pattern: str) -> None:
    """Remove files and folders that processes which were killed have left half written, by a pattern of names."""
    for path in folder.glob(pattern):
        with suppress(OSError):
            newest = max(each.stat().st_mtime for each in (path, *(path.iterdir() if path.is_dir() else ())))
            if time.time() - newest > LEFT_BEHIND:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


@contextmanager
def atomic(path: PathLike, mode: Literal["w", "wb"] = "w") -> Iterator[IO[Any]]:
    """Open `path` for writing text (UTF-8, line feeds) or bytes, so that it changes wholly or not at all.

    The file appears at `path` when the block ends without an exception. FileProblem as for :func:`atomic_path`.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> with atomic(folder / "note.txt") as file:
    ...     _ = file.write("hanging")
    >>> (folder / "note.txt").read_text()
    'hanging'
    """
    text = {"encoding": "utf-8", "newline": "\n"} if mode == "w" else {}
    with atomic_path(path) as part, part.open(mode, **text) as file:  # type: ignore[call-overload]
        yield file


def as_path(path: PathLike, what: str = "file") -> Path:
    """Return `path` as a Path; InvalidInput when it is none (`what` names the kind of file in the message)."""
    if not isinstance(path, (str, os.PathLike)) or "\0" in os.fspath(path):
        raise InvalidInput(f"the path of the {what} is no path", got=path, allowed="a file name as str or pathlib.Path")
    return Path(path)


def check_writable(path: PathLike) -> None:
    """Refuse, before any work, a file that cannot be written now. Raises FileProblem as :func:`atomic_path` does."""
    target = _target(path)
    try:
        tempfile.TemporaryFile(dir=target.parent).close()
    except OSError as error:
        raise _write_problem(target, target, error) from error


def check_space(path: PathLike, size: float) -> None:
    """Refuse, before any work, a file or folder that will take about `size` bytes where there is less: FileProblem."""
    target = Path(os.path.realpath(path))
    base = next(folder for folder in (target, *target.parents) if folder.is_dir())
    free = shutil.disk_usage(base).free
    if size > free:
        raise FileProblem(
            f"{target} will take some {in_words(size)}, and {in_words(free)} are free there. Nothing was "
            "written. Free some space, or give a path on another disk."
        )


def write_text(path: PathLike, text: str) -> None:
    """Write `text` (UTF-8) to `path`, wholly or not at all. Raises FileProblem as :func:`atomic_path` does."""
    with atomic(path) as file:
        file.write(text)


def write_bytes(path: PathLike, content: bytes | memoryview) -> None:
    """Write `content` to `path`, wholly or not at all. Raises FileProblem as :func:`atomic_path` does."""
    with atomic(path, "wb") as file:
        file.write(content)


def _target(path: PathLike) -> Path:
    """Return the real path to write to, or say why it cannot be written."""
    target = Path(os.path.realpath(as_path(path)))
    try:
        kind = target.stat().st_mode
    except FileNotFoundError:
        kind = stat.S_IFREG
    except OSError as error:
        raise FileProblem(f"{target} cannot be reached: {error.strerror}. Give another path.") from error
    if stat.S_ISDIR(kind):
        raise FileProblem(f"{target} is a folder, not a file. Add a file name.")
    if not stat.S_ISREG(kind):
        raise FileProblem(f"{target} is a device or pipe. Only regular files can be written; give another path.")
    if not target.parent.is_dir():
        raise FileProblem(f"The folder {target.parent} does not exist. Create it first, or give another path.")
    return target


def _replace(part: Path, target: Path) -> None:
    """Force `part` to the disk and rename it to `target`, which keeps its permissions."""
    with part.open("rb+") as file:
        os.fsync(file.fileno())
    if target.exists():
        part.chmod(stat.S_IMODE(target.stat().st_mode))
    part.replace(target)


def _write_problem(target: Path, part: Path, error: OSError) -> FileProblem:
    """Turn a system error into one that says what happened to the user's file."""
    unchanged = "The earlier file is unchanged" if target.exists() else "Nothing was written"
    if error.errno in _NO_SPACE or _NO_SPACE_TEXT.search(str(error)):
        reason, fix = "no space left", "Free some space and try again"
    else:
        ours = error.filename in (None, str(part))
        reason = (ours and error.strerror) or str(error).replace(part.name, target.name)
        fix = "Give another path"
    return FileProblem(f"{target} could not be written: {reason}. {unchanged}. {fix}.")


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
