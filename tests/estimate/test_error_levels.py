"""Errors that a run's markers are given, and those that a smoother of the run finds; what makes a track doubtful."""

import numpy as np
import pytest

from hyperflex.estimate import DoubtKind, EstimatedParameter, Observations, RopeFilter, RunErrors, run_errors
from hyperflex.estimate.doubts import doubts, explained
from hyperflex.estimate.error_levels import correlation_time
from tests.estimate.filmed import ARCS
from tests.estimate.runs import free_swing, rope

DECLARED, FRAMES = 1e-3, 75  # m, standard deviation of a coordinate
ORIGIN = [EstimatedParameter("offset_x", 0.01), EstimatedParameter("offset_y", 0.01)]


@pytest.fixture(scope="module")
def true() -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and places (T, K, 2) of the markers of a rope of 100 links, 30 frames a second."""
    swing, ends = free_swing(0, 4.0), np.linspace(0.0, 2.0, 101)
    rows = np.arange(0, 20 * FRAMES, 20)
    places = [np.stack([np.interp(ARCS, ends, swing.joints[k, :, c]) for c in (0, 1)], axis=1) for k in rows]
    return swing.t[rows], np.array(places)


def found(times: np.ndarray, places: np.ndarray, alike: float = 1.0) -> RunErrors:
    """Return the results of a filter with 20 links and a smoother, for positions stated `alike` times as uncertain."""
    estimator = RopeFilter(rope(20), ARCS, parameters=ORIGIN)
    seen, states = [Observations(t, each, std=DECLARED * alike**0.5) for t, each in zip(times, places, strict=True)], []
    for each in seen:
        estimator.update(each)
        states.append(estimator.x.copy())
    return run_errors(estimator, seen, np.array(states), alike=alike)


def inside(errors: RunErrors, off: np.ndarray) -> float:
    """Return the share of differences (T, K, 2) inside of their stated 95 %."""
    std = np.sqrt(np.diagonal(errors.covariances, axis1=2, axis2=3))
    return float((np.abs(off) < 1.96 * std)[np.isfinite(off)].mean())


@pytest.mark.parametrize("ratio", [0.5, 1.0, 4.0])
def test_the_noise_of_the_markers_is_found(true, ratio):
    """1200 coordinates determine a standard deviation to 2 %; the coarser chain adds a tenth of a millimetre."""
    times, places = true
    noise = ratio * DECLARED * np.random.default_rng(1).normal(size=places.shape)
    errors = found(times, places + noise)
    assert errors.level == pytest.approx(ratio, rel=0.12)
    assert errors.shift < 0.3 * ratio * DECLARED
    assert 0.92 < inside(errors, noise) < 0.98


def test_errors_that_count_less_are_reported_over_those_of_detection(true):
    """States are less well determined where errors count less, which adds a seventh."""
    times, places = true
    errors = found(times, places + DECLARED * np.random.default_rng(1).normal(size=places.shape), alike=8.0)
    assert errors.level == pytest.approx(1.0, rel=0.2)


def test_each_marker_has_its_own_errors(true):
    times, places = true
    size = DECLARED * np.where(np.arange(len(ARCS)) == 4, 6.0, 1.0)[:, None]
    errors = found(times, places + size * np.random.default_rng(2).normal(size=places.shape))
    std = np.sqrt(np.diagonal(errors.covariances, axis1=2, axis2=3)).mean(axis=(0, 2)) / DECLARED
    assert std[4] == pytest.approx(6.0, rel=0.2)
    assert np.delete(std, 4).max() < 1.6


def test_errors_that_are_seldom_large_are_stated_where_they_are_large(true):
    """As if something of the markers' colour touched one in a frame out of twelve: off by 8 mm instead of 1 mm."""
    times, places = true
    rng = np.random.default_rng(7)
    large = rng.random(places.shape[:2]) < 1.0 / 12.0
    noise = DECLARED * np.where(large, 8.0, 1.0)[:, :, None] * rng.normal(size=places.shape)
    errors = found(times, places + noise)
    std = np.sqrt(np.trace(errors.covariances, axis1=2, axis2=3) / 2.0) / DECLARED
    assert np.median(std[~large]) == pytest.approx(1.0, rel=0.2)
    assert np.mean(std[large] > 3.0) > 0.8  # of two normal numbers, 6 % are within 3 / 8 of zero
    assert 0.92 < inside(errors, noise) < 0.98


def test_a_swing_out_of_the_plane_is_stated_across_the_rope_too(true):
    """In perspective from 4 m, the tip 10 cm out of it. Motions of the rope explain much of what is across it."""
    times, places = true
    phase = np.sqrt(9.81 * 1.446 / 2.0) * times[:, None]  # the first mode of a hanging rope
    off = places * (0.05 * ARCS * np.sin(phase + 1.0) / 4.0)[:, :, None]
    noise = off + 0.3 * DECLARED * np.random.default_rng(8).normal(size=places.shape)
    errors = found(times, places + noise)
    std = np.sqrt(np.diagonal(errors.covariances, axis1=2, axis2=3))
    assert (np.abs(noise) < 1.96 * std).mean(axis=(0, 1)).min() > 0.9
    assert np.sqrt(np.mean(std**2)) < 2.0 * np.sqrt(np.mean(noise**2))


def test_a_shaking_camera_is_distinguished_from_the_markers_and_from_the_rope(true):
    """The common motion of all markers is found to 20 %: 150 numbers determine a standard deviation to 6 %."""
    times, places = true
    rng = np.random.default_rng(3)
    noise = DECLARED * rng.normal(size=places.shape) + 8e-3 * rng.normal(size=(len(places), 1, 2))
    errors = found(times, places + noise)
    assert errors.shift == pytest.approx(8e-3, rel=0.2)
    assert errors.level == pytest.approx(1.0, rel=0.15)
    assert 0.9 < inside(errors, noise) < 0.98
    assert errors.density[0] < 0.3  # rad/s^2 per root of Hz: the rope is not taken for a disturbed one


def test_an_origin_that_is_off_is_found_and_no_error_of_the_markers(true):
    """Half a pixel of 5 mm, as a hook clicked in a picture."""
    times, places = true
    noise = DECLARED * np.random.default_rng(4).normal(size=places.shape)
    errors = found(times, places + noise + [2.5e-3, -2e-3])
    assert errors.estimates["offset_x"][0] == pytest.approx(2.5e-3, abs=4.0 * errors.estimates["offset_x"][1])
    assert errors.estimates["offset_y"][0] == pytest.approx(-2e-3, abs=4.0 * errors.estimates["offset_y"][1])
    assert max(std for _, std in errors.estimates.values()) < 5e-4
    assert errors.level == pytest.approx(1.0, rel=0.12)


def test_frames_without_markers_and_a_new_start(true):
    times, places = true
    noise = DECLARED * np.random.default_rng(5).normal(size=places.shape)
    seen = places + noise
    seen[20:26] = np.nan
    seen[:, 3][::2] = np.nan
    estimator, states = RopeFilter(rope(20), ARCS, parameters=ORIGIN), []
    observed = [Observations(t, each, std=DECLARED) for t, each in zip(times, seen, strict=True)]
    for k, each in enumerate(observed):
        if k == 50:
            estimator.restart()
        estimator.update(each)
        states.append(estimator.x.copy())
    errors = run_errors(estimator, observed, np.array(states), begun=[0, 50])
    assert errors.level == pytest.approx(1.0, rel=0.2)
    assert 0.9 < inside(errors, np.where(np.isfinite(seen), noise, np.nan)) < 0.99
    assert errors.covariances.shape == (FRAMES, len(ARCS), 2, 2)
    assert np.isfinite(errors.covariances).all()


def test_the_correlation_time_is_that_of_an_autoregressive_series():
    """1 + 2 sum of a^k = (1 + a) / (1 - a): for a = 0.8 that is 9, less 0.1 where the sum is cut."""
    rng, series = np.random.default_rng(0), np.zeros((4000, 3))
    for k in range(1, len(series)):
        series[k] = 0.8 * series[k - 1] + rng.normal(size=3)
    assert correlation_time(series) == pytest.approx(8.9, rel=0.15)
    assert correlation_time(rng.normal(size=(4000, 3))) == pytest.approx(1.0, abs=0.1)
    assert correlation_time(np.zeros((100, 3))) == 1.0


@pytest.mark.parametrize(
    ("numbers", "kinds"),
    [
        ({}, []),
        ({"level": 5.0}, [DoubtKind.NOISE]),
        ({"level": 5.0, "alike": 0.6}, [DoubtKind.IMPOSSIBLE]),
        ({"shift": 2.0}, [DoubtKind.SHAKE]),
        ({"swing": 0.5, "density": np.array([5.0, 0.1])}, [DoubtKind.STILL]),
        ({"density": np.array([5.0, 0.1])}, [DoubtKind.DISTURBED]),
        ({"base": np.full((9, 2), 0.1)}, [DoubtKind.BASE_ELSEWHERE]),
        ({"base": np.linspace(0.0, 0.4, 18).reshape(9, 2), "level": 9.0}, [DoubtKind.BASE_MOVES]),
    ],
    ids=["none", "noise", "out of the plane", "shaking", "still", "disturbed", "base elsewhere", "base moves"],
)
def test_what_is_doubted(numbers, kinds):
    given = {"level": 1.0, "density": np.array([0.05, 0.1]), **numbers}
    assert [each.kind for each in doubts(rope(20), **given)] == kinds
    assert all(f"{each.size:.1g}"[0] in str(each) for each in doubts(rope(20), **given))
    said = explained(doubts(rope(20), **given), plain=True)
    assert bool(said) == bool(kinds)
    assert not any(word in said for word in ("marker", "arc length", "--origin-pixel"))
