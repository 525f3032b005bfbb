"""Output of commands: results to standard output, all else to standard error; interruption and exit codes."""

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar, cast

import typer

from hyperflex import files, interruption, progress
from hyperflex.interruption import stoppable
from hyperflex.status import Status

if TYPE_CHECKING:
    from hyperflex.report import TextTable

_T = TypeVar("_T")
_VALUE = r"=(?P<value>'[^']*'|\[[^\]]*\]|\([^)]*\)|\.+|-?[\w.]+)"  # of an argument, as errors advise it
_mode = {"json": False}
WARNED: list[str] = []  # by the command that runs


class ExitCode(IntEnum):
    """How a command ended; interrupted: 128 and the number of the signal."""

    SUCCESS = 0
    FAILED = 1
    REFUSED = 2
    NOT_CONVERGED = 3
    NO_PLAN = 4
    NOT_USABLE = 5


class Rows(NamedTuple):
    """Named values below a title."""

    title: str
    rows: Sequence[tuple[str, object]]


Block: TypeAlias = "str | Rows | TextTable"
_UNITS = {"m": "m", "s": "s", "px": "px", "deg": "degrees", "N": "N", "Nm": "N m", "J": "J"}  # that end names in JSON


def json_only(enabled: bool) -> None:
    """Make a single JSON object the only output of the command that runs, or not."""
    _mode["json"] = enabled


def as_json() -> bool:
    """Return whether the command prints JSON."""
    return _mode["json"]


def print_json(result: Mapping[str, Any], *, one_line: bool = False) -> None:
    """Print one JSON object on standard output; what JSON has no number for (NaN, infinity) becomes null."""
    sys.stdout.write(files.dumps_json(result, one_line=one_line))
    if one_line:  # a program waits for it
        sys.stdout.flush()


def note(message: str) -> None:
    """Print a message on standard error."""
    sys.stderr.write(f"hyperflex: {message}\n")


def complain(message: str, kind: str, code: int) -> int:
    """Print an error on standard error, and as a JSON object with ``--json``; return its exit code."""
    note(message)
    if as_json():
        print_json(_whole({"error": message, "type": kind}, Status.FAILED), one_line=True)
    return code


def _whole(result: Mapping[str, Any], status: Status) -> dict[str, Any]:
    """Return a result with what each has in JSON: success, status and warnings; its own status has precedence."""
    return {"success": status is Status.SUCCESS, "status": status, "warnings": WARNED, **result}


def warner() -> Callable[..., None]:
    """Return a ``warnings.showwarning`` that prints each warning once on standard error."""
    WARNED.clear()

    def show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in WARNED:
            WARNED.append(str(message))
            note(str(message))

    return show_warning


def with_options(message: str, options: Mapping[str, str]) -> str:
    """Return a message on arguments as one on options (``--time-unit`` by the argument's name) and tables of a file.

    ``name=value`` becomes ``--name value`` if there is such an option. A name alone becomes its option where the
    message begins with it, or if it has an underscore and so is no word. Values such as ``Peg(x=0.1)`` stay.
    """
    if not options:
        return files.toml_words(message)

    def option(found: re.Match[str]) -> str:
        if found["name"] is None:
            return found[0]
        value = found["value"].strip("'\"[]()").replace(", ", ",")
        return options[found["name"]] if value == "True" else f"{options[found['name']]} {value}"

    names, plain = "|".join(options), "|".join(name for name in options if "_" in name) or "$^"
    message = re.sub(rf"\b(?:[A-Z]\w*\([^()]*\)|(?P<name>{names}){_VALUE})", option, message)
    for pattern in (rf"(?<![\w/.'-])({plain})(?![\w/']|\.\w)", rf"^({names})(?= (?:is|has|cannot|leaves)\b|\[)"):
        message = re.sub(pattern, lambda found: options[found[1]], message)
    return files.toml_words(message)


def show(
    result: Mapping[str, Any], *blocks: Block, one_line: bool = False, interrupted: str = "", code: int = 0
) -> None:
    """Print a result as JSON, or as blocks of text, and end the command if it was interrupted or has an exit `code`.

    `interrupted` says what was interrupted and what is kept.
    """
    if not as_json():
        print_blocks(*blocks)
    elif not interrupted:
        print_json(_whole(result, Status.FAILED if code else Status.SUCCESS), one_line=one_line)
    if interrupted:
        code = interrupt(result, interrupted)
    if code:
        raise typer.Exit(code)


def interrupt(result: Mapping[str, Any], message: str) -> int:
    """Report an interruption, with what there is of a result as JSON; return the exit code."""
    note(message)
    if as_json():
        told = {**result, "error": "interrupted", "type": "Interrupted", "message": message}
        print_json(_whole(told, Status.INTERRUPTED), one_line=True)
    return 128 + interruption.number()


def print_blocks(*blocks: Block) -> None:
    """Print texts, named values and tables."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    for block in blocks:
        if isinstance(block, str):
            console.print(block, markup=False, soft_wrap=not console.is_terminal)
        elif isinstance(block, Rows):
            console.print(block.title, style="bold", markup=False)
            width = max((len(name) for name, _ in block.rows), default=0)
            for name, value in block.rows:
                console.print(f"  {name.ljust(width)}  {value}", soft_wrap=True, markup=False)
        else:
            table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
            for name in block.header:
                table.add_column(name, overflow="fold")
            for row in block.rows:
                table.add_row(*map(Text, row))
            console.print(table)


def rows(title: str, result: Mapping[str, Any], *more: tuple[str, str]) -> Rows:
    """Return the values of a result, as JSON has them, below a title: names in words, with units; then `more` rows."""
    return Rows(title, [*_rows(files.plain(result)), *more])


def _rows(result: Mapping[str, Any], above: str = "", unit: str = "") -> Iterator[tuple[str, str]]:
    """Yield names and values; mappings are gone through, and lists of texts have a row for each."""
    for key, value in result.items():
        name, _, end = key.rpartition("_")
        words, own = (name, _UNITS[end]) if end in _UNITS else (key, unit)
        if words.endswith("_per"):
            words, own = words.removesuffix("_per"), f"1/{own}"
        label = f"{above} {words}".strip().replace("_", " ")
        if isinstance(value, Mapping):
            if value.keys() >= {"value", "std"}:
                yield label, f"{value['value']:.5g} (std {value['std']:.2g}) {value.get('unit', own)}".rstrip()
            else:
                yield from _rows(value, label, own)
        elif isinstance(value, list) and not all(isinstance(each, int | float) for each in value):
            yield from ((label.removesuffix("s"), each) for each in value if isinstance(each, str))
        elif value not in (None, []):
            yield label, f"{_text(value)} {own}".rstrip()


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"({', '.join(map(_text, value))})"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def run(work: Callable[[], _T]) -> tuple[_T, bool]:
    """Return what `work` returns and False, or its partial result and True if it was interrupted.

    Raises KeyboardInterrupt if it left no partial result.
    """
    with stoppable() as stop:
        result = work()
    if not stop.received:
        return result, False
    if stop.partial is None:
        raise KeyboardInterrupt
    return cast(_T, stop.partial), True


def partial_path(out: Path) -> Path:
    """Return the file for a partial result, which leaves the whole result of an earlier run alone."""
    return out.with_stem(f"{out.stem}-interrupted")


@contextmanager
def keeping(written: Mapping[str, Path], missing: str, result: Mapping[str, Any]) -> Iterator[None]:
    """End the command if the block is interrupted: print which files are `written` and what is `missing`."""
    with stoppable() as stop:
        yield
    if stop.received:
        there = ", ".join(str(path) for path in written.values()) or "nothing"
        message = f"Interrupted. Written: {there}. Missing: {missing}."
        show({**result, "files": written, "missing": missing}, interrupted=message)


@contextmanager
def spinner() -> Iterator[Any]:
    """Show on standard error what is being done; yields a function that takes the text."""
    if (watched := progress.terminal()) is None:
        with progress.lines() as say:
            yield say
    else:
        with watched.status("starting") as status:
            yield status.update
