"""Clearance of a rope from the arm that throws it: from the motor's shaft, and from the arm between shaft and tip."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.model import Arm, Rope
from hyperflex.trajectory import Trajectory, interpolated

FINE = 4e-4  # m, that a link moves at most between two looks
FASTER = 1.5  # times its speeds at two samples that a link may move in between
# Links that begin so near the arm's tip do not count for the arm, from which they hang: radii of rope and arm, and
# lengths of the arm
RADII, LENGTHS = 8.0, 0.3


class Clearance(NamedTuple):
    """Least distance of a rope from its own arm: `value`, m, below 0 where it goes through; when, s; and from what."""

    value: float
    t: float
    what: str  # "shaft" or "arm"


def rope_clearance(run: Trajectory) -> Clearance:
    """Find how near a rope comes to its own arm in a run; infinitely far without an arm.

    The arm is a disc of radius ``Arm.shaft_radius`` about its pivot, and a bar of radius ``Arm.radius`` from there to
    its tip. Links next to the tip, which hang from it, do not count for the bar: those that begin within RADII radii of
    rope and arm, or LENGTHS of the arm's length.

    Notes
    -----
    Angles between samples are those of cubic interpolation. Intervals in which a link may come nearer than at any
    sample, by its speed, are looked at so closely that no link moves by more than FINE. Half of that is taken off, so
    what is told may be too small by FINE, but not too large.
    """
    arm, rope = run.setup.arm, run.setup.rope
    if arm is None:
        return Clearance(np.inf, float(run.t[0]), "arm")
    gap = _gaps(rope, arm, run.q, run.base, np.arange(rope.n_links))
    speed = FASTER * _speeds(run, arm)
    way = np.diff(run.t)[:, None] * np.maximum(speed[1:], speed[:-1])
    least = 0.5 * (gap[1:] + gap[:-1] - way[:, None]).min(axis=1)  # of each link in each interval, at least
    bound = least.min(axis=1)
    best = _least(run.t, gap)
    for row in np.argsort(bound):
        if bound[row] >= best.value:
            break
        near = np.flatnonzero(least[row] < best.value)
        times = np.linspace(run.t[row], run.t[row + 1], int(np.ceil(way[row, near].max() / FINE)) + 1)
        sides, links = slice(row, row + 2), slice(near[-1] + 1)
        q = interpolated(run.t[sides], run.q[sides, links], run.qd[sides, links], times)
        base = interpolated(run.t[sides], run.base[sides], run.base_velocity[sides], times)
        best = min(best, _least(times, _gaps(rope, arm, q, base, near)))
    return best._replace(value=best.value - rope.radius - 0.5 * FINE)


def sampled_clearance(rope: Rope, arm: Arm, q: Array, base: Array) -> Array:
    """Distance (T,), m, of a rope from its arm and shaft at samples alone, as of :func:`rope_clearance`.

    Link angles q (T, n), rad; `base` (T, 2), m, is the arm's tip.
    """
    return np.asarray(_gaps(rope, arm, q, base, np.arange(rope.n_links)).min(axis=(1, 2))) - rope.radius


def _least(t: Array, gap: Array) -> Clearance:
    k, what, _ = np.unravel_index(int(gap.argmin()), gap.shape)
    return Clearance(float(gap.min()), float(t[k]), ("shaft", "arm")[what])


def _speeds(run: Trajectory, arm: Arm) -> Array:
    """Greatest speed of each link (T, n), m/s, as the turning arm sees it."""
    spin, out = run.setup.rope.length * run.qd, run.joints - np.array(arm.pivot)
    x = np.cumsum(np.column_stack([run.base_velocity[:, :1], spin * np.cos(run.q)]), axis=1)
    y = np.cumsum(np.column_stack([run.base_velocity[:, 1:], spin * np.sin(run.q)]), axis=1)
    rate = run.arm_rate[:, None]
    speed = np.hypot(x + rate * out[..., 1], y - rate * out[..., 0])
    return np.asarray(np.maximum(speed[:, 1:], speed[:, :-1]))


def _gaps(rope: Rope, arm: Arm, q: Array, tip: Array, links: npt.NDArray[np.int64]) -> Array:
    """Distances (T, 2, k), m, of the axes of k `links` from shaft and arm.

    Angles q (T, m), rad, are those of the first m links, `tip` (T, 2), m, the arm's.
    """
    length = rope.length[: q.shape[1]]
    ways = np.stack([length * np.sin(q), -length * np.cos(q)], axis=-1)
    end = (tip[:, None] + np.cumsum(ways, axis=1))[:, links]
    begin, tip = end - ways[:, links], tip[:, None]
    pivot = np.broadcast_to(np.array(arm.pivot), tip.shape)
    shaft = _distance(pivot, begin, end)
    bar = np.minimum(shaft, _distance(tip, begin, end))
    bar = np.minimum(bar, np.minimum(_distance(begin, pivot, tip), _distance(end, pivot, tip)))
    apart = _side(pivot, begin, end) * _side(tip, begin, end) >= 0.0
    apart |= _side(begin, pivot, tip) * _side(end, pivot, tip) >= 0.0
    near = max(LENGTHS * arm.length, RADII * (rope.radius + arm.radius))
    hangs = (np.cumsum(rope.length) - rope.length)[links] <= near
    bar = np.where(hangs, np.inf, np.where(apart, bar, 0.0))
    return np.stack([shaft - arm.shaft_radius, bar - arm.radius], axis=1)


def _distance(point: Array, begin: Array, end: Array) -> Array:
    """Distance (...), m, of points (..., 2) from segments."""
    x, y = (end - begin)[..., 0], (end - begin)[..., 1]
    out = point - begin
    square = np.maximum(x * x + y * y, 1e-300)
    part = np.clip((out[..., 0] * x + out[..., 1] * y) / square, 0.0, 1.0)
    return np.asarray(np.hypot(out[..., 0] - part * x, out[..., 1] - part * y))


def _side(point: Array, begin: Array, end: Array) -> Array:
    """Twice the signed area (...) of the triangles of points and segments, m^2."""
    way, out = end - begin, point - begin
    return np.asarray(way[..., 0] * out[..., 1] - way[..., 1] * out[..., 0])
