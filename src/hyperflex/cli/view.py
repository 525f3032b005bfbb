"""``hyperflex view``: a saved run in, a page of it in the browser."""

import tempfile
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from hyperflex.cli import output
from hyperflex.cli.plot import End, Run, Start, Title


def view(
    run: Run,
    out: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write, .html. [default: one in a temporary folder]"),
    ] = None,
    start: Start = None,
    end: End = None,
    title: Title = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Write the page, but open no browser.")] = False,
    json: output.Json = False,
) -> None:
    """Play a saved run in the browser: scrub it, slow it down, read arm, speed and energy off.

    The page is a single file that needs no network: it can be kept, sent, and opened anywhere.
    """
    from hyperflex.trajectory import read_trajectory

    output.check_destination(out, ".html", [run])
    shown = read_trajectory(run)
    page = Path(tempfile.mkdtemp(prefix="hyperflex-")) / f"{run.stem}.html" if out is None else out
    shown.to_html(page, start=start, end=end, title=f"{run.name}, simulated" if title is None else title)
    opened = not no_open and webbrowser.open(page.resolve().as_uri())
    result = {"output": page, "bytes": page.stat().st_size, "opened": opened, "run": run}
    words = [("written", f"{page} ({page.stat().st_size / 1e3:.0f} kB)")]
    if not (opened or no_open):
        words.append(("no browser was found", "open the file with any browser"))
    output.show(result, repr(shown), words, as_json=json)
