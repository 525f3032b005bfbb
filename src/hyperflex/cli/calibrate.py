"""``hyperflex calibrate``: pictures or a video of a board in, a camera out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperflex import files
from hyperflex.checks import number
from hyperflex.cli import output
from hyperflex.errors import InvalidInput

if TYPE_CHECKING:
    from hyperflex.vision import PlaneView

_LONGEST = 1.0  # s


def calibrate(
    pictures: Annotated[list[Path], typer.Argument(help="Pictures of the board, or a video of it.")],
    squares: Annotated[
        tuple[int, int],
        typer.Option(help="Numbers of squares of the board, to the right and down."),
    ],
    square: Annotated[float, typer.Option(help="Side of a square, m, measured on the print.")],
    out: Annotated[Path, typer.Option("-o", "--output", help="TOML file for the camera.")] = Path("camera.toml"),
    marker: Annotated[
        float | None, typer.Option(help="Side of a marker, m, of a ChArUco board. [default: a plain chessboard]")
    ] = None,
    dictionary: Annotated[str, typer.Option(help="Of the markers, as OpenCV names it.")] = "DICT_4X4_50",
    plane: Annotated[Path | None, typer.Option(help="Picture of the board held in the swing plane.")] = None,
    points: Annotated[
        Path | None,
        typer.Option(help="In place of --plane: CSV table x,y,u,v of 4 or more known points (m, px)."),
    ] = None,
    origin: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Where --plane shows the arm's axis, px. [default: the board's corner]"),
    ] = None,
    exposure: Annotated[float, typer.Option(help="Of the videos to come, s.")] = 0.0,
    readout: Annotated[float, typer.Option(help="From the first row to the last, s; 0 for a global shutter.")] = 0.0,
    readout_direction: Annotated[str, typer.Option(help="down, up, right or left, as the picture is seen.")] = "down",
    delay: Annotated[float, typer.Option(help="By which time stamps are late, s.")] = 0.0,
    json: output.Json = False,
) -> None:
    """Calibrate a camera from pictures of a chessboard or ChArUco board.

    Show the whole board, flat and sharp, at 15 or more places and angles, tilted by 30 to 45 degrees. New and legacy
    ChArUco boards are tried both. With --plane or --points the file also holds where the swing plane is: x to the
    right, y up, and (0, 0) where --origin or the table says. What is printed says how the plane is seen.

    Refused by name: too few views, views that are all parallel, a board with other squares or markers, mirrored
    pictures (of a ChArUco board: a chessboard looks the same in both). A size of squares that is wrong by a factor
    shows in no picture: measure it.
    """
    import numpy as np

    from hyperflex.vision import Board, calibrate_camera, read_image, read_pictures

    inputs = [*pictures, *(path for path in (plane, points) if path is not None)]
    output.check_destination(out, ".toml", inputs)
    if plane is not None and points is not None:
        raise InvalidInput("--plane and --points are given both", fix="Give one of them")
    if origin is not None and plane is None:
        raise InvalidInput("--origin is given without --plane", fix="Give both")
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
    if origin is not None:
        camera = camera.with_origin(origin)
    files.rescued(camera.write, out)
    view = None if camera.rotation is None else camera.plane_view
    result = {
        "output": out,
        "reprojection_error_px": found.rms,
        "pictures": found.images,
        "views": found.views,
        "focal_length_px": camera.matrix[0, 0],
        "focal_length_std_px": found.focal_std,
        "greatest_tilt_deg": found.tilt,
        "legacy_pattern": found.legacy,
        "pixels_per_metre": None if camera.rotation is None else camera.pixels_per_metre,
        "plane_error_px": misfit,
        "plane": None if view is None else view._asdict(),
        "notes": [*found.notes, *(() if view is None else view.notes)],
    }
    _show(result, view, json)


def _short(option: str, value: float) -> float:
    """Return an exposure or readout, s; refuse one that no video's frame has time for."""
    if number(option, value, sign="nonnegative", unit="s") > _LONGEST:
        fix = "Give it in seconds: 1/250 s is 0.004"
        raise InvalidInput(f"{option} is longer than a frame of any video", got=value, allowed="0 to 1 s", fix=fix)
    return value


def _known_points(path: Path) -> tuple[Any, Any]:
    """Return places (K, 2), m, and pixels (K, 2) of a CSV table."""
    from hyperflex.files import read_table

    names, rows, *_ = read_table(path)
    columns = ["x", "y", "u", "v"]
    if sorted(names) != sorted(columns):
        raise InvalidInput(f"{path}: the columns do not fit", got=names, allowed="x, y (m), u, v (px)")
    table = rows[:, [names.index(name) for name in columns]]
    return table[:, :2], table[:, 2:]


def _show(result: dict[str, Any], view: "PlaneView | None", as_json: bool) -> None:
    seen = [("swing plane", "not known yet")]
    if view is not None:
        seen = [
            ("swing plane", f"{result['pixels_per_metre']:.1f} px/m at its origin"),
            ("its fit error", f"{result['plane_error_px']:.2f} px"),
            ("its axes", f"in the picture x points {view.x_words}, y {view.y_words}"),
            ("its tilt and roll", f"{view.tilt:.1f} and {view.roll:.1f} degrees"),
        ]
    output.show(
        result,
        f"Calibrated from {result['views']} views in {result['pictures']} pictures",
        [
            ("reprojection error", f"{result['reprojection_error_px']:.3f} px"),
            ("focal length", f"{result['focal_length_px']:.1f} ± {result['focal_length_std_px']:.1f} px"),
            ("greatest tilt between views", f"{result['greatest_tilt_deg']:.0f} degrees"),
            *seen,
            *(("note", note) for note in result["notes"]),
            ("written", str(result["output"])),
        ],
        as_json=as_json,
    )
