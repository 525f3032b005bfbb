"""Which joints slip and which stick at an instant, where dry friction holds what it can (M.16)."""

from __future__ import annotations

import numpy as np

from hyperflex.core.assign import assign
from hyperflex.core.chain.articulated_body import PRINTED, with_dry
from hyperflex.core.jit import kernel
from hyperflex.core.stiction.constraint_torques import STILL, at_rest, bear, hopeless, usual, widened, wider

SENSE = 1e-11  # part of the largest acceleration below which the sense of a joint's acceleration is rounding
CALM = 1e-8  # rad/s, slower than this a joint that chatters may be brought to rest


@kernel
def settled(chain, q, w, base, torque, chatter, grip, before, room):  # type: ignore[no-untyped-def]
    """Decide the modes after an event, or at a start; takes for rounding what would otherwise go on for ever.

    Parameters
    ----------
    chain, q, w, base, torque, grip, room : as in ``decide``; where joints chatter, `w` changes by up to CALM
    chatter : float
        Quick events so far.
    before : (n,) scratch

    Returns
    -------
    good : bool, False if no modes obey the law, or if joints chatter
    chatter : float, to go on with
    """
    n = q.size
    assign(before, grip)
    good = False
    while not (good or hopeless(chatter, n)):
        if chatter > usual(n):
            calm(chain, w, base, min(STILL * widened(chatter, n), CALM))
        good = decide(chain, q, w, base, torque, widened(chatter, n), grip, room)
        if not good:
            chatter = wider(chatter, n)
    if good and chatter > 0.0 and (grip == before).all():
        chatter = max(chatter, wider(0.0, n))  # an event after a quick one, and nothing has changed: rounding
    return good and not hopeless(chatter, n), chatter


@kernel
def calm(chain, w, base, still):  # type: ignore[no-untyped-def]
    """Bring joints with dry friction to rest in `w` (n,) that turn by no more than `still`, rad/s."""
    for i in range(w.size):
        up = w[i - 1] if i > 0 else base[3]
        if chain.dry[i] > 0.0 and abs(w[i] - up) <= still:
            w[i] = up


@kernel
def decide(chain, q, w, base, torque, widen, grip, room):  # type: ignore[no-untyped-def]
    """Find the modes at an instant: `grip` (n,) out, and accelerations and loads that go with them in `room`.

    Parameters
    ----------
    chain, q, w, base, torque : as in ``chain.accelerations``
    widen : float
        Factor on what a torque must exceed dry friction by; 1.0 unless joints chatter.

    Returns
    -------
    bool : False if no modes obey the law.
    """
    resting = 0
    for i in range(q.size):
        up = w[i - 1] if i > 0 else base[3]
        if chain.dry[i] == 0.0:
            grip[i] = 1.0
        elif at_rest(w[i], up):
            grip[i] = 0.0
            resting += 1
        else:
            grip[i] = 1.0 if w[i] > up else -1.0
    moved = np.zeros(q.size)
    if improve(chain, q, w, base, torque, widen, resting, moved, grip, room):
        return True
    while len(chain.bears) == len(PRINTED) and follow(chain, q, w, base, torque, moved, grip, room):
        at = lawless(chain, q, w, base, torque, widen, grip, room, False)
        if at < 0:
            return True
        if moved[at] == 1.0:
            return False
        moved[at] = 1.0
    return False


@kernel
def improve(chain, q, w, base, torque, widen, resting, moved, grip, room):  # type: ignore[no-untyped-def]
    """Change the modes of the `resting` joints at rest, all held in `grip` at first, until they obey the law.

    The one that breaks the law most is changed, a stuck one whose torque exceeds its dry friction to slip, a slipping
    one that would turn against its sense to stick. For friction that acts on both links this is a convex problem, and
    from a turn on the first that breaks the law is changed, a rule that ends. Returns False where it did not; `moved`
    (n,) is 1.0 for each joint that was changed.
    """
    patience = 2 * resting + 8
    for turn in range(patience if len(chain.bears) == len(PRINTED) else 20 + 12 * resting):
        at = lawless(chain, q, w, base, torque, widen, grip, room, turn >= patience)
        if at < 0:
            return True
        moved[at] = 1.0
        if grip[at] != 0.0:
            grip[at] = 0.0
        else:
            grip[at] = -1.0 if room.load[at] > 0.0 else 1.0
    return False


@kernel
def lawless(chain, q, w, base, torque, widen, grip, room, any_will_do):  # type: ignore[no-untyped-def]
    """Return the joint at rest that breaks the law most, or the first that does if any will do; -1: none."""
    bear(chain, q, w, grip, base, torque, room)
    largest = abs(base[2])
    for i in range(q.size):
        largest = max(largest, abs(room.alpha[i]))
    worst, at = 0.0, -1
    for i in range(q.size):
        if chain.dry[i] == 0.0 or not at_rest(w[i], w[i - 1] if i > 0 else base[3]):
            continue
        if grip[i] == 0.0:
            far = (abs(room.load[i]) - chain.dry[i] - widen * room.slack[i]) / chain.dry[i]
        else:
            up = room.alpha[i - 1] if i > 0 else base[2]
            far = -grip[i] * (room.alpha[i] - up) / (largest + 1e-300) - SENSE
        if far > worst and not (any_will_do and at >= 0):
            worst, at = far, i
    return at


@kernel
def follow(chain, q, w, base, torque, moved, grip, room):  # type: ignore[no-untyped-def]
    """Find modes of those joints at rest that have `moved` (n,), by following them from no dry friction in them to all.

    The other joints at rest are held, whatever that takes. Without friction each that has moved slips as it is pulled.
    As the friction grows, in proportion to `part`, the modes change one by one, and between two changes all loads and
    accelerations are linear in it. The way may lead back for a while, where what lets a joint slip is what holds it,
    but it cannot end: loads that obey the law solve a variational inequality on a box, and there are some for any
    friction (Hartman and Stampacchia 1966, doi:10.1007/BF02392210).

    Returns
    -------
    bool : False where rounding led astray.
    """
    n = q.size
    none, full = np.empty((2, n)), np.empty((2, n))
    for i in range(n):
        if at_rest(w[i], w[i - 1] if i > 0 else base[3]):
            grip[i] = moved[i] if chain.dry[i] > 0.0 else 1.0
    left(chain, q, w, base, torque, moved, 0.0, grip, room, none)
    for i in range(n):
        if none[0, i] < 0.0:
            grip[i] = -1.0
    part, way, last, side = 0.0, 1.0, -1, 0
    for _ in range(20 + 12 * int(moved.sum())):
        left(chain, q, w, base, torque, moved, 0.0, grip, room, none)
        left(chain, q, w, base, torque, moved, 1.0, grip, room, full)
        if last >= 0:  # what has just changed comes away from its limit
            way = 1.0 if full[side, last] > none[side, last] else -1.0
        far, last, side = first_change(none, full, part, way)
        if way > 0.0 and part + far >= 1.0:
            return True
        part += way * far
        if part < 0.0:
            return False
        if grip[last] == 0.0:
            grip[last], side = 2.0 * side - 1.0, 0
        else:
            grip[last], side = 0.0, 1 if grip[last] > 0.0 else 0
    return False


@kernel
def left(chain, q, w, base, torque, moved, part, grip, room, out):  # type: ignore[no-untyped-def]
    """How far each joint that has moved is from a change of its mode, if it has only a part of its dry friction.

    ``out`` (2, n): of a slipping joint its relative acceleration in its sense, rad/s^2, and 1.0; of a stuck one what it
    could bear beside its load in either sense, N m; 1.0 of any other.
    """
    dry = chain.dry * (1.0 - (1.0 - part) * moved)
    out[:] = 1.0
    bear(with_dry(chain, dry), q, w, grip, base, torque, room)
    for i in range(q.size):
        if moved[i] == 1.0 and grip[i] == 0.0:
            out[0, i], out[1, i] = dry[i] - room.load[i], dry[i] + room.load[i]
        elif moved[i] == 1.0:
            out[0, i] = grip[i] * (room.alpha[i] - (room.alpha[i - 1] if i > 0 else base[2]))


@kernel
def first_change(none, full, part, way):  # type: ignore[no-untyped-def]
    """How far from `part` the first of the margins (2, n), given at 0 and at 1, falls to zero; which, on which side."""
    far, at, at_side = np.inf, -1, 0
    for i in range(none.shape[1]):
        for side in range(2):
            slope = full[side, i] - none[side, i]
            if slope * way < 0.0:
                distance = max(0.0, none[side, i] + part * slope) / abs(slope)
                if distance < far:
                    far, at, at_side = distance, i, side
    return far, at, at_side
