"""Straight obstacles: walls with two ends, and the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, TypeVar

import numpy as np

from hyperflex import checks
from hyperflex.errors import InvalidInput


@dataclass(frozen=True)
class Wall:
    """A thin straight wall that a rope may touch on both sides; two of them with a gap between make a slit.

    Parameters
    ----------
    x, y, x2, y2 : float
        Its ends, m, which must not coincide. The rope's axis stays outside the rope's radius.
    mu : float
        Coulomb's coefficient of friction between rope and wall, >= 0.
    restitution : float
        Part of the speed with which a point bounces back, 0 to 1.

    Raises
    ------
    InvalidInput
        If a value is not finite, has the wrong sign, or the ends coincide.

    Examples
    --------
    >>> import hyperflex as hf
    >>> hf.Wall(x=0.5, y=-1.0, x2=0.5, y2=-0.2).mu
    0.3
    """

    x: float
    y: float
    x2: float
    y2: float
    mu: float = 0.3
    restitution: float = 0.0

    def __post_init__(self) -> None:
        _check(self, "wall", ("x", "y", "x2", "y2"))
        if (self.x, self.y) == (self.x2, self.y2):
            raise InvalidInput("ends of a wall coincide", got=(self.x, self.y), allowed="two points")


@dataclass(frozen=True)
class Ground:
    """Everything on one side of a straight line, solid: a floor, a ceiling, the side of a room.

    Parameters
    ----------
    x, y : float
        A point of its surface, m.
    nx, ny : float
        A vector out of it, not zero; the default is a floor's.
    mu, restitution : float
        As of a :class:`Wall`.

    Raises
    ------
    InvalidInput
        If a value is not finite, has the wrong sign, or the vector is zero.
    """

    x: float
    y: float
    nx: float = 0.0
    ny: float = 1.0
    mu: float = 0.3
    restitution: float = 0.0

    def __post_init__(self) -> None:
        _check(self, "ground", ("x", "y", "nx", "ny"))
        if (self.nx, self.ny) == (0.0, 0.0):
            raise InvalidInput("vector out of the ground is zero", got=(self.nx, self.ny), allowed="a direction")


_Kind = TypeVar("_Kind", Wall, Ground)


def _check(obstacle: Wall | Ground, what: str, places: Sequence[str]) -> None:
    for name in places:
        object.__setattr__(obstacle, name, checks.number(f"{what} {name}", getattr(obstacle, name), unit="m"))
    object.__setattr__(obstacle, "mu", checks.number(f"{what} mu", obstacle.mu, sign="nonnegative"))
    object.__setattr__(obstacle, "restitution", restitution(what, obstacle.restitution))


def restitution(what: str, value: float) -> float:
    """Check a coefficient of restitution."""
    number = checks.number(f"{what} restitution", value, sign="nonnegative")
    if number > 1.0:
        raise InvalidInput(f"{what} restitution is too large", got=number, allowed="0 to 1")
    return number


def obstacles_table(obstacles: Sequence[Any]) -> dict[str, list[float]]:
    """Return the table of a TOML file for obstacles of one class: arrays with one entry each."""
    return {f.name: [getattr(each, f.name) for each in obstacles] for f in fields(obstacles[0])}


def obstacles_from_table(kind: type[_Kind], what: str, table: Mapping[str, Any]) -> tuple[_Kind, ...]:
    """Build obstacles from a table of arrays of one length; what has a default may be missing."""
    names = [f.name for f in fields(kind)]
    needed = {f.name for f in fields(kind) if f.default is MISSING}
    if set(table) - set(names) or needed - set(table):
        raise InvalidInput(f"{what} table does not fit", got=sorted(table), allowed=", ".join(names))
    columns = {name: np.atleast_1d(checks.array(f"{what} {name}", v, np.shape(v))) for name, v in table.items()}
    if len({column.shape for column in columns.values()}) != 1:
        sizes = {name: column.size for name, column in columns.items()}
        raise InvalidInput(f"{what} arrays do not tell one number of obstacles", got=sizes, allowed="one length")
    rows = zip(*columns.values(), strict=True)
    return tuple(kind(**dict(zip(columns, map(float, row), strict=True))) for row in rows)
