"""Output of the commands: results to standard output, everything else to standard error."""

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, cast

import typer

from hyperflex import files, interruption, progress
from hyperflex.errors import InvalidInput
from hyperflex.interruption import catch_interrupt

if TYPE_CHECKING:
    from rich.console import Console

    from hyperflex.estimate import ChangeTests, EstimatedParameter
    from hyperflex.vision import Image, MarkerColour

_T = TypeVar("_T")
# exit codes; interrupted: 128 and the number of the signal
FAILED, REFUSED, NOT_CONVERGED, NO_PLAN, NOT_USABLE = 1, 2, 3, 4, 5
_VALUE = r"=(?P<value>'[^']*'|\[[^\]]*\]|\([^)]*\)|\.+|-?[\w.]+)"  # of an argument, as errors advise it
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else there.")]

ARC_LENGTHS = typer.Option(help="How far along the rope each marker sits, m; several times or with commas.")
Click = Annotated[
    tuple[float, float] | None,
    typer.Option(
        help="A pixel of a marker in the first frame, u v. [default: the colour that most small things share]"
    ),
]
Estimate = Annotated[
    str, typer.Option(help="What is estimated beside the rope's state: scale=0.01,delay=0.02 (standard deviations).")
]


Changes = Annotated[
    str,
    typer.Option(
        help="What is tested for changes: tip_mass,touch; none. [default: length, tip_mass, friction, drag, touch]"
    ),
]
FalseAlarmInterval = Annotated[
    float, typer.Option(help="Mean time between two false alarms of these tests, s, at least.")
]


def print_json(result: Mapping[str, Any], *, one_line: bool = False) -> None:
    """Print one JSON object on standard output; what JSON has no number for (NaN, infinity) becomes null."""
    sys.stdout.write(files.dumps_json(result, one_line=one_line))
    if one_line:  # somebody waits for it
        sys.stdout.flush()


def complain(message: str, kind: str, code: int, *, as_json: bool) -> int:
    """Say what went wrong on standard error, and as a JSON object if that was asked for; return `code`."""
    sys.stderr.write(f"hyperflex: {message}\n")
    if as_json:
        print_json({"error": message, "type": kind}, one_line=True)
    return code


def warner() -> Callable[..., None]:
    """Return a ``warnings.showwarning`` that writes each warning once, as a line on standard error."""
    told: set[str] = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in told:
            told.add(str(message))
            sys.stderr.write(f"hyperflex: {message}\n")

    return show


def with_options(message: str, options: Mapping[str, str]) -> str:
    """Return a message on arguments as one on options (``--time-unit`` by the argument's name) and tables of a file.

    ``name=value`` becomes ``--name value`` where there is such an option; a name stands for its option where the
    message begins with it, or where it has an underscore and so is no word. Values such as ``Peg(x=0.1)`` stay.
    """
    if not options:
        return files.toml_words(message)

    def option(found: re.Match[str]) -> str:
        if found["name"] is None:
            return found[0]
        value = found["value"].strip("'\"[]()").replace(", ", ",")
        return options[found["name"]] if value == "True" else f"{options[found['name']]} {value}"

    message = re.sub(rf"\b(?:[A-Z]\w*\([^()]*\)|(?P<name>{'|'.join(options)}){_VALUE})", option, message)
    plain = "|".join(name for name in options if "_" in name) or "$^"
    message = re.sub(rf"(?<![\w/.'-])({plain})(?![\w/']|\.\w)", lambda found: options[found[1]], message)
    message = re.sub(
        rf"^({'|'.join(options)})(?= (?:is|has|cannot|leaves)\b|\[)", lambda found: options[found[1]], message
    )
    return files.toml_words(message)


def interrupted(message: str, left: Mapping[str, Any], *, as_json: bool) -> int:
    """Say on standard error that Ctrl-C or SIGTERM came, and as JSON, with what was `left`; return the exit code."""
    sys.stderr.write(f"hyperflex: {message}\n")
    if as_json:
        print_json({**left, "error": "interrupted", "type": "Interrupted", "message": message}, one_line=True)
    return 128 + interruption.number()


def partial_of(work: Callable[[], _T]) -> _T:
    """Return what `work` returns, or what it leaves when it is interrupted; KeyboardInterrupt if that is nothing."""
    with catch_interrupt() as stop:
        result = work()
    if not stop.received:
        return result
    if stop.partial is None:
        raise KeyboardInterrupt
    return cast(_T, stop.partial)


def partial_path(out: Path) -> Path:
    """Return the file that a partial result is written to, so that a whole one of an earlier run stands."""
    return out.with_stem(f"{out.stem}-interrupted")


@contextmanager
def keeping(written: Mapping[str, Path], missing: str, result: Mapping[str, Any], *, as_json: bool) -> Iterator[None]:
    """Exit where Ctrl-C comes in the block, and say which files are `written` and what is `missing`.

    `result` is what JSON tells beside it.
    """
    with catch_interrupt() as stop:
        yield
    if stop.received:
        there = ", ".join(str(path) for path in written.values()) or "nothing"
        left = {**result, "files": written, "missing": missing}
        message = f"Interrupted. Written: {there}. Missing: {missing}."
        raise typer.Exit(interrupted(message, left, as_json=as_json))


def check_destination(out: Path | None, suffix: str, inputs: Sequence[Path]) -> None:
    """Refuse, before any work, an output of another kind than `suffix`, among the inputs, or that cannot be written."""
    if out is None:
        return
    check_no_input(out, inputs)
    if out.suffix.lower() != suffix:
        raise InvalidInput(
            "the output has the wrong suffix",
            got=str(out),
            allowed=f"a name ending in {suffix}",
            fix="Give a name that ends so",
        )
    files.check_writable(out)


def check_no_input(out: Path, inputs: Sequence[Path]) -> None:
    """Refuse an output that is among the inputs."""
    for path in inputs:
        if _exists(out) and _exists(path) and out.samefile(path):
            raise InvalidInput(
                "the output is one of the inputs and would overwrite it",
                got=str(out),
                allowed=f"a file other than {path}",
                fix="Give another name with -o",
            )


def words(given: Sequence[str] | None) -> list[str]:
    """Return the words that an option was given, with commas or several times."""
    return [word.strip() for text in given or () for word in text.split(",") if word.strip()]


def numbers(option: str, given: Sequence[str], example: str) -> list[float]:
    """Return the numbers that an option was given, in one or several words."""
    try:
        return [float(word) for word in words(given)]
    except ValueError:
        raise InvalidInput(
            f"{option} holds something that is no number", got=",".join(given), allowed=f"numbers such as {example}"
        ) from None


def parameters(text: str) -> "list[EstimatedParameter]":
    """Return what ``--estimate scale=0.01,delay=0.02`` asks for."""
    from hyperflex.estimate import EstimatedParameter

    result = []
    for each in words([text]):
        name, _, std = (part.strip() for part in each.partition("="))
        if not std:
            allowed = "each with the standard deviation of what is known of it, as in scale=0.01,delay=0.02"
            raise InvalidInput("--estimate names something without a number", got=each, allowed=allowed)
        result.append(EstimatedParameter(name, numbers("--estimate", [std], "scale=0.01")[0]))
    return result


def marker_colour(images: "Iterable[Image]", click: tuple[float, float] | None) -> "MarkerColour":
    """Return the markers' colour: that of the first picture which shows one, or at a pixel of the first picture."""
    from hyperflex.vision import MarkerColour

    looked = 0
    for image in images:
        if click is not None:
            return MarkerColour.from_click(image, click)
        with suppress(InvalidInput):
            return MarkerColour.from_frame(image)
        looked += 1
    if not looked:
        raise InvalidInput("no frame came", fix="Check the source, and --at where it is given")
    raise InvalidInput(
        "no colour of markers was found",
        got=f"{looked} frames",
        allowed="a frame with at least 3 small things of one strong colour and size",
        fix="Name a pixel of a marker with --click U V",
    )


def change_tests(changes: str, false_alarm_interval: float) -> "ChangeTests | None":
    """Return what ``--changes tip_mass,touch`` and ``--false-alarm-interval`` ask for; None for ``none``."""
    from hyperflex.estimate import ChangeTests

    names = tuple(words([changes]))
    return None if names == ("none",) else ChangeTests(names or None, false_alarm_interval)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that is too long, say; whoever opens it will tell
        return False


def console() -> "Console":
    """Return a console on standard output."""
    from rich.console import Console

    return Console(highlight=False)


def print_pairs(title: str, pairs: Sequence[tuple[str, str]]) -> None:
    """Print named values below a title."""
    screen = console()
    screen.print(f"[bold]{title}[/bold]")
    width = max(len(name) for name, _ in pairs)
    for name, value in pairs:
        screen.print(f"  {name.ljust(width)}  {value}", soft_wrap=True, markup=False)


def print_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table of ready-made cells."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in header:
        table.add_column(name, overflow="fold")
    for row in rows:
        table.add_row(*row)
    console().print(table)


def show(
    result: Mapping[str, Any],
    title: str,
    pairs: Sequence[tuple[str, str]],
    *,
    as_json: bool,
    one_line: bool = False,
) -> None:
    """Print a `result` as JSON, or its named values in words below a title; in JSON on `one_line` if asked."""
    if as_json:
        print_json(result, one_line=one_line)
    else:
        print_pairs(title, pairs)


@contextmanager
def spinner() -> Iterator[Any]:
    """Show on standard error what is being done; yields a function that takes the words."""
    if (watched := progress.terminal()) is None:
        with progress.lines() as say:
            yield say
    else:
        with watched.status("starting") as status:
            yield status.update
