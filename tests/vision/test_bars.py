"""Bars: a rendered double pendulum against its truth, and the real one's video."""

import numpy as np
import pytest

from hyperflex.vision import Bar, BarDetector, Camera, Renderer, RopeMotion, Scene
from tests.refusals import refuses

DARK, BLUE = (75.0, 60.0, 63.0), (223.0, 84.0, 30.0)
LENGTHS = np.array([0.205, 0.179])


def pendulum(**more):
    t = np.arange(0.0, 4.0, 0.005)
    q = np.stack([2.0 * np.sin(4.0 * t), 3.0 * np.sin(5.3 * t + 1.0)], axis=1)
    qd = np.stack([8.0 * np.cos(4.0 * t), 15.9 * np.cos(5.3 * t + 1.0)], axis=1)
    bars = Bar(0.205, 0.384, 0.038, BLUE), Bar(0.0, 0.205, 0.038, DARK)
    scene = Scene([], bars=bars, rope_width=0.0, background=(124.0, 144.0, 164.0), **more)
    camera = Camera.facing((316, 332), pixels_per_metre=430.0, origin=(158.0, 150.0), exposure=0.01)
    return Renderer(camera, RopeMotion(t, q, qd, LENGTHS), scene)


def test_a_hidden_bar_is_nan():
    renderer = pendulum()
    image = renderer.image(0.6)
    detector = BarDetector([DARK, BLUE], [4000.0, 3500.0])
    wall = np.tile(np.uint8([124, 144, 164]), (332, 316, 1))
    assert np.isnan(detector.find(wall).centres).all()
    image[(image[..., 0] > 150) & (image[..., 2] < 100)] = (75, 60, 63)
    seen = detector.find(image)
    assert np.isfinite(seen.centres[0]).all()
    assert np.isnan(seen.centres[1]).all()
    assert np.isnan(seen.covariances[1]).all()


@pytest.mark.parametrize(
    ("colours", "message"),
    [([DARK] * 4, "1 to 3"), ([BLUE, np.array(BLUE) * 0.99], "alike"), ([(124.0, 144.0, 164.0)], "alike, or like")],
)
def test_colours_that_cannot_be_told_are_refused(colours, message):
    wall = np.tile(np.uint8([124, 144, 164]), (332, 316, 1))
    refuses(message, BarDetector(colours).find, wall)
