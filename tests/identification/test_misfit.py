"""When a fit is called poor."""

from types import SimpleNamespace

import numpy as np
import pytest

from hyperflex.checks import Array
from hyperflex.identification import Kind
from hyperflex.identification.fit import Fit, Loss, LossName, Window
from hyperflex.identification.symptoms import _of_fit, _of_noise
from hyperflex.sensors import Angles


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


def shown(seen: list[Window], residuals: Array, *, white: bool = False, loss: LossName = "squares") -> list[Kind]:
    """Return the findings of a converged fit with such residuals; the last of three channels is a torque."""
    torque = residuals.shape[1] == 3
    parts = np.split(np.where(np.isnan(residuals), 0.0, -residuals), len(seen))
    weighted = [(part * window.weight).ravel() for part, window in zip(parts, seen, strict=True)]
    found = Fit(np.zeros(1), [window.guess for window in seen], weighted, Loss(loss), converged=True)
    plant = SimpleNamespace(motor=object() if torque else None, sensor=Angles())
    information = SimpleNamespace(white=white, variance=1.0, freedom=100.0)
    basis = SimpleNamespace(plant=plant, windows=seen, fit=found, information=information)
    return [each.kind for each in (*_of_fit(basis), *_of_noise(basis, []))]


def outliers(residuals: Array) -> Array:
    residuals[::20] += 3.0  # one in twenty, rms 0.67
    return residuals


@pytest.mark.parametrize(
    ("seen", "residuals", "how", "poor"),
    [
        # a fit is poor that leaves a third of the motion; right fits of real pendulums leave a tenth of that
        (windows(), left(0.1), {"white": True}, False),
        (windows(), left(0.1), {}, True),
        (windows(), left(0.03), {}, False),
        # outliers alone make none poor where the loss leaves them out
        (windows(), outliers(left(0.02)), {}, True),
        (windows(), outliers(left(0.02)), {"loss": "huber"}, False),
        (windows(), outliers(left(0.02)), {"loss": "cauchy"}, False),
        (windows(), left(0.4), {"loss": "cauchy"}, True),
        # down to the declared noise it is not, however little moves; twice that is, and what was not declared
        (windows(2e-3, moves=4e-3), left(2.04e-3), {"white": True}, False),
        (windows(2e-3, moves=4e-3), left(4e-3), {"white": True}, True),
        (windows(None, moves=4e-3), left(2.04e-3), {}, True),
        # declared noise excuses no errors of the model beyond a fifth of the motion
        (windows(0.2), left(0.15), {}, False),
        (windows(0.5), left(0.4), {}, True),
        (windows(0.5), left(0.4), {"white": True}, False),
    ],
)
def test_when_a_fit_is_poor(seen, residuals, how, poor):
    assert (Kind.POOR_FIT in shown(seen, residuals, **how)) == poor


def test_noise_declared_far_too_large_is_found():
    assert Kind.NOISE_OVERSTATED not in shown(windows(2e-3), left(2e-3))
    assert Kind.NOISE_OVERSTATED in shown(windows(0.1), left(2e-3))


def test_a_torque_that_does_not_fit():
    seen = windows(0.01, channels=3)
    for size, wrong in ((0.05, False), (1.0, True)):
        residuals = left(0.01, 3)
        residuals[:, 2] = left(size)[:, 1]
        assert (Kind.POOR_TORQUE in shown(seen, residuals)) == wrong
