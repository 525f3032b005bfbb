"""Arrays of the contact solver, and what a step inherits from the last ones: forces, modes and accelerations."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.contact.gaps import Index
from hyperflex.core.jit import kernel, non_allocating, zeros

# Modes. AHEAD, BACK: the rope slips along the tangent, or against it; a joint turns in the positive sense, or against
# it. UPPER, LOWER: a joint is held at a limit.
OPEN, STICK, AHEAD, BACK, UPPER, LOWER = range(6)
RELAXED = 0.99  # part of the last forces and torques with which a step starts: what nothing requires dies out
FRAME, TOUCH = 8, 12  # columns of Motion.frame and Motion.touch; core/contact/sweep.py has their names
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
    loose: float  # as ``modes.looseness``


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
