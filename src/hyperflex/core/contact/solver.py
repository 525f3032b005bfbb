"""Contact solver: an active-set search finds which contacts are open, stick or slip, and which joints are at a limit.

With fixed modes rope, contacts and pegs that turn are one linear problem (``sweep``, ``spin``).

A wrapped rope that sticks is hyperstatic: many impulses give the same motion. The proximal method (an augmented
Lagrangian) takes those nearest to the last step's, P = P0 - M v with a mass M far above the rope's, and projects them
on the cone. Its residual velocity is (P - P0) / M and dies out where the load is steady, so what sticks does not creep.
"""

import math

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.contact.arrays import AHEAD, BACK, GOOD, OPEN, SEARCHED, START, STICK
from hyperflex.core.contact.joints import (
    obeys_friction,
    release_joints,
    update_joint_modes,
    update_joint_multipliers,
    write_joints,
)
from hyperflex.core.contact.spin import turn_pegs
from hyperflex.core.contact.sweep import add_contact_impulse, changes, clear, linearize, resolved, velocity
from hyperflex.core.jit import absorbed, non_allocating

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
# of a search; a longer one goes in a circle more often than not
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
    violations = update_joint_modes(motion, joints, penalty, change != NONE, impulses.loose)
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
                if mu > 0.0 and abs(vt) <= SLOW:
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
            violations += 1
    return violations


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
    """Remember where the next search starts from, and the modes; `joints` are the Joints."""
    assign(joints.good_mode, joints.mode)
    for k in range(SEARCHED):
        assign(joints.of[GOOD + k], joints.of[START + k])
    assign(impulses.good_mode, impulses.mode)
    assign_rows(impulses.good, impulses.start)


@non_allocating
def restore(impulses, joints):  # type: ignore[no-untyped-def]
    """Go back to what was stored last."""
    assign(joints.mode, joints.good_mode)
    for k in range(SEARCHED):
        assign(joints.of[START + k], joints.of[GOOD + k])
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
def settle(chain, contacts, impulses, motion, joints, spin, h, penalty):  # type: ignore[no-untyped-def]
    """Solve for the changes of the rates anew with the present modes, for one M = `penalty`, kg."""
    motion.change[:] = 0.0
    for _ in range(SETTLING):
        linearize(chain, motion, h)
        solve_round(chain, contacts, impulses, motion, joints, spin, penalty, NONE)


@absorbed
def climb(chain, contacts, impulses, motion, joints, spin, h, whole):  # type: ignore[no-untyped-def]
    """Search modes for larger and larger M; arguments as for :func:`solve`.

    Where none are found for the first M, softer ones are tried. Each solution starts the next search, for the M that
    :func:`update_multipliers` returns, until the residual (P - P0) / M is slight. Where a larger M fails, the last one
    is tried again, from the P0 that it had. Unless its residual falls, M grows by ``MOST_GROWTH`` from then on, and by
    the square root of that where a search fails.

    Returns
    -------
    total : int, rounds of all searches
    last, penalty : float, M of the last solution, kg, 0.0 if there is none, and the last M that was tried
    residual : float, that of this solution, m/s
    """
    penalty = impulses.penalty[0] if impulses.penalty[0] > 0.0 else STIFF * whole
    last, residual, given = 0.0, math.inf, math.inf
    slight, most = SLIGHT_SPEED * impulses.loose, STIFFEST * whole
    total, again, rounds, climbs = 0, AGAIN, 0, False
    for _ in range(SEARCHES):
        rounds = search(chain, contacts, impulses, motion, joints, spin, h, penalty)
        total += abs(rounds)
        if rounds < 0:
            restore(impulses, joints)
            if climbs and penalty < LEAST_GROWTH * last:
                break
            if last == 0.0:
                penalty *= SOFTER
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
        if last > 0.0:
            settle(chain, contacts, impulses, motion, joints, spin, h, last)
    return total, last, penalty, residual


@absorbed
def solve(chain, contacts, impulses, motion, joints, spin, h, whole):  # type: ignore[no-untyped-def]
    """Find modes, impulses and changes of the rates that obey the law; each round is one O(n) sweep.

    The last solution found is the result: its impulses obey Coulomb's law, its velocities obey it up to the residual.
    Where none is found at all, contacts and joints are let go. The next step starts with a slightly larger M.

    Parameters
    ----------
    chain, contacts, impulses, motion, joints, spin : Chain, Contacts, Impulses, Motion, Joints, Spin
    h : float, step, s
    whole : float, mass of the rope, kg

    Returns
    -------
    int : rounds, negative if the law is not obeyed to within SLIGHT_SPEED, or regularized friction not to within
        RUBBING, or more where `impulses` are loose.
    """
    store(impulses, joints)
    total, last, penalty, residual = climb(chain, contacts, impulses, motion, joints, spin, h, whole)
    solved = residual <= SLIGHT_SPEED * impulses.loose and obeys_friction(joints, impulses.loose)
    if last == 0.0:  # nothing was found at all: let go
        release_joints(joints)
        for c in range(contacts.total[0]):
            impulses.mode[c] = OPEN
        settle(chain, contacts, impulses, motion, joints, spin, h, penalty)
    impulses.penalty[0] = min(RECOVERING * last, STIFF * whole)
    return total if solved else -total
