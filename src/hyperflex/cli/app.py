"""The command-line application: all commands, and the exit codes of errors."""

import ast
import errno
import importlib
import inspect
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from hyperflex import __version__
from hyperflex.cli import output
from hyperflex.cli.command import command
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.interruption import handle_signals

# the common base of what the parser raises: BadParameter <- UsageError <- ClickException
_PARSER_ERROR: Any = typer.BadParameter.__mro__[2]
COMPLETE = "_HYPERFLEX_COMPLETE"  # set by a shell that completes a command

COMMANDS = {  # by name: the module with the function of this name, and an example
    "init": ("init", "cast.toml --length 1.5 --mass 0.08 --peg 0.8 -0.6 0.03"),
    "simulate": ("simulate", "cast.toml -o cast.nc"),
    "view": ("view", "cast.nc"),
    "plot": ("view", "cast.nc -o cast.png"),
    "export": ("export", "cast.toml -o cast.xml"),
    "play": ("view", "cast.toml --folder casts"),
    "look": ("look", "swing.csv -o swing.png"),
    "identify": ("identify", "swing.csv --rope guess.toml --free inertia,friction -o identified"),
    "cast": ("plan", "--rope rope.toml --target -0.8 -1.0 --radius 0.04 -o planned"),
    "whip": ("plan", "--rope rope.toml --target 0.3 -2.05 --direction 0.2 -o whipped"),
    "insert": ("plan", "--rope rope.toml --slot 0.56 -1.9 --direction -0.78 --width 0.02 -o inserted"),
    "vibrate": ("vibrate", "--rope rope.toml --tilt 1.9 --arm-length 0.1 -o map.png"),
    "reach-map": ("plan", "--rope rope.toml --radius 0.04 --workers 2 -o reach"),
    "run": ("run", "planned/cast.toml --motor emulator:moteus -o done"),
    "calibrate": ("calibrate", "board.mp4 --squares 8 6 --square 0.03 --marker 0.022 --plane plane.png -o camera.toml"),
    "track": ("track", "swing.mp4 --rope rope.toml --camera camera.toml --arc-lengths 0.2,0.4,0.6 -o markers.nc"),
    "watch": ("track", "0 --rope rope.toml --camera camera.toml --arc-lengths 0.2,0.4,0.6 --page 8080"),
    "reproduce": ("reproduce", "fig10 fig12 -o paper"),
    "demo": ("demo", "-o demo-output"),
    "motor check": ("motor", "--motor XC330-M181 --rope rope.toml planned/cast.toml"),
    "motor identify": ("motor", "--motor emulator:moteus -o drive.toml"),
    "motor zero": ("motor", "--motor moteus:/dev/ttyACM0 -o zero.toml"),
    "warm": ("warm", ""),
    "doctor": ("doctor", "--source 0"),
}


class _Commands(TyperGroup):
    """The commands; each is loaded when it is used, since the planners' options load the simulator."""

    def list_commands(self, context: Any) -> list[str]:
        """Return the names of all commands."""
        return list(COMMANDS)

    def get_command(self, context: Any, name: str) -> Any:
        """Return a command; None if there is none of this name."""
        single = typer.Typer(rich_markup_mode=None, add_completion=False)
        if members := [each for each in COMMANDS if each.startswith(f"{name} ")]:
            lines = "\n".join(f"  {each:16}{_summary(each)}" for each in members)
            single.command(name, epilog=f"\b\nCommands:\n{lines}")(_show_help)
            return typer.main.get_command(single)
        if name not in COMMANDS:
            return None
        module, example = COMMANDS[name]
        function = getattr(importlib.import_module(f"hyperflex.cli.{module}"), _function(name))
        single.command(name, epilog=f"\b\nExample:\n  hyperflex {name} {example}")(command(function))
        return typer.main.get_command(single)

    def resolve_command(self, context: Any, args: list[str]) -> Any:
        """Find the command of one word or two."""
        return super().resolve_command(context, _joined(args))

    def format_commands(self, context: Any, formatter: Any) -> None:
        """List the commands with the first line of their help, which is read without loading them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, _summary(name)) for name in COMMANDS])


def _show_help(context: typer.Context) -> None:
    """List the commands of two words that begin with this one."""
    typer.echo(context.get_help())


def _joined(arguments: Sequence[str]) -> list[str]:
    """Return arguments with the name of a command of two words as one."""
    name = " ".join(arguments[:2])
    return [name, *arguments[2:]] if name in COMMANDS else list(arguments)


def _function(name: str) -> str:
    """Return the name of a command's function: its last word."""
    return name.rpartition(" ")[2].replace("-", "_")


def _summary(name: str) -> str:
    tree = ast.parse(Path(__file__).with_name(f"{COMMANDS[name][0]}.py").read_text("utf-8"))
    functions = (each for each in tree.body if isinstance(each, ast.FunctionDef))
    function = next(each for each in functions if each.name == _function(name))
    return (ast.get_docstring(function) or "").partition("\n")[0]


app = typer.Typer(cls=_Commands, rich_markup_mode=None, pretty_exceptions_enable=False)


def _show_version(requested: bool) -> None:
    if requested:
        typer.echo(__version__)
        raise typer.Exit


@app.callback(invoke_without_command=True, epilog="\b\nExample:\n  hyperflex demo")
def hyperflex(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Robots that use a rope as an arm: simulate it, identify it, cast it.

    Exit codes: 0 success; 1 a bug in hyperflex; 2 an error, with a message; 3 the fit did not converge, or the time ran
    out; 4 no plan succeeded; 5 the fit must not be used; 130 interrupted by Ctrl-C; 143 by SIGTERM.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def run(arguments: Sequence[str]) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str
        What follows the program's name.

    Returns
    -------
    int
        Exit code, as the help of ``hyperflex`` lists them; 1 also if the reader of a pipe has gone.
    """
    output.json_only("--json" in arguments)
    group: Any = typer.main.get_command(app)
    if COMPLETE in os.environ:
        group.main([], prog_name="hyperflex")  # answers, and ends the program
    named: Any = None
    try:
        named = group.get_command(None, next(iter(_joined(arguments)), ""))
        _check_empty(arguments)
        return _invoke(group, arguments)
    except KeyboardInterrupt:
        return output.interrupt({}, "Interrupted; no file was left incomplete.")
    except _PARSER_ERROR as error:
        text = error.format_message() if hasattr(error, "format_message") else str(error)
        text += _given(error, arguments)
        stop = "" if text.endswith(("?", ".")) else "."
        path = f"hyperflex {named.name}" if named else "hyperflex"
        return output.complain(f"{text}{stop} See {path} --help.", "UsageError", output.ExitCode.REFUSED)
    except BrokenPipeError:  # the reader of standard output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:  # noqa: BLE001 last resort: even a bug must not break the promise of --json
        cause = MemoryError(str(error)) if _short_of_resources(error) else error
        if isinstance(cause, (HyperflexError, MemoryError, OverflowError, RecursionError)):
            return output.complain(_refusal(cause, named), type(error).__name__, output.ExitCode.REFUSED)
        traceback.print_exc()
        message = f"{str(error) or 'no message'}. This is a bug in hyperflex; please report it with the lines above."
        return output.complain(message, type(error).__name__, output.ExitCode.FAILED)
    return output.ExitCode.FAILED


def _given(error: Any, arguments: Sequence[str]) -> str:
    """Return what was given for an option whose value the parser refuses; empty if that is not known."""
    option = getattr(error, "param", None)
    name = next((one for one in getattr(option, "opts", ()) if one in arguments), None)
    if option is None or name is None or "Invalid value" not in error.format_message():
        return ""
    at = len(arguments) - list(reversed(arguments)).index(name)  # the last one counts
    values = " ".join(arguments[at : at + option.nargs])
    return f": got {values!r}" + (". Separate numbers by spaces" if "," in values else "")


def _short_of_resources(error: Exception) -> bool:
    """Return whether the system had no memory, process or thread left, as libraries report it."""
    return getattr(error, "errno", None) in (errno.EAGAIN, errno.ENOMEM) or "start new thread" in str(error)


def _refusal(error: Exception, named: Any) -> str:
    """Return the message of an error that is no bug; `named` is the command, or None."""
    detail = f" ({error})" if str(error) else ""
    if isinstance(error, MemoryError):
        fix = "Use a shorter duration, fewer links, samples or outputs, or end other programs"
        return f"The memory is full, or what else the system lends{detail}. {fix}."
    if isinstance(error, OverflowError):
        return f"A number is out of range{detail}. Check for values far from any rope's."
    if isinstance(error, RecursionError):
        return "A file is nested too deep. Check the files that were given."
    return output.with_options(str(error), {} if named is None else _options(named))


def _check_empty(arguments: Sequence[str]) -> None:
    """Refuse empty words: as the name of a file they would stand for the working directory."""
    for before, word in pairwise(["the command", *arguments]):
        if not word.strip() or (word.startswith("--") and word.endswith("=")):
            option = word.rstrip("=") if word.strip() else before
            raise InvalidInput(f"{option} has no value", got=word, fix="Give one, or omit the option")


def _options(named: Any) -> dict[str, str]:
    """Return the options of a command by the names of its arguments; files are named by themselves."""
    kinds = inspect.signature(named.callback).parameters
    return {
        each.name: max(each.opts, key=len)
        for each in named.params
        if each.opts[0].startswith("-") and "Path" not in str(kinds[each.name].annotation)
    }


def _invoke(group: Any, arguments: Sequence[str]) -> int:
    """Run one command without the parser's own error handling, which suppresses Ctrl-C; return its exit code."""
    try:
        with (
            handle_signals(signal.SIGTERM),
            warnings.catch_warnings(),
            group.make_context("hyperflex", list(arguments)) as context,
        ):
            warnings.showwarning = output.warner()
            group.invoke(context)
    except typer.Exit as stop:
        return int(stop.exit_code)
    return 0
