"""Learning of clutter: its density, and positions of static clutter."""

import numpy as np
import pytest

from hyperflex.vision import ClutterMap, Gate, assign_markers
from tests.vision.test_assignment import NOISE, each, observed

SIZE = (1000, 500)


def test_a_place_that_was_no_marker_is_known_again():
    clutter, blobs = ClutterMap(SIZE), observed([[100.0, 100.0], [300.0, 300.0]])
    empty = clutter.density(blobs)
    np.testing.assert_allclose(empty, 1.0 / 5e5)
    for _ in range(3):
        clutter.learn(blobs, np.array([True, False]))
    density = clutter.density(blobs)
    assert density[0] < 1e-5  # a marker's place is not remembered
    assert density[1] == pytest.approx(0.75 / (2.0 * np.pi * NOISE**2), rel=1e-3)  # n / (n + 1), n = 3
    assert clutter.density(observed([[304.0, 300.0]]))[0] < 1e-5  # it has moved
    assert clutter.still(blobs).tolist() == [False, True]
    for _ in range(4):  # it is looked for there, and no longer found
        clutter.learn(observed(np.zeros((0, 2))), np.zeros(0, bool), [Gate([302.0, 300.0], 4.0 * np.eye(2))])
    assert clutter.density(blobs)[1] == pytest.approx(0.375 / (2.0 * np.pi * NOISE**2), rel=1e-3)  # 3 / (3 + 4 + 1)


def test_what_passed_by_once_is_forgotten():
    """A marker that was not recognised must not be refused when it comes by again."""
    clutter, blobs = ClutterMap(SIZE), observed([[300.0, 300.0]])
    clutter.learn(blobs, np.zeros(1, bool))
    assert clutter.density(blobs)[0] > 0.1
    nothing = observed(np.zeros((0, 2)))
    for _ in range(3):
        clutter.learn(nothing, np.zeros(0, bool), [])
    assert clutter.density(blobs)[0] < 1e-5
    assert clutter.density(nothing).shape == (0,)


def test_moving_clutter_makes_a_density():
    clutter, rng = ClutterMap(SIZE), np.random.default_rng(0)
    for _ in range(300):
        clutter.learn(observed(rng.uniform(0.0, 500.0, (5, 2))), np.zeros(5, bool))
    elsewhere = clutter.density(observed([[900.0, 400.0]]))[0]
    assert elsewhere == pytest.approx((1.0 + 5.0) / 5e5, rel=0.2)


def test_where_a_prediction_is_wide_clutter_is_not_taken_for_a_marker():
    """A blackout: one marker is expected within 60 px. A blob there is it if blobs are rare, not if there are many."""
    mean, seen = np.array([[100.0, 100.0]]), observed([[150.0, 100.0]])
    assert assign_markers(seen, mean, each(60.0, 1)).indices.tolist() == [0]
    assert assign_markers(seen, mean, each(60.0, 1), clutter=1e-3).indices.tolist() == [-1]
    assert assign_markers(seen, mean, each(60.0, 1), clutter=[1e-3]).indices.tolist() == [-1]
    assert assign_markers(seen, np.array([[149.0, 100.0]]), each(2.0, 1), clutter=1e-3).indices.tolist() == [0]


def test_a_marker_before_known_clutter_is_still_seen():
    clutter, blobs = ClutterMap(SIZE), observed([[300.0, 300.0]])
    for _ in range(3):
        clutter.learn(blobs, np.zeros(1, bool))
    density = clutter.density(blobs)
    far, near = (assign_markers(blobs, blobs.places, each(std, 1), clutter=density).indices[0] for std in (20.0, 0.3))
    assert (far, near) == (-1, 0)
