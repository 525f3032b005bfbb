"""The bare rope in a picture: offsets across it, the free end, and choices between things that look like it."""

import itertools

import cv2
import numpy as np
import pytest
from scipy.special import erf

from hyperflex.core.image import profiles
from hyperflex.vision import CurveDetector, Renderer, RopeLook, Scene, srgb_tone, view_curve
from hyperflex.vision.curve import marginals
from hyperflex.vision.renderer.renderer import Occluder
from tests.vision.ropes import camera, swinging

DARK = np.array([45.0, 45.0, 45.0])
WIDTH, PIECES, LINES = 0.006, 16, 5  # m


def strip(x, centre, width, blur):
    """Cover of a still strip."""
    edges = (x[..., None] - centre + 0.5 * width * np.array([1.0, -1.0])) / (np.sqrt(2.0) * blur)
    return 0.5 * (erf(edges[..., 0]) - erf(edges[..., 1]))


@pytest.mark.parametrize("sweep", [(0.0, 0.0), (3.0, 0.0), (-25.0, 0.0), (20.0, 30.0)])
def test_moving_strips_are_found_on_a_slope(sweep):
    """The reference averages still strips; 0.02 px is the error of sampling every half pixel."""
    x, u = 0.5 * np.arange(-120, 121), (np.arange(2000) + 0.5) / 2000 - 0.5
    centres = 3.3 + sweep[0] * u + 0.5 * sweep[1] * u**2
    seen = np.mean([strip(x, centre, 2.0, 0.7) for centre in centres], axis=0) * 0.8 + 0.05 + 0.002 * x
    found = np.empty((1, 2, profiles.COLUMNS))
    profiles.match_lines(seen[None], np.array([sweep]), np.array([2.0]), 0.7, 0.5, np.array([12.0]), found)
    assert found[0, 0, profiles.OFFSET] == pytest.approx(3.3, abs=0.02)
    assert found[0, 0, profiles.AMPLITUDE] == pytest.approx(0.8, rel=0.02)


def test_choices_along_the_rope_are_those_of_all_combinations():
    """Forward and backward sums against the sum over all combinations, to rounding."""
    rng = np.random.default_rng(1)
    offsets, ratios = rng.normal(0.0, 2.0, (5, 2)), rng.uniform(1.0, 6.0, (5, 2))
    ratios[2, 1] = -np.inf
    variances, prior = rng.uniform(0.1, 0.3, (5, 2)), 4.0 * np.exp(-0.2 * np.subtract.outer(range(5), range(5)) ** 2)
    total, share = 0.0, np.zeros((5, 2))
    for choice in itertools.product(range(3), repeat=5):
        log = 0.0
        for k, c in enumerate(choice):
            log += 2.0 if c == 2 else ratios[k, c]
            before = choice[k - 1] if k else 2
            if k and (c == 2) != (before == 2):
                log -= 2.0
            if c != 2:
                mean, wide = 0.0, prior[k, k] + variances[k, c]
                if before != 2:
                    part = prior[k, k - 1] / (prior[k - 1, k - 1] + variances[k - 1, before])
                    mean, wide = part * offsets[k - 1, before], wide - part * prior[k, k - 1]
                log -= 0.5 * ((offsets[k, c] - mean) ** 2 / wide + np.log(wide / variances[k, c]))
        total += np.exp(log)
        for k, c in enumerate(choice):
            if c < 2:
                share[k, c] += np.exp(log)
    assert marginals(offsets, ratios, variances, prior, 2.0) == pytest.approx(share / total, abs=1e-12)


def seen(t=0.5, away=(0.0, 0.0), std=3.0, speed=6.0, occluders=(), **look):
    """What the detector finds of a swinging rope that it expects elsewhere, and the true offsets of pieces and end."""
    view, moving = camera(exposure=0.01), swinging(speed)
    image = Renderer(view, moving, Scene([], rope_width=WIDTH, occluders=occluders)).image(t)
    arcs = np.append((np.arange(PIECES * LINES) + 0.5) / (PIECES * LINES), 1.0) * 2.0
    places = moving.places(t + np.array([-0.005, 0.0, 0.005]), arcs)
    points = np.array([view.project(each) for each in places]) - np.asarray(away)
    covariance = std**2 * np.kron(np.ones((PIECES + 1, PIECES + 1)), np.eye(2))
    expected = view_curve(points, PIECES, covariance, 2.0, 100)
    found = CurveDetector().find(image, RopeLook(DARK, WIDTH * view.pixels_per_metre, **look), expected)
    return found, expected.middles[1] @ away, float(expected.end_tangent @ away), points


@pytest.mark.parametrize("speed", [0.5, 6.0, 10.0])
def test_offsets_are_measured_across_and_the_end_along(speed):
    """Errors within the stated ones, plus a tenth of a pixel of model error if the rope rotates during the exposure."""
    found, true, end, _ = seen(away=(3.0, -2.0), speed=speed)
    assert np.isfinite(found.offsets).sum() >= PIECES - 1
    error = (found.offsets - true) / np.sqrt(found.variances)
    assert np.sqrt(np.nanmean(error**2)) < 1.5
    assert abs(found.end - end) < 4.0 * np.sqrt(found.end_variance)


def test_a_hidden_piece_is_not_guessed():
    hidden = Occluder((-2.0, -1.0), (2.0, -1.0), 0.3)
    found, true, _, points = seen(occluders=(hidden,), speed=2.0)
    covered = np.abs(points[1][LINES // 2 : -1 : LINES, 1] - 360.0) < 40.0  # px, y = -1 m is row 360
    assert covered.sum() >= 2
    assert np.isnan(found.offsets[covered]).all()
    far = np.abs(points[1][LINES // 2 : -1 : LINES, 1] - 360.0) > 75.0
    assert np.isfinite(found.offsets[far]).all()
    assert np.abs(found.offsets - true)[far].max() < 0.5


def test_a_line_beside_the_rope_is_not_taken_for_a_piece_of_it():
    """It is as dark and thick, and nearer to where the rope is expected, but its neighbours are elsewhere."""
    away = np.array([4.0, 0.0])
    _, true, _, points = seen(away=away, speed=2.0)
    middle = len(points[1]) // 2
    ends = points[1][[middle - LINES, middle + LINES]] - [2.5, 0.0]
    (x0, y0), (x1, y1) = ((ends - [640.0, 60.0]) / [300.0, -300.0]).tolist()
    found, *_ = seen(away=away, speed=2.0, occluders=(Occluder((x0, y0), (x1, y1), WIDTH, tuple(DARK)),))
    there = np.isfinite(found.offsets)
    assert there.sum() >= PIECES - 3
    assert (np.abs(found.offsets - true) < 1.0)[there].all()


def lines(*columns, contrast=1.0, wall=180.0, look=None):
    """Return the detections of a rope of 20 pieces expected at column 100 to 3 px, in a picture of these lines."""
    image, look = np.full((200, 200, 3), wall), look or RopeLook(DARK, 1.0)
    image[:, list(columns)] -= contrast * (wall - look.levels)
    image = cv2.GaussianBlur(image, (0, 0), 0.6) + np.random.default_rng(1).normal(0.0, 1.0, image.shape)
    moving = np.tile(np.stack([np.full(141, 100.0), np.append(np.arange(20.0, 160.0), 180.0)], axis=1), (3, 1, 1))
    view = view_curve(moving, 20, 9.0 * np.kron(np.ones((21, 21)), np.eye(2)), 4.0, 50)
    return CurveDetector().find(image.astype(np.uint8), look, view)


def test_a_dim_rope_is_seen_by_its_light():
    """Five levels differ by less than a unit of light there."""
    tone = srgb_tone()
    found = lines(97, wall=6.0, look=RopeLook(np.full(3, tone[11]), 1.0, tone))
    assert np.abs(np.abs(found.offsets) - 3.0).max() < 0.5


@pytest.mark.parametrize("part", [0.04, 0.3, 0.5])
def test_a_faint_line_is_no_rope_that_is_not_seen(part):
    found = lines(103, contrast=part)
    assert np.isnan(found.offsets).all()
    assert np.isnan(found.end)


def test_noise_of_a_wall_is_no_rope_however_widely_it_is_searched():
    """A rope with three times the contrast of the noise, in eight pictures without it."""
    line = np.stack([np.full(141, 100.0), np.append(np.arange(20.0, 160.0), 180.0)], axis=1)
    alike = np.exp(-0.5 * (np.subtract.outer(range(21), range(21)) / 4.0) ** 2)
    view = view_curve(np.tile(line, (3, 1, 1)), 20, 14.0**2 * np.kron(alike, np.eye(2)), 4.0, 50)
    for seed in range(8):
        noise = np.random.default_rng(seed).normal(0.0, 4.0, (200, 200, 1)) * np.ones(3)
        image = np.rint(180.0 + noise).astype(np.uint8)
        assert np.isnan(CurveDetector().find(image, RopeLook(np.full(3, 168.0), 1.0), view).offsets).all()


def test_what_is_common_to_all_pieces_counts_once():
    """Two lines at 1 and 2.5 standard deviations: odds of the normal distribution; at equal distance: neither."""
    chances = marginals(
        np.tile([3.0, 7.5], (20, 1)), np.full((20, 2), 8.0), np.full((20, 2), 0.01), np.full((20, 20), 9.0), 3.0
    )
    odds = np.exp(0.5 * (1.0 - 2.5**2))
    assert chances[:, 1] == pytest.approx(odds / (1.0 + odds), rel=0.1)
    assert np.isnan(lines(97, 103).offsets).all()
    assert np.abs(lines(97).offsets - 3.0).max() < 0.2


@pytest.mark.parametrize(("rope", "wall"), [(45, 180), (180, 45)])
def test_a_fast_streak_is_seen_with_the_tone_curve_of_its_pictures_and_refused_without(rope, wall):
    """It covers a tenth of each pixel: 0.58 and 2.2 of its contrast in levels, by the definition of sRGB."""
    tone, x = srgb_tone(), np.arange(200.0)
    cover = np.mean([strip(x, 103.0 + each, 2.0, 0.7) for each in np.linspace(-10.0, 10.0, 400)], axis=0)
    levels = np.interp(tone[wall] + (tone[rope] - tone[wall]) * cover, tone, np.arange(256.0))
    image = np.tile(levels[None, :, None], (200, 1, 3)) + np.random.default_rng(1).normal(0.0, 1.0, (200, 200, 3))
    line = np.stack([np.full(141, 100.0), np.append(np.arange(20.0, 160.0), 180.0)], axis=1)
    moving = line + np.array([-10.0, 0.0, 10.0])[:, None, None] * [1.0, 0.0]
    view = view_curve(moving, 20, 9.0 * np.kron(np.ones((21, 21)), np.eye(2)), 4.0, 50)
    looks = RopeLook(np.full(3, tone[rope]), 2.0, tone), RopeLook(np.full(3, rope), 2.0)
    right, wrong = (CurveDetector().find(np.rint(image).astype(np.uint8), each, view).offsets for each in looks)
    assert np.abs(np.abs(right) - 3.0).max() < 0.5
    assert np.isnan(wrong).all()
