"""One contact step of the Moreau-Jean scheme: angles at its middle, rates at its ends; air drag (M.34); energies."""

from typing import Final, NamedTuple

import numpy as np

from hyperflex.core.chain.air import air_loads
from hyperflex.core.chain.articulated_body import Array, energies, relative, sines
from hyperflex.core.chain.drive import base_state
from hyperflex.core.contact.arrays import (
    OPEN,
    STEADY,
    UNHELD,
    Impulses,
    Joints,
    Motion,
    new_impulses,
    new_joints,
    new_motion,
    trend_factor,
    warm_start,
)
from hyperflex.core.contact.gaps import NOWHERE, Contacts, find, joint_positions, nearest, new_contacts, speeds
from hyperflex.core.contact.joints import (
    JOINTS,
    bend_clearance,
    bound_joint_rates,
    friction_impulse,
    joint_impulses,
    joint_losses,
)
from hyperflex.core.contact.modes import looseness, solve
from hyperflex.core.contact.sweep import TX, TY, resolved
from hyperflex.core.contact.turning_pegs import Spin, lost_in_bearings, new_spin, prepare_spin
from hyperflex.core.jit import absorbed, kernel, non_allocating, zeros


class Air(NamedTuple):
    """Working arrays, and what the air does in a step."""

    work: Array  # (6 n,) torque on each link first, N m
    rate: Array  # (n,) rad/s, in the middle of the step
    total: Array  # (3,) force x, y on the rope, N, and all torques together, N m


@kernel
def new_air(n):  # type: ignore[no-untyped-def]
    """Working arrays for n links."""
    return Air(*zeros(6 * n, n, 3))


@non_allocating
def add_drag_impulses(chain, air, motion, base, h):  # type: ignore[no-untyped-def]
    """Add the impulses of air drag in a step h to those of the joints in `motion`; `base` (9,) in its middle.

    A torque on link i alone equals torques of all joints up to i, each on its link and back on its parent. What
    the first joint bears so, :func:`drag_work` subtracts from the load on the base.
    """
    n = motion.w.size
    for i in range(n):
        air.rate[i] = motion.w[i] + 0.5 * motion.change[i]  # as the accelerations of the last step predict
        air.work[4 * n + i], air.work[5 * n + i] = motion.trig[i], motion.trig[n + i]
    air.total[0], air.total[1], _ = air_loads(chain, air.rate, base, air.work, 0, 1)
    air.total[2] = 0.0
    for way in range(n):
        i = n - 1 - way
        air.total[2] += air.work[i]
        motion.joint[i, 0] += h * air.total[2]


@non_allocating
def drag_work(air, motion, rates, before, after, h):  # type: ignore[no-untyped-def]
    """Subtract the drag from the impulses at the first joint; returns the energy lost to drag in the step, J.

    `rates` (n,) are those after the step; `before`, `after` (9,) the motion of the first joint.
    """
    given = 0.5 * (air.total[0] * (before[5] + after[5]) + air.total[1] * (before[6] + after[6]))
    for k in range(3):
        motion.load[k] -= h * air.total[k]
    for i in range(rates.size):
        given += 0.5 * air.work[i] * (motion.w[i] + rates[i])
    return -h * given


# of ContactWorkspace.account, J: lost in joints, air, axles; in contacts, limits; put in
FRICTION, CONTACT, WORK = range(3)


@non_allocating
def mean_velocities(chain, motion, base, out):  # type: ignore[no-untyped-def]
    """Mean velocities of the joints in a step, m/s, to ``out`` (2, n + 1), along which forces acted; `base` (3, 9)."""
    n = motion.w.size
    out[0, 0], out[1, 0] = 0.5 * (base[0, 5] + base[2, 5]), 0.5 * (base[0, 6] + base[2, 6])
    for i in range(n):
        way = chain.length[i] * (motion.w[i] + 0.5 * motion.change[i])
        out[0, i + 1] = out[0, i] + way * motion.frame[i, TX]
        out[1, i + 1] = out[1, i] + way * motion.frame[i, TY]


@non_allocating
def account_step(chain, workspace, torque, whole, h):  # type: ignore[no-untyped-def]
    """Energy that joints, air, axles and contacts took in a step, and work put in: impulses times mean velocities."""
    motion, base, spin = workspace.motion, workspace.base, workspace.spin
    contacts, impulses, mean = workspace.contacts, workspace.impulses, workspace.ahead_speed
    n = motion.w.size
    mean_velocities(chain, motion, base, mean)
    taken, steady = 0.0, workspace.pace[STEADY]
    for i in range(n):
        change = relative(motion.change, i, motion.base[2])
        rate = relative(motion.w, i, base[0, 3]) + 0.5 * change
        impulse, slope = friction_impulse(chain, motion, workspace.trend, steady, base, h, i)
        taken -= (impulse - slope * change) * rate
    taken += drag_work(workspace.air, motion, workspace.out[n:], base[0], base[2], h)
    rubbed, limited = joint_losses(workspace.joints)
    workspace.account[FRICTION] = taken + rubbed + lost_in_bearings(spin)
    taken = limited
    for c in range(contacts.total[0]):
        if impulses.mode[c] == OPEN:
            continue
        i, p = contacts.link[c], contacts.peg[c]
        vn, vt = resolved(contacts, motion, c, mean[0, i], mean[1, i], motion.w[i] + 0.5 * motion.change[i])
        vt -= 0.5 * spin.reach[p] * (spin.before[p] + spin.after[p])
        taken -= impulses.normal[c] * vn + impulses.tangent[c] * vt
    workspace.account[CONTACT] = taken
    work = 0.5 * (motion.load[0] * (base[0, 5] + base[2, 5]) + motion.load[1] * (base[0, 6] + base[2, 6]))
    work += 0.5 * motion.load[2] * (base[0, 3] + base[2, 3])
    work += 0.5 * h * torque * (motion.w[0] + workspace.out[n])
    for k, g in ((0, chain.gx), (1, chain.gy)):
        fallen = 0.5 * h * (base[0, 5 + k] + base[2, 5 + k]) - (base[2, 7 + k] - base[0, 7 + k])
        work += whole * g * fallen + motion.tip[k] * mean[k, n]
    workspace.account[WORK] = work


@non_allocating
def energy(chain, y, base, trig):  # type: ignore[no-untyped-def]
    """Kinetic and potential energy of angles and rates y (2 n or more,), J; `base` (9,) motion of the first joint.

    `trig` is scratch, as in ``energies``.
    """
    n = chain.length.size
    kinetic, potential = energies(chain, y[:n], y[n : 2 * n], base, trig)
    return kinetic + potential


class Approach(NamedTuple):
    """Numbers that decide which links touch in a step, and how a rope is pushed out of a peg."""

    # m/s, speed above which a link touches in an impact of its own, and
    fast: float = 0.01
    # m/s^2, the same in proportion to the longest step
    fall: float = 50.0
    # m, gap that counts as touching in an impact
    touch: float = 1e-6
    # m/s, largest speed at which a rope is pushed out of a peg
    recovery: float = 1e-3
    # W, largest power with which it is pushed out
    push: float = 5e-7
    # m, depth that stays as it is: neighbours pushed at speeds of their own let contacts change modes in every
    # step, for which half of all rounds were made
    shallow: float = 2e-6
    # m, depth from which the speed is `recovery`; from `shallow` to here it is proportional and its power is limited
    deep: float = 2e-5
    # N, added to the contact force by which `push` is divided
    slight_force: float = 1e-6
    # part of the power allowed from nowhere that the residual velocities of contacts may have
    residual_share: float = 0.25
    # m, gap below which a link is watched even at rest
    near: float = 1e-4
    # m, by which a gap may change more than its rate predicts
    bend: float = 2e-5
    # how many times faster than before a step links may be after it
    faster: float = 2.0


APPROACH: Final = Approach()


class ContactWorkspace(NamedTuple):
    """Working arrays of the stepper for a chain of n links."""

    contacts: Contacts
    impulses: Impulses
    motion: Motion
    joints: Joints
    spin: Spin
    xy: Array  # (2, n + 1) joints there
    ahead: Array  # (2, n + 1) and where they would be a step later
    ahead_q: Array
    ahead_trig: Array
    ahead_speed: Array  # (2, n + 1)
    margin: Array  # (n,)
    trend: Array  # (2, n) rad/s^2, accelerations of the last step, where the next one begins to search, and before it
    pace: Array  # (3,) s, lengths of these steps, 0.0 where there was none; 1.0 where the last one changed no mode
    out: Array  # (2 n,) angles and rates after the step
    base: Array  # (3, 9) motion of the first joint before, in the middle and after
    air: Air
    account: Array  # (3,) of ``account_step``
    touch: Array  # (1,) s, from the beginning of the step until a link that is left free touches, or a joint its limit
    bend: Array  # (2,) rad, smallest gap of a joint to its limit after the step, and the smallest gap soon after
    fast: float  # m/s; a link that closes faster meets the peg in an impact of its own, at the instant of touching
    brisk: float  # rad/s; likewise a joint its limit


@kernel
def new_contact_workspace(chain, pegs, rate, longest, tol):  # type: ignore[no-untyped-def]
    """Working arrays for a chain, the Pegs `pegs`, and `rate`, `longest` step and `tol` as in ``run.Bounds``."""
    n = chain.length.size
    most = n * pegs.reach.size
    links = zeros((2, n + 1), (2, n + 1), n, 2 * n, (2, n + 1), n, (2, n), 3, 2 * n, (3, 9))
    return ContactWorkspace(  # type: ignore[call-arg]
        new_contacts(most),
        new_impulses(most, APPROACH.residual_share * rate, looseness(tol)),
        new_motion(chain),
        new_joints(chain),
        new_spin(n, pegs),
        *links,
        new_air(n),
        *zeros(3, 1, 2),
        max(APPROACH.fast, APPROACH.fall * longest),
        JOINTS.beyond / longest,
    )


@non_allocating
def velocity_before(contacts, motion, c):  # type: ignore[no-untyped-def]
    """Velocity of the point of contact c before the step, m/s: along its normal, and along its tangent."""
    i = contacts.link[c]
    return resolved(contacts, motion, c, motion.speed[0, i], motion.speed[1, i], motion.w[i])


@non_allocating
def find_contacts(chain, pegs, memory, workspace, h, push, bounce, struck):  # type: ignore[no-untyped-def]
    """Find the links that may touch in a step and how fast each may close; returns the smallest gap, m.

    A gap may be closed, not more. Without `push`, or where it is shallow (``APPROACH``), a link inside a peg stays as
    deep as it is; deeper ones are pushed out, the faster the deeper. `bounce` is the part of the restitution that takes
    place in an impact. Where an impact was made already (`struck`), a link that touches is held by the step,
    however it moves: only links further away may be left free. What was held in the last step (`memory`) is never
    left free: it may be pressed on, and would sink.
    """
    contacts, impulses, motion = workspace.contacts, workspace.impulses, workspace.motion
    n = motion.w.size
    workspace.touch[0] = np.inf
    for i in range(n):
        a = max(abs(motion.speed[0, i]), abs(motion.speed[1, i]))
        b = max(abs(motion.speed[0, i + 1]), abs(motion.speed[1, i + 1]))
        workspace.margin[i] = APPROACH.near + 1.5 * APPROACH.faster * h * max(a, b)
    least = find(chain, pegs, motion.q, motion.trig, workspace.xy, workspace.margin, contacts)
    count = contacts.total[0]
    if count == 0:
        return least
    if h > 0.0:
        look_ahead(chain, workspace, h)
    for c in range(count):
        i, p = contacts.link[c], contacts.peg[c]
        closing, _ = velocity_before(contacts, motion, c)
        impulses.tangent_target[c] = 0.0
        if h == 0.0:
            rebound = bounce * pegs.bounce[p] * closing if closing < -workspace.fast else 0.0
            impulses.target[c] = rebound if contacts.gap[c] <= 2.0 * APPROACH.touch else UNHELD
            continue
        held, fast = memory.mode[i, p] != OPEN, workspace.fast
        if held and pegs.bounce[p] == 0.0:
            fast = max(fast, 2.0 * APPROACH.touch / h)  # held again, it sinks by half a step at that speed
        away = contacts.gap[c] - 0.5 * h * closing  # at the beginning of the step
        if closing < -fast and (away > APPROACH.touch or not struck):
            workspace.touch[0] = min(workspace.touch[0], 0.0 if away <= APPROACH.touch else -away / closing)
            if not held:
                impulses.target[c] = UNHELD
                continue
        bend, impulses.tangent_target[c] = second_order(chain, pegs, workspace, h, c)
        out, depth = APPROACH.recovery if push else 0.0, -contacts.gap[c]
        if depth < APPROACH.deep:
            limit = APPROACH.push / (abs(memory.normal[i, p]) + APPROACH.slight_force)
            out = min(out, limit) * max(0.0, (depth - APPROACH.shallow) / (APPROACH.deep - APPROACH.shallow))
        impulses.target[c] = max(contacts.gap[c] / h, -out) + bend / h
    return least


@non_allocating
def look_ahead(chain, workspace, h):  # type: ignore[no-untyped-def]
    """Find where the rates before the step take the links from its middle in a step h, s."""
    motion, base, trig = workspace.motion, workspace.base, workspace.ahead_trig
    for i in range(motion.w.size):
        workspace.ahead_q[i] = motion.q[i] + h * motion.w[i]
    sines(workspace.ahead_q, trig, 0)
    vx, vy = base[0, 5], base[0, 6]  # as the joints' velocities, which are those before the step
    joint_positions(chain, trig, base[1, 7] + h * vx, base[1, 8] + h * vy, workspace.ahead)
    speeds(chain, trig, motion.w, vx, vy, workspace.ahead_speed)


@non_allocating
def second_order(chain, pegs, workspace, h, c):  # type: ignore[no-untyped-def]
    """What the turning of the rope changes in a step, where contact c is near, as the rates before it predict it.

    Left out, it would let what is inside a peg sink at every step.

    Returns
    -------
    bend : float, change of the gap in excess of its rate, m
    drift : float, half of the change of the tangential velocity, m/s
    """
    contacts, motion, trig = workspace.contacts, workspace.motion, workspace.ahead_trig
    i, p, n = contacts.link[c], contacts.peg[c], motion.w.size
    tx, ty, speed = workspace.ahead[0], workspace.ahead[1], workspace.ahead_speed
    link = (tx[i], ty[i], tx[i + 1], ty[i + 1], chain.length[i], trig[i], trig[n + i])
    s, gap, nx, ny = nearest(link, (pegs.x[p], pegs.y[p], pegs.ux[p], pegs.uy[p], pegs.span[p], pegs.reach[p]))
    if contacts.gap[c] >= APPROACH.near or gap >= NOWHERE:
        return 0.0, 0.0
    closing, sliding = velocity_before(contacts, motion, c)
    lever = s * motion.w[i]
    wx, wy = speed[0, i] + lever * trig[n + i], speed[1, i] + lever * trig[i]
    return max(-APPROACH.bend, min(gap - contacts.gap[c] - h * closing, APPROACH.bend)), 0.5 * (
        (wy * nx - wx * ny) - sliding
    )


@non_allocating
def scale_pull(motion, h):  # type: ignore[no-untyped-def]
    """Scale the impulses ``motion.pull`` of the last step that was tried to a step h, s; of a short one take none."""
    ratio = h / motion.span[0] if motion.span[0] > 0.25 * h else 0.0
    for k in range(2):
        for i in range(motion.w.size):
            pull = ratio * motion.pull[k, i]
            motion.pull[k, i] = pull if abs(pull) < np.inf and ratio > 0.0 else 0.0
    motion.span[0] = h


@absorbed
def begin_step(chain, drive, part, pegs, pull, t, h, y, memory, workspace, push, bounce, struck):  # type: ignore[no-untyped-def]
    """Prepare a step, with arguments as for :func:`try_step`, for :func:`finish_step`.

    ``workspace.touch`` is its longest length.

    Returns
    -------
    least : float, smallest gap in the middle of the step, m
    torque : float, of the motor, N m
    """
    motion, base = workspace.motion, workspace.base
    n = motion.w.size
    torque = base_state(drive, part, t + 0.5 * h, base[1])
    base_state(drive, part, t, base[0])
    base_state(drive, part, t + h, base[2])
    further = trend_factor(workspace.pace, h)
    for i in range(n):
        motion.w[i] = y[n + i]
        motion.q[i] = y[i] + 0.5 * h * y[n + i]
        motion.change[i] = h * (workspace.trend[0, i] + further * (workspace.trend[0, i] - workspace.trend[1, i]))
    scale_pull(motion, h)
    sines(motion.q, motion.trig, 0)
    joint_positions(chain, motion.trig, base[1, 7], base[1, 8], workspace.xy)
    speeds(chain, motion.trig, motion.w, base[0, 5], base[0, 6], motion.speed)
    joint_impulses(chain, motion, workspace.trend, workspace.pace[STEADY], base, h, torque)
    add_drag_impulses(chain, workspace.air, motion, base[1], h)
    motion.base[0] = base[2, 5] - base[0, 5] - h * chain.gx
    motion.base[1] = base[2, 6] - base[0, 6] - h * chain.gy
    motion.base[2] = base[2, 3] - base[0, 3]
    motion.tip[0], motion.tip[1] = h * pull[0], h * pull[1]
    least = find_contacts(chain, pegs, memory, workspace, h, push, bounce, struck)
    bound_joint_rates(chain, workspace, memory, h, struck)
    warm_start(memory, workspace.contacts, workspace.impulses, h)
    prepare_spin(workspace.spin, motion, h)
    return least, torque


@absorbed
def finish_step(chain, workspace, torque, h):  # type: ignore[no-untyped-def]
    """Take the step that :func:`begin_step` prepared; returns the rounds, as :func:`try_step`."""
    motion, whole = workspace.motion, chain.tip_mass
    n = motion.w.size
    for i in range(n):
        whole += chain.mass[i]
    rounds = solve(chain, workspace.contacts, workspace.impulses, motion, workspace.joints, workspace.spin, h, whole)
    for i in range(n):
        rate = motion.w[i] + motion.change[i]
        workspace.out[i] = motion.q[i] + 0.5 * h * rate
        workspace.out[n + i] = rate
    bend, out = workspace.bend, workspace.out
    bend[0], bend[1] = bend_clearance(chain, out[:n], out[n:], workspace.base[2, 4], workspace.base[2, 3])
    account_step(chain, workspace, torque, whole, h)
    return rounds


@non_allocating
def try_step(chain, drive, part, pegs, pull, t, h, y, memory, workspace, push, bounce, struck):  # type: ignore[no-untyped-def]
    """Take a step from y (2 n or more,) at time t to ``workspace.out``; h = 0.0: an impact, in which nothing else acts.

    Parameters
    ----------
    chain, drive, part, pegs : Chain, Drive, Segment that holds t..t + h, Pegs
    pull : (2,) force on the tip in addition to gravity, N
    memory, workspace : ContactMemory (not changed), ContactWorkspace with the rates of the pegs before the step
    push : bool, whether contacts may push the rope out of a peg
    bounce : float, part of the restitution that takes place in an impact
    struck : bool, an impact was made already at time t

    Returns
    -------
    least : float, smallest gap in the middle of the step, m
    rounds : int, of the search for the modes; negative if it failed
    """
    least, torque = begin_step(chain, drive, part, pegs, pull, t, h, y, memory, workspace, push, bounce, struck)
    return least, finish_step(chain, workspace, torque, h)
