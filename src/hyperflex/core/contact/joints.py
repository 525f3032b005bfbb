"""Joints in a step in contact: inelastic bend limits, dry and viscous friction, springs.

A joint is held at a limit where it would pass it; its mode says at which. Its impulse is then L = L0 - M (rate - limit)
by the proximal method, as for contacts: no more than a change of the joint's (T, kappa) in the sweep. Dry friction is
regularized and has no modes in the search: below it a joint creeps, see BEND_RATE.
"""

import math

from hyperflex.core import joint_law
from hyperflex.core.chain.articulated_body import joint_of, relative
from hyperflex.core.contact.arrays import (
    AFTER,
    AHEAD,
    BACK,
    BEFORE,
    BOUND,
    CREEP,
    FREE,
    HIGHEST,
    IMPULSE,
    LEVER,
    LINE,
    LOWER,
    LOWEST,
    OPEN,
    RELAXED,
    RUBBED,
    START,
    STICK,
    UPPER,
)
from hyperflex.core.integrate.events import limit_gap
from hyperflex.core.jit import non_allocating

# Numbers of joints with dry friction or limits in a contact step.
#
# rad, gap at which a limit is reached
LIMIT_REACHED = 1e-5
# rad, past a limit at which a step is tried again at half its length
LIMIT_PASSED = 2e-4
# rad/s, by which a rate must pass its bound to be held
JOINT_CLOSING = 1e-9
# rad/(s m), stiction tolerance of dry friction over the length of a link, at the usual tolerance of positions, and in
# proportion more at a larger one: a joint creeps at this times x / sqrt(1 - x^2) where its torque is x times the dry
# friction. At 0.7, a rope of 1 m that is bent to a circle takes 18 h to straighten. Two verified runs of wound ropes
# took 6 and 18 % longer with it than with a hundred times as much
BEND_RATE = 1e-4
# part of the dry friction by which a regularized one may miss its law at the usual tolerance of positions, and in
# proportion more at a larger one
RUBBING = 1e-3
# s, over which the present rate is extrapolated to a gap
SOON = 0.01

ANY = 1e9  # rad/s, bound of a rate that nothing holds


@non_allocating
def joint_mode(mode, rate, lower, upper, start, mass):  # type: ignore[no-untyped-def]
    """Angular impulse of a joint's limit, N m s, and the mode that it should have; start is L0, mass is M, kg m^2.

    `lower`, `upper` are bounds of the `rate`, rad/s.
    """
    if mode == OPEN:
        return 0.0, UPPER if rate > upper + JOINT_CLOSING else LOWER if rate < lower - JOINT_CLOSING else mode
    side, limit = (1.0, upper) if mode == UPPER else (-1.0, lower)
    impulse = start - mass * (rate - limit)
    return impulse, OPEN if side * impulse > 0.0 else mode


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
        last, bound = RELAXED * h * memory.torque[i], of[BOUND, i]
        of[CREEP, i] = BEND_RATE * workspace.impulses.loose * chain.length[i] if bound > 0.0 else 0.0
        held = memory.bent[i] >= UPPER
        joints.mode[i] = memory.bent[i] if held else OPEN
        of[AFTER, i] = rate + relative(motion.change, i, motion.base[2])
        of[RUBBED, i] = 0.0 if held else max(-bound, min(last, bound))
        of[START, i] = last - of[RUBBED, i]


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
def write_joints(motion, joints, penalty):  # type: ignore[no-untyped-def]
    """Write the joints, with their present modes, to ``motion.joint``; `penalty` is M of the contacts, kg."""
    of, joint = joints.of, motion.joint
    for i in joints.which:
        mode, torque, slope = joints.mode[i], 0.0, 0.0
        if mode != OPEN:
            slope = penalty * of[LEVER, i] * of[LEVER, i]
            torque = of[START, i] - slope * (of[BEFORE, i] - (of[HIGHEST, i] if mode == UPPER else of[LOWEST, i]))
        if of[CREEP, i] > 0.0:
            regularize(of, i)
            torque, slope = torque + of[LINE, i], slope + of[LINE + 1, i]
        joint[i, 0], joint[i, 1] = of[FREE, i] + torque, of[FREE + 1, i] + slope


@non_allocating
def update_joint_modes(motion, joints, penalty, change, loose):  # type: ignore[no-untyped-def]
    """Read rates and impulses off the changes of the rates; with `change`, change the modes that break the law.

    Returns how many broke it.
    """
    of, violations = joints.of, 0
    for i in joints.which:
        rate = of[BEFORE, i] + relative(motion.change, i, motion.base[2])
        mass = penalty * of[LEVER, i] * of[LEVER, i]
        if of[CREEP, i] > 0.0:
            of[RUBBED, i] = of[LINE, i] - of[LINE + 1, i] * (rate - of[BEFORE, i])
        of[AFTER, i] = rate
        violations += abs(of[RUBBED, i] - friction_law(joints, i)) > RUBBING * loose * of[BOUND, i]
        of[IMPULSE, i], new_mode = joint_mode(joints.mode[i], rate, of[LOWEST, i], of[HIGHEST, i], of[START, i], mass)
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
        lever, impulse = of[LEVER, i], of[IMPULSE, i]
        left = 0.0 if joints.mode[i] == OPEN else abs(impulse - of[START, i]) / (penalty * lever)
        worst, given = max(worst, left), given + left / lever * abs(impulse)
        of[START, i] = impulse
    return worst, given


@non_allocating
def regularize(of, i):  # type: ignore[no-untyped-def]
    """Linearize regularized friction at joint i about the last solution, to rows LINE and LINE + 1.

    These are the impulse L at the rate before the step, N m s, and by how much it falls with the rate. The law,
    L s = -bound w with s^2 = w^2 + tolerance^2, is linearized in both L and w, with L within the bound: the slope is
    never negative, and few rounds find joints that break loose (Chan, Golub and Mulet 1999,
    doi:10.1137/S1064827596299767).
    """
    bound, size = of[BOUND, i], math.sqrt(of[AFTER, i] ** 2 + of[CREEP, i] ** 2)
    last, part = max(-bound, min(of[RUBBED, i], bound)), of[AFTER, i] / size
    slope = (bound + last * part) / size
    of[LINE, i], of[LINE + 1, i] = last * part * part - slope * of[BEFORE, i], slope


@non_allocating
def obeys_friction(joints, loose):  # type: ignore[no-untyped-def]
    """Whether regularized friction obeys its law to within RUBBING times `loose`."""
    of, obeys = joints.of, True
    for i in joints.which:
        obeys = obeys and abs(of[RUBBED, i] - friction_law(joints, i)) <= RUBBING * loose * of[BOUND, i]
    return obeys


@non_allocating
def friction_law(joints, i):  # type: ignore[no-untyped-def]
    """Impulse of regularized friction at the rate after the step, N m s."""
    of = joints.of
    return (
        -of[BOUND, i] * of[AFTER, i] / math.sqrt(of[AFTER, i] ** 2 + of[CREEP, i] ** 2) if of[CREEP, i] > 0.0 else 0.0
    )


@non_allocating
def release_joints(joints):  # type: ignore[no-untyped-def]
    """Where no modes are found: limits hold nothing, and friction starts anew."""
    of = joints.of
    for i in joints.which:
        joints.mode[i], of[AFTER, i], of[RUBBED, i] = OPEN, of[BEFORE, i], 0.0


@non_allocating
def seen_mode(joints, i):  # type: ignore[no-untyped-def]
    """Mode of joint i after a step: its limit, or else whether it creeps (STICK) or turns against dry friction."""
    rate, creep = joints.of[AFTER, i], joints.of[CREEP, i]
    if joints.mode[i] != OPEN or creep == 0.0:
        return joints.mode[i]
    return STICK if abs(rate) <= creep else AHEAD if rate > 0.0 else BACK


@non_allocating
def joint_losses(joints):  # type: ignore[no-untyped-def]
    """Energy that dry friction and limits took in a step, J: impulses times mean rates."""
    of, friction, limits = joints.of, 0.0, 0.0
    for i in joints.which:
        mean = 0.5 * (of[BEFORE, i] + of[AFTER, i])
        friction -= of[RUBBED, i] * mean
        limits -= of[IMPULSE, i] * mean
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
