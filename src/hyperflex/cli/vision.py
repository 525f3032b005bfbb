"""``hyperflex calibrate`` and ``track``: a board's pictures to a camera, a video to the motion of its rope or bars."""

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex import files
from hyperflex.checks import number
from hyperflex.cli import output
from hyperflex.cli.command import ArcLengths, check_destination, numbers, words
from hyperflex.cli.output import Rows
from hyperflex.errors import InvalidInput

if TYPE_CHECKING:
    from hyperflex.estimate import ChangeTests, EstimatedParameter, RopeFilter
    from hyperflex.vision import BarDetector, Image, MarkerColour

_LONGEST = 1.0  # s, an exposure or readout: no frame of a video has more time
_SAME = 1e-6  # s, by which two times may differ
Camera = Annotated[Path, typer.Option(help="TOML file of the calibrated camera, with the swing plane (calibrate).")]
Click = Annotated[
    tuple[float, float] | None,
    typer.Option(help="Pixel of a marker in the first frame, u v. [default: the colour that most small things share]"),
]
Estimate = Annotated[
    str, typer.Option(help="Parameters to estimate too, with standard deviations: scale=0.01,delay=0.02.")
]
Changes = Annotated[
    str,
    typer.Option(
        help="Changes to test for: tip_mass,touch; or none. [default: length, tip_mass, friction, drag, touch]"
    ),
]
FalseAlarmInterval = Annotated[float, typer.Option(help="Least mean time between false alarms of these tests, s.")]
Preview = Annotated[Path | None, typer.Option(help="MP4 file of the pictures with the estimate drawn on them.")]


def calibrate(
    pictures: Annotated[list[Path], typer.Argument(help="Pictures of the board, or a video of it.")],
    squares: Annotated[tuple[int, int], typer.Option(help="Number of squares of the board, to the right and down.")],
    square: Annotated[float, typer.Option(help="Side of a square, m, measured on the print.")],
    out: Annotated[Path, typer.Option("-o", "--output", help="TOML file for the camera.")] = Path("camera.toml"),
    marker: Annotated[
        float | None, typer.Option(help="Side of a marker, m, of a ChArUco board. [default: a plain chessboard]")
    ] = None,
    dictionary: Annotated[str, typer.Option(help="OpenCV's name of the markers' dictionary.")] = "DICT_4X4_50",
    plane: Annotated[Path | None, typer.Option(help="Picture of the board held in the swing plane.")] = None,
    points: Annotated[
        Path | None, typer.Option(help="In place of --plane: CSV table x,y,u,v of 4 or more known points (m, px).")
    ] = None,
    origin_pixel: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Pixel of the arm's axis in --plane, u v. [default: the board's corner]"),
    ] = None,
    exposure: Annotated[float, typer.Option(help="Exposure of the videos that the camera will take, s.")] = 0.0,
    readout: Annotated[
        float, typer.Option(help="Readout time from the first row to the last, s; 0: global shutter.")
    ] = 0.0,
    readout_direction: Annotated[str, typer.Option(help="down, up, right or left, in the picture.")] = "down",
    delay: Annotated[float, typer.Option(help="Delay of the time stamps, s.")] = 0.0,
) -> None:
    """Calibrate a camera from pictures of a board.

    The board is a chessboard or a ChArUco board. Show the whole board, flat and sharp, at 15 or more places and angles,
    tilted by 30 to 45 degrees. New and legacy ChArUco boards are both tried. With --plane or --points the file also
    holds the swing plane: x to the right, y up, and (0, 0) at --origin-pixel or as the table says.

    The command refuses too few views, parallel views, a board with other squares or markers, and mirrored pictures (of
    a ChArUco board: a chessboard looks the same in both). No picture shows that the size of the squares is wrong:
    measure it.
    """
    import numpy as np

    from hyperflex.vision import Board, calibrate_camera, read_image, read_pictures

    check_destination(out, ".toml", [*pictures, plane, points])
    if plane is not None and points is not None:
        raise InvalidInput("--plane and --points are given both", fix="Give one of them")
    if origin_pixel is not None and plane is None:
        raise InvalidInput("--origin-pixel is given without --plane", fix="Give both")
    timing: dict[str, Any] = {
        "exposure": _short("--exposure", exposure),
        "readout": _short("--readout", readout),
        "readout_direction": readout_direction,
        "delay": number("--delay", delay, unit="s"),
    }
    picture, known = (None if plane is None else read_image(plane)), (None if points is None else _known_points(points))
    board = Board(squares, square, marker, dictionary)
    with output.spinner() as progress:
        found = calibrate_camera(
            read_pictures(pictures),
            board,
            progress=lambda images, views: progress(f"{images} pictures, {views} views of the board"),
            **timing,
        )
    if picture is not None:
        known = found.plane_points(picture)
    camera, misfit = found.camera, None
    if known is not None:
        camera = camera.with_plane(*known)
        misfit = float(np.sqrt(np.mean(np.sum((camera.project(known[0]) - known[1]) ** 2, axis=1))))
    if origin_pixel is not None:
        camera = camera.with_origin(origin_pixel)
    files.rescued(camera.write, out)
    view = None if camera.rotation is None else camera.plane_view
    notes = [*found.notes, *(() if view is None else view.notes)]
    rows = [
        ("reprojection error", f"{found.rms:.3f} px"),
        ("focal length", f"{camera.matrix[0, 0]:.1f} ± {found.focal_std:.1f} px"),
        ("greatest tilt between views", f"{found.tilt:.0f} degrees"),
    ]
    if view is None:
        rows.append(("swing plane", "not known yet"))
    else:
        rows += [
            ("swing plane", f"{camera.pixels_per_metre:.1f} px/m at its origin"),
            ("its fit error", f"{misfit:.2f} px"),
            ("its axes", f"in the picture x points {view.x_words}, y {view.y_words}"),
            ("its tilt and roll", f"{view.tilt:.1f} and {view.roll:.1f} degrees"),
        ]
    result = {
        "output": out,
        "reprojection_error_px": found.rms,
        "pictures": found.images,
        "views": found.views,
        "focal_length_px": camera.matrix[0, 0],
        "focal_length_std_px": found.focal_std,
        "greatest_tilt_deg": found.tilt,
        "legacy_pattern": found.legacy,
        "pixels_per_metre": None if view is None else camera.pixels_per_metre,
        "plane_error_px": misfit,
        "plane": None if view is None else view._asdict(),
        "notes": notes,
    }
    title = f"Calibrated from {found.views} views in {found.images} pictures"
    output.show(result, Rows(title, [*rows, *(("note", each) for each in notes), ("written", str(out))]))


def _short(option: str, value: float) -> float:
    """Return an exposure or readout, s; refuse one that no video's frame has time for."""
    if number(option, value, sign="nonnegative", unit="s") > _LONGEST:
        fix = "Give it in seconds: 1/250 s is 0.004"
        raise InvalidInput(f"{option} is longer than a frame of any video", got=value, allowed="0 to 1 s", fix=fix)
    return value


def _known_points(path: Path) -> tuple[Any, Any]:
    """Return places (K, 2), m, and pixels (K, 2) of a CSV table."""
    names, rows, *_ = files.read_table(path)
    columns = ["x", "y", "u", "v"]
    if sorted(names) != sorted(columns):
        raise InvalidInput(f"{path}: the columns do not fit", got=names, allowed="x, y (m), u, v (px)")
    table = rows[:, [names.index(name) for name in columns]]
    return table[:, :2], table[:, 2:]


def track(
    video: Annotated[Path, typer.Argument(help="Video of the rope, MP4, MOV, ...")],
    rope: Annotated[Path | None, typer.Option(help="TOML file with the rope.")] = None,
    camera: Annotated[
        Path | None, typer.Option(help="TOML file of the calibrated camera, with the swing plane (calibrate).")
    ] = None,
    arc_lengths: ArcLengths = None,
    bar: Annotated[
        list[str] | None,
        typer.Option(
            help="In place of markers: pixel u,v in the middle of a link that is a bar of its own colour; once for "
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
    preview: Preview = None,
    click: Click = None,
    estimate: Estimate = "",
    changes: Changes = "",
    false_alarm_interval: FalseAlarmInterval = 600.0,
) -> None:
    """Track a rope in a video by its markers and its dynamics.

    The rope hangs from the origin of the swing plane. Its markers are found and ordered in the first frames; from then
    on each is searched where the rope's motion predicts it. `hyperflex identify` continues from the file, with the same
    --arc-lengths and --origin 0 0.

    With --bar and --pivot the command follows the links of a pendulum by their colours and needs neither rope nor
    camera: the file then holds the links' angles.

    After Ctrl-C, the part that has been tracked is in a separate file, such as markers-interrupted.nc.
    """
    since = -math.inf if at is None else number("--at", at, unit="s") - _SAME
    needed = {"--rope": rope, "--camera": camera, "--arc-lengths": arc_lengths}
    if bar and pivot is None:
        raise InvalidInput("--pivot is missing", fix="Give the pixel of the first joint, as --pivot 167 147")
    if not bar and (missing := [name for name, value in needed.items() if not value]):
        fix = "Give them, or --bar and --pivot for a pendulum whose links are bars"
        raise InvalidInput("a rope with markers needs more to be tracked", got="no " + ", ".join(missing), fix=fix)
    for each, suffix in ((out, ".nc"), (preview, ".mp4")):
        check_destination(each, suffix, [video, rope, camera])
    details: dict[str, Any] = {}
    if bar:
        found, stopped = _track_bars(video, bar, pivot, since, preview)
        title, seen = f"Tracked {len(found.seen)} bars", found.seen.tolist()
        rows = [(f"link {k}", f"seen in {100.0 * part:.1f} % of the frames") for k, part in enumerate(seen)]
    else:
        tests = change_tests(changes, false_alarm_interval)
        estimator = _estimator(rope, camera, arc_lengths, parameters(estimate), tests)
        found, stopped = _track_markers(video, estimator, click, since, preview)
        title, seen = f"Tracked {len(found.arc_lengths)} markers", found.seen
        details = {
            "found_at_s": found.found_at,
            "markers": len(found.arc_lengths),
            "arc_lengths": found.arc_lengths.tolist(),
            "noise_level": estimator.measurement_noise.value,
            "estimated": {name: {"value": value, "std": std} for name, (value, std) in found.parameters.items()},
            "changes": [asdict(change) for change in found.changes],
        }
        rows = [
            ("found at", f"{found.found_at:.3f} s"),
            ("seen", f"{100.0 * seen:.1f} % of all markers in {found.recording.duration:.2f} s"),
            *((name, f"{value:.5g} ± {std:.2g}") for name, (value, std) in found.parameters.items()),
            *(("change", str(change)) for change in found.changes),
        ]
    kept = output.partial_path(out) if stopped else out
    files.rescued(found.to_netcdf, kept)
    notes = [each.replace("arc_lengths", "--arc-lengths") for each in found.notes]
    result = {"output": kept, "frames": found.frames, "duration_s": found.recording.duration, "seen": seen}
    rows += [*(("note", each) for each in notes), ("written", str(kept))]
    output.show(
        result | details | {"notes": notes},
        Rows(f"{title} in {found.frames} frames", rows if preview is None else [*rows, ("preview", str(preview))]),
        interrupted=f"Interrupted after {found.frames} frames; the part that was tracked is in {kept}."
        if stopped
        else "",
    )


def _track_markers(video: Path, estimator: "RopeFilter", click: Any, since: float, preview: Path | None) -> Any:
    """Track a rope with markers; return the result, and whether it was interrupted."""
    from hyperflex.estimate import MarkerMeasurement, RopeTracker, track_video
    from hyperflex.vision import MarkerDetector, VideoReader

    with VideoReader(video) as reader:
        colour = marker_colour((frame.image for frame in reader if frame.time >= since), click)
    tracker = RopeTracker(estimator, MarkerMeasurement(MarkerDetector(colour)))
    with output.spinner() as said:
        return output.run(
            lambda: track_video(video, tracker, preview=preview, progress=lambda count: said(f"frame {count}"))
        )


def _track_bars(video: Path, clicks: list[str], pivot: Any, since: float, preview: Path | None) -> Any:
    """Track links that are bars; return the result, and whether it was interrupted."""
    from hyperflex.vision import track_bars

    detector = _bar_detector(video, [numbers("--bar", [each], "213,140") for each in clicks], since)
    with output.spinner() as said:
        return output.run(
            lambda: track_bars(video, detector, pivot, preview=preview, progress=lambda count: said(f"frame {count}"))
        )


def _bar_detector(video: Path, clicks: list[list[float]], since: float) -> "BarDetector":
    """Return a detector of the bars at pixels in the first frame at or after a time."""
    from hyperflex.vision import BarDetector, VideoReader

    if any(len(each) != 2 for each in clicks):
        raise InvalidInput("--bar is a pixel", got=clicks, allowed="u,v", fix="Give it once for each link")
    with VideoReader(video) as reader:
        for frame in reader:
            if frame.time >= since:
                return BarDetector.from_clicks(frame.image, clicks)
    raise InvalidInput("--at is after the end of the video", got=since + _SAME, allowed=f"up to {frame.time:g} s")


def _estimator(rope: Any, camera: Any, arc_lengths: Any, estimated: Any, tests: "ChangeTests | None") -> "RopeFilter":
    """Return the filter of a rope with markers."""
    from hyperflex.estimate import RopeFilter
    from hyperflex.model import Rope
    from hyperflex.vision import read_camera

    lens, arcs = read_camera(camera), numbers("--arc-lengths", arc_lengths, "0.2,0.4,0.6")
    return RopeFilter(Rope.from_toml(rope), arcs, camera=lens, parameters=estimated, tests=tests)


def parameters(text: str) -> "list[EstimatedParameter]":
    """Return the parameters of ``--estimate scale=0.01,delay=0.02``."""
    from hyperflex.estimate import EstimatedParameter

    result = []
    for each in words([text]):
        name, _, std = (part.strip() for part in each.partition("="))
        if not std:
            allowed = "each with the standard deviation of its prior, as in scale=0.01,delay=0.02"
            raise InvalidInput("--estimate names a parameter without a number", got=each, allowed=allowed)
        result.append(EstimatedParameter(name, numbers("--estimate", [std], "scale=0.01")[0]))
    return result


def change_tests(changes: str, false_alarm_interval: float) -> "ChangeTests | None":
    """Return the tests of ``--changes tip_mass,touch`` and ``--false-alarm-interval``; None for ``none``."""
    from hyperflex.estimate import ChangeTests

    names = tuple(words([changes]))
    return None if names == ("none",) else ChangeTests(names or None, false_alarm_interval)


def marker_colour(images: "Iterable[Image]", click: tuple[float, float] | None) -> "MarkerColour":
    """Return the markers' colour: that of the first picture which shows one, or at a pixel of the first picture."""
    from hyperflex.vision import MarkerColour

    count = 0
    for image in images:
        if click is not None:
            return MarkerColour.from_click(image, click)
        with suppress(InvalidInput):
            return MarkerColour.from_frame(image)
        count += 1
    if not count:
        raise InvalidInput("no frame was received", fix="Check the source, and --at if it is given")
    raise InvalidInput(
        "no colour of markers was found",
        got=f"{count} frames",
        allowed="a frame with at least 3 small things of one strong colour and size",
        fix="Give a pixel of a marker with --click U V",
    )
