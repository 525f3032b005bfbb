"""Clearance of a rope from the arm that moves it (the motor's shaft, and the arm up to its tip), and obstacles."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array, Integers
from hyperflex.core.batch import proximity
from hyperflex.model import Arm, Obstacle, Peg, Rope, named, obstacle_gaps
from hyperflex.trajectory import Trajectory, interpolated
from hyperflex.winding import TOUCH, closest_points

FINE = 4e-4  # m, that a link moves at most between two checks
FASTER = 1.5  # times its speeds at two samples that a link may move in between
# Links that begin so near the arm's tip do not count for the arm, from which they hang: radii of rope and arm, and
# lengths of the arm
RADII, LENGTHS = 8.0, 0.3
Gaps = Callable[[Array, Array, Integers], Array]


class Clearance(NamedTuple):
    """Least distance of a rope from arm or obstacles: `value`, m, < 0 where it goes through; when, s; from what."""

    value: float
    t: float
    what: str  # "the motor's shaft", "the arm", or an obstacle as :func:`named` names it


def rope_clearance(run: Trajectory) -> Clearance:
    """Find how near a rope comes to its own arm in a run; infinitely far without an arm.

    The arm is a disc of radius ``Arm.shaft_radius`` about its pivot, and a bar of radius ``Arm.radius`` from there to
    its tip. Links next to the tip, which hang from it, do not count for the bar: those that begin within RADII radii of
    rope and arm, or LENGTHS of the arm's length.

    Notes
    -----
    Angles between samples are those of cubic interpolation. Intervals in which a link may come nearer than at any
    sample, by its speed, are checked so closely that no link moves by more than FINE. Half of that is subtracted, and
    what interpolation may be off where a blow lies between two samples. So the result may be too small by FINE and
    twice that, but not too large.
    """
    arm, rope = run.setup.arm, run.rope
    if arm is None:
        return Clearance(np.inf, float(run.t[0]), "the arm")
    speed = _speeds(run, run.arm_rate, np.array(arm.pivot))
    names = ("the motor's shaft", "the arm")
    return _least_clearance(run, lambda q, base, links: _arm_gaps(rope, arm, q, base, links), names, speed)


def obstacle_clearance(run: Trajectory, obstacles: Sequence[Obstacle], until: float = np.inf) -> Clearance:
    """Find how near a rope comes to obstacles in a run until a time, s; see :func:`rope_clearance`."""

    def gaps(q: Array, base: Array, links: Integers) -> Array:
        joints = run.rope.joints(q, base)
        return obstacle_gaps(obstacles, joints[:, links], joints[:, links + 1])

    speed = _speeds(run, np.zeros(run.t.size), np.zeros(2))
    return _least_clearance(run, gaps, [named(each) for each in obstacles], speed, until)


def sampled_obstacle_gaps(
    rope: Rope, obstacles: Sequence[Obstacle], q: Array, base: Array, within: float = np.inf
) -> Array:
    """Distance (...), m, of a rope from obstacles at samples alone; link angles q (..., n), rad, `base` (..., 2), m.

    A distance that is greater than `within`, m, may be stated as smaller, but not below it.
    """
    joints = rope.joints(q, base)
    gaps = obstacle_gaps(obstacles, joints[..., :-1, :], joints[..., 1:, :], rope.radius + within)
    return np.asarray(gaps.min(axis=(-2, -1), initial=np.inf)) - rope.radius


def sampled_clearance(rope: Rope, arm: Arm, q: Array, base: Array) -> Array:
    """Distance (T,), m, of a rope from its arm and shaft at samples alone, as of :func:`rope_clearance`.

    Link angles q (T, n), rad; `base` (T, 2), m, is the arm's tip.
    """
    return np.asarray(_arm_gaps(rope, arm, q, base, np.arange(rope.n_links)).min(axis=(1, 2))) - rope.radius


def clear_samples(
    ropes: Sequence[Rope], obstacles: Sequence[Obstacle], q: Array, base: Array, clearance: float
) -> Integers:
    """Return after how many samples (M,) ropes at angles q (M, T, n) come too near an obstacle; T if they do not.

    `base` (M, T, 2), m, are places of their first joints, `clearance`, m, is the distance that they keep.
    """
    clear, least = np.full(len(q), q.shape[1]), max(clearance, 0.0)
    for m, rope in enumerate(ropes if obstacles else ()):
        near = sampled_obstacle_gaps(rope, obstacles, np.nan_to_num(q[m]), base[m], least) <= least
        clear[m] = near.argmax() if near.any() else near.size
    return clear


def samples_clear_of_arm(
    rope: Rope, arm: Arm, q: Array, base: Array, clearance: float, until: Integers | None = None
) -> Integers:
    """Return after how many samples (M,) a rope at angles q (M, T, n) comes too near arm or shaft; T if it does not.

    `base` (M, T, 2), m, are places of the arm's tip, `clearance`, m, is the distance that it keeps; none if -inf.
    Samples from `until` (M,) on are not checked.
    """
    clear = np.full(len(q), q.shape[1])
    if clearance > -np.inf:
        least = rope.radius + clearance
        tips, last = base - np.array(arm.pivot), clear.copy() if until is None else until
        apart = arm.shaft_radius + least, arm.radius + least
        proximity.samples_apart(np.ascontiguousarray(q), tips, rope.length, *apart, _hangs(rope, arm), last, clear)
    return clear


def way_gaps(rope: Rope, target: Peg, behind: Sequence[Peg], q: Array, joints: Array) -> Array:
    """Return how far the rope's way to a target is from each of w pegs (T, w), m; infinite where it has no such way.

    Samples of link angles q (T, n), rad, and joints (T, n + 1, 2), m. The way begins at the arm and ends at the first
    touch of the target, or at the rope's end where it does not touch that.
    """
    begins = rope.link_ends - rope.length
    place, _, gap = closest_points(rope, target, q, joints)
    first = np.where(gap < TOUCH, begins + place, np.inf).min(axis=1)[:, None]
    found = np.full((len(q), len(behind)), np.inf)
    for k, each in enumerate(behind):
        place, _, gap = closest_points(rope, each, q, joints)
        found[:, k] = np.where(begins + place < first, gap, np.inf).min(axis=1)
    return found


def _least_clearance(
    run: Trajectory, gaps: Gaps, names: Sequence[str], speed: Array, until: float = np.inf
) -> Clearance:
    """Return how near a rope's surface comes to what `gaps` measures, w things with `names`.

    `gaps` takes link angles q (T, n), rad, the first joint (T, 2), m, and the numbers of k links, and returns distances
    (T, w, k), m, of their axes. `speed` (T, n), m/s, is how fast these may change. The first sample at or after
    `until`, s, is the last that counts.
    """
    rope, rows = run.rope, min(int(np.searchsorted(run.t, until)) + 1, run.t.size)

    def least(t: Array, gap: Array) -> Clearance:
        k, which, _ = np.unravel_index(int(gap.argmin()), gap.shape)
        return Clearance(float(gap.min()), float(t[k]), names[int(which)])

    gap = gaps(run.q[:rows], run.base[:rows], np.arange(rope.n_links))
    best, speed = least(run.t, gap), FASTER * speed[:rows]
    way = np.diff(run.t[:rows])[:, None] * np.maximum(speed[1:], speed[:-1])
    possible = 0.5 * (gap[1:] + gap[:-1] - way[:, None]).min(axis=1)  # of each link in each interval, at least
    bound = possible.min(axis=1)
    for row in np.argsort(bound):
        if bound[row] >= best.value:
            break
        near, sides = np.flatnonzero(possible[row] < best.value), slice(row, row + 2)
        times = np.linspace(run.t[row], run.t[row + 1], int(np.ceil(way[row, near].max() / FINE)) + 1)
        q = interpolated(run.t[sides], run.q[sides], run.qd[sides], times)
        base = interpolated(run.t[sides], run.base[sides], run.base_velocity[sides], times)
        between = gaps(q, base, near)
        low = np.maximum(between - _errors(run, row)[near], rope.radius)  # a touch, no unseen depth
        best = min(best, least(times, np.minimum(between, low)))
    return best._replace(value=best.value - rope.radius - 0.5 * FINE)


def _speeds(run: Trajectory, rate: Array, pivot: Array) -> Array:
    """Greatest speed of each link (T, n), m/s, as seen by what turns about a `pivot` at a `rate` (T,), rad/s."""
    x, y = np.moveaxis(run.rope.joint_velocities(run.q, run.qd, run.base_velocity), -1, 0)
    out, rate = run.joints - pivot, rate[:, None]
    speed = np.hypot(x + rate * out[..., 1], y - rate * out[..., 0])
    return np.asarray(np.maximum(speed[:, 1:], speed[:, :-1]))


def _errors(run: Trajectory, row: int) -> Array:
    """Greatest errors of cubic interpolation (n,), m, of each link where a blow lies between sample `row` and the next.

    A jump of a velocity by v in an interval dt moves what is interpolated by dt v / 8 at most. It is what the
    accelerations at both samples leave of the change of a velocity. Without contact there are no blows.
    """
    if run.contact_loss is None:
        return np.zeros(run.q.shape[1])
    dt, q = run.t[row + 1] - run.t[row], run.q[row + 1]
    jump = run.qd[row + 1] - run.qd[row] - 0.5 * dt * (run.qdd[row + 1] + run.qdd[row])
    joints = np.hypot(*run.rope.joint_velocities(q, jump, np.zeros(2)).T)
    return np.asarray(dt * np.maximum(joints[1:], joints[:-1]) / 8.0)


def _arm_gaps(rope: Rope, arm: Arm, q: Array, tip: Array, links: Integers) -> Array:
    """Distances (T, 2, k), m, of the axes of k `links` from shaft and arm; q (T, n), rad; arm's `tip` (T, 2), m."""
    gap = np.empty((len(q), 2, links.size))
    tips = tip - np.array(arm.pivot)
    proximity.arm_gaps(np.ascontiguousarray(q), tips, rope.length, links, _hangs(rope, arm), gap)
    return np.asarray(gap - np.array([[arm.shaft_radius], [arm.radius]]))


def _hangs(rope: Rope, arm: Arm) -> int:
    """Number of links that hang from the arm's tip, and do not count as too near the arm."""
    length = max(LENGTHS * arm.length, RADII * (rope.radius + arm.radius))
    return int(np.searchsorted(rope.link_ends, length, side="right")) + 1
