"""Round pegs that a rope may touch and wind round."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from hyperflex import checks
from hyperflex.errors import InvalidInput


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

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            object.__setattr__(self, name, checks.number(f"peg {name}", getattr(self, name), unit="m"))
        radius = checks.number("peg radius", self.radius, sign="positive", unit="m")
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "mu", checks.number("peg mu", self.mu, sign="nonnegative"))

    def table(self) -> dict[str, float]:
        """Return the entry of ``[[pegs]]`` in a TOML file."""
        return asdict(self)

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Peg:
        """Build a peg from an entry of ``[[pegs]]``."""
        names = [f.name for f in fields(cls)]
        if not isinstance(table, Mapping) or set(table) - set(names) or set(names[:3]) - set(table):
            got = sorted(table) if isinstance(table, Mapping) else table
            raise InvalidInput("peg table does not fit", got=got, allowed="x, y, radius, mu")
        return cls(**table)
