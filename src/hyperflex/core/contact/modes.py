"""Contact solver: an active-set search for open, stick and slip with proximal impulses.

A wrapped rope that sticks is hyperstatic: many impulses give the same motion. The proximal method (an augmented
Lagrangian) takes those nearest to the last step's, P = P0 - M v with a mass M far above the rope's, and projects them
on the cone. Its residual velocity is (P - P0) / M and dies out where the load is steady, so what sticks does not creep.
"""

import math

from hyperflex.core.contact.arrays import AHEAD, BACK, GOOD, OPEN, START, STICK
from hyperflex.core.contact.joints import release_joints, update_joint_modes, update_joint_multipliers, write_joints
from hyperflex.core.contact.point import add_contact_impulse, velocity
from hyperflex.core.contact.sweep import changes, clear
from hyperflex.core.contact.turning_pegs import turn_pegs
from hyperflex.core.jit import lean

STIFF = 1e3  # M in masses of the whole rope
SOFTER, GROW, STIFFEST = 0.1, 10.0, 1e6  # where that is too stiff to find modes, and where too soft for small residuals
TRIES = 16  # searches, of which each starts from the last that found modes
LEAST = 1.4  # growth of M; where none is found for less, the search ends
CLOSING = 1e-9  # m/s, at which an open contact closes
SLOW = 1e-6  # m/s, below which a contact that closes sticks at first
ROUNDS = 12  # of one search, and one more a joint; one that takes longer goes in a circle more often than not
SETTLED = 1e-10  # relative change of the rates at which the centrifugal terms have settled, in steps of USUAL and more
USUAL = 1e-4  # s; in shorter ones less, so that what is left is no more energy a second
SETTLING = 4  # rounds in which they settle anew
AGAIN = 4  # times that a solution with a slight residual starts the search anew
SLIGHT = 1e-5  # m/s, residual velocity of a solution
RECOVERING = 1.3  # growth of M from one step to the next, after one that took a softer one
INSTANT = 1e-6  # s, an impact may give as much as a step of this length


@lean
def write_modes(found, impulses, motion, held, heavy):  # type: ignore[no-untyped-def]
    """Write contacts and joints, in their present modes, to ``motion.touch`` and ``motion.joint``; `heavy` is M, kg."""
    n = motion.w.size
    write_joints(motion, held, heavy)
    for c in range(found.total[0]):
        if impulses.mode[c] == OPEN:
            continue
        i, s = found.link[c], found.place[c]
        nx, ny = found.nx[c], found.ny[c]
        vx = motion.speed[0, i] + motion.turned[0, i] + s * motion.trig[n + i] * motion.w[i]
        vy = motion.speed[1, i] + motion.turned[1, i] + s * motion.trig[i] * motion.w[i]
        pn = impulses.normal0[c] - heavy * (vx * nx + vy * ny + impulses.target[c])
        pt = impulses.tangent0[c] - heavy * (vy * nx - vx * ny + impulses.lean[c])
        add_contact_impulse(found, impulses, motion, c, heavy, pn, pt)


@lean
def update_modes(found, impulses, motion, held, spin, heavy, change):  # type: ignore[no-untyped-def]
    """Read velocities and impulses off the changes of the rates; with `change`, change the modes that break the law.

    What slips sticks again where P0 - M v is back inside the cone, by the same measure by which what sticks leaves it:
    were it asked whether the velocity turns, P0 outside the cone would let neither hold. Returns how many broke it.
    """
    broke = update_joint_modes(motion, held, heavy, change)
    for c in range(found.total[0]):
        vn, vt = velocity(found, motion, c)
        vt -= spin.reach[found.peg[c]] * spin.after[found.peg[c]]
        impulses.vn[c], impulses.vt[c] = vn, vt
        vt += impulses.lean[c]
        pn = impulses.normal0[c] - heavy * (vn + impulses.target[c])
        pt = impulses.tangent0[c] - heavy * vt
        mode, mu = impulses.mode[c], found.mu[c]
        wanted = mode
        if mode == OPEN:
            impulses.normal[c] = impulses.tangent[c] = 0.0
            if vn + impulses.target[c] < -CLOSING:
                wanted = AHEAD if vt >= 0.0 else BACK
                if mu > 0.0 and (abs(vt) <= SLOW or impulses.closed[c] % 2 == 1):
                    wanted = STICK
        else:
            impulses.normal[c] = pn
            bound = mu * max(pn, 0.0)
            if mode == STICK:
                impulses.tangent[c] = pt
                if abs(pt) > bound:
                    wanted = AHEAD if pt < 0.0 else BACK
            else:
                sense = 1.0 if mode == AHEAD else -1.0
                impulses.tangent[c] = -sense * bound
                if pn < 0.0:
                    wanted = OPEN
                elif mu > 0.0 and -sense * pt < bound:
                    wanted = STICK
        if wanted != mode:
            if change:
                impulses.mode[c] = wanted
                impulses.closed[c] += int(mode == OPEN)
            broke += 1
    return broke


@lean
def centrifugal(chain, motion, h, gx, gy):  # type: ignore[no-untyped-def]
    """Centrifugal terms at the mean of the rates before and after, and what ``motion.turned`` makes up for.

    Returns the greatest change of a rate that this may make, relative to the greatest rate.
    """
    n = motion.w.size
    moved = largest = 0.0
    for i in range(n):
        mean = motion.w[i] + 0.5 * motion.change[i]
        rho = h * mean * mean
        moved = max(moved, abs(rho - motion.rho[i]))
        largest = max(largest, abs(mean))
        motion.rho[i] = rho
    x, y = h * gx, h * gy
    for i in range(n):
        motion.turned[0, i], motion.turned[1, i] = x, y
        x += chain.length[i] * motion.trig[i] * motion.rho[i]
        y -= chain.length[i] * motion.trig[n + i] * motion.rho[i]
    return moved / (1.0 + largest)


@lean
def solve_round(chain, found, impulses, motion, held, spin, heavy, change):  # type: ignore[no-untyped-def]
    """Solve for the changes of the rates with the present modes; then as ``update_modes``, whose answer it returns."""
    write_modes(found, impulses, motion, held, heavy)
    fx, fy, moment = changes(
        chain,
        motion.trig,
        motion.joint,
        motion.rho,
        motion.touch,
        motion.base,
        motion.tip,
        motion.change,
        motion.place,
        motion.work,
    )
    motion.load[0], motion.load[1], motion.load[2] = fx, fy, moment
    if spin.which.size > 0:
        turn_pegs(chain, found, impulses, motion, held, spin, heavy)
    clear(motion.touch, found.link, found.total[0])
    return update_modes(found, impulses, motion, held, spin, heavy, change)


@lean
def search(chain, found, impulses, motion, held, spin, h, heavy):  # type: ignore[no-untyped-def]
    """Find modes that obey the law for one M = `heavy`, kg; returns the rounds, negative if there are too many."""
    settled = SETTLED * max(0.1, min(1.0, h / USUAL))
    for c in range(found.total[0]):
        impulses.closed[c] = 0
    most = ROUNDS + held.which.size
    for turn in range(most):
        moved = centrifugal(chain, motion, h, chain.gx, chain.gy)
        broke = solve_round(chain, found, impulses, motion, held, spin, heavy, True)
        if broke == 0 and moved <= settled:
            return turn + 1
        if not (abs(motion.load[0]) + abs(motion.load[1]) < math.inf):
            motion.change[:] = 0.0
            return -(turn + 1)
    return -most


@lean
def store(found, impulses, held):  # type: ignore[no-untyped-def]
    """Remember where the proximal method starts from, and the modes; `held` are the Joints."""
    for i in held.which:
        held.good_mode[i], held.of[GOOD, i] = held.mode[i], held.of[START, i]
    for c in range(found.total[0]):
        impulses.good_mode[c] = impulses.mode[c]
        impulses.good_normal[c], impulses.good_tangent[c] = impulses.normal0[c], impulses.tangent0[c]


@lean
def restore(found, impulses, held):  # type: ignore[no-untyped-def]
    """Go back to what was stored last."""
    for i in held.which:
        held.mode[i], held.of[START, i] = held.good_mode[i], held.of[GOOD, i]
    for c in range(found.total[0]):
        impulses.mode[c] = impulses.good_mode[c]
        impulses.normal0[c], impulses.tangent0[c] = impulses.good_normal[c], impulses.good_tangent[c]


@lean
def update_multipliers(found, impulses, held, heavy):  # type: ignore[no-untyped-def]
    """Store a solution for M = `heavy`, kg, and let the next one start from it.

    Returns its residual, m/s, and the energy that the residual stands for, J.
    """
    store(found, impulses, held)
    worst, given = update_joint_multipliers(held, heavy)
    for c in range(found.total[0]):
        pn, pt = impulses.normal[c], impulses.tangent[c]
        if impulses.mode[c] != OPEN:
            left = abs(pn - impulses.normal0[c]) / heavy
            worst, given = max(worst, left), given + left * abs(pn)
        if impulses.mode[c] == STICK:
            left = abs(pt - impulses.tangent0[c]) / heavy
            worst, given = max(worst, left), given + left * abs(pt)
        elif impulses.mode[c] != OPEN and found.mu[c] > 0.0:
            sense = 1.0 if impulses.mode[c] == AHEAD else -1.0
            left = max(0.0, -sense * (impulses.vt[c] + impulses.lean[c]))
            worst, given = max(worst, left), given + left * abs(pt)
        impulses.normal0[c], impulses.tangent0[c] = pn, pt
    return worst, given


@lean
def solve(chain, found, impulses, motion, held, spin, h, whole):  # type: ignore[no-untyped-def]
    """Find modes, impulses and changes of the rates that obey the law; each round is one O(n) sweep.

    Where no modes are found for the stiff M, the search begins anew with a soft one, for which they are found nearly
    always, and each solution starts the search for a stiffer one, half as far on where that fails; so it goes until the
    residual (P - P0) / M is slight. The last solution that was found holds: its impulses obey Coulomb's law, its
    velocities up to the residual. The next step starts with the M that did, and a little more.

    Parameters
    ----------
    chain, found, impulses, motion, held, spin : Chain, Contacts, Impulses, Motion, Joints, Spin
    h : float, step, s
    whole : float, mass of the rope, kg

    Returns
    -------
    int : rounds, negative if the law is not obeyed to within SLIGHT.
    """
    store(found, impulses, held)
    heavy = impulses.heavy[0] if impulses.heavy[0] > 0.0 else STIFF * whole
    last, residual, given = 0.0, math.inf, math.inf
    total, again, rounds = 0, AGAIN, 0
    for _ in range(TRIES):
        rounds = search(chain, found, impulses, motion, held, spin, h, heavy)
        total += abs(rounds)
        if rounds < 0:
            restore(found, impulses, held)
            if last == 0.0:
                heavy = SOFTER * min(whole, heavy)
                continue
            if heavy < LEAST * last:
                break
            heavy = math.sqrt(heavy * last)
            continue
        (residual, given), last = update_multipliers(found, impulses, held, heavy), heavy
        if residual > SLIGHT:
            heavy = min(GROW * heavy, STIFFEST * whole)
            continue
        again -= 1
        if given <= impulses.gift * max(h, INSTANT) or again < 0:
            break
        heavy = max(heavy, min(GROW * heavy, STIFF * whole))
    if rounds < 0:
        restore(found, impulses, held)
        if last == 0.0:  # nothing was found at all: let go
            release_joints(held)
            for c in range(found.total[0]):
                impulses.mode[c] = OPEN
        motion.change[:] = 0.0
        for _ in range(SETTLING):
            centrifugal(chain, motion, h, chain.gx, chain.gy)
            solve_round(chain, found, impulses, motion, held, spin, last if last > 0.0 else heavy, False)
    impulses.heavy[0] = min(RECOVERING * last, STIFF * whole)
    return total if residual <= SLIGHT else -total
