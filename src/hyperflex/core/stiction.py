"""Dry friction in joints: constraint torques, margins to a change of mode, and the search for the modes (M.16).

A slipping joint has a constant friction torque against its sense of slipping. A stuck joint turns with its parent; its
constraint torque is at most the dry friction. The modes, `slip`, are constant within a step. A change of mode is an
event, and a step ends exactly there. The modes at an instant are found by an active-set search.
"""

from typing import Final, NamedTuple

import numpy as np

from hyperflex.core import joint_law
from hyperflex.core.assign import assign
from hyperflex.core.chain.air import air_loads
from hyperflex.core.chain.articulated_body import (
    ONE_SIDED,
    Array,
    accelerations,
    joint_of,
    motor_torque,
    relative,
    with_dry,
)
from hyperflex.core.jit import kernel, non_allocating, zeros


class Stiction(NamedTuple):
    """Tolerances of dry friction."""

    # links whose rates differ by at most this fraction of them, and
    same: float = 4e-15
    # rad/s, this much, rotate together: rounding of the arm's rate by one switch
    still: float = 1e-12
    # part of the dry friction, and
    slack: float = 1e-12
    # fraction of all torques on a link, by which a torque must exceed dry friction to count: above rounding
    noise: float = 1e-13
    # s, accuracy of the location of an event
    instant: float = 1e-13
    # s; event after event in steps shorter than this is chatter
    quick: float = 1e-9
    # powers of ten by which `slack` and `noise` are widened at most, see ``tolerance_factor``
    widest: float = 8.0
    # quick events in excess of the normal ones, after which joints chatter
    hopeless: float = 30.0
    # fraction of the largest acceleration below which the sign of a joint's acceleration is rounding
    sense: float = 1e-11
    # rad/s, slower than this a joint that chatters may be brought to rest
    calm: float = 1e-8


STICTION: Final = Stiction()


class StictionWorkspace(NamedTuple):
    """Working arrays for one chain of n links."""

    alpha: Array  # (n,)
    load: Array  # (n,) friction torque of each joint, N m
    slack: Array  # (n,) N m, excess over dry friction from which a torque counts
    work: Array  # (6 n,)
    state: Array  # (2 n,) angles and rates in the middle of a step
    margin: Array  # (2, n) margins in the middle of a step


@kernel
def new_stiction_workspace(n):  # type: ignore[no-untyped-def]
    """Working arrays for n links."""
    return StictionWorkspace(*zeros(n, n, n, 6 * n, 2 * n, (2, n)))


@non_allocating
def constraint_torques(chain, q, w, slip, base, torque, workspace):  # type: ignore[no-untyped-def]
    """Accelerations, and the friction torque of each joint, including stuck ones; two passes, O(n).

    Newton's and Euler's equations link by link, from the tip: independent of the elimination in the sweep. Arguments as
    in ``articulated_body.accelerations``; results in ``alpha``, ``load`` and ``slack`` of `workspace`.
    """
    n = q.size
    alpha, work = workspace.alpha, workspace.work
    accelerations(chain, q, w, slip, base, torque, 0.0, alpha, work)
    air_loads(chain, w, base, work, 2 * n, 1)
    px = base[0] - chain.gx
    py = base[1] - chain.gy
    for i in range(n):  # sines and cosines are those of the sweep; its other data for the backward pass are overwritten
        work[i], work[n + i] = px, py
        rate2 = w[i] * w[i]
        px += chain.length[i] * (work[5 * n + i] * alpha[i] - work[4 * n + i] * rate2)
        py += chain.length[i] * (work[4 * n + i] * alpha[i] + work[5 * n + i] * rate2)
    reaction_factor = len(chain.reaction) - 1.0
    fx = chain.tip_mass * px
    fy = chain.tip_mass * py
    back = size = 0.0
    for way in range(n):
        i = n - 1 - way
        sin, cos = work[4 * n + i], work[5 * n + i]
        px, py = work[i], work[n + i]
        mass, com, length = chain.mass[i], chain.com[i], chain.length[i]
        spring = joint_law.spring(joint_of(chain, i), relative(q, i, base[4]))
        external = work[2 * n + i] + motor_torque(base, torque, i)
        turn = (chain.inertia[i] + mass * com * com) * alpha[i]
        turn += mass * com * (cos * px + sin * py) + length * (cos * fx + sin * fy) + back
        size += mass * abs(com) * (abs(px) + abs(py)) + length * (abs(fx) + abs(fy)) + abs(spring) + abs(external)
        workspace.load[i] = turn - spring - external
        workspace.slack[i] = STICTION.slack * chain.dry[i] + STICTION.noise * size
        size = abs(turn)
        back = reaction_factor * workspace.load[i] + spring
        rate2 = w[i] * w[i]
        fx += mass * (px + com * (cos * alpha[i] - sin * rate2))
        fy += mass * (py + com * (sin * alpha[i] + cos * rate2))


@non_allocating
def chatter_allowance(n):  # type: ignore[no-untyped-def]
    """Quick events that are normal for n joints at rates near zero: each may stick, slip and stick again."""
    return 4.0 * n + 4.0


@non_allocating
def tolerance_factor(chatter, n):  # type: ignore[no-untyped-def]
    """Factor on ``STICTION.slack`` and `noise` after `chatter` quick events; above 1 beyond ``chatter_allowance``."""
    return 10.0 ** min(STICTION.widest, max(0.0, chatter - chatter_allowance(n)))


@non_allocating
def at_rest(rate, up):  # type: ignore[no-untyped-def]
    """Whether two links' rates are equal up to rounding."""
    return abs(rate - up) <= STICTION.still + STICTION.same * (abs(rate) + abs(up))


@non_allocating
def margins(chain, q, w, slip, base, torque, widen, workspace, out):  # type: ignore[no-untyped-def]
    """Write the constraint torques and the margins, see :func:`margins_of`."""
    constraint_torques(chain, q, w, slip, base, torque, workspace)
    margins_of(chain, w, slip, base, widen, workspace, out)


@non_allocating
def margins_of(chain, w, slip, base, widen, workspace, out):  # type: ignore[no-untyped-def]
    """Margin of each joint to a change of its mode, and its slope, from known constraint torques.

    ``out`` (2, n): for a slipping joint the relative rate in its sense, rad/s, and its derivative, rad/s^2; for a stuck
    one the distance of its load from its dry friction, as a fraction of the friction, and 0.0; inf without dry
    friction.
    """
    for i in range(w.size):
        out[0, i], out[1, i] = np.inf, 0.0
        if chain.dry[i] > 0.0 and slip[i] == 0.0:
            out[0, i] = 1.0 + (widen * workspace.slack[i] - abs(workspace.load[i])) / chain.dry[i]
        elif chain.dry[i] > 0.0:
            out[0, i] = slip[i] * relative(w, i, base[3])
            out[1, i] = slip[i] * relative(workspace.alpha, i, base[2])


@non_allocating
def project_stuck(chain, slip, q, base_before, out, base):  # type: ignore[no-untyped-def]
    """Project ``out`` (2 n + 2,) onto stuck joints: rates become the parents', angles between links stay.

    `q` (n or more,) are the angles at an earlier instant since which no mode has changed, with its base (9,).
    """
    n = slip.size
    for i in range(n):
        if chain.dry[i] > 0.0 and slip[i] == 0.0:
            out[n + i] = out[n + i - 1] if i > 0 else base[3]
            if i > 0:
                out[i] = out[i - 1] + (q[i] - q[i - 1])
            else:
                out[0] = base[4] + (q[0] - base_before[4])


@non_allocating
def stops(margin, i):  # type: ignore[no-untyped-def]
    """Whether slipping joint i is at rest by its margin and slope (2, n), or will be within an STICTION.instant."""
    return margin[0, i] + STICTION.instant * margin[1, i] <= 0.0


@non_allocating
def stop_joints(chain, slip, margin, out, base):  # type: ignore[no-untyped-def]
    """Set the rates of joints that have just stopped, and of stuck ones, to those of their parents."""
    n = slip.size
    for i in range(n):
        if chain.dry[i] > 0.0 and (slip[i] == 0.0 or stops(margin, i)):
            out[n + i] = out[n + i - 1] if i > 0 else base[3]


@non_allocating
def midpoint_state(step, q, w, alpha, out, workspace):  # type: ignore[no-untyped-def]
    """Middle of a step, to ``workspace.state``, from its ends: q, w, alpha (n,) before, ``out``, ``alpha`` after."""
    n = q.size
    for i in range(n):
        q1, w1, a1 = out[i], out[n + i], workspace.alpha[i]
        workspace.state[i] = 0.5 * (q[i] + q1) + step * (0.15625 * (w[i] - w1) + 0.015625 * step * (alpha[i] + a1))
        workspace.state[n + i] = 1.875 * (q1 - q[i]) / step - 0.4375 * (w[i] + w1) + 0.03125 * step * (a1 - alpha[i])


@non_allocating
def stuck_power(chain, w, slip, load):  # type: ignore[no-untyped-def]
    """Power that stuck joints take from the chain, W: none if their torques act on both links, which turn together."""
    power = 0.0
    if len(chain.reaction) == 1:
        for i in range(w.size):
            if slip[i] == 0.0:
                power -= load[i] * w[i]
    return power


@non_allocating
def stuck_loss(power, step, part):  # type: ignore[no-untyped-def]
    """Energy that stuck joints take in the first fraction `part` of a step, J; power (3,), W, at 0, 1/2 and 1 of it."""
    p0, pm, p1 = power
    slope, bend = 4.0 * pm - 3.0 * p0 - p1, 2.0 * (p0 - 2.0 * pm + p1)
    return step * part * (p0 + part * (slope / 2.0 + part * bend / 3.0))


@kernel
def decide_modes(chain, q, w, base, torque, chatter, slip, before, workspace):  # type: ignore[no-untyped-def]
    """Determine the modes after an event or at a start, with wider tolerances if joints chatter.

    Parameters
    ----------
    chain, q, w, base, torque, slip, workspace : as in ``decide``; chatter changes `w` by up to ``STICTION.calm``
    chatter : float
        Quick events so far.
    before : (n,) scratch

    Returns
    -------
    good : bool, False if no modes obey the law, or if joints chatter
    chatter : float, for the next event
    """
    n, good = q.size, False
    allowance = chatter_allowance(n)
    most = allowance + STICTION.hopeless
    assign(before, slip)
    while not good and chatter <= most:
        widen = tolerance_factor(chatter, n)
        for i in range(n if chatter > allowance else 0):  # joints that are nearly at rest are brought to rest
            up = w[i - 1] if i > 0 else base[3]
            if chain.dry[i] > 0.0 and abs(w[i] - up) <= min(STICTION.still * widen, STICTION.calm):
                w[i] = up
        good = find_modes(chain, q, w, base, torque, widen, slip, workspace)
        if not good:
            chatter = max(chatter, allowance) + 1.0
    if good and chatter > 0.0 and (slip == before).all():
        chatter = max(chatter, allowance + 1.0)  # an event after a quick one, and nothing has changed: rounding
    return good and chatter <= most, chatter


@kernel
def find_modes(chain, q, w, base, torque, widen, slip, workspace):  # type: ignore[no-untyped-def]
    """Find the modes at an instant and write them to `slip` (n,), with accelerations and loads in `workspace`.

    Parameters
    ----------
    chain, q, w, base, torque : as in ``articulated_body.accelerations``
    widen : float
        Factor on the tolerance of the dry friction; 1.0 unless joints chatter.

    Returns
    -------
    bool : False if no modes obey the law.
    """
    resting = 0
    for i in range(q.size):
        up = w[i - 1] if i > 0 else base[3]
        if chain.dry[i] == 0.0:
            slip[i] = 1.0
        elif at_rest(w[i], up):
            slip[i] = 0.0
            resting += 1
        else:
            slip[i] = 1.0 if w[i] > up else -1.0
    moved = np.zeros(q.size)
    if active_set_search(chain, q, w, base, torque, widen, resting, moved, slip, workspace):
        return True
    while len(chain.reaction) == len(ONE_SIDED) and continuation(chain, q, w, base, torque, moved, slip, workspace):
        at = worst_violation(chain, q, w, base, torque, widen, slip, workspace, False)
        if at < 0:
            return True
        if moved[at] == 1.0:
            return False
        moved[at] = 1.0
    return False


@non_allocating
def active_set_search(chain, q, w, base, torque, widen, resting, moved, slip, workspace):  # type: ignore[no-untyped-def]
    """Active-set search: change the modes of the `resting` joints, all stuck at first, until they obey (M.16).

    The joint with the largest violation of (M.16) changes: a stuck one whose torque exceeds its dry friction slips, a
    slipping one that would move against its sense sticks. If friction acts on both links, this is a convex problem;
    after a number of rounds the first violation is changed instead, a rule that terminates. Returns False if it did
    not; `moved` (n,) is 1.0 for each changed joint.
    """
    max_changes = 2 * resting + 8
    for turn in range(max_changes if len(chain.reaction) == len(ONE_SIDED) else 20 + 12 * resting):
        at = worst_violation(chain, q, w, base, torque, widen, slip, workspace, turn >= max_changes)
        if at < 0:
            return True
        moved[at] = 1.0
        if slip[at] != 0.0:
            slip[at] = 0.0
        else:
            slip[at] = -1.0 if workspace.load[at] > 0.0 else 1.0
    return False


@non_allocating
def worst_violation(chain, q, w, base, torque, widen, slip, workspace, any_will_do):  # type: ignore[no-untyped-def]
    """Return the joint at rest with the largest violation of (M.16), or with `any_will_do` the first one; -1: none."""
    constraint_torques(chain, q, w, slip, base, torque, workspace)
    largest = abs(base[2])
    for i in range(q.size):
        largest = max(largest, abs(workspace.alpha[i]))
    worst, at = 0.0, -1
    for i in range(q.size):
        if chain.dry[i] == 0.0 or not at_rest(w[i], w[i - 1] if i > 0 else base[3]):
            continue
        if slip[i] == 0.0:
            far = (abs(workspace.load[i]) - chain.dry[i] - widen * workspace.slack[i]) / chain.dry[i]
        else:
            far = -slip[i] * relative(workspace.alpha, i, base[2]) / (largest + 1e-300) - STICTION.sense
        if far > worst and not (any_will_do and at >= 0):
            worst, at = far, i
    return at


@kernel
def continuation(chain, q, w, base, torque, moved, slip, workspace):  # type: ignore[no-untyped-def]
    """Find modes of the joints at rest that have `moved` (n,), by continuation from zero to full dry friction.

    The other joints at rest are held by any torque. Without friction each moved joint slips in the direction of its
    load. As the friction grows, in proportion to `part`, the modes change one by one, and between two changes all loads
    and accelerations are linear in it. The path may turn back temporarily, but it cannot end: such loads solve a
    variational inequality on a box, which has a solution for any friction (Hartman and Stampacchia 1966,
    doi:10.1007/BF02392210).

    Returns
    -------
    bool : False if rounding has broken the path.
    """
    n = q.size
    none, full = np.empty((2, n)), np.empty((2, n))
    for i in range(n):
        if at_rest(w[i], w[i - 1] if i > 0 else base[3]):
            slip[i] = moved[i] if chain.dry[i] > 0.0 else 1.0
    continuation_margins(chain, q, w, base, torque, moved, 0.0, slip, workspace, none)
    for i in range(n):
        if none[0, i] < 0.0:
            slip[i] = -1.0
    part, way, last, side = 0.0, 1.0, -1, 0
    for _ in range(20 + 12 * int(moved.sum())):
        continuation_margins(chain, q, w, base, torque, moved, 0.0, slip, workspace, none)
        continuation_margins(chain, q, w, base, torque, moved, 1.0, slip, workspace, full)
        if last >= 0:  # a joint that has just changed moves away from its limit
            way = 1.0 if full[side, last] > none[side, last] else -1.0
        far, last, side = first_breakpoint(none, full, part, way)
        if way > 0.0 and part + far >= 1.0:
            return True
        part += way * far
        if part < 0.0:
            return False
        if slip[last] == 0.0:
            slip[last], side = 2.0 * side - 1.0, 0
        else:
            slip[last], side = 0.0, 1 if slip[last] > 0.0 else 0
    return False


@kernel
def continuation_margins(chain, q, w, base, torque, moved, part, slip, workspace, out):  # type: ignore[no-untyped-def]
    """Margins of the joints that have moved, with a fraction of their dry friction.

    ``out`` (2, n): for a slipping joint its relative acceleration in its sense, rad/s^2, and 1.0; for a stuck one its
    dry friction minus its load in either sense, N m; 1.0 for any other.
    """
    dry = chain.dry * (1.0 - (1.0 - part) * moved)
    out[:] = 1.0
    constraint_torques(with_dry(chain, dry), q, w, slip, base, torque, workspace)
    for i in range(q.size):
        if moved[i] == 1.0 and slip[i] == 0.0:
            out[0, i], out[1, i] = dry[i] - workspace.load[i], dry[i] + workspace.load[i]
        elif moved[i] == 1.0:
            out[0, i] = slip[i] * relative(workspace.alpha, i, base[2])


@non_allocating
def first_breakpoint(none, full, part, way):  # type: ignore[no-untyped-def]
    """Distance from `part` to the first zero of the margins (2, n), given at 0 and 1; its joint and side."""
    far, at, at_side = np.inf, -1, 0
    for i in range(none.shape[1]):
        for side in range(2):
            slope = full[side, i] - none[side, i]
            if slope * way < 0.0:
                distance = max(0.0, none[side, i] + part * slope) / abs(slope)
                if distance < far:
                    far, at, at_side = distance, i, side
    return far, at, at_side
