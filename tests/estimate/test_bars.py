"""Links that are coloured bars, without markers: a rendered pendulum against its truth, and the real one's video."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.estimate import BarMeasurement, EstimatedParameter, RopeFilter, RopeTracker, bar_arc_lengths
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
SPANS = np.array([[-0.015, 0.22], [0.22, 0.399]])  # their ends are round, and the first lies over the second


def filmed(path, duration=3.0):
    """Write a video of a double pendulum that turns over; return its truth, and a detector of its bars."""
    run = hf.simulate(PENDULUM, duration=duration, q0=[2.2, 2.6], t_eval=np.arange(0.0, duration, 0.002))
    bars = Bar(0.205, 0.384, 0.038, BLUE), Bar(0.0, 0.205, 0.038, DARK)
    scene = Scene([], bars=bars, rope_width=0.0, background=(124.0, 144.0, 164.0))
    renderer = Renderer(CAMERA, RopeMotion(run.t, run.q, run.qd, PENDULUM.length), scene)
    renderer.write(path, frame_times(0.0, duration - 0.05, 30.0))
    with VideoReader(path) as video:
        first = next(iter(video)).image
    return run, BarDetector.from_clicks(first, CAMERA.project(renderer.motion.places(np.zeros(1), [0.1025, 0.2945])[0]))


def test_links_are_followed_through_whole_turns(tmp_path):
    """Angles with their turns: within 1 degree (median) and never another turn or end; the preview is as long."""
    run, detector = filmed(tmp_path / "pendulum.mp4")
    found = track_bars(tmp_path / "pendulum.mp4", detector, (158.0, 150.0), preview=tmp_path / "seen.mp4")
    true = np.stack([np.interp(found.recording.t, run.t, column) for column in run.q.T], axis=1)
    off = found.recording.data - true
    assert np.abs(np.diff(true[:, 1])).max() > 0.3  # rad between frames: fast enough to matter
    assert np.nanmedian(np.abs(off)) < np.radians(1.0)
    assert np.nanmax(np.abs(off)) < 0.6  # a covered bar shows a part of itself; its noise says so
    assert np.nanmax(np.abs(off) / found.recording.noise) < 8.0
    assert found.seen.min() > 0.85
    with VideoReader(tmp_path / "seen.mp4") as video:
        assert len(list(video)) == found.frames


def test_a_hidden_joint_leaves_the_last_direction():
    """Without its first bar, the second keeps the end that it pointed with; without anything known it is NaN."""
    image = np.tile(np.uint8([124, 144, 164]), (332, 316, 1))
    image[100:160, 200:220] = BLUE
    seen = BarDetector([DARK, BLUE]).find(image)
    pivot = np.array([158.0, 100.0])
    np.testing.assert_allclose(link_angles(seen, pivot, np.array([np.nan, 3.3]))[1], np.pi, atol=0.02)
    np.testing.assert_allclose(link_angles(seen, pivot, np.array([np.nan, 6.0]))[1], 2.0 * np.pi, atol=0.02)
    assert np.isnan(link_angles(seen, pivot, np.full(2, np.nan))).all()


def test_the_filter_carries_on_hidden_bars(tmp_path):
    """Every fourth frame is withheld, and predicted within 2 px rms."""
    _, detector = filmed(tmp_path / "pendulum.mp4")
    tracker = RopeTracker(RopeFilter(PENDULUM, bar_arc_lengths(SPANS), camera=CAMERA), BarMeasurement(detector))
    errors = withheld(tracker, tmp_path / "pendulum.mp4", every=4)
    assert np.sqrt((errors**2).sum(axis=-1).mean()) < 2.0


def test_frames_and_states_that_cannot_be_are_met_as_with_a_rope(tmp_path, monkeypatch):
    """Another size is refused; if no rope can continue from the state, it is searched again."""
    _, detector = filmed(tmp_path / "pendulum.mp4", duration=0.3)
    tracker = RopeTracker(RopeFilter(PENDULUM, bar_arc_lengths(SPANS), camera=CAMERA), BarMeasurement(detector))
    with VideoReader(tmp_path / "pendulum.mp4") as video:
        frames = list(video)
    assert tracker.look(frames[0]).state is not None
    refuses("another size than the camera's", tracker.look, replace(frames[1], image=frames[1].image[:100]))

    def fail(_t):
        raise hf.SimulationError("no rope", status="not finite", time=0.0)

    with monkeypatch.context() as patched:
        patched.setattr(tracker.estimator, "predict_to", fail)
        found = tracker.look(frames[1])
    assert found.state is not None
    assert np.isnan(found.predicted).all()
    assert tracker.look(frames[2]).state is not None


def test_places_of_bars_are_by_what_is_estimated(tmp_path):
    """The origin is declared 20 px = 5 cm to the left of the pivot."""
    _, detector = filmed(tmp_path / "pendulum.mp4", duration=1.0)
    camera, unsure = CAMERA.with_origin([138.0, 150.0]), [EstimatedParameter("offset_x", std=0.1)]
    tracker = RopeTracker(
        RopeFilter(PENDULUM, bar_arc_lengths(SPANS), camera=camera, parameters=unsure), BarMeasurement(detector)
    )
    with VideoReader(tmp_path / "pendulum.mp4") as video:
        for frame in video:
            found = tracker.look(frame)
    assert tracker.estimator.values["offset_x"][0] == pytest.approx(0.05, abs=3e-3)
    np.testing.assert_allclose(found.places, CAMERA.locate(found.pixels), atol=4e-3)


def withheld(tracker, path, every, skip=0):
    """Return differences (m, 2), px, of observed and predicted positions in frames withheld from the tracker."""
    errors = []
    with VideoReader(path) as video:
        for number, frame in enumerate(video):
            if number < skip:
                continue
            if number > skip + 20 and number % every == 0:
                expected, base = tracker.expect(frame.time), tracker.estimator.process.base(frame.time)[0]
                pixels, _ = tracker.measurement.measure(frame.image, tracker, base, expected, tracker.arc_lengths)
                whole = np.repeat(tracker.measurement.detector.find(frame.image).areas > 0.9, 2)
                errors.append((pixels - expected.pixels)[whole])
            else:
                tracker.look(frame)
    return np.concatenate(errors)


@pytest.mark.parametrize(("spans", "message"), [([[0.2, 0.1]], "ends before it begins")])
def test_bars_that_cannot_be_are_refused(spans, message):
    refuses(message, bar_arc_lengths, spans)


def test_a_filter_with_other_points_is_refused():
    with pytest.raises(hf.InvalidInput, match=r"other points than are measured.*4"):
        RopeTracker(RopeFilter(PENDULUM, [0.1, 0.2, 0.3], camera=CAMERA), BarMeasurement(BarDetector([DARK, BLUE])))


def test_the_real_pendulum(data_dir, tmp_path):
    """From the video to ratios, the time between frames, and predicted positions in withheld frames.

    Bars of 0.205 and 0.179 m are 112.7 and 98.4 px long: 550 px/m, and the joints are 85.7 px = 0.156 m apart. Angles
    alone tell lengths only over g times the square of the clock's rate, so that the first link's length is fitted and
    gives the clock. The source says 60 frames/s were filmed and stores 33 ms; 1.5 to 2 sixtieths were guessed.
    """
    path, pivot, joints = data_dir / "real_double_pendulum_video" / "pendulum.mp4", (167.2, 146.7), 0.1559
    with VideoReader(path) as video:
        frames = list(video)
    detector = BarDetector.from_clicks(frames[40].image, [(213, 140), (252, 180)])
    track = track_bars(path, detector, pivot)
    assert track.seen[0] == 1.0
    assert track.seen[1] > 0.93
    bars = [detector.find(frame.image) for frame in frames[5:]]
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
    spans = scale * np.array([[0.0815 - 0.1025, 0.0815 + 0.1025], [joints + 0.0239, joints + 0.1543]])
    camera = Camera.facing((316, 332), pixels_per_metre=550.0 / scale, origin=pivot)
    rope = found.rope.replace(length=[found.rope.length[0], 0.1545 * scale])
    unsure = [
        EstimatedParameter(f"arc[{k}]", std=0.01) for k in (2, 3)
    ]  # where the second bar comes out from the first
    tracker = RopeTracker(
        RopeFilter(rope, bar_arc_lengths(spans), camera=camera, parameters=unsure), BarMeasurement(detector)
    )
    errors = withheld(tracker, path, every=5, skip=5)
    assert len(errors) > 50
    assert np.sqrt((errors**2).sum(axis=-1).mean()) < 4.0
