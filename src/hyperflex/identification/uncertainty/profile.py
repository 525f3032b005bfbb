"""Profile likelihood: one parameter held at a value, all others fitted again."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.fit.loss import Loss
from hyperflex.identification.fit.multiple_shooting import Fit, Report, fit
from hyperflex.identification.result import Identification
from hyperflex.identification.uncertainty.covariance import Basis, End, checked_level, from_covariance
from hyperflex.identification.uncertainty.threshold import quantile, threshold
from hyperflex.interruption import interruptible
from hyperflex.model import Rope

FINISH = 1e-2  # gain of a round, in units of the residual variance, below which a point of the profile has settled
CLOSE = 0.01  # std to which an end is found
LONGEST = 3.0  # factor by which a step may grow
TRIES = 25  # points on either side
MOST_ROUNDS = 100  # of all fits on one side; usual are ten
PROMISING = 4  # rounds of a fit after which its squares must not be HOPELESS
HOPELESS = 1e4  # rise of the squares after the first rounds, over the residual variance: not this optimum's valley
BETTER = 1.0  # fall of the squares, over the residual variance, from which another optimum is said to be better


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile likelihood of one parameter, and its interval.

    Attributes
    ----------
    name : str
        Of the parameter, as in ``Identification.parameters``.
    low, high, level : float
        The interval, SI units, inf where the data set no limit; its confidence level. Of noise alone:
        ``Identification.intervals`` add errors of the model and of the lengths.
    ends : tuple of str
        Of either end: ``crossed`` where the curve crosses the limit, ``bound`` where the parameter's own bound comes
        first, ``open`` where neither was found (no limit in the data, or the rope cannot be simulated there).
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
    """A fit with the parameter held at x[which]."""

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
    """Return the profile likelihood interval of one parameter.

    Parameters
    ----------
    found : Identification
        Of :func:`identify`, in the same session.
    name : str
        One of ``found.parameters``, e.g. ``inertia:shared``.
    level : float
        Confidence level.
    points : int
        So many more points of the curve on either side, for drawing.
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
    F(1, freedom), or beside a bound with the distribution there (see ``threshold``). Robust losses are treated as in
    :func:`estimate_covariance`. Cost: about three fits of two or three rounds a side, a hundred rounds at most.
    """
    basis, level = found.basis, checked_level(level)
    labels = basis.plant.parameters.labels
    if name not in labels:
        raise InvalidInput("no such parameter was free", got=name, allowed=", ".join(labels))
    return profiled(basis, labels.index(name), level, checks.count("points", points, least=0), progress)


def profiled(basis: Basis, which: int, level: float, points: int = 0, report: Report | None = None) -> Profile:
    """Return the profile of parameter number `which`; see :func:`profile`."""
    parameter = basis.plant.parameters.all[which]
    variances = np.diag(basis.information.covariance)
    unknown = np.isinf(basis.information.deviations(np.ones(variances.size))[which])
    if unknown or variances[which] <= 0.0:
        least = parameter.value(basis.plant.parameters.lower[which])
        return Profile(parameter.label, least, np.inf, level, ("open", "open"), *np.zeros((3, 0)))
    walk = _ProfileSearch(basis, which, level, report)
    kind: Literal["profile", "covariance"] = "profile"
    try:
        below, first = walk.side(-1.0)
        above, second = walk.side(1.0)
        low = parameter.value(below) if np.isfinite(below) or parameter.form == "log" else -np.inf
        high = parameter.value(above) if np.isfinite(above) else np.inf
        ends = first, second
    except _BudgetExceeded:
        kind, interval = "covariance", from_covariance(basis.of_noise, which, level)
        low, high, ends = interval.low, interval.high, interval.ends
    if points:
        walk.fill(points)
    known = sorted((p for p in walk.points if np.isfinite(p.rise)), key=lambda p: float(p.x[which]))
    values, rise, limit = np.array([(parameter.value(float(p.x[which])), max(p.rise, 0.0), p.limit) for p in known]).T
    best = min(known, key=lambda p: p.rise)
    gain = (basis.fit.cost - walk.least) / walk.unit - min(best.rise, 0.0)
    better = basis.plant.parameters.rope(best.x) if gain > BETTER else None
    return Profile(parameter.label, low, high, level, ends, values, rise, limit, kind, max(gain, 0.0), better)


class _HopelessError(Exception):
    """A fit is nowhere near."""


class _BudgetExceeded(Exception):
    """A side has taken all its rounds."""


class _ProfileSearch:
    """Walks away from the optimum along one parameter, to either side."""

    def __init__(self, basis: Basis, which: int, level: float, report: Report | None) -> None:
        self.basis, self.which, self.level, self.report = basis, which, level, report
        self.budget = MOST_ROUNDS
        information, found = basis.information, basis.fit
        self.lower = basis.plant.parameters.lower
        self.loss = Loss(found.loss.name, found.loss.scale, fixed=True)
        self.column = information.covariance[:, which] / information.covariance[which, which]
        self.std = float(np.sqrt(information.covariance[which, which]))
        self.unit = information.variance * float(information.covariance[which, which] / information.plain[which, which])
        self.enough = FINISH * information.variance / max(found.cost, 1e-300)
        best = self._fit(found.x, found.states, 10)
        self.least = best.cost
        self.points = [self._point(best.x, best.states, best.cost)]

    def _point(self, x: Array, states: list[Array], cost: float) -> _Point:
        information = self.basis.information
        rise = (cost - self.least) / self.unit  # negative where this optimum is a better one
        limit = threshold(self.level, information.freedom, self.which, information.covariance, x - self.lower)
        return _Point(x, states, rise, limit)

    def _fit(
        self, x: Array, states: list[Array], rounds: int, held: tuple[int, ...] = (), report: Report | None = None
    ) -> Fit:
        """Return a fit from there, all other than `held` free."""
        plant, windows = self.basis.plant, self.basis.windows
        loss, enough, report = self.loss, self.enough, report or self.report
        return fit(plant, windows, x, states, loss=loss, enough=enough, rounds=rounds, report=report, held=held)

    def at(self, value: float) -> _Point | None:
        """Return the fit with the parameter at `value`, from the nearest one known; None where none can be found."""
        start = min(self.points, key=lambda p: abs(float(p.x[self.which]) - value))
        x = np.maximum(start.x + self.column * (value - start.x[self.which]), self.lower)
        x[self.which] = value
        move = x - start.x
        states = [s + f @ move for s, f in zip(start.states, self.basis.information.follow, strict=True)]
        for begin in (states, start.states):
            if self.budget <= 0:
                raise _BudgetExceeded
            found = self._reached(x, begin)
            if found is None:
                continue
            self.points.append(self._point(found.x, found.states, found.cost))
            return self.points[-1]
        return None

    def _reached(self, x: Array, states: list[Array]) -> Fit | None:
        """Return the fit from there, or None where it cannot be simulated or is far from any of interest."""
        taken = 0

        def look(entry: dict[str, Any]) -> None:
            nonlocal taken
            taken += 1
            if self.report is not None:
                self.report(entry)
            if taken >= PROMISING and (entry["cost"] - self.least) / self.unit > HOPELESS:
                raise _HopelessError

        try:
            return self._fit(x, states, min(20, self.budget), held=(self.which,), report=look)
        except (InvalidInput, _HopelessError):
            return None
        finally:
            self.budget -= max(taken, 1)

    def side(self, sign: float) -> tuple[float, End]:
        """Return x of the end of the interval below (-1) or above (1) the optimum, and its kind."""
        self.budget = MOST_ROUNDS
        bound = float(self.lower[self.which]) if sign < 0.0 else np.inf
        inside, outside = self.points[0], None
        origin = float(inside.x[self.which])
        step = self.std * float(np.sqrt(quantile(self.level, self.basis.information.freedom)))
        value = origin + sign * step
        for _ in range(TRIES):
            value = max(value, bound) if sign < 0.0 else value
            if value == float(inside.x[self.which]):  # at the bound, and allowed
                return value, "bound"
            tried = self.at(value)
            if tried is None:
                value = 0.5 * (value + float(inside.x[self.which]))
                continue
            if abs(tried.excess) < CLOSE:
                return value, "crossed"
            inside, outside = (tried, outside) if tried.excess < 0.0 else (inside, tried)
            if value == bound and tried is inside:
                return value, "bound"
            value = self._next(origin, inside, outside, step)
        if outside is None:
            return sign * np.inf, "open"
        return float(outside.x[self.which]), "crossed"

    def _next(self, origin: float, inside: _Point, outside: _Point | None, step: float) -> float:
        """Return where to look next: where the root of the rise, taken as linear, meets the limit."""
        here = float(inside.x[self.which])
        if outside is None:
            root = max(float(np.sqrt(max(inside.rise, 0.0) / inside.limit)), 1.0 / LONGEST)
            return origin + max(1.0 / root, 1.05) * (here - origin) if here != origin else origin + step
        there = float(outside.x[self.which])
        part = -inside.excess / (outside.excess - inside.excess)
        return here + float(np.clip(part, 0.05, 0.95)) * (there - here)

    def fill(self, points: int) -> None:
        """Add points of the curve between the optimum and the farthest one on either side."""
        values = np.array([p.x[self.which] for p in self.points])
        for end in (values.min(), values.max()):
            for value in np.linspace(values[0], end, points + 2)[1:-1]:
                self.budget = MOST_ROUNDS
                if value != values[0]:
                    self.at(float(value))
