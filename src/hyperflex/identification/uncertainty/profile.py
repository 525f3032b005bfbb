"""Profile likelihood: one parameter or ratio held at a value, all others fitted again."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import Fit, Report, fit
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.coordinate import Coordinate, ParameterCoordinate, RatioCoordinate
from hyperflex.identification.uncertainty.covariance import Basis, End, checked_level
from hyperflex.identification.uncertainty.threshold import quantile, threshold
from hyperflex.interruption import interruptible
from hyperflex.model import Rope


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

    def __init__(self, basis: Basis, along: Coordinate, level: float, budget: Budget, report: Report | None) -> None:
        self.basis, self.along, self.level, self.budget, self.report = basis, along, level, budget, report
        self.rounds = WALK.most_rounds  # that one side may still take
        information, found = basis.information, basis.fit
        self.loss = Loss(found.loss.name, found.loss.scale, fixed=True)
        self.unit = information.variance * along.widening
        self.enough = WALK.finish * information.variance / max(found.cost, 1e-300)
        best = self._fit(found.x, found.states, 10)
        self.least = best.cost
        self.points = [self._point(best.x, best.states, best.cost)]

    def _point(self, x: Array, states: list[Array], cost: float) -> _Point:
        rise = (cost - self.least) / self.unit  # negative where this optimum is a better one
        which, covariance, above = self.along.limits(x)
        limit = threshold(self.level, self.basis.information.freedom, which, covariance, above)
        return _Point(self.along.at(x), x, states, rise, limit)

    def _fit(self, x: Array, states: list[Array], rounds: int, **held: Any) -> Fit:
        """Return a fit from there, all free but for what is `held`."""
        plant, windows = self.basis.plant, self.basis.windows
        how: dict[str, Any] = {"loss": self.loss, "enough": self.enough, "budget": self.budget, "report": self.report}
        found = fit(plant, windows, x, states, rounds=rounds, **how, **held)
        self.rounds -= max(len(found.history), 1)
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
        rounds = min(20, self.rounds)
        try:
            found = self._fit(x, states, min(WALK.promising, rounds), **held)
            if found.converged or len(found.history) < WALK.promising:
                return found
            if "target" not in held and (found.cost - self.least) / self.unit > WALK.hopeless:
                return None
            return self._fit(found.x, found.states, max(1, rounds - WALK.promising), **held)
        except InvalidInput:
            return None

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
