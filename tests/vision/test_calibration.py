"""Calibration on rendered boards: its accuracy and its refusals."""

import functools

import cv2
import numpy as np
import pytest

from hyperflex.vision import Board, VideoWriter, calibrate_camera, read_camera
from hyperflex.vision.renderer.boards import DISTORTION, MATRIX, SIZE, board_poses, render_board
from tests.cli.conftest import hyperflex, hyperflex_json  # noqa: F401 fixtures
from tests.refusals import refuses

CHARUCO = Board((8, 6), 0.03, 0.0225)  # even rows: new and legacy patterns differ
CHESSBOARD = Board((9, 7), 0.025)
PLANE = np.array([0.1, -0.2, 0.05]), np.array([-0.12, -0.08, 0.55])


@functools.cache
def pictures(board=CHARUCO, legacy=False):
    return [render_board(board, *pose, legacy=legacy, seed=k) for k, pose in enumerate(board_poses(board, 10))]


def few():
    return pictures()[:6]


def parallel(lean):
    """Boards with equal tilts do not determine the focal length, whether they face the camera or not."""
    poses = enumerate(board_poses(CHARUCO, 6, tilt=0.0))
    turn, aside = np.array([lean, 0.0, 0.0]), np.array([0.03, 0.02, 0.0])
    return [render_board(CHARUCO, turn, place - aside, seed=k) for k, (_, place) in poses]


@pytest.mark.parametrize(
    ("board", "legacy"),
    [
        pytest.param(CHARUCO, False, marks=pytest.mark.nightly, id="new"),  # in the gate: the command on a video
        pytest.param(CHARUCO, True, id="legacy"),
        pytest.param(CHESSBOARD, False, id="chessboard"),
    ],
)
def test_camera_and_scale_are_found(board, legacy):
    """Reprojection below 0.3 px and the scale in the plane within 0.1 %: the acceptance figures."""
    found = calibrate_camera(pictures(board, legacy), board)
    assert found.rms < 0.3
    assert found.legacy == legacy
    assert abs(found.camera.matrix[0, 0] - MATRIX[0, 0]) < 4.0 * found.focal_std
    assert 0.0 < found.focal_std < 0.002 * MATRIX[0, 0]
    camera = found.camera.with_plane(*found.plane_points(render_board(board, *PLANE, legacy=legacy, seed=99)))
    extent = board.square * np.array(board.squares)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * extent
    pixels = cv2.projectPoints(np.column_stack([corners, np.zeros(4)]), *PLANE, MATRIX, DISTORTION)[0][:, 0]
    places = camera.locate(pixels)
    sides, true = (np.linalg.norm(p - np.roll(p, 1, axis=0), axis=1) for p in (places, corners))
    assert np.abs(sides / true - 1.0).max() < 1e-3
    assert np.abs(places - corners * [1.0, -1.0]).max() < 5e-4  # x right, y up from the top left corner


SAME = ((8, 6), 0.03, 0.0225)
REFUSED = {  # pictures, the board that is declared, and what is said
    "mirrored": (lambda: [image[:, ::-1].copy() for image in few()], SAME, "mirrored"),
    "turned": (few, ((6, 8), 0.03, 0.0225), "not the declared one"),
    "narrower": (few, ((7, 6), 0.03, 0.0225), "not the declared one"),
    "wider": (few, ((9, 6), 0.03, 0.0225), "not the declared one"),
    "smaller markers": (few, ((8, 6), 0.03, 0.02), "another size in their squares.*0.7[2-5]"),
    "another dictionary": (few, (*SAME, "DICT_5X5_100"), "another dictionary.*DICT_4X4"),
    "three views": (lambda: pictures()[:3], SAME, "too few views.*3 in 3 pictures"),
    "no board": (lambda: [np.zeros((480, 640, 3), np.uint8)], SAME, "too few views.*0 in 1"),
    "nothing": (list, SAME, "no picture"),
    "facing": (lambda: parallel(0.0), SAME, "degenerate.*parallel"),
    "leaning": (lambda: parallel(0.5), SAME, "degenerate.*parallel"),
    "sizes": (lambda: [pictures()[0], pictures()[1][:-2]], SAME, "differ in size"),
}


@pytest.mark.parametrize(
    ("views", "board", "message"),
    [pytest.param(*each, id=name, marks=[pytest.mark.nightly] * (name == "facing")) for name, each in REFUSED.items()],
)
def test_views_that_do_not_fit_are_refused(views, board, message):
    refuses(message, calibrate_camera, views(), Board(*board))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((2, 6), 0.03), "squares to the right"),
        (((8, 6), -0.03), "square"),
        (((8, 6), 30.0), "too large.*in metres"),
        (((8, 6), 0.03, 0.03), "no smaller"),
        (((8, 6), 0.03, 0.02, "DICT_9X9"), "dictionary"),
        (((16, 16), 0.03, 0.02), "too few markers"),
    ],
)
def test_boards_that_cannot_be_are_refused(arguments, message):
    refuses(message, Board, *arguments)


def test_command_on_a_video(hyperflex, hyperflex_json, tmp_path):  # noqa: F811
    with VideoWriter(tmp_path / "board.mp4", SIZE) as video:
        for k, picture in enumerate(pictures()):
            video.write(picture, 0.25 * k)
    cv2.imwrite(str(tmp_path / "plane.png"), render_board(CHARUCO, *PLANE, seed=99))
    arguments = ("calibrate", tmp_path / "board.mp4", "--squares", 8, 6, "--square", 0.03, "--marker", 0.0225)
    arguments += ("-o", tmp_path / "camera.toml", "--exposure", 0.01)
    code, result = hyperflex_json(*arguments, "--plane", tmp_path / "plane.png", "--origin-pixel", 384, 216)
    assert code == 0
    assert result["views"] == 10
    assert result["reprojection_error_px"] < 0.3
    camera = read_camera(tmp_path / "camera.toml")
    assert camera.exposure == 0.01
    assert np.abs(camera.project([[0.0, 0.0]])[0] - [384.0, 216.0]).max() < 1e-6
    (tmp_path / "points.csv").write_text("x,y,u,v\n0,0,100,400\n0.3,0,500,400\n0.3,0.2,500,133\n0,0.2,100,133\n")
    code, out, _ = hyperflex(*arguments, "--points", tmp_path / "points.csv")
    assert code == 0
    assert "pixels per metre" in out
    assert "x points right, y up" in out
    assert "note" not in out
    (tmp_path / "down.csv").write_text("x,y,u,v\n0,0,100,400\n0.3,0,500,400\n0.3,-0.2,500,133\n0,-0.2,100,133\n")
    code, result = hyperflex_json(*arguments, "--points", tmp_path / "down.csv")
    assert code == 0
    assert result["plane_error_px"] < 2.0
    assert (result["plane"]["mirrored"], round(abs(result["plane"]["roll"]), -1)) == (True, 180.0)
    assert ["points down" in result["notes"][-2], "from behind" in result["notes"][-1]] == [True, True]
    for option in ("--exposure", "--readout"):
        code, result = hyperflex_json(*arguments, option, 30)
        assert (code, f"{option} is longer than a frame of any video" in result["error"]) == (2, True)
    assert read_camera(tmp_path / "camera.toml").pixels_per_metre == pytest.approx(
        1333.0, rel=0.02
    )  # the lens bends it


def test_command_refuses(hyperflex_json, tmp_path):  # noqa: F811
    (tmp_path / "empty.mp4").write_bytes(b"")
    (tmp_path / "text.png").write_bytes(b"no picture")
    common = ("--squares", 8, 6, "--square", 0.03, "-o", tmp_path / "camera.toml")
    for name, message in (("empty.mp4", "empty"), ("text.png", "as a picture"), ("none.png", "There is no picture")):
        code, result = hyperflex_json("calibrate", tmp_path / name, *common)
        assert code == 2
        assert message in result["error"]
    code, result = hyperflex_json("calibrate", tmp_path / "text.png", *common, "--origin-pixel", 3, 4)
    assert (code, "without --plane" in result["error"]) == (2, True)
    assert not (tmp_path / "camera.toml").exists()
