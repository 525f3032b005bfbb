"""Round pegs that a rope may touch and wind round."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.model.wall import restitution


@dataclass(frozen=True)
class Peg:
    """A fixed round peg, its axis across the plane of the rope.

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

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign.

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

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            object.__setattr__(self, name, checks.number(f"peg {name}", getattr(self, name), unit="m"))
        radius = checks.number("peg radius", self.radius, sign="positive", unit="m")
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "mu", checks.number("peg mu", self.mu, sign="nonnegative"))
        object.__setattr__(self, "restitution", restitution("peg", self.restitution))


def pegs_table(pegs: Sequence[Peg]) -> dict[str, list[float]]:
    """Return the ``[pegs]`` table of a TOML file: arrays with one entry a peg."""
    return {f.name: [getattr(peg, f.name) for peg in pegs] for f in fields(Peg)}


def pegs_from_table(table: Mapping[str, Any]) -> tuple[Peg, ...]:
    """Build pegs from a ``[pegs]`` table; a number stands for one peg, ``mu`` and ``restitution`` for all."""
    names = [f.name for f in fields(Peg)]
    if set(table) - set(names) or set(names[:3]) - set(table):
        raise InvalidInput("pegs table does not fit", got=sorted(table), allowed="x, y, radius; mu, restitution")
    columns = {
        name: np.atleast_1d(checks.array(f"pegs {name}", value, np.shape(value))) for name, value in table.items()
    }
    sizes = {name: value.size for name, value in columns.items() if name in names[:3] or value.size > 1}
    if len(set(sizes.values())) != 1 or any(value.ndim > 1 for value in columns.values()):
        raise InvalidInput("pegs arrays do not tell one number of pegs", got=sizes, allowed="arrays of one length")
    columns = {name: np.broadcast_to(value, columns["x"].shape) for name, value in columns.items()}
    rows = zip(*columns.values(), strict=True)
    return tuple(Peg(**dict(zip(columns, map(float, row), strict=True))) for row in rows)
