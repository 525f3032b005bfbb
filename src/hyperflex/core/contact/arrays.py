"""Arrays of the search for contact modes: impulses of the contacts, and the motion that they change."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.contact.gaps import Index
from hyperflex.core.jit import kernel

OPEN, STICK, AHEAD, BACK = range(4)  # modes; the last two: the rope slips along the tangent, or against it


class Impulses(NamedTuple):
    """Of each of the contacts found, in their order; and of the search for their modes."""

    normal: Array  # (K,) N s
    tangent: Array
    normal0: Array  # where the proximal method starts from
    tangent0: Array
    target: Array  # (K,) m/s, the normal velocity may be as low as minus this
    lean: Array  # (K,) m/s, and what sticks has the tangential velocity minus this, against the peg
    vn: Array  # (K,) velocity of the point at the end of the step, m/s
    vt: Array  # less that of a peg that turns, without `lean`
    good_normal: Array  # normal0, tangent0 and mode of the last solution found
    good_tangent: Array
    mode: Index
    good_mode: Index
    closed: Index  # how often each closed in this search
    heavy: Array  # (1,) kg, mass M with which the search starts, then that for the next one; 0: the usual one
    gift: float  # W, power that residual velocities may have


class Motion(NamedTuple):
    """Rates before and after a step and what moves them."""

    w: Array  # (n,) before
    change: Array  # (n,)
    rho: Array  # (n,)
    joint: Array  # (n, 2)
    touch: Array  # (n, 12)
    trig: Array  # (2 n,)
    speed: Array  # (2, n + 1) velocities of the joints at the rates before, in the middle's configuration
    place: Array  # (2, n)
    turned: Array  # (2, n + 1) what `place` lacks of the change of the joints' velocities, m/s
    base: Array  # (3,)
    tip: Array  # (2,)
    load: Array  # (3,) out, impulse at the first joint
    work: Array  # (4 n,)


@kernel
def new_impulses(most, gift):  # type: ignore[no-untyped-def]
    """Impulses of at most so many contacts, whose residual velocities may have the power `gift`, W."""
    ten = np.zeros((10, most))
    modes = np.zeros((3, most), np.int64)
    return Impulses(
        ten[0],
        ten[1],
        ten[2],
        ten[3],
        ten[4],
        ten[5],
        ten[6],
        ten[7],
        ten[8],
        ten[9],
        modes[0],
        modes[1],
        modes[2],
        np.zeros(1),
        gift,
    )


@kernel
def new_motion(n):  # type: ignore[no-untyped-def]
    """Arrays for n links."""
    return Motion(
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, 2)),
        np.zeros((n, 12)),
        np.zeros(2 * n),
        np.zeros((2, n + 1)),
        np.zeros((2, n)),
        np.zeros((2, n + 1)),
        np.zeros(3),
        np.zeros(2),
        np.zeros(3),
        np.zeros(4 * n),
    )
