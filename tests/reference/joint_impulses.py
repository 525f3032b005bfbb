"""Impulses of joints with friction and limits, by dense matrices and many small projections.

One joint after the other takes the impulse with which its own law holds, the others given, until nothing moves
(projected Gauss-Seidel): the friction of a joint and its limits form one relation between rate and impulse, solved here
by cases of the scalar problem rate = free + impulse * ease. No modes, no proximal shift, no recursion.
"""

import numpy as np

from tests.reference.dense import Real


def scalar(free: float, ease: float, lower: float, upper: float, bound: float) -> float:
    """Impulse with which ``free + ease * impulse`` obeys the law; it falls with the rate."""
    for rate, low, high in ((upper, -np.inf, -bound if upper > 0.0 else bound), (0.0, -bound, bound)):
        impulse = (rate - free) / ease
        if lower <= rate <= upper and low <= impulse <= high:
            return impulse
    impulse = (lower - free) / ease
    if impulse >= (bound if lower < 0.0 else -bound):
        return impulse
    return -bound if free - ease * bound > 0.0 else bound


def rates_after(
    matrix: Real, impulse: Real, w: Real, bounds: tuple[Real, Real, Real], base: float = 0.0
) -> tuple[Real, Real]:
    """Rates (n,) after a step and impulses (n,) of the joints.

    Parameters
    ----------
    matrix, impulse : (n, n), (n,) mass matrix, with implicit terms if there are any, and what acts beside the joints
    w : (n,) rates before
    bounds : lowest and highest relative rates after, and bound of friction, (n,) each
    base : rate of the parent of the first link after the step
    """
    lower, upper, bound = bounds
    n = w.size
    relative = np.eye(n) - np.eye(n, k=-1)
    inverse = np.linalg.inv(matrix)
    ease = relative @ inverse @ relative.T
    free = relative @ (w + inverse @ impulse)
    free[0] -= base
    found = np.zeros(n)
    for _ in range(200_000):
        worst = 0.0
        for i in range(n):
            rest = free[i] + ease[i] @ found - ease[i, i] * found[i]
            new = scalar(rest, ease[i, i], lower[i], upper[i], bound[i])
            worst, found[i] = max(worst, abs(new - found[i]) * ease[i, i]), new
        if worst < 1e-13 * (1.0 + np.abs(free).max()):
            return w + inverse @ (impulse + relative.T @ found), found
    raise RuntimeError("no convergence")
