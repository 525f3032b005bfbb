"""The folder that a report goes to: all of its files or none."""

import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from hyperflex import files
from hyperflex.errors import FileProblem
from hyperflex.interruption import deferred

Progress = Callable[[str], None]  # called with a message on what is being done
_EARLIER = "earlier"  # folder of the files to replace, until all are replaced


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
    except (FileProblem, OSError) as error:
        if stage is not None and any((stage / _EARLIER).glob("*")):
            kept = True
            raise FileProblem(
                f"The folder {target} could not be filled, and not all its earlier files could be put back. "
                f"They are in {stage / _EARLIER}; move them back."
            ) from error
        if isinstance(error, FileProblem):
            raise FileProblem(str(error).replace(str(stage or target), str(target))) from error
        raise FileProblem(
            f"The folder {target} cannot be made or filled: {error.strerror}. Nothing was written. Give another one."
        ) from error
    finally:
        if stage is not None and not kept:
            with deferred():
                shutil.rmtree(stage, ignore_errors=True)


def check_folder(directory: str | Path) -> None:
    """Check before any work that a folder can be made and filled; FileProblem otherwise, see :func:`whole_folder`."""
    with whole_folder(directory):
        pass
    files.check_space(directory, 8.0 * 2**20)  # bytes: a report with a film


def _stage(target: Path) -> Path:
    """Make the temporary folder, in `target` or, where that is not there yet, in the nearest folder above it."""
    base = next(path for path in (target, *target.parents) if path.exists())
    if not base.is_dir():
        raise FileProblem(f"{target} is or lies under a file, not a folder. Give the name of a folder.")
    files.remove_left_behind(base, f".hyperflex.{'[0-9a-f]' * 8}.part")
    stage = base / f".hyperflex.{secrets.token_hex(4)}.part"
    stage.mkdir()
    return stage


def _move(stage: Path, target: Path, own: Sequence[str]) -> None:
    """Replace the `own` files by those of `stage`; restore everything on failure."""
    names = sorted(path.name for path in stage.iterdir())
    for name in (*names, *own):
        if (target / name).is_dir():
            raise FileProblem(f"{target / name} is a folder where a file shall go. Nothing was written. Move it away.")
    if not names and not own:
        return
    earlier = stage / _EARLIER
    target.mkdir(parents=True, exist_ok=True)
    with ExitStack() as undo:
        undo.callback(_remove_if_empty, target)
        earlier.mkdir()
        for name in (*names, *(set(own) - set(names))):
            for source, place in ((target / name, earlier / name), (stage / name, target / name)):
                with suppress(FileNotFoundError):
                    source.rename(place)
                    undo.callback(place.replace, source)
        undo.pop_all()


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):  # it was there before: the stage is within it
        folder.rmdir()
