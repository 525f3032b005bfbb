"""One contact step of the Moreau-Jean scheme: angles at its middle, rates at its ends."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.chain.articulated_body import Array, energies, sines
from hyperflex.core.chain.drive import base_state
from hyperflex.core.contact.air import Air, add_drag_impulses, drag_work, new_air
from hyperflex.core.contact.arrays import IMPULSE, OPEN, Impulses, Joints, Motion, new_impulses, new_joints, new_motion
from hyperflex.core.contact.gaps import NOWHERE, Contacts, Index, find, joint_positions, nearest, new_contacts, speeds
from hyperflex.core.contact.joints import (
    BEYOND,
    bend_clearance,
    bound_joint_rates,
    friction_impulse,
    joint_impulses,
    joint_losses,
)
from hyperflex.core.contact.modes import solve
from hyperflex.core.contact.sweep import TX, TY
from hyperflex.core.contact.trend import STEADY, foresight
from hyperflex.core.contact.turning_pegs import Spin, lost_in_bearings, new_spin, prepare_spin
from hyperflex.core.jit import kernel, non_allocating

FAST, FALL = 0.01, 50.0  # m/s, m/s^2; what closes faster than that, and than a step may make it, does so in an impact
TOUCH = 1e-6  # m, gap that counts as touching there
FREE = 1e9  # m/s, target of a link that nothing holds
RECOVERY, PUSH = 1e-3, 5e-7  # m/s, W; at most so fast, and with so little power, a rope is pushed out of a peg
DEEP = 2e-5  # m, penetration from which on it takes the power that it needs
RELAXED = 0.99  # of the last step's forces is where the next step starts: what nothing asks for dies out
SLIGHT_FORCE = 1e-6  # N
RESIDUAL_SHARE = 0.25  # part of the power allowed from nowhere that the residual velocities of contacts may have
NEAR = 1e-4  # m, gap below which a link is watched even at rest
BEND = 2e-5  # m, by which a gap may change more than its rate says
FASTER = 2.0  # how many times faster than before a step links may be after it

FRICTION, CONTACT, WORK = range(
    3
)  # of ContactWorkspace.account, J: lost in joints, air, axles; in contacts, limits; put in


class ContactMemory(NamedTuple):
    """Contact forces and modes of the last step, the warm start of the next; by link and peg or by joint."""

    normal: Array  # (n, m) N
    tangent: Array
    mode: Index
    penalty: Array  # (1,) kg, as in Impulses
    torque: Array  # (n,) N m, of the joints' dry friction and limits
    bent: Index  # (n,) their modes


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
    account: Array  # (3,)
    touch: Array  # (1,) s, from the beginning of the step until a link that is left free touches, or a joint its limit
    bend: Array  # (2,) rad, smallest gap of a joint to its limit after the step, and what is left of the gaps soon
    fast: float  # m/s; a link that closes faster meets the peg in an impact of its own, at the instant of touching
    brisk: float  # rad/s; likewise a joint its limit


@kernel
def new_contact_workspace(chain, pegs, rate, longest):  # type: ignore[no-untyped-def]
    """Working arrays for a chain, the Pegs `pegs` and steps up to `longest`, s; energy may appear at `rate`, W."""
    n = chain.length.size
    most = n * pegs.reach.size
    return ContactWorkspace(
        new_contacts(most),
        new_impulses(most, RESIDUAL_SHARE * rate),
        new_motion(chain),
        new_joints(chain),
        new_spin(n, pegs),
        np.zeros((2, n + 1)),
        np.zeros((2, n + 1)),
        np.zeros(n),
        np.zeros(2 * n),
        np.zeros((2, n + 1)),
        np.zeros(n),
        np.zeros((2, n)),
        np.zeros(3),
        np.zeros(2 * n),
        np.zeros((3, 9)),
        new_air(n),
        np.zeros(3),
        np.zeros(1),
        np.zeros(2),
        max(FAST, FALL * longest),
        BEYOND / longest,
    )


@kernel
def new_contact_memory(n, pegs):  # type: ignore[no-untyped-def]
    """An empty memory."""
    return ContactMemory(
        np.zeros((n, pegs)),
        np.zeros((n, pegs)),
        np.zeros((n, pegs), np.int64),
        np.zeros(1),
        np.zeros(n),
        np.zeros(n, np.int64),
    )


@non_allocating
def velocity_before(contacts, motion, c):  # type: ignore[no-untyped-def]
    """Velocity of the point of contact c before the step, m/s: along its normal, and along its tangent."""
    n = motion.w.size
    i = contacts.link[c]
    lever = contacts.place[c] * motion.w[i]
    vx = motion.speed[0, i] + lever * motion.trig[n + i]
    vy = motion.speed[1, i] + lever * motion.trig[i]
    return vx * contacts.nx[c] + vy * contacts.ny[c], vy * contacts.nx[c] - vx * contacts.ny[c]


@non_allocating
def find_contacts(chain, pegs, memory, workspace, h, push, bounce, struck):  # type: ignore[no-untyped-def]
    """Find the links that may touch in a step and how fast each may close; returns the smallest gap, m.

    A gap may be closed, not more. Where the rope turns, gaps change by a term of second order, which is allowed for as
    the rates before the step predict it: left out, it would let what is inside a peg sink at every step. Without `push`
    that stays as deep as it is. `bounce` is the part of the restitution that takes place in an impact. Where an impact
    was made already (`struck`), a link that touches is held by the step, however it moves: only links further away may
    be left free.
    """
    contacts, impulses, motion = workspace.contacts, workspace.impulses, workspace.motion
    n = motion.w.size
    workspace.touch[0] = np.inf
    for i in range(n):
        a = max(abs(motion.speed[0, i]), abs(motion.speed[1, i]))
        b = max(abs(motion.speed[0, i + 1]), abs(motion.speed[1, i + 1]))
        workspace.margin[i] = NEAR + 1.5 * FASTER * h * max(a, b)
    least = find(chain, pegs, motion.q, motion.trig, workspace.xy, workspace.margin, contacts)
    count = contacts.total[0]
    if count == 0:
        return least
    if h == 0.0:
        for c in range(count):
            closing, _ = velocity_before(contacts, motion, c)
            impulses.target[c] = FREE
            if contacts.gap[c] <= 2.0 * TOUCH:
                impulses.target[c] = (
                    bounce * pegs.bounce[contacts.peg[c]] * (closing if closing < -workspace.fast else 0.0)
                )
            impulses.tangent_target[c] = 0.0
        return least
    for i in range(n):
        workspace.ahead_q[i] = motion.q[i] + h * motion.w[i]
    sines(workspace.ahead_q, workspace.ahead_trig, 0)
    x = workspace.base[1, 7] + h * workspace.base[0, 5]  # as the joints' velocities, which are those before the step
    y = workspace.base[1, 8] + h * workspace.base[0, 6]
    joint_positions(chain, workspace.ahead_trig, x, y, workspace.ahead)
    speeds(chain, workspace.ahead_trig, motion.w, workspace.base[0, 5], workspace.base[0, 6], workspace.ahead_speed)
    for c in range(count):
        i, p = contacts.link[c], contacts.peg[c]
        closing, sliding = velocity_before(contacts, motion, c)
        impulses.tangent_target[c] = 0.0
        away = contacts.gap[c] - 0.5 * h * closing  # at the beginning of the step
        if closing < -workspace.fast and (away > TOUCH or not struck):
            impulses.target[c] = FREE
            workspace.touch[0] = min(workspace.touch[0], 0.0 if away <= TOUCH else -away / closing)
            continue
        turned, tx, ty = workspace.ahead_trig, workspace.ahead[0], workspace.ahead[1]
        link = (tx[i], ty[i], tx[i + 1], ty[i + 1], chain.length[i], turned[i], turned[n + i])
        s, gap, nx, ny = nearest(link, (pegs.x[p], pegs.y[p], pegs.ux[p], pegs.uy[p], pegs.span[p], pegs.reach[p]))
        bend = 0.0
        if contacts.gap[c] < NEAR and gap < NOWHERE:
            bend = max(-BEND, min(gap - contacts.gap[c] - h * closing, BEND))
            lever = s * motion.w[i]
            wx = workspace.ahead_speed[0, i] + lever * workspace.ahead_trig[n + i]
            wy = workspace.ahead_speed[1, i] + lever * workspace.ahead_trig[i]
            impulses.tangent_target[c] = 0.5 * ((wy * nx - wx * ny) - sliding)
        out = RECOVERY if push else 0.0
        if contacts.gap[c] > -DEEP:
            out = min(out, PUSH / (abs(memory.normal[i, p]) + SLIGHT_FORCE))
        impulses.target[c] = max(contacts.gap[c] / h, -out) + bend / h
    return least


@non_allocating
def warm_start(memory, contacts, impulses, h):  # type: ignore[no-untyped-def]
    """Warm start: modes and forces of the last step."""
    impulses.penalty[0] = memory.penalty[0]
    for c in range(contacts.total[0]):
        i, p = contacts.link[c], contacts.peg[c]
        impulses.mode[c] = memory.mode[i, p]
        impulses.normal0[c] = RELAXED * h * memory.normal[i, p]
        impulses.tangent0[c] = RELAXED * h * memory.tangent[i, p]


@non_allocating
def save_memory(memory, contacts, impulses, joints, h):  # type: ignore[no-untyped-def]
    """Save modes and forces for the next step; `joints` are the Joints."""
    for i in joints.which:
        memory.torque[i], memory.bent[i] = joints.of[IMPULSE, i] / h, joints.mode[i]
    memory.penalty[0] = impulses.penalty[0]
    for i in range(memory.mode.shape[0]):
        for p in range(memory.mode.shape[1]):
            memory.normal[i, p] = memory.tangent[i, p] = 0.0
            memory.mode[i, p] = OPEN
    for c in range(contacts.total[0]):
        i, p = contacts.link[c], contacts.peg[c]
        memory.mode[i, p] = impulses.mode[c]
        memory.normal[i, p], memory.tangent[i, p] = impulses.normal[c] / h, impulses.tangent[c] / h


@non_allocating
def scale_pull(motion, h):  # type: ignore[no-untyped-def]
    """Scale the impulses ``motion.pull`` of the last step that was tried to a step h, s; of a short one take none."""
    ratio = h / motion.span[0] if motion.span[0] > 0.25 * h else 0.0
    for k in range(2):
        for i in range(motion.w.size):
            pull = ratio * motion.pull[k, i]
            motion.pull[k, i] = pull if abs(pull) < np.inf and ratio > 0.0 else 0.0
    motion.span[0] = h


@non_allocating
def try_step(chain, drive, part, pegs, pull, t, h, y, memory, workspace, push, bounce, struck):  # type: ignore[no-untyped-def]
    """Take a step from y (2 n or more,) at time t to ``workspace.out``; h = 0.0: an impact, in which nothing else acts.

    Parameters
    ----------
    chain, drive, part, pegs : Chain, Drive, Segment that holds t..t + h, Pegs
    pull : (2,) force on the tip beside gravity, N
    memory, workspace : ContactMemory (not changed), ContactWorkspace with the rates of the pegs before the step
    push : bool, whether contacts may push the rope out of a peg
    bounce : float, part of the restitution that takes place in an impact
    struck : bool, an impact was made already at time t

    Returns
    -------
    least : float, smallest gap in the middle of the step, m
    rounds : int, of the search for the modes; negative if it failed
    """
    motion, base = workspace.motion, workspace.base
    n = motion.w.size
    torque = base_state(drive, part, t + 0.5 * h, base[1])
    base_state(drive, part, t, base[0])
    base_state(drive, part, t + h, base[2])
    whole, further = chain.tip_mass, foresight(workspace.pace, h)
    for i in range(n):
        whole += chain.mass[i]
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
    rounds = solve(chain, workspace.contacts, workspace.impulses, motion, workspace.joints, workspace.spin, h, whole)
    for i in range(n):
        rate = motion.w[i] + motion.change[i]
        workspace.out[i] = motion.q[i] + 0.5 * h * rate
        workspace.out[n + i] = rate
    bend, out = workspace.bend, workspace.out
    bend[0], bend[1] = bend_clearance(chain, out[:n], out[n:], base[2, 4], base[2, 3])
    energy_account(chain, workspace, torque, whole, h)
    return least, rounds


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
def energy_account(chain, workspace, torque, whole, h):  # type: ignore[no-untyped-def]
    """Energy that joints, air, axles and contacts took in a step, and work put in: impulses times mean velocities."""
    motion, base, spin = workspace.motion, workspace.base, workspace.spin
    contacts, impulses, mean = workspace.contacts, workspace.impulses, workspace.ahead_speed
    n = motion.w.size
    mean_velocities(chain, motion, base, mean)
    taken, steady = 0.0, workspace.pace[STEADY]
    for i in range(n):
        change = motion.change[i] - (motion.change[i - 1] if i > 0 else motion.base[2])
        rate = motion.w[i] - (motion.w[i - 1] if i > 0 else base[0, 3]) + 0.5 * change
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
        lever = contacts.place[c] * (motion.w[i] + 0.5 * motion.change[i])
        vx, vy = mean[0, i] + lever * motion.trig[n + i], mean[1, i] + lever * motion.trig[i]
        sliding = vy * contacts.nx[c] - vx * contacts.ny[c]
        sliding -= 0.5 * spin.reach[p] * (spin.before[p] + spin.after[p])
        taken -= impulses.normal[c] * (vx * contacts.nx[c] + vy * contacts.ny[c]) + impulses.tangent[c] * sliding
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
    point = (base[7], base[8], base[5], base[6], base[4], base[3])
    kinetic, potential = energies(chain, y[:n], y[n : 2 * n], point, trig)
    return kinetic + potential
