"""Round pegs, fixed or turning on an axle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.model.wall import restitution

FIXED = (math.inf, 0.0)  # kg m^2 and N m s/rad, of what does not turn


@dataclass(frozen=True)
class Peg:
    """A round peg, its axis across the plane of the rope; fixed, or a pulley that turns on an axle.

    Parameters
    ----------
    x, y : float
        Its centre, m.
    radius : float
        m, > 0. The rope's axis stays outside `radius` plus the rope's own radius.
    mu : float
        Coulomb's coefficient of friction between rope and peg, >= 0.
    restitution : float
        Part of the speed with which a point bounces back, 0 to 1.
    inertia : float, optional
        Moment of inertia about its axle, kg m^2, > 0, of a peg that turns; by default it is fixed.
    bearing : float
        Viscous friction of the axle, N m s/rad, >= 0; of a peg that turns.

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign, or a fixed peg has a bearing.

    Examples
    --------
    >>> import hyperflex as hf
    >>> hf.Peg(x=0.8, y=-0.6, radius=0.03, mu=0.3).radius
    0.03
    """

    x: float
    y: float
    radius: float
    mu: float = 0.3
    restitution: float = 0.0
    inertia: float | None = None
    bearing: float = 0.0

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            object.__setattr__(self, name, checks.number(f"peg {name}", getattr(self, name), unit="m"))
        radius = checks.number("peg radius", self.radius, sign="positive", unit="m")
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "mu", checks.number("peg mu", self.mu, sign="nonnegative"))
        object.__setattr__(self, "restitution", restitution("peg", self.restitution))
        if self.inertia is not None:
            inertia = checks.number("peg inertia", self.inertia, sign="positive", unit="kg m^2")
            object.__setattr__(self, "inertia", inertia)
        bearing = checks.number("peg bearing", self.bearing, sign="nonnegative", unit="N m s/rad")
        object.__setattr__(self, "bearing", bearing)
        if bearing > 0.0 and self.inertia is None:
            raise InvalidInput("a fixed peg has no bearing", got=bearing, fix="Give its inertia, in kg m^2")

    @property
    def turns(self) -> bool:
        """Whether it turns on an axle."""
        return self.inertia is not None

    @property
    def axle(self) -> tuple[float, float]:
        """Its inertia, kg m^2, infinite if it is fixed, and its bearing, N m s/rad."""
        return FIXED if self.inertia is None else (self.inertia, self.bearing)


def pegs_table(pegs: Sequence[Peg]) -> dict[str, list[float]]:
    """Return the ``[pegs]`` table of a TOML file: arrays with one entry a peg; a fixed one has inertia inf."""
    names = [f.name for f in fields(Peg)][: None if any(peg.turns for peg in pegs) else -2]
    table = {name: [getattr(peg, name) for peg in pegs] for name in names}
    if "inertia" in table:
        table["inertia"] = [peg.axle[0] for peg in pegs]
    return table


def pegs_from_table(table: Mapping[str, Any]) -> tuple[Peg, ...]:
    """Build pegs from a ``[pegs]`` table; a number stands for one peg, or for all but as place or radius."""
    names = [f.name for f in fields(Peg)]
    if set(table) - set(names) or set(names[:3]) - set(table):
        allowed = "x, y, radius; " + ", ".join(names[3:])
        raise InvalidInput("pegs table does not fit", got=sorted(table), allowed=allowed)
    columns = {name: np.atleast_1d(_column(name, value)) for name, value in table.items()}
    sizes = {name: value.size for name, value in columns.items() if name in names[:3] or value.size > 1}
    if len(set(sizes.values())) != 1 or any(value.ndim > 1 for value in columns.values()):
        raise InvalidInput("pegs arrays do not tell one number of pegs", got=sizes, allowed="arrays of one length")
    columns = {name: np.broadcast_to(value, columns["x"].shape) for name, value in columns.items()}
    rows = (dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True))
    return tuple(Peg(**{name: v for name, v in row.items() if (name, v) != ("inertia", math.inf)}) for row in rows)


def _column(name: str, value: Any) -> checks.Array:
    """Return what a table has under a name as an array; an infinite inertia is that of a fixed peg."""
    try:
        endless = name == "inertia" and np.isposinf(value)
    except TypeError:
        endless = False
    finite = checks.array(f"pegs {name}", np.where(endless, 1.0, value) if np.any(endless) else value, np.shape(value))
    return np.asarray(np.where(endless, math.inf, finite))
