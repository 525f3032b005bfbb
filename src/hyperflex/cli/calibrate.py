"""``hyperflex calibrate``: pictures of a board in, a camera out."""

from pathlib import Path
from typing import Annotated, Any

import typer

from hyperflex import files, vision
from hyperflex.checks import ByName, number
from hyperflex.cli import output
from hyperflex.cli.command import check_destination
from hyperflex.errors import InvalidInput


def calibrate(
    pictures: Annotated[list[Path], typer.Argument(help="Pictures of the board, or a video of it.")],
    squares: Annotated[tuple[int, int], "Number of squares of the board, to the right and down."],
    square: Annotated[float, "Side of a square, m, measured on the print."],
    out: Annotated[Path, "TOML file for the camera."] = Path("camera.toml"),
    marker: Annotated[float | None, "Side of a marker, m, of a ChArUco board. [default: a plain chessboard]"] = None,
    dictionary: Annotated[str, "OpenCV's name of the markers' dictionary."] = "DICT_4X4_50",
    plane: Annotated[Path | None, "Picture of the board held in the swing plane."] = None,
    points: Annotated[Path | None, "In place of --plane: CSV table x,y,u,v of 4 or more known points (m, px)."] = None,
    origin_pixel: Annotated[
        tuple[float, float] | None,
        "Pixel of the arm's axis in --plane, u v. [default: the board's corner]",
    ] = None,
    exposure: Annotated[float, "Exposure of the videos that the camera will take, s."] = 0.0,
    readout: Annotated[float, "Readout time from the first row to the last, s; 0: global shutter."] = 0.0,
    readout_direction: Annotated[str, "down, up, right or left, in the picture."] = "down",
    delay: Annotated[float, "Delay of the time stamps, s."] = 0.0,
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

    check_destination(out, ".toml", [*pictures, plane, points])
    if plane is not None and points is not None:
        raise InvalidInput("--plane and --points are given both", fix="Give one of them")
    if origin_pixel is not None and plane is None:
        raise InvalidInput("--origin-pixel is given without --plane", fix="Give both")
    timing: ByName = {
        "exposure": _short("--exposure", exposure),
        "readout": _short("--readout", readout),
        "readout_direction": readout_direction,
        "delay": number("--delay", delay, unit="s"),
    }
    picture, known = (
        (None if plane is None else vision.read_image(plane)),
        (None if points is None else _known_points(points)),
    )
    board = vision.Board(squares, square, marker, dictionary)
    with output.spinner() as progress:
        found = vision.calibrate_camera(
            vision.read_pictures(pictures),
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
    if view is None:
        more = [("swing plane", "not known yet: give --plane or --points")]
    else:
        more = [
            ("axes in the picture", f"x points {view.x_words}, y {view.y_words}"),
            ("tilt and roll of the plane", f"{view.tilt:.1f} and {view.roll:.1f} degrees"),
        ]
    output.show(result, output.rows("Calibrated", {**result, "plane": {}}, *more))


def _short(option: str, value: float) -> float:
    """Return an exposure or readout, s; refuse one that no video's frame has time for."""
    if number(option, value, sign="nonnegative", unit="s") > 1.0:  # no frame of a video has more time
        raise InvalidInput(
            f"{option} is longer than a frame of any video",
            got=value,
            allowed="0 to 1 s",
            fix="Give it in seconds: 1/250 s is 0.004",
        )
    return value


def _known_points(path: Path) -> tuple[Any, Any]:
    """Return places (K, 2), m, and pixels (K, 2) of a CSV table."""
    found, columns = files.read_table(path), ["x", "y", "u", "v"]
    if sorted(found.names) != sorted(columns):
        raise InvalidInput(f"{path}: the columns do not fit", got=found.names, allowed="x, y (m), u, v (px)")
    table = found.columns(columns)
    return table[:, :2], table[:, 2:]
