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
SHORT = 1.0  # damping above which a step is so much shortened that its own gain says nothing about what is left to gain
ROUGH = 1e-3  # part of the cost that a fit may leave where it stalls: dry friction and bounds make a bottom rough
LEFT = 1e-6  # damping for what the linear model has left to gain: parameters that do not act promise nothing
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
    known: bool = True  # False: no rollout near its state succeeds, and the derivatives are set to 0


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
            promised = _promise(parameters, best, linear)
            damping, free = _improve(plant, parameters, windows, best, linear, damping)
            gain = (before - best.cost) / before if before > 0.0 else 0.0
            best.history.append({"round": number, "cost": best.cost, "gain": gain, "damping": damping})
            if report is not None:
                report(best.history[-1])
            if gain < (enough := min(1e-4, ENOUGH / count)):
                best.converged = free or promised < max(enough, ROUGH) * before
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
        known = True
        others = [other for each in ropes if (other := plant.residual(each, window, state)) is not None]
        if slope is None or len(others) < len(ropes):
            slope = np.zeros((residual.size, state.size))  # a window on the brink: leave it as it is in this round
            others, known = [residual] * len(ropes), False
        shared = np.stack([(other - residual) / s for other, s in zip(others, steps, strict=True)], axis=1)
        result.append(_Linear(slope, shared, known))
    return result


def reduce(slope: Array, shared: Array, residual: Array) -> tuple[Array, Array]:
    """Return parameter derivatives (m n, P) and residual (m n,) less what the window's own state can absorb."""
    basis = np.linalg.qr(slope)[0]
    return shared - basis @ (basis.T @ shared), residual - basis @ (basis.T @ residual)


@dataclass
class _Step:
    """A step of the linear model: of the parameters (P,) and of each window's state (2n,)."""

    shared: Array
    states: list[Array]


def _step(parameters: Parameters, at: Fit, linear: list[_Linear], damping: float) -> _Step:
    """Return the damped step of least squares within the bounds."""
    root = np.sqrt(damping)
    width = np.sqrt(sum((each.shared**2).sum(axis=0) for each in linear)) + 1e-12
    matrix, gradient = np.diag((root * width) ** 2), np.zeros(at.x.size)
    padded = []
    for each, residual in zip(linear, at.residuals, strict=True):
        size = np.sqrt((each.state**2).sum(axis=0)) + 1e-12
        slope = np.vstack([each.state, np.diag(root * size)])
        shared = np.vstack([each.shared, np.zeros((size.size, at.x.size))])
        right = np.append(residual, np.zeros(size.size))
        left, rest = reduce(slope, shared, right)
        matrix += left.T @ left
        gradient += left.T @ rest
        padded.append((slope, shared, right))
    move = _bounded(matrix, gradient, at.x, parameters.lower)
    states = [-np.linalg.lstsq(slope, right + shared @ move, rcond=None)[0] for slope, shared, right in padded]
    return _Step(move, states)


def _promise(parameters: Parameters, at: Fit, linear: list[_Linear]) -> float:
    """Return by how much the cost would fall if the model were linear; inf where no window has derivatives."""
    if not any(each.known for each in linear):
        return float("inf")
    step = _step(parameters, at, linear, LEFT)
    left = 0.0
    for each, residual, state in zip(linear, at.residuals, step.states, strict=True):
        ahead = residual + each.state @ state + each.shared @ step.shared
        left += float(ahead @ ahead)
    return at.cost - left


def _improve(
    plant: Plant, parameters: Parameters, windows: Sequence[Window], best: Fit, linear: list[_Linear], damping: float
) -> tuple[float, bool]:
    """Take one accepted step (or none, when no damping helps); `best` is changed in place.

    Return the damping for the next round, and whether a step was taken that damping did not much shorten.
    """
    before = best.cost
    while damping < MOST_DAMPING:
        step = _step(parameters, best, linear, damping)
        x = best.x + step.shared
        states = [state + move for state, move in zip(best.states, step.states, strict=True)]
        rope = parameters.possible(x)
        residuals = None if rope is None else _residuals(plant, rope, windows, states)
        if residuals is not None and sum(r @ r for r in residuals) <= before:
            best.x, best.states, best.residuals = x, states, residuals
            free = damping <= SHORT and any(each.known for each in linear)
            return max(0.1 * damping, LEAST_DAMPING), free
        damping = max(10.0 * damping, 1e-6)
    return 1e-3, False


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
