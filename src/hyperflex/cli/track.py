"""``hyperflex track``: a video of a rope with markers in, their places out."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex.cli import output


def track(
    video: Annotated[Path, typer.Argument(help="Video of the rope, MP4, MOV, ...", show_default=False)],
    rope: Annotated[Path, typer.Option(help="TOML file with the rope.", show_default=False)],
    camera: Annotated[
        Path, typer.Option(help="TOML file of the camera, with the swing plane (calibrate).", show_default=False)
    ],
    arc_lengths: Annotated[
        list[str],
        typer.Option(
            help="How far along the rope each marker sits, m; several times or with commas.", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--output", help="NetCDF file for the markers' places.")] = Path(
        "markers.nc"
    ),
    preview: Annotated[Path | None, typer.Option(help="MP4 file that shows what was seen.", show_default=False)] = None,
    click: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="A pixel of a marker in the first frame, u v. [default: the colour that most small things share]",
            show_default=False,
        ),
    ] = None,
    estimate: Annotated[
        str,
        typer.Option(help="What is estimated beside the rope's state: scale=0.01,delay=0.02 (standard deviations)."),
    ] = "",
    changes: Annotated[
        str,
        typer.Option(
            help="What is tested for changes: tip_mass,touch; none. [default: length, tip_mass, friction, drag, touch]",
            show_default=False,
        ),
    ] = "",
    false_alarm_interval: Annotated[
        float, typer.Option(help="Mean time between two false alarms of these tests, s, at least.")
    ] = 600.0,
    json: output.Json = False,
) -> None:
    """Track a rope in a video by its markers and its dynamics.

    The rope hangs from the swing plane's origin. In the first frames its markers are found and put in order; from then
    on each is looked for where the rope's motion says. `hyperflex identify` goes on from the file, with the same
    --arc-lengths and --origin 0,0.
    """
    from hyperflex.estimate import ChangeTests, EstimatedParameter, RopeFilter, RopeTracker, track_video
    from hyperflex.model import Rope
    from hyperflex.vision import MarkerColour, MarkerDetector, VideoReader, read_camera

    output.check_destination(out, ".nc", [video, rope, camera])
    if preview is not None:
        output.check_destination(preview, ".mp4", [video, rope, camera])
    lens = read_camera(camera)
    with VideoReader(video) as reader:
        first = next(iter(reader)).image
    colour = MarkerColour.from_frame(first) if click is None else MarkerColour.from_click(first, click)
    parameters = [
        EstimatedParameter(name.strip(), output.numbers("--estimate", [std], "scale=0.01")[0])
        for name, _, std in (each.partition("=") for each in estimate.split(",") if each)
    ]
    names = tuple(name.strip() for name in changes.split(",") if name.strip())
    estimator = RopeFilter(
        Rope.from_toml(rope),
        output.numbers("--arc-lengths", arc_lengths, "0.2,0.4,0.6"),
        camera=lens,
        parameters=parameters,
        tests=None if changes == "none" else ChangeTests(names or None, false_alarm_interval),
    )
    with output.spinner(json) as said:
        found = track_video(
            video,
            RopeTracker(estimator, MarkerDetector(colour)),
            preview=preview,
            progress=lambda count: said(f"frame {count}"),
        )
    found.recording.to_netcdf(out)
    result: dict[str, Any] = {
        "output": out,
        "frames": found.frames,
        "found_at_s": found.found_at,
        "duration_s": found.recording.duration,
        "markers": len(estimator.model.arc_lengths),
        "seen": found.seen,
        "noise_level": estimator.measurement_noise.value,
        "estimated": {name: {"value": value, "std": std} for name, (value, std) in found.parameters.items()},
        "changes": [asdict(change) for change in found.changes],
        "notes": list(found.notes),
    }
    if json:
        output.print_json(result)
        return
    output.print_pairs(
        f"Tracked {result['markers']} markers in {found.frames} frames",
        [
            ("found at", f"{found.found_at:.3f} s"),
            ("seen", f"{100.0 * found.seen:.1f} % of all markers in {found.recording.duration:.2f} s"),
            *((name, f"{value:.5g} ± {std:.2g}") for name, (value, std) in found.parameters.items()),
            *(("change", str(change)) for change in found.changes),
            *(("note", note) for note in found.notes),
            ("written", str(out)),
        ],
    )
