"""Samples denser than a swing needs become one value, without loss of information and without a shift."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hyperflex as hf
from hyperflex.identification.fit import averaged
from hyperflex.identification.measurements import DENSEST, Measurements, measure, merged
from hyperflex.identification.uncertainty.noise import Piece, channel_correlation
from tests.identification.twins import EXACT

RATE, PERIOD = 500.0, 1.2  # samples/s, s
T = np.arange(5000) / RATE
MOTION = 0.6 * np.sin(2.0 * np.pi / PERIOD * T + 0.3)[:, None] * [1.0, 0.5]


def off(recording: hf.Recording, spread: np.ndarray) -> np.ndarray:
    """Differences between values and the motion's means, except the first and last, where derivatives are one-sided."""
    there = 0.6 * np.sin(2.0 * np.pi / PERIOD * recording.t + 0.3)[:, None] * [1.0, 0.5]
    return (recording.data - averaged(there, recording.t, spread))[3:-3]


@pytest.mark.parametrize("merging", ["mean", "median"])
@pytest.mark.parametrize("missing", [0.0, 0.2])
def test_values_are_those_of_the_motion_at_their_times(merging, missing):
    """The motion at their times would be 40 microrad off, and 2 mrad where a sample misses; noise is a milliradian."""
    seen = np.where(np.random.default_rng(0).random(MOTION.shape) < missing, np.nan, MOTION)
    found, share, spread = merged(hf.Recording(T, seen), 4, merging)
    assert np.nanmax(np.abs(off(found, spread))) < (2e-4 if missing else 1e-6)
    assert (share[~np.isnan(found.data)] >= 0.25).all()


def test_noise_falls_by_the_root_of_the_samples():
    noise = np.full(MOTION.shape, 1e-3)
    noise[::4] = 2e-3  # one of four is worse: it counts a quarter
    seen = MOTION + noise * np.random.default_rng(1).standard_normal(MOTION.shape)
    found, _, spread = merged(hf.Recording(T, seen, noise=noise), 4)
    np.testing.assert_allclose(found.noise, 1e-3 / np.sqrt(3.25))
    assert np.sqrt(np.mean(off(found, spread) ** 2)) == pytest.approx(1e-3 / np.sqrt(3.25), rel=0.05)  # 2,500 values


def test_white_noise_stays_white():
    """Values corrected by their own curvature had autocorrelations of -0.02 two apart: long recordings show that."""
    noise = np.random.default_rng(4).standard_normal((100_000, 4))
    values = merged(hf.Recording(np.arange(100_000) / RATE, noise), 5)[0].data
    for lag in (1, 2, 3):
        shown = (values[lag:] * values[:-lag]).sum() / (values**2).sum()
        assert abs(shown) < 0.011  # three deviations of 80,000 values
    assert values.var() == pytest.approx(0.2, rel=0.015)  # three of theirs


def test_outliers_do_not_reach_their_neighbours_with_a_robust_loss():
    seen = MOTION.copy()
    seen[::20] += 1.0
    for merging, most in (("median", 1e-3), ("mean", np.inf)):
        found, _, spread = merged(hf.Recording(T, seen), 4, merging)
        assert np.abs(off(found, spread)).max() < most
    assert np.abs(off(found, spread)).max() > 0.2


def test_frames_that_miss_do_not_join_what_lies_apart():
    keep = (T < 3.003) | (T > 4.001)
    found, share, spread = merged(hf.Recording(T[keep], MOTION[keep]), 4)
    assert not ((found.t > 3.01) & (found.t < 4.0)).any()
    assert np.abs(off(found, spread)).max() < 1e-4
    assert share.min() < 1.0


@pytest.mark.parametrize("length", [0.4, 0.6, 0.798, 0.8, 3.0])
def test_no_window_holds_more_than_the_densest(length):
    seen = hf.Recording(T, MOTION)
    step = Measurements(seen, seen, np.zeros((0, 4))).step(length)
    assert (step - 1) * DENSEST < round(length * RATE) <= step * DENSEST


def test_all_samples_of_500_frames_a_second_count():
    """A point mass; five times the frames make its length known to the root of five better."""

    def swing(rate: float) -> hf.Recording:
        t = np.arange(0.0, 5.0, 1.0 / rate)

        def slope(_: float, y: np.ndarray) -> list[float]:
            return [y[1], -9.81 / 0.5 * np.sin(y[0]) - 0.05 * y[1]]

        angle = solve_ivp(slope, (0.0, t[-1]), [0.4, 0.0], t_eval=t, rtol=1e-10, atol=1e-12).y[0]
        return hf.Recording(t, (angle + 2e-3 * np.random.default_rng(2).standard_normal(t.size))[:, None])

    guess = hf.Rope(length=[0.5], mass=[0.1], com=[0.5], inertia=[1e-4], friction=[1e-4])
    exact = EXACT
    few, many = (hf.identify(swing(rate), guess, ["inertia", "friction"], options=exact) for rate in (100.0, 500.0))
    ratio = few.ratio_std["J/p1"][0] / many.ratio_std["J/p1"][0]
    assert ratio == pytest.approx(np.sqrt(5.0), rel=0.1)  # the noise of 500 values is known to 3 %
    assert 0.5 in many.intervals["J/p1[0]"]
    assert many.settings["decimation"] > 1


def test_a_marker_that_errs_turns_a_short_link_farther():
    """Markers of equal noise: the weights of the links' angles are as their lengths."""
    length = np.array([0.4, 0.1])
    q = MOTION[::20]
    steps = length[:, None] * np.stack([np.sin(q), -np.cos(q)], axis=-1).reshape(-1, 2, 2)
    places = np.concatenate([np.zeros((len(q), 1, 2)), np.cumsum(steps, axis=1)], axis=1).reshape(len(q), -1)
    measured = measure(hf.Recording(T[::20], places, "markers"), hf.Rope(length=length, mass=0.1), None)
    (window, *_), _ = measured.windows(2.0)
    np.testing.assert_allclose(window.weight, np.broadcast_to([1.0, 0.25], window.weight.shape))


def test_channels_that_err_unlike_are_distinguished_from_chance():
    """Long recordings determine each channel's noise; short ones do not, and use one value for all channels."""
    true = np.array([[1.6, -0.5, 0.0], [-0.5, 1.0, 0.2], [0.0, 0.2, 0.4]])

    def shown(count: int, covariance: np.ndarray) -> np.ndarray:
        noise = np.random.default_rng(3).standard_normal((count, 3)) @ np.linalg.cholesky(covariance).T
        return channel_correlation([Piece(noise, np.ones((count, 3)), np.zeros((count, 3, 0)))], np.ones(1))

    np.testing.assert_allclose(shown(20000, true), true, atol=0.05)  # of 20,000 each: 1 % and the mean
    assert np.abs(shown(30, np.eye(3)) - np.eye(3)).max() < 0.2  # of 30 each: 0.26 without being drawn to equal ones
