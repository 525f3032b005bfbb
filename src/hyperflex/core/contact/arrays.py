"""Arrays of a step in contact: contacts and joints with their modes, and the motion of the links."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.contact.gaps import Index
from hyperflex.core.jit import kernel, zeros

# Modes. AHEAD, BACK: the rope slips along the tangent, or against it. UPPER, LOWER: a joint is held at a limit. In the
# memory a joint with dry friction also has those of contacts, as ``seen_mode``.
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
    penalty: Array  # (1,) kg, mass M with which the search starts, then that for the next one; 0: the usual one
    residual_power: float  # W, power that residual velocities may have
    loose: float  # as ``looseness``


class Joints(NamedTuple):
    """Joints with dry friction or limits. Few arrays: kernels copy what they are called with, word by word."""

    which: Index  # (k,) the joints
    mode: Index  # (n,)
    good_mode: Index  # (n,) of the last solution found
    of: Array  # (ROWS, n) see the names below


# Rows of Joints.of, by joint. IMPULSE: of the limit, N m s. START: where the proximal method starts from; AFTER:
# relative rate after the step, rad/s; RUBBED: impulse of dry friction, N m s; GOOD and the next two: these three of
# the last solution found. BOUND: the greatest that dry friction gives in the step, N m s. LOWEST, HIGHEST: the relative
# rate after the step may be between these, rad/s. BEFORE: that before, rad/s. LEVER: length of the chain beyond the
# joint, m. CREEP: stiction tolerance of dry friction, rad/s, 0.0 without. FREE, FREE + 1: as ``Motion.joint``, without
# friction and limits. LINE, LINE + 1: of the line by which ``regularize`` replaces the law of dry
# friction, the impulse at the rate before, N m s, and by how much it falls with the rate, kg m^2.
SEARCHED = 3  # rows from START on
IMPULSE, START, AFTER, RUBBED, GOOD, _, _, BOUND, LOWEST, HIGHEST, BEFORE, LEVER, CREEP = range(13)
FREE, LINE, ROWS = 13, 15, 17


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
    modes = np.zeros((2, most), np.int64)
    values = zeros(most, most, (2, most), (2, most), most, most, most, most)
    return Impulses(*values, modes[0], modes[1], np.zeros(1), residual_power, loose)  # type: ignore[call-arg]


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
