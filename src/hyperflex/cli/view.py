"""``hyperflex view``, ``plot`` and ``play``: a saved run in the browser or drawn, and a live page."""

import contextlib
import tempfile
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex import report
from hyperflex.cli import output
from hyperflex.cli.command import check_destination
from hyperflex.errors import InvalidInput
from hyperflex.interruption import stoppable

_FILM = "start end title speed width"
_OPTIONS = {  # that apply, by what is written
    ".png": "start end title kind",
    ".gif": _FILM,
    ".mp4": _FILM,
    ".html": "start end title speed",
    ".csv": "",
}
Run = Annotated[
    Path, typer.Argument(help="NetCDF file of a run, such as simulate, cast and whip write.", metavar="RUN.nc")
]
Start = Annotated[float | None, "First time to show, s. [default: the run's]"]
End = Annotated[float | None, "Last time to show, s. [default: the run's]"]
Title = Annotated[str | None, "Title of the drawing. [default: the file's name]"]
NoOpen = Annotated[bool, "Open no browser."]


def plot(
    run: Run,
    out: Annotated[Path, "File to write: .png, .gif, .mp4, .html or .csv."],
    kind: Annotated[
        str | None,
        "What a .png shows: strobe (many instants) or course (curves over time). [default: strobe]",
    ] = None,
    start: Start = None,
    end: End = None,
    speed: Annotated[float | None, "Simulated seconds in a second of a film or page. [default: 1.0]"] = None,
    width: Annotated[int | None, "Width of a film, pixels. [default: 640]"] = None,
    title: Title = None,
) -> None:
    """Draw a saved run as a picture, film, page or table.

    A picture is a .png, a film a .gif or .mp4, a page that plays the run an .html. The table, a .csv, holds all samples
    in SI units: arm, link angles and rates, joints, energies and torque.
    """
    suffix = out.suffix.lower()
    if suffix not in _OPTIONS:
        raise InvalidInput(
            "the output has the wrong suffix", got=str(out), allowed=", ".join(_OPTIONS), fix="Change -o"
        )
    every = {"start": start, "end": end, "title": title, "kind": kind, "speed": speed, "width": width}
    options: dict[str, Any] = {name: value for name, value in every.items() if value is not None}
    if idle := [f"--{name}" for name in options if name not in _OPTIONS[suffix].split()]:
        raise InvalidInput(f"a {suffix} does not show the options", got=" ".join(idle), fix="Omit them")
    check_destination(out, suffix, [run])
    shown = _read(run, "plot")
    # the drawing of a course contains "simulated"
    options["title"] = _title(run, shown, title, "" if kind == "course" else ", simulated")
    if suffix == ".png":
        report.save_png(shown.plot(**options), out)
    elif suffix == ".html":
        shown.to_html(out, **options)
    elif suffix == ".csv":
        shown.to_csv(out)
    else:
        with output.spinner() as progress:
            options["progress"] = lambda done, frames: progress(f"frame {done} of {frames}")
            shown.animate(out, **options)
    result = {"output": out, "bytes": out.stat().st_size, "run": run, "start_s": shown.t[0], "end_s": shown.t[-1]}
    result["run_status"] = shown.status
    output.show(result, output.rows(repr(shown), result))


def view(
    run: Run,
    out: Annotated[Path | None, "File to write, .html. [default: in a temporary folder]"] = None,
    start: Start = None,
    end: End = None,
    title: Title = None,
    no_open: NoOpen = False,
) -> None:
    """Play a saved run in the browser.

    Scrub it, slow it down, and read arm, speed and energy. The page is a single file that needs no network: it can be
    kept, sent, and opened anywhere.
    """
    check_destination(out, ".html", [run])
    shown = _read(run, "view")
    page = Path(tempfile.mkdtemp(prefix="hyperflex-")) / f"{run.stem}.html" if out is None else out
    shown.to_html(page, start=start, end=end, title=_title(run, shown, title, ", simulated"))
    opened = not no_open and webbrowser.open(page.resolve().as_uri())
    result = {"output": page, "bytes": page.stat().st_size, "opened": opened, "run": run, "run_status": shown.status}
    found = [] if opened or no_open else [("no browser was found", "open the file with any browser")]
    output.show(result, output.rows(repr(shown), result, *found))


def _title(run: Path, shown: Any, given: str | None, what: str) -> str:
    """Return the title of what shows a run; of one that did not come to its end with how it ended."""
    return (given or f"{run.name}{what}") + ("" if shown.success else f" ({shown.status})")


def _read(run: Path, command: str) -> Any:
    """Return a saved run; refuse a set-up or a recording, with the command that makes a run of it."""
    from hyperflex.trajectory import read_trajectory

    makes = {
        ".toml": f"hyperflex simulate {run} -o {run.stem}.nc makes one of a set-up; then {command} {run.stem}.nc",
        ".csv": f"A recording is drawn by hyperflex look {run} -o {run.stem}.png",
    }
    if fix := makes.get(run.suffix.lower()):
        raise InvalidInput(
            f"{command} shows runs, and this is none",
            got=str(run),
            allowed="a NetCDF file of a run, as simulate, cast and whip write",
            fix=fix,
        )
    return read_trajectory(run)


def play(
    setup: Annotated[
        Path | None, typer.Argument(help="TOML file of a set-up or a plan to begin with. [default: the paper's cable]")
    ] = None,
    folder: Annotated[
        Path, typer.Option("--folder", "-f", help="Folder that the page may read and write; no other.")
    ] = Path(),
    port: Annotated[int, "Port of the page; 0: any free one."] = 0,
    host: Annotated[str, "Address to listen at; by default this machine alone."] = "127.0.0.1",
    allow: Annotated[
        list[str] | None, "A further host:port that browsers may use, several times; others get 403."
    ] = None,
    no_open: NoOpen = False,
) -> None:
    """Swing, cast and watch a rope live in the browser.

    Drag the target, change rope and arm, plan, and scrub the recorded motion. Ctrl-C ends it. Planning runs in a
    separate process. The page requests nothing from any other host, and serves this machine alone unless --host and
    --allow say otherwise: whoever can open it can save files in the folder.
    """
    from hyperflex.play import Folder, PlayServer, read_opened

    if setup is not None and setup.suffix.lower() == ".nc":
        raise InvalidInput(
            "play begins with a set-up",
            got=str(setup),
            allowed="a TOML file",
            fix=f"View a run with hyperflex view {setup}; in the page, Open takes one from the folder",
        )
    opened = None if setup is None else read_opened(setup)
    with PlayServer(Folder(folder), port=port, host=host, allow=allow or ()) as server:
        if opened is not None:
            server.runner.open(opened)
        shown = server.runner.session.scene()["rope"]
        cable = f"the paper's cable ({shown}); hyperflex play SETUP.toml shows another"
        output.note(f"at {server.address}; Ctrl-C ends it. It shows {setup or cable}")
        if output.as_json():
            output.print_json({"address": server.address, "port": server.port, "folder": folder}, one_line=True)
        if not no_open:
            with contextlib.suppress(webbrowser.Error):
                webbrowser.open(server.address)
        with stoppable():  # Ctrl-C is the way to end it
            server.wait()
