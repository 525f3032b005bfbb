"""Pegs on an axle in a step in contact: their rates are computed together with those of the rope.

The tangential velocity of a contact is that of its point minus ``reach`` times the peg's rate, and its tangential
impulse acts on the peg with the same lever: contacts act on the rope's axis, so peg and rope exchange action and
reaction in one point. With fixed modes the rope's response is linear in the rates of the pegs. One more sweep for each
peg to which a link sticks, and one equation per peg, give all rates.
"""

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign
from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.contact.arrays import FRAME, OPEN, STICK
from hyperflex.core.contact.gaps import Index
from hyperflex.core.contact.sweep import KX, TX, add_contact_impulse, changes, clear, friction_ratio, resolved, velocity
from hyperflex.core.jit import kernel, non_allocating, zeros


class Spin(NamedTuple):
    """Turning pegs, k of m, and the response of n links to each."""

    which: Index  # (k,) turning pegs
    row: Index  # (m,) index of each in `which`; -1 if it is fixed
    reach: Array  # (m,) m, lever of the rope's axis about the axle
    inertia: Array  # (m,) kg m^2
    bearing: Array  # (m,) N m s, viscous friction of the axle
    before: Array  # (m,) rad/s, rates before the step; 0 of fixed ones
    after: Array  # (m,) rad/s, rates after the step
    stay: Array  # (m,) fraction of its rate that a free peg keeps in the step
    penalty: Array  # (m,) kg m^2, angular impulse over the resulting change of the rate
    system: Array  # (k, k + 1) equations of the rates after the step
    change: Array  # (k, n) responses to a rate of 1 rad/s: of the links' rates
    place: Array  # (k, 2, n) of the joints' velocities
    pull: Array  # (2, n)
    load: Array  # (k, 3) of the impulse at the first joint
    joint: Array  # (n, 2) angular impulse of each joint in these responses: 0, and its slope
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
    """Fraction of its rate that a free peg keeps in h s, and angular impulse over change of rate, kg m^2 (exact)."""
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
    """Find the rope's response to a rate of 1 rad/s of turning peg k alone, in these modes; `penalty` is M, kg."""
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

    ``motion`` contains the rope's response to pegs at rest.
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
    """Find the pegs' rates after the step with the present modes, and add their effect on the rope.

    ``motion`` contains the rope's response to pegs at rest; ``motion.touch`` is overwritten.
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
    """Energy that the axles absorb in the step, J: their angular impulse times the mean rate."""
    taken = 0.0
    for p in spin.which:
        penalty, inertia, before, after = spin.penalty[p], spin.inertia[p], spin.before[p], spin.after[p]
        impulse = (penalty - inertia) * after + (inertia - penalty * spin.stay[p]) * before
        taken += impulse * 0.5 * (before + after)
    return taken
