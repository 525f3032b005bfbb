"""``hyperflex plot``: a saved run in, a picture, a film, a page or a table of it out."""

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
Title = Annotated[str | None, typer.Option(help="Written above. [default: the file's name]")]


def plot(
    run: Run,
    out: Annotated[Path, typer.Option("--output", "-o", help="File to write: .png, .gif, .mp4, .html or .csv.")],
    kind: Annotated[
        str, typer.Option(help="Of a .png: strobe (many instants in one) or course (over time).")
    ] = "strobe",
    start: Start = None,
    end: End = None,
    speed: Annotated[float, typer.Option(help="Of a film: simulated seconds a second.")] = 1.0,
    width: Annotated[int, typer.Option(help="Of a film, pixels.")] = 640,
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
    output.check_destination(out, suffix, [run])
    shown = read_trajectory(run)
    named = run.name if kind == "course" else f"{run.name}, simulated"  # a course says so itself
    options: dict[str, Any] = {"start": start, "end": end, "title": named if title is None else title}
    if suffix == ".png":
        save_png(shown.plot(kind, **options), out)  # type: ignore[arg-type]
    elif suffix == ".html":
        shown.to_html(out, speed=speed, **options)
    elif suffix == ".csv":
        shown.to_csv(out)
    else:
        with output.spinner(json) as progress:
            done = lambda frame, frames: progress(f"frame {frame} of {frames}")  # noqa: E731
            shown.animate(out, speed=speed, width=width, progress=done, **options)
    result = {"output": out, "bytes": out.stat().st_size, "run": run, "start_s": shown.t[0], "end_s": shown.t[-1]}
    output.show(result, repr(shown), [("written", f"{out} ({out.stat().st_size / 1e3:.0f} kB)")], as_json=json)
