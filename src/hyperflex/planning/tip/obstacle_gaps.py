"""Gaps between a swung rope and obstacles, < 0 where it passes through them, and their derivatives by the strokes.

A free swing passes through obstacles. How deep tells a search how far it is from a swing that does not touch them.
"""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Obstacle, Peg, Wall
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.clearance import obstacle_gaps
from hyperflex.planning.tip.joint_motion import JointMotion

BESIDE = 0.01  # m, that a rope shall keep from what it must not touch, beyond the clearance asked


def signed_gaps(obstacles: Sequence[Obstacle], begin: Array, end: Array) -> Array:
    """Distances (..., w, k), m, of links from `begin` to `end` (..., k, 2) from w obstacles, < 0 inside them.

    Of a link through a wall it is how far the nearer end of the wall is from where they cross.
    """
    gaps = obstacle_gaps(obstacles, begin, end)
    for k, each in enumerate(obstacles):
        if isinstance(each, Wall):
            rows = np.nonzero(gaps[..., k, :] == 0.0)
            along, size, _ = _crossing(each, begin[rows], end[rows])
            gaps[(*rows[:-1], np.full(rows[0].size, k), rows[-1])] = -np.minimum(along, size - along)
    return gaps


def blocked(cast_setup: CastSetup, q: Array, base: Array) -> Array:
    """Return how far, m, swings have come too near obstacles until each sample: (M, T), 0 as long as they have not.

    Link angles q (M, T, n), rad; `base` (M, T, 2), m, is the arm's tip.
    """
    rope, lacks = cast_setup.rope, np.zeros(q.shape[:2])
    if cast_setup.obstacles:
        for swing, places, first in zip(lacks, np.nan_to_num(q), base, strict=True):
            joints = rope.joints(places, first)
            gaps = signed_gaps(cast_setup.obstacles, joints[:, :-1], joints[:, 1:]).min(axis=(1, 2)) - rope.radius
            swing[:] = np.maximum.accumulate(np.maximum(max(cast_setup.clearance, 0.0) - gaps, 0.0))
    return lacks


def least_spare_gaps(cast_setup: CastSetup, motion: JointMotion, until: int) -> tuple[Array, Array]:
    """Return what gaps have to spare beyond the clearance asked (G,), m, before row `until`, and derivatives (G, P).

    They are those of each time that the rope is within BESIDE of that, the least of each obstacle and time.
    """
    rope, obstacles = cast_setup.rope, cast_setup.obstacles
    spare, changes = list[float](), list[Array]()
    if obstacles:
        begin, end = motion.places[:until, :-1], motion.places[:until, 1:]
        gaps = signed_gaps(obstacles, begin, end) - rope.radius - max(cast_setup.clearance, 0.0)
        for k, each in enumerate(obstacles):
            least = gaps[:, k].min(axis=1)
            near = np.flatnonzero(least < BESIDE)
            for part in np.split(near, 1 + np.flatnonzero(np.diff(near) > 1)):
                if part.size:
                    row = int(part[least[part].argmin()])
                    link = int(gaps[row, k].argmin())
                    spare.append(float(least[row]))
                    changes.append(
                        _change(each, begin[row, link], end[row, link], motion.changes(row)[link : link + 2])
                    )
    return np.array(spare), np.array(changes).reshape(len(spare), motion.run.dtip.shape[2])


def _crossing(wall: Wall, begin: Array, end: Array) -> tuple[Array, float, Array]:
    """Return where links (..., 2) cross a wall, m from its beginning, its length, m, and the parts of the links."""
    first, way = np.array([wall.x, wall.y]), np.array([wall.x2 - wall.x, wall.y2 - wall.y])
    size = float(np.hypot(*way))
    normal = np.array([-way[1], way[0]])
    low, high = (begin - first) @ normal, (end - first) @ normal
    apart = np.where(low == high, 1.0, low - high)
    part = np.clip(low / apart, 0.0, 1.0)
    along = ((begin + part[..., None] * (end - begin)) - first) @ way / size
    return np.clip(along, 0.0, size), size, part


def _change(obstacle: Obstacle, begin: Array, end: Array, change: Array) -> Array:
    """Return the derivatives (P,) of the signed gap of one link (2,) from those of its ends (2, 2, P)."""
    part, slope = _slope(obstacle, begin, end)
    return np.asarray(slope @ ((1.0 - part) * change[0] + part * change[1]))


def _slope(obstacle: Obstacle, begin: Array, end: Array) -> tuple[float, Array]:
    """Return the part of a link at which it is nearest to an obstacle, and the gap's gradient (2,) by that place."""
    place, way = np.array([obstacle.x, obstacle.y]), end - begin
    if isinstance(obstacle, Peg):
        part = _nearest(place, begin, end)
        return part, _unit(begin + part * way - place)
    if not isinstance(obstacle, Wall):
        out = _unit(np.array([obstacle.nx, obstacle.ny]))
        return float(way @ out < 0.0), out
    last = np.array([obstacle.x2, obstacle.y2])
    if signed_gaps((obstacle,), begin[None], end[None])[0, 0] <= 0.0:
        along, size, crossed = _crossing(obstacle, begin, end)
        wall, normal = _unit(last - place), np.array([place[1] - last[1], last[0] - place[0]])
        across = float(way @ normal)
        slope = wall - normal * (float(wall @ way) / across if across != 0.0 else 0.0)
        return float(crossed), slope if along > 0.5 * size else -slope
    pairs = [(part, end_of_wall) for end_of_wall in (place, last) for part in [_nearest(end_of_wall, begin, end)]]
    pairs += [(part, place + _nearest(p, place, last) * (last - place)) for part, p in ((0.0, begin), (1.0, end))]
    part, nearest = min(pairs, key=lambda pair: float(np.hypot(*(begin + pair[0] * way - pair[1]))))
    return part, _unit(begin + part * way - nearest)


def _nearest(point: Array, begin: Array, end: Array) -> float:
    """Return the part of a segment at which it is nearest to a point (2,)."""
    way = end - begin
    return float(np.clip((point - begin) @ way / max(float(way @ way), 1e-300), 0.0, 1.0))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.hypot(*vector)), 1e-300))
