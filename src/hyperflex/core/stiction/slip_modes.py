"""Slip modes of joints with dry friction: an active-set search (M.16)."""

import numpy as np

from hyperflex.core.assign import assign
from hyperflex.core.chain.articulated_body import ONE_SIDED, with_dry
from hyperflex.core.jit import kernel, non_allocating
from hyperflex.core.stiction.constraint_torques import (
    STILL,
    at_rest,
    chatter_allowance,
    chatter_exceeded,
    constraint_torques,
    tolerance_factor,
    widened_count,
)

SENSE = 1e-11  # part of the largest acceleration below which the sense of a joint's acceleration is rounding
CALM = 1e-8  # rad/s, slower than this a joint that chatters may be brought to rest


@kernel
def decide_modes(chain, q, w, base, torque, chatter, slip, before, workspace):  # type: ignore[no-untyped-def]
    """Decide the modes after an event or at a start; where joints chatter, with wider tolerances.

    Parameters
    ----------
    chain, q, w, base, torque, slip, workspace : as in ``decide``; where joints chatter, `w` changes by up to CALM
    chatter : float
        Quick events so far.
    before : (n,) scratch

    Returns
    -------
    good : bool, False if no modes obey the law, or if joints chatter
    chatter : float, to go on with
    """
    n = q.size
    assign(before, slip)
    good = False
    while not (good or chatter_exceeded(chatter, n)):
        if chatter > chatter_allowance(n):
            stop_slow_joints(chain, w, base, min(STILL * tolerance_factor(chatter, n), CALM))
        good = find_modes(chain, q, w, base, torque, tolerance_factor(chatter, n), slip, workspace)
        if not good:
            chatter = widened_count(chatter, n)
    if good and chatter > 0.0 and (slip == before).all():
        chatter = max(chatter, widened_count(0.0, n))  # an event after a quick one, and nothing has changed: rounding
    return good and not chatter_exceeded(chatter, n), chatter


@non_allocating
def stop_slow_joints(chain, w, base, still):  # type: ignore[no-untyped-def]
    """Set the rates in `w` (n,) of dry joints slower than `still`, rad/s, to those of their parents."""
    for i in range(w.size):
        up = w[i - 1] if i > 0 else base[3]
        if chain.dry[i] > 0.0 and abs(w[i] - up) <= still:
            w[i] = up


@kernel
def find_modes(chain, q, w, base, torque, widen, slip, workspace):  # type: ignore[no-untyped-def]
    """Find the modes at an instant, to `slip` (n,), with their accelerations and loads in `workspace`.

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

    The joint that violates (M.16) most changes, a stuck one whose torque exceeds its dry friction to slip, a slipping
    one that would turn against its sense to stick. For friction that acts on both links this is a convex problem, and
    after some turns the first violation is changed instead, a rule that ends. Returns False where it did not; `moved`
    (n,) is 1.0 for each joint that was changed.
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
    """Return the joint at rest that violates (M.16) most, or with `any_will_do` the first; -1: none."""
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
            up = workspace.alpha[i - 1] if i > 0 else base[2]
            far = -slip[i] * (workspace.alpha[i] - up) / (largest + 1e-300) - SENSE
        if far > worst and not (any_will_do and at >= 0):
            worst, at = far, i
    return at


@kernel
def continuation(chain, q, w, base, torque, moved, slip, workspace):  # type: ignore[no-untyped-def]
    """Find modes of the joints at rest that have `moved` (n,), by continuation from no dry friction to all of it.

    The other joints at rest are held, whatever that takes. Without friction each that has moved slips as it is pulled.
    As the friction grows, in proportion to `part`, the modes change one by one, and between two changes all loads and
    accelerations are linear in it. The path may turn back for a while, but it cannot end: such loads solve a
    variational inequality on a box, which has a solution for any friction (Hartman and Stampacchia 1966,
    doi:10.1007/BF02392210).

    Returns
    -------
    bool : False where rounding has broken the path.
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
        if last >= 0:  # what has just changed comes away from its limit
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
    """Margins of the joints that have moved, with only a part of their dry friction.

    ``out`` (2, n): of a slipping joint its relative acceleration in its sense, rad/s^2, and 1.0; of a stuck one its
    dry friction less its load in either sense, N m; 1.0 of any other.
    """
    dry = chain.dry * (1.0 - (1.0 - part) * moved)
    out[:] = 1.0
    constraint_torques(with_dry(chain, dry), q, w, slip, base, torque, workspace)
    for i in range(q.size):
        if moved[i] == 1.0 and slip[i] == 0.0:
            out[0, i], out[1, i] = dry[i] - workspace.load[i], dry[i] + workspace.load[i]
        elif moved[i] == 1.0:
            out[0, i] = slip[i] * (workspace.alpha[i] - (workspace.alpha[i - 1] if i > 0 else base[2]))


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
