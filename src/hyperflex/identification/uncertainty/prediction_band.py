"""How far a prediction may be off: by its parameters, by the state that it starts from, and by noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import Fit, linearise
from hyperflex.identification.fit.windows import Window
from hyperflex.identification.model.plant import Plant
from hyperflex.identification.uncertainty.covariance import Information


@dataclass(frozen=True)
class PredictionUncertainty:
    """What a fit leaves unsure.

    covariance (P, P): of x. noise (C,): standard deviation of what the fit has left of each channel, rad or m.
    correlation: factor by which autocorrelation shortens a sample.
    """

    covariance: Array
    noise: Array
    correlation: float

    def of(self, count: int) -> PredictionUncertainty:
        """Return the same of the first channels alone: a motor's torque is not predicted."""
        return replace(self, noise=self.noise[:count])


def prediction_uncertainty(information: Information, windows: Sequence[Window], found: Fit) -> PredictionUncertainty:
    """Return what a fit leaves unsure; outliers count as little as they did in the fit."""
    squares, counted = 0.0, 0.0
    for window, residual in zip(windows, found.residuals, strict=True):
        counts = (found.loss.weight(residual) ** 2).reshape(window.y.shape) * (window.weight > 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.where(window.weight > 0.0, residual.reshape(window.y.shape) / window.weight, 0.0)
        squares = squares + (counts * error**2).sum(axis=0)
        counted = counted + counts.sum(axis=0)
    noise = np.sqrt(squares / np.maximum(counted, 1e-300))
    return PredictionUncertainty(information.covariance, noise, information.correlation)


def spread(
    plant: Plant, x: Array, window: Window, found: tuple[Array, Array], t: Array, unsure: PredictionUncertainty
) -> Array:
    """Return the standard deviation (m, C) of measured less predicted samples at times t (m,).

    Parameters
    ----------
    plant : Plant
    x : (P,) array
        The parameters of the prediction.
    window : Window
        On which its state was fitted.
    found : (2n,), (k C,) arrays
        That state at ``window.t[0]``, and what it leaves of the window.
    t : (m,) array, s
    unsure : PredictionUncertainty

    Notes
    -----
    To first order. An error of the parameters moves the fitted state as well, and the prediction feels both; an error
    of the state alone comes from the noise of the window, which counts as many times as its autocorrelation says. Where
    motion is chaotic the true spread soon leaves what a straight line can tell. NaN where derivatives fail.
    """
    state, residual = found
    linear = linearise(plant, window, x, state, residual, Loss())
    ahead = plant.slopes(x, np.append(window.t[0], t), state)
    if ahead is None or not linear.known:
        return np.full((t.size, unsure.noise.size), np.nan)
    absorb = np.linalg.pinv(linear.state)
    rows = (unsure.noise * window.weight).ravel() * np.sqrt(unsure.correlation)
    rows = np.append(rows, np.ones(linear.residual.size - rows.size))  # beliefs are in standard deviations
    by_state, shared = ahead.state[1:], ahead.shared[1:]
    by_noise = by_state @ (absorb * rows)
    by_parameters = shared - by_state @ (absorb @ linear.shared)
    variance = (by_noise**2).sum(axis=2) + np.einsum("mci,ij,mcj->mc", by_parameters, unsure.covariance, by_parameters)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) + unsure.noise**2))
