"""Articulated-body sweep for changes of rates, with contacts as implicit forces.

A contact with fixed mode answers the velocity of its point by an impulse P = C - B v, where B is so large that v stays
next to nothing. That is one more linear term on its link, so the sweep solves rope and all contacts at once, with no
contact matrix: (M.8)-(M.13) with the terms of B and C.
"""

from hyperflex.core.contact.arrays import AHEAD, STICK
from hyperflex.core.jit import inlined, non_allocating

# of a row of `touch`: sums over the contacts of a link at places s, n the direction across the link
BXX, BXY, BYX, BYY = range(4)  # B, kg
GX, GY, EX, EY = range(4, 8)  # s B n and s n B, kg m
DD = 8  # s^2 n.B n, kg m^2
CX, CY, RC = range(9, 12)  # C, N s, and s n.C, N m s
# of a row of `frame`: where its rate changes by x, the velocity of a link's far joint less that of its other one
# changes by its length times V x + K; T is the way, in its lengths, along which forces at the far joint turn it; TURN,
# N m s, less SLOPE x, kg m^2, turns the link alone. At rest T = V = n, the rest is 0
TX, TY, VX, VY, SLOPE, KX, KY, TURN = range(8)


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
    zero = 0.0
    at = (chain.tip_mass, zero, zero, chain.tip_mass, zero, zero, -tip[0], -tip[1], zero, zero, zero, zero)
    for way in range(n):
        i = n - 1 - way
        ma = chain.mass[i] * chain.com[i]
        link = (chain.length[i], ma, ma * chain.com[i], chain.inertia[i], chain.mass[i])
        o = 12 * i
        work[o + 4], work[o + 5], work[o + 6], work[o + 7], work[o + 8], work[o + 9], work[o + 10], work[o + 11] = at[
            :8
        ]
        at, back = link_change(link, (joint[i, 0], joint[i, 1]), frame[i], touch[i], at)
        work[o], work[o + 1], work[o + 2], work[o + 3] = back
    px, py, up = base[0], base[1], base[2]
    fx = at[0] * px + at[1] * py + at[4] * up + at[6]
    fy = at[2] * px + at[3] * py + at[5] * up + at[7]
    moment = at[8] * px + at[9] * py + at[10] * up + at[11]
    for i in range(n):
        o = 12 * i
        place[0, i], place[1, i] = px, py
        up = work[o] - work[o + 1] * px - work[o + 2] * py + work[o + 3] * up
        change[i] = up
        length, ma = chain.length[i], chain.mass[i] * chain.com[i]
        vx, vy = frame[i, VX] * up + frame[i, KX], frame[i, VY] * up + frame[i, KY]
        pull[0, i] = ma * (px + chain.com[i] * vx)
        pull[1, i] = ma * (py + chain.com[i] * vy)
        px += length * vx
        py += length * vy
        pull[0, i] += length * (work[o + 4] * px + work[o + 5] * py + work[o + 8] * up + work[o + 10])
        pull[1, i] += length * (work[o + 6] * px + work[o + 7] * py + work[o + 9] * up + work[o + 11])
    return fx, fy, moment


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
