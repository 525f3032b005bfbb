"""The folder that a report goes to."""

from __future__ import annotations

from pathlib import Path

from hyperflex.errors import FileProblem


def output_folder(directory: str | Path) -> Path:
    """Return `directory` as a folder that exists, making it and its parents if need be.

    Raises
    ------
    FileProblem
        There is a file of that name, or no permission to make the folder.
    """
    folder = Path(directory)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise FileProblem(f"{folder} is or lies under a file, not a folder. Give the name of a folder.") from None
    except OSError as error:
        raise FileProblem(f"The folder {folder} cannot be made: {error.strerror}. Give another one.") from error
    return folder
