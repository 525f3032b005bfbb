"""Shooting: change the moves of the arm until a simulated flight does what is required.

Steps of Levenberg and Marquardt with differences of flights. Flights are simulated in batches, so each step is tried
with several dampings at once.
"""

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array

DAMPING = np.geomspace(1e-4, 2.5, 8)  # relative to the greatest singular value of the Jacobian
LONGEST = 0.6  # change of a parameter in a step, in its scale
LESS = 0.8  # of the residuals, that a step must leave at most for another one


class Shot(Protocol):
    """What is reduced to 0 after some moves, the residuals (m,), at time t, s."""

    @property
    def t(self) -> float:
        """Time at which the residuals count, s."""

    @property
    def residuals(self) -> Array:
        """Residuals (m,)."""


ShotT = TypeVar("ShotT", bound=Shot)


def shoot(
    best: ShotT,
    scale: Array,
    fly: Callable[[ShotT, Sequence[Array], Sequence[float]], list[ShotT | None]],
    rounds: int,
    difference: float,
    budget: Budget,
    close: float = 0.0,
) -> tuple[ShotT, list[ShotT]]:
    """Reduce the residuals of a shot; return the best one, and those at its differences.

    Parameters
    ----------
    best : Shot
        To begin with.
    scale : (P,) float64
        Scales of the parameters; only their ratios and `difference`, in scales, count.
    fly : callable
        Returns what becomes of a shot whose parameters change by some of (P,), and its time by about so much, s; None
        for one without residuals.
    rounds : int
        Steps, at most.
    close : float
        Norm of the residuals at which the search ends.
    """
    stalled = False
    for left in range(rounds, -1, -1):
        near = fly(best, list(np.diag(difference * scale)), [0.0] * scale.size)
        varied = [each or best for each in near]
        if left == 0 or stalled or np.linalg.norm(best.residuals) < close:
            break
        budget.check()
        jacobian = np.array([each.residuals - best.residuals for each in varied]).T / difference
        later: Array = np.array([each.t - best.t for each in varied]) / difference
        first, size, second = np.linalg.svd(jacobian, full_matrices=False)
        steps = list[Array]()
        for damping in DAMPING.tolist():
            kept = size / np.maximum(size**2 + (damping * size[0]) ** 2, 1e-300)
            step = -second.T @ (kept * (first.T @ best.residuals))
            steps.append(step / max(1.0, float(np.abs(step).max()) / LONGEST))
        tried = fly(best, [scale * each for each in steps], [float(later @ each) for each in steps])
        better = min((each for each in tried if each), key=lambda one: np.linalg.norm(one.residuals), default=best)
        before, after = (float(np.linalg.norm(each.residuals)) for each in (best, better))
        if after >= before:
            break
        best, stalled = better, after > LESS * before
    return best, varied
