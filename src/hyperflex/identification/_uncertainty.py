"""What can be known: singular values, covariance with autocorrelated residuals, ratios by the delta method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification._parameters import Parameters, lumped
from hyperflex.identification._shooting import PRECISION, Fit, Plant, reduce, state_nudges
from hyperflex.identification._windows import Window
from hyperflex.model import Rope

CLOSER = (0.01, 0.1, 1.0)  # tolerance of the rollouts for derivatives over the fit's own; the first that works is taken
UNKNOWN = 1e-4  # singular values below this part of the largest are noise of the differences (measured: 1e-8 to 5e-6)
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


def judge(plant: Plant, parameters: Parameters, windows: Sequence[Window], fit: Fit) -> Information:
    """Return what the fit's windows tell.

    Notes
    -----
    Covariance s^2 (S^T S)^+ tau: S are the derivatives less what the states absorb, s^2 the residual variance per
    degree of freedom, and tau the integrated autocorrelation time of the residuals in samples, so that N samples count
    as N / tau independent ones. This is crude: it takes the residuals as one stationary process. Model error that
    repeats from window to window is in no way covered by it.
    """
    widths = parameters.widths
    rows = []
    for number, window in enumerate(windows):
        left = _derivatives(plant, parameters, window, fit, number)
        if left is not None:
            rows.append(np.linalg.qr(left * widths, mode="r"))
    total = len(parameters)
    stacked = np.vstack([*rows, np.zeros((total, total))])
    _, singular, directions = np.linalg.svd(stacked, full_matrices=False)
    told = singular > UNKNOWN * singular[0]
    known, unknown = directions[told].T, directions[~told].T
    count = sum(window.values for window in windows)
    freedom = max(1, count - sum(state.size for state in fit.states) - int(told.sum()))
    correlation = autocorrelation([r.reshape(w.y.shape) for r, w in zip(fit.residuals, windows, strict=True)])
    scaled = (known / singular[told] ** 2) @ known.T * (fit.cost / freedom * correlation)
    return Information(fit.x, widths, singular, known, unknown, scaled * np.outer(widths, widths), correlation)


def _derivatives(plant: Plant, parameters: Parameters, window: Window, fit: Fit, number: int) -> Array | None:
    """Return the derivatives (m n, P) of one window by central differences, less what its state absorbs."""
    state = fit.states[number]
    for precision in CLOSER:
        nudges = state_nudges(window, parameters.guess.n_links)
        by_state = partial(_at_state, plant, parameters.rope(fit.x), window, precision)
        by_parameter = partial(_at_parameter, plant, parameters, window, state, precision)
        slope = _central(by_state, state, nudges, np.full(state.size, -np.inf))
        shared = _central(by_parameter, fit.x, parameters.steps, parameters.lower)
        if slope is not None and shared is not None:
            return reduce(slope, shared, fit.residuals[number])[0]
    return None


def _at_state(plant: Plant, rope: Rope, window: Window, precision: float, state: Array) -> Array | None:
    return plant.residual(rope, window, state, precision * PRECISION)


def _at_parameter(
    plant: Plant, parameters: Parameters, window: Window, state: Array, precision: float, x: Array
) -> Array | None:
    return plant.residual(parameters.rope(x), window, state, precision * PRECISION)


def _central(function: Callable[[Array], Array | None], at: Array, steps: Array, lower: Array) -> Array | None:
    """Return derivatives by central differences; None where the function has no value.

    At a lower bound three points on the allowed side take their place. Two would err in the first order of the step,
    enough to turn directions that cannot be known into ones that touch a weakly known parameter.
    """
    columns = []
    for k, step in enumerate(steps):
        one, other = at.copy(), at.copy()
        one[k] += step
        bounded = at[k] - step < lower[k]
        other[k] += 2.0 * step if bounded else -step
        values = [function(one), function(other), function(at) if bounded else None]
        near, far, middle = values
        if near is None or far is None or (bounded and middle is None):
            return None
        columns.append(
            (near - far) / (2.0 * step) if middle is None else (4.0 * near - far - 3.0 * middle) / (2.0 * step)
        )
    return np.stack(columns, axis=1)


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
