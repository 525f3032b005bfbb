"""Gap functions: closest point of each link to an obstacle, gap and closing speed.

A link touches a peg with its axis at the distance ``reach`` (peg radius plus rope radius) from the peg's centre. Only
joints can touch a straight face, so each link represents the joint at its end; the ends of a face are pegs of radius
zero. The contact force acts on the axis: the lever of friction about the axis is neglected, as in the capstan law of a
thin rope (docs/models.md).
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.jit import kernel, non_allocating, zeros

Index = npt.NDArray[np.int64]
NOWHERE = 1e9  # m, gap of links that cannot touch
LARGEST_TURN = 1.5  # rad, largest arc of a single contact; more is a kink


class Pegs(NamedTuple):
    """Obstacles, one entry each: round pegs, and straight faces."""

    x: Array  # m, centre of a peg, first end of a face
    y: Array
    ux: Array  # unit vector along a face; a half plane is solid on its right
    uy: Array
    span: Array  # m, length of a face; 0 for a peg, infinite where one side is solid
    reach: Array  # m, peg radius plus rope radius
    mu: Array  # Coulomb's coefficient
    bounce: Array  # coefficient of restitution
    inertia: Array  # kg m^2, of a turning peg; infinite for fixed obstacles
    bearing: Array  # N m s, viscous friction of its axle
    first: int  # first link that may touch: 1 where link 0 is the arm


class Contacts(NamedTuple):
    """Links near a peg, in the order of the links; the first ``total[0]`` entries are valid."""

    total: Index  # (1,)
    link: Index  # (K,)
    peg: Index
    place: Array  # m, of the closest point along the link from its motor-side joint
    nx: Array  # unit vector from the peg to the link; the tangent is (-ny, nx)
    ny: Array
    gap: Array  # m, negative: penetration
    mu: Array  # coefficient of friction, corrected for the corners of the polygon


@kernel
def new_contacts(most):  # type: ignore[no-untyped-def]
    """Contacts for at most `size` pairs of a link and a peg."""
    pairs = np.zeros((2, most), np.int64)
    return Contacts(np.zeros(1, np.int64), pairs[0], pairs[1], *zeros(most, most, most, most, most))


@non_allocating
def joint_positions(chain, trig, x0, y0, out):  # type: ignore[no-untyped-def]
    """Positions of the joints, m: ``out`` (2, n + 1), from the first at (x0, y0); `trig` (2 n,) sines, cosines."""
    n = chain.length.size
    out[0, 0], out[1, 0] = x0, y0
    for i in range(n):
        out[0, i + 1] = out[0, i] + chain.length[i] * trig[i]
        out[1, i + 1] = out[1, i] - chain.length[i] * trig[n + i]


@non_allocating
def closest(link, x, y):  # type: ignore[no-untyped-def]
    """Closest point of a link to the point (x, y): distance along the link, m; distance, m; unit vector to it.

    `link`: x, y of its motor-side joint and of its far joint, m; its length, m; sine and cosine of its angle.
    """
    x0, y0, _, _, length, sin, cos = link
    rx, ry = x - x0, y - y0
    s = min(max(rx * sin - ry * cos, 0.0), length)
    dx, dy = s * sin - rx, -s * cos - ry
    size = math.sqrt(dx * dx + dy * dy)
    if size < 1e-12:  # the axis runs through the centre: either side is valid
        return s, size, cos, sin
    return s, size, dx / size, dy / size


@non_allocating
def joint_gap(link, obstacle):  # type: ignore[no-untyped-def]
    """Gap between the joint at the end of a link and a face, m, and the unit vector from the face to the joint."""
    x, y, ux, uy, span, reach = obstacle
    rx, ry = link[2] - x, link[3] - y
    along, across = rx * ux + ry * uy, ry * ux - rx * uy
    if span < np.inf:
        if along < 0.0 or along > span:
            return NOWHERE, -uy, ux
        if across < 0.0:
            return -across - reach, uy, -ux
    return across - reach, -uy, ux


@non_allocating
def nearest(link, obstacle):  # type: ignore[no-untyped-def]
    """Point of a link that may touch an obstacle: distance along the link, m; gap, m; unit vector to it.

    `link` as for ``closest``; `obstacle`: x, y, ux, uy, span, reach as in Pegs. Numbers, not arrays: reading arrays
    from their tuples behind a branch costs more than everything else.
    """
    if obstacle[4] > 0.0:
        gap, nx, ny = joint_gap(link, obstacle)
        return link[4], gap, nx, ny
    s, size, nx, ny = closest(link, obstacle[0], obstacle[1])
    return s, size - obstacle[5], nx, ny


@non_allocating
def corner(q, i):  # type: ignore[no-untyped-def]
    """Factor on the friction of link i, which represents the arc between the middles of its two corners.

    Tangential forces meet the hinges of a polygon outside the circle: a wrapped polygon of corners d holds exp(mu theta
    sin(d) / d) instead of exp(mu theta). With d / sin(d) times the friction it holds as much as the rope.
    """
    n = q.size
    turn = 0.0
    if i > 0:
        turn += 0.5 * abs(q[i] - q[i - 1])
    if i < n - 1:
        turn += 0.5 * abs(q[i + 1] - q[i])
    turn = min(turn, LARGEST_TURN)
    return 1.0 if turn < 1e-6 else turn / math.sin(turn)


@non_allocating
def find(chain, pegs, q, trig, place, margin, contacts):  # type: ignore[no-untyped-def]
    """Collect the pairs of a link and a peg whose gap is below `margin` (n,), m, into the Contacts `contacts`.

    Returns the smallest gap of all pairs, m, or a lower bound if it is above the margins.
    """
    count, n = 0, q.size
    least = np.inf
    length, x, y, ux, uy = chain.length, pegs.x, pegs.y, pegs.ux, pegs.uy
    span, reach, mu = pegs.span, pegs.reach, pegs.mu
    for i in range(pegs.first, n):
        x0, y0, size = place[0, i], place[1, i], length[i]
        link = (x0, y0, place[0, i + 1], place[1, i + 1], size, trig[i], trig[n + i])
        for p in range(x.size):
            dx, dy = x[p] - x0, y[p] - y0
            far = reach[p] + size + margin[i]
            away = math.sqrt(dx * dx + dy * dy)
            if away > far and span[p] == 0.0:
                least = min(least, away - far + margin[i])
                continue
            s, gap, nx, ny = nearest(link, (x[p], y[p], ux[p], uy[p], span[p], reach[p]))
            least = min(least, gap)
            if gap < margin[i]:
                contacts.link[count], contacts.peg[count] = i, p
                contacts.place[count], contacts.nx[count], contacts.ny[count] = s, nx, ny
                contacts.gap[count] = gap
                contacts.mu[count] = mu[p] * (corner(q, i) if span[p] == 0.0 else 1.0)
                count += 1
    contacts.total[0] = count
    return least


@non_allocating
def speeds(chain, trig, w, vx, vy, out):  # type: ignore[no-untyped-def]
    """Velocities of the joints, m/s: ``out`` (2, n + 1), from that of the first, (vx, vy); `trig` as in ``joints``."""
    n = w.size
    out[0, 0], out[1, 0] = vx, vy
    for i in range(n):
        out[0, i + 1] = out[0, i] + chain.length[i] * trig[n + i] * w[i]
        out[1, i + 1] = out[1, i] + chain.length[i] * trig[i] * w[i]
