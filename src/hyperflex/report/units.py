"""Numbers as people read them: a unit that suits their size, and as many digits as their uncertainty leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_METRES = ((1.0, "m"), (1e-3, "mm"))
_LADDERS: dict[str, tuple[tuple[float, str], ...]] = {
    "length": _METRES,
    "com": _METRES,
    "arc": _METRES,
    "origin_x": _METRES,
    "origin_y": _METRES,
    "mass": ((1.0, "kg"), (1e-3, "g"), (1e-6, "mg")),
    "tip_mass": ((1.0, "kg"), (1e-3, "g"), (1e-6, "mg")),
    "inertia": ((1.0, "kg m²"), (1e-3, "g m²"), (1e-6, "kg mm²"), (1e-9, "g mm²")),
    "friction": tuple((10.0**-k, f"{prefix}N m s/rad") for k, prefix in ((0, ""), (3, "m"), (6, "µ"), (9, "n"))),
    "dry_friction": tuple((10.0**-k, f"{prefix}N m") for k, prefix in ((0, ""), (3, "m"), (6, "µ"), (9, "n"))),
    "stiffness": tuple((10.0**-k, f"{prefix}N m/rad") for k, prefix in ((0, ""), (3, "m"), (6, "µ"), (9, "n"))),
    "gravity_angle": ((np.pi / 180.0, "degrees"),),
    "delay": ((1e-3, "ms"),),
    "J/p1": ((1.0, "m"),),  # ratios as they are compared between fits: plain
    "c/p1": ((1.0, "m/s"),),
    "dry/p1": ((1.0, "m/s²"),),
    "k/p1": ((1.0, "m/s²"),),
    "rad": ((1.0, "rad"), (1e-3, "mrad")),
    "m": _METRES,
}


@dataclass(frozen=True)
class Unit:
    """A unit for reading: `size` in SI units, and `name`."""

    size: float
    name: str

    @property
    def after(self) -> str:
        """Its name after a space, or nothing; no line breaks within."""
        return f" {self.name}".replace(" ", "\u00a0") if self.name else ""


def readable(what: str, values: npt.ArrayLike) -> Unit:
    """Return the unit that suits these values of a property, a ratio, or of a residual in ``rad`` or ``m``.

    The largest one in which the greatest value is at least 1, else the smallest there is; numbers without a unit keep
    theirs.
    """
    ladder = _LADDERS.get(what, ((1.0, ""),))
    sizes = np.abs(np.atleast_1d(values))
    greatest = float(sizes[np.isfinite(sizes)].max(initial=0.0))
    fitting = [step for step in ladder if greatest >= step[0]] if greatest > 0.0 else [ladder[0]]
    return Unit(*(fitting[0] if fitting else ladder[-1]))


def rounded(value: float, sd: float) -> str:
    """Return a value with as many digits as two of its standard deviation's leave; four digits where it has none."""
    if not np.isfinite(value):
        return "not known"
    if not np.isfinite(sd) or sd <= 0.0:
        return f"{value:.4g}"
    decimals = 1 - int(np.floor(np.log10(sd)))
    if 0 <= decimals <= 9:
        return f"{value:.{decimals}f}"
    return f"{value:.4g}" if decimals > 9 else f"{round(value, decimals):.0f}"


def short(sd: float) -> str:
    """Return a standard deviation with two digits."""
    decimals = 1 - int(np.floor(np.log10(sd))) if sd > 0.0 else 1
    return f"{sd:.{max(decimals, 0)}f}" if decimals <= 7 else f"{sd:.1e}"
