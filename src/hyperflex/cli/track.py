"""``hyperflex track``: a video of a rope with markers, or of a pendulum of bars, in; places or angles out."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex import files
from hyperflex.checks import number
from hyperflex.cli import output
from hyperflex.errors import InvalidInput
from hyperflex.interruption import catch_interrupt

if TYPE_CHECKING:
    from hyperflex.estimate import RopeFilter, VideoTrack
    from hyperflex.vision import BarDetector

_SAME = 1e-6  # s, by which two times may differ


def track(
    video: Annotated[Path, typer.Argument(help="Video of the rope, MP4, MOV, ...")],
    rope: Annotated[Path | None, typer.Option(help="TOML file with the rope.")] = None,
    camera: Annotated[
        Path | None, typer.Option(help="TOML file of the camera, with the swing plane (calibrate).")
    ] = None,
    arc_lengths: Annotated[list[str] | None, output.ARC_LENGTHS] = None,
    bar: Annotated[
        list[str] | None,
        typer.Option(
            help="In place of markers: a pixel u,v in the middle of a link that is a bar of its own colour; once for "
            "each link, from the pivot on."
        ),
    ] = None,
    pivot: Annotated[tuple[float, float] | None, typer.Option(help="Pixel of the first joint, u v, for --bar.")] = None,
    at: Annotated[
        float | None,
        typer.Option(help="Time of the frame of the pixels of --bar or --click, s. [default: the first frame]"),
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--output", help="NetCDF file for the places or angles.")] = Path(
        "markers.nc"
    ),
    preview: Annotated[Path | None, typer.Option(help="MP4 file that shows what was seen.")] = None,
    click: output.Click = None,
    estimate: output.Estimate = "",
    changes: output.Changes = "",
    false_alarm_interval: output.FalseAlarmInterval = 600.0,
    json: output.Json = False,
) -> None:
    """Track a rope in a video by its markers and its dynamics.

    The rope hangs from the swing plane's origin. In the first frames its markers are found and put in order; from then
    on each is looked for where the rope's motion says. `hyperflex identify` goes on from the file, with the same
    --arc-lengths and --origin 0,0.

    With --bar and --pivot, the links of a pendulum are followed by their colours, and no rope and no camera is needed:
    the file then holds the links' angles.

    After Ctrl-C, what has been tracked is in a file of its own, markers-interrupted.nc.
    """
    since = -math.inf if at is None else number("--at", at, unit="s") - _SAME
    if bar:
        _track_bars(video, bar, pivot, since, out, preview, json)
        return
    if rope is None or camera is None or not arc_lengths:
        needed = {"--rope": rope, "--camera": camera, "--arc-lengths": arc_lengths}
        missing = [name for name, value in needed.items() if not value]
        fix = "Give them, or --bar and --pivot for a pendulum whose links are bars"
        raise InvalidInput("a rope with markers needs more to be tracked", got="no " + ", ".join(missing), fix=fix)
    from hyperflex.estimate import MarkerMeasurement, RopeFilter, RopeTracker, track_video
    from hyperflex.model import Rope
    from hyperflex.vision import MarkerDetector, VideoReader, read_camera

    output.check_destination(out, ".nc", [video, rope, camera])
    output.check_destination(preview, ".mp4", [video, rope, camera])
    lens = read_camera(camera)
    with VideoReader(video) as reader:
        colour = output.marker_colour((frame.image for frame in reader if frame.time >= since), click)
    estimator = RopeFilter(
        Rope.from_toml(rope),
        output.numbers("--arc-lengths", arc_lengths, "0.2,0.4,0.6"),
        camera=lens,
        parameters=output.parameters(estimate),
        tests=output.change_tests(changes, false_alarm_interval),
    )
    with _keeping(out, json), output.spinner() as said:
        found = track_video(
            video,
            RopeTracker(estimator, MarkerMeasurement(MarkerDetector(colour))),
            preview=preview,
            progress=lambda count: said(f"frame {count}"),
        )
    files.rescued(found.to_netcdf, out)
    _show(found, estimator, out, preview, json)


@contextmanager
def _keeping(out: Path, as_json: bool) -> Iterator[None]:
    """Write what Ctrl-C has left of the tracking in the block, under a name that says so, and exit."""
    with catch_interrupt() as stop:
        yield
    if not stop.received:
        return
    if (part := stop.partial) is None:
        raise KeyboardInterrupt
    kept = output.partial_path(out)
    files.rescued(part.to_netcdf, kept)
    left = {"output": kept, "frames": part.frames, "duration_s": part.recording.duration}
    message = f"Interrupted after {part.frames} frames; what was tracked until then is in {kept}."
    raise typer.Exit(output.interrupted(message, left, as_json=as_json))


def _show(found: "VideoTrack", estimator: "RopeFilter", out: Path, preview: Path | None, as_json: bool) -> None:
    """Print what was tracked."""
    result: dict[str, Any] = {
        "output": out,
        "frames": found.frames,
        "found_at_s": found.found_at,
        "duration_s": found.recording.duration,
        "markers": len(found.arc_lengths),
        "arc_lengths": found.arc_lengths.tolist(),
        "seen": found.seen,
        "noise_level": estimator.measurement_noise.value,
        "estimated": {name: {"value": value, "std": std} for name, (value, std) in found.parameters.items()},
        "changes": [asdict(change) for change in found.changes],
        "notes": [note.replace("arc_lengths", "--arc-lengths") for note in found.notes],
    }
    output.show(
        result,
        f"Tracked {result['markers']} markers in {found.frames} frames",
        [
            ("found at", f"{found.found_at:.3f} s"),
            ("seen", f"{100.0 * found.seen:.1f} % of all markers in {found.recording.duration:.2f} s"),
            *((name, f"{value:.5g} ± {std:.2g}") for name, (value, std) in found.parameters.items()),
            *(("change", str(change)) for change in found.changes),
            *(("note", note) for note in result["notes"]),
            ("written", str(out)),
            *([] if preview is None else [("look at", str(preview))]),
        ],
        as_json=as_json,
    )


def _track_bars(
    video: Path,
    clicks: list[str],
    pivot: tuple[float, float] | None,
    since: float,
    out: Path,
    preview: Path | None,
    json: bool,
) -> None:
    """Track links that are bars, and write their angles."""
    from hyperflex.vision import track_bars

    if pivot is None:
        raise InvalidInput("--pivot is missing", fix="Give the pixel of the first joint, as --pivot 167 147")
    output.check_destination(out, ".nc", [video])
    output.check_destination(preview, ".mp4", [video])
    detector = _clicked(video, [output.numbers("--bar", [each], "213,140") for each in clicks], since)
    with _keeping(out, json), output.spinner() as said:
        found = track_bars(video, detector, pivot, preview=preview, progress=lambda count: said(f"frame {count}"))
    files.rescued(found.to_netcdf, out)
    result: dict[str, Any] = {
        "output": out,
        "frames": found.frames,
        "duration_s": found.recording.duration,
        "seen": found.seen.tolist(),
        "notes": list(found.notes),
    }
    output.show(
        result,
        f"Tracked {len(found.seen)} bars in {found.frames} frames",
        [
            *((f"link {k}", f"seen in {100.0 * part:.1f} % of the frames") for k, part in enumerate(found.seen)),
            *(("note", note) for note in found.notes),
            ("written", str(out)),
            *([] if preview is None else [("look at", str(preview))]),
        ],
        as_json=json,
    )


def _clicked(video: Path, clicks: list[list[float]], since: float) -> "BarDetector":
    """Return a detector of the bars at pixels in the first frame at or after a time."""
    from hyperflex.vision import BarDetector, VideoReader

    if any(len(each) != 2 for each in clicks):
        raise InvalidInput("--bar is a pixel", got=clicks, allowed="u,v", fix="Give it once for each link")
    with VideoReader(video) as reader:
        for frame in reader:
            if frame.time >= since:
                return BarDetector.from_clicks(frame.image, clicks)
    raise InvalidInput("--at is after the end of the video", got=since + _SAME, allowed=f"up to {frame.time:g} s")
