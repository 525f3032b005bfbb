"""Links that are coloured bars, without markers: a rendered pendulum against its truth, and the real one's video."""

import itertools

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.estimate import Observations, RopeFilter
from hyperflex.vision import (
    Bar,
    BarDetector,
    Camera,
    Renderer,
    RopeMotion,
    Scene,
    VideoReader,
    frame_times,
    link_angles,
    track_bars,
)
from tests.refusals import refuses

DARK, BLUE = (75.0, 60.0, 63.0), (223.0, 84.0, 30.0)
PENDULUM = hf.Rope(
    length=[0.205, 0.179], mass=[0.26, 0.11], com=[0.1, 0.09], inertia=[9.5e-4, 3.1e-4], friction=[2e-4, 1e-4]
)
CAMERA = Camera.facing((316, 332), pixels_per_metre=400.0, origin=(158.0, 150.0), exposure=0.008)
WALL = np.tile(np.uint8([124, 144, 164]), (332, 316, 1))


def filmed(path, duration=3.0):
    """Write a video of a double pendulum that turns over; return its truth, and a detector of its bars."""
    run = hf.simulate(PENDULUM, duration=duration, q0=[2.2, 2.6], t_eval=np.arange(0.0, duration, 0.002))
    bars = Bar(0.205, 0.384, 0.038, BLUE), Bar(0.0, 0.205, 0.038, DARK)
    scene = Scene([], bars=bars, rope_width=0.0, background=(124.0, 144.0, 164.0))
    renderer = Renderer(CAMERA, RopeMotion(run.t, run.q, run.qd, PENDULUM.length), scene)
    renderer.write(path, frame_times(0.0, duration - 0.05, 30.0))
    clicks = CAMERA.project(renderer.motion.places(np.zeros(1), [0.1025, 0.2945])[0])
    return run, BarDetector.from_clicks(frames(path, 1)[0].image, clicks)


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    path = tmp_path_factory.mktemp("bars") / "pendulum.mp4"
    return path, *filmed(path)


def frames(path, count=None):
    """Return the first frames of a video."""
    with VideoReader(path) as video:
        return list(itertools.islice(video, count))


def test_links_are_followed_through_whole_turns(pendulum, tmp_path):
    """Angles with their turns: within 1 degree (median) and never another turn or end; the preview is as long."""
    path, run, detector = pendulum
    found = track_bars(path, detector, (158.0, 150.0), preview=tmp_path / "seen.mp4")
    true = np.stack([np.interp(found.recording.t, run.t, column) for column in run.q.T], axis=1)
    off = found.recording.data - true
    assert np.abs(np.diff(true[:, 1])).max() > 0.3  # rad between frames: fast enough to matter
    assert np.nanmedian(np.abs(off)) < np.radians(1.0)
    assert np.nanmax(np.abs(off)) < 0.6  # a covered bar shows a part of itself; its noise says so
    assert np.nanmax(np.abs(off) / found.recording.noise) < 8.0
    assert found.seen.min() > 0.85
    assert len(frames(tmp_path / "seen.mp4")) == found.frames


def test_a_hidden_bar_is_nan():
    image, detector = WALL.copy(), BarDetector([DARK, BLUE], [4000.0, 3500.0])
    image[100:200, 140:180] = DARK
    assert np.isnan(detector.find(WALL).centres).all()
    seen = detector.find(image)
    assert np.isfinite(seen.centres[0]).all()
    assert np.isnan(seen.centres[1]).all()
    assert np.isnan(seen.stds[1])


def test_a_hidden_joint_leaves_the_last_direction():
    """Without its first bar, the second keeps the end that it pointed with; without anything known it is NaN."""
    image = WALL.copy()
    image[100:160, 200:220] = BLUE
    seen = BarDetector([DARK, BLUE]).find(image)
    pivot = np.array([158.0, 100.0])
    np.testing.assert_allclose(link_angles(seen, pivot, np.array([np.nan, 3.3]))[1], np.pi, atol=0.02)
    np.testing.assert_allclose(link_angles(seen, pivot, np.array([np.nan, 6.0]))[1], 2.0 * np.pi, atol=0.02)
    assert np.isnan(link_angles(seen, pivot, np.full(2, np.nan))).all()


def withheld(rope, track, every):
    """Return differences (m, 2), m, of link ends in withheld frames from those that a filter of the others predicts."""
    recording = track.recording
    tracker, errors = RopeFilter(rope, rope.link_ends), []
    places = rope.joints(recording.data, np.zeros((recording.t.size, 2)))[:, 1:]
    stds = np.sqrt(np.cumsum((rope.length * recording.noise) ** 2, axis=1))
    whole = (recording.noise < np.radians(6.0)) & ~np.isnan(recording.data)  # little of them is covered
    for k, (t, place, std) in enumerate(zip(recording.t, places, stds, strict=True)):
        if k > 20 and k % every == 0:
            tracker.predict_to(t)
            errors.append((place - tracker.markers()[0])[whole[k].cumprod() > 0])
        else:
            tracker.update(Observations(t, place, std))
    return np.concatenate(errors)


def test_a_filter_of_their_angles_carries_on_hidden_bars(pendulum):
    """Every fourth frame is withheld, and predicted within 2 px rms."""
    path, _, detector = pendulum
    errors = withheld(PENDULUM, track_bars(path, detector, (158.0, 150.0)), every=4)
    assert len(errors) > 20
    assert CAMERA.pixels_per_metre * np.sqrt((errors**2).sum(axis=-1).mean()) < 2.0


def test_bars_that_cannot_be_are_refused():
    refuses("1 to 3", BarDetector, [DARK] * 4)
    for alike in ([BLUE, np.array(BLUE) * 0.99], [WALL[0, 0]]):
        refuses("alike, or like", BarDetector(alike).find, WALL)


def test_the_real_pendulum(data_dir, tmp_path):
    """From the video to ratios, the time between frames, and predicted positions in withheld frames.

    Bars of 0.205 and 0.179 m are 112.7 and 98.4 px long: 550 px/m, and the joints are 85.7 px = 0.156 m apart. Angles
    alone tell lengths only over g times the square of the clock's rate, so that the first link's length is fitted and
    gives the clock. The source says 60 frames/s were filmed and stores 33 ms; 1.5 to 2 sixtieths were guessed.
    """
    path, pivot, joints = data_dir / "real_double_pendulum_video" / "pendulum.mp4", (167.2, 146.7), 0.1559
    video = frames(path)
    detector = BarDetector.from_clicks(video[40].image, [(213, 140), (252, 180)])
    track = track_bars(path, detector, pivot)
    assert track.seen[0] == 1.0
    assert track.seen[1] > 0.93
    bars = [detector.find(frame.image) for frame in video[5:]]
    whole = [k for k, each in enumerate(bars) if (each.areas > 0.9).all()]
    first = np.array([np.sin(track.recording.data[5:, 0]), np.cos(track.recording.data[5:, 0])]).T
    reach = np.array([np.linalg.norm(bars[k].centres[1] - (pivot + 85.7 * first[k])) for k in whole])
    assert len(whole) > 25
    assert np.std(reach) < 2.0  # px: the second link keeps its length
    angles = track.recording.window(0.16, track.recording.t[-1])  # the first frames fade in
    guess = hf.Rope(
        [joints, 0.154], mass=[0.262, 0.110], com=[0.08, 0.066], inertia=[9.5e-4, 3.1e-4], friction=[1e-4, 1e-4]
    )
    found = hf.identify(angles, guess, free=["length[0]", "inertia", "com", "friction", "gravity_angle"])
    assert found.success
    low, high = found.intervals["length[0]"].low, found.intervals["length[0]"].high
    clock = np.sqrt(joints / np.array([high, low]))  # true time over stored time
    sixtieths = 0.033 * 60.0 * clock
    assert 1.5 < sixtieths[0] < sixtieths[1] < 2.0
    # Ratios of plain bars, the first with m2 at its end: 0.139 m and 0.0202 m in true time, 0.187 without a unit
    scale = found.rope.length[0] / joints
    np.testing.assert_allclose(
        found.ratios["J/p1"] / scale, [0.139, 0.0202], rtol=0.2
    )  # bolts and bearings are not in them
    rope = found.rope.replace(length=[found.rope.length[0], 0.1545 * scale])
    errors = withheld(rope, track, every=5)
    assert len(errors) > 50
    assert 550.0 / scale * np.sqrt((errors**2).sum(axis=-1).mean()) < 4.0  # measured 3.9, 0.3 m from the pivot
