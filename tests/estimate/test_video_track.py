"""A whole video: estimates are in the output, markers that were never seen are reported, and threads."""

import struct
import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from hyperflex.errors import InvalidInput
from hyperflex.estimate import EstimatedParameter, MarkerMeasurement, RopeFilter, RopeTracker, VideoTrack, track_video
from hyperflex.files import read_netcdf
from hyperflex.vision import Camera, MarkerColour, MarkerDetector, VideoReader, VideoWriter
from tests.estimate.filmed import ARCS, facing, film_swing
from tests.estimate.runs import free_swing, rope
from tests.vision.test_video import UPRIGHT


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of a free swing."""
    path = tmp_path_factory.mktemp("video") / "swing.mp4"
    film_swing(path)
    return path


def follower(
    path: Path, camera: Camera, parameters: Sequence[EstimatedParameter] = (), arcs: np.ndarray = ARCS
) -> RopeTracker:
    with VideoReader(path) as reader:
        first = next(iter(reader)).image
    estimator = RopeFilter(rope(20), arcs, camera=camera, parameters=parameters)
    return RopeTracker(estimator, MarkerMeasurement(MarkerDetector(MarkerColour.from_frame(first))))


def tracked(
    path: Path, camera: Camera, parameters: Sequence[EstimatedParameter] = (), arcs: np.ndarray = ARCS
) -> VideoTrack:
    return track_video(path, follower(path, camera, parameters, arcs))


def errors(found: VideoTrack, arcs: np.ndarray = ARCS) -> np.ndarray:
    """Return by how much the places (T, K) of the swing are off, m."""
    run, ends = free_swing(0, 4.0), np.linspace(0.0, 2.0, 101)
    joints = np.stack([[np.interp(found.recording.t, run.t, run.joints[:, i, c]) for c in (0, 1)] for i in range(101)])
    true = np.stack([[np.interp(arcs, ends, joints[:, c, k]) for c in (0, 1)] for k in range(len(found.recording.t))])
    return np.linalg.norm(found.recording.data.reshape(len(true), -1, 2) - true.transpose(0, 2, 1), axis=2)


@pytest.mark.parametrize(
    ("camera", "name", "prior", "truth", "bound"),
    [
        (facing(scale=202.0), "scale", 0.02, -0.0099, 4e-3),
        (facing(scale=212.0), "scale", 0.1, -0.0566, 4e-3),
        (facing(scale=188.0), "scale", 0.1, 0.0638, 4e-3),
        (facing(roll=0.03), "roll", 0.05, -0.03, 1e-2),
        (facing().with_origin([316.0, 20.0]), "offset_x", 0.05, 0.02, 4e-3),
    ],
    ids=["scale", "scale too great", "scale too small", "roll", "offset"],
)
def test_what_is_estimated_of_the_plane_is_in_all_places(swing, tmp_path, camera, name, prior, truth, bound):
    """A pixel is 5 mm; from the first frame on places are as good as with the right camera, and the file says so.

    Without the estimate they are 20 mm off with the least of these errors, 120 mm with the greatest.
    """
    found = tracked(swing, camera, [EstimatedParameter(name, prior)])
    assert found.seen == 1.0
    assert found.parameters[name][0] == pytest.approx(truth, abs=5e-3)
    assert np.nanmax(errors(found)) < bound
    assert any(f"applied to the places of all frames: {name}" in note for note in found.notes)
    found.to_netcdf(tmp_path / "markers.nc")
    kept = read_netcdf(tmp_path / "markers.nc").attributes
    np.testing.assert_array_equal(kept[f"estimated_{name}"], found.parameters[name])
    assert f"{name} {found.parameters[name][0]:.5g}" in kept["convention"]
    np.testing.assert_array_equal(kept["arc_lengths"], ARCS)


def test_a_marker_that_is_seldom_seen_is_named(swing, tmp_path):
    tips = facing().project(tracked(swing, facing()).recording.data[:, -2:])
    with VideoReader(swing) as reader, VideoWriter(tmp_path / "hidden.mp4", reader.image_size) as writer:
        for k, frame in enumerate(reader):
            (u, v), image = tips[k].astype(int), frame.image.copy()
            if k >= 9:
                image[v - 15 : v + 15, u - 15 : u + 15] = image[0, 0]
            writer.write(image, frame.time)
    found = tracked(tmp_path / "hidden.mp4", facing())
    np.testing.assert_array_equal(found.seen_each, [1.0] * 7 + [0.3])
    assert "the marker at 2 m was seen in only 30 % of the frames: check its arc length and colour" in found.notes


def test_linear_algebra_keeps_to_one_thread_and_gives_the_others_back(tmp_path):
    """Threads wait for each other at small matrices: two of them on two busy cores take ten times as long as one."""

    def threads():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    with VideoWriter(tmp_path / "dark.mp4", (320, 240)) as writer:
        for time in (0.0, 0.1, 0.2):
            writer.write(np.zeros((240, 320, 3), np.uint8), time)
    camera = Camera.facing((320, 240), pixels_per_metre=100.0, origin=(160.0, 10.0))
    colour, inside = MarkerColour(np.array([40.0, 30.0, 210.0])), []
    tracker = RopeTracker(RopeFilter(rope(5), [1.0, 2.0], camera=camera), MarkerMeasurement(MarkerDetector(colour)))
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        with pytest.raises(InvalidInput, match="not found in the video"):
            track_video(tmp_path / "dark.mp4", tracker, progress=lambda _: inside.append(threads()))
        assert threads() == before
    assert inside == [{1}] * 3


def test_times_are_earlier_by_the_delay_that_is_found(swing):
    """A swing from a fixed point does not determine it: the declared value is kept, applied, and reported as
    undetermined."""
    plain, late = tracked(swing, facing()), tracked(swing, facing(), [EstimatedParameter("delay", 0.01, value=0.02)])
    np.testing.assert_allclose(late.recording.t, plain.recording.t - 0.02, atol=1e-9)
    assert late.found_at == pytest.approx(plain.found_at - 0.02)
    assert "does not determine delay" in " ".join(late.notes)


def test_lengths_are_reported_for_the_rope_and_do_not_change_positions(swing):
    """The rope is 2 % longer than declared, and its third marker 2 cm further up."""
    arcs = ARCS / 1.02
    arcs[2] += 0.02
    found = tracked(swing, facing(), [EstimatedParameter("length", 0.02), EstimatedParameter("arc[2]", 0.02)], arcs)
    np.testing.assert_allclose(found.arc_lengths, ARCS, atol=4e-3)
    assert np.nanmax(errors(found)) < 4e-3
    said = next(note for note in found.notes if "of the rope" in note)
    assert "times 1.02" in said
    assert f"arc_lengths {found.arc_lengths[0]:.5g},{found.arc_lengths[1]:.5g}" in said


@pytest.mark.parametrize("timing", [pytest.param({"exposure": 30.0}, marks=pytest.mark.nightly), {"readout": 0.04}])
def test_times_longer_than_the_frame_interval_are_refused(swing, timing):
    name = next(iter(timing))
    with pytest.raises(InvalidInput, match=f"{name} is longer than the time from frame to frame.*at most 0.033"):
        tracked(swing, replace(facing(), **timing))
    tracked(swing, replace(facing(), **{name: 0.0334}))


def test_rows_that_contradict_a_turned_file_are_noted(swing, tmp_path):
    """A phone held upside down: the file says so, and its rows follow each other upwards."""
    path = tmp_path / "turned.mp4"
    with VideoReader(swing) as upright, VideoWriter(path, (640, 480)) as video:
        for frame in upright:
            video.write(np.ascontiguousarray(frame.image[::-1, ::-1]), frame.time)
    content = path.read_bytes()
    at = content.index(UPRIGHT, content.index(b"tkhd"))
    turned = struct.pack(">9i", -65536, 0, 0, 0, -65536, 0, 0, 0, 1 << 30)
    path.write_bytes(content[:at] + turned + content[at + len(turned) :])
    assert tracked(path, replace(facing(), readout=0.01, readout_direction="up")).notes == ()
    notes = tracked(path, replace(facing(), readout=0.01)).notes
    assert "follow each other up; the camera's readout_direction says down" in notes[0]


def test_the_rope_is_drawn_as_it_is_estimated(swing):
    """Its joints end at the tip's marker, by what was found of the scale; 20 px off without that."""
    tracker = follower(swing, facing(scale=188.0), [EstimatedParameter("scale", 0.1)])
    with VideoReader(swing) as reader:
        for frame in reader:
            result = tracker.look(frame)
    assert np.linalg.norm(tracker.shape(result.state)[0][-1] - result.pixels[-1]) < 1.0


def test_frames_are_let_go(swing, monkeypatch):
    """With 50 links, the covariance of a frame's state has 80 kB: not one of them is kept for the recording."""
    tracker, results = follower(swing, facing()), []
    look = tracker.look

    def noted(frame):
        result = look(frame)
        results.append(weakref.ref(result))
        return result

    alive: list[int] = []
    monkeypatch.setattr(tracker, "look", noted)
    track_video(swing, tracker, progress=lambda _: alive.append(sum(each() is not None for each in results)))
    assert max(alive) <= 2
