"""When a fit is called poor, and when all can be said to be known."""

from __future__ import annotations

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.windows import Window
from hyperflex.identification.verdict import ALL_ACT, ALL_KNOWN, consistent, poor_fit, poor_torque, too_small


def windows(noise: float | None = None, moves: float = 1.0, channels: int = 2) -> list[Window]:
    """Two windows of 100 samples in which each channel swings by `moves` (rms), with one gap."""
    t = np.linspace(0.0, 1.0, 101)[:-1]
    y = moves * np.sqrt(2.0) * np.sin(2.0 * np.pi * t)[:, None] * np.ones(channels)
    weight = np.full(y.shape, 1.0 if noise is None else 1.0 / noise)
    weight[3, 0] = 0.0
    return [Window(t, np.where(weight > 0.0, y, 0.0), weight, np.zeros(4), np.zeros((0, 4)))] * 2


def left(size: float, channels: int = 2) -> Array:
    """Residuals with such an rms, apart from chance, and the windows' gap."""
    residuals = size * np.random.default_rng(0).standard_normal((200, channels))
    residuals[[3, 103], 0] = np.nan
    return residuals


def test_a_fit_is_poor_that_leaves_a_third_of_the_motion() -> None:
    residuals = left(0.1)
    assert poor_fit(windows(), residuals, "rad", Loss(), white=True) == ""
    assert poor_fit(windows(), residuals, "rad", Loss())  # fits of real pendulums that are right leave a tenth of that
    assert poor_fit(windows(), 0.3 * residuals, "rad", Loss()) == ""
    residuals[:, 1] *= 3.0
    told = poor_fit(windows(), residuals, "rad", Loss())
    assert "fit is poor: link 1 is 0.3" in told
    told = poor_fit(windows(), residuals, "m", Loss())
    assert "marker 0" in told


def test_outliers_alone_make_no_fit_poor_where_the_loss_leaves_them_out() -> None:
    residuals = left(0.02)
    residuals[::20] += 3.0  # one in twenty, rms 0.67
    assert poor_fit(windows(), residuals, "rad", Loss())
    for name in ("huber", "cauchy"):
        assert poor_fit(windows(), residuals, "rad", Loss(name)) == ""
    assert poor_fit(windows(), left(0.4), "rad", Loss("cauchy"))


def test_a_fit_down_to_the_declared_noise_is_not_poor_however_little_moves() -> None:
    still = windows(2e-3, moves=4e-3)
    assert poor_fit(still, left(2.04e-3), "m", Loss(), white=True) == ""
    assert poor_fit(still, left(4e-3), "m", Loss(), white=True)  # twice what was declared, and all of the motion
    assert poor_fit(windows(None, moves=4e-3), left(2.04e-3), "m", Loss())  # nothing was declared


def test_declared_noise_excuses_no_errors_of_the_model_beyond_a_fifth_of_the_motion() -> None:
    assert poor_fit(windows(0.2), left(0.15), "rad", Loss()) == ""  # not white, but little
    assert poor_fit(windows(0.5), left(0.4), "rad", Loss())
    assert poor_fit(windows(0.5), left(0.4), "rad", Loss(), white=True) == ""


def test_noise_declared_far_too_large_is_told() -> None:
    assert too_small(windows(2e-3), left(2e-3), Loss()) == ""
    told = too_small(windows(0.1), left(2e-3), Loss())
    assert "declared noise (0.1) is 5" in told


def test_a_torque_that_does_not_fit() -> None:
    seen = windows(0.01, channels=3)
    assert poor_torque(seen, None, Loss()) == ""
    assert poor_torque(seen, left(0.05)[:, 1], Loss()) == ""
    assert "check its sign" in poor_torque(seen, left(1.0)[:, 1], Loss()).lower()


def test_all_can_be_known_does_not_stand_beside_a_warning() -> None:
    assert consistent([ALL_KNOWN]) == [ALL_KNOWN]
    assert consistent(["Not converged.", ALL_KNOWN]) == ["Not converged.", ALL_ACT]
    assert not ALL_ACT.startswith("All free parameters can be known")
