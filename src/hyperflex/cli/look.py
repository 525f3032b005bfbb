"""``hyperflex view`` and ``plot``: a saved run in the browser, and as a picture, a film, a page or a table."""

import tempfile
import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex.cli import output
from hyperflex.errors import InvalidInput

SUFFIXES = (".png", ".gif", ".mp4", ".html", ".csv")
Run = Annotated[
    Path, typer.Argument(help="NetCDF file of a run, such as simulate, cast and whip write.", metavar="RUN.nc")
]
Start = Annotated[float | None, typer.Option(help="First time to show, s. [default: the run's]")]
End = Annotated[float | None, typer.Option(help="Last time to show, s. [default: the run's]")]
Title = Annotated[str | None, typer.Option(help="Title of what is drawn. [default: the file's name]")]


def plot(
    run: Run,
    out: Annotated[Path, typer.Option("--output", "-o", help="File to write: .png, .gif, .mp4, .html or .csv.")],
    kind: Annotated[
        str, typer.Option(help="What a .png shows: strobe (many instants in one) or course (curves over time).")
    ] = "strobe",
    start: Start = None,
    end: End = None,
    speed: Annotated[float, typer.Option(help="Simulated seconds in a second of a film.")] = 1.0,
    width: Annotated[int, typer.Option(help="Width of a film, pixels.")] = 640,
    title: Title = None,
    json: output.Json = False,
) -> None:
    """Draw a saved run: a picture (.png), a film (.gif, .mp4), a page that plays it (.html), or a table (.csv).

    The table holds all samples in SI units: arm, link angles and rates, joints, energies and torque.
    """
    from hyperflex.report import save_png
    from hyperflex.trajectory import read_trajectory

    suffix = out.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidInput(
            "the output has the wrong suffix", got=str(out), allowed=", ".join(SUFFIXES), fix="Change -o"
        )
    if suffix == ".csv" and not (start is None and end is None):
        raise InvalidInput("--start and --end do not go with a table", allowed="all samples", fix="Leave them out")
    output.check_destination(out, suffix, [run])
    shown = read_trajectory(_checked(run, "plot"))
    named = run.name if kind == "course" else f"{run.name}, simulated"  # a course says so itself
    options: dict[str, Any] = {"start": start, "end": end, "title": named if title is None else title}
    if suffix == ".png":
        save_png(shown.plot(kind, **options), out)  # type: ignore[arg-type]
    elif suffix == ".html":
        shown.to_html(out, speed=speed, **options)
    elif suffix == ".csv":
        shown.to_csv(out)
    else:
        with output.spinner() as progress:
            options["progress"] = lambda done, frames: progress(f"frame {done} of {frames}")
            shown.animate(out, speed=speed, width=width, **options)
    result = {"output": out, "bytes": out.stat().st_size, "run": run, "start_s": shown.t[0], "end_s": shown.t[-1]}
    output.show(result, repr(shown), [("written", f"{out} ({out.stat().st_size / 1e3:.0f} kB)")], as_json=json)


def _checked(run: Path, command: str) -> Path:
    """Return the path of a run; InvalidInput, with the command that makes a run of it, for a set-up or a recording."""
    makes = {
        ".toml": f"hyperflex simulate {run} -o {run.stem}.nc makes one of a set-up; then {command} {run.stem}.nc",
        ".csv": f"A recording is drawn beside its fit: hyperflex identify {run} --guess rope.toml -o {run.stem}",
    }
    if fix := makes.get(run.suffix.lower()):
        allowed = "a NetCDF file of a run, as simulate, cast and whip write"
        raise InvalidInput(f"{command} shows runs, and this is none", got=str(run), allowed=allowed, fix=fix)
    return run


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
    shown = read_trajectory(_checked(run, "view"))
    page = Path(tempfile.mkdtemp(prefix="hyperflex-")) / f"{run.stem}.html" if out is None else out
    shown.to_html(page, start=start, end=end, title=f"{run.name}, simulated" if title is None else title)
    opened = not no_open and webbrowser.open(page.resolve().as_uri())
    result = {"output": page, "bytes": page.stat().st_size, "opened": opened, "run": run}
    words = [("written", f"{page} ({page.stat().st_size / 1e3:.0f} kB)")]
    if not (opened or no_open):
        words.append(("no browser was found", "open the file with any browser"))
    output.show(result, repr(shown), words, as_json=json)
