"""From a rendered video of a finer rope to its markers, and to the rope (simulated throughout)."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.estimate import (
    MarkedCurveMeasurement,
    MarkerMeasurement,
    Observations,
    RopeFilter,
    RopeTracker,
    track_video,
)
from hyperflex.files import read_netcdf
from hyperflex.vision import Camera, MarkerColour, MarkerDetector, RopeLook, Truth, VideoReader
from tests.estimate.filmed import ARCS, facing, film_swing
from tests.estimate.runs import free_swing, rope
from tests.refusals import refuses

CAMERA, FRAMES = facing(exposure=0.005, readout=0.02), 62


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Truth]:
    """A free swing with clutter of the markers' colour, drifting light and a blackout of 0.2 s; frames are uneven."""
    path, uneven = tmp_path_factory.mktemp("video") / "swing.mp4", np.random.default_rng(1).uniform(0.0, 0.008, FRAMES)
    scene = {"clutter": 8, "light_drift": 0.1, "blackouts": ((1.2, 1.4),)}
    return path, film_swing(path, CAMERA, count=FRAMES, late=uneven, **scene)


def tracker(path: Path, truth: Truth, camera: Camera = CAMERA) -> RopeTracker:
    with VideoReader(path) as reader:
        colour = MarkerColour.from_click(next(iter(reader)).image, truth.pixels[0, 3])
    return RopeTracker(RopeFilter(rope(50), ARCS, camera=camera), MarkerMeasurement(MarkerDetector(colour)))


def test_ctrl_c_carries_what_was_tracked(video, tmp_path):
    def hit(count):
        if count == 12:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stopped:
        track_video(video[0], tracker(*video), preview=tmp_path / "seen.mp4", progress=hit)
    assert stopped.value.partial.frames == 12
    assert 2 <= len(stopped.value.partial.recording.t) <= 12
    assert stopped.value.partial.interrupted
    stopped.value.partial.to_netcdf(tmp_path / "part.nc")
    assert read_netcdf(tmp_path / "part.nc").attributes["interrupted"] == 1
    (tmp_path / "part.nc").unlink()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(Interrupted) as early:  # before there is anything to keep
        track_video(video[0], tracker(*video), progress=lambda count: hit(count + 11))
    assert early.value.partial is None


def test_markers_are_followed_through_clutter_and_a_blackout(video, tmp_path):
    """A pixel is 5 mm; its noise after compression some 0.25 px, so 2 mm in both coordinates."""
    path, truth = video
    found = track_video(path, tracker(path, truth), preview=tmp_path / "seen.mp4")
    recording = found.recording
    middle = truth.stamps + 0.5 * 0.02
    at = [int(np.abs(middle - t).argmin()) for t in recording.t]
    # the truth is of each marker's own row: where it is in the middle of the readout follows from its speed
    swing, ends = free_swing(0, 4.0), np.linspace(0.0, 2.0, 101)
    moments = np.round(recording.t * 600.0).astype(int)
    true = np.stack([np.stack([np.interp(ARCS, ends, swing.joints[i, :, c]) for c in (0, 1)], axis=1) for i in moments])
    true += (recording.t - swing.t[moments])[:, None, None] * np.gradient(true, recording.t, axis=0)
    visible = truth.visible[at]
    error = np.where(visible[:, :, None], recording.data.reshape(true.shape) - true, np.nan)
    scaled = error / recording.noise.reshape(true.shape)
    assert np.sqrt(np.nanmean((error[1:] ** 2).sum(axis=2))) < 2e-3  # in the first frame, speeds are not known yet
    assert np.nanmax(np.linalg.norm(error, axis=2)) < 0.015  # none swapped: they are 0.25 m apart
    assert np.sqrt(np.nanmean(scaled**2)) < 1.3
    assert np.isfinite(error[:, :, 0]).sum() > 0.95 * visible.sum()
    with VideoReader(tmp_path / "seen.mp4") as seen:
        assert sum(1 for _ in seen) == found.frames == FRAMES


def test_a_rope_that_begins_elsewhere_is_an_error_after_a_second_of_frames(video):
    """The motion of an arm may come later than the first frames: five of them were an error once."""
    wrong = tracker(*video, Camera.facing((640, 480), pixels_per_metre=200.0, origin=(620.0, 20.0)))
    with VideoReader(video[0]) as reader:
        frames = list(reader)
    frames += [replace(frame, time=frame.time + 2.1) for frame in frames]
    assert all(wrong.look(frame).state is None for frame in frames[:40])
    with pytest.raises(InvalidInput, match="does not begin at its first joint"):
        [wrong.look(frame) for frame in frames[40:]]


@pytest.mark.parametrize(("slower", "said"), [(1.0, ()), (4.0, ("time stamps", "offset_x"))])
def test_slow_motion_is_doubted(slower, said):
    """A clip of 120 frames/s whose stamps say 30: nothing else alarms, but the rope moves as if it were pushed."""
    cable = hf.Rope.uniform(length=1.0, mass=0.05, n_links=10, radius=0.002, friction=2e-4)
    run = hf.simulate(cable, duration=4.0 / slower, q0=np.full(10, 0.9), t_eval=np.arange(0.0, 4.0, 1 / 30) / slower)
    view = Camera.facing((640, 480), pixels_per_metre=200.0, origin=(320.0, 120.0))
    estimator, rng = RopeFilter(cable, np.linspace(0.2, 1.0, 5), camera=view), np.random.default_rng(0)
    image = np.full((99, 99, 3), 128, np.uint8)
    image[46:53, 46:53] = 0, 0, 200
    tracker = RopeTracker(estimator, MarkerMeasurement(MarkerDetector(MarkerColour.from_click(image, (49, 49)))))
    assert tracker.warning == ""
    for t, joints in zip(run.t, np.asarray(run.joints), strict=True):
        pixels = view.project(joints[2::2])
        estimator.update(Observations(float(t) * slower, pixels + 0.3 * rng.normal(size=pixels.shape), 0.3))
    assert bool(tracker.warning) == bool(said)
    assert all(words in tracker.warning for words in said)


def test_frames_and_states_that_cannot_be_are_met(video, monkeypatch):
    """A picture of another size is refused; if no rope can continue from the state, it is searched again."""
    follower = tracker(*video)
    with VideoReader(video[0]) as reader:
        first, second, third = itertools.islice(reader, 3)
    assert follower.look(first).state is not None
    refuses("another size than the camera's", follower.look, replace(second, image=second.image[:100]))

    def fail(_t):
        raise hf.SimulationError("no rope", status="not finite", time=0.0)

    with monkeypatch.context() as patched:
        patched.setattr(follower.estimator, "predict_to", fail)
        found = follower.look(second)
    assert found.state is not None
    assert np.isnan(found.predicted).all()
    assert follower.look(third).state is not None


def test_points_that_are_not_those_of_the_filter_are_refused():
    estimator, look = RopeFilter(rope(5), ARCS, camera=CAMERA), RopeLook(np.zeros(3), 4.0)
    measurement = MarkedCurveMeasurement(look, np.ones(3, bool), MarkerDetector(MarkerColour(np.array([0, 0, 200.0]))))
    refuses("other points than are measured.*3", RopeTracker, estimator, measurement)
