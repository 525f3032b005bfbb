"""``hyperflex identify``: a recording and a first guess in, an identified rope and its report out."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex import files
from hyperflex.cli import output
from hyperflex.errors import InvalidInput

if TYPE_CHECKING:
    from hyperflex.identification import Identification
    from hyperflex.model import Rope
    from hyperflex.recording import Recording

_ROWS, _OF_EACH = 24, 5  # of a table in the terminal, and of one ratio


def identify(
    recording: Annotated[Path, typer.Argument(help="CSV, NetCDF, MCAP, .mat file or ROS 2 bag of angles or markers.")],
    guess: Annotated[Path, typer.Option(help="TOML file with the rope to begin with.")],
    out: Annotated[
        Path,
        typer.Option("--output", "-o", help="Folder for rope.toml, identification.json and report.html, or one .toml."),
    ],
    free: Annotated[
        list[str] | None,
        typer.Option(
            help="What to identify; several times or with commas. [default: chosen by what the recording tells]"
        ),
    ] = None,
    train: Annotated[
        float | None, typer.Option(help="Fit the samples before this time, s; predict the rest. inf fits all.")
    ] = None,
    window: Annotated[float | None, typer.Option(help="Length of the windows that are fitted one by one, s.")] = None,
    arc_lengths: Annotated[list[str] | None, output.ARC_LENGTHS] = None,
    origin: Annotated[
        str | None, typer.Option(help="Where the camera sees the origin of the motion, X,Y in m; else it is fitted.")
    ] = None,
    length_std: Annotated[
        float, typer.Option(help="Relative standard deviation of the lengths, which intervals hold; 0: exact.")
    ] = 0.01,
    clock_std: Annotated[
        float, typer.Option(help="Relative standard deviation of the times, which intervals hold; 0: exact.")
    ] = 0.005,
    loss: Annotated[str, typer.Option(help="squares; huber or cauchy where there are outliers.")] = "squares",
    setup: Annotated[
        Path | None, typer.Option(help="TOML file of a set-up (as for simulate) whose motion and arm drive the rope.")
    ] = None,
    kind: Annotated[str | None, typer.Option(help="angles or markers.")] = None,
    time: Annotated[str, typer.Option(help="Name of the time column; of messages t or log.")] = "t",
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
    columns: Annotated[str | None, typer.Option(help="Data columns, or joints, in order, with commas.")] = None,
    topic: Annotated[str | None, typer.Option(help="Topic of an MCAP file or a bag that holds several.")] = None,
    plane: Annotated[
        str | None, typer.Option(help="In which the rope swings, of poses in space: xz (x right, z up), xy or yz.")
    ] = None,
    max_rate: Annotated[
        float | None, typer.Option(help="Angles that turn faster, rad/s, are refused as wrong units. [default: 300]")
    ] = None,
    intervals: Annotated[
        str, typer.Option(help="How 95 % intervals are found: auto, covariance, profile or none.")
    ] = "auto",
    time_budget: Annotated[
        float | None,
        typer.Option(
            help="Processor time of the fit, s; then the best so far is written. inf: no end. [default: 1800]"
        ),
    ] = None,
    json: output.Json = False,
) -> None:
    """Identify a rope from a recording.

    Units, axes and frame rate are declared by the file or by the options, never guessed. Markers sit at the joints
    unless --arc-lengths says where.

    Ctrl-C ends the fit; the best so far is printed and written, marked as interrupted.

    The first line says what the result may be used for: usable, usable for ratios (masses, inertias and frictions
    share a factor that a free swing does not tell), or do not use, and why.

    The exit code is 3 if the fit did not converge, 5 if it did and is not to be used: what was declared or held does
    not fit, say. The rope is written all the same, with the grade.
    """
    from hyperflex.identification import FitOptions, RecordingSetup
    from hyperflex.identification import identify as run
    from hyperflex.model import Rope
    from hyperflex.recording import read_recording

    _check_output(out, [recording, guess, *([setup] if setup else [])])
    driven = _drive(setup)
    places = output.numbers("--arc-lengths", arc_lengths, "0.2,0.4,0.6") if arc_lengths else None
    seen = output.numbers("--origin", [origin], "0.01,-0.02") if origin else None
    arranged = RecordingSetup(**driven, arc_lengths=places, origin=seen)
    how = FitOptions(
        window=window,
        train=train,
        loss=loss,  # type: ignore[arg-type]  # refused there, if unknown
        length_std=length_std,
        clock_std=clock_std,
        intervals=None if intervals == "none" else intervals,  # type: ignore[arg-type]  # likewise
    )
    known: dict[str, Any] = {"topic": topic, "plane": plane} | ({} if max_rate is None else {"max_rate": max_rate})
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
        **known,
    )
    first = Rope.from_toml(guess)
    result = output.partial_of(
        lambda: run(
            measured,
            first,
            output.words(free) or None,
            setup=arranged,
            options=how,
            time_budget=time_budget,
            progress=True,
        )
    )
    summary = result.ending() | {"output": out, **result.summary()}
    summary["files"] = files = _write(out, measured, result, first, summary, json)
    if result.message == "interrupted":  # the best so far is written, and says what it is
        if not json:
            _show(result, files)
        words = f"Interrupted; the best so far is in {out}, marked as interrupted."
        raise typer.Exit(output.interrupted(words, summary, as_json=json))
    if json:
        output.print_json(summary)
    else:
        _show(result, files)
    if not result.success:
        raise typer.Exit(output.NOT_CONVERGED)
    if result.grade.name == "do not use":
        raise typer.Exit(output.NOT_USABLE)


def _folder(out: Path) -> bool:
    return out.suffix == "" or out.is_dir()


def _check_output(out: Path, inputs: Sequence[Path]) -> None:
    """Refuse, before any work, what cannot be written or would overwrite an input."""
    if not _folder(out):
        output.check_destination(out, ".toml", inputs)
        return
    from hyperflex.report import check_folder

    check_folder(out)
    for name in ("rope.toml", "identification.json", "report.html"):
        output.check_no_input(out / name, inputs)


def _drive(path: Path | None) -> dict[str, Any]:
    """Return the motion and the arm of a set-up."""
    from hyperflex.model import Setup
    from hyperflex.motion import hold_arm

    if path is None:
        return {}
    setup = Setup.from_toml(path)
    if setup.torque_driven:
        raise InvalidInput(
            f"{path} drives its arm by a torque",
            allowed="a motion",
            fix='Measure the arm\'s angle and give it as motion = {kind = "file", path = "arm.csv"}',
        )
    return {"motion": setup.motion or hold_arm(0.0), "arm": setup.arm}


def _write(
    out: Path, measured: "Recording", found: "Identification", guess: "Rope", summary: dict[str, Any], as_json: bool
) -> dict[str, Path]:
    """Write the folder, or the one file; return the files by what they are."""
    if not _folder(out):
        files.rescued(found.to_toml, out)
        return {"rope": out}
    from hyperflex.report import identification_page, write_found

    written = files.rescued(lambda folder: write_found(folder, found), out)
    with output.keeping(written, "the page", summary, as_json=as_json), output.spinner() as said:
        said("drawing the report")
        return written | identification_page(out / "report.html", measured, found, guess)


def _show(found: "Identification", files: dict[str, Path]) -> None:
    """Print what was found and what to look at."""
    from hyperflex.report import parameters_table, ratios_table, readable_unit

    output.console().print(str(found.grade), markup=False, style="bold")
    for reason in found.grade.more:
        output.console().print(f"  {reason}", markup=False)
    unit = readable_unit(found.unit, found.residual_rms)
    pairs = [("ended", found.message), ("fit error, rms", f"{found.residual_rms_all / unit.size:.3g} {unit.name}")]
    if (held := found.held_out) is not None:
        worst = f"{held.rms.max() / unit.size:.3g} {unit.name}"
        pairs.append((f"prediction error over {held.ahead:g} s", f"{worst} rms in the worst channel"))
    output.print_pairs("Fit", pairs)
    for table in (parameters_table(found, None), ratios_table(found)):
        if table is not None:
            first = [row[0] for row in table.rows]
            kept = [row for k, row in enumerate(table.rows) if first[:k].count(row[0]) < _OF_EACH][:_ROWS]
            shown = [k for k, name in enumerate(table.header) if name != "what it is"]
            output.print_table([table.header[k] for k in shown], [[row[k] for k in shown] for row in kept])
            if len(table.rows) > len(kept):
                left = f"  and {len(table.rows) - len(kept)} more, in {files['page']}"
                output.console().print(left, markup=False, soft_wrap=True)
    for sentence in found.verdict:
        output.console().print(sentence, markup=False)
    words = {"rope": "rope and figures", "figures": "numbers", "page": "the whole story on one page"}
    output.print_pairs("Written", [(words[kind], str(path)) for kind, path in files.items()])
