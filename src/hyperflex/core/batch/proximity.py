"""How near ropes come to a peg, or to their own arm, at samples of flights; and which samples are the first to be."""

import math

import numpy as np

from hyperflex.core.chain.articulated_body import sincos, sines
from hyperflex.core.jit import kernel, non_allocating


@kernel
def first_contacts(q, base, length, x0, y0, reach, near, at, link, least):  # type: ignore[no-untyped-def]
    """Set sample `at` and `link` of the first strike on a peg, and the `least` gap until then, m, (M,) each.

    Sample 0 means no strike; the link is the nearest one of that sample then. Of angles that are all NaN the gap is
    infinite.

    Parameters
    ----------
    q, base : (M, T, n), (M, T, 2) float64
        Link angles, rad, and positions of the first joint, m.
    length : (M, n) float64
        Of the links, m.
    x0, y0, reach : float
        Centre of the peg, m, and the distance from there to the axis of a rope that touches it, m.
    near : float
        Gap, m, below which a rope that was farther away before strikes. One at any gap does so if a link passes the
        peg, or overlaps it, at a sample after the first.
    """
    n = q.shape[2]
    trig, beside = np.empty(2 * n), np.empty(n)
    sin, cos = trig[:n], trig[n:]
    for m in range(q.shape[0]):
        at[m], least[m] = 0, np.inf
        away = False
        beside[:] = 0.0
        for t in range(q.shape[1]):
            sines(q[m, t], trig, 0)
            x, y = x0 - base[m, t, 0], y0 - base[m, t, 1]
            square, closest, passes = np.inf, 0, False
            for i in range(n):
                along, across = x * sin[i] - y * cos[i], x * cos[i] + y * sin[i]
                side = across if 0.0 < along < length[m, i] else 0.0
                passes = passes or side * beside[i] < 0.0
                beside[i] = side
                past = along - min(max(along, 0.0), length[m, i])
                apart = past * past + across * across
                if apart < square:
                    square, closest = apart, i
                x, y = x - length[m, i] * sin[i], y + length[m, i] * cos[i]
            gap = math.sqrt(square) - reach
            least[m] = min(least[m], max(gap, 0.0))
            away = away or gap >= near
            strikes = t > 0 and (passes or gap < 0.0)
            if t == 0 or strikes or (away and gap < near):
                link[m] = closest
            if strikes or (away and gap < near):
                at[m] = t
                break


@kernel
def samples_apart(q, tip, length, shaft, bar, hangs, until, count):  # type: ignore[no-untyped-def]
    """Set after how many samples (M,) ropes first come too near their shaft or arm; T if they do not.

    Parameters
    ----------
    q, tip : (M, T, n), (M, T, 2) float64
        Link angles, rad, and the arm's tip, from which the rope hangs, m from the shaft's centre.
    length : (n,) float64
        Of the links, m.
    shaft, bar : float
        Least distances, m, of a link's axis from the shaft's centre and from the arm's axis.
    hangs : int
        Links that may be near the arm: they hang from its tip.
    until : (M,) int64
        Samples to look at.
    """
    n = q.shape[2]
    trig = np.empty(2 * n)
    sin, cos = trig[:n], trig[n:]
    for m in range(q.shape[0]):
        count[m] = q.shape[1]
        for t in range(min(until[m], q.shape[1])):
            sines(q[m, t], trig, 0)
            near = False
            tx, ty = tip[m, t, 0], tip[m, t, 1]
            room = max(shaft, math.sqrt(tx * tx + ty * ty) + bar)
            x, y = tx, ty
            for i in range(n):
                ex, ey = x + length[i] * sin[i], y - length[i] * cos[i]
                if ex * ex + ey * ey < (room + length[i]) ** 2:
                    near = near or from_segment(0.0, 0.0, x, y, ex, ey) <= shaft
                    if i >= hangs:
                        near = near or between_segments(x, y, ex, ey, 0.0, 0.0, tx, ty) <= bar
                x, y = ex, ey
            if near:
                count[m] = t
                break


@kernel
def arm_gaps(q, tip, length, links, hangs, gap):  # type: ignore[no-untyped-def]
    """Set the distances of links' axes from the shaft's centre, and from the arm's axis, m: `gap` (T, 2, k).

    Parameters
    ----------
    q, tip : (T, m), (T, 2) float64
        Angles of the first m links, rad, and the arm's tip, from which they hang, m from the shaft's centre.
    length : (m,) float64
        Of the links, m.
    links : (k,) int64
        Numbers of the links to measure, increasing, < m.
    hangs : int
        Links that hang from the arm's tip: infinitely far from its axis.
    """
    for t in range(q.shape[0]):
        tx, ty = tip[t, 0], tip[t, 1]
        x, y, k = tx, ty, 0
        for i in range(q.shape[1]):
            sin, cos = sincos(q[t, i])
            ex, ey = x + length[i] * sin, y - length[i] * cos
            if k < links.size and links[k] == i:
                gap[t, 0, k] = from_segment(0.0, 0.0, x, y, ex, ey)
                gap[t, 1, k] = np.inf if i < hangs else between_segments(x, y, ex, ey, 0.0, 0.0, tx, ty)
                k += 1
            x, y = ex, ey


@non_allocating
def from_segment(x, y, x0, y0, x1, y1):  # type: ignore[no-untyped-def]
    """Distance of the point (x, y) from the segment from (x0, y0) to (x1, y1)."""
    ux, uy, rx, ry = x1 - x0, y1 - y0, x - x0, y - y0
    part = min(max((rx * ux + ry * uy) / max(ux * ux + uy * uy, 1e-300), 0.0), 1.0)
    return math.sqrt((rx - part * ux) ** 2 + (ry - part * uy) ** 2)


@non_allocating
def between_segments(x0, y0, x1, y1, x2, y2, x3, y3):  # type: ignore[no-untyped-def]
    """Distance of the segment from (x0, y0) to (x1, y1) from that from (x2, y2) to (x3, y3); 0 if they cross."""
    ux, uy, vx, vy = x1 - x0, y1 - y0, x3 - x2, y3 - y2
    crosses = (ux * (y2 - y0) - uy * (x2 - x0)) * (ux * (y3 - y0) - uy * (x3 - x0)) < 0.0
    if crosses and (vx * (y0 - y2) - vy * (x0 - x2)) * (vx * (y1 - y2) - vy * (x1 - x2)) < 0.0:
        return 0.0
    one = min(from_segment(x2, y2, x0, y0, x1, y1), from_segment(x3, y3, x0, y0, x1, y1))
    return min(one, from_segment(x0, y0, x2, y2, x3, y3), from_segment(x1, y1, x2, y2, x3, y3))
