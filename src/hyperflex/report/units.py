"""Numbers for reports: a unit that suits their size, and as many digits as their uncertainty allows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hyperflex.model import PROPERTIES, RATIOS


def _ladder(unit: str, prefixes: str) -> tuple[tuple[float, str], ...]:
    return tuple((10.0 ** (-3 * k), f"{prefix}{unit}") for k, prefix in enumerate(("", *prefixes)))


_LADDERS = {  # by SI unit
    "m": _ladder("m", "m"),
    "rad": _ladder("rad", "m"),
    "kg": ((1.0, "kg"), (1e-3, "g"), (1e-6, "mg")),
    "kg m^2": ((1.0, "kg m²"), (1e-3, "g m²"), (1e-6, "kg mm²"), (1e-9, "g mm²")),
    "N m s/rad": _ladder("N m s/rad", "mµn"),
    "N m": _ladder("N m", "mµn"),
    "N m/rad": _ladder("N m/rad", "mµn"),
    "kg/m^2": ((1.0, "kg/m²"), (1e-3, "g/m²"), (1e-6, "mg/m²")),
    "angle": ((np.pi / 180.0, "degrees"),),  # of a property
    "s": ((1e-3, "ms"),),
}


@dataclass(frozen=True)
class Unit:
    """A display unit: `size` in SI units, and `name`."""

    size: float
    name: str

    @property
    def after(self) -> str:
        """Its name after a space, or nothing; no line breaks within."""
        return f" {self.name}".replace(" ", "\u00a0") if self.name else ""


def readable_unit(what: str, values: ArrayLike) -> Unit:
    """Return the unit that suits these values of a property, or of a residual in ``rad`` or ``m``.

    The largest one in which the greatest value is at least 1, else the smallest there is; numbers without a unit keep
    theirs, and ratios, which are compared between fits, stay in SI units.
    """
    if what in RATIOS:
        return Unit(1.0, RATIOS[what].unit.replace("^2", "²").replace("^3", "³"))
    unit = PROPERTIES[what].unit if what in PROPERTIES else what
    ladder = _LADDERS.get("angle" if unit == "rad" != what else unit, ((1.0, unit),))
    sizes = np.abs(np.atleast_1d(values))
    greatest = float(sizes[np.isfinite(sizes)].max(initial=0.0))
    fitting = [step for step in ladder if greatest >= step[0]] if greatest > 0.0 else [ladder[0]]
    return Unit(*(fitting[0] if fitting else ladder[-1]))


def amount(value: float, what: str, digits: int = 3) -> str:
    """Return a value with the unit that suits it, and so many digits; `what` as of :func:`readable_unit`."""
    unit = readable_unit(what, value)
    return f"{value / unit.size:.{digits}g}{unit.after}"


def rounded(value: float, std: float) -> str:
    """Return a value rounded to two digits of its standard deviation; four digits without one, and a plain 0."""
    if not np.isfinite(value):
        return "not known"
    if value == 0.0:
        return "0"
    if not np.isfinite(std) or std <= 0.0:
        return f"{value:.4g}"
    decimals = 1 - int(np.floor(np.log10(std)))
    if 0 <= decimals <= 9:
        return f"{value:.{decimals}f}"
    return f"{value:.4g}" if decimals > 9 else f"{round(value, decimals):.0f}"


def short(std: float) -> str:
    """Return a standard deviation with two digits."""
    decimals = 1 - int(np.floor(np.log10(std))) if std > 0.0 else 1
    return f"{std:.{max(decimals, 0)}f}" if decimals <= 7 else f"{std:.1e}"


def length(value: float, digits: int = 3, small: str = "mm", least: float = 0.0) -> str:
    """Return a length, m, with so many digits, in m from 1 m on and below it in mm or cm.

    One below `least`, m, is shown as "less than" that.
    """
    if abs(value) < least:
        return f"less than {length(least, digits, small)}"
    size, name = (1.0, "m") if abs(value) >= 1.0 else ({"mm": 1e3, "cm": 1e2}[small], small)
    return f"{float(f'{size * value:.{digits}g}'):g} {name}"
