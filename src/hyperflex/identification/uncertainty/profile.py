"""Profile likelihood of a parameter or ratio, all else fitted again; and which intervals are found by it."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.fit import Fit, Loss, Report, Target, fit, with_entries
from hyperflex.identification.model import Mask
from hyperflex.identification.options import How
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import (
    LEVEL,
    SIGNED,
    Basis,
    End,
    Interval,
    checked_level,
    freedom_with,
    interval,
    quantile,
    ratio_gradients,
    ratios,
)
from hyperflex.interruption import interruptible
from hyperflex.model import Rope


class Coordinate:
    """A function of x (P,) that a profile follows: the x of a parameter, or a ratio such as ``J/p1[0]``, by its label.

    Attributes
    ----------
    label : str
        As in ``Identification.intervals``.
    bound : float
        The least value of the coordinate, -inf where none is known beforehand.
    slope : (P,) array
        Its derivatives at the fit.
    std : float
        Standard deviation by noise; 0 or not finite where the data do not determine it.
    """

    def __init__(self, basis: Basis, label: str) -> None:
        self.basis, self.label, self.parameters = basis, label, basis.plant.parameters
        self.name, _, link = label.removesuffix("]").partition("[")
        self.own = label in self.parameters.labels  # a parameter, else a ratio
        self.which = self.parameters.labels.index(label) if self.own else int(link)
        information, x = basis.information, basis.fit.x
        self.slope = self.gradient(x)
        variance = float(self.slope @ information.covariance @ self.slope)
        if self.own:
            spread = information.deviations(np.ones(x.size))[self.which]
            self.bound = self.least = float(self.parameters.lower[self.which])
        else:
            spread = information.spread(self.slope[None])[0]
            self.bound = -np.inf if self.name in SIGNED else 0.0
            self.least = self._least_ratio() if self.name in ("J/p1", *SIGNED) else 0.0
        self.std = float(np.sqrt(max(variance, 0.0))) if np.isfinite(spread) else np.inf

    def at(self, x: Array) -> float:
        """Return its value at x (P,)."""
        if self.own:
            return float(x[self.which])
        return float(ratios(self.parameters.rope(x), self.parameters.names)[self.name][self.which])

    def gradient(self, x: Array) -> Array:
        """Return its derivatives (P,) at x (P,)."""
        if self.own:
            return np.asarray(np.eye(x.size)[self.which])
        return np.asarray(ratio_gradients(self.parameters, x)[self.name][self.which])

    def value(self, at: float) -> float:
        """Return the value in SI units from that of the coordinate."""
        return self.parameters.all[self.which].value(at) if self.own else max(at, self.bound)

    def limit(self, x: Array, level: float) -> float:
        """Return the rise of the squares, over the residual variance, at which the value at x is refused."""
        return threshold(level, self.basis.information.freedom, (self.at(x) - self.least) / self.std)

    def _least_ratio(self) -> float:
        """Return the least ratio that the bound of the parameter allows by which alone it moves; else -inf."""
        lowest, movers = self.basis.fit.x.copy(), np.flatnonzero(self.slope)
        lowest[movers] = self.parameters.lower[movers]
        alone = movers.size == 1 and self.slope[movers[0]] > 0.0 and np.isfinite(lowest).all()
        return self.at(lowest) if alone and self.parameters.possible(lowest) is not None else -np.inf

    @property
    def unit(self) -> float:
        """Rise of the squares one `std` away: the residual variance, as far as autocorrelation widens that of it."""
        information = self.basis.information
        return information.variance * self.std**2 / float(self.slope @ information.plain @ self.slope)

    def aimed(self, x: Array, at: float) -> Array:
        """Return where a fit at `at` begins: x moved with its estimate, as far as the coordinate goes along."""
        away = at - self.at(x)
        move = self.basis.information.covariance @ self.slope / self.std**2 * away
        for halvings in range(WALK.tried):
            begun: Array = np.maximum(x + 0.5**halvings * move, self.parameters.lower)
            if self.parameters.possible(begun) is not None and abs(at - self.at(begun)) < 0.75 * abs(away):
                return begun
        return x

    def target(self, at: float, firmness: float) -> Target:
        """Return the target that draws a fit to `at`, so many times more firmly than usual.

        It lies beyond by what the data hold it back.
        """
        weight = firmness * WALK.weight
        beyond = at + (at - self.at(self.basis.fit.x)) / weight**2
        return Target(self.at, self.gradient, beyond, weight * float(np.sqrt(self.unit)) / self.std)


@dataclass(frozen=True)
class ProfileOptions:
    """Which parameters are profiled, and how a profile walks away from the optimum."""

    # gain of a round, as a rise of the profile, below which a point of it has settled
    finish: float = 0.01
    # std to which an end is found
    close: float = 0.01
    # std, and part of the way to it; an end that is not known so well after all tries is not reported
    loose: float = 0.1
    # part of the way that a ratio may stay short of its aim
    reached: float = 0.1
    # factor by which a step may grow
    longest: float = 3.0
    # points on either side
    tries: int = 25
    # of all fits on one side; usual are ten
    most_rounds: int = 100
    # fall of the squares, over the residual variance, from which another optimum is reported as better
    better: float = 1.0

    # of a target, in 1 / std: the data hold a ratio back from it by a millionth of its way; where another parameter is
    # at its bound they may do so a thousand times more than the standard deviation suggests
    weight: float = 1000.0
    # times this weight, one after the other, before a bound is taken to be in the way of a ratio
    firmness: tuple[float, ...] = (1.0, 10.0, 100.0)
    # steps, each half of the one before, with which a start is to bring a ratio a quarter of its way
    tried: int = 2
    # std: a bound so far off is not felt; correlation with a parameter near its bound from which that matters
    near: float = 4.0
    tied: float = 0.1
    # profiles that "auto" takes on, each as dear as two or three fits
    most: int = 4


WALK = ProfileOptions()


@dataclass(frozen=True, eq=False, kw_only=True)
class Profile(Interval):
    """Profile likelihood of one parameter or ratio, and its interval.

    Attributes
    ----------
    name : str
        Of the parameter or ratio, as in ``Identification.intervals``.
    low, high, level : float
        The interval, SI units, inf where the data set no limit; its confidence level. Of noise alone:
        ``Identification.intervals`` add errors of the model and of the lengths.
    ends : tuple of str
        Of either end: ``crossed`` where the curve crosses the limit, ``bound`` where a bound of the parameter, or of
        those that move the ratio, comes first, ``open`` where neither was found (no limit in the data, or the rope
        cannot be simulated there).
    values, rise, limit : (K,) array
        The curve: values of the parameter or ratio (SI units, increasing), rise of the least sum of squares over the
        residual variance, and the rise at which a value is refused.
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
def profile(
    found: Identification, name: str, level: float = 0.95, points: int = 0, *, progress: Report | None = None
) -> Profile:
    """Return the profile likelihood interval of one parameter or ratio.

    Parameters
    ----------
    found : Identification
        Of :func:`identify`, in the same session.
    name : str
        One of ``found.parameters``, e.g. ``inertia:shared``, or of a link's ratios, e.g. ``J/p1[0]``.
    level : float
        Confidence level.
    points : int
        So many more points of the curve on either side, for drawing.
    progress : callable, optional
        Gets each round of each fit, as that of :func:`identify` does.

    Raises
    ------
    InvalidInput
        For a name that was not free, a ratio that nothing free moves, or a result without its fit (read from a file).

    Notes
    -----
    At each value all other parameters and states are fitted again, starting from a linear extrapolation of the last
    point; a ratio is drawn to its value by one residual more, whose squares do not count. The rise of the squares,
    divided by the factor by which autocorrelation widens the variance, is compared with F(1, freedom), or near a
    bound with the distribution there (see :func:`threshold`). Robust losses are treated as in
    :func:`estimate_covariance`. Cost: about three fits of two or three rounds a side, a hundred rounds at most.
    """
    basis, level, points = found.basis, checked_level(level), checks.count("points", points, least=0)
    every = [f"{ratio}[{k}]" for ratio, std in found.ratio_std.items() for k in np.flatnonzero(std)]
    every = [*basis.plant.parameters.labels, *every]
    if name not in every:
        raise InvalidInput(
            "no such parameter was free, and no free one moves such a ratio", got=name, allowed=", ".join(every)
        )
    return profiled(Coordinate(basis, name), level, points, report=progress)


def bottom(basis: Basis, budget: Budget | None = None, report: Report | None = None) -> Fit:
    """Return a fit with the scale of its loss held, followed to where profiles begin."""
    found = basis.fit
    loss = Loss(found.loss.name, found.loss.scale, fixed=True)
    enough = WALK.finish * basis.information.variance / max(found.cost, 1e-300)
    again = partial(fit, basis.plant, basis.windows, found.x, found.states, loss=loss, rounds=10)
    return again(enough=enough, budget=budget, report=report)


def profiled(
    along: Coordinate,
    level: float,
    points: int = 0,
    *,
    begun: Fit | None = None,
    budget: Budget | None = None,
    report: Report | None = None,
) -> Profile:
    """Return the profile along a coordinate from the fit `begun`, see :func:`bottom`; see :func:`profile`."""
    if not np.isfinite(along.std) or along.std == 0.0:
        every = Interval(along.value(along.bound), np.inf, "profile", ("open", "open"), level)
        return Profile(**vars(every), name=along.label, values=np.zeros(0), rise=np.zeros(0), limit=np.zeros(0))
    walk = _ProfileSearch(along, level, begun or bottom(along.basis, budget, report), budget or Budget(), report)
    try:
        (below, first), (above, second) = walk.side(-1.0), walk.side(1.0)
        found = Interval(along.value(below), along.value(above), "profile", (first, second), level)
    except _TooLong:
        at, freedom = along.at(along.basis.fit.x), along.basis.information.freedom
        found = interval(at, along.std, freedom, along.bound, level, along.value)
    if points:
        walk.fill(points)
    known = sorted((p for p in walk.points if np.isfinite(p.rise)), key=lambda p: p.at)
    values, rise, limit = np.array([(along.value(p.at), max(p.rise, 0.0), p.limit) for p in known]).T
    best = min(known, key=lambda p: p.rise)
    gain = (along.basis.fit.cost - walk.least) / walk.unit - min(best.rise, 0.0)
    better = along.parameters.rope(best.x) if gain > WALK.better else None
    return Profile(
        **vars(found), name=along.label, values=values, rise=rise, limit=limit, gain=max(gain, 0.0), better=better
    )


class _TooLong(Exception):
    """A side has taken all its rounds."""


@dataclass(frozen=True)
class _Point:
    """A fit with the coordinate held at `at`."""

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
    """Walks away from the optimum along one coordinate, to either side."""

    def __init__(self, along: Coordinate, level: float, best: Fit, budget: Budget, report: Report | None) -> None:
        self.along, self.level, self.budget = along, level, budget
        self.rounds = WALK.most_rounds  # that one side may still take
        self.settled = True  # whether the last fit that could be simulated has converged
        basis = along.basis
        self.unit = along.unit
        enough = WALK.finish * self.unit / max(basis.fit.cost, 1e-300)
        self._fit = partial(
            fit, basis.plant, basis.windows, loss=best.loss, enough=enough, budget=budget, report=report
        )
        self.least = best.cost
        self.points = [self._point(best, best.cost)]

    def _point(self, found: Fit, squares: float) -> _Point:
        self.budget.check()  # else a fit that the budget has ended would pass for one that has settled
        rise, limit = (squares - self.least) / self.unit, self.along.limit(found.x, self.level)
        return _Point(self.along.at(found.x), found.x, found.states, rise, limit)

    def at(self, value: float) -> _Point | None:
        """Return the fit with the coordinate at `value`, as firmly held as it takes; None where none can be found."""
        start = min(self.points, key=lambda p: abs(p.at - value))
        x = self.along.aimed(start.x, value)
        follow = zip(start.states, self.along.basis.information.follow, strict=True)
        states, point = [s + f @ (x - start.x) for s, f in follow], start
        for firmness in WALK.firmness:
            if self.rounds <= 0:
                raise _TooLong
            target = self.along.target(value, firmness)
            try:
                found = self._fit(x, states, rounds=min(20, self.rounds), target=target)
            except InvalidInput:
                self.rounds, self.settled = self.rounds - 1, True
                return None
            self.rounds -= max(len(found.history), 1)
            x, states, self.settled = found.x, found.states, found.converged
            point = self._point(found, found.cost - target.residual(x) ** 2)
            if self.settled and not self.short(point, value):
                break
        self.points += [point] * self.settled
        return point if self.settled else None

    def short(self, point: _Point, value: float) -> bool:
        """Whether a point stays short of the value that it was drawn to, seen from the optimum."""
        origin = self.points[0].at
        return bool((value - point.at) * np.sign(value - origin) > WALK.reached * abs(value - origin))

    def side(self, sign: float) -> tuple[float, End]:
        """Return the coordinate of the end of the interval below (-1) or above (1) the optimum, and its kind."""
        self.rounds = WALK.most_rounds
        along, bound = self.along, self.along.bound if sign < 0.0 else np.inf
        inside, outside = self.points[0], None
        origin = inside.at
        value = origin + sign * along.std * float(np.sqrt(quantile(self.level, along.basis.information.freedom)))
        for _ in range(WALK.tries):
            value = max(value, bound) if sign < 0.0 else value
            if value == inside.at:  # at the bound, and allowed
                return value, "bound"
            tried = self.at(value)
            if tried is None or sign * (tried.at - inside.at) < -WALK.reached * along.std:  # or on the wrong side
                value = 0.5 * (value + inside.at)
                continue
            if abs(tried.excess) < WALK.close:
                return tried.at, "crossed"
            short = self.short(tried, value)
            inside, outside = (tried, outside) if tried.excess < 0.0 else (inside, tried)
            if (value == bound or short) and tried is inside:
                return bound if value == bound else tried.at, "bound"
            if outside is None:  # the root of the rise, taken as linear, meets the limit there
                root = max(float(np.sqrt(max(inside.rise, 0.0) / inside.limit)), 1.0 / WALK.longest)
                value = origin + max(1.0 / root, 1.05) * (inside.at - origin)
            else:
                part = inside.excess / (inside.excess - outside.excess)
                value = inside.at + float(np.clip(part, 0.05, 0.95)) * (outside.at - inside.at)
        if outside is None and self.settled:
            return sign * np.inf, "open"
        if outside is None:
            raise _TooLong
        known = WALK.loose * min(along.std, abs(outside.at - origin))
        if outside.excess > WALK.loose and abs(outside.at - inside.at) > known:
            raise _TooLong
        return outside.at, "crossed"

    def fill(self, points: int) -> None:
        """Add points of the curve between the optimum and the farthest one on either side."""
        values = np.array([p.at for p in self.points])
        for end in (values.min(), values.max()):
            for value in np.linspace(values[0], end, points + 2)[1:-1]:
                self.rounds = WALK.most_rounds
                if value != values[0]:
                    self.at(float(value))


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
        along = Coordinate(basis, label)
        found = profiled(along, LEVEL, begun=begun, budget=budget, report=heard)
        if found.kind == "profile":
            result[label] = _with_model_error(along, found)
        if found.gain > WALK.better:
            remarks.append(Finding(Kind.BETTER_OPTIMUM, Severity.LIMIT, {"name": label, "gain": found.gain}))
        elif found.kind == "covariance":
            remarks.append(Finding(Kind.PROFILE_GIVEN_UP, Severity.LIMIT, {"name": label}))
        yield result, remarks


def _with_model_error(along: Coordinate, found: Profile) -> Interval:
    """Return the interval of a profile, made wider by the model's errors; it stays within the parameter's bound."""
    information, x, parameter = along.basis.information, along.at(along.basis.fit.x), along.parameters.all[along.which]
    gradient, usual = along.slope[None] * parameter.derivative(x), quantile(found.level, information.freedom)
    whole, declared = information.spread(gradient), information.declared.model_spread(gradient)
    freedom = float(freedom_with(information.freedom, whole, declared)[0])
    wider = float(np.sqrt(quantile(found.level, freedom) / usual))
    model, value = float(information.model_spread(gradient)[0]) * float(np.sqrt(usual)), along.value(x)
    low = value - wider * float(np.hypot(value - found.low, model))
    high = value + wider * float(np.hypot(found.high - value, model))
    least = along.value(along.bound)
    ends: tuple[End, End] = ("bound" if low <= least else found.ends[0], found.ends[1])
    return Interval(max(low, least), high, "profile", ends, found.level)


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


def threshold(level: float, freedom: float, above: float) -> float:
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

    usual, normal, above = quantile(level, freedom), quantile(level, np.inf), max(above, 1e-9)

    def excess(limit: float) -> float:
        """Return by how much more often than `level` the truth is held with a limit."""
        return float(ndtr(np.sqrt(limit)) - ndtr(-0.5 * (above**2 + limit) / above)) - level

    if above**2 >= normal or not excess(above**2) < 0.0 < excess(normal):  # the latter by rounding, just below it
        return usual
    return usual * float(brentq(excess, above**2, normal)) / normal
