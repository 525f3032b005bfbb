"""Two cameras: a swing in space that each projects by itself, with noise, is the recording of markers in space."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

import hyperflex as hf
from hyperflex.vision import Camera, stereo_recording
from tests.refusals import refuses

TILT = math.radians(2.0)


def camera(turn, size=(1920, 1080)):
    """A camera with distortion, turned about the vertical through the plane's origin, rad, and nodding a little."""
    facing = Camera.facing(size, pixels_per_metre=700.0, origin=(960.0, 200.0))
    about = cv2.Rodrigues(np.array([0.05, 0.0, 0.0]))[0] @ facing.axes[0] @ cv2.Rodrigues(np.array([0.0, turn, 0.0]))[0]
    lens = np.array([0.08, -0.1, 0.001, -0.002, 0.0])
    return replace(facing, distortion=lens, rotation=cv2.Rodrigues(about)[0].ravel())


CAMERAS = camera(0.4), camera(-0.5, (1920, 1080))


@pytest.fixture(scope="module")
def swing():
    """A run of four links with its joints (T, 5, 3), m, that began 2 degrees out of the plane."""
    rope = hf.Rope.uniform(length=0.8, mass=0.05, n_links=4, radius=0.002, friction=2e-4)
    run = hf.simulate(rope, duration=2.0, q0=0.5)
    found = hf.sideways(run, tilt=TILT)
    return run, np.dstack([run.joints, found.joints])


def viewed(places, cameras=CAMERAS, late=0.0, noise=0.3):
    """Recordings of places (T, K, 3), m, every 10 ms, as cameras see them; the second frame a little late, s."""
    t, found, rng = 0.01 * np.arange(len(places)), [], np.random.default_rng(1)
    for each, shift in zip(cameras, (0.0, late), strict=True):
        there = np.stack([np.interp(t + shift, t, column) for column in places.reshape(t.size, -1).T], axis=1)
        pixels = each.project(there.reshape(-1, 3))
        data = each.locate(pixels + noise * rng.standard_normal(pixels.shape)).reshape(t.size, -1)
        data[10, 2:4] = np.nan
        found.append(hf.Recording(t + shift, data, kind="markers"))
    return found


def test_two_cameras_show_the_tilt_and_the_plane(swing):
    run, places = swing
    for late in (0.0, 0.004):
        found = stereo_recording(*viewed(places, late=late), *CAMERAS, plane="xy")
        slope = np.diff(places[:, :, 2], axis=1) / 0.2
        assert found.tilt == pytest.approx(math.sqrt(2.0 * np.mean(slope**2)), rel=0.06)
        moved = places[:, :, 2] - places[:, :, 2].mean(axis=0)
        assert found.out_of_plane == pytest.approx(math.sqrt(np.mean(moved**2)), rel=0.06)
        off = found.data.reshape(-1, 5, 2) - run.joints
        assert np.sqrt(np.nanmean(off**2)) < 1.5e-3
        assert np.isnan(found.data[10, 2:4]).all()
    planar = places * [1.0, 1.0, 0.0]
    assert stereo_recording(*viewed(planar, noise=0.0), *CAMERAS).tilt < 1e-6


def test_what_does_not_fit_is_refused(swing):
    _, places = swing
    left, right = viewed(places)
    refuses("do not meet", stereo_recording, left, replace(right, t=right.t + 0.2), *CAMERAS)
    near = CAMERAS[0], camera(0.41)
    refuses("degrees between the cameras", stereo_recording, *viewed(places, near), *near)
    refuses("do not fit each other", stereo_recording, left, replace(right, data=right.data[:, 2:]), *CAMERAS)
    refuses("does not know the swing plane", stereo_recording, left, right, CAMERAS[0], Camera.pinhole((640, 480)))
