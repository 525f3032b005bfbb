"""Confidence intervals of parameters and ratios from their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.uncertainty.covariance import Basis
from hyperflex.identification.uncertainty.threshold import quantile

End = Literal["crossed", "bound", "open"]
LEVEL = 0.95
SIGNED = ("p/p1",)  # ratios that may be negative: a centre of mass behind its joint


@dataclass(frozen=True)
class Interval:
    """Confidence interval, SI units.

    `kind` is its method: ``covariance`` (Student's quantile times the standard deviation), ``profile``, ``bootstrap``,
    or ``unknown`` where the data set no limits. `ends`: ``crossed``, the parameter's own ``bound``, or ``open``.
    `remark` tells what went wrong, or nothing.
    """

    low: float
    high: float
    kind: Literal["covariance", "profile", "bootstrap", "unknown"]
    ends: tuple[End, End] = ("crossed", "crossed")
    level: float = LEVEL
    remark: str = ""

    def __str__(self) -> str:
        return f"{self.low:.5g} to {self.high:.5g} ({self.kind})"

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high


def checked_level(level: float) -> float:
    """Return a confidence level, refused outside of 0 to 1."""
    if checks.number("level", level, sign="positive") >= 1.0:
        raise InvalidInput("level is not a probability", got=level, allowed="between 0 and 1, such as 0.95")
    return float(level)


def from_covariance(basis: Basis, which: int, level: float = LEVEL) -> Interval:
    """Return the interval of parameter number `which` from its standard deviation, within its bound."""
    information, parameter = basis.information, basis.plant.parameters.all[which]
    std = float(information.deviations(np.ones(information.x.size))[which])
    if not np.isfinite(std):
        low = -np.inf if parameter.form == "linear" else 0.0
        return Interval(low, np.inf, "unknown", ("open" if low else "bound", "open"), level)
    least, x = float(basis.plant.parameters.lower[which]), float(information.x[which])
    half = std * float(np.sqrt(quantile(level, information.freedom)))
    ends: tuple[End, End] = ("bound" if x - half < least else "crossed", "crossed")
    return Interval(parameter.value(max(x - half, least)), parameter.value(x + half), "covariance", ends, level)


def of_ratios(ratios: dict[str, Array], std: dict[str, Array], freedom: float) -> dict[str, Interval]:
    """Return intervals of the ratios by name and link (``J/p1[0]``), from their standard deviations, within bounds."""
    times, result = float(np.sqrt(quantile(LEVEL, freedom))), {}
    for name, values in ratios.items():
        for k, (value, spread) in enumerate(zip(values, std[name], strict=True)):
            if not np.isfinite(spread):
                low = -np.inf if name in SIGNED else 0.0
                result[f"{name}[{k}]"] = Interval(low, np.inf, "unknown", ("bound" if low == 0.0 else "open", "open"))
            elif spread > 0.0:
                low, high = value - times * spread, value + times * spread
                bounded = low < 0.0 and name not in SIGNED
                ends: tuple[End, End] = ("bound" if bounded else "crossed", "crossed")
                result[f"{name}[{k}]"] = Interval(0.0 if bounded else low, high, "covariance", ends)
    return result
