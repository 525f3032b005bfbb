"""The camera: projection against OpenCV's own, derivatives against differences, poses, row times, files."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from hyperflex.vision import Camera, read_camera
from tests.refusals import refuses

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (10, 2)) * [1.0, 0.8]


def tilted():
    """Return a camera with distortion that views the plane from the side."""
    facing = Camera.facing((1280, 720), pixels_per_metre=300.0, origin=(640.0, 300.0))
    turn = cv2.Rodrigues(np.array([0.1, 0.2, 0.05]))[0] @ facing.axes[0]
    return replace(
        facing, distortion=np.array([0.1, -0.2, 0.001, -0.002, 0.05]), rotation=cv2.Rodrigues(turn)[0].ravel()
    )


@pytest.mark.parametrize("count", [4, 5, 8])
def test_projection_is_opencvs(count):
    """With each kind of distortion, on and off the plane: rounding only. And the way back."""
    values = np.array([0.1, -0.2, 0.001, -0.002, 0.05, 0.03, -0.02, 0.01])[:count]
    camera, points = replace(tilted(), distortion=values), np.column_stack([POINTS, 0.1 * POINTS[:, 0]])
    want, slopes = cv2.projectPoints(points, camera.rotation, camera.translation, camera.matrix, values)
    pixels, by_point = camera.linearize(points)
    assert np.abs(pixels - want[:, 0]).max() < 1e-9
    assert np.abs(by_point - (slopes[:, 3:6] @ camera.axes[0]).reshape(-1, 2, 3)).max() < 1e-8
    assert np.array_equal(
        camera.linearize(POINTS)[1], camera.linearize(np.column_stack([POINTS, np.zeros(10)]))[1][:, :, :2]
    )
    assert np.abs(camera.locate(camera.project(POINTS)) - POINTS).max() < 1e-10


def test_an_adjusted_plane_is_a_similarity_of_the_one_before():
    """Its places p are at offset + scale R(roll) p in the old plane: rounding only."""
    camera, angle = tilted(), 0.1
    moved = camera.adjusted(1.02, angle, (0.05, -0.02))
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert np.abs(moved.project(POINTS) - camera.project(1.02 * POINTS @ rotation.T + [0.05, -0.02])).max() < 1e-9


def test_gaps_and_points_behind_the_camera_are_nan():
    camera = tilted()
    behind = [0.0, 0.0, 2.0 * camera.translation[2]]
    for found in camera.linearize([[0.1, 0.2, 0.0], [np.nan, 0.0, 0.0], behind]):
        assert np.isfinite(found[0]).all()
        assert np.isnan(found[1:]).all()
    assert np.isnan(camera.locate([[np.nan, 3.0]])).all()
    assert camera.project(np.zeros((0, 2))).shape == (0, 2)


def test_facing_camera_has_the_requested_scale_and_roll():
    camera = Camera.facing((640, 480), pixels_per_metre=250.0, origin=(300.0, 50.0), roll=np.pi / 2)
    assert np.allclose(camera.project([[0.0, 0.0], [0.4, 0.0], [0.0, 0.4]]), [[300, 50], [300, -50], [200, 50]])
    assert camera.pixels_per_metre == pytest.approx(250.0)


@pytest.mark.parametrize("count", [4, 10])
def test_pose_from_known_points(count):
    camera = tilted()
    found = Camera(camera.image_size, camera.matrix, camera.distortion).with_plane(
        POINTS[:count], camera.project(POINTS[:count])
    )
    assert np.abs(found.project(POINTS) - camera.project(POINTS)).max() < 1e-6


@pytest.mark.parametrize(
    ("points", "pixels", "message"),
    [
        (POINTS[:3], np.zeros((3, 2)), "too few points"),
        (np.column_stack([np.arange(4.0), np.arange(4.0)]), np.zeros((4, 2)), "one line"),
        ([[0, 0], [1, 0], [1, 1], [0, 1], [2, 2]], [[0, 500], [900, 500], [900, 0], [0, 0], [30, 700]], "no pose"),
        (1000.0 * SQUARE, SQUARE * [200, -200] + [600, 400], "scale.*0.2 px/m.*in metres"),
        (1e-4 * SQUARE, SQUARE * [200, -200] + [600, 400], "scale"),
    ],
)
def test_pose_is_refused_by_name(points, pixels, message):
    refuses("with_plane", Camera.pinhole((1280, 720)).project, POINTS)
    refuses(message, Camera.pinhole((1280, 720)).with_plane, points, pixels)


@pytest.mark.parametrize(
    ("by_place", "directions", "roll", "notes"),
    [
        ([[200, 0], [0, -200]], ("right", "up"), 0.0, []),
        ([[0, -200], [-200, 0]], ("up", "left"), 90.0, ["y of the swing plane points left"]),
        ([[-200, 0], [0, 200]], ("left", "down"), -180.0, ["y of the swing plane points down"]),
        ([[200, 0], [0, 200]], ("right", "down"), -180.0, ["y of the swing plane points down", "seen from behind"]),
        ([[-200, 0], [0, -200]], ("left", "up"), 0.0, ["seen from behind: x points left"]),
    ],
    ids=["upright", "on its side", "upside down", "y down", "x left"],
)
def test_it_reports_the_directions_of_the_plane(by_place, directions, roll, notes):
    """Known points whose axes point elsewhere than right and up are taken, and said."""
    pixels = SQUARE @ np.array(by_place).T + [600, 400]
    pixels[0, 0] += 0.01  # OpenCV finds no pose of a plane that is seen from behind exactly at a right angle
    camera = Camera.pinhole((1280, 720)).with_plane(SQUARE, pixels)
    view = camera.plane_view
    assert (view.x_words, view.y_words) == directions
    assert abs(view.roll) == pytest.approx(abs(roll), abs=0.01)
    assert len(view.notes) == len(notes)
    assert all(words in said for said, words in zip(view.notes, notes, strict=True))


def test_a_tilt_and_a_roll_are_found_again():
    camera = Camera.facing((1280, 720), pixels_per_metre=200.0, origin=(600.0, 300.0), roll=0.1)
    view = camera.plane_view
    assert (view.tilt, view.roll) == pytest.approx((0.0, np.degrees(0.1)), abs=1e-5)
    assert tilted().plane_view.tilt == pytest.approx(np.degrees(np.arccos(abs(tilted().axes[0][2, 2]))), abs=1e-9)


def test_points_that_miss_by_some_pixels_are_refused():
    """3.84 px may be missing in a picture of 1280 px; a corner that is 16 px off leaves some 7."""
    off = np.array([[0.0, 0.0], [0.0, 0.0], [8.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    five = np.vstack([SQUARE, [[0.5, 0.4]]])
    pixels = five * [200, -200] + [600, 400]
    Camera.pinhole((1280, 720)).with_plane(five, pixels + 0.5 * off)
    refuses(r"at most 3\.8 px", Camera.pinhole((1280, 720)).with_plane, five, pixels + np.roll(4.0 * off, 2, axis=0))


@pytest.mark.parametrize(
    ("rotation", "translation", "message"),
    [([np.pi, 0.0, 0.0], [0.0, 0.0, -3.0], "behind the camera"), ([np.pi / 2, 0.0, 0.0], [0.0, 0.0, 3.0], "edge-on")],
)
def test_a_file_with_a_plane_that_cannot_be_seen_is_refused(tmp_path, rotation, translation, message):
    replace(tilted(), rotation=np.array(rotation), translation=np.array(translation)).write(tmp_path / "camera.toml")
    refuses(f"camera.toml: the swing plane is.*{message}", read_camera, tmp_path / "camera.toml")


@pytest.mark.parametrize(
    ("direction", "first", "last"),
    [("down", (5, 0), (5, 719)), ("up", (5, 719), (5, 0)), ("right", (0, 5), (1279, 5)), ("left", (1279, 5), (0, 5))],
)
def test_rows_are_exposed_one_after_the_other(direction, first, last):
    camera = Camera.pinhole((1280, 720), exposure=0.01, readout=0.03, readout_direction=direction, delay=0.005)
    assert np.allclose(camera.exposure_times(2.0, [first, last]), [1.995, 2.025])


def test_file_reads_back_to_the_bit(tmp_path):
    camera = replace(tilted(), exposure=0.01, readout=0.02, readout_direction="left", delay=-0.001)
    camera.write(tmp_path / "camera.toml")
    again = read_camera(tmp_path / "camera.toml")
    for name in ("matrix", "distortion", "rotation", "translation"):
        assert np.array_equal(getattr(camera, name), getattr(again, name))
    for name in ("image_size", "exposure", "readout", "readout_direction", "delay"):
        assert getattr(camera, name) == getattr(again, name)
    Camera.pinhole((64, 48)).write(tmp_path / "camera.toml")
    assert read_camera(tmp_path / "camera.toml").rotation is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[rope]\nmass = 1.0", "not a camera's file"),
        ("[camera]\nimage_size = [4, 4]", "lacks matrix, distortion"),
        ("[camera]\nimage_size = [4, 4]\nmatrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\ndistortion = [1]", "4, 5 or 8"),
        ("[camera]\nimage_size = 4\nmatrix = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\ndistortion = [0, 0, 0, 0]", "pair"),
        ("[camera]\nimage_size = [4, 4]\nmatrix = [[1, 9, 0], [0, 1, 0], [0, 0, 1]]\ndistortion = []", "camera matrix"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, text, message):
    (tmp_path / "camera.toml").write_text(text)
    refuses(message, read_camera, tmp_path / "camera.toml")
