"""MuJoCo's renderer as an independent eye: our camera, synthetic pictures and first frame against its pictures."""

import mujoco
import numpy as np
import pytest

from hyperflex.vision import Camera, Renderer, RopeLook, RopeMotion, Scene, find_rope
from hyperflex.vision.look import places_across
from tests.oracles.mujoco_eye import Eye, Look

SIZE, SCALE, ORIGIN = (480, 360), 260.0, (230.0, 40.0)  # px, px/m, px
LINKS, EXPOSURE = 40, 0.006
ACROSS = np.linspace(-15.0, 15.0, 61)


def turning(rate):
    """Return a bent rope of 1 m that turns about its pivot, rad/s."""
    q, t = 0.4 + 0.5 * np.sin(np.linspace(0.0, np.pi, LINKS)), np.array([-1.0, 1.0])
    return RopeMotion(t, q + rate * t[:, None], np.full((2, LINKS), rate), np.full(LINKS, 1.0 / LINKS))


@pytest.fixture(scope="module")
def eye():
    try:
        found = Eye(SIZE, 700.0, 700.0 / SCALE, np.array(ORIGIN), LINKS, Look(radius=0.006, shine=0.0, shadow=False))
    except (ImportError, AttributeError, RuntimeError, mujoco.FatalError) as error:
        pytest.skip(f"MuJoCo cannot render here: {error!r}")
    yield found
    found.close()


def seen_by(eye, rate):
    """Return the picture, and the true curve in the middle of the exposure, px."""
    motion, times = turning(rate), EXPOSURE * ((np.arange(12) + 0.5) / 12 - 0.5)
    camera = Camera.facing(SIZE, pixels_per_metre=SCALE, origin=ORIGIN, focal=700.0, exposure=EXPOSURE)
    curve = camera.project(motion.places([0.0], np.linspace(0.0, 1.0, 200))[0])
    ours = Renderer(camera, motion, Scene([], rope_width=0.012)).image(0.0)
    return eye.picture(motion.places(times, motion.joint_arc_lengths)[:, :, :2]), ours, curve


def profile(image, curve):
    """Return mean, standard deviation and sum of the mean profile across the outer half of a rope, px."""
    look, half = RopeLook.from_curve(image, curve, width=0.012 * SCALE), places_across(curve, ACROSS)[100:-10]
    off, contrast, precision = look.before_wall(image, half, np.abs(ACROSS) > 10.0, ACROSS)
    weights = contrast @ precision
    values = ((off * weights).sum(axis=2) / (contrast * weights).sum(axis=2)).mean(axis=0)
    mean = values @ ACROSS / values.sum()
    return np.array([mean, np.sqrt(values @ (ACROSS - mean) ** 2 / values.sum()), 0.5 * values.sum()])


def test_a_rope_is_where_the_camera_says(eye):
    """At rest, within 0.1 px: MuJoCo samples a pixel at 8 points."""
    image, _, curve = seen_by(eye, 0.0)
    assert abs(profile(image, curve)[0]) < 0.1


def test_blur_of_both_renderers_is_alike(eye):
    """A streak of 9 px at the end: its place within 0.15 px, its width and its sum within 10 %."""
    theirs, ours, curve = seen_by(eye, 6.0)
    one, other = profile(theirs, curve), profile(ours, curve)
    assert one[0] == pytest.approx(other[0], abs=0.15)
    assert one[1:] == pytest.approx(other[1:], rel=0.1)


def test_the_rope_is_found_in_its_picture(eye):
    """Within half a pixel, its end within two."""
    image, _, curve = seen_by(eye, 3.0)
    found = find_rope(image, curve[0] + [2.0, 1.0])
    near = np.linalg.norm(found.curve[:, None] - curve, axis=2).min(axis=0)
    assert np.sqrt(np.mean(near**2)) < 0.5
    assert np.linalg.norm(found.curve[-1] - curve[-1]) < 2.0
