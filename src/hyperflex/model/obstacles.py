"""Obstacles together: pegs, walls and grounds in files and as kernel arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyperflex.core.contact.gaps import Pegs
from hyperflex.model.peg import FIXED, Peg, pegs_from_table, pegs_table
from hyperflex.model.wall import Ground, Wall, obstacles_from_table, obstacles_table

Obstacle = Peg | Wall | Ground


def packed(obstacles: Sequence[Obstacle], radius: float, first: int) -> Pegs:
    """Return obstacles as the kernels take them, for a rope of `radius`, m, whose link `first` is its first.

    A wall becomes a face and two pegs of no radius at its ends.
    """
    rows: list[tuple[float, ...]] = []
    for each in obstacles:
        rub = (each.mu, each.restitution, *(each.axle if isinstance(each, Peg) else FIXED))
        if isinstance(each, Peg):
            rows.append((each.x, each.y, 0.0, 0.0, 0.0, each.radius + radius, *rub))
        elif isinstance(each, Ground):
            size = float(np.hypot(each.nx, each.ny))
            rows.append((each.x, each.y, each.ny / size, -each.nx / size, np.inf, radius, *rub))
        else:
            dx, dy = each.x2 - each.x, each.y2 - each.y
            size = float(np.hypot(dx, dy))
            rows.append((each.x, each.y, dx / size, dy / size, size, radius, *rub))
            rows += [(x, y, 0.0, 0.0, 0.0, radius, *rub) for x, y in ((each.x, each.y), (each.x2, each.y2))]
    x, y, ux, uy, span, reach, mu, bounce, inertia, bearing = np.array(rows).reshape(-1, 10).T.copy()
    return Pegs(x, y, ux, uy, span, reach, mu, bounce, inertia, bearing, first)


def round_places(obstacles: Sequence[Obstacle]) -> list[int]:
    """Return where the round pegs stand in what :func:`packed` returns, in their order."""
    sizes = [3 if isinstance(each, Wall) else 1 for each in obstacles]
    return [sum(sizes[:k]) for k, each in enumerate(obstacles) if isinstance(each, Peg)]


def tables(obstacles: Sequence[Obstacle]) -> dict[str, Any]:
    """Return the tables of a TOML file; obstacles come back ordered by class."""
    pegs = [each for each in obstacles if isinstance(each, Peg)]
    walls = [each for each in obstacles if isinstance(each, Wall)]
    grounds = [each for each in obstacles if isinstance(each, Ground)]
    named: dict[str, Any] = {"pegs": pegs_table(pegs)} if pegs else {}
    named |= {name: obstacles_table(some) for name, some in (("walls", walls), ("grounds", grounds)) if some}
    return named


def obstacles_of(named: Mapping[str, Any]) -> tuple[Obstacle, ...]:
    """Build obstacles from the tables of a file; a table that is not there is None."""
    result: tuple[Obstacle, ...] = ()
    if named["pegs"] is not None:
        result += pegs_from_table(named["pegs"])
    if named["walls"] is not None:
        result += obstacles_from_table(Wall, "walls", named["walls"])
    if named["grounds"] is not None:
        result += obstacles_from_table(Ground, "grounds", named["grounds"])
    return result
