"""Gaps between a swung rope and obstacles, < 0 where it passes through them, and their derivatives by the strokes.

A free swing passes through obstacles. How deep tells a search how far it is from a swing that does not touch them. Of
walls that is how far the rope must move along itself or the wall, and of the ground how deep it lies. Of a peg it is
less than the radius: where the rope sweeps over all of it, small changes of the strokes do not help.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Obstacle, Peg, Wall
from hyperflex.planning.clearance import gap_of, obstacle_gaps
from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.joint_motion import JointMotion

BESIDE = 0.01  # m, that a rope shall keep from what it must not touch, beyond the clearance asked
SLANT = 0.1  # sine of the angle between link and wall, below which their crossing moves as at that angle


class SpareGaps(NamedTuple):
    """Gaps (G,), m, of a swing beyond the clearance asked: the least of each time that it comes near an obstacle.

    `change` (G, P) are their derivatives, `beside` (G,), m, what they shall be at least.
    """

    spare: Array
    change: Array
    beside: Array


def signed_gaps(obstacles: Sequence[Obstacle], begin: Array, end: Array) -> Array:
    """Distances (..., w, n), m, of the links of a rope from `begin` to `end` (..., n, 2) from w obstacles, < 0 inside.

    Of a link through a wall it is how far the nearer end of the wall is from where they cross, or the rope's own end
    along the rope if that is less.
    """
    gaps = obstacle_gaps(obstacles, begin, end)
    size = np.hypot(*np.moveaxis(end - begin, -1, 0))
    beyond = np.cumsum(size[..., ::-1], axis=-1)[..., ::-1]  # of the rope, from the beginning of each link
    for k, each in enumerate(obstacles):
        if isinstance(each, Wall):
            rows = np.nonzero(gaps[..., k, :] == 0.0)
            along, length, part = _crossing(each, begin[rows], end[rows])
            left = beyond[rows] - part * size[rows]
            depth = np.minimum(np.minimum(along, length - along), left)
            gaps[(*rows[:-1], np.full(rows[0].size, k), rows[-1])] = -depth
    return gaps


def blocked(problem: Problem, q: Array, base: Array) -> Array:
    """Return how far, m, swings have come too near obstacles until each sample: (M, T), 0 as long as they have not.

    Link angles q (M, T, n), rad; `base` (M, T, 2), m, is the arm's tip.
    """
    rope, lacks = problem.rope, np.zeros(q.shape[:2])
    if problem.obstacles:
        for swing, places, first in zip(lacks, np.nan_to_num(q), base, strict=True):
            joints = rope.joints(places, first)
            gaps = signed_gaps(problem.obstacles, joints[:, :-1], joints[:, 1:]).min(axis=(1, 2)) - rope.radius
            swing[:] = np.maximum.accumulate(np.maximum(max(problem.clearance, 0.0) - gaps, 0.0))
    return lacks


def margins(problem: Problem, places: Array) -> Array:
    """Return what gaps from obstacles shall be at least (w,), m, where the tip is asked at `places` (K, 2), m.

    That is BESIDE, or half of what those places leave of it.
    """
    needed = problem.rope.radius + max(problem.clearance, 0.0)
    left = [min(gap_of(each, *place) for place in places) - needed for each in problem.obstacles]
    return np.clip(0.5 * np.array(left), 0.0, BESIDE)


def least_spare_gaps(
    problem: Problem, motion: JointMotion, until: int, beside: Array, last: tuple[Array, Array] | None = None
) -> SpareGaps:
    """Return the gaps before row `until`, from obstacles from which they shall be `beside` (w,), m, and derivatives.

    Or less, where the rope begins nearer. `last` are places of the joints at a later end, and their derivatives.
    """
    rope, obstacles = problem.rope, problem.obstacles
    spare, changes, least = list[float](), list[Array](), list[float]()
    if obstacles:
        places = motion.places[:until] if last is None else np.append(motion.places[:until], last[0][None], axis=0)
        begin, end = places[:, :-1], places[:, 1:]
        gaps = signed_gaps(obstacles, begin, end) - rope.radius - max(problem.clearance, 0.0)
        for k, each in enumerate(obstacles):
            gap, links = gaps[:, k].min(axis=1), gaps[:, k].argmin(axis=1)
            asked = min(float(beside[k]), max(float(gap[0]), 0.0))
            near = np.flatnonzero(gap < BESIDE)
            for part in np.split(near, 1 + np.flatnonzero(np.diff(near) > 1)):
                if part.size:
                    row = int(part[gap[part].argmin()])
                    change = motion.changes(row) if last is None or row < until else last[1]
                    spare.append(float(gap[row]))
                    changes.append(_change(each, places[row], change, int(links[row])))
                    least.append(asked)
    return SpareGaps(np.array(spare), np.array(changes).reshape(len(spare), motion.run.dtip.shape[2]), np.array(least))


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


def _change(obstacle: Obstacle, joints: Array, change: Array, link: int) -> Array:
    """Return the derivatives (P,) of the signed gap of a link from those of all joints (n + 1, 2, P)."""
    part, slope = _slope(obstacle, joints, link)
    return np.asarray(slope @ ((1.0 - part) * change[link] + part * change[link + 1]))


def _slope(obstacle: Obstacle, joints: Array, link: int) -> tuple[float, Array]:
    """Return the part of a link at which it is nearest to an obstacle, and the gap's gradient (2,) by that place."""
    begin, end = joints[link], joints[link + 1]
    place, way = np.array([obstacle.x, obstacle.y]), end - begin
    if isinstance(obstacle, Peg):
        part = _nearest(place, begin, end)
        return part, _unit(begin + part * way - place)
    if not isinstance(obstacle, Wall):
        out = _unit(np.array([obstacle.nx, obstacle.ny]))
        return float(way @ out < 0.0), out
    last = np.array([obstacle.x2, obstacle.y2])
    if signed_gaps((obstacle,), joints[None, :-1], joints[None, 1:])[0, 0, link] <= 0.0:
        return _slope_through(obstacle, joints, link)
    pairs = [(part, end_of_wall) for end_of_wall in (place, last) for part in [_nearest(end_of_wall, begin, end)]]
    pairs += [(part, place + _nearest(p, place, last) * (last - place)) for part, p in ((0.0, begin), (1.0, end))]
    part, nearest = min(pairs, key=lambda pair: float(np.hypot(*(begin + pair[0] * way - pair[1]))))
    return part, _unit(begin + part * way - nearest)


def _slope_through(wall: Wall, joints: Array, link: int) -> tuple[float, Array]:
    """Return what :func:`_slope` does, of a link through a wall."""
    along, size, part = _crossing(wall, joints[link], joints[link + 1])
    way, wall_way = joints[link + 1] - joints[link], _unit(np.array([wall.x2 - wall.x, wall.y2 - wall.y]))
    normal, length = np.array([-wall_way[1], wall_way[0]]), float(np.hypot(*way))
    across = float(way @ normal)
    across = float(np.copysign(max(abs(across), SLANT * length), across))
    left = float(np.hypot(*np.diff(joints[link:], axis=0).T).sum() - part * length)
    if left < min(along, size - along):
        return float(part), -length / across * normal
    slope = wall_way - normal * (float(wall_way @ way) / across)
    return float(part), slope if along > 0.5 * size else -slope


def _nearest(point: Array, begin: Array, end: Array) -> float:
    """Return the part of a segment at which it is nearest to a point (2,)."""
    way = end - begin
    return float(np.clip((point - begin) @ way / max(float(way @ way), 1e-300), 0.0, 1.0))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.hypot(*vector)), 1e-300))
