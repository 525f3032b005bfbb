"""The fit: windows of a recording, losses, and multiple shooting by Levenberg-Marquardt steps.

A recording is cut into windows, short parts with an initial state each. The states of a window touch only that window's
residuals, so each step for parameters and states eliminates them window by window (QR) and solves a small system for
the parameters: cost linear in the number of windows. Derivatives are exact, those of the rollouts themselves.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from statistics import NormalDist
from typing import Any, Literal, get_args

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.model import Plant
from hyperflex.interruption import stoppable
from hyperflex.status import Status

LossName = Literal["squares", "huber", "cauchy"]
LOSSES: tuple[LossName, ...] = get_args(LossName)
# Where large begins, in standard deviations: 95 % as good as squares where there are no outliers (Holland and Welsch
# 1977, doi:10.1080/03610927708827533)
TUNING = {"squares": 1.0, "huber": 1.345, "cauchy": 2.385}
NORMAL = 1.0 / NormalDist().inv_cdf(
    0.75
)  # standard deviation over the median of absolute values, of a normal distribution


@dataclass(frozen=True)
class Loss:
    """Costs and weights of residuals; `scale` is their standard deviation without the outliers."""

    name: LossName = "squares"
    scale: float = 1.0
    fixed: bool = False

    def scaled(self, residuals: Sequence[Array]) -> "Loss":
        """Return the same loss with the scale that these residuals show, unless it is fixed."""
        if self.name == "squares" or self.fixed:
            return self
        sizes = np.abs(np.concatenate(residuals)) if residuals else np.zeros(0)
        sizes = sizes[sizes > 0.0]
        return Loss(self.name, max(NORMAL * float(np.median(sizes)), 1e-300) if sizes.size else 1.0)

    @property
    def limit(self) -> float:
        """Where large residuals begin."""
        return TUNING[self.name] * self.scale

    def rho(self, residual: Array) -> tuple[Array, Array, Array]:
        """Return the loss of z = (residual / limit)^2 and its first two derivatives by z, as scipy's least_squares."""
        z = (residual / self.limit) ** 2
        if self.name == "squares":
            return z, np.ones_like(z), np.zeros_like(z)
        if self.name == "cauchy":
            return np.log1p(z), 1.0 / (1.0 + z), -1.0 / (1.0 + z) ** 2
        small, large = z <= 1.0, np.maximum(z, 1.0)
        return np.where(small, z, 2.0 * np.sqrt(z) - 1.0), large**-0.5, np.where(small, 0.0, -0.5 * large**-1.5)

    def cost(self, residual: Array) -> float:
        """Return what residuals (m,) cost: their squares while they are small."""
        return self.limit**2 * float(self.rho(residual)[0].sum())

    def weight(self, residual: Array) -> Array:
        """Return the roots of the weights (m,) that make squares of these costs (iterated least squares)."""
        return np.sqrt(self.rho(residual)[1])

    def influence(self, residual: Array) -> Array:
        """Return psi (m,), half the slope of the cost: the residuals themselves while they are small."""
        return self.rho(residual)[1] * residual

    def sensitivity(self, residual: Array) -> Array:
        """Return d psi / d residual (m,): 1 while residuals are small."""
        _, first, second = self.rho(residual)
        return first + 2.0 * (residual / self.limit) ** 2 * second


def averaged(values: Array, t: Array, spread: Array | None) -> Array:
    """Return values (m, ...) of a motion at times t (m,), s, as means over samples about these; see `Window.spread`.

    Its curvature is by differences of neighbours. That of measured values would be noise, and colour the residuals.
    """
    if spread is None or t.size < 3:
        return values
    shape = (-1, *[1] * (values.ndim - 1))
    step = np.diff(t).reshape(shape)
    bend = 2.0 * np.diff(np.diff(values, axis=0) / step, axis=0) / (step[1:] + step[:-1])
    return np.asarray(values + spread.reshape(shape) * np.concatenate([bend[:1], bend, bend[-1:]]))


@dataclass(frozen=True)
class Window:
    """Measurements over a short time, with a first guess of the state.

    t (m,) s; y (m, C) rad or m, with 0 in gaps; weight (m, C), 1 / rad or 1 / m, 0 in gaps; guess (2n,) of the state at
    t[0]; prior (r, 2n): linear combinations of the state that are 0, in units of their standard deviations. others:
    further guesses, of shapes that look alike. spread (m,), s^2: half the mean square time from t of the samples whose
    mean a value is.
    """

    t: Array
    y: Array
    weight: Array
    guess: Array
    prior: Array
    others: tuple[Array, ...] = ()
    spread: Array | None = None

    @property
    def values(self) -> int:
        """Number of measured values, gaps left out."""
        return int(np.count_nonzero(self.weight))

    @property
    def unknowns(self) -> int:
        """Size of the state, less the rows of the prior."""
        return int(self.guess.size - self.prior.shape[0])

    @property
    def motion(self) -> Array:
        """Measured values less their means over the window (m, C), 0 in gaps."""
        known = self.weight > 0.0
        return np.where(known, self.y - self.y.sum(axis=0) / np.maximum(known.sum(axis=0), 1), 0.0)

    def residual(self, plant: Plant, x: Array, state: Array) -> Array | None:
        """Return weighted prediction errors (m C,), 0 in gaps; None where the rollout from `state` (2n,) fails."""
        seen = self.predicted(plant, x, state)
        return None if seen is None else ((seen - self.y) * self.weight).ravel()

    def predicted(self, plant: Plant, x: Array, state: Array) -> Array | None:
        """Return the predicted values (m, C); None where the rollout from `state` (2n,) fails."""
        seen = plant.predict(x, self.t, state)
        return None if seen is None else averaged(seen, self.t, self.spread)

    def prior_cost(self, state: Array) -> float:
        """Return the sum of squares of a state's residuals under the prior."""
        return float(np.sum((self.prior @ state) ** 2))


# part of the motion that a fit may leave: right fits of real pendulums leave 0.1 to 1 %
POOR = 0.05


def part_left(windows: Sequence[Window], residuals: Sequence[Array], loss: Loss) -> float:
    """Return the residuals [(m C,), ..] as a part of the motion about each window's mean, rms of both; inf without.

    A robust loss counts outliers, which are no part of the motion, as little as the fit does.
    """
    left = sum(map(loss.cost, residuals))
    moved = sum(float(((window.motion * window.weight) ** 2).sum()) for window in windows)
    return float(np.sqrt(left / moved)) if moved > 0.0 else np.inf


DAMPING = 1e-3  # of the first step
LEAST_DAMPING, MOST_DAMPING = 1e-7, 1e10
# gain of a round, in units of the residual variance, below which parameters move by less than their std
ENOUGH = 0.1
# gain of a round, as a part of the cost, that ends a fit after which others come
HARDLY = 0.01
# part of the cost that a fit may leave where it stalls: dry friction and bounds make a bottom rough
ROUGH = 1e-5
# part of the motion: less is as exact as the simulation itself, whose rounding makes a bottom rough
EXACT = 1e-6
# rounds that hardly gain, though the linear model promises more, before a fit gives up
STALLS = 5
# in scales: farther above its bound a parameter falls by no more than this part of the way
NEAR = 0.01
FALL = 0.7
Report = Callable[[dict[str, Any]], None]


def with_entries(report: Report, entries: dict[str, Any]) -> Report:
    """Return a report that adds entries to those of each round."""
    return lambda entry: report(entry | entries)


@dataclass(frozen=True)
class Fit:
    """State of a fit: x (P,), one state (2n,) a window, and the residuals (m C,) of each window."""

    x: Array
    states: list[Array]
    residuals: list[Array]
    loss: Loss = field(default_factory=Loss)
    prior_cost: float = 0.0  # sum of squares of the residuals of the states' prior, and of a target
    expected: float = 0.0  # the same of what is known of x beforehand, in standard deviations
    noise: float = 1.0  # standard deviation of the residuals, which makes these comparable
    converged: bool = False
    status: Status | None = None  # why it ended early; None if it did not
    history: tuple[dict[str, float], ...] = ()

    @property
    def cost(self) -> float:
        """Sum of squares, or of what the loss makes of them."""
        return sum(self.loss.cost(r) for r in self.residuals) + self.prior_cost + self.noise**2 * self.expected

    def scaled(self) -> "Fit":
        """Return the same with the scale of the loss, and the noise, that the residuals show."""
        loss = self.loss.scaled(self.residuals)
        count = sum(np.count_nonzero(each) for each in self.residuals)
        square = sum(loss.cost(each) for each in self.residuals) / max(count, 1)
        return replace(self, loss=loss, noise=float(np.sqrt(square)))


def residuals_of(windows: Sequence[Window], fit: Fit) -> Array:
    """Return measured less fitted channels (m, C) of all windows, rad or m, a torque last, N m; NaN in gaps."""
    weights = np.concatenate([window.weight for window in windows])
    away = -np.concatenate(fit.residuals).reshape(weights.shape)
    return np.asarray(np.divide(away, weights, out=np.full_like(away, np.nan), where=weights > 0.0))


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
    """Return a window's linear model at its residual (m C,); of means its derivatives are those at their times."""
    weight = loss.weight(residual)
    seen = plant.jacobian(x, window.t, state)
    if seen is None:  # a window on the brink: leave it as it is in this round
        size = residual.size
        return Linear(np.zeros((size, state.size)), np.zeros((size, x.size)), weight * residual, known=False)
    scale = (weight * window.weight.ravel())[:, None]
    by_state, shared = (scale * slope.reshape(residual.size, -1) for slope in (seen.state, seen.shared))
    prior = window.prior
    return Linear(
        np.vstack([by_state, prior]),
        np.vstack([shared, np.zeros((len(prior), x.size))]),
        np.append(weight * residual, prior @ state),
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
    target: Target | None = None,
) -> Fit:
    """Fit parameters and all states together, or the states alone, from first guesses.

    A `target` counts as one residual more. Out of time it returns the best so far. It ends with a round that gains less
    than the part `enough` of the cost; by default less than parameters move by chance.

    Raises
    ------
    Interrupted
        By Ctrl-C, with the best so far.
    InvalidInput
        When the guess cannot be simulated.
    """
    budget, problem = budget or Budget(), _Problem(plant, windows, target, states_only)
    best = problem.evaluated(x, states, loss or Loss())
    if best is None:
        raise InvalidInput("the rope cannot be simulated from the guess", fix="Give a guess nearer to the real one")
    least = min(1e-4, ENOUGH / sum(window.values for window in windows)) if enough is None else enough
    damping, stalled, converged, history = DAMPING, 0, False, list[dict[str, float]]()
    with stoppable() as stop:
        for number in range(rounds):
            budget.check()
            best = best.scaled()
            before, linear = best.cost, problem.linear(best)
            promised = problem.predicted_decrease(best, linear)
            start, tried = best, damping
            best, damping, free = problem.improved(start, linear, tried)
            gain = (before - best.cost) / before if before > 0.0 else 0.0
            history.append({"round": number, "cost": best.cost, "gain": gain, "damping": damping})
            if report is not None:
                report(history[-1])
            stalled = stalled + 1 if gain < least else 0
            # of a step that promised much and gained nothing another round may make more
            settled = promised < max(least, HARDLY if free else ROUGH) * before or (free and stalled > 1)
            converged = stalled > 0 and (settled or part_left(windows, best.residuals, best.loss) < EXACT)
            if converged or stalled == STALLS or (best is start and tried <= DAMPING):  # the next would be the same
                break
    return stop.deliver(replace(best, converged=converged, status=stop.status, history=tuple(history)))


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

    Of several `starts` the one counts that ends with the least cost. It ends as :func:`fit` does.
    """
    fits = list[Fit]()
    for start in starts:
        with suppress(InvalidInput):
            fits.append(fit(plant, [window], x, [start], loss=loss, states_only=True, rounds=rounds, enough=enough))
    found = min(fits, key=lambda each: each.cost, default=None)
    return None if found is None else (found.states[0], found.residuals[0])


def least_squares(matrix: Array, right: Array) -> Array:
    """Return the minimum-norm solution (k,) of a least-squares problem (m, k), (m,)."""
    return np.linalg.lstsq(matrix, right, rcond=None)[0].astype(np.float64, copy=False)


@dataclass(frozen=True)
class _Problem:
    """What is fitted: windows and a target, by the parameters (P of them; none with `states_only`) and states."""

    plant: Plant
    windows: Sequence[Window]
    target: Target | None
    states_only: bool

    @property
    def lower(self) -> Array:
        """Bounds of the parameters (P,)."""
        return np.empty(0) if self.states_only else self.plant.parameters.lower

    def evaluated(self, x: Array, states: list[Array], loss: Loss, noise: float = 1.0) -> Fit | None:
        """Return a fit with all windows' residuals, or None as soon as a rollout fails."""
        residuals: list[Array] = []
        prior_cost = 0.0 if self.target is None else self.target.residual(x) ** 2
        for window, state in zip(self.windows, states, strict=True):
            residual = window.residual(self.plant, x, state)
            if residual is None:
                return None
            residuals.append(residual)
            prior_cost += window.prior_cost(state)
        expected = 0.0 if self.states_only else float((self.plant.parameters.prior_residual(x) ** 2).sum())
        return Fit(x, states, residuals, loss, prior_cost, expected, noise)

    def linear(self, at: Fit) -> list[Linear]:
        """Return the linear models of all windows, and those of the target and of the prior: rows without a state."""
        found = [
            linearise(self.plant, window, at.x, state, residual, at.loss)
            for window, state, residual in zip(self.windows, at.states, at.residuals, strict=True)
        ]
        if (target := self.target) is not None:
            row = target.weight * target.gradient(at.x)
            found.append(Linear(np.zeros((1, 0)), row[None, :], np.array([target.residual(at.x)])))
        prior = self.plant.parameters.prior
        if len(prior):
            left = at.noise * self.plant.parameters.prior_residual(at.x)
            found.append(Linear(np.zeros((len(prior), 0)), at.noise * prior, left))
        if self.states_only:
            found = [Linear(each.state, each.shared[:, :0], each.residual, each.known) for each in found]
        return [each.compact() for each in found]

    def step(self, at: Fit, linear: Sequence[Linear], damping: float) -> tuple[Array, list[Array]]:
        """Return the damped Gauss-Newton step of parameters (P,), within bounds, and of each window's state (2n,)."""
        root, lower = np.sqrt(damping), self.lower
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

    def predicted_decrease(self, at: Fit, linear: Sequence[Linear]) -> float:
        """Return the decrease of the squares that the linear model predicts; inf where no window has derivatives."""
        shared, states = self.step(at, linear, LEAST_DAMPING)  # parameters that do not act promise nothing
        ahead = [
            each.residual + each.state @ own + each.shared @ shared for each, own in zip(linear, states, strict=True)
        ]
        known = any(each.known for each in linear)
        gains = (each.residual @ each.residual - left @ left for each, left in zip(linear, ahead, strict=True))
        return float(sum(gains)) if known else np.inf

    def improved(self, at: Fit, linear: Sequence[Linear], damping: float) -> tuple[Fit, float, bool]:
        """Return the fit after an accepted step (`at` itself, if no damping helps) and the damping for the next round.

        And whether the step was hardly shortened by the damping.
        """
        while damping < MOST_DAMPING:
            shared, moves = self.step(at, linear, damping)
            states = [state + move for state, move in zip(at.states, moves, strict=False)]  # a target has none
            tried = self.evaluated(at.x if self.states_only else at.x + shared, states, at.loss, at.noise)
            if tried is not None and tried.cost <= at.cost:
                free = damping <= 1.0 and any(each.known for each in linear)  # else its gain says nothing
                return tried, max(0.1 * damping, LEAST_DAMPING), free
            damping = max(10.0 * damping, 1e-6)
        return at, DAMPING, False


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
    above = x - lower
    far = above > NEAR
    room = np.where(np.isinf(lower), 1.0, FALL * above)[far]
    steps = np.where(np.isinf(lower), np.abs(move), -move)[far]
    return move / max(1.0, float(np.max(steps / room, initial=0.0)))
