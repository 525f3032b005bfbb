"""What can be known: singular values, covariance with autocorrelated residuals, ratios by the delta method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification._parameters import Parameters, lumped
from hyperflex.identification._plant import Plant
from hyperflex.identification._shooting import Fit, linearise
from hyperflex.identification._windows import Window
from hyperflex.model import Rope

UNKNOWN = 1e-6  # singular values below this part of the largest are rounding
TOUCHED = 1e-3  # a parameter or ratio is unknown when this part of it lies in an unknown direction


@dataclass(frozen=True)
class Information:
    """What the windows tell about the parameters, in units of `widths` (see ``Parameters.widths``).

    singular (P,): of the derivatives of all residuals, states eliminated, largest first. known (P, k) and unknown
    (P, P - k): directions. covariance (P, P): of x, 0 along unknown directions. correlation: factor by which
    autocorrelation shortens the sample.
    """

    x: Array
    widths: Array
    singular: Array
    known: Array
    unknown: Array
    covariance: Array
    correlation: float

    def spread(self, gradient: Array) -> Array:
        """Return the sd (k,) of functions of x with the given gradients (k, P); inf where x alone cannot tell."""
        variance = np.einsum("ij,jk,ik->i", gradient, self.covariance, gradient)
        scaled = gradient * self.widths
        length = np.sqrt((scaled**2).sum(axis=1))
        beyond = np.sqrt(((scaled @ self.unknown) ** 2).sum(axis=1)) > TOUCHED * length
        return np.where(beyond & (length > 0.0), np.inf, np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, eq=False)
class Basis:
    """What further questions about a fit need: the plant, its windows, where the fit stands, and what they tell."""

    plant: Plant
    windows: list[Window]
    fit: Fit
    information: Information


def judge(plant: Plant, windows: Sequence[Window], fit: Fit) -> Information:
    """Return what the fit's windows tell.

    Notes
    -----
    Covariance s^2 (S^T S)^+ tau: S are the derivatives less what the states absorb, s^2 the residual variance per
    degree of freedom, and tau the integrated autocorrelation time of the residuals in samples, so that N samples count
    as N / tau independent ones. This is crude: it takes the residuals as one stationary process. Model error that
    repeats from window to window is in no way covered by it.
    """
    parameters = plant.parameters
    widths, total = parameters.widths, len(parameters)
    rows, weighted, freedom = [], [], 0.0
    for window, state, residual in zip(windows, fit.states, fit.residuals, strict=True):
        linear = linearise(plant, window, fit.x, state, residual, fit.loss)
        rows.append(np.linalg.qr(linear.reduced()[0] * widths, mode="r"))
        weight = fit.loss.weight(residual)
        weighted.append((weight * residual).reshape(window.y.shape))
        freedom += float((weight * (window.weight.ravel() > 0.0)).sum()) - state.size + window.believed.shape[0]
    stacked = np.vstack([*rows, np.zeros((total, total))])
    _, singular, directions = np.linalg.svd(stacked, full_matrices=False)
    told = singular > UNKNOWN * singular[0]
    known, unknown = directions[told].T, directions[~told].T
    cost = sum(float((r**2).sum()) for r in weighted)
    correlation = autocorrelation(weighted)
    variance = cost / max(1.0, freedom - int(told.sum()))
    scaled = (known / singular[told] ** 2) @ known.T * (variance * correlation)
    return Information(fit.x, widths, singular, known, unknown, scaled * np.outer(widths, widths), correlation)


def autocorrelation(residuals: Sequence[Array]) -> float:
    """Return the integrated autocorrelation time (samples, >= 1) of residuals [(m, n), ..], pooled over windows.

    1 + 2 sum of the autocorrelations up to the first below 0.05.
    """
    longest = max(r.shape[0] for r in residuals)
    sums = np.zeros(longest)
    for r in residuals:
        for lag in range(r.shape[0]):
            sums[lag] += float((r[lag:] * r[: r.shape[0] - lag]).sum())
    if sums[0] <= 0.0:
        return 1.0
    part = sums / sums[0]
    low = np.flatnonzero(part < 0.05)
    end = int(low[0]) if low.size else longest
    return max(1.0, float(1.0 + 2.0 * part[1:end].sum()))


RATIOS = {
    "J/p1": "inertia about the joint with all mass beyond at the far joint, m",
    "p/p1": "first moment about the joint with all mass beyond",
    "c/p1": "viscous friction, m/s",
    "dry/p1": "dry friction, m^2/s^2 / m",
    "k/p1": "stiffness, m/s^2",
}


def ratios(rope: Rope) -> dict[str, Array]:
    """Return what a motion without known forces can tell at most, each (n,), over p1 = p of link 0.

    ``J/p1`` (m), ``p/p1``, ``c/p1`` (m/s), and where the rope has them ``dry/p1`` and ``k/p1`` (m/s^2).
    """
    p, inertia = lumped(rope)
    result = {"J/p1": inertia / p[0], "p/p1": p / p[0], "c/p1": rope.friction / p[0]}
    if rope.dry_friction.any():
        result["dry/p1"] = rope.dry_friction / p[0]
    if rope.stiffness.any():
        result["k/p1"] = rope.stiffness / p[0]
    return result


def ratio_spread(parameters: Parameters, information: Information) -> dict[str, Array]:
    """Return the sd (n,) of each ratio by the delta method; inf where even the ratio cannot be known."""
    x, names = information.x, ratios(parameters.rope(information.x))
    step = 1e-6
    columns = []
    for k in range(x.size):
        up, down = x.copy(), x.copy()
        up[k] += step
        down[k] = max(x[k] - step, parameters.lower[k])
        above, below = _wide_ratios(parameters.rope(up)), _wide_ratios(parameters.rope(down))
        columns.append({name: (above[name] - below[name]) / (up[k] - down[k]) for name in names})
    return {name: information.spread(np.stack([c[name] for c in columns], axis=1)) for name in names}


def _wide_ratios(rope: Rope) -> dict[str, Array]:
    """Return the ratios with those that are 0."""
    p, _ = lumped(rope)
    return ratios(rope) | {"dry/p1": rope.dry_friction / p[0], "k/p1": rope.stiffness / p[0]}
