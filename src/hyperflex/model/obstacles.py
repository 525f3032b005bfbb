"""Obstacles that a rope may touch: round pegs, walls and grounds; in files, and as kernel arrays."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks, options
from hyperflex.checks import Array
from hyperflex.core.contact.gaps import Pegs
from hyperflex.errors import InvalidInput
from hyperflex.options import option

ELSEWHERE = {"in mu=...": ("friction",)}  # viscous friction of a Rope and an Arm, a coefficient of an obstacle
FIXED = (math.inf, 0.0)  # kg m^2 and N m s/rad, of a fixed obstacle


class Placed:
    """Something that stands at x and y, m."""

    x: float
    y: float

    @property
    def point(self) -> Array:
        """The point (2,), m."""
        return np.array([self.x, self.y])


@checks.named(ELSEWHERE)
@dataclass(frozen=True)
class Peg(Placed):
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
        Fraction of the speed with which a point bounces back, 0 to 1.
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

    x: float = option(MISSING, "centre of the peg", unit="m")
    y: float = option(MISSING, "centre, up", unit="m")
    radius: float = option(MISSING, "radius of the peg", unit="m", sign="positive")
    mu: float = option(0.3, "coefficient of friction between rope and peg", sign="nonnegative")
    restitution: float = option(0.0, "part of the speed with which a point bounces back", sign="nonnegative")
    inertia: float | None = option(
        None, "moment of inertia about the axle of a peg that turns", unit="kg m^2", sign="positive", shown="fixed"
    )
    bearing: float = option(0.0, "viscous friction of the axle", unit="N m s/rad", sign="nonnegative")

    def __post_init__(self) -> None:
        _check(self, "peg")
        for name in ("x", "y", "radius"):
            checks.meant(f"peg {name}", getattr(self, name), "m")
        if self.bearing > 0.0 and self.inertia is None:
            raise InvalidInput("a fixed peg has no bearing", got=self.bearing, fix="Give its inertia, in kg m^2")

    @property
    def turns(self) -> bool:
        """Whether the peg turns on an axle."""
        return self.inertia is not None

    @property
    def axle(self) -> tuple[float, float]:
        """Inertia, kg m^2, infinite for a fixed peg, and bearing, N m s/rad."""
        return FIXED if self.inertia is None else (self.inertia, self.bearing)


@checks.named(ELSEWHERE)
@dataclass(frozen=True)
class Wall(Placed):
    """A thin straight wall that a rope may touch on both sides; two of them with a gap between make a slit.

    Parameters
    ----------
    x, y, x2, y2 : float
        Its ends, m, which must not coincide. The rope's axis stays outside the rope's radius.
    mu : float
        Coulomb's coefficient of friction between rope and wall, >= 0.
    restitution : float
        Fraction of the speed with which a point bounces back, 0 to 1.

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

    x: float = option(MISSING, "one end, to the right", unit="m")
    y: float = option(MISSING, "one end, up", unit="m")
    x2: float = option(MISSING, "other end, to the right", unit="m")
    y2: float = option(MISSING, "other end, up", unit="m")
    mu: float = option(0.3, "coefficient of friction between rope and wall", sign="nonnegative")
    restitution: float = option(0.0, "part of the speed with which a point bounces back", sign="nonnegative")

    def __post_init__(self) -> None:
        _check(self, "wall")
        if (self.x, self.y) == (self.x2, self.y2):
            raise InvalidInput("ends of a wall coincide", got=(self.x, self.y), allowed="two points")


@checks.named(ELSEWHERE)
@dataclass(frozen=True)
class Ground(Placed):
    """A solid half plane: a floor, a ceiling, the side of a room.

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

    x: float = option(MISSING, "point of the surface, to the right", unit="m")
    y: float = option(MISSING, "point of the surface, up", unit="m")
    nx: float = option(0.0, "vector out of the ground, to the right")
    ny: float = option(1.0, "vector out of the ground, up")
    mu: float = option(0.3, "coefficient of friction between rope and ground", sign="nonnegative")
    restitution: float = option(0.0, "part of the speed with which a point bounces back", sign="nonnegative")

    def __post_init__(self) -> None:
        _check(self, "ground")
        if (self.nx, self.ny) == (0.0, 0.0):
            raise InvalidInput("vector out of the ground is zero", got=(self.nx, self.ny), allowed="a direction")


Obstacle = Peg | Wall | Ground
KINDS: dict[str, type[Obstacle]] = {"pegs": Peg, "walls": Wall, "grounds": Ground}  # by table of a TOML file


def checked_obstacles(pegs: object, name: str = "pegs") -> tuple[Obstacle, ...]:
    """Return a sequence of obstacles as a tuple; InvalidInput, with its `name`, for other objects."""
    given = tuple(pegs) if isinstance(pegs, Iterable) else (None,)
    for peg in given:
        if not isinstance(peg, Obstacle):
            got = pegs if peg is None else peg
            raise InvalidInput(f"{name} holds something else", got=got, allowed="a sequence of Peg, Wall, Ground")
    return given


def _check(obstacle: Obstacle, what: str) -> None:
    """Convert all fields to floats; InvalidInput for a wrong sign, or a restitution above 1."""
    options.check(obstacle, what)
    if obstacle.restitution > 1.0:
        raise InvalidInput(f"{what} restitution is too large", got=obstacle.restitution, allowed="0 to 1")


def packed(obstacles: Sequence[Obstacle], radius: float, first: int) -> Pegs:
    """Return the kernels' arrays of obstacles, for a rope of `radius`, m, that begins at link `first` of the chain.

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


def obstacle_gaps(obstacles: Sequence[Obstacle], begin: Array, end: Array, within: float = math.inf) -> Array:
    """Distances (..., w, k), m, of the axes of k links of a chain from `begin` to `end` (..., k, 2) from w obstacles.

    Negative inside. The distance from a ground is that of the link's end. For a link through a wall, the depth is the
    distance along the wall from the crossing to the nearer end of the wall, or the length of the chain beyond it if
    that is smaller: roughly the distance to the nearest position without contact. A distance above `within`, m, may be
    underestimated, but not below `within`: this is faster for walls.
    """
    gaps = np.empty((*begin.shape[:-2], len(obstacles), begin.shape[-2]))
    for w, each in enumerate(obstacles):
        place = each.point
        if isinstance(each, Peg):
            gap = _distance(place, begin, end) - each.radius
        elif isinstance(each, Wall):
            last: Array = np.array([each.x2, each.y2])
            away, long = begin - 0.5 * (place + last), float(np.abs(end - begin).max(initial=0.0))
            most = math.sqrt(2.0) * long + 0.5 * math.dist(
                place, last
            )  # by which links can be nearer than their beginnings
            gap = np.hypot(away[..., 0], away[..., 1]) - most
            near = gap <= within
            gap[near] = _segment_distance(begin[near], end[near], place, last)
            _write_depths(gap, each, begin, end)
        else:
            gap = (end - place) @ (np.array([each.nx, each.ny]) / math.hypot(each.nx, each.ny))
        gaps[..., w, :] = gap
    return gaps


def _write_depths(gap: Array, wall: Wall, begin: Array, end: Array) -> None:
    """Replace the gaps (..., k), m, of links through a wall, which are 0, by the negative depths."""
    rows = np.nonzero(gap == 0.0)
    if rows[0].size:
        size = np.hypot(*np.moveaxis(end - begin, -1, 0))
        beyond = np.cumsum(size[..., ::-1], axis=-1)[..., ::-1]  # of the chain, from the beginning of each link
        x, y = wall.x2 - wall.x, wall.y2 - wall.y
        length, axes = math.hypot(x, y), np.array([[x, -y], [y, x]]) / math.hypot(x, y)
        (low, below), (high, above) = (((each[rows] - wall.point) @ axes).T for each in (begin, end))
        part = np.clip(below / np.where(below == above, 1.0, below - above), 0.0, 1.0)
        along = np.clip(low + part * (high - low), 0.0, length)
        gap[rows] = -np.minimum(np.minimum(along, length - along), beyond[rows] - part * size[rows])


def gap_of(obstacle: Obstacle, place: ArrayLike) -> float:
    """Distance of a point `place` (2,), m, from an obstacle, m, <= 0 inside."""
    link = np.array([place])
    return float(obstacle_gaps((obstacle,), link, link)[0, 0])


def named(obstacle: Obstacle) -> str:
    """Return a name of an obstacle from its kind and position."""
    return f"the {type(obstacle).__name__.lower()} at ({obstacle.x:.4g}, {obstacle.y:.4g}) m"


def _segment_distance(begin: Array, end: Array, first: Array, last: Array) -> Array:
    """Distance (...), m, of segments from `begin` to `end` (..., 2) from others from `first` to `last`."""
    near = np.minimum(_distance(first, begin, end), _distance(last, begin, end))
    near = np.minimum(near, np.minimum(_distance(begin, first, last), _distance(end, first, last)))
    apart = _side(first, begin, end) * _side(last, begin, end) >= 0.0
    apart |= _side(begin, first, last) * _side(end, first, last) >= 0.0
    return np.where(apart, near, 0.0)


def _distance(point: Array, begin: Array, end: Array) -> Array:
    """Distance (...), m, of points (..., 2) from segments."""
    x, y = (end - begin)[..., 0], (end - begin)[..., 1]
    out = point - begin
    square = np.maximum(x * x + y * y, 1e-300)
    part = np.clip((out[..., 0] * x + out[..., 1] * y) / square, 0.0, 1.0)
    return np.hypot(out[..., 0] - part * x, out[..., 1] - part * y)


def _side(point: Array, begin: Array, end: Array) -> Array:
    """Twice the signed area (...) of the triangles of points and segments, m^2."""
    way, out = end - begin, point - begin
    return way[..., 0] * out[..., 1] - way[..., 1] * out[..., 0]


def round_places(obstacles: Sequence[Obstacle]) -> list[int]:
    """Return the indices of the round pegs in the arrays of :func:`packed`, in their order."""
    sizes = [3 if isinstance(each, Wall) else 1 for each in obstacles]
    return [sum(sizes[:k]) for k, each in enumerate(obstacles) if isinstance(each, Peg)]


def obstacle_tables(obstacles: Sequence[Obstacle]) -> dict[str, Any]:
    """Return the tables of a TOML file, one for each obstacle, by the names of their kinds."""
    named: dict[str, Any] = {}
    for name, kind in KINDS.items():
        some = [asdict(each) for each in obstacles if isinstance(each, kind)]
        if some:
            named[name] = [{key: value for key, value in each.items() if value is not None} for each in some]
    return named


def obstacles_of(named: Mapping[str, Any]) -> tuple[Obstacle, ...]:
    """Build obstacles from the tables of a file; the order is that of KINDS."""
    found: list[Obstacle] = []
    for name, kind in KINDS.items():
        known, needed = [f.name for f in fields(kind)], [f.name for f in fields(kind) if f.default is MISSING]
        for number, row in enumerate(rows := rows_of(named.get(name, [])), start=1):
            what = f"table {number} of [[{name}]]" if len(rows) > 1 else f"the {name} table"
            checks.keys(what, checks.mapping(what, row), known, needed=needed, elsewhere=ELSEWHERE)
            if lists := [key for key, value in row.items() if isinstance(value, list)]:
                fix = f"Give each obstacle a table of its own: [[{name}]]"
                raise InvalidInput(f"{lists[0]} in {what} is a list", got=row[lists[0]], allowed="a number", fix=fix)
            found.append(kind(**row))
    return tuple(found)


def rows_of(given: object) -> list[Any]:
    """Return the tables of several obstacles in a file, or the only one, as a list."""
    return given if isinstance(given, list) else [given]
