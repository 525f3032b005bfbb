"""Articulated-body sweep for changes of rates, with contacts as implicit forces.

A contact with fixed mode answers the velocity of its point by an impulse P = C - B v, where B is so large that v stays
next to nothing. That is one more linear term on its link, so the sweep solves rope and all contacts at once, with no
contact matrix: (M.8)-(M.13) with the terms of B and C.

Pegs may turn on an axle; their rates after a step are solved together with the rope. A contact sees the tangential
velocity of its point less that of the peg, ``reach`` times the peg's rate, and its tangential impulse turns the peg
with the same lever: contacts act on the rope's axis, so peg and rope exchange no more than action and reaction in one
point. With fixed modes the rope's answer is linear in the rates of the pegs. One more sweep for each peg that a link
sticks to, and one equation a peg, give them all.
"""

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign
from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.contact.arrays import AHEAD, FRAME, OPEN, STICK
from hyperflex.core.contact.gaps import Index
from hyperflex.core.jit import inlined, kernel, non_allocating, read, write, zeros

# of a row of `touch`: sums over the contacts of a link at places s, n the direction across the link
BXX, BXY, BYX, BYY = range(4)  # B, kg
GX, GY, EX, EY = range(4, 8)  # s B n and s n B, kg m
DD = 8  # s^2 n.B n, kg m^2
CX, CY, RC = range(9, 12)  # C, N s, and s n.C, N m s
# of a row of `frame`: where its rate changes by x, the velocity of a link's far joint less that of its other one
# changes by its length times V x + K; T is the way, in its lengths, along which forces at the far joint turn it; TURN,
# N m s, less SLOPE x, kg m^2, turns the link alone. At rest T = V = n, the rest is 0
TX, TY, VX, VY, SLOPE, KX, KY, TURN = range(8)
WAY_BACK = tuple(range(12))  # of ``work``, for each link: how it answers, and what the links beyond it answer


@inlined
def link_change(link, joint, frame, touch, beyond):  # type: ignore[no-untyped-def]
    """One link of the sweep from tip to motor, as ``articulated_body.link_step``, with contacts and without symmetry.

    Parameters
    ----------
    link : (length, mass * com, mass * com^2, inertia about the centre of mass, mass)
    joint : (T, kappa), angular impulse T - kappa (change of this rate less change of the parent's), N m s, kg m^2
    frame : (8,) how the link moves, see the names above
    touch : (12,) the contacts of the link
    beyond : (axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, s, beta)

    Returns
    -------
    at : tuple, the same answer at the link's motor-side joint
    back : (r inv, ex inv, ey inv, k), for the way back
    """
    length, ma, maa, inertia, mass = link
    torque, kappa = joint
    axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, s, beta = beyond
    tx, ty, vx, vy, kx, ky = frame[TX], frame[TY], frame[VX], frame[VY], frame[KX], frame[KY]
    lx, ly = length * vx, length * vy
    mx, my = length * tx, length * ty
    ax = lx * axx + ly * axy
    ay = lx * ayx + ly * ayy
    gx = ma * vx + ax + fx + touch[GX]
    gy = ma * vy + ay + fy + touch[GY]
    ex = ma * tx + (mx * axx + my * ayx) + ux + touch[EX]
    ey = ma * ty + (mx * axy + my * ayy) + uy + touch[EY]
    own = inertia + maa * (tx * vx + ty * vy) + touch[DD] + frame[SLOPE]
    rigid = own + s + (mx * fx + my * fy) + (lx * ux + ly * uy) + (mx * ax + my * ay)
    inv = 1.0 / (rigid + kappa)
    k = kappa * inv
    px, py = length * kx, length * ky
    hx = axx * px + axy * py + bx
    hy = ayx * px + ayy * py + by
    turn = torque + frame[TURN] + touch[RC] - maa * (tx * kx + ty * ky)
    turn = (turn - beta - (mx * hx + my * hy) - (px * ux + py * uy)) * inv
    at = (
        axx + mass + touch[BXX] - gx * ex * inv,
        axy + touch[BXY] - gx * ey * inv,
        ayx + touch[BYX] - gy * ex * inv,
        ayy + mass + touch[BYY] - gy * ey * inv,
        gx * k,
        gy * k,
        gx * turn + hx + ma * kx - touch[CX],
        gy * turn + hy + ma * ky - touch[CY],
        k * ex,
        k * ey,
        k * rigid,
        torque - kappa * turn,
    )
    return at, (turn, ex * inv, ey * inv, k)


@non_allocating
def changes(chain, joint, frame, touch, base, tip, change, place, pull, work):  # type: ignore[no-untyped-def]
    """Changes of all rates within a step; O(n).

    Parameters
    ----------
    chain : Chain, with friction that acts on both links of a joint
    joint : (n, 2) angular impulse of each joint, N m s, and its slope kappa, kg m^2
    frame : (n, 8) how the links move, see the names above
    touch : (n, 12) contacts, see the names above
    base : (3,) change of the first joint's velocity less step times gravity, m/s, and of the parent's rate, rad/s
    tip : (2,) impulse on the tip in addition to gravity, N s
    change : (n,) out, rad/s
    place : (2, n) out, change of the velocity of each link's motor-side joint less step times gravity, m/s
    pull : (2, n) out, forces along which T turns each link, times their levers, N m s
    work : (12 n,) scratch

    Returns
    -------
    (px, py, l) : impulse on the rope at its first joint, N s, and angular impulse through that joint, N m s
    """
    n = change.size
    at = (chain.tip_mass, 0.0, 0.0, chain.tip_mass, 0.0, 0.0, -tip[0], -tip[1], 0.0, 0.0, 0.0, 0.0)
    for way in range(n):
        i = n - 1 - way
        ma = chain.mass[i] * chain.com[i]
        link = (chain.length[i], ma, ma * chain.com[i], chain.inertia[i], chain.mass[i])
        beyond = at
        at, back = link_change(link, (joint[i, 0], joint[i, 1]), frame[i], touch[i], beyond)
        write(work, 1, 12 * i, WAY_BACK, (*back, *beyond[:8]))
    px, py, up = base[0], base[1], base[2]
    axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, s, beta = at
    load = axx * px + axy * py + fx * up + bx, ayx * px + ayy * py + fy * up + by, ux * px + uy * py + s * up + beta
    for i in range(n):
        r, ex, ey, k, axx, axy, ayx, ayy, fx, fy, bx, by = read(work, 1, 12 * i, WAY_BACK)
        place[0, i], place[1, i] = px, py
        change[i] = up = r - ex * px - ey * py + k * up
        length, ma = chain.length[i], chain.mass[i] * chain.com[i]
        vx, vy = frame[i, VX] * up + frame[i, KX], frame[i, VY] * up + frame[i, KY]
        com_x, com_y = ma * (px + chain.com[i] * vx), ma * (py + chain.com[i] * vy)
        px += length * vx
        py += length * vy
        pull[0, i] = com_x + length * (axx * px + axy * py + fx * up + bx)
        pull[1, i] = com_y + length * (ayx * px + ayy * py + fy * up + by)
    return load


@non_allocating
def clear(touch, links, count):  # type: ignore[no-untyped-def]
    """Take the contacts of the first `count` of `links` off the rows of `touch`."""
    for c in range(count):
        touch[links[c]] = 0.0


@non_allocating
def add_contact(touch, i, s, sin, cos, b, c):  # type: ignore[no-untyped-def]
    """Add an impulse C - B v at the place s of link i: b = (bxx, bxy, byx, byy), kg; c = (cx, cy), N s."""
    row = touch[i]
    bxx, bxy, byx, byy = b
    cx, cy = c
    gx, gy = bxx * cos + bxy * sin, byx * cos + byy * sin
    row[BXX] += bxx
    row[BXY] += bxy
    row[BYX] += byx
    row[BYY] += byy
    row[GX] += s * gx
    row[GY] += s * gy
    row[EX] += s * (cos * bxx + sin * byx)
    row[EY] += s * (cos * bxy + sin * byy)
    row[DD] += s * s * (cos * gx + sin * gy)
    row[CX] += cx
    row[CY] += cy
    row[RC] += s * (cos * cx + sin * cy)


@non_allocating
def add_contact_impulse(contacts, impulses, motion, c, penalty, pn, pt):  # type: ignore[no-untyped-def]
    """Add contact c, in its present mode, to ``motion.touch``: impulses pn, pt, N s, at rest; `penalty` is M, kg.

    What slips has the tangential impulse that goes with the normal one; pt is of no account then.
    """
    i, s = contacts.link[c], contacts.place[c]
    sin, cos = motion.trig[i], motion.trig[motion.w.size + i]
    nx, ny = contacts.nx[c], contacts.ny[c]
    if impulses.mode[c] == STICK:
        b = (penalty, 0.0, 0.0, penalty)
        add_contact(motion.touch, i, s, sin, cos, b, (pn * nx - pt * ny, pn * ny + pt * nx))
    else:
        ratio = friction_ratio(contacts, impulses, c)
        fx, fy = nx - ratio * ny, ny + ratio * nx
        b = (penalty * fx * nx, penalty * fx * ny, penalty * fy * nx, penalty * fy * ny)
        add_contact(motion.touch, i, s, sin, cos, b, (pn * fx, pn * fy))


@non_allocating
def friction_ratio(contacts, impulses, c):  # type: ignore[no-untyped-def]
    """Tangential impulse of a contact that slips, in parts of the normal one."""
    return -contacts.mu[c] if impulses.mode[c] == AHEAD else contacts.mu[c]


@inlined
def resolved(contacts, motion, c, vx, vy, rate):  # type: ignore[no-untyped-def]
    """Velocity of the point of contact c, m/s: along its normal, and along its tangent.

    Its link turns at a `rate`, rad/s, and the link's motor-side joint moves at (vx, vy), m/s.
    """
    i, lever = contacts.link[c], contacts.place[c] * rate
    px, py = vx + lever * motion.trig[motion.w.size + i], vy + lever * motion.trig[i]
    return px * contacts.nx[c] + py * contacts.ny[c], py * contacts.nx[c] - px * contacts.ny[c]


@non_allocating
def velocity(contacts, motion, c):  # type: ignore[no-untyped-def]
    """Velocity of the point of contact c after the step, m/s: along its normal, and along its tangent."""
    i, speed, turned, place = contacts.link[c], motion.speed, motion.turned, motion.place
    vx, vy = speed[0, i] + turned[0, i] + place[0, i], speed[1, i] + turned[1, i] + place[1, i]
    return resolved(contacts, motion, c, vx, vy, motion.w[i] + motion.change[i])


class Spin(NamedTuple):
    """Pegs that turn, k of m, and the answer of n links to each."""

    which: Index  # (k,) pegs that turn
    row: Index  # (m,) index of each in `which`; -1 if it is fixed
    reach: Array  # (m,) m, lever of the rope's axis about the axle
    inertia: Array  # (m,) kg m^2
    bearing: Array  # (m,) N m s, viscous friction of the axle
    before: Array  # (m,) rad/s, rates before the step; 0 of fixed ones
    after: Array  # (m,) and after it
    stay: Array  # (m,) part of its rate that a peg keeps in the step where nothing touches it
    penalty: Array  # (m,) kg m^2, angular impulse over the change of the rate that it makes
    system: Array  # (k, k + 1) equations of the rates after the step
    change: Array  # (k, n) answers to a rate of 1 rad/s: of the links' rates
    place: Array  # (k, 2, n) of the joints' velocities
    pull: Array  # (2, n)
    load: Array  # (k, 3) of the impulse at the first joint
    joint: Array  # (n, 2) angular impulse of each joint in these answers: 0, and its slope
    frame: Array  # (n, 8) as ``Motion.frame``, without K and TURN
    none: Array  # (3,) nothing


@kernel
def new_spin(n, pegs):  # type: ignore[no-untyped-def]
    """Working arrays for n links and the Pegs `pegs`, all at rest."""
    m = pegs.reach.size
    row, k = np.full(m, -1), 0
    which = np.zeros(m, np.int64)
    for p in range(m):
        if pegs.inertia[p] < np.inf:
            row[p], which[k] = k, p
            k += 1
    links = n if k > 0 else 0
    pegs_alone = zeros(m, m, m, m, (k, k + 1))
    answers = zeros((k, links), (k, 2, links), (2, links), (k, 3), (links, 2), (links, FRAME), 3)
    return Spin(which[:k].copy(), row, pegs.reach, pegs.inertia, pegs.bearing, *pegs_alone, *answers)


@non_allocating
def coasting(inertia, bearing, h):  # type: ignore[no-untyped-def]
    """Part of its rate that a free peg keeps for h s, and angular impulse over change of rate, kg m^2; both exact."""
    x = bearing * h / inertia
    if x == 0.0:
        return 1.0, inertia
    return math.exp(-x), -bearing * h / math.expm1(-x)


@non_allocating
def prepare_spin(spin, motion, h):  # type: ignore[no-untyped-def]
    """Prepare a step h, s; 0.0: an impact."""
    for p in spin.which:
        spin.stay[p], spin.penalty[p] = coasting(spin.inertia[p], spin.bearing[p], h)
    if spin.which.size > 0:
        assign(spin.joint[:, 1], motion.joint[:, 1])


@non_allocating
def peg_response(chain, contacts, impulses, motion, spin, penalty, k):  # type: ignore[no-untyped-def]
    """Find what a rate of 1 rad/s of turning peg k alone does to the rope, in these modes; `penalty` is M, kg."""
    p = spin.which[k]
    clear(motion.touch, contacts.link, contacts.total[0])
    sticks = False
    for c in range(contacts.total[0]):
        if impulses.mode[c] != OPEN:
            here = impulses.mode[c] == STICK and contacts.peg[c] == p
            sticks = sticks or here
            add_contact_impulse(contacts, impulses, motion, c, penalty, 0.0, penalty * spin.reach[p] if here else 0.0)
    if not sticks:
        spin.change[k] = spin.load[k] = 0.0
        spin.place[k] = 0.0
        return
    base, tip = spin.none, spin.none[:2]
    spin.load[k, 0], spin.load[k, 1], spin.load[k, 2] = changes(
        chain, spin.joint, spin.frame, motion.touch, base, tip, spin.change[k], spin.place[k], spin.pull, motion.work
    )


@non_allocating
def add_peg_equation(contacts, impulses, motion, spin, penalty, c):  # type: ignore[no-untyped-def]
    """Enter the tangential impulse of contact c into the equation of its peg, at present rates and per rad/s of each.

    ``motion`` holds the rope's answer to pegs at rest.
    """
    last = spin.which.size
    i, k, lever = contacts.link[c], spin.row[contacts.peg[c]], spin.reach[contacts.peg[c]]
    vn, vt = velocity(contacts, motion, c)
    sticks, ratio = impulses.mode[c] == STICK, friction_ratio(contacts, impulses, c)
    if sticks:
        pt = impulses.start[1, c] - penalty * (vt + impulses.tangent_target[c])
        spin.system[k, k] += lever * penalty * lever
    else:
        pt = ratio * (impulses.start[0, c] - penalty * (vn + impulses.target[c]))
    spin.system[k, last] -= lever * pt
    for j in range(last):
        vn, vt = resolved(contacts, motion, c, spin.place[j, 0, i], spin.place[j, 1, i], spin.change[j, i])
        spin.system[k, j] -= lever * penalty * (vt if sticks else ratio * vn)


@non_allocating
def eliminate(system):  # type: ignore[no-untyped-def]
    """Solve equations (k, k + 1), the right-hand side last, which becomes the solution."""
    k = system.shape[0]
    for i in range(k):
        best = i
        for j in range(i + 1, k):
            if abs(system[j, i]) > abs(system[best, i]):
                best = j
        for col in range(k + 1):
            system[i, col], system[best, col] = system[best, col], system[i, col]
        for j in range(k):
            if j != i:
                factor = system[j, i] / system[i, i]
                for col in range(i, k + 1):
                    system[j, col] -= factor * system[i, col]
    for i in range(k):
        system[i, k] /= system[i, i]


@non_allocating
def turn_pegs(chain, contacts, impulses, motion, joints, spin, penalty):  # type: ignore[no-untyped-def]
    """Find the pegs' rates after the step with the present modes, and add what they do to the rope.

    ``motion`` holds the rope's answer to pegs at rest; what ``motion.touch`` holds is lost.
    """
    last = spin.which.size
    for i in joints.which:
        spin.joint[i, 1] = motion.joint[i, 1]
    for i in range(motion.w.size):
        for k in range(TX, KX):
            spin.frame[i, k] = motion.frame[i, k]
    for k in range(last):
        p = spin.which[k]
        peg_response(chain, contacts, impulses, motion, spin, penalty, k)
        spin.system[k] = 0.0
        spin.system[k, k] = spin.penalty[p]
        spin.system[k, last] = spin.penalty[p] * spin.stay[p] * spin.before[p]
    for c in range(contacts.total[0]):
        if impulses.mode[c] != OPEN and spin.row[contacts.peg[c]] >= 0:
            add_peg_equation(contacts, impulses, motion, spin, penalty, c)
    eliminate(spin.system)
    for k in range(last):
        rate = spin.system[k, last]
        spin.after[spin.which[k]] = rate
        for i in range(motion.w.size):
            motion.change[i] += rate * spin.change[k, i]
            motion.place[0, i] += rate * spin.place[k, 0, i]
            motion.place[1, i] += rate * spin.place[k, 1, i]
        for j in range(3):
            motion.load[j] += rate * spin.load[k, j]


@non_allocating
def lost_in_bearings(spin):  # type: ignore[no-untyped-def]
    """Energy that the axles took in the step, J: their angular impulse times the mean rate."""
    taken = 0.0
    for p in spin.which:
        penalty, inertia, before, after = spin.penalty[p], spin.inertia[p], spin.before[p], spin.after[p]
        impulse = (penalty - inertia) * after + (inertia - penalty * spin.stay[p]) * before
        taken += impulse * 0.5 * (before + after)
    return taken
