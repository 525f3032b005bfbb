"""Contact solver: the modes and impulses of contacts and joints in a step.

A contact with fixed mode answers the velocity of its point by an impulse P = C - B v, where B is so large that v stays
next to nothing. That is one more linear term on its link, so an articulated-body sweep for changes of rates solves rope
and all contacts at once, with no contact matrix: (M.8)-(M.13) with the terms of B and C. An active-set search finds
which contacts are open, stick or slip.

Pegs may turn on an axle; their rates after a step are solved together with the rope. A contact sees the tangential
velocity of its point less that of the peg, ``reach`` times the peg's rate, and its tangential impulse turns the peg
with the same lever: contacts act on the rope's axis, so peg and rope exchange no more than action and reaction in one
point. With fixed modes the rope's answer is linear in the rates of the pegs. One more sweep for each peg that a link
sticks to, and one equation a peg, give them all.

Dry friction with stiction and inelastic bend limits of a joint are one law between the relative rate of a joint after
the step and its angular impulse L, a staircase that only falls (a maximal monotone graph): at the lower limit any L
above that of friction, then the friction of a joint that turns back, at rest any L within friction, the friction of one
that turns ahead, at the upper limit any L below it. A mode is a step of the staircase. Where the rate is given, L = L0
- M rate by the proximal method, as for contacts: no more than a change of the joint's (T, kappa) in the sweep.

A wrapped rope that sticks is hyperstatic: many impulses give the same motion. The proximal method (an augmented
Lagrangian) takes those nearest to the last step's, P = P0 - M v with a mass M far above the rope's, and projects them
on the cone. Its residual velocity is (P - P0) / M and dies out where the load is steady, so what sticks does not creep.
"""

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core import joint_law
from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain.articulated_body import Array, joint_of, relative, sines
from hyperflex.core.contact.gaps import Index
from hyperflex.core.integrate.events import limit_gap
from hyperflex.core.jit import absorbed, inlined, kernel, non_allocating, read, write, zeros

# Modes. AHEAD, BACK: the rope slips along the tangent, or against it; a joint turns in the positive sense, or against
# it. UPPER, LOWER: a joint is held at a limit.
OPEN, STICK, AHEAD, BACK, UPPER, LOWER = range(6)
RELAXED = 0.99  # part of the last forces and torques with which a step starts: what nothing requires dies out
FRAME, TOUCH = 8, 12  # columns of Motion.frame and Motion.touch; see the names below
UNHELD = 1e9  # m/s, target of a link that nothing holds


class Impulses(NamedTuple):
    """Impulses and velocities of the contacts found, in their order, and state of the search for their modes."""

    normal: Array  # (K,) N s
    tangent: Array
    start: Array  # (2, K) N s, normal and tangential, where the proximal method starts from
    good: Array  # (2, K) and where it started for the last solution found
    target: Array  # (K,) m/s, the normal velocity may be as low as minus this
    tangent_target: Array  # (K,) m/s, and what sticks has the tangential velocity minus this, against the peg
    vn: Array  # (K,) velocity of the point at the end of the step, m/s
    vt: Array  # less that of a peg that turns, without `tangent_target`
    mode: Index
    good_mode: Index  # of the last solution found
    closed: Index  # how often each closed in this search
    penalty: Array  # (1,) kg, mass M with which the search starts, then that for the next one; 0: the usual one
    residual_power: float  # W, power that residual velocities may have
    loose: float  # as ``looseness``


class Joints(NamedTuple):
    """Joints with dry friction or limits. Few arrays: kernels copy what they are called with, word by word."""

    which: Index  # (k,) the joints
    mode: Index  # (n,)
    good_mode: Index  # (n,) of the last solution found
    of: Array  # (ROWS, n) see the names below


# Rows of Joints.of, by joint. IMPULSE: of friction and limit together, N m s. START: where the proximal method starts
# from; GOOD: that of the last solution found. BOUND: the greatest that dry friction gives in the step, N m s. LOWEST,
# HIGHEST: the relative rate after the step may be between these, rad/s. BEFORE, AFTER: relative rates, rad/s. LEVER:
# length of the chain beyond the joint, m. FREE, FREE + 1: as ``Motion.joint``, without friction and limits.
IMPULSE, START, GOOD, BOUND, LOWEST, HIGHEST, BEFORE, AFTER, LEVER, FREE, ROWS = *range(10), 11


class Motion(NamedTuple):
    """Rates before and after a step and what moves them."""

    w: Array  # (n,) before
    change: Array  # (n,)
    last: Array  # (n,) the change about which `frame` is linear
    q: Array  # (n,) angles in the middle of the step as the rates before make them; those of the contacts
    trig: Array  # (2 n,) their sines and cosines
    mean: Array  # (n,) means of the angles before and after
    mean_trig: Array  # (2 n,) their sines and cosines
    frame: Array  # (n, FRAME)
    joint: Array  # (n, 2)
    touch: Array  # (n, TOUCH)
    weight: Array  # (n,) moment of the mass that a link bears about its motor-side joint, kg m
    damping: Array  # (n,) 1/s, rate at which friction at a joint alone ends the turning of its links against each other
    speed: Array  # (2, n + 1) velocities of the joints at the rates before, in the middle's configuration
    place: Array  # (2, n)
    turned: Array  # (2, n + 1) what `place` lacks of the change of the joints' velocities in that configuration, m/s
    base: Array  # (3,)
    tip: Array  # (2,)
    load: Array  # (3,) out, impulse at the first joint
    pull: Array  # (2, n)
    span: Array  # (1,) s, step that `pull` is of
    work: Array  # (12 n,)


@kernel
def new_impulses(most, residual_power, loose):  # type: ignore[no-untyped-def]
    """Impulses of at most so many contacts; `residual_power` and `loose` as in Impulses."""
    modes = np.zeros((3, most), np.int64)
    values = zeros(most, most, (2, most), (2, most), most, most, most, most)
    return Impulses(*values, modes[0], modes[1], modes[2], np.zeros(1), residual_power, loose)  # type: ignore[call-arg]


@kernel
def new_joints(chain):  # type: ignore[no-untyped-def]
    """The joints of a chain that have dry friction or limits."""
    n = chain.length.size
    which, of, count, beyond = np.zeros(n, np.int64), np.zeros((ROWS, n)), 0, 0.0
    for i in range(n):
        if chain.dry[i] > 0.0 or chain.max_bend[i] < np.inf:
            which[count] = i
            count += 1
        beyond += chain.length[n - 1 - i]
        of[LEVER, n - 1 - i] = beyond
    return Joints(which[:count].copy(), np.zeros(n, np.int64), np.zeros(n, np.int64), of)


@kernel
def new_motion(chain):  # type: ignore[no-untyped-def]
    """Arrays for a chain."""
    n = chain.length.size
    weight, damping, beyond = np.zeros(n), np.zeros(n), chain.tip_mass
    for way in range(n):
        i = n - 1 - way
        weight[i] = chain.length[i] * beyond + chain.mass[i] * chain.com[i]
        beyond += chain.mass[i]
        damping[i] = chain.viscous[i] * (1.0 / chain.inertia[i] + (1.0 / chain.inertia[i - 1] if i > 0 else 0.0))
    before = zeros(n, n, n, n, 2 * n, n, 2 * n, (n, FRAME), (n, 2), (n, TOUCH))
    return Motion(*before, weight, damping, *zeros((2, n + 1), (2, n), (2, n + 1), 3, 2, 3, (2, n), 1, 12 * n))  # type: ignore[call-arg]


LATEST, EARLIER, STEADY = range(3)  # of ContactWorkspace.pace


class ContactMemory(NamedTuple):
    """Contact forces and modes of the last step, the warm start of the next; by link and peg or by joint."""

    normal: Array  # (n, m) N
    tangent: Array
    mode: Index
    penalty: Array  # (1,) kg, as in Impulses
    torque: Array  # (n,) N m, of the joints' dry friction and limits
    bent: Index  # (n,) their modes


@kernel
def new_contact_memory(n, pegs):  # type: ignore[no-untyped-def]
    """An empty memory."""
    modes = np.zeros((n, pegs), np.int64)
    return ContactMemory(*zeros((n, pegs), (n, pegs)), modes, *zeros(1, n), np.zeros(n, np.int64))  # type: ignore[call-arg]


@non_allocating
def clear_memory(memory):  # type: ignore[no-untyped-def]
    """Clear the modes and forces of the last step."""
    memory.penalty[0] = 0.0
    memory.normal[:] = memory.tangent[:] = memory.torque[:] = 0.0
    memory.mode[:] = OPEN
    memory.bent[:] = OPEN


@non_allocating
def warm_start(memory, contacts, impulses, h):  # type: ignore[no-untyped-def]
    """Warm start: modes and forces of the last step."""
    impulses.penalty[0] = memory.penalty[0]
    for c in range(contacts.total[0]):
        i, p = contacts.link[c], contacts.peg[c]
        impulses.mode[c] = memory.mode[i, p] if impulses.target[c] < UNHELD else OPEN
        impulses.start[0, c] = RELAXED * h * memory.normal[i, p]
        impulses.start[1, c] = RELAXED * h * memory.tangent[i, p]


@non_allocating
def save_memory(memory, contacts, impulses, joints, h):  # type: ignore[no-untyped-def]
    """Save modes and forces for the next step; `joints` are the Joints."""
    clear_memory(memory)
    memory.penalty[0] = impulses.penalty[0]
    for i in joints.which:
        memory.torque[i], memory.bent[i] = joints.of[IMPULSE, i] / h, joints.mode[i]
    for c in range(contacts.total[0]):
        i, p = contacts.link[c], contacts.peg[c]
        memory.mode[i, p] = impulses.mode[c]
        memory.normal[i, p], memory.tangent[i, p] = impulses.normal[c] / h, impulses.tangent[c] / h


@non_allocating
def keeps_modes(memory, contacts, impulses, joints):  # type: ignore[no-untyped-def]
    """Whether contacts and joints have the modes of the last step; `joints` are the Joints."""
    for i in joints.which:
        if memory.bent[i] != joints.mode[i]:
            return False
    changed = 0
    for c in range(contacts.total[0]):
        changed += memory.mode[contacts.link[c], contacts.peg[c]] != impulses.mode[c]
    return changed == 0


@non_allocating
def save_trend(memory, workspace, h):  # type: ignore[no-untyped-def]
    """Keep the accelerations of a step of the length h, s, and whether it changed modes; of a short one, 0.0, none."""
    motion, trend, pace = workspace.motion, workspace.trend, workspace.pace
    steady = h > 0.0 and keeps_modes(memory, workspace.contacts, workspace.impulses, workspace.joints)
    pace[EARLIER] = pace[LATEST] if steady and pace[STEADY] == 1.0 else 0.0
    pace[LATEST], pace[STEADY] = h, 1.0 if steady else 0.0
    for i in range(motion.w.size):
        trend[1, i] = trend[0, i]
        trend[0, i] = motion.change[i] / h if h > 0.0 else 0.0


@non_allocating
def trend_factor(pace, h):  # type: ignore[no-untyped-def]
    """Factor on the last change of the accelerations that extrapolates it over a step h, s; 0.0 where modes changed."""
    if pace[EARLIER] == 0.0 or pace[STEADY] == 0.0:
        return 0.0
    return (h + pace[LATEST]) / (pace[LATEST] + pace[EARLIER])


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


# Numbers of joints with dry friction or limits in a contact step.
#
# rad, gap at which a limit is reached
LIMIT_REACHED = 1e-5
# rad, past a limit at which a step is tried again at half its length
LIMIT_PASSED = 2e-4
# rad/s, by which a rate must pass its bound to be held
JOINT_CLOSING = 1e-9
# rad/s, below which a joint with dry friction sticks at first
JOINT_SLOW = 1e-8
# s, over which the present rate is extrapolated to a gap
SOON = 0.01

ANY = 1e9  # rad/s, bound of a rate that nothing holds


@non_allocating
def joint_mode(mode, rate, lower, upper, bound, start, mass):  # type: ignore[no-untyped-def]
    """Angular impulse of a joint in a mode, N m s, and the mode that it should have; start is L0, mass is M, kg m^2.

    `bound` is that of dry friction, N m s; `lower`, `upper` are bounds of the `rate`, rad/s.
    """
    if mode in (UPPER, LOWER):
        side, limit = (1.0, upper) if mode == UPPER else (-1.0, lower)
        impulse, beyond_rest = start - mass * (rate - limit), side * limit > 0.0
        if side * impulse > (-bound if beyond_rest else bound):
            return impulse, OPEN if bound == 0.0 else AHEAD if beyond_rest == (mode == UPPER) else BACK
        return impulse, mode
    impulse = start - mass * rate
    if mode == STICK:
        return impulse, AHEAD if impulse < -bound else BACK if impulse > bound else mode
    sense = 1.0 if mode == AHEAD else -1.0 if mode == BACK else 0.0
    new_mode = mode
    if rate > upper + JOINT_CLOSING:
        new_mode = UPPER
    elif rate < lower - JOINT_CLOSING:
        new_mode = LOWER
    elif lower < 0.0 < upper and -sense * impulse < bound:
        new_mode = STICK
    return -sense * bound, new_mode


@non_allocating
def bound_joint_rates(chain, workspace, memory, h, struck):  # type: ignore[no-untyped-def]
    """Say what each joint may do in a step `h`, s, and begin with the modes and torques of the last step.

    A gap to a limit may be closed, not more. As for contacts (``run.find_contacts``), a joint that closes faster than
    ``workspace.brisk`` is left free, and ``workspace.touch`` is the time until it is there; in an impact (h = 0.0)
    those that are there are held.
    """
    motion, joints, of = workspace.motion, workspace.joints, workspace.joints.of
    for i in joints.which:
        bend = relative(motion.q, i, workspace.base[1, 4]) - chain.rest[i]
        rate = relative(motion.w, i, workspace.base[0, 3])
        of[BEFORE, i], of[BOUND, i] = rate, h * chain.dry[i]
        of[FREE, i], of[FREE + 1, i] = motion.joint[i, 0], motion.joint[i, 1]
        of[HIGHEST, i] = allowed_rate(workspace, chain.max_bend[i] - bend, rate, h, struck)
        of[LOWEST, i] = -allowed_rate(workspace, chain.max_bend[i] + bend, -rate, h, struck)
        of[START, i] = RELAXED * h * memory.torque[i]
        joints.mode[i] = initial_joint_mode(memory.bent[i], rate, of[LOWEST, i], of[HIGHEST, i], of[BOUND, i])


@non_allocating
def allowed_rate(workspace, gap, closing, h, struck):  # type: ignore[no-untyped-def]
    """Greatest rate, rad/s, at which a gap, rad in the middle of a step, may close that closes at `closing` before."""
    if h == 0.0:
        return 0.0 if gap <= 2.0 * LIMIT_REACHED else ANY
    if gap >= ANY:
        return ANY
    away = gap + 0.5 * h * closing  # at the beginning of the step
    if closing > workspace.brisk and (away > LIMIT_REACHED or not struck):
        workspace.touch[0] = min(workspace.touch[0], 0.0 if away <= LIMIT_REACHED else away / closing)
        return ANY
    return max(gap, 0.0) / h


@non_allocating
def initial_joint_mode(last, rate, lower, upper, bound):  # type: ignore[no-untyped-def]
    """Mode of a joint to begin the search with, from that of the last step."""
    mode = last
    if bound == 0.0:
        mode = last if last >= UPPER else OPEN
    elif last == OPEN:
        mode = STICK if abs(rate) <= JOINT_SLOW else AHEAD if rate > 0.0 else BACK
    if mode in (STICK, AHEAD) and upper <= 0.0:
        return UPPER
    if mode in (STICK, BACK) and lower >= 0.0:
        return LOWER
    return mode


@non_allocating
def write_joints(motion, joints, penalty):  # type: ignore[no-untyped-def]
    """Write the joints, with their present modes, to ``motion.joint``; `penalty` is M of the contacts, kg."""
    of, joint = joints.of, motion.joint
    for i in joints.which:
        mode, torque, slope = joints.mode[i], 0.0, 0.0
        if mode in (AHEAD, BACK):
            torque = -of[BOUND, i] if mode == AHEAD else of[BOUND, i]
        elif mode != OPEN:
            slope = penalty * of[LEVER, i] * of[LEVER, i]
            at = of[HIGHEST, i] if mode == UPPER else of[LOWEST, i] if mode == LOWER else 0.0
            torque = of[START, i] - slope * (of[BEFORE, i] - at)
        joint[i, 0], joint[i, 1] = of[FREE, i] + torque, of[FREE + 1, i] + slope


@non_allocating
def update_joint_modes(motion, joints, penalty, change):  # type: ignore[no-untyped-def]
    """Read rates and impulses off the changes of the rates; with `change`, change the modes that break the law.

    Returns how many broke it.
    """
    of, violations = joints.of, 0
    for i in joints.which:
        rate = of[BEFORE, i] + relative(motion.change, i, motion.base[2])
        mass = penalty * of[LEVER, i] * of[LEVER, i]
        of[AFTER, i] = rate
        of[IMPULSE, i], new_mode = joint_mode(
            joints.mode[i], rate, of[LOWEST, i], of[HIGHEST, i], of[BOUND, i], of[START, i], mass
        )
        if new_mode != joints.mode[i]:
            violations += 1
            if change:
                joints.mode[i] = new_mode
    return violations


@non_allocating
def update_joint_multipliers(joints, penalty):  # type: ignore[no-untyped-def]
    """As ``update_multipliers`` for the joints: residual velocity, m/s, and its energy, J."""
    of = joints.of
    worst = given = 0.0
    for i in joints.which:
        mode, lever, impulse = joints.mode[i], of[LEVER, i], of[IMPULSE, i]
        if mode in (AHEAD, BACK):
            left = max(0.0, -of[AFTER, i] if mode == AHEAD else of[AFTER, i]) * lever
        elif mode == OPEN:
            left = 0.0
        else:
            left = abs(impulse - of[START, i]) / (penalty * lever)
        worst, given = max(worst, left), given + left / lever * abs(impulse)
        of[START, i] = impulse
    return worst, given


@non_allocating
def release_joints(joints):  # type: ignore[no-untyped-def]
    """Where no modes are found: limits hold nothing, and friction acts against the rates before the step."""
    of = joints.of
    for i in joints.which:
        joints.mode[i] = OPEN if of[BOUND, i] == 0.0 else AHEAD if of[BEFORE, i] > 0.0 else BACK


@non_allocating
def joint_losses(joints):  # type: ignore[no-untyped-def]
    """Energy that dry friction and limits took in a step, J: impulses times mean rates."""
    of, friction, limits = joints.of, 0.0, 0.0
    for i in joints.which:
        taken = -0.5 * of[IMPULSE, i] * (of[BEFORE, i] + of[AFTER, i])
        if joints.mode[i] >= UPPER:
            limits += taken
        elif joints.mode[i] != OPEN:
            friction += taken
    return friction, limits


@non_allocating
def bend_clearance(chain, q, w, angle, rate):  # type: ignore[no-untyped-def]
    """Smallest gap of a joint to its limit, rad, now and ``SOON`` later; infinite where no joint has limits.

    `q`, `w` (n or more,) are angles, rad, and rates, rad/s, of the links, `angle` and `rate` those of the parent of the
    first one.
    """
    least = left = math.inf
    for i in range(chain.length.size):
        if chain.max_bend[i] < math.inf:
            gap, opening = limit_gap(chain, i, q[i] - angle, w[i] - rate)
            least, left = min(least, gap), min(left, gap + SOON * min(opening, 0.0))
        angle, rate = q[i], w[i]
    return least, left


@non_allocating
def implicitness(motion, i, h):  # type: ignore[no-untyped-def]
    """Part of the change of its rate with which friction at joint i acts in a step: one half, of second order.

    More where links turn against each other by friction alone within the step: so much that this dies out.
    """
    fastest = 2.0 * h * motion.damping[i]
    return 0.5 if fastest <= 2.0 else 1.0 - 1.0 / fastest


@non_allocating
def friction_impulse(chain, motion, trend, steady, base, h, i):  # type: ignore[no-untyped-def]
    """Angular impulse of viscous friction at joint i, N m s, less its slope times the change of the rate; that slope.

    What is more than one half of the change acts on its difference from h times the accelerations before, ``trend``,
    where modes were `steady`, 1.0, and from nothing else, 0.0.
    """
    theta = implicitness(motion, i, h)
    rate = relative(motion.w, i, base[0, 3])
    predicted = steady * h * relative(trend[0], i, base[0, 2])
    slope, _ = joint_law.jacobian(joint_of(chain, i), 1.0, theta * h, 0.0)
    return h * joint_law.friction(joint_of(chain, i), rate - (theta - 0.5) * predicted, 0.0), slope


@non_allocating
def joint_impulses(chain, motion, trend, steady, base, h, torque):  # type: ignore[no-untyped-def]
    """Angular impulses of the joints, to ``motion.joint``: implicit friction, springs at the mean of the angles.

    `trend`, `steady` as in ``friction_impulse``; `base` (3, 9).
    """
    joint, q = motion.joint, motion.q
    for i in range(q.size):
        angle = relative(q, i, base[1, 4])
        law = joint_of(chain, i)
        impulse, slope = friction_impulse(chain, motion, trend, steady, base, h, i)
        stiff, _ = joint_law.jacobian(law, 1.0, 0.0, 0.25 * h * h)
        joint[i, 0], joint[i, 1] = impulse + h * joint_law.spring(law, angle), slope + stiff
    joint[0, 0] += h * torque


# Numbers of the contact solver: the proximal mass M, the searches for modes, and what a solution may leave.
#
# masses of the whole rope, M of the first search
STIFF = 1e3
# factor on an M for which no modes are found, where none were found before
SOFTER = 0.01
# most that M grows from one search to the next
MOST_GROWTH = 10.0
# masses of the whole rope, the largest M
STIFFEST = 1e6
# each search starts from the last that found modes
SEARCHES = 24
# part of a residual below which the next one at the same M must fall; else larger M are tried
STALE = 0.7
# growth of M; where no modes are found for less, the search ends
LEAST_GROWTH = 1.4
# m/s, at which an open contact closes
CLOSING = 1e-9
# m/s, below which a contact that closes sticks at first
SLOW = 1e-6
# of a search; a longer one goes in a circle more often than not, also where many joints have dry friction
ROUNDS = 24
# rounds in a row with no fewer violations than before, after which a search of a coarse run ends.
# Until then it changes the modes of every second contact alone, in turn: changed at once,
# neighbours go to and fro together. At the usual tolerance this gained 5 %, and energy rose by 0.2 mJ in two of
# 500 throws
STALLED = 4
# relative change of the rates at which the centrifugal terms have settled, in steps of `usual_step` and longer
SETTLED = 2e-5
# s; shorter steps leave less, so that the energy that is left does not grow per second
USUAL_STEP = 1e-4
# largest factor on what a solution may leave, for a tolerance above `usual_tol`
LOOSEST = 100.0
# rounds in which the centrifugal terms settle where no modes are found
SETTLING = 4
# times that a solution with a slight residual starts the search anew
AGAIN = 8
# m/s, residual velocity of a solution at the usual tolerance
SLIGHT_SPEED = 1e-5
# growth of M from one step to the next, after one that took a softer one
RECOVERING = 1.3
# s, an impact may give as much energy as a step of this length
INSTANT = 1e-6
USUAL_TOL = 1e-5  # m, tolerance of positions to which the numbers of steps in contact belong

NONE, ALL, EVEN = range(3)  # contacts whose modes a round changes; EVEN + 1 are the odd ones


@non_allocating
def write_modes(contacts, impulses, motion, joints, penalty):  # type: ignore[no-untyped-def]
    """Write contacts and joints, in their modes, to ``motion.touch`` and ``motion.joint``; `penalty` is M, kg."""
    write_joints(motion, joints, penalty)
    for c in range(contacts.total[0]):
        if impulses.mode[c] == OPEN:
            continue
        i, speed, turned = contacts.link[c], motion.speed, motion.turned
        vx, vy = speed[0, i] + turned[0, i], speed[1, i] + turned[1, i]
        vn, vt = resolved(contacts, motion, c, vx, vy, motion.w[i])
        pn = impulses.start[0, c] - penalty * (vn + impulses.target[c])
        pt = impulses.start[1, c] - penalty * (vt + impulses.tangent_target[c])
        add_contact_impulse(contacts, impulses, motion, c, penalty, pn, pt)


@non_allocating
def update_modes(contacts, impulses, motion, joints, spin, penalty, change):  # type: ignore[no-untyped-def]
    """Read velocities and impulses off the changes of the rates; change the modes that break the law.

    What slips sticks again where P0 - M v is back inside the cone, by the same measure by which what sticks leaves it:
    a criterion of velocity would let neither mode hold for a P0 outside the cone. `change` selects the
    contacts: NONE, ALL, EVEN or EVEN + 1. Returns how many broke it.
    """
    violations = update_joint_modes(motion, joints, penalty, change != NONE)
    for c in range(contacts.total[0]):
        vn, vt = velocity(contacts, motion, c)
        vt -= spin.reach[contacts.peg[c]] * spin.after[contacts.peg[c]]
        impulses.vn[c], impulses.vt[c] = vn, vt
        vt += impulses.tangent_target[c]
        pn = impulses.start[0, c] - penalty * (vn + impulses.target[c])
        pt = impulses.start[1, c] - penalty * vt
        mode, mu = impulses.mode[c], contacts.mu[c]
        new_mode = mode
        if mode == OPEN:
            impulses.normal[c] = impulses.tangent[c] = 0.0
            if vn + impulses.target[c] < -CLOSING:
                new_mode = AHEAD if vt >= 0.0 else BACK
                if mu > 0.0 and (abs(vt) <= SLOW or impulses.closed[c] % 2 == 1):
                    new_mode = STICK
        else:
            impulses.normal[c] = pn
            bound = mu * max(pn, 0.0)
            if mode == STICK:
                impulses.tangent[c] = pt
                if abs(pt) > bound:
                    new_mode = AHEAD if pt < 0.0 else BACK
            else:
                sense = 1.0 if mode == AHEAD else -1.0
                impulses.tangent[c] = -sense * bound
                if pn < 0.0:
                    new_mode = OPEN
                elif mu > 0.0 and -sense * pt < bound:
                    new_mode = STICK
        if new_mode != mode:
            if change == ALL or change == EVEN + c % 2:
                impulses.mode[c] = new_mode
                impulses.closed[c] += int(mode == OPEN)
            violations += 1
    return violations


@non_allocating
def linearize(chain, motion, h):  # type: ignore[no-untyped-def]
    """Linearize the motion of the links in a step about the present changes of the rates, to ``motion.frame``.

    With the angles before and after, q and q', the joints' velocities change by l (n' w' - n w) a link, and forces act
    along the mean velocity, l (n w + n' w') / 2: so what they do is the change of the energy, exactly.
    """
    n = motion.w.size
    mean, trig, frame, turned = motion.mean, motion.mean_trig, motion.frame, motion.turned
    for i in range(n):
        mean[i] = motion.q[i] + 0.25 * h * motion.change[i]
        motion.last[i] = motion.change[i]
    sines(mean, trig, 0)
    x, y = h * chain.gx, h * chain.gy
    for i in range(n):
        change = motion.change[i]
        rate = motion.w[i] + 0.5 * change
        cos, sinc = half_turn(0.5 * h * rate)
        sin = 0.5 * h * rate * sinc
        nx, ny, dx, dy = trig[n + i], trig[i], trig[i], -trig[n + i]
        tilt, ahead = 0.25 * h * change * sinc, 0.5 * h * (rate + 0.5 * change)
        across, along = cos - ahead * sin, -(sin + ahead * cos)
        row = frame[i]
        row[TX], row[TY] = cos * nx - tilt * dx, cos * ny - tilt * dy
        row[VX], row[VY] = across * nx + along * dx, across * ny + along * dy
        vx = change * cos * nx - 2.0 * rate * sin * dx
        vy = change * cos * ny - 2.0 * rate * sin * dy
        row[KX], row[KY] = vx - change * row[VX], vy - change * row[VY]
        pull_x, pull_y = (sinc - cos) * nx + tilt * dx, (sinc - cos) * ny + tilt * dy
        row[SLOPE] = max(-0.5 * h * (dx * motion.pull[0, i] + dy * motion.pull[1, i]), -0.5 * chain.inertia[i])
        row[TURN] = change * row[SLOPE] + h * motion.weight[i] * (chain.gx * pull_x + chain.gy * pull_y)
        turned[0, i], turned[1, i] = x, y
        x += chain.length[i] * (change * motion.trig[n + i] - vx)
        y += chain.length[i] * (change * motion.trig[i] - vy)


@inlined
def half_turn(x):  # type: ignore[no-untyped-def]
    """Cosine of x, and sine of x over x; to 3e-13 for x up to 0.25, rad, and to rounding up to 0.1."""
    z = x * x
    cos = 1.0 - z / 2.0 * (1.0 - z / 12.0 * (1.0 - z / 30.0 * (1.0 - z / 56.0)))
    sinc = 1.0 - z / 6.0 * (1.0 - z / 20.0 * (1.0 - z / 42.0 * (1.0 - z / 72.0)))
    return cos, sinc


@non_allocating
def moved(motion):  # type: ignore[no-untyped-def]
    """How far the changes of the rates are from those about which they were linear, relative to the greatest rate."""
    far = largest = 0.0
    for i in range(motion.w.size):
        far = max(far, abs(motion.change[i] - motion.last[i]))
        largest = max(largest, abs(motion.w[i]))
    return far / (1.0 + largest)


@absorbed
def solve_round(chain, contacts, impulses, motion, joints, spin, penalty, change):  # type: ignore[no-untyped-def]
    """Solve for the changes of the rates with the present modes; then as ``update_modes``, whose answer it returns."""
    write_modes(contacts, impulses, motion, joints, penalty)
    fx, fy, moment = changes(
        chain,
        motion.joint,
        motion.frame,
        motion.touch,
        motion.base,
        motion.tip,
        motion.change,
        motion.place,
        motion.pull,
        motion.work,
    )
    motion.load[0], motion.load[1], motion.load[2] = fx, fy, moment
    if spin.which.size > 0:
        turn_pegs(chain, contacts, impulses, motion, joints, spin, penalty)
    clear(motion.touch, contacts.link, contacts.total[0])
    return update_modes(contacts, impulses, motion, joints, spin, penalty, change)


@non_allocating
def looseness(tol):  # type: ignore[no-untyped-def]
    """How many times as much as usual a solution may leave, where positions may err by `tol`, m."""
    return max(1.0, min(tol / USUAL_TOL, LOOSEST))


@absorbed
def search(chain, contacts, impulses, motion, joints, spin, h, penalty):  # type: ignore[no-untyped-def]
    """Find modes that obey the law for one M = `penalty`, kg; returns the rounds, negative if none are found."""
    settled = SETTLED * impulses.loose * max(0.1, min(1.0, h / USUAL_STEP))
    for c in range(contacts.total[0]):
        impulses.closed[c] = 0
    hasty = h > 0.0 and impulses.loose > 1.0
    fewest, stalled = contacts.total[0] + motion.w.size + 1, 0
    for turn in range(ROUNDS):
        if turn == 0 or h > 0.0:  # an impact is linear
            linearize(chain, motion, h)
        change = EVEN + turn % 2 if hasty and stalled > 0 else ALL
        violations = solve_round(chain, contacts, impulses, motion, joints, spin, penalty, change)
        if violations == 0 and (h == 0.0 or moved(motion) <= settled):
            return turn + 1
        if not (abs(motion.load[0]) + abs(motion.load[1]) < math.inf):
            motion.change[:] = 0.0
            motion.pull[:] = 0.0
            return -(turn + 1)
        stalled = 0 if violations < fewest else stalled + 1
        if hasty and stalled == STALLED:
            return -(turn + 1)
        fewest = violations if violations > 0 else fewest
    return -ROUNDS


@non_allocating
def store(impulses, joints):  # type: ignore[no-untyped-def]
    """Remember where the proximal method starts from, and the modes; `joints` are the Joints."""
    assign(joints.good_mode, joints.mode)
    assign(joints.of[GOOD], joints.of[START])
    assign(impulses.good_mode, impulses.mode)
    assign_rows(impulses.good, impulses.start)


@non_allocating
def restore(impulses, joints):  # type: ignore[no-untyped-def]
    """Go back to what was stored last."""
    assign(joints.mode, joints.good_mode)
    assign(joints.of[START], joints.of[GOOD])
    assign(impulses.mode, impulses.good_mode)
    assign_rows(impulses.start, impulses.good)


@non_allocating
def update_multipliers(contacts, impulses, joints, penalty):  # type: ignore[no-untyped-def]
    """Store a solution for M = `penalty`, kg, and let the next one start from it.

    Returns its residual, m/s, the energy that the residual stands for, J, and the M for the next search, kg. M grows by
    ``MOST_GROWTH``, or by less where the residual is large: M times the residual is then the mean of the contacts'
    impulses, weighted by themselves. A larger M would make the next round open most contacts.
    """
    store(impulses, joints)
    worst, given = update_joint_multipliers(joints, penalty)
    squares = borne = 0.0
    for c in range(contacts.total[0]):
        pn, pt = impulses.normal[c], impulses.tangent[c]
        if impulses.mode[c] != OPEN:
            squares, borne = squares + pn * pn, borne + abs(pn)
            left = abs(pn - impulses.start[0, c]) / penalty
            worst, given = max(worst, left), given + left * abs(pn)
        if impulses.mode[c] == STICK:
            left = abs(pt - impulses.start[1, c]) / penalty
            worst, given = max(worst, left), given + left * abs(pt)
        elif impulses.mode[c] != OPEN and contacts.mu[c] > 0.0:
            sense = 1.0 if impulses.mode[c] == AHEAD else -1.0
            left = max(0.0, -sense * (impulses.vt[c] + impulses.tangent_target[c]))
            worst, given = max(worst, left), given + left * abs(pt)
        impulses.start[0, c], impulses.start[1, c] = pn, pt
    if borne * MOST_GROWTH * penalty * worst <= squares:
        return worst, given, MOST_GROWTH * penalty
    return worst, given, max(penalty, squares / (borne * worst))


@absorbed
def solve(chain, contacts, impulses, motion, joints, spin, h, whole):  # type: ignore[no-untyped-def]
    """Find modes, impulses and changes of the rates that obey the law; each round is one O(n) sweep.

    Where no modes are found for the stiff M, the search begins anew with a softer one, for which they are found nearly
    always. Each solution starts the next search, for the M that :func:`update_multipliers` returns, until the residual
    (P - P0) / M is slight. Where a larger M fails, the last one is tried again, from the P0 that it had. Unless its
    residual falls, M grows by ``MOST_GROWTH`` from then on, and by the square root of that where a search fails. The
    last solution found is the result: its impulses obey Coulomb's law, its velocities obey it up to the residual. The
    next step starts with a slightly larger M.

    Parameters
    ----------
    chain, contacts, impulses, motion, joints, spin : Chain, Contacts, Impulses, Motion, Joints, Spin
    h : float, step, s
    whole : float, mass of the rope, kg

    Returns
    -------
    int : rounds, negative if the law is not obeyed to within SLIGHT_SPEED, or more where `impulses` are loose.
    """
    store(impulses, joints)
    penalty = impulses.penalty[0] if impulses.penalty[0] > 0.0 else STIFF * whole
    last, residual, given = 0.0, math.inf, math.inf
    slight, most = SLIGHT_SPEED * impulses.loose, STIFFEST * whole
    total, again, rounds, climbs = 0, AGAIN, 0, False
    for _ in range(SEARCHES):
        rounds = search(chain, contacts, impulses, motion, joints, spin, h, penalty)
        total += abs(rounds)
        if rounds < 0:
            restore(impulses, joints)
            if last == 0.0:
                penalty *= SOFTER
            elif climbs and penalty < LEAST_GROWTH * last:
                break
            elif climbs:
                penalty = math.sqrt(penalty * last)
            elif penalty > last:
                penalty = most = last
            else:  # none are found any more where some were
                penalty, climbs = math.sqrt(MOST_GROWTH) * last, True
            continue
        before, last = residual, penalty
        residual, given, stiffer = update_multipliers(contacts, impulses, joints, penalty)
        if residual <= slight:
            again -= 1
            if given <= impulses.residual_power * max(h, INSTANT) or again < 0:
                break
            penalty = max(penalty, min(stiffer, STIFF * whole, most))
            continue
        climbs = climbs or (penalty >= most and residual > STALE * before)
        penalty = min(MOST_GROWTH * penalty, STIFFEST * whole) if climbs else min(stiffer, most)
    if rounds < 0:
        restore(impulses, joints)
        if last == 0.0:  # nothing was found at all: let go
            release_joints(joints)
            for c in range(contacts.total[0]):
                impulses.mode[c] = OPEN
        motion.change[:] = 0.0
        for _ in range(SETTLING):
            linearize(chain, motion, h)
            solve_round(chain, contacts, impulses, motion, joints, spin, last if last > 0.0 else penalty, NONE)
    impulses.penalty[0] = min(RECOVERING * last, STIFF * whole)
    return total if residual <= slight else -total
