"""Profile likelihood of a parameter or ratio, all else fitted again; and which intervals are found by it."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.findings import Finding, Kind, Severity
from hyperflex.identification.fit import Fit, Loss, Report, Target, fit, with_entries
from hyperflex.identification.options import How
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import (
    LEVEL,
    SIGNED,
    Basis,
    End,
    Interval,
    around,
    checked_level,
    from_covariance,
)
from hyperflex.identification.uncertainty.ratios import ratio_gradients, ratios
from hyperflex.identification.uncertainty.threshold import near_bounds, quantile, threshold
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Rope

# Of a target, in 1 / std: the data hold a ratio back from it by a millionth of its way; where another parameter is at
# its bound they may do so a thousand times more than the standard deviation says
WEIGHT = 1000.0
TRIED = 2  # steps, each half of the one before, with which a start is to bring a ratio a quarter of its way


class _Coordinate:
    """A function of x (P,) that a profile follows.

    Attributes
    ----------
    label : str
        The name, as in ``Identification.intervals``.
    origin, std : float
        Value at the fit, and its standard deviation by noise; 0 or not finite where the data do not determine it.
    column : (P,) array
        How the estimate of x moves with the coordinate.
    widening : float
        By what factor autocorrelated residuals widen its variance.
    bound : float
        The least value of the coordinate, -inf where none is known beforehand.
    """

    def __init__(self, basis: Basis, label: str, slope: Array, bound: float, *, known: bool) -> None:
        information = basis.information
        self.basis, self.label, self.bound = basis, label, bound
        self.parameters, self.lower = basis.plant.parameters, basis.plant.parameters.lower
        self.origin = self.at(basis.fit.x)
        variance = float(slope @ information.covariance @ slope)
        self.std = (float(np.sqrt(variance)) if variance > 0.0 else 0.0) if known else float("inf")
        known = known and self.std > 0.0
        self.column = information.covariance @ slope / variance if known else np.zeros(slope.size)
        self.widening = variance / float(slope @ information.plain @ slope) if known else 1.0

    def at(self, x: Array) -> float:
        """Return the coordinate of x."""
        raise NotImplementedError


class ParameterCoordinate(_Coordinate):
    """One of the parameters, by its x."""

    def __init__(self, basis: Basis, which: int) -> None:
        self.which, parameters = which, basis.plant.parameters
        one = np.eye(len(parameters))[which]
        known = bool(np.isfinite(basis.information.deviations(np.ones(one.size))[which]))
        super().__init__(basis, parameters.labels[which], one, float(parameters.lower[which]), known=known)

    def at(self, x: Array) -> float:
        """Return its x."""
        return float(x[self.which])

    def value(self, at: float) -> float:
        """Return the value in SI units."""
        return self.parameters.all[self.which].value(at)

    def aimed(self, x: Array, at: float) -> Array:
        """Return where a fit held at `at` begins: x with this one set, the others moved along, within their bounds."""
        begun: Array = np.maximum(x + self.column * (at - self.at(x)), self.lower)
        begun[self.which] = at
        return begun

    def held(self, at: float, unit: float, firmness: float) -> dict[str, Any]:
        """Return the options of ``fit`` that hold it where the fit begins."""
        return {"held": (self.which,)}

    def limits(self, x: Array) -> tuple[int, Array, Array]:
        """Return for ``threshold`` its number, the covariance (P, P), and the distances (P,) of x above the bounds."""
        return self.which, self.basis.information.covariance, x - self.lower

    def by_std(self, level: float) -> Interval:
        """Return its interval of noise from the standard deviation."""
        return from_covariance(self.basis.of_noise, self.which, level)


class RatioCoordinate(_Coordinate):
    """A ratio such as ``J/p1[0]``, by its value."""

    def __init__(self, basis: Basis, name: str, link: int) -> None:
        self.name, self.link, self.parameters = name, link, basis.plant.parameters
        slope = self.gradient(basis.fit.x)
        known = bool(np.isfinite(basis.information.spread(slope[None])[0]))
        super().__init__(basis, f"{name}[{link}]", slope, -np.inf if name in SIGNED else 0.0, known=known)
        self.least = self._least(slope, basis.fit.x)

    def _least(self, slope: Array, x: Array) -> float:
        """Return the least ratio that bounds allow, in so far as it is known: of a resistance, or of one parameter."""
        if self.name not in ("J/p1", *SIGNED):
            return 0.0
        movers = np.flatnonzero(slope)
        if movers.size != 1 or slope[movers[0]] < 0.0 or not np.isfinite(self.lower[movers[0]]):
            return -np.inf
        lowest = x.copy()
        lowest[movers[0]] = self.lower[movers[0]]
        return self.at(lowest) if self.parameters.possible(lowest) is not None else -np.inf

    def at(self, x: Array) -> float:
        """Return the ratio."""
        return float(ratios(self.parameters.rope(x), self.parameters.names)[self.name][self.link])

    def gradient(self, x: Array) -> Array:
        """Return its derivatives by x (P,)."""
        slope: Array = ratio_gradients(self.parameters, x)[self.name][self.link]
        return slope

    def value(self, at: float) -> float:
        """Return the ratio, which is in SI units, within the bound."""
        return max(at, self.bound)

    def aimed(self, x: Array, at: float) -> Array:
        """Return where a fit at `at` begins: x moved along, as far as the ratio goes along; a target draws it on."""
        here, part = self.at(x), 1.0
        for _ in range(TRIED):
            begun = np.maximum(x + part * self.column * (at - here), self.lower)
            if self.parameters.possible(begun) is not None and abs(self.at(begun) - at) < 0.75 * abs(at - here):
                return np.asarray(begun)
            part *= 0.5
        return x

    def held(self, at: float, unit: float, firmness: float) -> dict[str, Any]:
        """Return the target that draws it to `at`, so many times more firmly than usual.

        `unit` is the rise of the squares one std away. The target lies beyond by what the data hold the ratio back.
        """
        weight = firmness * WEIGHT
        beyond = at + (at - self.origin) / weight**2
        return {"target": Target(self.at, self.gradient, beyond, weight * float(np.sqrt(unit)) / self.std)}

    def limits(self, x: Array) -> tuple[int, Array, Array]:
        """Return the number, the variance (1, 1) and the distance (1,) of the ratio alone above its bound.

        Other parameters' bounds do not count: where all share an unknown factor they are not in a ratio's way.
        """
        return 0, np.array([[self.std**2]]), np.array([self.at(x) - self.least])

    def by_std(self, level: float) -> Interval:
        """Return its interval of noise from the standard deviation, within its bound."""
        half = self.std * float(np.sqrt(quantile(level, self.basis.information.freedom)))
        return around(self.origin, half, self.bound, level)


Coordinate = ParameterCoordinate | RatioCoordinate


@dataclass(frozen=True)
class ProfileOptions:
    """How a profile walks away from the optimum."""

    # gain of a round, in units of the residual variance, below which a point of the profile has settled
    finish: float = 0.01
    # std to which an end is found
    close: float = 0.01
    # std, and part of the way to it; an end that is not known so well after all TRIES is not told
    loose: float = 0.1
    # part of the way that a ratio may stay short of its aim
    reached: float = 0.1
    # factor by which a step may grow
    longest: float = 3.0
    # points on either side
    tries: int = 25
    # of all fits on one side; usual are ten
    most_rounds: int = 100
    # rounds of a fit after which its squares must not be HOPELESS
    promising: int = 4
    # rise of the squares after the first rounds, over the residual variance: not this optimum's valley
    hopeless: float = 10000.0
    # fall of the squares, over the residual variance, from which another optimum is said to be better
    better: float = 1.0


WALK = ProfileOptions()
# Firmness with which a ratio is drawn there, one after the other, before a bound is said to be in its way
FIRMNESS = (1.0, 10.0, 100.0)


@dataclass(frozen=True, eq=False)
class Profile:
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
    low: float
    high: float
    level: float
    ends: tuple[End, End]
    values: Array
    rise: Array
    limit: Array
    kind: Literal["profile", "covariance"] = "profile"
    gain: float = 0.0
    better: Rope | None = None


@dataclass(frozen=True)
class _Point:
    """A fit with the coordinate held at `at`."""

    at: float
    x: Array
    states: list[Array]
    rise: float
    limit: float

    @property
    def excess(self) -> float:
        """How far beyond the limit it stands, in std; negative within."""
        return float(np.sqrt(max(self.rise, 0.0)) - np.sqrt(self.limit))


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
    divided by the factor by which autocorrelation widens the variance, is compared with F(1, freedom), or beside a
    bound with the distribution there (see ``threshold``). Robust losses are treated as in :func:`estimate_covariance`.
    Cost: about three fits of two or three rounds a side, a hundred rounds at most.
    """
    basis, level, points = found.basis, checked_level(level), checks.count("points", points, least=0)
    labels = basis.plant.parameters.labels
    if name in labels:
        return profiled(basis, ParameterCoordinate(basis, labels.index(name)), level, points, report=progress)
    moved = {
        f"{ratio}[{k}]": (ratio, k) for ratio, std in found.ratio_std.items() for k in np.flatnonzero(std).tolist()
    }
    if name not in moved:
        raise InvalidInput(
            "no such parameter was free, and no free one moves such a ratio",
            got=name,
            allowed=", ".join([*labels, *moved]),
        )
    return profiled(basis, RatioCoordinate(basis, *moved[name]), level, points, report=progress)


def profiled(
    basis: Basis,
    along: Coordinate,
    level: float,
    points: int = 0,
    *,
    budget: Budget | None = None,
    report: Report | None = None,
) -> Profile:
    """Return the profile along a coordinate; see :func:`profile`."""
    if not np.isfinite(along.std) or along.std == 0.0:
        return Profile(along.label, along.value(along.bound), np.inf, level, ("open", "open"), *np.zeros((3, 0)))
    walk = _ProfileSearch(basis, along, level, budget or Budget(), report)
    kind: Literal["profile", "covariance"] = "profile"
    try:
        below, first = walk.side(-1.0)
        above, second = walk.side(1.0)
        low, high, ends = along.value(below), along.value(above), (first, second)
    except _TooLong:
        kind, interval = "covariance", along.by_std(level)
        low, high, ends = interval.low, interval.high, interval.ends
    if points:
        walk.fill(points)
    known = sorted((p for p in walk.points if np.isfinite(p.rise)), key=lambda p: p.at)
    values, rise, limit = np.array([(along.value(p.at), max(p.rise, 0.0), p.limit) for p in known]).T
    best = min(known, key=lambda p: p.rise)
    gain = (basis.fit.cost - walk.least) / walk.unit - min(best.rise, 0.0)
    better = basis.plant.parameters.rope(best.x) if gain > WALK.better else None
    return Profile(along.label, low, high, level, ends, values, rise, limit, kind, max(gain, 0.0), better)


class _TooLong(Exception):
    """A side has taken all its rounds."""


class _ProfileSearch:
    """Walks away from the optimum along one coordinate, to either side."""

    def __init__(
        self,
        basis: Basis,
        along: Coordinate,
        level: float,
        budget: Budget,
        report: Report | None,
    ) -> None:
        self.basis, self.along, self.level, self.budget, self.report = basis, along, level, budget, report
        self.rounds = WALK.most_rounds  # that one side may still take
        information, found = basis.information, basis.fit
        self.loss = Loss(found.loss.name, found.loss.scale, fixed=True)
        self.unit = information.variance * along.widening
        self.enough = WALK.finish * information.variance / max(found.cost, 1e-300)
        best = self._fit(found.x, found.states, 10, report)
        self.least = best.cost
        self.points = [self._point(best.x, best.states, best.cost)]

    def _point(self, x: Array, states: list[Array], cost: float) -> _Point:
        rise = (cost - self.least) / self.unit  # negative where this optimum is a better one
        which, covariance, above = self.along.limits(x)
        limit = threshold(self.level, self.basis.information.freedom, which, covariance, above)
        return _Point(self.along.at(x), x, states, rise, limit)

    def _fit(self, x: Array, states: list[Array], rounds: int, report: Report | None = None, **held: Any) -> Fit:
        """Return a fit from there, all free but for what is `held`."""
        how: dict[str, Any] = {"loss": self.loss, "enough": self.enough, "budget": self.budget, "report": report}
        found = fit(self.basis.plant, self.basis.windows, x, states, rounds=rounds, **how, **held)
        self.budget.check()  # else a fit that the budget has ended would pass for one that has settled
        return found

    def at(self, value: float) -> _Point | None:
        """Return the fit with the coordinate at `value`, from the nearest one known; None where none can be found."""
        start = min(self.points, key=lambda p: abs(p.at - value))
        x = self.along.aimed(start.x, value)
        move = x - start.x
        states = [s + f @ move for s, f in zip(start.states, self.basis.information.follow, strict=True)]
        for begin in (states, start.states):
            found = self._drawn(x, begin, value)
            if found is not None:
                self.points.append(found)
                return found
        return None

    def _drawn(self, x: Array, states: list[Array], value: float) -> _Point | None:
        """Return the fit from there with the coordinate at `value`, as firmly held as it takes; None on failure."""
        point, found = None, None
        for firmness in FIRMNESS:
            if self.rounds <= 0:
                raise _TooLong
            held = self.along.held(value, self.unit, firmness)
            found = self._reached(x, states, held)
            if found is None:
                return None
            if "target" not in held:
                return self._point(found.x, found.states, found.cost)
            x, states = found.x, found.states
            point = self._point(x, states, found.cost - held["target"].residual(x) ** 2)
            if found.converged and not self.short(point, value):
                return point
        return point if found is not None and found.converged else None

    def short(self, point: _Point, value: float) -> bool:
        """Whether a point stays short of the value that it was drawn to, seen from the optimum."""
        origin = self.points[0].at
        return bool((value - point.at) * np.sign(value - origin) > WALK.reached * abs(value - origin))

    def _reached(self, x: Array, states: list[Array], held: dict[str, Any]) -> Fit | None:
        """Return the fit from there, or None where it cannot be simulated or is far from any of interest."""
        taken = 0

        def watch(entry: dict[str, Any]) -> None:
            nonlocal taken
            taken += 1
            if self.report is not None:
                self.report(entry)
            rise = (entry["cost"] - self.least) / self.unit
            if "target" not in held and taken >= WALK.promising and rise > WALK.hopeless:
                raise InvalidInput("no fit of interest is near")

        try:
            return self._fit(x, states, min(20, self.rounds), watch, **held)
        except InvalidInput:
            return None
        finally:
            self.rounds -= max(taken, 1)

    def side(self, sign: float) -> tuple[float, End]:
        """Return the coordinate of the end of the interval below (-1) or above (1) the optimum, and its kind."""
        self.rounds = WALK.most_rounds
        bound = self.along.bound if sign < 0.0 else np.inf
        inside, outside = self.points[0], None
        origin = inside.at
        step = self.along.std * float(np.sqrt(quantile(self.level, self.basis.information.freedom)))
        value = origin + sign * step
        for _ in range(WALK.tries):
            value = max(value, bound) if sign < 0.0 else value
            if value == inside.at:  # at the bound, and allowed
                return value, "bound"
            tried = self.at(value)
            if tried is None or sign * (tried.at - inside.at) < -WALK.reached * self.along.std:  # or on the wrong side
                value = 0.5 * (value + inside.at)
                continue
            if abs(tried.excess) < WALK.close:
                return tried.at, "crossed"
            short = self.short(tried, value)
            inside, outside = (tried, outside) if tried.excess < 0.0 else (inside, tried)
            if (value == bound or short) and tried is inside:
                return bound if value == bound else tried.at, "bound"
            value = self._next(origin, inside, outside, step)
        if outside is None:
            return sign * np.inf, "open"
        known = WALK.loose * min(self.along.std, abs(outside.at - origin))
        if outside.excess > WALK.loose and abs(outside.at - inside.at) > known:
            raise _TooLong
        return outside.at, "crossed"

    def _next(self, origin: float, inside: _Point, outside: _Point | None, step: float) -> float:
        """Return where to look next: where the root of the rise, taken as linear, meets the limit."""
        here = inside.at
        if outside is None:
            root = max(float(np.sqrt(max(inside.rise, 0.0) / inside.limit)), 1.0 / WALK.longest)
            return origin + max(1.0 / root, 1.05) * (here - origin) if here != origin else origin + step
        part = -inside.excess / (outside.excess - inside.excess)
        return here + float(np.clip(part, 0.05, 0.95)) * (outside.at - here)

    def fill(self, points: int) -> None:
        """Add points of the curve between the optimum and the farthest one on either side."""
        values = np.array([p.at for p in self.points])
        for end in (values.min(), values.max()):
            for value in np.linspace(values[0], end, points + 2)[1:-1]:
                self.rounds = WALK.most_rounds
                if value != values[0]:
                    self.at(float(value))


TIED = 0.1  # correlation with a parameter beside its bound from which the bound is felt
BENT = 0.1  # part by which the root of the rise may depart from a straight line before the covariance is left
MOST = 4  # profiles that "auto" takes on, each as dear as two or three fits


def all_intervals(
    basis: Basis,
    how: How,
    level: float = LEVEL,
    *,
    remarks: list[Finding] | None = None,
    budget: Budget | None = None,
    report: Report | None = None,
) -> dict[str, Interval]:
    """Return intervals of all free parameters, by label.

    ``auto`` profiles up to four parameters whose covariance is skewed: within four standard deviations of a bound,
    correlated with such a one, or with squares that do not rise as a parabola; of more, those nearest to their bounds.
    What a profile shows besides is added to `remarks`. `report` gets each round of each profile, with its ``parameter``
    and ``phase="profile"``. Ctrl-C raises Interrupted; in its ``partial``, and out of time, what was not profiled yet
    has intervals from the covariance.
    """
    result = {label: from_covariance(basis, which, level) for which, label in enumerate(basis.plant.parameters.labels)}
    labels = list(result)
    if how == "covariance":
        return result
    with stoppable() as stop:
        chosen = _skewed_parameters(basis) if how == "auto" else list(range(len(labels)))
        chosen = [k for k in chosen if result[labels[k]].kind != "unknown"]
        length = max(float(w.t[-1] - w.t[0]) for w in basis.windows)
        for number, k in enumerate(chosen):
            at = {"phase": "profile", "parameter": labels[k], "window": length, "stage": number, "stages": len(chosen)}
            along = ParameterCoordinate(basis, k)
            found = profiled(
                basis, along, level, budget=budget, report=None if report is None else with_entries(report, at)
            )
            if found.kind == "profile":
                interval = Interval(found.low, found.high, found.kind, found.ends, level)
                result[labels[k]] = _with_model_error(basis, k, interval)
            if remarks is not None:
                remarks += _remarks(found)
    return stop.deliver(result)


def _with_model_error(basis: Basis, which: int, interval: Interval) -> Interval:
    """Return the interval of a profile, made wider by the model's errors; it stays within the parameter's bound."""
    parameter, information = basis.plant.parameters.all[which], basis.information
    x = float(information.x[which])
    one = np.eye(information.x.size)[which : which + 1] * parameter.derivative(x)
    value = parameter.value(x)
    model = float(information.model_spread(one)[0]) * float(np.sqrt(quantile(interval.level, information.freedom)))
    low = value - float(np.hypot(value - interval.low, model))
    least = -np.inf if parameter.form == "linear" else 0.0
    end: End = "bound" if low <= least else interval.ends[0]
    high = value + float(np.hypot(interval.high - value, model))
    return replace(interval, low=max(low, least), high=high, ends=(end, interval.ends[1]))


def _remarks(found: Profile) -> list[Finding]:
    """Return that a profile has found a better optimum, or took too long."""
    if found.gain > WALK.better:
        return [Finding(Kind.BETTER_OPTIMUM, Severity.LIMIT, {"name": found.name, "gain": found.gain})]
    return [Finding(Kind.PROFILE_GIVEN_UP, Severity.LIMIT, {"name": found.name})] * (found.kind == "covariance")


def skewed(basis: Basis, which: int) -> bool:
    """Tell whether the covariance does not suffice for a parameter.

    Beside a bound, its own or that of one it correlates with; or where, two standard deviations away along the line of
    the covariance, the squares rise otherwise than by four. Two rollouts of all windows.
    """
    information = basis.information
    covariance, std = information.covariance, np.sqrt(np.diag(information.covariance))
    near = np.flatnonzero(near_bounds(covariance, information.x - basis.plant.parameters.lower))
    if std[which] == 0.0:
        return False
    if any(abs(covariance[which, k]) > TIED * std[which] * std[k] for k in near):
        return True
    for step in (-2.0, 2.0):
        move = step * information.plain[:, which] / np.sqrt(information.plain[which, which])
        rise = _rise(basis, move)
        if rise is None or abs(np.sqrt(max(rise, 0.0)) / abs(step) - 1.0) > BENT:
            return True
    return False


def _skewed_parameters(basis: Basis) -> list[int]:
    information = basis.information
    std = np.sqrt(np.diag(information.covariance))
    above = (information.x - basis.plant.parameters.lower) / np.where(std > 0.0, std, 1.0)
    known = np.isfinite(information.deviations(np.ones(std.size)))
    chosen: list[int] = []
    for k in np.argsort(above, kind="stable"):
        if len(chosen) < MOST and known[k] and skewed(basis, int(k)):
            chosen.append(int(k))
    return chosen


def _rise(basis: Basis, move: Array) -> float | None:
    """Return the rise of the cost over the residual variance, x and states moved along a straight line."""
    found, total = basis.fit, 0.0
    for window, state, follow in zip(basis.windows, found.states, basis.information.follow, strict=True):
        moved = state + follow @ move
        residual = window.residual(basis.plant, found.x + move, moved)
        if residual is None:
            return None
        total += found.window_cost(window, moved, residual)
    return (total - found.cost) / basis.information.variance
