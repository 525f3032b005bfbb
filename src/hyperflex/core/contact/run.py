"""A rollout with contact: Moreau-Jean steps, their control, impacts, outputs, and the end of contact.

A step has angles at its middle and rates at its ends. Shorter steps are tried until energy, depth and error are
accepted. A sample within a step is reached by separate steps.
"""

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core import status
from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain.air import air_loads
from hyperflex.core.chain.articulated_body import Array, Chain, energies, relative, sines
from hyperflex.core.chain.drive import Drive, base_state, segment
from hyperflex.core.chain.torque_peaks import watch_torque
from hyperflex.core.contact.arrays import OPEN, UNHELD, Impulses, Joints, Motion, new_impulses, new_joints, new_motion
from hyperflex.core.contact.gaps import NOWHERE, Contacts, Pegs, find, joint_positions, nearest, new_contacts, speeds
from hyperflex.core.contact.joints import (
    LIMIT_PASSED,
    bend_clearance,
    bound_joint_rates,
    friction_impulse,
    joint_impulses,
    joint_losses,
)
from hyperflex.core.contact.memory import (
    STEADY,
    ContactMemory,
    clear_memory,
    keeps_modes,
    new_contact_memory,
    save_memory,
    save_trend,
    trend_factor,
    warm_start,
)
from hyperflex.core.contact.solver import USUAL_TOL, looseness, solve
from hyperflex.core.contact.spin import Spin, lost_in_bearings, new_spin, prepare_spin
from hyperflex.core.contact.sweep import TX, TY, resolved
from hyperflex.core.integrate.step_size import allowed, fitted, lasting
from hyperflex.core.jit import absorbed, kernel, non_allocating, zeros


class Scene(NamedTuple):
    """The chain and the forces and obstacles that act on it."""

    chain: Chain
    drive: Drive
    pegs: Pegs
    pull: Array  # (2,) force on the tip in addition to gravity, N


@non_allocating
def add_drag_impulses(chain, workspace, h):  # type: ignore[no-untyped-def]
    """Add the impulses of air drag in a step h, s, to those of the joints, predicted from the previous accelerations.

    A torque on link i alone equals torques of all joints up to i, each with its reaction on the parent.
    :func:`drag_work` subtracts the part of the first joint from the load on the base.
    """
    motion, work, total, rate = workspace.motion, workspace.air, workspace.drag, workspace.ahead_q  # scratch here
    n = motion.w.size
    for i in range(n):
        rate[i] = motion.w[i] + 0.5 * motion.change[i]
        work[4 * n + i], work[5 * n + i] = motion.trig[i], motion.trig[n + i]
    total[0], total[1], _ = air_loads(chain, rate, workspace.base[1], work, 0, 1)
    total[2] = 0.0
    for way in range(n):
        i = n - 1 - way
        total[2] += work[i]
        motion.joint[i, 0] += h * total[2]


@non_allocating
def drag_work(workspace, h):  # type: ignore[no-untyped-def]
    """Subtract the drag from the impulses at the first joint; returns the energy lost to drag in the step, J."""
    motion, total, base = workspace.motion, workspace.drag, workspace.base
    n = motion.w.size
    given = 0.5 * (total[0] * (base[0, 5] + base[2, 5]) + total[1] * (base[0, 6] + base[2, 6]))
    for k in range(3):
        motion.load[k] -= h * total[k]
    for i in range(n):
        given += 0.5 * workspace.air[i] * (motion.w[i] + workspace.out[n + i])
    return -h * given


# of ContactWorkspace.account, J: losses in joints, air, axles; losses in contacts, limits; work put in
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
def account_step(chain, workspace, torque, h):  # type: ignore[no-untyped-def]
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
    taken += drag_work(workspace, h)
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
        work += workspace.whole * g * fallen + motion.tip[k] * mean[k, n]
    workspace.account[WORK] = work


@non_allocating
def energy(chain, y, base, spin, rate, trig):  # type: ignore[no-untyped-def]
    """Energy of angles and rates y (2 n or more,), and of pegs that rotate at rates (m,), J.

    `base` (9,) motion of the first joint; `trig` is scratch, as in ``energies``.
    """
    n = chain.length.size
    kinetic, potential = energies(chain, y[:n], y[n : 2 * n], base, trig)
    for p in spin.which:
        kinetic += 0.5 * spin.inertia[p] * rate[p] * rate[p]
    return kinetic + potential


# Constants that determine which links touch in a step, and how a rope is pushed out of a peg.
#
# m/s, speed above which a link touches in a separate impact, and
FAST = 0.01
# m/s^2, this speed in proportion to the longest step
FALL = 50.0
# m, gap that counts as touching in an impact
TOUCHING = 1e-6
# m/s, largest speed at which a rope is pushed out of a peg
RECOVERY = 1e-3
# W, largest power with which it is pushed out
PUSH = 5e-7
# m, depth that is not corrected: pushing neighbours at different speeds changes contact modes in every step, which took
# half of all rounds
SHALLOW = 2e-6
# m, depth from which the speed is `recovery`; from `shallow` to here it is proportional and its power is limited
DEEP = 2e-5
# N, added to the contact force that divides `push`
SLIGHT_FORCE = 1e-6
# fraction of the allowed unexplained power that the residual velocities of contacts may have
RESIDUAL_SHARE = 0.25
# m, gap below which a link is checked even at rest
NEAR = 1e-4
# m, by which a gap may change more than its rate predicts
MOST_BEND = 2e-5
# largest ratio of the links' speeds after and before a step
FASTER = 2.0


class ContactWorkspace(NamedTuple):
    """Working arrays of the stepper for a chain of n links."""

    contacts: Contacts
    impulses: Impulses
    motion: Motion
    joints: Joints
    spin: Spin
    xy: Array  # (2, n + 1) joints there
    ahead: Array  # (2, n + 1) positions of the joints a step later
    ahead_q: Array
    ahead_trig: Array
    ahead_speed: Array  # (2, n + 1)
    margin: Array  # (n,)
    trend: Array  # (2, n) rad/s^2, accelerations of the last step, where the next search starts, and before it
    pace: Array  # (3,) s, lengths of these steps, 0.0 if missing; 1.0 if the last one changed no mode
    out: Array  # (2 n,) angles and rates after the step
    base: Array  # (3, 9) motion of the first joint before, in the middle and after
    air: Array  # (6 n,) torque of the air on each link first, N m
    drag: Array  # (3,) its force x, y on the rope, N, and all torques together, N m
    account: Array  # (3,) of ``account_step``
    touch: Array  # (1,) s, from the beginning of the step until a free link touches, or a joint reaches its limit
    bend: Array  # (2,) rad, smallest gap of a joint to its limit after the step, and the smallest gap soon after
    whole: float  # kg, mass of the rope
    fast: float  # m/s; a link that closes faster has a separate impact at the instant of touching
    brisk: float  # rad/s; likewise for a joint at its limit


@kernel
def new_contact_workspace(scene, rate, longest, tol):  # type: ignore[no-untyped-def]
    """Working arrays for a Scene; `rate`, `longest` step and `tol` as in ``run.Bounds``."""
    chain, pegs = scene.chain, scene.pegs
    n, whole = chain.length.size, chain.tip_mass
    for mass in chain.mass:
        whole += mass
    most = n * pegs.reach.size
    links = zeros((2, n + 1), (2, n + 1), n, 2 * n, (2, n + 1), n, (2, n), 3, 2 * n, (3, 9))
    return ContactWorkspace(  # type: ignore[call-arg]
        new_contacts(most),
        new_impulses(most, RESIDUAL_SHARE * rate, looseness(tol)),
        new_motion(chain),
        new_joints(chain),
        new_spin(n, pegs),
        *links,
        *zeros(6 * n, 3, 3, 1, 2),
        whole,
        max(FAST, FALL * longest),
        LIMIT_PASSED / longest,
    )


@non_allocating
def velocity_before(contacts, motion, c):  # type: ignore[no-untyped-def]
    """Velocity of the point of contact c before the step, m/s: along its normal, and along its tangent."""
    i = contacts.link[c]
    return resolved(contacts, motion, c, motion.speed[0, i], motion.speed[1, i], motion.w[i])


@non_allocating
def find_contacts(chain, pegs, memory, workspace, h, push, bounce, struck):  # type: ignore[no-untyped-def]
    """Find the links that may touch in a step and the allowed closing speed of each; returns the smallest gap, m.

    A gap may close but not become negative. Without `push`, or at a shallow depth (``SHALLOW``), a link inside a peg
    keeps its depth; deeper ones are pushed out, faster with increasing depth. `bounce` is the fraction of the
    restitution in an impact. After an impact (`struck`), the step holds every link that touches, whatever its motion:
    only more distant links may be free. A contact that was held in the last step (`memory`) is never free, because a
    pressed link would sink.
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
    if h > 0.0:
        look_ahead(chain, workspace, h)
    for c in range(count):
        i, p = contacts.link[c], contacts.peg[c]
        closing, _ = velocity_before(contacts, motion, c)
        impulses.tangent_target[c] = 0.0
        if h == 0.0:
            rebound = bounce * pegs.bounce[p] * closing if closing < -workspace.fast else 0.0
            impulses.target[c] = rebound if contacts.gap[c] <= 2.0 * TOUCHING else UNHELD
            continue
        held, fast = memory.mode[i, p] != OPEN, workspace.fast
        if held and pegs.bounce[p] == 0.0:
            fast = max(fast, 2.0 * TOUCHING / h)  # held again, the link sinks by half a step at that speed
        away = contacts.gap[c] - 0.5 * h * closing  # at the beginning of the step
        if closing < -fast and (away > TOUCHING or not struck):
            workspace.touch[0] = min(workspace.touch[0], 0.0 if away <= TOUCHING else -away / closing)
            if not held:
                impulses.target[c] = UNHELD
                continue
        bend, impulses.tangent_target[c] = second_order(chain, pegs, workspace, h, c)
        out, depth = RECOVERY if push else 0.0, -contacts.gap[c]
        if depth < DEEP:
            limit = PUSH / (abs(memory.normal[i, p]) + SLIGHT_FORCE)
            out = min(out, limit) * max(0.0, (depth - SHALLOW) / (DEEP - SHALLOW))
        impulses.target[c] = max(contacts.gap[c] / h, -out) + bend / h
    return least


@non_allocating
def look_ahead(chain, workspace, h):  # type: ignore[no-untyped-def]
    """Extrapolate the links from the middle of a step h, s, with the rates before it."""
    motion, base, trig = workspace.motion, workspace.base, workspace.ahead_trig
    for i in range(motion.w.size):
        workspace.ahead_q[i] = motion.q[i] + h * motion.w[i]
    sines(workspace.ahead_q, trig, 0)
    vx, vy = base[0, 5], base[0, 6]  # for the joints' velocities, which are those before the step
    joint_positions(chain, trig, base[1, 7] + h * vx, base[1, 8] + h * vy, workspace.ahead)
    speeds(chain, trig, motion.w, vx, vy, workspace.ahead_speed)


@non_allocating
def second_order(chain, pegs, workspace, h, c):  # type: ignore[no-untyped-def]
    """Effect of the rope's rotation in a step at contact c, predicted from the rates before it.

    Without it, a link inside a peg would sink at every step.

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
    if contacts.gap[c] >= NEAR or gap >= NOWHERE:
        return 0.0, 0.0
    closing, sliding = velocity_before(contacts, motion, c)
    lever = s * motion.w[i]
    wx, wy = speed[0, i] + lever * trig[n + i], speed[1, i] + lever * trig[i]
    return max(-MOST_BEND, min(gap - contacts.gap[c] - h * closing, MOST_BEND)), 0.5 * ((wy * nx - wx * ny) - sliding)


@non_allocating
def scale_pull(motion, h):  # type: ignore[no-untyped-def]
    """Scale the impulses ``motion.pull`` of the last attempt to a step h, s; use none after a short attempt."""
    ratio = h / motion.span[0] if motion.span[0] > 0.25 * h else 0.0
    for k in range(2):
        for i in range(motion.w.size):
            pull = ratio * motion.pull[k, i]
            motion.pull[k, i] = pull if abs(pull) < np.inf else 0.0
    motion.span[0] = h


@absorbed
def begin_step(scene, part, t, h, y, memory, workspace, push, bounce, struck):  # type: ignore[no-untyped-def]
    """Prepare a step, with arguments as for :func:`try_step`, for :func:`finish_step`.

    ``workspace.touch`` is its longest length.

    Returns
    -------
    least : float, smallest gap in the middle of the step, m
    torque : float, of the motor, N m
    """
    motion, base, chain, drive = workspace.motion, workspace.base, scene.chain, scene.drive
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
    add_drag_impulses(chain, workspace, h)
    motion.base[0] = base[2, 5] - base[0, 5] - h * chain.gx
    motion.base[1] = base[2, 6] - base[0, 6] - h * chain.gy
    motion.base[2] = base[2, 3] - base[0, 3]
    motion.tip[0], motion.tip[1] = h * scene.pull[0], h * scene.pull[1]
    least = find_contacts(chain, scene.pegs, memory, workspace, h, push, bounce, struck)
    bound_joint_rates(chain, workspace, memory, h, struck)
    warm_start(memory, workspace.contacts, workspace.impulses, h)
    prepare_spin(workspace.spin, motion, h)
    return least, torque


@absorbed
def finish_step(chain, workspace, torque, h):  # type: ignore[no-untyped-def]
    """Take the step that :func:`begin_step` prepared; returns the rounds, as :func:`try_step`."""
    motion, whole = workspace.motion, workspace.whole
    n = motion.w.size
    rounds = solve(chain, workspace.contacts, workspace.impulses, motion, workspace.joints, workspace.spin, h, whole)
    for i in range(n):
        rate = motion.w[i] + motion.change[i]
        workspace.out[i] = motion.q[i] + 0.5 * h * rate
        workspace.out[n + i] = rate
    bend, out = workspace.bend, workspace.out
    bend[0], bend[1] = bend_clearance(chain, out[:n], out[n:], workspace.base[2, 4], workspace.base[2, 3])
    account_step(chain, workspace, torque, h)
    return rounds


@non_allocating
def try_step(scene, part, t, h, y, memory, workspace, push, bounce, struck):  # type: ignore[no-untyped-def]
    """Take a step from y (2 n or more,) at time t to ``workspace.out``; h = 0.0: an impact without other forces.

    Parameters
    ----------
    scene, part : Scene, Segment of its drive that holds t..t + h
    memory, workspace : ContactMemory (not changed), ContactWorkspace with the rates of the pegs before the step
    push : bool, whether contacts may push the rope out of a peg
    bounce : float, fraction of the restitution in an impact
    struck : bool, an impact has already occurred at time t

    Returns
    -------
    least : float, smallest gap in the middle of the step, m
    rounds : int, of the search for the modes; negative if it failed
    """
    least, torque = begin_step(scene, part, t, h, y, memory, workspace, push, bounce, struck)
    return least, finish_step(scene.chain, workspace, torque, h)


MOMENT = 1e-8  # s; forces of shorter steps are not kept for the next step: they are mostly rounding
SLIGHT, ROUNDING = 1e-5, 1e-15  # s, J; energy that may appear in a step of any length: rounding of large forces
LOSS = 10.0  # ratio of the energies that may vanish and appear in a step

# T: time, s. STEP: next step, s. INDEX: next output. TAKEN, REJECTED: steps. UNSOLVED: steps whose contact problem was
# not solved. IMPACTS: of links that closed fast. LOST: energy that contacts took, J. DEEPEST: greatest penetration, m.
# FORCED: steps taken though their energy balance is off. ENERGY_GAIN: energy that came from nowhere, J. IMPACT_DUE: 1.0
# where a link touches or a joint reaches its limit, and an impact is due. BEND: greatest angle past a joint limit, rad.
# GIVEN: by how much the energy that contacts took has fallen since it was greatest, J. SPENT: time with contact, s.
T, STEP, INDEX, TAKEN, REJECTED, UNSOLVED, IMPACTS, LOST = range(8)
DEEPEST, FORCED, ENERGY_GAIN, IMPACT_DUE, BEND, GIVEN, SPENT, CLOCK = range(8, 16)


class Bounds(NamedTuple):
    """Bounds of a rollout with contact."""

    stop: float  # s
    step: float  # s, longest step
    tol: float  # m, error allowed in the position of any joint, as in ``rollout.run``
    rate: float  # W, allowed power of unexplained energy
    clear: float  # m, smallest gap at which the rope has left the pegs
    slack: float  # rad, smallest gap, predicted with the present rates, at which joints have left their limits
    budget: int  # steps of one call


class ContactState(NamedTuple):
    """State of a rollout with contact; all arrays are changed in place."""

    y: Array  # (2 n + 2,) angles, rates, work put in, energy dissipated
    clock: Array  # (CLOCK,)
    spin: Array  # (2, m) angles, rad, and rates, rad/s, of the pegs; 0 of fixed ones
    memory: ContactMemory
    torque: Array  # (k, COLUMNS) windows of ``core.chain.torque_peaks``


# Constants of the acceptance of steps in contact and the length of the next step.
#
# of the longest step, the shortest attempt
SHORTEST = 2.0**-10
# largest factor on this length, in proportion to a tolerance above the usual one, if that is safe
COARSEST = 2.0**5
# s, the shortest step to an impact
BRIEF = 1e-9
# of the longest step: position errors do not shorten a step below this length
RESOLVED = 0.12
# relative error above which a step is repeated with half its length
REJECTED_ERROR = 4.0
# of the smallest reach of a peg: allowed motion of nearby links in a step
SAFE = 0.5
# factor on the energy that may appear, for contacts that push a rope out
GENEROUS = 100.0
# m, penetration above which a step is repeated with half its length
DEEPER = 5e-5
# factor from a step to the next
GROWTH = 1.5
# relative error of a step, below which steps grow
EASY = 0.2
# times the greatest earlier depth, allowed in a step: a slowly sinking link sinks with any step
SINKING = 1.02


class Chosen(NamedTuple):
    """The step that :func:`choose_step` left in a workspace."""

    h: float  # s
    wanted: float  # s; h is shorter if touchdown or an end cut it, or if equal steps lead to an end
    least: float  # m, smallest gap
    touch: float  # s, until a link touches
    rounds: int  # of the search; negative if it failed
    surplus: float  # J, unexplained energy
    has: float  # J, energy after the step
    good: bool  # False if the shortest step had to be accepted
    error: float  # of positions, relative to the allowed error
    struck: bool  # whether an impact has occurred at its beginning


@non_allocating
def follow(workspace, h, x, state):  # type: ignore[no-untyped-def]
    """Advance a state to the fraction x of the step in `workspace`, of length h, s; rates are linear in between."""
    y, spin, account, change = state.y, workspace.spin, workspace.account, workspace.motion.change
    n = change.size
    for i in range(n):
        y[i] += x * h * (y[n + i] + 0.5 * x * change[i])
        y[n + i] += x * change[i]
    y[2 * n] += x * account[WORK]
    y[2 * n + 1] += x * (account[FRICTION] + account[CONTACT])
    state.clock[LOST] += x * account[CONTACT]
    for p in spin.which:
        more = x * (spin.after[p] - spin.before[p])
        state.spin[0, p] += x * h * (spin.before[p] + 0.5 * more)
        state.spin[1, p] = spin.before[p] + more


@absorbed
def accept_step(drive, state, workspace, h, rounds, least):  # type: ignore[no-untyped-def]
    """Accept the step to ``workspace.out``."""
    load, angle, clock = workspace.motion.load, workspace.base[1, 4], state.clock
    about_shaft = load[2] + drive.arm_length * (math.cos(angle) * load[0] + math.sin(angle) * load[1])
    watch_torque(state.torque, about_shaft, clock[T], h)
    follow(workspace, h, 1.0, state)
    assign(state.y[: workspace.out.size], workspace.out)
    assign(workspace.spin.before, workspace.spin.after)
    assign(state.spin[1], workspace.spin.after)
    clock[GIVEN] = max(0.0, clock[GIVEN] - workspace.account[CONTACT])
    clock[SPENT] += h
    clock[DEEPEST] = max(clock[DEEPEST], -least)
    clock[BEND] = max(clock[BEND], -workspace.bend[0])
    clock[TAKEN] += 1.0
    clock[UNSOLVED] += rounds < 0
    long = h > MOMENT
    save_trend(state.memory, workspace, h if long else 0.0)
    if long:
        save_memory(state.memory, workspace.contacts, workspace.impulses, workspace.joints, h)


@non_allocating
def impact(scene, part, state, workspace):  # type: ignore[no-untyped-def]
    """Stop the links that touch a peg, or let them bounce, at an instant, in the last step's modes if these are valid.

    Newton's restitution with friction may create energy; in this case there is no restitution.
    """
    clock, y, memory = state.clock, state.y, state.memory
    least, rounds = try_step(scene, part, clock[T], 0.0, y, memory, workspace, True, 1.0, True)
    if scene.pegs.bounce.any() and workspace.account[CONTACT] < 0.0:
        least, rounds = try_step(scene, part, clock[T], 0.0, y, memory, workspace, True, 0.0, True)
    accept_step(scene.drive, state, workspace, 0.0, rounds, least)
    clock[IMPACTS] += 1.0
    clock[IMPACT_DUE] = 0.0


@non_allocating
def longest_safe_step(scene, workspace):  # type: ignore[no-untyped-def]
    """Longest step, s, in which no link near a peg moves by more than SAFE of the smallest reach."""
    speed = workspace.motion.speed
    fastest = 0.0
    for c in range(workspace.contacts.total[0]):
        i = workspace.contacts.link[c]
        for j in range(i, i + 2):
            fastest = max(fastest, abs(speed[0, j]), abs(speed[1, j]))
    smallest = np.inf
    for reach in scene.pegs.reach:
        smallest = min(smallest, reach)
    return SAFE * smallest / fastest if fastest > 0.0 else np.inf


@non_allocating
def relative_error(chain, bounds, memory, workspace, h):  # type: ignore[no-untyped-def]
    """Error of a step in units of the allowed error, as in free flight; 0.0 unless no mode has changed for three steps.

    The error of the velocity of any joint is a twelfth of the difference from the extrapolation of the last two steps.
    """
    motion, trend, further = workspace.motion, workspace.trend, trend_factor(workspace.pace, h)
    if further == 0.0 or not keeps_modes(memory, workspace.contacts, workspace.impulses, workspace.joints):
        return 0.0
    n = motion.w.size
    x = y = worst = 0.0
    for i in range(n):
        off = motion.change[i] - h * (trend[0, i] + further * (trend[0, i] - trend[1, i]))
        x += chain.length[i] * motion.trig[n + i] * off
        y += chain.length[i] * motion.trig[i] * off
        worst = max(worst, x * x + y * y)
    return math.sqrt(worst) / 12.0 * lasting(h) / allowed(bounds.tol, h, 0.0)


@non_allocating
def choose_step(scene, part, bounds, state, workspace, nothing, end, struck, had):  # type: ignore[no-untyped-def]
    """Try a step, and shorter ones, until one is accepted; it is left in `workspace`.

    Parameters
    ----------
    scene, part, bounds, state, workspace : as for :func:`try_step` and :func:`run`
    nothing : ContactMemory, empty
    end : s, time that no step goes beyond
    struck : bool, an impact has already occurred at this instant
    had : J, energy before the step, NaN if unknown

    Returns
    -------
    Chosen
    """
    y, clock, account, spin = state.y, state.clock, workspace.account, workspace.spin
    chain, base, trig = scene.chain, workspace.base, workspace.ahead_trig
    wanted = min(clock[STEP], bounds.step)
    h = fitted(wanted, end - clock[T])
    coarse = max(1.0, min(bounds.tol / USUAL_TOL, COARSEST))
    finest, shortest = SHORTEST * bounds.step, min(coarse * SHORTEST * bounds.step, h)
    push, anew, back, stale = True, False, False, np.inf
    while True:
        begin = nothing if anew else state.memory
        least, torque = begin_step(scene, part, clock[T], h, y, begin, workspace, push, 0.0, struck)
        touch = workspace.touch[0]
        if touch == 0.0:
            impact(scene, part, state, workspace)
            struck, had = True, math.nan
            continue
        if touch < 0.999 * h:
            h = max(touch, BRIEF)
            shortest = min(shortest, h)
            continue
        rounds = finish_step(chain, workspace, torque, h)
        given, taken = bounds.rate * max(h, SLIGHT) + ROUNDING, account[CONTACT]
        # whether contacts return no more energy than the unexplained energy allowed so far
        little = taken >= -given or clock[GIVEN] - taken <= bounds.rate * (clock[SPENT] + h)
        longest = longest_safe_step(scene, workspace)
        if h > longest:  # a link may pass through a peg: no tolerance allows this
            shortest = min(finest, shortest)
        if push and (taken < -GENEROUS * given or not little):
            push = False  # a shorter step would push out with the same power
            continue
        error = relative_error(chain, bounds, state.memory, workspace, h)
        if math.isnan(had):
            had = energy(chain, y, base[0], spin, spin.before, trig)
        has = energy(chain, workspace.out, base[2], spin, spin.after, trig)
        surplus = has - had + account[FRICTION] + taken - account[WORK]
        good = -LOSS * given <= surplus <= given and little and rounds > 0 and h <= longest
        good = good and (error <= REJECTED_ERROR or h <= RESOLVED * bounds.step)
        good = good and (-least < DEEPER or -least <= SINKING * clock[DEEPEST])
        good = good and (-workspace.bend[0] < LIMIT_PASSED or -workspace.bend[0] <= SINKING * clock[BEND])
        if good or back or (h <= shortest and (surplus <= stale if anew else rounds > 0)):
            return Chosen(h, wanted, least, touch, rounds, surplus, has, good, error, struck)
        if h <= shortest:  # the last resort: a search without a warm start, unless it creates more energy
            anew, back, stale = not anew, anew, surplus
            continue
        h = max(0.5 * h, shortest)
        wanted, push = h, True
        clock[REJECTED] += 1.0


@non_allocating
def complete_step(drive, bounds, state, workspace, chosen, end):  # type: ignore[no-untyped-def]
    """Accept the step of :func:`choose_step`, and set the clock for the next step; none goes beyond `end`, s."""
    clock, h, error = state.clock, chosen.h, chosen.error
    clock[FORCED] += not chosen.good
    clock[ENERGY_GAIN] += chosen.surplus
    accept_step(drive, state, workspace, h, chosen.rounds, chosen.least)
    clock[IMPACT_DUE] = 1.0 if chosen.touch <= 1.001 * h else 0.0
    clock[T] = end if h >= end - clock[T] else clock[T] + h
    growth = GROWTH if error < EASY else 1.0 if error < 1.0 else 1.0 / GROWTH
    clock[STEP] = max(chosen.wanted * growth, min(chosen.wanted, RESOLVED * bounds.step))


MOST_STEPS = 100  # to a sample


@kernel
def new_branch(state):  # type: ignore[no-untyped-def]
    """A ContactState of the same shapes, for :func:`branch_off`."""
    memory = new_contact_memory(*state.memory.normal.shape)
    return ContactState(state.y.copy(), state.clock.copy(), state.spin.copy(), memory, state.torque.copy())


@non_allocating
def branch_off(scene, part, bounds, workspace, aside, branch, nothing, chosen, end):  # type: ignore[no-untyped-def]
    """Advance `branch`, a copy of the state before the step `chosen`, to a time `end`, s, within it.

    The steps, in `aside`, are chosen like those of a run, and start with the modes and forces of the whole step.
    Returns whether they reach the time and conserve energy. The run itself continues from the end of its step.
    """
    assign_rows(aside.trend, workspace.trend)
    assign(aside.pace, workspace.pace)
    assign_rows(
        aside.motion.pull, workspace.motion.pull
    )  # its initial guess is overwritten; this is the best available one
    aside.motion.span[0] = workspace.motion.span[0]
    assign(aside.spin.before, workspace.spin.before)
    save_memory(branch.memory, workspace.contacts, workspace.impulses, workspace.joints, chosen.h)
    struck = chosen.struck
    for _ in range(MOST_STEPS):
        if branch.clock[IMPACT_DUE] == 1.0:
            impact(scene, part, branch, aside)
            struck = True
        tried = choose_step(scene, part, bounds, branch, aside, nothing, end, struck, math.nan)
        if not (tried.good and abs(tried.surplus) < math.inf):
            return False
        complete_step(scene.drive, bounds, branch, aside, tried, end)
        if branch.clock[T] >= end - MOMENT:
            return True
        struck = False
    return False


@non_allocating
def copy_state(state, out):  # type: ignore[no-untyped-def]
    """Copy a ContactState without its memory to another of the same shapes."""
    assign(out.y, state.y)
    assign(out.clock, state.clock)
    assign_rows(out.spin, state.spin)
    assign_rows(out.torque, state.torque)


@non_allocating
def write_output(workspace, h, state, clock, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Write a state as the next output of `clock`; accelerations and forces are means over the step in `workspace`."""
    k, y, n = int(clock[INDEX]), state.y, workspace.motion.w.size
    assign(y_out[k], y)
    step_means(workspace, h, seen_out[k])
    seen_out[k, 3 * n + 3] = state.clock[LOST]
    m = state.spin.shape[1]
    assign(seen_out[k, 3 * n + 4 : 3 * n + 4 + m], state.spin[0])
    assign(seen_out[k, 3 * n + 4 + m :], state.spin[1])
    clock[INDEX] += 1


@non_allocating
def write_within(  # type: ignore[no-untyped-def]
    scene, part, bounds, state, workspace, aside, branch, nothing, chosen, t_out, y_out, seen_out
):
    """Write the outputs within the step `chosen` to ``workspace.out``.

    The rates, and with them the energy, differ from a linear interpolation between the ends of a step by a term of
    second order, so a sample within a step is reached by separate steps, in `aside` and `branch`, a workspace and a
    state; `nothing` is as for :func:`choose_step`. If these fail, the sample is interpolated linearly.
    """
    clock, h = state.clock, chosen.h
    while clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] < clock[T] + h - MOMENT:
        end = t_out[int(clock[INDEX])]
        copy_state(state, branch)
        given = scene, part, bounds, workspace, aside, branch, nothing, chosen, end
        if end > clock[T] + MOMENT and not branch_off(*given):
            copy_state(state, branch)
            follow(workspace, h, (end - clock[T]) / h, branch)
        write_output(workspace, h, branch, clock, y_out, seen_out)


@non_allocating
def step_means(workspace, h, out):  # type: ignore[no-untyped-def]
    """Means over a step, to the first 3 n + 3 entries of ``out``.

    Accelerations, rad/s^2; forces of the pegs on the links, first x, then y, N; force on the rope at its first joint,
    x and y, N, and torque through that joint, N m.
    """
    contacts, impulses, motion = workspace.contacts, workspace.impulses, workspace.motion
    n = motion.w.size
    for i in range(n):
        out[i] = motion.change[i] / h
        out[n + i] = out[2 * n + i] = 0.0
    for k in range(3):
        out[3 * n + k] = motion.load[k] / h
    for c in range(contacts.total[0]):
        if impulses.mode[c] != OPEN:
            i, nx, ny = contacts.link[c], contacts.nx[c], contacts.ny[c]
            out[n + i] += (impulses.normal[c] * nx - impulses.tangent[c] * ny) / h
            out[2 * n + i] += (impulses.normal[c] * ny + impulses.tangent[c] * nx) / h


@non_allocating
def take_steps(scene, bounds, state, workspace, aside, branch, nothing, t_out, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Take the steps of :func:`run`, separate because a function that makes arrays counts all references in it."""
    clock, memory, drive = state.clock, state.memory, scene.drive
    part = segment(drive, clock[T])
    had = math.nan  # energy before the step, if known
    for _ in range(bounds.budget):
        if clock[T] >= bounds.stop:
            return status.OK
        if clock[T] >= part.end:
            part = segment(drive, clock[T])
        struck = clock[IMPACT_DUE] == 1.0
        if struck:
            impact(scene, part, state, workspace)
            had = math.nan
        end = min(part.end, bounds.stop)
        chosen = choose_step(scene, part, bounds, state, workspace, nothing, end, struck, had)
        if not (abs(chosen.surplus) < math.inf):
            if not (memory.mode.any() or memory.bent.any()):  # OPEN is 0
                return status.NOT_FINITE
            clear_memory(memory)  # restart without a warm start
            continue
        rest = nothing, chosen, t_out, y_out, seen_out
        write_within(scene, part, bounds, state, workspace, aside, branch, *rest)
        had = chosen.has
        complete_step(drive, bounds, state, workspace, chosen, end)
        while clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] <= clock[T] + MOMENT:
            write_output(workspace, chosen.h, state, clock, y_out, seen_out)
        if chosen.least > bounds.clear and workspace.bend[1] > bounds.slack and clock[T] < bounds.stop:
            return status.LEFT
    return status.RUNNING if clock[T] < bounds.stop else status.OK


@kernel
def run(scene, bounds, state, t_out, y_out, seen_out):  # type: ignore[no-untyped-def]
    """Run until ``bounds.stop`` or until the budget is spent.

    Parameters
    ----------
    scene, bounds, state : Scene, Bounds, ContactState
    t_out : (k,) increasing times, s; y_out : (k, 2 n + 2) out, as in ``rollout.run``
    seen_out : (k, 3 n + 4 + 2 m) out: ``see``, energy lost to contact, J, angles, rad, and rates, rad/s, of the m pegs

    Returns
    -------
    int : OK, RUNNING (call again), LEFT (no link is near a peg, no joint near its limit), or why it failed
    """
    workspace = new_contact_workspace(scene, bounds.rate, bounds.step, bounds.tol)
    aside = new_contact_workspace(scene, bounds.rate, bounds.step, bounds.tol)
    assign(workspace.spin.before, state.spin[1])
    nothing = new_contact_memory(scene.chain.length.size, scene.pegs.x.size)
    return take_steps(scene, bounds, state, workspace, aside, new_branch(state), nothing, t_out, y_out, seen_out)


@kernel
def clearance(chain, drive, pegs, t, y, near):  # type: ignore[no-untyped-def]
    """Distances at time t between rope and pegs, and between joints and their limits; y as in ``ContactState``.

    Gaps above `near`, m, may be reported too small.

    Returns
    -------
    gap, speed : float, smallest gap between rope and pegs, m, and the greatest speed of a joint, m/s
    left : float, rad, as ``joints.bend_clearance`` gives it
    """
    n = chain.length.size
    base, trig = np.empty(9), np.empty(2 * n)
    base_state(drive, segment(drive, t), t, base)
    xy, speed, contacts = np.empty((2, n + 1)), np.empty((2, n + 1)), new_contacts(n * pegs.x.size)
    sines(y[:n], trig, 0)
    joint_positions(chain, trig, base[7], base[8], xy)
    speeds(chain, trig, y[n : 2 * n], base[5], base[6], speed)
    fastest = 0.0
    for i in range(n + 1):
        fastest = max(fastest, math.hypot(speed[0, i], speed[1, i]))
    _, left = bend_clearance(chain, y[:n], y[n : 2 * n], base[4], base[3])
    return find(chain, pegs, y[:n], trig, xy, np.full(n, near), contacts), fastest, left
