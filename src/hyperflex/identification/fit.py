"""The fit: windows of a recording, losses, and multiple shooting by Levenberg-Marquardt steps.

A recording is cut into windows, short parts with an initial state each. The states of a window touch only that window's
residuals, so each step for parameters and states eliminates them window by window (QR) and solves a small system for
the parameters: cost linear in the number of windows. Derivatives are exact, those of the rollouts themselves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.model import Plant
from hyperflex.interruption import stoppable
from hyperflex.model import Rope
from hyperflex.recording import Recording
from hyperflex.status import Status

LossName = Literal["squares", "huber", "cauchy"]
LOSSES: tuple[LossName, ...] = ("squares", "huber", "cauchy")
# Where large begins, in standard deviations: 95 % as good as squares where there are no outliers (Holland and Welsch
# 1977, doi:10.1080/03610927708827533)
TUNING = {"huber": 1.345, "cauchy": 2.385}
NORMAL = 1.4826  # standard deviation over the median of absolute values, of a normal distribution


class Loss:
    """Costs and weights of residuals; `scale` is their standard deviation without the outliers."""

    def __init__(self, name: LossName = "squares", scale: float = 1.0, *, fixed: bool = False) -> None:
        self.name, self.scale, self.fixed = name, scale, fixed

    def scaled(self, residuals: Sequence[Array]) -> "Loss":
        """Return the same loss with the scale that these residuals show, unless it is fixed."""
        if self.name == "squares" or self.fixed:
            return self
        sizes = np.abs(np.concatenate(residuals))
        sizes = sizes[sizes > 0.0]
        return Loss(self.name, max(NORMAL * float(np.median(sizes)), 1e-300) if sizes.size else 1.0)

    def cost(self, residual: Array) -> float:
        """Return what residuals (m,) cost: their squares while they are small."""
        if self.name == "squares":
            return float(residual @ residual)
        limit = TUNING[self.name] * self.scale
        if self.name == "cauchy":
            return float(limit**2 * np.log1p((residual / limit) ** 2).sum())
        size = np.abs(residual)
        return float(np.where(size <= limit, size**2, 2.0 * limit * size - limit**2).sum())

    def weight(self, residual: Array) -> Array:
        """Return the roots of the weights (m,) that make squares of these costs (iterated least squares)."""
        if self.name == "squares":
            return np.ones(residual.size)
        ratio = np.abs(residual) / (TUNING[self.name] * self.scale)
        weight = 1.0 / (1.0 + ratio**2) if self.name == "cauchy" else 1.0 / np.maximum(ratio, 1.0)
        return np.sqrt(weight)

    def influence(self, residual: Array) -> Array:
        """Return psi (m,), half the slope of the cost: the residuals themselves while they are small."""
        return np.asarray(self.weight(residual) ** 2 * residual)

    def sensitivity(self, residual: Array) -> Array:
        """Return d psi / d residual (m,): 1 while residuals are small."""
        if self.name == "squares":
            return np.ones(residual.size)
        ratio = np.abs(residual) / (TUNING[self.name] * self.scale)
        if self.name == "cauchy":
            return np.asarray((1.0 - ratio**2) / (1.0 + ratio**2) ** 2)
        return np.where(ratio <= 1.0, 1.0, 0.0)


# samples a window; more of them repeat what their neighbours say and only cost time
DENSEST = 200
# samples a window, where the recording allows it
FEWEST_SAMPLES = 8
# values of each link's angle in a window, ten for each unknown of its state, where the recording allows it
FEWEST_SEEN = 20
# periods
PERIODS = 1.2
# rad a link may turn within a window, as rms rate times time: beyond it fits find false minima
MOST_TURN = 8.0
# part of a window for which a link may be out of sight
BLIND = 0.5
# values of a link's angle in a window
LEAST_VALUES = 4
# rad by which a shape must differ from another to be a start of its own
ASIDE = 0.3
# of weighted least squares that come near to least absolute errors
ABSOLUTE_ROUNDS = 8
# rad, a recording that moves less holds no dynamics
STILL = 0.001
WEIGHTLESS = 1.0  # s, taken for the period of a swing where nothing pulls


@dataclass(frozen=True)
class Window:
    """Measurements over a short time, with a first guess of the state.

    t (m,) s; y (m, C) rad or m, with 0 in gaps; weight (m, C), 1 / rad or 1 / m, 0 in gaps; guess (2n,) of the state at
    t[0]; prior (r, 2n): linear combinations of the state that are 0, in units of their standard deviations. others:
    further guesses, of shapes that look alike.
    """

    t: Array
    y: Array
    weight: Array
    guess: Array
    prior: Array
    others: tuple[Array, ...] = ()

    @property
    def values(self) -> int:
        """Number of measured values, gaps left out."""
        return int(np.count_nonzero(self.weight))

    @property
    def unknowns(self) -> int:
        """Size of the state, less the rows of the prior."""
        return int(self.guess.size - self.prior.shape[0])

    def residual(self, plant: Plant, x: Array, state: Array) -> Array | None:
        """Return weighted prediction errors (m C,), 0 in gaps; None where the rollout from `state` (2n,) fails."""
        seen = plant.predict(x, self.t, state)
        return None if seen is None else ((seen - self.y) * self.weight).ravel()

    def prior_cost(self, state: Array) -> float:
        """Return the sum of squares of a state's residuals under the prior."""
        residual = self.prior @ state
        return float(residual @ residual)


def part_left(windows: Sequence[Window], residuals: Sequence[Array]) -> float:
    """Return the residuals [(m C,), ..] as a part of the motion about each window's mean, rms of both; inf without."""
    left, moved = 0.0, 0.0
    for window, residual in zip(windows, residuals, strict=True):
        known = window.weight > 0.0
        left += float((residual**2).sum())
        mean = (window.weight * window.y).sum(axis=0) / np.maximum(window.weight.sum(axis=0), 1e-300)
        moved += float(((np.where(known, window.y - mean, 0.0) * window.weight) ** 2).sum())
    return float(np.sqrt(left / moved)) if moved > 0.0 else np.inf


def swing_period(rope: Rope) -> float:
    """Return the period, s, of a small swing of a straight rod as long as the rope; inf without gravity."""
    gravity = float(np.hypot(*rope.gravity))
    return 2.0 * np.pi * float(np.sqrt(2.0 * rope.total_length / (3.0 * gravity))) if gravity > 0.0 else np.inf


def usual_length(recording: Recording, rope: Rope, fewest: int = FEWEST_SEEN) -> float:
    """Return a window length (s): some periods of a small swing of a rod as long as the rope, less for fast links.

    It is doubled until it holds ``FEWEST_SEEN`` values of each link.
    """
    period = swing_period(rope) if rope.gravity.any() else WEIGHTLESS
    fastest = max(rms_rate(recording.t, column) for column in recording.data.T)
    spacing = float(np.median(np.diff(recording.t)))
    length = max(min(PERIODS * period, MOST_TURN / max(fastest, 1e-300)), FEWEST_SAMPLES * spacing)
    seen = float((~np.isnan(recording.data)).mean(axis=0).min()) * length / spacing
    return float(length * 2.0 ** np.ceil(np.log2(fewest / seen))) if 0.0 < seen < fewest else length


def rms_rate(t: Array, angle: Array) -> float:
    """Return the rms rate (rad/s) over steps of at least a two-hundredth of the recording or 10 ms, noise left out."""
    known = ~np.isnan(angle)
    t, angle = t[known], angle[known]
    if angle.size > 2:  # a single sample that is far off is no motion
        angle = np.median([angle[:-2], angle[1:-1], angle[2:]], axis=0)
        t = t[1:-1]
    least = min(0.01, (t[-1] - t[0]) / 200.0)
    picked = [0]
    for k in range(1, t.size):
        if t[k] - t[picked[-1]] >= least:
            picked.append(k)
    turned, taken = np.diff(angle[picked]), np.diff(t[picked])
    return float(np.sqrt((turned**2 / taken).sum() / taken.sum())) if taken.size else 0.0


def decimation_step(recording: Recording, length: float) -> int:
    """Return the step of the decimation that leaves at most ``DENSEST`` samples a window."""
    spacing = float(np.median(np.diff(recording.t)))
    return max(1, int(length / (spacing * DENSEST)))


def cut_windows(
    recording: Recording,
    length: float,
    shape: Recording | None = None,
    prior: Array | None = None,
    sides: Sequence[Array] = (),
) -> tuple[list[Window], int]:
    """Cut a recording into windows of `length` (s), [start, start + length); return them and the number left out.

    Windows are left out where some link has too few values, or too long a gap, to tell its angle and rate. `shape`
    holds link angles for first states, by default the recording itself, `sides` others (T, n); prior (r, 2n): see
    :class:`Window`.
    """
    t, data, noise = recording.t, recording.data, recording.noise
    weight = np.where(np.isnan(data), 0.0, 1.0 if noise is None else 1.0 / noise)
    y = np.where(np.isnan(data), 0.0, data)
    angles = (shape or recording).data
    prior = np.zeros((0, 2 * angles.shape[1])) if prior is None else prior
    spacing = float(np.median(np.diff(t)))
    number = np.floor((t - t[0]) / length + 1e-6 * spacing / length).astype(int)
    windows, dropped = [], 0
    for k in np.unique(number):
        rows = number == k
        known = ~np.isnan(angles[rows])
        span = t[rows][-1] - t[rows][0]
        if known.sum(axis=0).min() < LEAST_VALUES or span < 0.5 * length or _longest_gap(t[rows], known) > BLIND * span:
            dropped += 1
            continue
        guess, *others = (first_state(t[rows], each[rows]) for each in (angles, *sides))
        others = [each for each in others if np.abs(each - guess)[: angles.shape[1]].max() > ASIDE]
        windows.append(Window(t[rows], y[rows], weight[rows], guess, prior, tuple(others)))
    return windows, dropped


def _longest_gap(t: Array, known: npt.NDArray[np.bool_]) -> float:
    return max(float(np.diff(np.concatenate([t[:1], t[column], t[-1:]])).max()) for column in known.T)


def first_state(t: Array, angles: Array) -> Array:
    """Return a guess of the state (2n,) at t[0]: a cubic through each link's first angles (m, n), NaN in gaps."""
    n = angles.shape[1]
    state = np.zeros(2 * n)
    for k in range(n):
        known = np.flatnonzero(~np.isnan(angles[:, k]))
        few = known[: max(6, known.size // 5)]
        tau = t[few] - t[0]
        state[k], state[n + k] = _value_and_slope(tau / max(tau[-1], 1e-9), angles[few, k])
        state[n + k] /= max(tau[-1], 1e-9)
    return state


def nearest_turn(state: Array, guess: Array) -> Array:
    """Return a state (2n,) with whole turns added to its angles, so that they come near to those of a guess (2n,)."""
    n = state.size // 2
    return np.append(state[:n] + 2.0 * np.pi * np.round((guess[:n] - state[:n]) / (2.0 * np.pi)), state[n:])


def _value_and_slope(tau: Array, y: Array) -> tuple[float, float]:
    """Return value and slope at 0 of the cubic nearest to y (m,), by least absolute errors: no outlier tilts it."""
    powers = np.vander(tau, min(3, tau.size - 2) + 1, increasing=True)
    weight = np.ones(tau.size)
    for _ in range(ABSOLUTE_ROUNDS):
        found = np.linalg.lstsq(powers * weight[:, None], y * weight, rcond=None)[0]
        away = np.abs(powers @ found - y)
        weight = 1.0 / np.sqrt(np.maximum(away, 0.1 * away.mean() + 1e-12))
    return float(found[0]), float(found[1])


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
    target: Target | None = None,
) -> Fit:
    """Fit parameters and all states together, or the states alone, from first guesses.

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
        residual = window.residual(plant, x, state)
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
