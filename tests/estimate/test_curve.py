"""A rope without markers, followed by a filter with fewer links than the rope has."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from hyperflex.estimate import (
    CurveMeasurement,
    DoubtKind,
    EstimatedParameter,
    MovingHorizon,
    Observations,
    RopeFilter,
    RopeTracker,
    TrackingTask,
    curve_arc_lengths,
    marked_arc_lengths,
    measurements,
    track_video,
)
from hyperflex.estimate.observations import UNMEASURED, InputFrame
from hyperflex.vision import (
    Camera,
    CurveDetector,
    Frame,
    MarkerColour,
    Renderer,
    RopeLook,
    RopeMotion,
    Scene,
    VideoWriter,
    order_markers,
    view_curve,
)
from tests.estimate.runs import free_swing, rope

WIDTH, SCALE = 0.005, 200.0  # m, px/m
CAMERA = Camera.facing((640, 480), pixels_per_metre=SCALE, origin=(320.0, 30.0), exposure=0.01)
LOOK = RopeLook(np.array([45.0, 45.0, 45.0]), WIDTH * SCALE)
MARKERS, RED = np.array([0.5, 1.0, 1.5]), MarkerColour(np.array([40.0, 30.0, 210.0]), area=20.0)  # m


def test_a_direction_that_is_not_measured_has_no_effect():
    """The update equals that of the Kalman filter with one number, by its textbook form, to rounding."""
    rng = np.random.default_rng(2)
    way, slope, x = np.array([0.6, 0.8]), rng.normal(size=(1, 2, 3)), rng.normal(size=3)
    along = np.array([-0.8, 0.6])
    wide = 0.3**2 * (np.outer(way, way) + (2.0 * UNMEASURED) ** 2 * np.outer(along, along))
    place = slope[0] @ x + 0.1 * way + 5.0 * along
    frame = InputFrame(Observations(0.0, place[None], covariances=wide[None]), np.array([True]), 2.0)
    off, rows = frame.residuals((slope @ x), slope)
    assert off.shape == (1,)
    np.testing.assert_allclose(np.abs(off), 0.1 / 0.6, rtol=1e-6)
    np.testing.assert_allclose(rows.T @ rows, np.outer(way @ slope[0], way @ slope[0]) / 0.36, rtol=1e-6)
    np.testing.assert_allclose(frame.log_determinant, -np.log(0.6), rtol=1e-6)


def bare(kind=RopeFilter, **options):
    """A tracker of 24 links by the curve."""
    cable, arcs = rope(24), curve_arc_lengths(rope(24), 20)
    return RopeTracker(kind(cable, arcs, **{"camera": CAMERA} | options), CurveMeasurement(LOOK))


def followed(tracker, frames=12, **scene):
    """A swing of 100 links, known to a pixel at first; returns errors of joints (T, n + 1), and the tracker."""
    motion = RopeMotion.from_trajectory(free_swing(3, 2.0))
    renderer = Renderer(CAMERA, motion, Scene(**{"arc_lengths": [], "rope_width": WIDTH, "seed": 3} | scene))
    places = motion.places([0.05], tracker.arc_lengths)[0]
    tracker.estimator.update(Observations(0.05, CAMERA.project(places), std=1.0))
    off, joints = [], np.append(0.0, np.cumsum(tracker.estimator.process.rope.length))
    for k in range(frames):
        t = 0.05 + (k + 1) / 30.0
        tracked = tracker.look(Frame(t, renderer.image(t), k))
        true = motion.places([t], joints)[0, :, :2]
        off.append(np.linalg.norm(tracker.estimator.joints(tracked.state)[0] - true, axis=1))
    return np.array(off), tracker


def test_a_filter_follows_the_bare_rope():
    """A pixel is 5 mm: a tenth of it for the curve, and half of it for its end, in spite of longer links."""
    off, tracker = followed(bare())
    assert np.sqrt(np.mean(off[6:] ** 2)) < 5e-4
    assert off[6:, -1].max() < 2.5e-3
    assert not tracker.warning
    assert 0.5 <= tracker.estimator.measurement_noise.value < 2.0


def test_a_moving_horizon_follows_it_too():
    off, tracker = followed(bare(MovingHorizon, starts=1), 8)
    assert np.sqrt(np.mean(off[6:] ** 2)) < 5e-4
    assert len(tracker.estimator.smoothed) == 8


def test_three_markers_and_the_curve_together_are_better_than_each():
    """The scale is 1 % off: the curve shows the shape, but only its end the scale, which the markers show."""
    lens, doubt, off = CAMERA.adjusted(1.01, 0.0, (0.0, 0.0)), [EstimatedParameter("scale", 0.02)], []
    for colours, look in (([RED], None), ((), LOOK), ([RED], LOOK)):
        arcs = MARKERS if colours else curve_arc_lengths(rope(24))
        tracker = TrackingTask(rope(24), arcs, lens, colours, look=look, parameters=doubt).tracker()
        off.append(followed(tracker, 8, arc_lengths=MARKERS)[0][4:])
    markers, curve, both = (np.sqrt(np.mean(each**2)) for each in off)
    assert both < 0.7 * min(markers, curve)


def test_scale_roll_and_readout_are_estimated_together_with_the_arc_length_of_the_free_end():
    """It is seen half of the thickness, 2.5 mm, too far. Without its arc length the curve is off by 14 mm."""
    doubts = {"scale": 0.02, "roll": 0.03, "readout": 0.01, "arc[43]": 0.5 * WIDTH}
    doubted = [EstimatedParameter(name, std) for name, std in doubts.items()]
    lens = CAMERA.adjusted(1.01, 0.0, (0.0, 0.0))
    tracker = TrackingTask(rope(50), MARKERS, lens, [RED], look=LOOK, parameters=doubted).tracker()
    off, _ = followed(tracker, 13, arc_lengths=MARKERS)
    assert np.sqrt(np.mean(off[9:] ** 2)) < 4e-3


def test_a_marker_at_the_free_end_is_measured_in_place_of_it():
    arcs = np.append(MARKERS, 2.0)
    tracker = TrackingTask(rope(24), arcs, CAMERA, [RED], look=LOOK).tracker()
    off, _ = followed(tracker, 4, arc_lengths=arcs)
    assert off[-1, -1] < 0.01
    assert tracker.estimator.used[-1]
    assert not tracker.estimator.used[-2]
    assert tracker.measurement.end_seen == 1.0


class Watched(CurveDetector):
    """Keeps where the rope was expected."""

    def find(self, image, look, view):
        self.view = view
        return super().find(image, look, view)


@pytest.mark.parametrize("colours", [[], [RED]], ids=["bare", "marked"])
def test_the_arc_length_of_the_free_end_moves_it_alone(colours):
    """By 2.5 mm at 200 px/m, and by -20 mm, when the last lines across the rope are beyond it."""
    arcs, end = (MARKERS, 43) if colours else (curve_arc_lengths(rope(24)), 40)
    doubt = [EstimatedParameter(f"arc[{end}]", 0.01)]
    tracker = TrackingTask(rope(24), arcs, CAMERA, colours, look=LOOK, parameters=doubt).tracker()
    tracker.measurement.detector = watched = Watched()
    motion, image = RopeMotion.from_trajectory(free_swing(3, 2.0)), np.full((480, 640, 3), 200, np.uint8)
    places = CAMERA.project(motion.places([0.05], tracker.arc_lengths)[0])
    tracker.estimator.update(Observations(0.05, places, std=1.0))
    views = []
    for value in (0.0, 2.5e-3, -0.02):
        tracker.estimator.x[-1] = value
        base = tracker.estimator.process.base(0.05)[0]
        tracker.measurement.measure(image, tracker, base, tracker.expect(0.05), tracker.arc_lengths)
        views.append(watched.view)
    for view, moved in zip(views, (0.0, 0.5, -4.0), strict=True):
        np.testing.assert_array_equal(view.points, views[0].points)
        np.testing.assert_allclose(view.end, views[0].end + moved * view.end_tangent, atol=0.01)  # px, the last bend
    last = views[0].points[-1, -1]  # half a line's distance from the end, of 280 on 2 m
    assert np.linalg.norm(views[0].end - last) == pytest.approx(SCALE * 1.0 / 280.0, rel=1e-3)


def test_an_estimated_readout_delays_lines_as_a_known_one():
    views = []
    for known, doubts in ((0.01, []), (0.0, [EstimatedParameter("readout", 0.01)])):
        tracker = bare(camera=replace(CAMERA, readout=known), parameters=doubts)
        tracker.measurement.detector = watched = Watched()
        tracker.estimator.update(
            Observations(0.05, CAMERA.project(np.linspace([0.0, -0.05], [0.5, -1.9], 21)), std=1.0)
        )
        tracker.estimator.x[24:48], tracker.estimator.x[48:] = 3.0, 0.01
        tracker.measurement.measure(
            np.full((480, 640, 3), 200, np.uint8), tracker, np.zeros(2), tracker.expect(0.05), ()
        )
        views.append(watched.view)
    assert np.abs(np.diff(views[0].sweeps[:, 0])).max() > 0.1  # it moves
    np.testing.assert_allclose(views[1].points, views[0].points, atol=1e-9)
    np.testing.assert_allclose(views[1].sweeps, views[0].sweeps, atol=1e-9)


def test_what_is_not_known_of_the_readout_is_no_error_of_detection():
    """A model that estimates the readout has it. With it, pieces would count as measured along the rope, too."""
    tracker = bare(parameters=[EstimatedParameter("readout", 0.03)])
    motion, t = RopeMotion.from_trajectory(free_swing(3, 2.0)), 0.6
    renderer, measure, found = Renderer(CAMERA, motion, Scene([], rope_width=WIDTH)), tracker.measurement.measure, []
    tracker.measurement.measure = lambda *given: found.append(measure(*given)) or found[-1]
    tracker.estimator.update(Observations(t, CAMERA.project(motion.places([t], tracker.arc_lengths)[0]), std=1.0))
    for k in range(3):
        tracked = tracker.look(Frame(t + (k + 1) / 60.0, renderer.image(t + (k + 1) / 60.0), k))
        np.testing.assert_array_equal(tracked.covariances, found[k][1])
    assert np.linalg.eigvalsh(tracked.movements)[:, 1].max() > 0.04  # px^2


def test_doubt_of_the_free_end_does_not_blur_the_order_of_the_markers(monkeypatch):
    noises = []

    def ordered(*given, noise, slack):
        noises.append(noise)
        return order_markers(*given, noise=noise, slack=slack)

    monkeypatch.setattr(measurements, "order_markers", ordered)
    motion = RopeMotion.from_trajectory(free_swing(3, 2.0))
    image = Renderer(CAMERA, motion, Scene(arc_lengths=MARKERS, rope_width=WIDTH, seed=3)).image(0.05)
    marked = np.flatnonzero(marked_arc_lengths(rope(24), MARKERS)[1])
    for k in (43, marked[0]):
        doubt = [EstimatedParameter(f"arc[{k}]", 0.01)]
        TrackingTask(rope(24), MARKERS, CAMERA, [RED], look=LOOK, parameters=doubt).tracker().look(
            Frame(0.05, image, 0)
        )
    assert noises[0] < 2e-3  # of blobs alone
    assert noises[1] == pytest.approx(noises[0] + 0.01)  # m


def test_a_shadow_that_is_less_dark_is_not_taken_for_the_rope():
    """It lies nearer to where the rope is expected, by half a standard deviation."""
    image = np.full((200, 200, 3), 180.0)
    image[:, [100, 120]] = [[45.0], [130.0]]
    image = cv2.GaussianBlur(image, (0, 0), 0.6) + np.random.default_rng(1).normal(0.0, 2.0, image.shape)
    v = np.append(np.arange(20.0, 160.0), 180.0)
    moving = np.tile(np.stack([np.full(141, 112.0), v], axis=1), (3, 1, 1))
    view = view_curve(moving, 20, 8.0**2 * np.ones((42, 42)) + np.eye(42), 4.0, 50)
    found = CurveDetector().find(image.astype(np.uint8), LOOK, view)
    np.testing.assert_allclose(view.points[:, 3, 0] + found.offsets * view.normals[:, 3, 0], 100.0, atol=0.2)


@pytest.mark.parametrize("hidden", [0.03, pytest.param(0.09, marks=pytest.mark.nightly)])
def test_where_a_hidden_rope_seems_to_end_is_not_its_end(hidden, tmp_path):
    """The wall is painted over the end of the rope, in all frames: the tip is as stated, and doubted."""
    tracker, motion = bare(), RopeMotion.from_trajectory(free_swing(3, 2.0))
    seen, bare_wall = (Renderer(CAMERA, motion, Scene([], rope_width=each, seed=3)) for each in (WIDTH, 0.0))
    wall = bare_wall.image(0.05)
    arcs, exposure = np.linspace(2.0 * (1.0 - hidden), 2.0, 20), np.linspace(-0.006, 0.006, 9)
    with VideoWriter(tmp_path / "rope.mp4", CAMERA.image_size, 15) as video:
        for t in 0.05 + np.arange(7) / 30.0:
            paint = np.zeros((480, 640, 1), np.uint8)
            for places in motion.places(t + exposure, arcs):
                cv2.polylines(paint, [np.round(CAMERA.project(places)).astype(np.int32)], False, 1, 7)
            video.write(np.where(paint > 0, wall, seen.image(t)), t)
    track = track_video(tmp_path / "rope.mp4", tracker)
    state = tracker.estimator.state
    places, slopes = tracker.estimator.joints(state)
    off = places[-1] - motion.places([state.t], [2.0])[0, 0, :2]
    wide = slopes[-1] @ state.covariance[:24, :24] @ slopes[-1].T
    assert off @ np.linalg.solve(wide, off) < 12.0
    assert np.linalg.norm(off) < 0.02
    assert DoubtKind.END in [each.kind for each in track.doubts]
