"""Impulses of joints at limits, by dense matrices and many small projections.

One joint after the other takes the impulse with which its own law holds, the others given, until nothing moves
(projected Gauss-Seidel): the scalar problem rate = free + impulse * ease, solved here by cases. No modes, no proximal
shift, no recursion.
"""

import numpy as np

from tests.reference.dense import Real


def scalar(free: float, ease: float, lower: float, upper: float) -> float:
    """Impulse with which ``free + ease * impulse`` obeys the law; it falls with the rate."""
    return (min(max(free, lower), upper) - free) / ease


def rates_after(matrix: Real, w: Real, lower: Real, upper: Real) -> tuple[Real, Real]:
    """Rates (n,) after an impact and impulses (n,) of the joints.

    Parameters
    ----------
    matrix : (n, n) mass matrix
    w : (n,) rates before
    lower, upper : (n,) lowest and highest relative rates after
    """
    n = w.size
    relative = np.eye(n) - np.eye(n, k=-1)
    inverse = np.linalg.inv(matrix)
    ease = relative @ inverse @ relative.T
    free = relative @ w
    found = np.zeros(n)
    for _ in range(200_000):
        worst = 0.0
        for i in range(n):
            rest = free[i] + ease[i] @ found - ease[i, i] * found[i]
            new = scalar(rest, ease[i, i], lower[i], upper[i])
            worst, found[i] = max(worst, abs(new - found[i]) * ease[i, i]), new
        if worst < 1e-13 * (1.0 + np.abs(free).max()):
            return w + inverse @ relative.T @ found, found
    raise RuntimeError("no convergence")
