"""The command-line application: all commands, and the exit codes of errors."""

import inspect
import os
import re
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Any

import typer

from hyperflex import __version__
from hyperflex.cli import output
from hyperflex.cli.calibrate import calibrate
from hyperflex.cli.export import export
from hyperflex.cli.identify import identify
from hyperflex.cli.look import plot, view
from hyperflex.cli.plan.cast import cast
from hyperflex.cli.plan.insert import insert
from hyperflex.cli.plan.reach import reach_map
from hyperflex.cli.plan.whip import whip
from hyperflex.cli.play import play
from hyperflex.cli.reproduce import reproduce
from hyperflex.cli.simulate import simulate
from hyperflex.cli.start.demo import demo
from hyperflex.cli.start.doctor import doctor
from hyperflex.cli.start.init import init
from hyperflex.cli.start.warm import warm
from hyperflex.cli.track import track
from hyperflex.cli.watch import watch
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.interruption import handle_signals

# the common base of what the parser raises: BadParameter <- UsageError <- ClickException
_PARSER_ERROR: Any = typer.BadParameter.__mro__[2]

_NO_NUMBER = re.compile(r"Invalid value for '(?:-\w / )?(--[\w-]+)'.* valid (number|integer)")
_OUT_OF_RANGE = re.compile(r"Invalid value for '(?:-\w / )?(--[\w-]+)': .* (greater|less) than or equal to ([\d.]+)")
COMPLETE = "_HYPERFLEX_COMPLETE"  # set by a shell that asks what may follow

app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)
for _command, _example in (
    (init, "init cast.toml --length 1.5 --mass 0.08 --peg 0.8 -0.6 0.03"),
    (simulate, "simulate cast.toml -o cast.nc"),
    (view, "view cast.nc"),
    (plot, "plot cast.nc -o cast.png"),
    (export, "export cast.toml -o cast.xml"),
    (play, "play cast.toml --folder casts"),
    (identify, "identify swing.csv --guess guess.toml --free inertia,friction -o identified"),
    (cast, "cast --rope rope.toml --target -0.8 -1.0 --radius 0.04 -o planned"),
    (whip, "whip --rope rope.toml --target 0.3 -2.05 --direction 0.2 -o whipped"),
    (insert, "insert --rope rope.toml --slot 0.56 -1.9 --direction -0.78 --width 0.02 -o inserted"),
    (reach_map, "reach-map --rope rope.toml --radius 0.04 --workers 2 -o reach"),
    (calibrate, "calibrate board.mp4 --squares 8 6 --square 0.03 --marker 0.022 --plane plane.png -o camera.toml"),
    (track, "track swing.mp4 --rope rope.toml --camera camera.toml --arc-lengths 0.2,0.4,0.6 -o markers.nc"),
    (watch, "watch --camera 0 --rope rope.toml --calibration camera.toml --arc-lengths 0.2,0.4,0.6 --page 8080"),
    (reproduce, "reproduce fig10 fig12 -o paper"),
    (demo, "demo -o demo-output"),
    (warm, "warm"),
    (doctor, "doctor --camera 0"),
):
    app.command(epilog=f"\b\nExample:\n  hyperflex {_example}")(_command)
_COMMANDS = {each.callback.__name__.replace("_", "-") for each in app.registered_commands if each.callback is not None}


def _show_version(asked: bool) -> None:
    if asked:
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

    Exit codes: 0 done, 1 a bug in hyperflex, 2 refused or failed with a message, 3 the fit did not converge, 4 no
    cast that winds and holds, whip that meets its target, or way through a slot was found, 5 the fit is not to be
    used, 130 ended by Ctrl-C, 143 by SIGTERM.
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
        Exit code, as the command's help has it; 1 also where the reader of a pipe went away.
    """
    as_json = "--json" in arguments
    if COMPLETE in os.environ:
        typer.main.get_command(app).main([], prog_name="hyperflex")  # answers, and ends the program
    try:
        _check_empty(arguments)
        return _invoke(arguments)
    except KeyboardInterrupt:
        return output.interrupted("Interrupted; nothing was left half written.", {}, as_json=as_json)
    except HyperflexError as error:
        message = output.with_options(str(error), _options(arguments))
        return output.complain(message, type(error).__name__, output.REFUSED, as_json=as_json)
    except _PARSER_ERROR as error:
        return output.complain(_misused(error, arguments), "UsageError", output.REFUSED, as_json=as_json)
    except MemoryError as error:
        what = f"The memory is full ({error})" if str(error) else "The memory is full"
        message = f"{what}. Make it smaller: a shorter duration, fewer links, samples or outputs."
        return output.complain(message, "MemoryError", output.REFUSED, as_json=as_json)
    except OverflowError as error:
        message = f"A number is out of range ({error.args[-1]}). Look for values far from any rope's."
        return output.complain(message, "OverflowError", output.REFUSED, as_json=as_json)
    except RecursionError:
        message = "Something that was given is nested too deep. Look at the files that were named."
        return output.complain(message, "RecursionError", output.REFUSED, as_json=as_json)
    except BrokenPipeError:  # whoever read standard output went away: nothing is left to be said to them
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return output.FAILED
    except Exception as error:  # noqa: BLE001 last resort: even a bug must not break the promise of --json
        traceback.print_exc()
        message = f"{str(error) or 'no message'}. This is a bug in hyperflex; please report it with the lines above."
        return output.complain(message, type(error).__name__, output.FAILED, as_json=as_json)


def _check_empty(arguments: Sequence[str]) -> None:
    """Refuse words that hold nothing: as a name of a file they would stand for the folder of now."""
    for before, word in pairwise(["", *arguments]):
        if not word.strip() or (word.startswith("--") and word.endswith("=")):
            option = before if word.strip() == "" and before.startswith("-") else word.rstrip("=")
            what = f"{option} is given nothing" if option.strip() else "an argument is empty"
            raise InvalidInput(what, got=word, allowed="a value", fix="Give one, or leave the option out")


def _options(arguments: Sequence[str]) -> dict[str, str]:
    """Return the options of the command that is run, by the names of its arguments; files are named by themselves."""
    commands: Any = typer.main.get_command(app)
    command = commands.commands.get(next(iter(arguments), ""))
    if command is None:
        return {}
    kinds = inspect.signature(command.callback).parameters
    return {
        each.name: max(each.opts, key=len)
        for each in command.params
        if each.opts[0].startswith("-") and "Path" not in str(kinds[each.name].annotation)
    }


def _misused(error: Any, arguments: Sequence[str]) -> str:
    """Return what the parser complains of in whole sentences, and where to look."""
    worded = getattr(error, "format_message", None)
    message = str(worded() if worded else error).rstrip(".")
    if found := _NO_NUMBER.search(message):
        kind = "a whole number" if found[2] == "integer" else "numbers"
        message = f"{found[1]} takes {kind}: got {_given(found[1], arguments)}"
    elif found := _OUT_OF_RANGE.search(message):
        side = "at least" if found[2] == "greater" else "at most"
        message = f"{found[1]} is out of range: got {_given(found[1], arguments)}. Allowed: {side} {found[3]}"
    forms = {"--target": " Give two numbers: --target X Y.", "--peg": " Give three numbers: --peg X Y RADIUS."}
    form = next((words for option, words in forms.items() if option in message), "")
    named = arguments[0] if arguments and arguments[0] in _COMMANDS else ""
    stop = "" if message.endswith("?") else "."
    return f"{message}{stop}{form} See {f'hyperflex {named}'.strip()} --help."


def _given(option: str, arguments: Sequence[str]) -> str:
    """Return the words that were given to an option, as they stand on the command line."""
    joined = [word.partition("=")[2] for word in arguments if word.startswith(f"{option}=")]
    after = [word for before, word in pairwise(arguments) if before == option]
    return ", ".join(map(repr, joined + after)) or "something else"


def _invoke(arguments: Sequence[str]) -> int:
    """Run one command without the parser's own handling of errors, which swallows Ctrl-C; return its exit code."""
    try:
        with handle_signals(signal.SIGTERM), warnings.catch_warnings():
            command = typer.main.get_command(app)
            with command.make_context("hyperflex", list(arguments)) as context:
                warnings.showwarning = output.warner()
                command.invoke(context)
    except typer.Exit as stop:
        return int(stop.exit_code)
    return 0
