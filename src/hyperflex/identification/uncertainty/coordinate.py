"""What a profile follows: one parameter, or a ratio of several."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.fit.multiple_shooting import Target
from hyperflex.identification.uncertainty.covariance import SIGNED, Basis, End, Interval, from_covariance
from hyperflex.identification.uncertainty.ratios import ratio_gradients, ratios
from hyperflex.identification.uncertainty.threshold import quantile

# Of a target, in 1 / std: the data hold a ratio back from it by a millionth of its way; where another parameter is at
# its bound they may do so a thousand times more than the standard deviation says
WEIGHT = 1000.0
TRIED = 2  # steps, each half of the one before, with which a start is to bring a ratio a quarter of its way


class Coordinate(ABC):
    """A function of x (P,) that a profile follows, by its own coordinate.

    Attributes
    ----------
    label : str
        The name, as in ``Identification.intervals``.
    origin, std : float
        Where the fit stands, and its standard deviation by noise; 0 or not finite where the data tell nothing.
    column : (P,) array
        How the estimate of x moves with the coordinate.
    widening : float
        By what factor autocorrelated residuals widen its variance.
    bound : float
        The least value of the coordinate, -inf where none is known beforehand.
    """

    label: str
    origin: float
    std: float
    column: Array
    widening: float
    bound: float

    @abstractmethod
    def at(self, x: Array) -> float:
        """Return the coordinate of x."""

    @abstractmethod
    def value(self, at: float) -> float:
        """Return the value in SI units."""

    @abstractmethod
    def aimed(self, x: Array, at: float) -> Array:
        """Return where a fit with the coordinate at `at` begins (P,), from a point x (P,) of the curve."""

    @abstractmethod
    def held(self, at: float, unit: float, firmness: float) -> dict[str, Any]:
        """Return the options of ``fit`` that hold it at `at`, a ratio so many times more firmly than usual.

        `unit` is the rise of the squares one std away.
        """

    @abstractmethod
    def limits(self, x: Array) -> tuple[int, Array, Array]:
        """Return for ``threshold``: its number, the covariance (k, k), and the distances (k,) of x above the bounds."""

    @abstractmethod
    def by_std(self, level: float) -> Interval:
        """Return its interval of noise from the standard deviation."""


class ParameterCoordinate(Coordinate):
    """One of the parameters, by its x."""

    def __init__(self, basis: Basis, which: int) -> None:
        information, parameters = basis.information, basis.plant.parameters
        self.basis, self.which, self.parameter, self.lower = basis, which, parameters.all[which], parameters.lower
        self.label, self.origin, self.bound = self.parameter.label, float(basis.fit.x[which]), float(self.lower[which])
        self.covariance = information.covariance
        variance = float(self.covariance[which, which])
        self.std = float(np.sqrt(variance)) if variance > 0.0 else 0.0
        if not np.isfinite(information.deviations(np.ones(self.lower.size))[which]):
            self.std = float("inf")
        known = self.std > 0.0 and np.isfinite(self.std)
        self.column = self.covariance[:, which] / variance if known else np.zeros(self.lower.size)
        self.widening = variance / float(information.plain[which, which]) if known else 1.0

    def at(self, x: Array) -> float:
        """Return its x."""
        return float(x[self.which])

    def value(self, at: float) -> float:
        """Return the value in SI units."""
        return self.parameter.value(at)

    def aimed(self, x: Array, at: float) -> Array:
        """Return x with this one set, the others moved along and within their bounds."""
        begun: Array = np.maximum(x + self.column * (at - self.at(x)), self.lower)
        begun[self.which] = at
        return begun

    def held(self, at: float, unit: float, firmness: float) -> dict[str, Any]:
        """Return what holds it where the fit begins."""
        return {"held": (self.which,)}

    def limits(self, x: Array) -> tuple[int, Array, Array]:
        """Return its number, the covariance, and the distances above the bounds."""
        return self.which, self.covariance, x - self.lower

    def by_std(self, level: float) -> Interval:
        """Return its interval of noise from the standard deviation."""
        return from_covariance(self.basis.of_noise, self.which, level)


class RatioCoordinate(Coordinate):
    """A ratio such as ``J/p1[0]``, by its value."""

    def __init__(self, basis: Basis, name: str, link: int) -> None:
        self.parameters, self.name, self.link = basis.plant.parameters, name, link
        self.label, self.lower = f"{name}[{link}]", basis.plant.parameters.lower
        information, x = basis.information, basis.fit.x
        self.origin, slope = self.at(x), self.gradient(x)
        variance = float(slope @ information.covariance @ slope)
        self.std = float(np.sqrt(variance)) if variance > 0.0 else 0.0
        if not np.isfinite(information.spread(slope[None])[0]):
            self.std = float("inf")
        known = self.std > 0.0 and np.isfinite(self.std)
        self.column = information.covariance @ slope / variance if known else np.zeros(x.size)
        self.widening = variance / float(slope @ information.plain @ slope) if known else 1.0
        self.freedom = information.freedom
        self.bound = -np.inf if name in SIGNED else 0.0
        self.least = self._least(slope, x)

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
        """Return the same, which is in SI units, within the bound."""
        return max(at, self.bound)

    def aimed(self, x: Array, at: float) -> Array:
        """Return x moved along, within its bounds, as far as the ratio goes along; the target draws it further."""
        here, part = self.at(x), 1.0
        for _ in range(TRIED):
            begun = np.maximum(x + part * self.column * (at - here), self.lower)
            if self.parameters.possible(begun) is not None and abs(self.at(begun) - at) < 0.75 * abs(at - here):
                return np.asarray(begun)
            part *= 0.5
        return x

    def held(self, at: float, unit: float, firmness: float) -> dict[str, Any]:
        """Return the target that draws it to `at`: it lies beyond by as much as the data hold the ratio back."""
        weight = firmness * WEIGHT
        beyond = at + (at - self.origin) / weight**2
        return {"target": Target(self.at, self.gradient, beyond, weight * float(np.sqrt(unit)) / self.std)}

    def limits(self, x: Array) -> tuple[int, Array, Array]:
        """Return the number, the variance (1, 1) and the distance (1,) of the ratio alone above its bound.

        Other parameters' bounds do not count: where all share an unknown factor they are not in a ratio's way.
        """
        return 0, np.array([[self.std**2]]), np.array([self.at(x) - self.least])

    def by_std(self, level: float) -> Interval:
        """Return its interval of noise from the standard deviation."""
        half = self.std * float(np.sqrt(quantile(level, self.freedom)))
        ends: tuple[End, End] = ("bound" if self.origin - half < self.bound else "crossed", "crossed")
        return Interval(self.value(self.origin - half), self.origin + half, "covariance", ends, level)
