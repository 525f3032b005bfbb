"""Reading whole files with messages that say what to do; devices, pipes and files beyond a bound are refused."""

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hyperflex.errors import FileProblem, HyperflexError, InvalidInput
from hyperflex.files.writing import PathLike, as_path

LARGEST = 1 << 30  # bytes that are read into memory
# By kind of file, bytes: text is read into memory; a rope of 100,000 links, each property an array, has some 20 MB
SMALLER = {"table": 256_000_000, "TOML file": 64_000_000}


def regular_file(path: PathLike, what: str = "file", most: float | None = None) -> Path:
    """Return the path of a regular file that is not empty; `what` names its kind in messages.

    It has at most `most` bytes, by default SMALLER for its kind, or LARGEST.

    Raises
    ------
    FileProblem
        When it is missing, a folder, a device, a pipe or a socket, empty, too large or not to be reached.
    InvalidInput
        When `path` is no path at all, e.g. None.
    """
    file, most = as_path(path, what), SMALLER.get(what, LARGEST) if most is None else most
    try:
        status = file.stat()
    except FileNotFoundError:
        raise FileProblem(f"There is no {what} {path}. Check the name and the folder.") from None
    except OSError as error:
        raise FileProblem(
            f"The {what} {str(path)[:200]} cannot be read: {error.strerror}. Give another path."
        ) from error
    except ValueError:  # half of a surrogate pair, say
        raise InvalidInput(
            f"the path of the {what} is no path", got=path, allowed="a name that can be encoded"
        ) from None
    if stat.S_ISDIR(status.st_mode):
        raise FileProblem(f"{path} is a folder, not a {what}. Add a file name.")
    if not stat.S_ISREG(status.st_mode):
        raise FileProblem(
            f"{path} is a device, pipe or socket, not a {what}. Only regular files are read: save what comes from it "
            "to a file, and give that."
        )
    if status.st_size == 0:
        raise FileProblem(f"The {what} {path} is empty (0 bytes). It may have been cut off; get it again.")
    if status.st_size > most:
        raise FileProblem(
            f"The {what} {path} has {status.st_size / 1e6:.0f} MB; at most {most / 1e6:.0f} MB are read. Check that it "
            "is the right file, and cut it to the part that is needed."
        )
    return file


@contextmanager
def not_damaged(what: str, path: PathLike, advice: str = "Get it, or write it, again") -> Iterator[None]:
    """Raise FileProblem for errors of the block, in which a library reads a file; `what` names the file's kind.

    On damaged files libraries raise errors of nearly all classes.
    """
    try:
        yield
    except HyperflexError:
        raise
    except Exception as error:
        raise FileProblem(f"The {what} {path} cannot be read: it is damaged or cut off. {advice}.") from error


def read_bytes(path: PathLike, what: str = "file") -> bytes:
    """Return the content of a file. Raises FileProblem and InvalidInput as :func:`regular_file` does."""
    try:
        with regular_file(path, what).open("rb") as file:
            return file.read()
    except FileProblem:
        raise
    except OSError as error:
        raise FileProblem(f"The {what} {path} cannot be read: {error.strerror}. Give another path.") from error


def read_text(path: PathLike, what: str = "file", *, any_encoding: bool = False) -> str:
    """Return a UTF-8 text (a byte order mark is dropped); with `any_encoding` also UTF-16 with a mark, and Latin-1.

    Raises FileProblem for other encodings and binary files.
    """
    content = read_bytes(path, what)
    wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        text = content.decode("utf-16" if wide and any_encoding else "utf-8-sig")
    except UnicodeDecodeError as error:
        if wide:
            advice = "It is damaged or cut off" if any_encoding else "Save it as UTF-8 and try again"
            raise FileProblem(f"{path} is UTF-16 text that cannot be read. {advice}.") from None
        if not any_encoding:
            line = content[: error.start].count(b"\n") + 1
            raise FileProblem(
                f"{path} is not a text {what}: byte {error.start} (line {line}) is not UTF-8. Give a text "
                "file in UTF-8."
            ) from None
        text = content.decode("latin-1")
    if "\x00" in text:
        raise FileProblem(f"{path} is a binary file, not a text {what}. Give a text file in UTF-8.")
    return text
