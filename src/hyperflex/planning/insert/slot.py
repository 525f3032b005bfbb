"""A slot between two walls, and where a rope crosses the line of these walls."""

import math
from dataclasses import MISSING, dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks, options
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope, Wall
from hyperflex.options import option

NARROWEST = 3.0  # diameters of the rope


@dataclass(frozen=True)
class Slot:
    """A gap between two thin walls in one line, through which the tip shall go.

    Parameters
    ----------
    x, y : float
        Middle of the gap, m.
    direction : float
        The way in, across the walls: rad, counterclockwise from the x axis.
    width : float
        Of the gap, m, > 0.
    depth : float
        How far beyond the walls the tip shall come, m, > 0.
    wall : float
        Length of each wall, m, > 0.
    tube : float
        How far walls go on inwards from both edges of the gap, m, >= 0: the tip goes into a tube. 0: none.
    max_speed : float
        Greatest speed of the tip at that depth, m/s, > 0; infinite for any.
    touching : bool
        Whether the rope may touch the walls.

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign.

    Examples
    --------
    >>> from hyperflex.planning import Slot
    >>> [round(wall.x, 3) for wall in Slot(0.2, -2.0, direction=-1.5708, width=0.02, wall=0.1).walls]
    [0.21, 0.19]
    """

    x: float = option(MISSING, "middle of the gap, to the right", unit="m")
    y: float = option(MISSING, "middle of the gap, up", unit="m")
    direction: float = option(MISSING, "the way in, across the walls: 0 is +x, pi/2 is up", unit="rad")
    width: float = option(0.02, "width of the gap: three diameters of the rope or more", unit="m", sign="positive")
    depth: float = option(0.05, "how far beyond the walls the tip must come", unit="m", sign="positive")
    wall: float = option(0.1, "length of each wall", unit="m", sign="positive")
    tube: float = option(
        0.0, "length of the tube: walls that run inwards from the gap's edges", unit="m", sign="nonnegative"
    )
    max_speed: float = option(
        math.inf, "greatest speed of the tip at that depth", unit="m/s", sign="positive", infinite=True, shown="any"
    )
    touching: bool = option(False, "the rope may touch the walls")

    def __post_init__(self) -> None:
        options.check(self, "slot")
        object.__setattr__(self, "touching", checks.flag("slot touching", self.touching))

    @property
    def point(self) -> Array:
        """Middle of the gap (2,), m."""
        return np.array([self.x, self.y])

    @property
    def axes(self) -> Array:
        """Unit vectors (2, 2): the way in, and across it to its left."""
        c, s = np.cos(self.direction), np.sin(self.direction)
        return np.array([[c, s], [-s, c]])

    @property
    def walls(self) -> tuple[Wall, ...]:
        """The walls: that to the left of the way in, that to the right, and those of the tube, if there is one."""
        inwards, left = self.axes
        edges = [self.point + side * 0.5 * self.width * left for side in (1.0, -1.0)]
        ways = [side * self.wall * left for side in (1.0, -1.0)]
        pairs = list(zip(edges, ways, strict=True))
        pairs += [(edge, self.tube * inwards) for edge in edges if self.tube > 0.0]
        return tuple(Wall(*edge.tolist(), *(edge + way).tolist()) for edge, way in pairs)

    def check_width(self, rope: Rope) -> None:
        """Raise InvalidInput if the gap is narrower than NARROWEST diameters of a rope."""
        least = 2.0 * NARROWEST * rope.radius
        if self.width < least * (1.0 - 1e-9):
            raise InvalidInput(
                "slot width is too narrow for the rope",
                got=self.width,
                allowed=f"{least:g} m, {NARROWEST:g} diameters of the rope, or more",
                fix="Give a wider slot, in m, or a thinner rope",
            )


class Crossings(NamedTuple):
    """Where links of a rope cross the line of the walls (K,): row and link, offset to the left and gap, m.

    The gap is the distance of the rope's surface from the nearest end of a wall, < 0 where it goes through one.
    `tip` marks that next to a tip that is beyond the walls.
    """

    row: npt.NDArray[np.int64]
    link: npt.NDArray[np.int64]
    part: Array  # of the link, from its motor-side joint
    offset: Array
    gap: Array
    tip: npt.NDArray[np.bool_]


def find_crossings(slot: Slot, radius: float, depth: Array, offset: Array) -> Crossings:
    """Find where ropes (R) cross the line of the walls, from depth and offset of their joints (R, n + 1), m.

    `radius` is that of the rope, m.
    """
    beyond = depth > 0.0
    row, link = np.nonzero(beyond[:, 1:] != beyond[:, :-1])
    d0, d1, u0, u1 = depth[row, link], depth[row, link + 1], offset[row, link], offset[row, link + 1]
    part = d0 / (d0 - d1)
    at = u0 + part * (u1 - u0)
    slant = np.abs(d1 - d0) / np.hypot(d1 - d0, u1 - u0)
    past = np.abs(at) - 0.5 * slot.width  # the gap's edge
    gap = slant * np.maximum(-past, past - slot.wall) - radius
    last = np.append(row[1:] != row[:-1], True)[: row.size]
    return Crossings(row, link, part, at, gap, last & beyond[row, -1])


def frame(slot: Slot, points: Array) -> tuple[Array, Array]:
    """Return depth beyond the walls (...) and offset to the left of the way in (...) of points (..., 2), m."""
    out = (points - slot.point) @ slot.axes.T
    return out[..., 0], out[..., 1]


def tip_speed(t: Array, depth: Array, offset: Array, row: int) -> float:
    """Return the speed of the tip, m/s, before sample `row` of times t (T,), s, by its depth and offset (T,), m."""
    way = math.hypot(depth[row] - depth[row - 1], offset[row] - offset[row - 1])
    return way / float(t[row] - t[row - 1])


def passages(depth: Array, asked: float) -> list[tuple[int, int]]:
    """Return for each way of a tip beyond the walls its first row and that at which it is as deep as `asked`, m.

    If it is never so deep, the second is that at which it is deepest. `depth` (T,), m, is the tip's.
    """
    beyond = np.concatenate([[False], depth[1:] > 0.0, [False]])
    begins, ends = 1 + np.flatnonzero(beyond[1:] & ~beyond[:-1]), 1 + np.flatnonzero(beyond[:-1] & ~beyond[1:])
    found = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        if depth[begin - 1] <= 0.0:
            way = depth[begin:end]
            found.append((begin, begin + int(np.argmax(way >= asked) if way.max() >= asked else way.argmax())))
    return found


def nearest_passage(depth: Array, asked: float, t: Array, near: float) -> tuple[int, int] | None:
    """Return that of the :func:`passages` whose end is next to time `near`, s, of the times t (T,), s; None without."""
    return min(passages(depth, asked), key=lambda way: abs(t[way[1]] - near), default=None)
