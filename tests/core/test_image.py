"""Kernels of pictures against brute force: cover of capsules, moments of blobs, the discriminant."""

import numpy as np
import pytest

from hyperflex.core.image import blobs, pairs
from hyperflex.core.image.discriminant import discriminant, wall_sums
from hyperflex.core.image.exposure import Capsules, RowTimes, expose

COLOUR = np.array([[10.0, 100.0, 200.0]], np.float32)


def drawn(ends, radius, times, shape=(24, 30)):
    out = np.zeros((*shape, 4), np.float32)
    expose(Capsules(np.asarray(ends, float), np.array([radius]), np.zeros(1, np.int64), COLOUR), times, out)
    return out


STILL = RowTimes(0.0, 0.0, 0.0, 1)


@pytest.mark.parametrize("ends", [(14.3, 11.8, 14.3, 11.8), (8.2, 7.9, 20.6, 15.1), (15.0, 4.0, 15.0, 18.0)])
def test_cover_is_the_area_covered(ends):
    """Against 16 x 16 samples a pixel: the linear edge misses a pixel by 0.1 at most, the whole area by 1 %."""
    radius = 3.7
    fine = (np.arange(16) + 0.5) / 16 - 0.5
    v = np.arange(24)[:, None, None, None] + fine[:, None]
    u = np.arange(30)[:, None, None] + fine
    a, b = np.array(ends[:2]), np.array(ends[2:])
    along = b - a
    t = np.clip(((u - a[0]) * along[0] + (v - a[1]) * along[1]) / max(along @ along, 1e-12), 0.0, 1.0)
    inside = np.hypot(u - a[0] - t * along[0], v - a[1] - t * along[1]) <= radius
    want = inside.mean(axis=(2, 3))
    got = drawn([[ends], [ends]], radius, STILL)
    assert np.abs(got[..., 3] - want).max() < 0.1
    assert got[..., 3].sum() == pytest.approx(want.sum(), rel=0.01)
    assert np.allclose(got[..., :3], got[..., 3:] * COLOUR[0], rtol=1e-6)


def test_a_moving_disc_is_the_mean_of_discs():
    start, end = (6.0, 8.0, 6.0, 8.0), (20.0, 14.0, 20.0, 14.0)
    got = drawn([[start], [end]], 3.0, RowTimes(0.5, 0.0, 0.8, 7))
    want = np.zeros_like(got)
    for tau in 0.5 + 0.8 * ((np.arange(7) + 0.5) / 7 - 0.5):
        place = tuple((1.0 - tau) * np.array(start) + tau * np.array(end))
        want += drawn([[place], [place]], 3.0, STILL) / 7
    assert np.abs(got - want).max() < 1e-4


def test_each_row_has_its_own_time():
    start, end = (5.0, 12.0, 5.0, 12.0), (22.0, 13.0, 22.0, 13.0)
    got = drawn([[start], [end]], 4.0, RowTimes(0.1, 0.03, 0.0, 1))
    for v in range(24):
        tau = min(0.1 + 0.03 * v, 1.0)
        place = tuple((1.0 - tau) * np.array(start) + tau * np.array(end))
        assert np.allclose(got[v], drawn([[place], [place]], 4.0, STILL)[v], atol=1e-4)


def test_the_layer_in_front_covers():
    ends = np.array([[[15.0, 12.0, 15.0, 12.0]] * 2] * 2)
    both = Capsules(ends, np.array([6.0, 3.0]), np.array([0, 1]), np.array([[1, 2, 3], [200, 100, 50]], np.float32))
    out = np.zeros((24, 30, 4), np.float32)
    expose(both, STILL, out)
    assert out[12, 15].tolist() == [200.0, 100.0, 50.0, 1.0]
    assert out[12, 19].tolist() == [1.0, 2.0, 3.0, 1.0]
    assert out[12, 28].tolist() == [0.0] * 4


def test_moments_of_blobs():
    rng = np.random.default_rng(0)
    weights = np.zeros((30, 40))
    weights[5:12, 6:14] = rng.uniform(0.2, 1.0, (7, 8))
    weights[18:25, 20:33] = rng.uniform(0.2, 1.0, (7, 13))
    image = rng.integers(0, 255, (30, 40, 3)).astype(np.uint8)
    found = np.empty((8, blobs.COLUMNS))
    assert blobs.blob_moments(image, weights, 0.1, found) == 2
    for row, part in zip(found, (np.s_[5:12, 6:14], np.s_[18:25, 20:33]), strict=False):
        v, u = np.mgrid[part]
        w = weights[part]
        area = w.sum()
        mean = np.array([(w * u).sum(), (w * v).sum()]) / area
        off = np.stack([u - mean[0], v - mean[1]])
        covariance = np.einsum("iab,jab,ab->ij", off, off, w) / area
        assert row[blobs.AREA] == pytest.approx(area)
        assert np.allclose(row[[blobs.MEAN_U, blobs.MEAN_V]], mean)
        assert np.allclose(row[[blobs.COV_UU, blobs.COV_UV, blobs.COV_VV]], covariance[[0, 0, 1], [0, 1, 1]])
        full = w > blobs.FULLY
        assert row[blobs.FULL] == full.sum()
        assert np.allclose(row[blobs.COLOUR :], image[part][full].mean(axis=0))


def test_no_more_blobs_than_there_is_room_for():
    weights = np.zeros((9, 40))
    weights[4, 2::5] = 1.0
    assert blobs.blob_moments(np.zeros((9, 40, 3), np.uint8), weights, 0.5, np.empty((3, blobs.COLUMNS))) == 3


def test_discriminant_is_fishers():
    """Against numpy's own covariance of the wall alone: 0 on its mean, 1 on the target."""
    rng = np.random.default_rng(0)
    image = (rng.normal([120, 130, 140], [3, 6, 4], (40, 40, 3))).round().astype(np.uint8)
    image[15:22, 15:22] = (60, 40, 210)
    axes = np.array([[-1.0, -1.0, 2.0], [1.0, -1.0, 0.0]]) / np.array([[6.0**0.5], [2.0**0.5]])
    target = axes @ [60.0, 40.0, 210.0]
    out = np.empty(4)
    noise = discriminant(image, axes, target, np.array([15.0, 1.5]), out)
    wall = np.delete(image.reshape(-1, 3), np.flatnonzero(image[..., 2].ravel() == 210), axis=0) @ axes.T
    covariance = np.cov(wall.T, bias=True) + 1.5**2 * np.eye(2)
    contrast = target - wall.mean(axis=0)
    want = np.linalg.solve(covariance, contrast)
    want /= want @ contrast
    assert np.allclose(out[:3], want @ axes, rtol=1e-9)
    assert out[:3] @ [60, 40, 210] + out[3] == pytest.approx(1.0)
    assert noise == pytest.approx(np.sqrt(want @ covariance @ want))
    assert discriminant(image, axes, axes @ [120.0, 130.0, 141.0], np.array([15.0, 1.5]), out) == 0.0


def test_sums_over_the_wall():
    """Against numpy, over a number of pixels that no SIMD register divides: rounding only."""
    rng = np.random.default_rng(1)
    x, y = rng.normal(100.0, 20.0, (2, 1003))
    px, py = x - 101.0, y - 98.0
    wall = 0.01 * px + 0.02 * py < 0.15
    want = [wall.sum(), *(each[wall].sum() for each in (px, py, px * px, px * py, py * py))]
    assert np.allclose(wall_sums(x, y, 101.0, 98.0, 0.01, 0.02, 0.15), want, rtol=1e-12)


def test_costs_of_pairs_are_those_of_their_innovations():
    """Against the joint innovation written out: d' S^-1 d + log det S of each pair."""
    rng = np.random.default_rng(2)
    places, mean, unseen = rng.uniform(0.0, 9.0, (3, 2)), rng.uniform(0.0, 9.0, (3, 2)), rng.normal(size=3)
    root = rng.normal(size=(6, 6))
    prior, wide = (
        root @ root.T + np.eye(6),
        np.array([[[2.0, 0.3], [0.3, 1.0]]]) * np.array([1.0, 2.0, 3.0])[:, None, None],
    )
    cost = np.empty((3, 3))
    pairs.pair_costs(places, wide, mean, prior, unseen, 4.0, 1e9, cost)
    for k in range(3):
        for j in range(3):
            S, off = prior[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] + wide[j], places[j] - mean[k]
            far = off @ np.linalg.solve(S, off)
            assert cost[k, j] == pytest.approx(1e9 if far > 4.0 else far + np.log(np.linalg.det(S)) + unseen[j])
    assert 0 < (cost == 1e9).sum() < 9
