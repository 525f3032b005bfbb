"""A rope without markers, followed by a filter with fewer links than the rope has."""

import numpy as np

from hyperflex.estimate import CurveMeasurement, MovingHorizon, Observations, RopeFilter, RopeTracker, curve_arc_lengths
from hyperflex.estimate.observations import UNMEASURED, InputFrame
from hyperflex.vision import Camera, Frame, Renderer, RopeLook, RopeMotion, Scene
from tests.estimate.runs import free_swing, rope

WIDTH, SCALE = 0.005, 200.0  # m, px/m
CAMERA = Camera.facing((640, 480), pixels_per_metre=SCALE, origin=(320.0, 30.0), exposure=0.01)
LOOK = RopeLook(np.array([45.0, 45.0, 45.0]), WIDTH * SCALE)


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


def followed(kind=RopeFilter, frames=12, **options):
    """A swing of 100 links, known to a pixel at first; returns errors of joints (T, n + 1), and the tracker."""
    cable, arcs = rope(24), curve_arc_lengths(rope(24), 20)
    motion = RopeMotion.from_trajectory(free_swing(3, 2.0))
    renderer = Renderer(CAMERA, motion, Scene([], rope_width=WIDTH, seed=3))
    tracker = RopeTracker(kind(cable, arcs, camera=CAMERA, **options), CurveMeasurement(LOOK))
    tracker.estimator.update(Observations(0.05, CAMERA.project(motion.places([0.05], arcs)[0]), std=1.0))
    off = []
    for k in range(frames):
        t = 0.05 + (k + 1) / 30.0
        tracked = tracker.look(Frame(t, renderer.image(t), k))
        true = motion.places([t], np.append(0.0, np.cumsum(cable.length)))[0, :, :2]
        off.append(np.linalg.norm(tracker.estimator.joints(tracked.state)[0] - true, axis=1))
    return np.array(off), tracker


def test_a_filter_follows_the_bare_rope():
    """A pixel is 5 mm: a tenth of it for the curve, and half of it for its end, in spite of longer links."""
    off, tracker = followed()
    assert np.sqrt(np.mean(off[6:] ** 2)) < 5e-4
    assert off[6:, -1].max() < 2.5e-3
    assert not tracker.warning
    assert 0.5 <= tracker.estimator.measurement_noise.value < 2.0


def test_a_moving_horizon_follows_it_too():
    off, tracker = followed(MovingHorizon, 8, starts=1)
    assert np.sqrt(np.mean(off[6:] ** 2)) < 5e-4
    assert len(tracker.estimator.smoothed) == 8
