"""``hyperflex identify``: a recording and a first guess in, an identified rope out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hyperflex.cli import output


def identify(
    recording: Annotated[Path, typer.Argument(help="CSV, NetCDF or .mat file of angles or markers.")],
    rope: Annotated[Path, typer.Option("--rope", help="TOML file with the first guess.")],
    out: Annotated[Path, typer.Option("--output", "-o", help="File to write the identified rope to, .toml.")],
    free: Annotated[
        list[str] | None, typer.Option(help="What to identify; give it several times. [default: inertia, friction]")
    ] = None,
    train: Annotated[float | None, typer.Option(help="Fit the samples before this time, s; predict the rest.")] = None,
    window: Annotated[float | None, typer.Option(help="Length of the windows that are fitted one by one, s.")] = None,
    kind: Annotated[str | None, typer.Option(help="angles or markers.")] = None,
    time: Annotated[str, typer.Option(help="Name of the time column.")] = "t",
    time_unit: Annotated[str | None, typer.Option(help="s, ms, us, min or frame.")] = None,
    unit: Annotated[str | None, typer.Option(help="rad, mrad, deg, turn; m, cm, mm, px.")] = None,
    frame_rate: Annotated[float | None, typer.Option(help="Frames a second, for --time-unit frame.")] = None,
    y_axis: Annotated[str | None, typer.Option(help="Where the markers' y points: up or down.")] = None,
    scale: Annotated[float | None, typer.Option(help="Length of a pixel, m.")] = None,
    zero: Annotated[str | None, typer.Option(help="Where angles are 0: hanging or up.")] = None,
    sense: Annotated[str | None, typer.Option(help="Side to which angles grow: +x or -x.")] = None,
    angles: Annotated[str | None, typer.Option(help="absolute, or relative to the link before.")] = None,
    wrapped: Annotated[bool | None, typer.Option(help="Whether angles jump by whole turns.")] = None,
    noise: Annotated[float | None, typer.Option(help="Standard deviation of a sample, in its unit.")] = None,
    columns: Annotated[str | None, typer.Option(help="Data columns in order, with commas between them.")] = None,
    json: output.Json = False,
) -> None:
    """Identify a rope from a recording.

    Units, axes and frame rate are declared by the file or by the options, never guessed.

    The exit code is 3 if the fit did not converge; the rope is written all the same, marked as not converged.
    """
    from hyperflex.identification import identify as run
    from hyperflex.model import Rope
    from hyperflex.recording import read_recording

    output.check_destination(out, ".toml", [recording, rope])
    measured = read_recording(
        recording,
        kind=kind,
        time=time,
        time_unit=time_unit,
        unit=unit,
        frame_rate=frame_rate,
        y_axis=y_axis,
        scale=scale,
        zero=zero,
        sense=sense,
        angles=angles,
        wrapped=wrapped,
        noise=noise,
        columns=columns.split(",") if columns else None,
    )
    result = run(
        measured,
        Rope.from_toml(rope),
        free or ["inertia", "friction"],
        window=window,
        train=train,
        progress=output.watched(json),
    )
    result.to_toml(out)
    summary = {"status": result.status, "output": out, **result.summary()}
    if result.status == "interrupted":  # the best so far is written, and says what it is
        words = f"Interrupted; the best so far is in {out}, marked as interrupted."
        raise typer.Exit(output.interrupted(words, summary, as_json=json))
    if json:
        output.print_json(summary)
    else:
        output.print_pairs("Fit", [("status", result.status)])
        output.console().print(str(result), markup=False)
        output.print_pairs("Written", [("rope and figures", str(out))])
    if result.status != "converged":
        raise typer.Exit(output.NOT_CONVERGED)
