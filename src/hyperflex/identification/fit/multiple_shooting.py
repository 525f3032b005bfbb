"""Multiple shooting: Levenberg-Marquardt steps for parameters and each window's state.

The states of a window touch only that window's residuals, so each step eliminates them window by window (QR) and
solves a small system for the parameters: cost linear in the number of windows. Derivatives are exact, those of the
rollouts themselves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.windows import Window
from hyperflex.identification.model.plant import Plant
from hyperflex.interruption import stoppable
from hyperflex.status import Status

LEAST_DAMPING = 1e-07
MOST_DAMPING = 10000000000.0
# gain of a round, in units of the residual variance, below which parameters move by less than their std
ENOUGH = 0.1
# damping above which a step is so much shortened that its own gain says nothing about what is left to gain
SHORT_DAMPING = 1.0
# gain of a round, as a part of the cost, that ends a fit after which others come
HARDLY = 0.01
# part of the cost that a fit may leave where it stalls: dry friction and bounds make a bottom rough
ROUGH = 1e-05
# rounds that hardly gain, though the linear model promises more, before a fit gives up
STALLS = 5
# in scales: farther above its bound a parameter falls by no more than this part of the way
NEAR = 0.01
FALL = 0.7
# for the predicted decrease: parameters that do not act promise nothing
PREDICTION_DAMPING = 1e-06
# rounds after which one of several states is preferred
SKETCH = 6
Report = Callable[[dict[str, Any]], None]


def with_entries(report: Report, entries: dict[str, Any]) -> Report:
    """Return a report that adds entries to those of each round."""
    return lambda entry: report(entry | entries)


@dataclass
class Fit:
    """State of a fit: x (P,), one state (2n,) a window, and the residuals (m C,) of each window."""

    x: Array
    states: list[Array]
    residuals: list[Array]
    loss: Loss = field(default_factory=Loss)
    prior_cost: float = 0.0  # sum of squares of the residuals of the states' prior, and of a target
    converged: bool = False
    status: Status | None = None  # why it ended early; None if it did not
    history: list[dict[str, float]] = field(default_factory=list)

    @property
    def cost(self) -> float:
        """Sum of squares, or of what the loss makes of them."""
        return sum(self.loss.cost(r) for r in self.residuals) + self.prior_cost

    def window_cost(self, window: Window, state: Array, residual: Array) -> float:
        """Return the cost of a window from `state` (2n,) with residual (m C,)."""
        return self.loss.cost(residual) + window.prior_cost(state)


@dataclass(frozen=True)
class Target:
    """A value that a function of x (P,) is drawn to: one residual more, the difference times `weight`.

    Where all residuals together are least, those of the data are the least of all x with the function's value there,
    whatever the weight is: a point of the function's profile likelihood.
    """

    function: Callable[[Array], float]
    gradient: Callable[[Array], Array]
    value: float
    weight: float

    def residual(self, x: Array) -> float:
        """Return the weighted difference."""
        return self.weight * (self.function(x) - self.value)

    def linear(self, x: Array) -> "Linear":
        """Return its linear model: one row, without a state."""
        row = self.weight * self.gradient(x)
        return Linear(np.zeros((1, 0)), row[None, :], np.array([self.residual(x)]))


@dataclass(frozen=True)
class Linear:
    """One window's residuals (M,), weighted, and their derivatives: by its state (M, 2n), by the parameters (M, P)."""

    state: Array
    shared: Array
    residual: Array
    known: bool = True  # False: no rollout from its state succeeds, and the derivatives are 0

    def compact(self) -> "Linear":
        """Return the same least-squares problem in as few rows as possible."""
        width = self.state.shape[1]
        both = np.column_stack([self.state, self.shared, self.residual])
        rows: Array = np.asarray(np.linalg.qr(both, mode="r"))
        return Linear(rows[:, :width], rows[:, width:-1], rows[:, -1], self.known)

    def reduced(self) -> tuple[Array, Array]:
        """Return parameter derivatives (M, P) and residuals (M,), projected off the window's own state."""
        basis = np.linalg.qr(self.state)[0]
        return self.shared - basis @ (basis.T @ self.shared), self.residual - basis @ (basis.T @ self.residual)


def linearise(plant: Plant, window: Window, x: Array, state: Array, residual: Array, loss: Loss) -> Linear:
    """Return a window's linear model at its residual (m C,)."""
    weight = loss.weight(residual)
    seen = plant.jacobian(x, window.t, state)
    prior = window.prior @ state
    if seen is None:  # a window on the brink: leave it as it is in this round
        size = residual.size
        return Linear(np.zeros((size, state.size)), np.zeros((size, x.size)), weight * residual, known=False)
    scale = (weight * window.weight.ravel())[:, None]
    by_state, shared = (scale * slope.reshape(residual.size, -1) for slope in (seen.state, seen.shared))
    if prior.size == 0:
        return Linear(by_state, shared, weight * residual)
    return Linear(
        np.vstack([by_state, window.prior]),
        np.vstack([shared, np.zeros((prior.size, x.size))]),
        np.append(weight * residual, prior),
    )


def fit(
    plant: Plant,
    windows: Sequence[Window],
    x: Array,
    states: list[Array],
    *,
    loss: Loss | None = None,
    states_only: bool = False,
    rounds: int = 60,
    enough: float | None = None,
    budget: Budget | None = None,
    report: Report | None = None,
    held: Sequence[int] = (),
    target: Target | None = None,
) -> Fit:
    """Fit parameters and all states together, or the states alone, from first guesses; parameters `held` stay.

    A `target` counts as one residual more. Out of time it returns the best so far. It ends with a round that gains less
    than the part `enough` of the cost; by default less than parameters move by chance.

    Raises
    ------
    Interrupted
        By Ctrl-C, with the best so far.
    OutOfTime
        If the time was over before it began.
    InvalidInput
        When the guess cannot be simulated.
    """
    loss, budget = loss or Loss(), budget or Budget()
    budget.check()
    best = _evaluated(plant, windows, x, states, loss, target)
    if best is None:
        raise InvalidInput("the rope cannot be simulated from the guess", fix="Give a guess nearer to the real one")
    count = sum(window.values for window in windows)
    lower = np.empty(0) if states_only else plant.parameters.lower
    least = min(1e-4, ENOUGH / count) if enough is None else enough
    damping, stalled = 1e-3, 0
    with stoppable() as stop:
        for number in range(rounds):
            budget.check()
            best.loss = best.loss.scaled(best.residuals)
            before = best.cost
            linear = [
                linearise(plant, *each, best.loss)
                for each in zip(windows, [best.x] * len(windows), best.states, best.residuals, strict=True)
            ]
            if target is not None:
                linear.append(target.linear(best.x))
            for each in linear:
                each.shared[:, list(held)] = 0.0
            if states_only:
                linear = [Linear(each.state, each.shared[:, :0], each.residual, each.known) for each in linear]
            linear = [each.compact() for each in linear]
            promised = _predicted_decrease(best, linear, lower)
            damping, free = _improve(plant, windows, best, linear, lower, damping, target)
            gain = (before - best.cost) / before if before > 0.0 else 0.0
            best.history.append({"round": number, "cost": best.cost, "gain": gain, "damping": damping})
            if report is not None:
                report(best.history[-1])
            stalled = stalled + 1 if gain < least else 0
            best.converged = stalled > 0 and (free or promised < max(least, ROUGH) * before)
            if best.converged or stalled == STALLS:
                break
    best.status = stop.status
    return stop.deliver(best)


def fit_state(
    plant: Plant,
    x: Array,
    window: Window,
    *starts: Array,
    loss: Loss | None = None,
    rounds: int = 30,
    enough: float | None = None,
) -> tuple[Array, Array] | None:
    """Return the fitted state (2n,) at a window's start and its residual (m C,), parameters fixed; None on failure.

    Of several `starts` the one goes on that a few rounds bring farthest. It ends as :func:`fit` does.
    """

    def fitted(start: Array, rounds: int) -> Fit | None:
        try:
            return fit(plant, [window], x, [start], loss=loss, states_only=True, rounds=rounds, enough=enough)
        except InvalidInput:
            return None

    sketches = [fitted(start, SKETCH if len(starts) > 1 else rounds) for start in starts]
    found = min((each for each in sketches if each is not None), key=lambda each: each.cost, default=None)
    if found is not None and len(starts) > 1 and not found.converged:
        found = fitted(found.states[0], rounds) or found
    return None if found is None else (found.states[0], found.residuals[0])


def _evaluated(
    plant: Plant, windows: Sequence[Window], x: Array, states: list[Array], loss: Loss, target: Target | None
) -> Fit | None:
    """Return a fit with all windows' residuals, or None as soon as a rollout fails."""
    residuals: list[Array] = []
    prior_cost = 0.0 if target is None else target.residual(x) ** 2
    for window, state in zip(windows, states, strict=True):
        residual = plant.residual(x, window, state)
        if residual is None:
            return None
        residuals.append(residual)
        prior_cost += window.prior_cost(state)
    return Fit(x, states, residuals, loss, prior_cost)


def _step(at: Fit, linear: Sequence[Linear], lower: Array, damping: float) -> tuple[Array, list[Array]]:
    """Return the damped Gauss-Newton step of parameters (P,), within bounds, and of each window's state (2n,)."""
    root = np.sqrt(damping)
    width = np.sqrt(sum((each.shared**2).sum(axis=0) for each in linear)) + 1e-12
    matrix, gradient = np.diag((root * width) ** 2), np.zeros(lower.size)
    padded = []
    for each in linear:
        size = np.sqrt((each.state**2).sum(axis=0)) + 1e-12
        wide = Linear(
            np.vstack([each.state, np.diag(root * size)]),
            np.vstack([each.shared, np.zeros((size.size, lower.size))]),
            np.append(each.residual, np.zeros(size.size)),
        )
        left, rest = wide.reduced()
        matrix += left.T @ left
        gradient += left.T @ rest
        padded.append(wide)
    move = _bounded(matrix, gradient, at.x[: lower.size], lower)
    return move, [-least_squares(each.state, each.residual + each.shared @ move) for each in padded]


def least_squares(matrix: Array, right: Array) -> Array:
    """Return the minimum-norm solution (k,) of a least-squares problem (m, k), (m,)."""
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0].astype(np.float64, copy=False))


def _predicted_decrease(at: Fit, linear: Sequence[Linear], lower: Array) -> float:
    """Return the decrease of the squares that the linear model predicts; inf where no window has derivatives."""
    if not any(each.known for each in linear):
        return float("inf")
    shared, states = _step(at, linear, lower, PREDICTION_DAMPING)
    gained = 0.0
    for each, state in zip(linear, states, strict=True):
        ahead = each.residual + each.state @ state + each.shared @ shared
        gained += float(each.residual @ each.residual - ahead @ ahead)
    return gained


def _improve(
    plant: Plant,
    windows: Sequence[Window],
    best: Fit,
    linear: Sequence[Linear],
    lower: Array,
    damping: float,
    target: Target | None,
) -> tuple[float, bool]:
    """Take one accepted step (or none, when no damping helps); `best` is changed in place.

    Return the damping for the next round, and whether a step was taken that damping hardly shortened.
    """
    before = best.cost
    while damping < MOST_DAMPING:
        shared, moves = _step(best, linear, lower, damping)
        x = best.x + shared if lower.size else best.x
        states = [state + move for state, move in zip(best.states, moves[: len(windows)], strict=True)]
        tried = _evaluated(plant, windows, x, states, best.loss, target)
        if tried is not None and tried.cost <= before:
            best.x, best.states, best.residuals, best.prior_cost = x, states, tried.residuals, tried.prior_cost
            free = damping <= SHORT_DAMPING and any(each.known for each in linear)
            return max(0.1 * damping, LEAST_DAMPING), free
        damping = max(10.0 * damping, 1e-6)
    return 1e-3, False


def _bounded(matrix: Array, gradient: Array, x: Array, lower: Array) -> Array:
    """Return the step -matrix^-1 gradient that keeps x >= lower (active set).

    Steps of logarithms and the like are kept below 1 (a factor of e); x far above its bound approaches it gradually,
    since the linear model of a far point says little about the bound.
    """
    free = (x > lower) | (gradient < 0.0)
    move = np.zeros(x.size)
    for _ in range(x.size):
        held = ~free
        right = gradient[free] + matrix[np.ix_(free, held)] @ move[held]
        move[free] = least_squares(matrix[np.ix_(free, free)], -right)
        crossing = free & (x + move < lower)
        if not crossing.any():
            break
        move[crossing] = lower[crossing] - x[crossing]
        free &= ~crossing
    unbounded = ~np.isfinite(lower)
    longest = float(np.abs(move[unbounded]).max()) if unbounded.any() else 0.0
    above = x - lower
    far = ~unbounded & (above > NEAR)
    falling = float((-move[far] / (FALL * above[far])).max()) if far.any() else 0.0
    return move / max(1.0, longest, falling)
