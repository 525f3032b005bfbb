"""Profile likelihood of a parameter, all else fitted again; and which intervals are found by it."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.fit import Fit, Loss, Report, fit, with_entries
from hyperflex.identification.model import Mask
from hyperflex.identification.options import How
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import (
    LEVEL,
    Basis,
    Interval,
    freedom_with,
    interval,
    quantile,
)
from hyperflex.interruption import interruptible
from hyperflex.model import Rope


@dataclass(frozen=True)
class ProfileOptions:
    """Which parameters are profiled, and how a profile walks away from the optimum."""

    # gain of a round, as a rise of the profile, below which a point of it has settled
    finish: float = 0.01
    # std to which an end is found
    close: float = 0.01
    # std, and part of the way to it; an end that is not known so well after all tries is not reported
    loose: float = 0.1
    # factor by which a step may grow
    longest: float = 3.0
    # points on either side
    tries: int = 25
    # of all fits on one side; usual are ten
    most_rounds: int = 100
    # fall of the squares, over the residual variance, from which another optimum is reported as better
    better: float = 1.0
    # std: a bound so far off is not felt; correlation with a parameter near its bound from which that matters
    near: float = 4.0
    tied: float = 0.1
    # profiles that "auto" takes on, each as dear as two or three fits
    most: int = 4


WALK = ProfileOptions()


@dataclass(frozen=True, eq=False, kw_only=True)
class Profile(Interval):
    """Profile likelihood of one parameter, and its interval.

    Attributes
    ----------
    name : str
        Of the parameter, as in ``Identification.parameters``.
    low, high : float
        The interval of 95 %, SI units, inf where the data set no limit. Of noise alone: ``Identification.intervals``
        add errors of the model and of the lengths.
    values, rise, limit : (K,) array
        The curve: values of the parameter (SI units, increasing), rise of the least sum of squares over the residual
        variance, and the rise at which a value is refused.
    kind : str
        ``profile``; ``covariance`` where the curve took too many rounds: the interval is then that of the standard
        deviation.
    gain : float
        By how much the sum of squares fell below that of the result, over the residual variance. Beyond 1 the result is
        not the best fit, and the interval means little.
    better : Rope or None
        The rope of least squares, where `gain` is beyond 1: a guess for another fit.
    """

    name: str
    values: Array
    rise: Array
    limit: Array
    gain: float = 0.0
    better: Rope | None = None


@interruptible(Profile)
def profile(found: Identification, name: str, *, progress: Report | None = None) -> Profile:
    """Return the profile likelihood interval of one parameter.

    Parameters
    ----------
    found : Identification
        Of :func:`identify`, in the same session.
    name : str
        One of ``found.parameters``, e.g. ``inertia:shared``.
    progress : callable, optional
        Gets each round of each fit, as that of :func:`identify` does.

    Raises
    ------
    InvalidInput
        For a name that was not free, or a result without its fit (read from a file).

    Notes
    -----
    At each value all other parameters and states are fitted again, starting from a linear extrapolation of the last
    point. The rise of the squares, divided by the factor by which autocorrelation widens the variance, is compared with
    F(1, freedom), or near a bound with the distribution there (see :func:`threshold`). Robust losses are treated as in
    :func:`estimate_covariance`. Cost: about three fits of two or three rounds a side, a hundred rounds at most.
    """
    basis, labels = found.basis, found.basis.plant.parameters.labels
    if name not in labels:
        raise InvalidInput("no such parameter was free", got=name, allowed=", ".join(labels))
    return profiled(basis, labels.index(name), report=progress)


def bottom(basis: Basis, budget: Budget | None = None, report: Report | None = None) -> Fit:
    """Return a fit with the scale of its loss held, followed to where profiles begin."""
    found = basis.fit
    loss = Loss(found.loss.name, found.loss.scale, fixed=True)
    enough = WALK.finish * basis.information.variance / max(found.cost, 1e-300)
    again = partial(fit, basis.plant, basis.windows, found.x, found.states, loss=loss, rounds=10)
    return again(enough=enough, budget=budget, report=report)


def profiled(
    basis: Basis,
    which: int,
    *,
    begun: Fit | None = None,
    budget: Budget | None = None,
    report: Report | None = None,
) -> Profile:
    """Return the profile of a parameter, by its number, from the fit `begun`, see :func:`bottom`."""
    parameters, information = basis.plant.parameters, basis.information
    parameter, bound = parameters.all[which], float(parameters.lower[which])
    deviations = information.deviations(np.ones(basis.fit.x.size))
    std = float(np.sqrt(information.covariance[which, which])) if np.isfinite(deviations[which]) else np.inf
    if not np.isfinite(std) or std == 0.0:
        every = Interval(parameter.value(bound), np.inf, "profile")
        return Profile(**vars(every), name=parameter.label, values=np.zeros(0), rise=np.zeros(0), limit=np.zeros(0))
    walk = _ProfileSearch(basis, which, std, begun or bottom(basis, budget, report), budget or Budget(), report)
    try:
        below, above = walk.side(-1.0), walk.side(1.0)
        found = Interval(parameter.value(below), parameter.value(above), "profile")
    except _TooLong:
        found = interval(float(basis.fit.x[which]), std, information.freedom, bound, parameter.value)
    known = sorted((p for p in walk.points if np.isfinite(p.rise)), key=lambda p: p.at)
    values, rise, limit = np.array([(parameter.value(p.at), max(p.rise, 0.0), p.limit) for p in known]).T
    best = min(known, key=lambda p: p.rise)
    gain = (basis.fit.cost - walk.least) / walk.unit - min(best.rise, 0.0)
    better = parameters.rope(best.x) if gain > WALK.better else None
    return Profile(
        **vars(found), name=parameter.label, values=values, rise=rise, limit=limit, gain=max(gain, 0.0), better=better
    )


class _TooLong(Exception):
    """A side has taken all its rounds."""


@dataclass(frozen=True)
class _Point:
    """A fit with the parameter held at `at`."""

    at: float
    x: Array
    states: list[Array]
    rise: float  # negative where this optimum is a better one
    limit: float

    @property
    def excess(self) -> float:
        """How far beyond the limit it is, in std; negative within."""
        return float(np.sqrt(max(self.rise, 0.0)) - np.sqrt(self.limit))


class _ProfileSearch:
    """Walks away from the optimum along one parameter, to either side."""

    def __init__(self, basis: Basis, which: int, std: float, best: Fit, budget: Budget, report: Report | None) -> None:
        self.basis, self.which, self.budget = basis, which, budget
        information = basis.information
        self.bound, self.std = float(basis.plant.parameters.lower[which]), std
        self.rounds = WALK.most_rounds  # that one side may still take
        self.settled = True  # whether the last fit that could be simulated has converged
        # rise one `std` away: the residual variance, as far as autocorrelation widens that of the parameter
        self.unit = information.variance * self.std**2 / float(information.plain[which, which])
        enough = WALK.finish * self.unit / max(basis.fit.cost, 1e-300)
        self._fit = partial(
            fit, basis.plant, basis.windows, loss=best.loss, enough=enough, budget=budget, report=report, held=which
        )
        self.least = best.cost
        self.points = [self._point(best)]

    def _point(self, found: Fit) -> _Point:
        self.budget.check()  # else a fit that the budget has ended would pass for one that has settled
        at = float(found.x[self.which])
        limit = threshold(self.basis.information.freedom, (at - self.bound) / self.std)
        return _Point(at, found.x, found.states, (found.cost - self.least) / self.unit, limit)

    def at(self, value: float) -> _Point | None:
        """Return the fit with the parameter held at `value`; None where none can be found."""
        if self.rounds <= 0:
            raise _TooLong
        start, information = min(self.points, key=lambda p: abs(p.at - value)), self.basis.information
        along = information.covariance[self.which] / self.std**2
        x = np.maximum(start.x + along * (value - start.at), self.basis.plant.parameters.lower)
        x[self.which] = value
        states = [s + f @ (x - start.x) for s, f in zip(start.states, information.follow, strict=True)]
        try:
            found = self._fit(x, states, rounds=min(20, self.rounds))
        except InvalidInput:
            self.rounds, self.settled = self.rounds - 1, True
            return None
        self.rounds, self.settled = self.rounds - max(len(found.history), 1), found.converged
        if not found.converged:
            return None
        self.points.append(self._point(found))
        return self.points[-1]

    def side(self, sign: float) -> float:
        """Return the x at the end of the interval below (-1) or above (1) the optimum; inf where there is none."""
        self.rounds = WALK.most_rounds
        inside, outside = self.points[0], None
        origin, bound = inside.at, self.bound if sign < 0.0 else np.inf
        value = origin + sign * self.std * float(np.sqrt(quantile(self.basis.information.freedom)))
        for _ in range(WALK.tries):
            value = max(value, bound) if sign < 0.0 else value
            if value == inside.at:  # at the bound, and allowed
                return value
            tried = self.at(value)
            if tried is None:
                value = 0.5 * (value + inside.at)
                continue
            if abs(tried.excess) < WALK.close:
                return tried.at
            inside, outside = (tried, outside) if tried.excess < 0.0 else (inside, tried)
            if outside is None:  # the root of the rise, taken as linear, meets the limit there
                root = max(float(np.sqrt(max(inside.rise, 0.0) / inside.limit)), 1.0 / WALK.longest)
                value = origin + max(1.0 / root, 1.05) * (inside.at - origin)
            else:
                part = inside.excess / (inside.excess - outside.excess)
                value = inside.at + float(np.clip(part, 0.05, 0.95)) * (outside.at - inside.at)
        if outside is None and self.settled:
            return sign * np.inf
        if outside is None:
            raise _TooLong
        known = WALK.loose * min(self.std, abs(outside.at - origin))
        if outside.excess > WALK.loose and abs(outside.at - inside.at) > known:
            raise _TooLong
        return outside.at


def all_intervals(
    basis: Basis, how: How, budget: Budget | None = None, report: Report | None = None
) -> Iterator[tuple[dict[str, Interval], list[Finding]]]:
    """Yield intervals of all free parameters, by label, and what profiles show besides; again after each profile.

    ``auto`` profiles up to four parameters whose covariance is skewed: within four standard deviations of a bound, or
    correlated with such a one; of more, those nearest to their bounds.
    `report` gets each round of each profile, with its ``parameter`` and ``phase="profile"``. The budget must not be
    over: what was not profiled yet has intervals from the covariance.
    """
    result, remarks = basis.intervals(), list[Finding]()
    yield result, remarks
    every = list(result)
    chosen = {"covariance": [], "profile": every, "auto": [every[k] for k in skewed(basis)]}[how]
    labels = [label for label in chosen if result[label].kind != "unknown"]
    length = max(float(w.t[-1] - w.t[0]) for w in basis.windows)
    begun = bottom(basis, budget) if labels else None
    for number, label in enumerate(labels):
        at = {"phase": "profile", "parameter": label, "window": length, "stage": number, "stages": len(labels)}
        heard = None if report is None else with_entries(report, at)
        which = every.index(label)
        found = profiled(basis, which, begun=begun, budget=budget, report=heard)
        if found.kind == "profile":
            result[label] = _with_model_error(basis, which, found)
        if found.gain > WALK.better:
            remarks.append(Finding(Kind.BETTER_OPTIMUM, Severity.LIMIT, {"name": label, "gain": found.gain}))
        elif found.kind == "covariance":
            remarks.append(Finding(Kind.PROFILE_GIVEN_UP, Severity.LIMIT, {"name": label}))
        yield result, remarks


def _with_model_error(basis: Basis, which: int, found: Profile) -> Interval:
    """Return the interval of a profile, made wider by the model's errors; it stays within the parameter's bound."""
    information, x, parameter = basis.information, float(basis.fit.x[which]), basis.plant.parameters.all[which]
    gradient = np.eye(basis.fit.x.size)[[which]] * parameter.derivative(x)
    whole, declared = information.spread(gradient), information.declared.model_spread(gradient)
    freedom, usual = float(freedom_with(information.freedom, whole, declared)[0]), quantile(information.freedom)
    wider = float(np.sqrt(quantile(freedom) / usual))
    model, value = float(information.model_spread(gradient)[0]) * float(np.sqrt(usual)), parameter.value(x)
    low = value - wider * float(np.hypot(value - found.low, model))
    high = value + wider * float(np.hypot(found.high - value, model))
    return Interval(max(low, parameter.value(float(basis.plant.parameters.lower[which]))), high, "profile")


def skewed(basis: Basis) -> list[int]:
    """Return the parameters for which the covariance does not suffice, `most` at most, those nearest to a bound first.

    Near a bound, its own or that of one it correlates with.
    """
    information, above = basis.information, basis.information.x - basis.plant.parameters.lower
    std = np.sqrt(np.diag(information.covariance))
    before = np.array([np.isfinite(each.prior) for each in basis.plant.parameters.all])  # normal, as was declared
    known = np.isfinite(information.deviations(np.ones(std.size))) & (std > 0.0) & ~before
    beside = (above < WALK.near * std) & (std > 0.0)
    tied: Mask = np.any((np.abs(information.covariance) > WALK.tied * np.outer(std, std)) & beside, axis=1)
    order = np.argsort(above / np.where(std > 0.0, std, 1.0), kind="stable")
    return order[(known & tied)[order]][: WALK.most].tolist()  # type: ignore[no-any-return]


def threshold(freedom: float, above: float) -> float:
    """Return the rise, over the residual variance, at which a value so many deviations `above` its bound is refused.

    `freedom` is of the residual variance; `above` is inf where there is no bound.

    Away from bounds the rise follows F(1, freedom). Beside its bound it does not: an estimate that noise would push
    beyond stays there. The limit is that of the linear problem, at the very value that is tested, so that intervals
    contain the truth as often as stated, whether the truth lies at the bound, near it or far off (the construction of
    Feldman and Cousins 1998, doi:10.1103/PhysRevD.57.3873). Bounds of other parameters make intervals contain it in
    94.5 to 97.3 % for stated 95 %, up to a correlation of 0.95, so that they do not count.
    """
    from scipy.optimize import brentq
    from scipy.special import ndtr

    usual, normal, above = quantile(freedom), quantile(np.inf), max(above, 1e-9)

    def excess(limit: float) -> float:
        """Return by how much more often than in 95 % the truth is held with a limit."""
        return float(ndtr(np.sqrt(limit)) - ndtr(-0.5 * (above**2 + limit) / above)) - LEVEL

    if above**2 >= normal or not excess(above**2) < 0.0 < excess(normal):  # the latter by rounding, just below it
        return usual
    return usual * float(brentq(excess, above**2, normal)) / normal
