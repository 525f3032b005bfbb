"""Hard looks of the synthetic camera: shadow, shine, textures, blackouts and steps of the exposure."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.looks import HardRenderer, HardScene

from hyperflex.vision import RopeMotion
from tests.vision.ropes import camera, sliding

WALL = (175.0, 185.0, 190.0)
PLAIN = HardScene([], rope_width=0.04, rope_colour=(60.0, 60.0, 60.0), noise=0.0, background=WALL)  # 12 px wide


def test_a_rope_casts_a_shadow_beside_it():
    """A straight rope at 640 px; its shadow 0.1 m to the right takes 30 % of the light there, and nowhere else."""
    plain, shaded = (
        HardRenderer(camera(), sliding((0.0, 0.0)), scene).image(0.0)[200, :, 1].astype(float)
        for scene in (PLAIN, replace(PLAIN, shadow=(0.1, 0.0, 0.3)))
    )
    assert shaded[670] / plain[670] == pytest.approx(0.7, abs=0.01)
    assert np.flatnonzero(shaded != plain).tolist() == list(range(664, 677))


def test_a_wire_shines_on_the_side_of_the_light():
    """A highlight of 4.8 px to the left of the middle; of a rope that points to the light, none."""
    down = HardRenderer(camera(), sliding((0.0, 0.0)), replace(PLAIN, shine=150.0)).image(0.0)[200, 635:646, 1]
    assert 636 <= 635 + int(np.argmax(down)) <= 639
    assert down.max() == pytest.approx(60.0 + 0.36 * 150.0, abs=3.0)
    to_light = np.full((2, 2), np.arctan2(-0.6, -0.8))
    rest = RopeMotion([-1.0, 1.0], to_light, np.zeros((2, 2)), [0.5, 0.5], np.zeros((2, 2)), np.zeros((2, 2)))
    images = [HardRenderer(camera(), rest, scene).image(0.0) for scene in (PLAIN, replace(PLAIN, shine=150.0))]
    assert np.abs(np.diff(np.int16(images), axis=0)).max() <= 2


def test_textures_are_as_strong_as_declared_and_stay():
    scene = replace(PLAIN, rope_texture=0.2, wall_texture=10.0)
    renderer = HardRenderer(camera(), sliding((0.0, 0.0)), scene)
    first, later = renderer.image(0.0), renderer.image(0.5)
    assert np.array_equal(first, later)
    assert first[:, 700:].astype(float).std(axis=(0, 1)).mean() == pytest.approx(10.0, rel=0.3)
    along = first[66:358:24, 640, 1].astype(float)  # a piece is 24 px long
    assert along.std() / along.mean() == pytest.approx(0.2, rel=0.4)  # 12 pieces


def test_without_a_rope_the_wall_is_seen():
    wall = replace(PLAIN, rope_width=0.0)
    textured = replace(wall, rope_texture=0.2, shine=150.0, shadow=(0.1, 0.0, 0.3))
    images = [HardRenderer(camera(), sliding((0.0, 0.0)), scene).image(0.0) for scene in (wall, textured)]
    assert np.array_equal(*images)


def test_an_automatic_exposure_steps():
    scene = replace(PLAIN, exposure_steps=((0.5, 0.7), (1.0, 1.2)))
    renderer = HardRenderer(camera(), sliding((0.0, 0.0)), scene)
    levels = [renderer.image(t)[600, 1000].astype(float).mean() for t in (0.0, 0.6, 1.5)]
    assert np.array(levels[1:]) / levels[0] == pytest.approx([0.7, 1.2], abs=0.01)


def test_nothing_of_the_rope_is_seen_in_a_blackout():
    scene = HardScene([0.2, 0.9], noise=0.0, blackouts=((0.5, 0.6),))
    renderer = HardRenderer(camera(), sliding((0.0, 0.0)), scene)
    assert renderer.truth([0.0, 0.55]).visible.tolist() == [[True, True], [False, False]]
    wall = scene.wall((1280, 720))[330, 640]
    seen, black = (renderer.image(t)[330, 640].astype(float) - wall for t in (0.0, 0.55))
    assert np.abs(black).max() <= 1.0 < np.abs(seen).max()
