"""Hermite interpolation within a step, from states and derivatives at its beginning, middle and end."""

import math

import numpy as np

from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.jit import kernel, non_allocating


def _hermite(derivatives: int) -> Array:
    """Coefficients (basis, power) of the Hermite basis on -1, 0, 1 with the given derivatives (0..k) at each node."""
    count = 3 * (derivatives + 1)
    rows = [
        [math.perm(power, d) * node ** (power - d) if power >= d else 0.0 for power in range(count)]
        for d in range(derivatives + 1)
        for node in (-1.0, 0.0, 1.0)
    ]
    return np.linalg.inv(np.array(rows)).T.copy()


_ANGLES = _hermite(2)  # (9, 9): value, first and second derivative at three nodes
_SUMS = _hermite(1)  # (6, 6): value and first derivative


@non_allocating
def basis(order, theta, weight):  # type: ignore[no-untyped-def]
    """Derivative of the given order of the interpolation's basis (9,) at theta; of values, rates and accelerations."""
    for b in range(9):
        total = 0.0
        for k in range(order, 9):
            factor = 1.0
            for m in range(order):
                factor *= k - m
            total += _ANGLES[b, k] * factor * theta ** (k - order)
        weight[b] = total


@kernel
def interpolate(theta, step, ys, dys, out):  # type: ignore[no-untyped-def]
    """State at theta in -1..1 within a step from its values ys (3, 2 n + 2) and derivatives dys at -1, 0, 1.

    Angles follow the polynomial of degree 8 through angles, rates and accelerations; rates are its derivative; work
    and dissipation follow one of degree 5. Not for the step behind a switch, where friction settles (docs/models.md).
    """
    n = (ys.shape[1] - 2) // 2
    half = 0.5 * step
    value = np.empty(9)
    slope = np.empty(9)
    basis(0, theta, value)
    basis(1, theta, slope)
    for i in range(n):
        q = w = 0.0
        for k in range(3):
            rate = half * ys[k, n + i]
            bend = half * half * dys[k, n + i]
            q += value[k] * ys[k, i] + value[3 + k] * rate + value[6 + k] * bend
            w += slope[k] * ys[k, i] + slope[3 + k] * rate + slope[6 + k] * bend
        out[i] = q
        out[n + i] = w / half
    for i in range(2 * n, 2 * n + 2):
        total = 0.0
        for b in range(6):
            node = b % 3
            weight = 0.0
            for k in range(6):
                weight += _SUMS[b, k] * theta**k
            total += weight * (ys[node, i] if b < 3 else half * dys[node, i])
        out[i] = total
