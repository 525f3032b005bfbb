"""Reading whole files with messages that say what to do."""

from hyperflex.errors import FileProblem
from hyperflex.files.writing import PathLike, as_path


def read_bytes(path: PathLike, what: str = "file") -> bytes:
    """Return the content of a file; `what` names its kind in messages.

    Raises
    ------
    FileProblem
        When it is missing, a folder, not readable or empty.
    InvalidInput
        When `path` is no path at all, e.g. None.
    """
    try:
        content = as_path(path, what).read_bytes()
    except FileNotFoundError:
        raise FileProblem(f"There is no {what} {path}. Check the name and the folder.") from None
    except IsADirectoryError:
        raise FileProblem(f"{path} is a folder, not a {what}.") from None
    except OSError as error:
        raise FileProblem(f"The {what} {path} cannot be read: {error.strerror}.") from error
    if not content:
        raise FileProblem(f"The {what} {path} is empty (0 bytes). It may have been cut off; get it again.")
    return content


def read_text(path: PathLike, what: str = "file") -> str:
    """Return a UTF-8 text (a byte order mark is dropped). Raises FileProblem for other encodings and binary files."""
    content = read_bytes(path, what)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FileProblem(f"{path} is UTF-16 text. Save it as UTF-8 and try again.")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileProblem(
            f"{path} is not a text {what}: byte {error.start} is not UTF-8. Give a text file in UTF-8."
        ) from None
    if "\x00" in text:
        raise FileProblem(f"{path} is a binary file, not a text {what}. Give a text file in UTF-8.")
    return text
