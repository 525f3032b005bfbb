"""Output-error shooting: every window has its own initial state, all windows share the parameters.

The states of a window touch only that window's residuals, so each step eliminates them window by window (QR) and
solves a small system for the parameters: cost linear in the number of windows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.identification._parameters import Parameters
from hyperflex.identification._windows import Window
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.simulation import angles

PRECISION = 1e-9  # tolerance of a rollout over the rope's length, far below any measured angle's error
NUDGE = 1e-5  # rad, difference in the initial state for derivatives
LEAST_DAMPING, MOST_DAMPING = 1e-7, 1e10
ENOUGH = 0.1  # gain of a round, in units of the residual variance, below which parameters move by less than their sd
Report = Callable[[dict[str, float]], None]


class Plant:
    """Predicts a window's angles; what the base does is fixed here."""

    def __init__(self, motion: Motion | None, arm: Arm | None) -> None:
        self.motion, self.arm = motion, arm

    def predict(self, rope: Rope, t: Array, state: Array, precision: float = PRECISION) -> Array | None:
        """Return angles (m, n) at times t (m,) from `state` (2n,) at t[0]; None where the rollout fails."""
        n = rope.n_links
        if not np.isfinite(state).all():
            return None
        tol = precision * rope.total_length
        try:
            return angles(rope, t, state[:n], state[n:], motion=self.motion, arm=self.arm, tol=tol)[0]
        except SimulationError:
            return None

    def residual(self, rope: Rope, window: Window, state: Array, precision: float = PRECISION) -> Array | None:
        """Return weighted prediction errors (m n,), 0 in gaps."""
        q = self.predict(rope, window.t, state, precision)
        if q is None or not np.isfinite(q).all():
            return None
        return ((q - window.y) * window.weight).ravel()


@dataclass
class Fit:
    """Where a fit stands: x (P,), one state (2n,) a window, and the residuals (m n,) of each window."""

    x: Array
    states: list[Array]
    residuals: list[Array]
    converged: bool = False
    interrupted: bool = False
    history: list[dict[str, float]] = field(default_factory=list)

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(sum(r @ r for r in self.residuals))


def state_nudges(window: Window, n: int) -> Array:
    """Return differences (2n,): NUDGE in each angle, and rates that come to NUDGE over the window."""
    return np.repeat([NUDGE, NUDGE / (window.t[-1] - window.t[0])], n)


def state_jacobian(plant: Plant, rope: Rope, window: Window, state: Array, residual: Array) -> Array | None:
    """Return d residual / d state (m n, 2n) by forward differences, or None where a rollout fails."""
    nudges = state_nudges(window, rope.n_links)
    columns = []
    for k, nudge in enumerate(nudges):
        moved = state.copy()
        moved[k] += nudge
        other = plant.residual(rope, window, moved)
        if other is None:
            return None
        columns.append((other - residual) / nudge)
    return np.stack(columns, axis=1)


def fit_state(plant: Plant, rope: Rope, window: Window, state: Array, rounds: int = 30) -> tuple[Array, Array] | None:
    """Fit the state at a window's start, parameters fixed (Levenberg-Marquardt).

    Returns
    -------
    state (2n,), residual (m n,), or None where no rollout from `state` succeeds.
    """
    residual = plant.residual(rope, window, state)
    if residual is None:
        return None
    damping = 1e-3
    for _ in range(rounds):
        slope = state_jacobian(plant, rope, window, state, residual)
        if slope is None:
            break
        size = np.sqrt((slope**2).sum(axis=0))
        before = residual @ residual
        while damping < MOST_DAMPING:
            matrix = np.vstack([slope, np.diag(np.sqrt(damping) * size)])
            move = np.linalg.lstsq(matrix, np.append(-residual, np.zeros(state.size)), rcond=None)[0]
            tried = plant.residual(rope, window, state + move)
            if tried is not None and tried @ tried <= before:
                break
            damping = max(10.0 * damping, 1e-6)
        else:
            break
        state, residual, damping = state + move, tried, 0.1 * damping
        if before - residual @ residual <= 1e-8 * before:
            break
    return state, residual


@dataclass
class _Linear:
    """Derivatives of one window: with respect to its state (m n, 2n) and to the parameters (m n, P)."""

    state: Array
    shared: Array


def fit(
    plant: Plant,
    parameters: Parameters,
    windows: Sequence[Window],
    x: Array,
    states: list[Array],
    *,
    rounds: int = 60,
    report: Report | None = None,
) -> Fit:
    """Fit parameters and all states together from first guesses.

    Raises
    ------
    InvalidInput
        When not even the guess can be rolled out.

    Notes
    -----
    Ctrl-C ends the fit; what is returned then is the best so far, marked ``interrupted``.
    """
    residuals = _residuals(plant, parameters.rope(x), windows, states)
    if residuals is None:
        raise InvalidInput("the rope cannot be simulated from the guess", fix="Give a guess nearer to the real one")
    best = Fit(x, states, residuals)
    count = sum(window.values for window in windows)
    damping = 1e-3
    try:
        for number in range(rounds):
            before = best.cost
            linear = _linearise(plant, parameters, windows, best)
            damping = _improve(plant, parameters, windows, best, linear, damping)
            gain = (before - best.cost) / before if before > 0.0 else 0.0
            best.history.append({"round": number, "cost": best.cost, "gain": gain, "damping": damping})
            if report is not None:
                report(best.history[-1])
            if gain < min(1e-4, ENOUGH / count):
                best.converged = True
                break
    except KeyboardInterrupt:
        best.interrupted = True
    return best


def _residuals(plant: Plant, rope: Rope, windows: Sequence[Window], states: Sequence[Array]) -> list[Array] | None:
    """Return all windows' residuals, or None as soon as a rollout fails."""
    result = []
    for window, state in zip(windows, states, strict=True):
        residual = plant.residual(rope, window, state)
        if residual is None:
            return None
        result.append(residual)
    return result


def _linearise(plant: Plant, parameters: Parameters, windows: Sequence[Window], at: Fit) -> list[_Linear]:
    """Return the derivatives of every window by forward differences."""
    rope = parameters.rope(at.x)
    steps = parameters.steps
    ropes = []
    for k in range(len(parameters)):
        moved = at.x.copy()
        moved[k] += steps[k]
        ropes.append(parameters.possible(moved) or rope)
    result = []
    for window, state, residual in zip(windows, at.states, at.residuals, strict=True):
        slope = state_jacobian(plant, rope, window, state, residual)
        others = [other for each in ropes if (other := plant.residual(each, window, state)) is not None]
        if slope is None or len(others) < len(ropes):
            slope = np.zeros((residual.size, state.size))  # a window on the brink: leave it as it is in this round
            others = [residual] * len(ropes)
        shared = np.stack([(other - residual) / s for other, s in zip(others, steps, strict=True)], axis=1)
        result.append(_Linear(slope, shared))
    return result


def reduce(slope: Array, shared: Array, residual: Array) -> tuple[Array, Array]:
    """Return parameter derivatives (m n, P) and residual (m n,) less what the window's own state can absorb."""
    basis = np.linalg.qr(slope)[0]
    return shared - basis @ (basis.T @ shared), residual - basis @ (basis.T @ residual)


def _improve(
    plant: Plant, parameters: Parameters, windows: Sequence[Window], best: Fit, linear: list[_Linear], damping: float
) -> float:
    """Take one accepted step (or none, when no damping helps); `best` is changed in place. Return the damping."""
    lower, before = parameters.lower, best.cost
    sizes = [np.sqrt((each.state**2).sum(axis=0)) + 1e-12 for each in linear]
    width = np.sqrt(sum((each.shared**2).sum(axis=0) for each in linear)) + 1e-12
    while damping < MOST_DAMPING:
        root = np.sqrt(damping)
        matrix, gradient = np.diag((root * width) ** 2), np.zeros(best.x.size)
        padded = []
        for each, size, residual in zip(linear, sizes, best.residuals, strict=True):
            slope = np.vstack([each.state, np.diag(root * size)])
            shared = np.vstack([each.shared, np.zeros((size.size, best.x.size))])
            right = np.append(residual, np.zeros(size.size))
            left, rest = reduce(slope, shared, right)
            matrix += left.T @ left
            gradient += left.T @ rest
            padded.append((slope, shared, right))
        move = _bounded(matrix, gradient, best.x, lower)
        tried = [
            state - np.linalg.lstsq(slope, right + shared @ move, rcond=None)[0]
            for state, (slope, shared, right) in zip(best.states, padded, strict=True)
        ]
        rope = parameters.possible(best.x + move)
        residuals = None if rope is None else _residuals(plant, rope, windows, tried)
        if residuals is not None and sum(r @ r for r in residuals) <= before:
            best.x, best.states, best.residuals = best.x + move, tried, residuals
            return max(0.1 * damping, LEAST_DAMPING)
        damping = max(10.0 * damping, 1e-6)
    return 1e-3


def _bounded(matrix: Array, gradient: Array, x: Array, lower: Array) -> Array:
    """Return the step -matrix^-1 gradient that keeps x >= lower: what would cross stops at its bound, the rest adapts.

    Steps of logarithms and the like are kept below 1 (a factor of e).
    """
    free = (x > lower) | (gradient < 0.0)
    move = np.zeros(x.size)
    for _ in range(x.size):
        held = ~free
        right = gradient[free] + matrix[np.ix_(free, held)] @ move[held]
        move[free] = np.linalg.lstsq(matrix[np.ix_(free, free)], -right, rcond=None)[0]
        crossing = free & (x + move < lower)
        if not crossing.any():
            break
        move[crossing] = lower[crossing] - x[crossing]
        free &= ~crossing
    unbounded = ~np.isfinite(lower)
    largest = float(np.abs(move[unbounded]).max()) if unbounded.any() else 0.0
    return move / max(1.0, largest)
