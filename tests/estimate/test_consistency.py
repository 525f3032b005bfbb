"""Is the filter as sure as it says? Short runs; 100 of each kind are in benchmarks/tracking.py."""

import numpy as np
import pytest
from scipy import stats

from hyperflex.estimate import EstimatedParameter
from tests.estimate.runs import Tracked, disturbed, friction_bound, track

DENSITY = (0.5, 1.0)


def nees(found: Tracked, name: str, floor: float) -> tuple[float, float]:
    """Mean NEES over dimension of places or velocities since 1 s, and how often the 90 % region holds."""
    late = [each[name] for t, each in zip(found.t, found.seen, strict=True) if t >= 1.0]
    error, covariance = np.array([each[0] for each in late]), np.array([each[1] for each in late])
    size = np.linalg.solve(covariance + floor**2 * np.eye(2), error[..., None])[..., 0]
    value = (error * size).sum(axis=-1)
    return float(value.mean() / 2.0), float((value < stats.chi2.ppf(0.9, 2)).mean())


@pytest.mark.parametrize("moved", [False, True], ids=["free swings", "casts"])
def test_where_the_model_is_right(moved):
    """Disturbances as the filter assumes them, of unknown size: chi squares, and white innovations.

    Successive frames are correlated, so the mean of NEES over two runs of 6 s varies by some 10 %.
    """
    runs = []
    for seed in range(2):
        truth = disturbed(moved=moved, n=50, noise=DENSITY, seed=seed, duration=7.0)
        runs.append(track(truth, frames=30.0, moved=moved, seed=seed, seen=True))
    for name in ("places", "velocities", "tip", "tip velocity"):
        mean, held = np.mean([nees(found, name, 8e-6 if "velo" not in name else 8e-5) for found in runs], axis=0)
        assert 0.75 < mean < 1.25, name
        assert 0.85 < held < 0.97, name
    for found in runs:
        assert found.tracker.process_noise.value[0] == pytest.approx(DENSITY[0], rel=0.3)
        z = np.array([each for t, each in zip(found.t, found.whitened, strict=True) if t >= 1.0])
        assert stats.kstest(z.ravel(), stats.norm.cdf).pvalue > 1e-3
        for lag in (1, 2, 3):
            pairs = (z[lag:] * z[:-lag]).ravel()
            assert abs(pairs.mean()) < 4.0 / np.sqrt(pairs.size)


@pytest.mark.parametrize(
    "moved", [pytest.param(False, marks=pytest.mark.nightly, id="free swings"), pytest.param(True, id="casts")]
)
def test_with_a_finer_truth(moved):
    """100 links for 50, undisturbed, whose differences come in bursts: single runs hold 67 to 99 %, 86 % on average."""
    runs = [
        track(disturbed(moved=moved, seed=seed, duration=6.0), frames=30.0, moved=moved, seed=seed, seen=True)
        for seed in range(2)
    ]
    for name in ("places", "velocities", "tip", "tip velocity"):
        mean, held = np.mean([nees(found, name, 3e-5 if "velo" not in name else 3e-4) for found in runs], axis=0)
        assert mean < 1.9, name
        assert held > 0.7, name


@pytest.mark.parametrize("frames", [7.5, pytest.param(30.0, marks=pytest.mark.nightly)])
def test_starts_with_a_wrong_length(frames):
    """1 % off, from random shapes, at 7.5 frames/s too: always finite, and the tip is right a second later."""
    for seed in range(4):
        moved, unsure = bool(seed % 2), [EstimatedParameter("length", 0.01)]
        truth, scale = disturbed(moved=moved, n=40, duration=1.5, at=0.1, seed=seed), 1.01 if seed < 2 else 0.99
        found = track(truth, n=20, frames=frames, noise=1e-3, scale=scale, parameters=unsure, moved=moved, seed=seed)
        assert np.isfinite(found.tracker.x).all()
        assert found.rms("tip", 1.0) < 5e-3


@pytest.mark.parametrize(
    "moved", [pytest.param(False, id="free swing"), pytest.param(True, marks=pytest.mark.nightly, id="cast")]
)
def test_joint_friction_near_its_bound(moved):
    """No estimate is surer than the Cramer-Rao bound; this one, which has to allow for disturbances, nearly so."""
    truth = disturbed(moved=moved, n=25, duration=5.2, at=0.1)
    bound = friction_bound(truth, moved, 1.5e-3)
    found = track(truth, n=25, frames=30.0, moved=moved, parameters=[EstimatedParameter("friction", 3.0)])
    error, std = found.tracker.values["friction"]
    assert bound < 0.05
    assert std > 0.95 * bound
    assert abs(error) < 3.0 * min(std, 1.5 * bound)
