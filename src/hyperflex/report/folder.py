"""The folder that a report goes to: all of its files or none."""

import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from hyperflex import files
from hyperflex.errors import FileProblem
from hyperflex.interruption import deferred

Progress = Callable[[str], None]  # called with a message on what is being done


def silent(message: str) -> None:
    """Do nothing: the default progress callable."""


@contextmanager
def whole_folder(directory: str | Path, own: Sequence[str] = ()) -> Iterator[Path]:
    """Provide a temporary folder; move its files to `directory` if the block succeeds.

    Parameters
    ----------
    directory : str or Path
        Where the files go in the end; made with its parents if need be. Other files there stay, files of the same
        names are replaced at the end.
    own : sequence of str, optional
        Names of files that are removed there at the end if the block writes none of the name: an earlier report's.

    Yields
    ------
    pathlib.Path
        An empty folder on the same disk. It is removed if the block raises anything, KeyboardInterrupt included;
        `directory` is then as it was.

    Raises
    ------
    FileProblem
        There is a file of that name, no permission, no space, or a folder in the way of one of the files.
    """
    target, stage = Path(os.path.realpath(directory)), None
    kept = False  # the stage holds earlier files that could not be put back
    try:
        with deferred():
            stage = _stage(target)
        yield stage
        with deferred():
            _move(stage, target, own)
    except _NotPutBackError:
        kept = True
        raise
    except FileProblem as error:
        raise FileProblem(str(error).replace(str(stage or target), str(target))) from error
    except OSError as error:
        raise _problem(target, error) from error
    finally:
        if stage is not None and not kept:
            with deferred():
                shutil.rmtree(stage, ignore_errors=True)


class _NotPutBackError(FileProblem):
    """A folder could neither be filled nor restored."""


def check_folder(directory: str | Path) -> None:
    """Check before any work that a folder can be made and filled; FileProblem otherwise, see :func:`whole_folder`."""
    with deferred():
        _stage(Path(os.path.realpath(directory))).rmdir()
    files.check_space(directory, 8.0 * 2**20)  # bytes: a report with a film


def _stage(target: Path) -> Path:
    """Make the temporary folder, in `target` or, where that is not there yet, in the nearest folder above it."""
    try:
        base = next(path for path in (target, *target.parents) if path.exists())
        if not base.is_dir():
            raise FileProblem(f"{target} is or lies under a file, not a folder. Give the name of a folder.")
        files.remove_left_behind(base, f".hyperflex.{'[0-9a-f]' * 8}.part")
        stage = base / f".hyperflex.{secrets.token_hex(4)}.part"
        stage.mkdir()
    except FileProblem:
        raise
    except OSError as error:
        raise _problem(target, error) from error
    return stage


def _move(stage: Path, target: Path, own: Sequence[str]) -> None:
    """Replace the `own` files by those of `stage`; restore everything on failure."""
    names = sorted(path.name for path in stage.iterdir())
    for name in (*names, *own):
        if (target / name).is_dir():
            raise FileProblem(f"{target / name} is a folder where a file shall go. Nothing was written. Move it away.")
    done: list[tuple[Path, Path]] = []
    earlier = stage / "earlier"
    target.mkdir(parents=True, exist_ok=True)
    try:
        earlier.mkdir()
        for name in (*names, *(set(own) - set(names))):
            for source, place in ((target / name, earlier / name), (stage / name, target / name)):
                with suppress(FileNotFoundError):
                    source.rename(place)
                    done.append((source, place))
    except BaseException as error:
        _undo(done, stage, target, error)
        if isinstance(error, OSError):
            raise _problem(target, error) from error
        raise


def _undo(done: list[tuple[Path, Path]], stage: Path, target: Path, error: BaseException) -> None:
    """Undo renames from sources to places, the last one first."""
    try:
        for source, place in reversed(done):
            place.replace(source)
        with suppress(OSError):  # it was there before: the stage is within it
            target.rmdir()
    except OSError as problem:
        raise _NotPutBackError(
            f"The folder {target} could not be filled, and not all its earlier files could be put back: "
            f"{problem.strerror}. They are in {stage / 'earlier'}; move them back."
        ) from error


def _problem(target: Path, error: OSError) -> FileProblem:
    return FileProblem(
        f"The folder {target} cannot be made or filled: {error.strerror}. Nothing was written. Give another one."
    )
