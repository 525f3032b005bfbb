"""The synthetic camera: drawn positions against its truth, blur and readout against brute force."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.vision import Camera, Occluder, Renderer, RopeMotion, Scene, VideoReader, frame_times, random_occlusion
from tests.refusals import refuses
from tests.vision.ropes import ARCS, camera, sliding, swinging

WALL = (175.0, 185.0, 190.0)
ONE = Scene([0.4], rope_width=0.0, noise=0.0, background=WALL, marker_diameter=0.04)


def centroid(image, scene=ONE):
    """Return the mean place of what differs from the scene's wall, by how much it differs."""
    off = np.abs(image.astype(float) - scene.wall(image.shape[1::-1])).sum(axis=2)
    off[off < 6.0] = 0.0  # rounding to whole levels
    v, u = np.indices(off.shape)
    return np.array([(off * u).sum(), (off * v).sum()]) / off.sum()


@pytest.mark.parametrize("shift", [0.0, 0.13, 0.37, 0.5, 0.81])
def test_a_marker_at_rest_is_where_the_truth_says(shift):
    """Within 0.02 px: levels are whole numbers."""
    start = (shift / 300.0, -0.6 * shift / 300.0)
    renderer = Renderer(camera(), sliding((0.0, 0.0), start), ONE)
    truth = renderer.truth([0.0])
    assert np.abs(centroid(renderer.image(0.0)) - truth.pixels[0, 0]).max() < 0.02
    assert np.abs(truth.pixels[0, 0] - camera().project([[start[0], start[1] - 0.4]])[0]).max() < 1e-9


@pytest.mark.parametrize("direction", ["down", "up", "right", "left"])
@pytest.mark.parametrize("readout", [0.0, 0.03])
@pytest.mark.parametrize("velocity", [(3.0, 2.0), (-2.0, 4.0)])
def test_a_streak_lies_about_the_place_of_the_truth(direction, readout, velocity):
    """The middle within 0.1 px of 12 px or more of blur, for each way of reading rows out."""
    seen = camera(exposure=0.012, readout=readout, readout_direction=direction, delay=0.004)
    renderer = Renderer(seen, sliding(velocity, (0.0, -0.7)), ONE)
    truth = renderer.truth([0.0])
    pixels = truth.pixels[0]
    assert np.abs(centroid(renderer.image(0.0)) - pixels[0]).max() < 0.1
    assert truth.times[0, 0] == pytest.approx(seen.exposure_times(0.0, pixels)[0], abs=1e-9)
    assert np.linalg.norm(truth.streaks[0, 0]) > 12.0
    place = np.array([0.0, -1.1]) + truth.times[0, 0] * np.array(velocity)
    assert np.abs(truth.places[0, 0, :2] - place).max() < 1e-9


def test_blur_is_the_mean_of_sharp_pictures():
    """Levels are whole numbers in each of them: 1 level."""
    scene = Scene(ARCS, noise=0.0)
    blurred = Renderer(camera(exposure=0.01), swinging(), scene, sub_exposures=8).image(0.7)
    sharp = Renderer(camera(), swinging(), scene)
    instants = 0.7 + 0.01 * ((np.arange(8) + 0.5) / 8 - 0.5)
    mean = np.mean([sharp.image(t).astype(float) for t in instants], axis=0)
    assert np.abs(blurred - mean).max() <= 3.0  # places are interpolated linearly over 1 ms
    assert np.abs(blurred - mean).mean() < 0.05


def test_rows_are_read_one_after_the_other():
    scene = Scene(ARCS, noise=0.0)
    rolled = Renderer(camera(readout=0.03), swinging(), scene).image(0.7)
    still = Renderer(camera(), swinging(), scene)
    for row in range(70, 700, 90):
        alone = still.image(0.7 + 0.03 * row / 719)
        assert np.abs(rolled[row].astype(float) - alone[row]).max() <= 3.0
    assert np.abs(rolled.astype(float) - still.image(0.7)).max() > 50.0


def test_light_drifts_and_noise_is_as_declared():
    scene = Scene([0.4], noise=3.0, light_drift=0.4, drift_period=2.0)
    renderer = Renderer(camera(), sliding((0.0, 0.0)), scene)
    corner = [renderer.image(t)[600:, 1100:].astype(float) for t in (0.0, 1.0)]
    assert corner[1].mean() / corner[0].mean() == pytest.approx(0.6, abs=0.05)
    assert (corner[0] - renderer.image(0.0)[600:, 1100:]).std() == pytest.approx(3.0 * 2**0.5, rel=0.1)


def test_what_is_covered_is_not_seen():
    def cover(t):
        return np.array([True, False, False])

    scene = Scene(
        [0.2, 0.5, 0.9],
        noise=0.0,
        hidden=cover,
        occluders=(Occluder((-0.2, -0.5), (0.2, -0.5), 0.1, (9.0, 99.0, 9.0)),),
        blackouts=((0.5, 0.6),),
    )
    renderer = Renderer(camera(), sliding((0.0, 0.0)), scene)
    truth = renderer.truth([0.0, 0.55])
    assert truth.visible.tolist() == [[False, False, True], [False] * 3]
    image, black = renderer.image(0.0), renderer.image(0.55)
    red = [image[round(v), round(u)].tolist() == [40, 30, 210] for u, v in truth.pixels[0]]
    assert red == [False, False, True]
    assert image[round(60 + 0.5 * 300), 640].tolist() == [9, 99, 9]
    assert np.abs(black[330, 640] - scene.wall((1280, 720))[330, 640]).max() <= 1.0


@pytest.mark.parametrize("share", [0.3, 0.0])
def test_random_occlusion_covers_its_share(share):
    hidden = random_occlusion(200, share, 0.4, until=20.0)
    assert np.mean([hidden(t) for t in np.linspace(0.0, 20.0, 80)]) == pytest.approx(share, abs=0.1 * share)


def test_off_the_plane_it_looks_larger():
    seen = camera()
    near = Renderer(
        seen, swinging(off_plane=lambda t, s: 0.3 * np.sin(np.pi * t)[:, None] * (s / 2.0) ** 2), Scene(ARCS)
    ).truth([0.5])
    assert near.places[0, -1, 2] == pytest.approx(0.3)
    flat = near.places[0, :, :2]
    towards = (near.pixels[0] - seen.matrix[:2, 2]) / (seen.project(flat) - seen.matrix[:2, 2])
    distance = seen.translation[2]
    assert np.allclose(towards, (distance / (distance - near.places[0, :, 2]))[:, None])


def test_motion_between_samples():
    """Hermite cubics over 5 ms of waves of 10 rad/s: 1e-8 rad; a rope of a trajectory is where its joints are."""
    motion = swinging(links=20)
    t = np.array([0.3021, 0.9977])
    rate, s = 4.0, (np.arange(20) + 0.5) / 20
    q = 0.6 * np.sin(rate * t[:, None] - 2.0 * s) + 0.35 * s * np.sin(1.7 * rate * t[:, None] - 4.0 * s)
    tips = np.stack([0.1 * np.sin(q).sum(axis=1), -0.1 * np.cos(q).sum(axis=1)], axis=1)
    assert np.abs(motion.places(t, [2.0])[:, 0, :2] - tips).max() < 1e-7


def test_motion_of_a_trajectory():
    rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=5, radius=0.003, friction=0.0)
    run = hf.simulate(rope, hf.arm_swings(), arm=hf.Arm(length=0.3), duration=0.5, t_eval=np.arange(0.0, 0.5, 0.01))
    motion = RopeMotion.from_trajectory(run)
    assert np.abs(motion.places(run.t, motion.joint_arc_lengths)[:, :, :2] - run.joints).max() < 1e-12


def test_video_with_truth(tmp_path):
    stamps = frame_times(0.1, 1.1, 30.0, jitter=0.2, dropped=0.2, seed=3)
    assert 18 <= stamps.size < 30
    small = Camera.facing((320, 240), pixels_per_metre=100.0, origin=(160.0, 20.0), exposure=0.01)
    Renderer(small, swinging(), Scene(ARCS)).write(tmp_path / "swing.mp4", stamps)
    with VideoReader(tmp_path / "swing.mp4") as video:
        frames = list(video)
    assert np.abs([f.time for f in frames] - stamps).max() < 1e-5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"marker_diameter": 0.0}, "marker_diameter"),
        ({"noise": -1.0}, "noise"),
        ({"marker_colours": [[1, 2, 3], [4, 5, 6]]}, "marker_colours"),
        ({"clutter": -1}, "clutter"),
    ],
)
def test_scenes_that_cannot_be_are_refused(change, message):
    refuses(message, replace, ONE, **change)


PLAIN = Scene([], rope_width=0.04, rope_colour=(60.0, 60.0, 60.0), noise=0.0, background=WALL)  # 12 px wide


def test_a_rope_casts_a_shadow_beside_it():
    """A straight rope at 640 px; its shadow 0.1 m to the right takes 30 % of the light there, and nowhere else."""
    plain, shaded = (
        Renderer(camera(), sliding((0.0, 0.0)), scene).image(0.0)[200, :, 1].astype(float)
        for scene in (PLAIN, replace(PLAIN, shadow=(0.1, 0.0, 0.3)))
    )
    assert shaded[670] / plain[670] == pytest.approx(0.7, abs=0.01)
    assert np.flatnonzero(shaded != plain).tolist() == list(range(664, 677))


def test_a_wire_shines_on_the_side_of_the_light():
    """A highlight of 4.8 px to the left of the middle; of a rope that points to the light, none."""
    down = Renderer(camera(), sliding((0.0, 0.0)), replace(PLAIN, shine=150.0)).image(0.0)[200, 635:646, 1]
    assert 636 <= 635 + int(np.argmax(down)) <= 639
    assert down.max() == pytest.approx(60.0 + 0.36 * 150.0, abs=3.0)
    to_light = np.full((2, 2), np.arctan2(-0.6, -0.8))
    rest = RopeMotion([-1.0, 1.0], to_light, np.zeros((2, 2)), [0.5, 0.5], np.zeros((2, 2)), np.zeros((2, 2)))
    images = [Renderer(camera(), rest, scene).image(0.0) for scene in (PLAIN, replace(PLAIN, shine=150.0))]
    assert np.abs(np.diff(np.int16(images), axis=0)).max() <= 2


def test_textures_are_as_strong_as_declared_and_stay():
    scene = replace(PLAIN, rope_texture=0.2, wall_texture=10.0)
    renderer = Renderer(camera(), sliding((0.0, 0.0)), scene)
    first, later = renderer.image(0.0), renderer.image(0.5)
    assert np.array_equal(first, later)
    assert first[:, 700:].astype(float).std(axis=(0, 1)).mean() == pytest.approx(10.0, rel=0.3)
    along = first[66:358:24, 640, 1].astype(float)  # a piece is 24 px long
    assert along.std() / along.mean() == pytest.approx(0.2, rel=0.4)  # 12 pieces


def test_without_a_rope_the_wall_is_seen():
    wall = replace(PLAIN, rope_width=0.0)
    textured = replace(wall, rope_texture=0.2, shine=150.0, shadow=(0.1, 0.0, 0.3))
    images = [Renderer(camera(), sliding((0.0, 0.0)), scene).image(0.0) for scene in (wall, textured)]
    assert np.array_equal(*images)


def test_an_automatic_exposure_steps():
    scene = replace(PLAIN, exposure_steps=((0.5, 0.7), (1.0, 1.2)))
    renderer = Renderer(camera(), sliding((0.0, 0.0)), scene)
    levels = [renderer.image(t)[600, 1000].astype(float).mean() for t in (0.0, 0.6, 1.5)]
    assert np.array(levels[1:]) / levels[0] == pytest.approx([0.7, 1.2], abs=0.01)
