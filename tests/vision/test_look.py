"""The appearance of a plain rope: its colour and width from a curve, the adjacent wall, changing light."""

import numpy as np
import pytest

from hyperflex.vision import Camera, Renderer, RopeLook, Scene
from hyperflex.vision.look import places_across
from tests.refusals import refuses
from tests.vision.ropes import swinging

ARCS = np.linspace(0.0, 2.0, 200)
CAMERA = Camera.facing((640, 360), pixels_per_metre=150.0, origin=(320.0, 30.0))
LOOKS = {
    "dark on bright": {"rope_colour": (50.0, 45.0, 40.0), "background": (200.0, 205.0, 210.0)},
    "bright on dark": {"rope_colour": (220.0, 225.0, 230.0), "background": (40.0, 42.0, 45.0)},
    "coloured on textured": {
        "rope_colour": (40.0, 60.0, 200.0),
        "background": (120.0, 130.0, 120.0),
        "wall_texture": 12,
    },
}


def filmed(times=(0.5,), **scene):
    """Return pictures of a rope 24 mm, 3.6 px, wide, and its curve in the first."""
    motion = swinging(speed=2.0)
    renderer = Renderer(CAMERA, motion, Scene([], rope_width=0.024, **scene))
    return [renderer.image(t) for t in times], CAMERA.project(motion.places(times[:1], ARCS)[0])


@pytest.mark.parametrize("name", LOOKS)
def test_colour_and_width_are_found(name):
    """Width within 15 %, 0.5 px; the light is at most 14 % less away from the picture's left top corner."""
    images, curve = filmed(**LOOKS[name])
    look = RopeLook.from_curve(images[0], curve)
    assert look.width == pytest.approx(3.6, rel=0.15)
    assert look.bgr == pytest.approx(LOOKS[name]["rope_colour"], abs=15.0)


@pytest.mark.parametrize("name", LOOKS)
def test_a_rope_differs_from_the_wall_by_its_contrast_and_the_wall_by_noise(name):
    """In the middle of the rope within a tenth; the wall's differences have the stated covariance."""
    images, curve = filmed(**LOOKS[name])
    look = RopeLook.from_curve(images[0], curve)
    across = np.linspace(-15.0, 15.0, 61)
    outside = np.abs(across) > 6.0
    off, contrast, precision = look.before_wall(images[0], places_across(curve, across), outside, across)
    size = np.einsum("kmi,kij,kmj->km", contrast, precision, contrast)
    share = np.einsum("kmi,kij,kmj->km", off, precision, contrast) / size
    assert np.median(share[:, 30]) == pytest.approx(1.0, abs=0.1)
    assert np.median(share[:, outside]) == pytest.approx(0.0, abs=0.05)
    assert 0.5 < (share * np.sqrt(size))[:, outside].std() < 1.2  # noise is averaged where it is interpolated


def test_a_look_follows_the_light():
    """After a step of the exposure by 0.7 the colour is 0.7 times as bright."""
    steps = {**LOOKS["dark on bright"], "exposure_steps": ((1.0, 0.7),)}
    images, curve = filmed([0.5, 0.1, 0.3, 0.9, 1.2], **steps)
    look = RopeLook.from_curve(images[0], curve)
    later = look.in_light_of(images[4])
    assert later.bgr / look.bgr == pytest.approx(0.7, abs=0.01)
    assert look.in_light_of(images[1]).bgr == pytest.approx(look.bgr, rel=0.01)


def test_a_look_follows_light_that_rises_slowly():
    """By half in 200 frames: less than a level from one to the next."""
    wall = np.random.default_rng(0).integers(60, 150, (160, 160, 3), np.uint8)  # which change in different pictures
    look = first = RopeLook([50.0, 45.0, 40.0], 3.6).in_light_of(wall)
    for gain in np.linspace(1.0, 1.5, 200):
        look = look.in_light_of(np.rint(wall * gain).astype(np.uint8))
    assert look.bgr == pytest.approx(1.5 * first.bgr, rel=0.01)


@pytest.mark.parametrize("name", LOOKS)
def test_a_curve_without_a_rope_has_no_look(name):
    images, curve = filmed(**LOOKS[name])
    refuses("stand out", RopeLook.from_curve, images[0], curve + np.array([60.0, 0.0]))


def test_a_calibrated_width_is_kept():
    images, curve = filmed(**LOOKS["dark on bright"])
    assert RopeLook.from_curve(images[0], curve, width=3.6).width == 3.6


def test_a_point_is_no_curve():
    """As is left of a faint rope that ends where it begins."""
    refuses("no line", RopeLook.from_curve, np.full((40, 40, 3), 128, np.uint8), [[20.0, 20.0]])
