"""Covariance of the parameters (sandwich estimate for robust losses and coloured noise), and intervals from it."""

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit import Fit, Loss, Window, fit, least_squares, linearise
from hyperflex.identification.model import (
    Mask,
    Parameter,
    Parameters,
    Plant,
    extended,
    in_common_factor,
    lumped,
    rope_derivatives,
)
from hyperflex.identification.uncertainty.noise import (
    CHANCE,
    Piece,
    autocorrelation,
    channel_correlation,
    correlated,
    noise_memory,
    whiteness,
)
from hyperflex.model import RESISTANCES, Rope

UNKNOWN = 1e-6  # singular values below this part of the largest are rounding
LEAST_SENSITIVITY = 0.05  # of a loss, on average: where nearly all residuals count as outliers nothing is known
TOUCHED = 1e-3  # a parameter or ratio is unknown when this part of it lies in an unknown direction
End = Literal["crossed", "bound", "open"]
IntervalKind = Literal["covariance", "profile", "unknown"]
LEVEL = 0.95
GRACE = 0.5  # s of work: what an interrupted fit may still take for its deviations
MASSES = ("J/p1", "p/p1")  # ratios without friction and stiffness
SIGNED = ("p/p1",)  # ratios that may be negative: a centre of mass behind its joint


@dataclass(frozen=True)
class Information:
    """Fisher information of the windows about the parameters, in units of `widths` (see ``Parameters.widths``).

    singular (P,): of the derivatives of all residuals, states eliminated, largest first. known (P, k) and unknown
    (P, P - k): directions. covariance (P, P): of x, 0 along unknown directions. model (P, P): the same of errors of the
    model, which come on top. correlation: autocorrelation time of the residuals, samples. plain (P, P): the covariance
    if the residuals were white. variance: of what each residual counts. freedom: its degrees of freedom, 1 at least.
    agrees: whether a stationary noise explains the residuals. whiteness: p-value of
    white noise. follow: derivative of each window's state by x (2n, P). growing (P,): which parameters share an
    unknown common factor. scaled (P + 1, P + 1): covariance
    of x and of the logarithm of a factor on all lengths, as lengths, clock and torque may be off. estimated:
    False where an interrupt left all open.
    """

    x: Array
    widths: Array
    singular: Array
    known: Array
    unknown: Array
    covariance: Array
    correlation: float
    plain: Array = field(default_factory=lambda: np.zeros((0, 0)))
    variance: float = 1.0
    freedom: float = np.inf
    whiteness: float = 1.0
    follow: tuple[Array, ...] = ()
    agrees: bool = True
    growing: Mask | bool = False
    model: Array | float = 0.0
    scaled: Array | float = 0.0
    estimated: bool = True

    @property
    def white(self) -> bool:
        """Whether residuals may be white noise."""
        return self.whiteness >= CHANCE

    @property
    def total(self) -> Array:
        """Covariance (P, P) of x by noise and errors of the model, lengths and times being as declared."""
        return self.covariance + self.model

    @property
    def root(self) -> Array:
        """Change of x (P, k) by what is known of it, where residuals follow one of k orthonormal directions each."""
        return self.known / self.singular[: self.known.shape[1]] * self.widths[:, None]

    @property
    def declared(self) -> "Information":
        """The same without errors of the model: what ``model_spread`` has then is by lengths, clock and torque."""
        return replace(self, model=0.0)

    def model_spread(self, gradient: Array, by_length: Array | float = 0.0) -> Array:
        """Return the part of `spread` that errors of the model, the lengths, the clock and the torque have."""
        both = np.column_stack([gradient, np.broadcast_to(by_length, len(gradient))])
        return np.asarray(np.sqrt(_variances(gradient, self.model) + _variances(both, self.scaled)))

    def spread(self, gradient: Array, by_length: Array | float = 0.0) -> Array:
        """Return standard deviations (k,) of functions of x with gradients (k, P); inf where x does not determine them.

        `by_length` (k,) are their derivatives by the logarithm of a factor on all lengths, x held.
        """
        variance = _variances(gradient, self.covariance) + self.model_spread(gradient, by_length) ** 2
        scaled = gradient * self.widths
        beyond = np.linalg.norm(scaled @ self.unknown, axis=1) > TOUCHED * np.linalg.norm(scaled, axis=1)
        return np.where(beyond, np.inf, np.sqrt(variance))

    def covariances(self, slopes: Array) -> tuple[Array, Array]:
        """Return the covariance (P, P) of the values, and that of a length factor with these and itself (P + 1,).

        `slopes` (P,) are d value / d x.
        """
        both = np.append(slopes, 1.0)
        moved = self.scaled * np.outer(both, both)
        return self.total * np.outer(slopes, slopes) + moved[:-1, :-1], moved[-1]

    def deviations(self, slopes: Array) -> Array:
        """Return standard deviations (P,) of the values, `slopes` (P,) d value / d x; inf where unknown."""
        return np.where(self.growing, np.inf, self.spread(np.diag(slopes)))


def _variances(gradient: Array, covariance: Array | float) -> Array:
    """Return the variances (k,) of functions with gradients (k, P); a number is each element of the covariance."""
    size = gradient.shape[1]
    found = np.einsum("ij,jk,ik->i", gradient, np.broadcast_to(covariance, (size, size)), gradient)
    return np.asarray(np.maximum(found, 0.0))  # but for rounding


def estimate_covariance(plant: Plant, windows: Sequence[Window], fit: Fit, budget: Budget | None = None) -> Information:
    """Return the information of the fit's windows, at the cost of one round of the fit.

    Sandwich covariance A^+ M A^+ of x, with S the derivatives of the residuals less what the states absorb:

    - A = mean(psi') S^T S, and what each residual counts has the variance s^2 = K^2 sum(psi^2) / freedom / mean(psi'),
      where psi is half the slope of the loss and K = 1 + (p / n) var(psi') / mean(psi')^2 (Huber, Robust Statistics,
      section 7.6). For squares psi is the residual and s^2 their variance.
    - M = s^2 S^T R S: R are the correlations of the residuals, those of their instants, see :func:`noise_memory`, times
      those of their channels, see :func:`channel_correlation`.

    Assumed are residuals of one stationary process, alike and independent in all windows, at times that are about even.
    Model errors are not covered.
    """
    slopes, mean = sensitivities(windows, fit)
    models = window_models(plant, windows, fit, mean, budget or Budget())
    prior = fit.noise * plant.parameters.prior  # rows of the least-squares problem, as those of windows
    found = fisher_information(plant.parameters, fit.x, [*(model.shared for model in models), prior])
    pieces = [model.piece(found.root) for model in models]
    memory, agrees = noise_memory(pieces)
    channels = channel_correlation(pieces, memory)
    absorbed = sum(float((piece.basis * correlated(memory, piece.basis)).sum()) for piece in pieces)
    freedom = max(1.0, slopes.size - absorbed)
    factor = 1.0 + absorbed / slopes.size * float(slopes.var()) / mean**2
    variance = factor**2 * sum(float((p.residual**2).sum()) for p in pieces) / freedom / mean
    meat = np.sum([model.meat(memory, channels) for model in models], axis=0) + prior.T @ prior
    return replace(
        found,
        covariance=found.plain @ meat @ found.plain * variance,
        correlation=autocorrelation(pieces),
        plain=found.plain * variance,
        variance=variance,
        freedom=max(1.0, freedom / (2.0 * float(memory @ memory) - 1.0)),
        whiteness=whiteness(pieces),
        follow=tuple(model.follow for model in models),
        agrees=agrees,
    )


def sensitivities(windows: Sequence[Window], fit: Fit) -> tuple[Array, float]:
    """Return psi' of all residuals, gaps omitted, and its mean."""
    psi = zip(windows, map(fit.loss.sensitivity, fit.residuals), strict=True)
    slopes = np.concatenate([each[window.weight.ravel() > 0.0] for window, each in psi])
    return slopes, max(float(slopes.mean()), LEAST_SENSITIVITY)


@dataclass(frozen=True)
class WindowModel:
    """A window at the optimum: derivatives less what its state absorbs (M, P), and what that is.

    own (M, 2n): orthonormal directions of the state. follow (2n, P): derivative of the state by the parameters.
    influence, seen (m, C): psi of the residuals, and 0 in gaps, else 1. The first m C of M rows are the window's
    values, the rest the prior.
    """

    shared: Array
    own: Array
    follow: Array
    influence: Array
    seen: Array

    def piece(self, inner: Array) -> Piece:
        """Return its residuals, and all directions (m, C, 2n + k) that the fit absorbs; inner (P, k)."""
        basis = np.column_stack([self.own, self.shared @ inner])[: self.influence.size]
        return Piece(self.influence, self.seen, basis.reshape(*self.influence.shape, -1) * self.seen[:, :, None])

    def meat(self, memory: Array, channels: Array) -> Array:
        """Return S^T R S (P, P)."""
        size, shape = self.influence.size, self.influence.shape
        rows, prior = self.shared[:size].reshape(*shape, -1), self.shared[size:]
        coloured = np.einsum("cd,tdp->tcp", channels, correlated(memory, rows))
        return np.asarray(self.shared[:size].T @ coloured.reshape(size, -1) + prior.T @ prior)


def window_models(plant: Plant, windows: Sequence[Window], fit: Fit, mean: float, budget: Budget) -> list[WindowModel]:
    """Return all windows' derivatives, those of values times the root of the mean of psi'."""
    models = []
    for window, state, residual in zip(windows, fit.states, fit.residuals, strict=True):
        budget.check()
        linear = linearise(plant, window, fit.x, state, residual, Loss())
        scale = np.ones((linear.residual.size, 1))
        scale[: residual.size] = np.sqrt(mean)
        by_state, shared = scale * linear.state, scale * linear.shared
        own = np.linalg.qr(by_state)[0] if linear.known else np.zeros_like(by_state)
        left = shared - own @ (own.T @ shared)
        influence, seen = fit.loss.influence(residual), (window.weight > 0.0).astype(np.float64)
        models.append(WindowModel(left, own, -least_squares(by_state, shared), influence.reshape(seen.shape), seen))
    return models


def fisher_information(parameters: Parameters, x: Array, rows: Sequence[Array]) -> Information:
    """Return the information of residuals of variance 1, by their derivatives [(m, P), ..] with respect to x (P,)."""
    widths = parameters.widths
    small = [np.linalg.qr(each * widths, mode="r") for each in (*rows, np.zeros((x.size, x.size)))]
    _, singular, directions = np.linalg.svd(np.vstack(small), full_matrices=False)
    determined = singular > UNKNOWN * singular[0]
    known, unknown = directions[determined].T, directions[~determined].T
    inner = known / singular[determined] * widths[:, None]
    covariance, growing = inner @ inner.T, in_common_factor(parameters, x, unknown)
    return Information(x, widths, singular, known, unknown, covariance, 1.0, plain=covariance, growing=growing)


@dataclass(frozen=True)
class Interval:
    """Confidence interval, SI units.

    `kind` is its method: ``covariance`` (Student's quantile times the standard deviation), ``profile``,
    or ``unknown`` where the data set no limits. `ends`: ``crossed``, the parameter's own ``bound``, or ``open``.
    """

    low: float
    high: float
    kind: IntervalKind
    ends: tuple[End, End] = ("crossed", "crossed")
    level: float = LEVEL

    def __str__(self) -> str:
        return f"{self.low:.5g} to {self.high:.5g} ({self.kind})"

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


def checked_level(level: float) -> float:
    """Return a confidence level, refused outside of 0 to 1."""
    if checks.number("level", level, sign="positive") >= 1.0:
        raise InvalidInput("level is not a probability", got=level, allowed="between 0 and 1, such as 0.95")
    return float(level)


def quantile(level: float, freedom: float) -> float:
    """Return the quantile of F(1, freedom): the square of Student's."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 * (1.0 + level))) ** 2


def freedom_with(freedom: float, std: Array, declared: Array) -> Array:
    """Return the degrees of freedom of standard deviations (k,), of which `declared` (k,) is a part that is known.

    Welch and Satterthwaite (doi:10.2307/3002019): noise and errors of the model have those of the residuals, `freedom`,
    and what was declared of lengths, clock and torque has no doubt.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        estimated = np.where(np.isfinite(std), 1.0 - (declared / std) ** 2, 1.0)
        return np.asarray(freedom / np.clip(estimated, 0.0, 1.0) ** 2)


def widening(freedom: float) -> float:
    """Return how many times wider Student's distribution makes an interval than a deviation that is known."""
    return float(np.sqrt(quantile(LEVEL, freedom) / quantile(LEVEL, np.inf)))


def interval(
    at: float,
    std: float,
    freedom: float,
    least: float,
    level: float = LEVEL,
    value: Callable[[float], float] = float,
) -> Interval:
    """Return the interval of a value, a function of `at`, from the standard deviation of `at` and its bound `least`."""
    if not np.isfinite(std):
        low = value(least)
        return Interval(low, np.inf, "unknown", ("open" if np.isneginf(low) else "bound", "open"), level)
    half = std * float(np.sqrt(quantile(level, freedom)))
    ends: tuple[End, End] = ("bound" if at - half < least else "crossed", "crossed")
    return Interval(value(max(at - half, least)), value(at + half), "covariance", ends, level)


def of_ratios(
    ratios: dict[str, Array], std: dict[str, Array], declared: dict[str, Array], freedom: float
) -> dict[str, Interval]:
    """Return intervals of the ratios by name and link (``J/p1[0]``), from their standard deviations, within bounds.

    `declared` is the part of these that follows from what was declared, `freedom` are the degrees of that of the rest.
    """
    found = {}
    for name, values in ratios.items():
        every = zip(values, std[name], freedom_with(freedom, std[name], declared[name]), strict=True)
        for k, (value, spread, degrees) in enumerate(every):
            if spread > 0.0:
                least = -np.inf if name in SIGNED else 0.0
                found[f"{name}[{k}]"] = interval(value, spread, degrees, least)
    return found


def ratios(rope: Rope, free: Collection[str] = ()) -> dict[str, Array]:
    """Return the ratios over p1 = p of link 0 that are identifiable without known forces, each (n,).

    ``J/p1`` (m), ``p/p1``, ``c/p1`` (m/s), and of the other resistances those that the rope has or that are `free`:
    ``tau_d/p1`` and ``k/p1`` (m/s^2), ``d/p1`` (1/m^3). Without a first moment none is a number: inf, or nan.
    """
    p, inertia = lumped(rope)
    resistances = {each.symbol: getattr(rope, each.name) for each in RESISTANCES}
    shown = {each.symbol for each in RESISTANCES if each.name in free or each.symbol == "c"}
    resistances = {name: value for name, value in resistances.items() if name in shown or value.any()}
    with np.errstate(divide="ignore", invalid="ignore"):
        return {f"{name}/p1": value / p[0] for name, value in {"J": inertia, "p": p, **resistances}.items()}


def ratio_gradients(parameters: Parameters, x: Array) -> dict[str, Array]:
    """Return the derivatives (n, P) of each ratio by x (P,)."""
    free, rope = [each.name for each in RESISTANCES], parameters.rope(x)
    slopes = rope_derivatives(parameters, x, lambda rope: np.array(list(ratios(rope, free).values())))
    every = dict(zip(ratios(rope, free), slopes, strict=True))
    return {name: every[name] for name in ratios(rope, parameters.names)}


def ratio_spread(parameters: Parameters, information: Information, *, model: bool = False) -> dict[str, Array]:
    """Return standard deviations (n,) of each ratio by the delta method; inf where it cannot be known.

    With `model` only the part that errors of the model, lengths and clock have. Ratios of what was held have none.
    """
    every = tuple(range(parameters.guess.n_links))
    stretched = Parameter("length", every, "length:factor", 1.0, 1.0, "factor")
    gradients = ratio_gradients(Parameters(parameters.guess, [*parameters.all, stretched]), np.append(information.x, 0))
    spread = information.model_spread if model else information.spread
    return {
        name: spread(each[:, :-1], np.where(each[:, :-1].any(axis=1), each[:, -1], 0.0))
        for name, each in gradients.items()
    }


@dataclass(frozen=True)
class RefitOptions:
    """How far a refit goes: for time."""

    # windows, spread over the recording, and rounds at most
    windows: int = 12
    rounds: int = 40
    # gain of a round, as a part of the cost, that ends a refit: far less than gains that differ
    enough: float = 1e-3


REFIT = RefitOptions()


@dataclass(frozen=True, eq=False)
class Basis:
    """State of a fit: its model, its windows, and their information about the parameters.

    usual: time, s, over which windows and parts of longer ones are compared with each other. settings: how the windows
    were used.
    """

    plant: Plant
    windows: list[Window]
    fit: Fit
    information: Information
    usual: float = np.inf
    settings: dict[str, Any] = field(default_factory=dict)
    _refits: dict[str, "Basis | None"] = field(default_factory=dict, init=False)

    @classmethod
    def begun(cls, plant: Plant, windows: list[Window], fit: Fit, usual: float, settings: dict[str, Any]) -> "Basis":
        """Return the state of a fit whose information has not been estimated."""
        unknown = replace(fisher_information(plant.parameters, fit.x, ()), estimated=False)
        return cls(plant, windows, fit, unknown, usual, settings)

    def estimated(self, budget: Budget | None = None) -> "Basis":
        """Return the same with its information, by default within GRACE."""
        found = estimate_covariance(self.plant, self.windows, self.fit, budget or Budget(GRACE))
        return replace(self, information=found)

    @property
    def part(self) -> "Basis":
        """The fit in some of its windows, spread over the recording."""
        every, found = -(-len(self.windows) // REFIT.windows), self.fit
        some = Fit(found.x, found.states[::every], found.residuals[::every], found.loss)
        return replace(self, windows=self.windows[::every], fit=some)

    def refit(self, name: str = "", *, covariance: bool = False) -> "Basis | None":
        """Return a fit of some windows with `name` free as well, made once; None where none converges.

        Its information is that of this fit unless its own `covariance` is required.
        """
        if not name and self.fit.converged and len(self.windows) <= REFIT.windows:
            return self
        if name not in self._refits:
            self._refits[name] = None
            some = self.refit() if name else self.part
            if some is not None:
                plant, x, _ = extended(some.plant, some.fit.x, [name] * bool(name))
                with suppress(InvalidInput):
                    again = partial(fit, plant, some.windows, x, some.fit.states, loss=some.fit.loss)
                    self._refits[name] = replace(some, plant=plant, fit=again(rounds=REFIT.rounds, enough=REFIT.enough))
        found = self._refits[name]
        if covariance and found is not None and found.information is self.information:
            own = estimate_covariance(found.plant, found.windows, found.fit)
            found = self._refits[name] = replace(found, information=own)
        return found

    def pieces(self, budget: Budget) -> list[Piece]:
        """Return the windows' residuals, with all directions that the fit absorbs, the 2n of the state first."""
        mean = sensitivities(self.windows, self.fit)[1]
        models = window_models(self.plant, self.windows, self.fit, mean, budget)
        return [each.piece(self.information.root) for each in models]

    def intervals(self) -> dict[str, Interval]:
        """Return intervals of all free parameters by label, from their standard deviations, within bounds."""
        information = self.information
        stds = information.deviations(np.ones(information.x.size))
        freedom = freedom_with(information.freedom, stds, information.declared.model_spread(np.eye(information.x.size)))
        each = zip(self.plant.parameters.all, information.x, stds, freedom, strict=True)
        return {p.label: interval(float(x), std, more, p.least, value=p.value) for p, x, std, more in each}
