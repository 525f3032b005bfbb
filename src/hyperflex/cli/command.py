"""Commands: options made from dataclasses, arguments that several commands share, and checks of what is given."""

import functools
import inspect
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, Field, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer

from hyperflex import checks, files
from hyperflex.checks import Array
from hyperflex.cli import output
from hyperflex.errors import InvalidInput
from hyperflex.options import options_of

Given = dict[str, Any]  # the options of a dataclass that were given, by name
Json = Annotated[bool, "Print one JSON object on standard output and nothing else there."]


OutFolder = Annotated[Path, "Folder to write to; made if it does not exist."]
ArmLength = Annotated[float | None, "Length of the arm that the motor turns", "m", "0.105"]
Workers = Annotated[int, typer.Option(min=1, help="Number of processes; each takes one processor.")]
ArcLengths = Annotated[list[str] | None, "Distance of each marker along the rope, m; several times or with commas."]

Click = Annotated[
    list[str] | None,
    "Pixel u,v of a marker in the first frame; once for each colour of the markers. [default: the colour that most "
    "small things share]",
]


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function whose signature has the options of dataclasses one by one, and ``--json``.

    An argument annotated with a dataclass becomes the options of its fields, which are annotated in the same way, and
    receives an instance. One annotated ``Annotated[Given, MotorLimits]`` becomes one option for each option of that
    dataclass, and receives those that were given. With ``Annotated[Given, Problem, "clearance"]`` only the named ones.
    Options x and y become one option with the name of the argument: ``--slot X Y``.

    An argument annotated with a text, ``Annotated[float, "Time of a half turn", "s"]``, becomes an option with this
    help; with a unit, its value must be positive. A third text is shown as its default, where that is None. The
    argument `out` is the option ``--output``, or ``-o``.
    """
    parameters, collect = _expanded(function)
    json = inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Json)
    parameters.append(_option(json))

    @functools.wraps(function)
    def call(**values: Any) -> None:
        output.json_only(values.pop("json"))
        function(**collect(values))

    ordered = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in parameters]
    call.__signature__ = inspect.Signature(ordered)  # type: ignore[attr-defined]
    return call


def _expanded(function: Callable[..., Any]) -> tuple[list[inspect.Parameter], Callable[[Given], Given]]:
    """Return the options of a function, and a function that makes its arguments from their values."""
    parameters: list[inspect.Parameter] = []
    makers: dict[str, Callable[[Given], Any]] = {}
    part: Any
    for each in inspect.signature(function, eval_str=True).parameters.values():
        kind, *names = getattr(each.annotation, "__metadata__", (None,))
        if is_dataclass(each.annotation):
            part = each.annotation
            own, collect = _expanded(part)
            makers[each.name] = functools.partial(_instance, part, collect)
        elif isinstance(kind, type) and is_dataclass(kind):
            options = list(_options(each.name, kind, names))
            own = [parameter for parameter, _ in options]
            makers[each.name] = functools.partial(_given, {each.name: fields for each, fields in options})
        else:
            own = [_option(each) if isinstance(kind, str) else each]
            makers[each.name] = operator.itemgetter(each.name)
        parameters += own
    return parameters, lambda values: {name: make(values) for name, make in makers.items()}


def _option(given: inspect.Parameter) -> inspect.Parameter:
    """Return an argument annotated with the help of its option, and perhaps a unit, as the parser takes it."""
    text, unit, default = (*given.annotation.__metadata__, "", "")[:3]
    kind, words = given.annotation.__origin__, []
    if given.name == "out":
        words = ["--output", "-o"]
    elif kind is bool:
        words = [f"--{given.name.replace('_', '-')}"]

    def check(option: typer.CallbackParam, value: float | None) -> float | None:
        return None if value is None else checks.positive(option.opts[0], value, unit)

    shown = f" [default: {default}]" if default else ""
    info = typer.Option(*words, callback=check if unit else None, help=f"{text}, {unit}.{shown}" if unit else text)
    return given.replace(annotation=Annotated[kind, info])


def _instance(kind: Callable[..., Any], collect: Callable[[Given], Given], values: Given) -> Any:
    return kind(**collect(values))


def _given(fields: dict[str, tuple[str, ...]], values: Given) -> Given:
    """Return the fields of a dataclass whose options, by name, were given."""
    given: Given = {}
    for option, names in fields.items():
        value = values[option]
        if len(names) > 1 and value is not None:
            given |= zip(names, value, strict=True)
        elif value is not None:
            given[names[0]] = None if value == "none" else value
    return given


def _options(argument: str, kind: type, names: Sequence[str]) -> Iterator[tuple[inspect.Parameter, tuple[str, ...]]]:
    """Yield a parameter for each option of a dataclass, with the fields that it sets."""
    hints = get_type_hints(kind)
    for each in options_of(kind):
        if (names and each.name not in names) or each.name == "y":
            continue
        place, hint = each.name == "x", hints[each.name]
        if any(get_origin(part) is Literal for part in (hint, *get_args(hint))):
            hint = str
        option = argument if place else each.name
        value: Any = hint if hint is bool else (tuple[float, float] if place else hint) | None
        help_of: Any = Annotated[value, _help(each, place)]
        made = inspect.Parameter(option, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=help_of)
        yield _option(made), ("x", "y") if place else (each.name,)


def _help(each: Field[Any], place: bool) -> str:
    """Return the help of an option: its text, unit and default."""
    rule, default = each.metadata, each.default
    unit = f", {rule['unit']}" if rule["unit"] else ""
    phrase = rule["help"].rstrip(".")
    text = f"{phrase[0].upper()}{phrase[1:]}{': x to the right and y up' if place else ''}{unit}."
    values = default if isinstance(default, tuple) else (default,)
    shown = rule["shown"] or " ".join(f"{each:.4g}" if isinstance(each, float) else str(each) for each in values)
    hidden = default is MISSING or isinstance(default, bool) or (default is None and not rule["shown"])
    return text if hidden else f"{text} [default: {shown}]"


def check_destination(out: Path | None, suffix: str, inputs: Sequence[Path | None]) -> None:
    """Refuse, before any work, an output of another kind than `suffix`, among the inputs, or that cannot be written."""
    if out is None:
        return
    check_no_input(out, inputs)
    if out.suffix.lower() != suffix:
        raise InvalidInput("the output has the wrong suffix", got=str(out), allowed=f"a name ending in {suffix}")
    files.check_writable(out)


def check_no_input(out: Path, inputs: Sequence[Path | None]) -> None:
    """Refuse an output that is among the inputs; an input may be None."""
    for path in inputs:
        if path is not None and out.exists() and path.exists() and out.samefile(path):
            raise InvalidInput(
                "the output is one of the inputs and would overwrite it",
                got=str(out),
                allowed=f"a file other than {path}",
                fix="Give another name with -o",
            )


def arcs_of(given: Sequence[str] | None) -> Array | None:
    """Return the distances (K,), m, that ``--arc-lengths`` was given; None without."""
    return checks.array("--arc-lengths", numbers("--arc-lengths", given, "0.2,0.4,0.6"), (-1,)) if given else None


def words(given: Sequence[str] | None) -> list[str]:
    """Return the words that an option was given, with commas or several times."""
    return [word.strip() for text in given or () for word in text.split(",") if word.strip()]


def numbers(option: str, given: Sequence[str], example: str) -> list[float]:
    """Return the numbers that an option was given, in one or several words."""
    try:
        return [float(word) for word in words(given)]
    except ValueError:
        raise InvalidInput(
            f"{option} is not made of numbers", got=",".join(given), allowed=f"numbers such as {example}"
        ) from None
