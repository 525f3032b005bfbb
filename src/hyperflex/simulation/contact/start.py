"""Checks of the start: outside obstacles, and within the joint limits."""

import numpy as np

from hyperflex.checks import Array
from hyperflex.core.chain.drive import motion_at
from hyperflex.core.contact.gaps import Pegs
from hyperflex.errors import InvalidInput
from hyperflex.model import Setup, Wall

SHALLOW = 5e-4  # m, penetration that may be there at the start: a polygon laid on a circle by its joints has some
PASSED = 1e-3  # rad, by which a joint may be past its limit at the start


def check_outside(setup: Setup, t: float = 0.0, q: Array | None = None, who: str = "the rope") -> None:
    """Refuse a start at t, s, whose rope is inside an obstacle by more than SHALLOW.

    q (n,), rad, are the angles of the chain's links there, by default those that the set-up starts from; the message is
    about `who`, and names the link that is deepest inside, the obstacle and the depth.
    """
    if not setup.pegs:
        return
    chain, drive, pegs = setup.chain(), setup.drive(), setup.contacts()
    q = setup.start()[0] if q is None else q
    base = np.empty(9)
    motion_at(drive, t, base)
    steps = chain.length[:, None] * np.stack([np.sin(q), -np.cos(q)], axis=1)
    joints = np.concatenate([base[None, 7:9], base[7:9] + np.cumsum(steps, axis=0)])
    found = depths(pegs, joints)
    i, p = np.unravel_index(int(np.argmax(found)), found.shape)
    if found[i, p] <= SHALLOW:
        return
    rows = [each for each in setup.pegs for _ in range(3 if isinstance(each, Wall) else 1)]  # as ``packed`` makes them
    raise InvalidInput(
        f"{who} starts inside an obstacle: link {i - pegs.first} is {1e3 * found[i, p]:.3g} mm deep in it",
        got=rows[p],
        allowed=f"at most {1e3 * SHALLOW:g} mm",
        fix="Give a q0 that keeps clear of it, or move the obstacle",
    )


def check_start(setup: Setup, t: float = 0.0, q: Array | None = None, who: str = "the rope") -> None:
    """Refuse a start inside an obstacle or past a joint's limit; arguments as for :func:`check_outside`."""
    check_outside(setup, t, q, who)
    check_limits(setup, t, q, who)


def check_limits(setup: Setup, t: float = 0.0, q: Array | None = None, who: str = "the rope") -> None:
    """Refuse a start with a joint bent past its limit by more than PASSED; arguments as for :func:`check_outside`."""
    if not setup.rope.limited:
        return
    chain, drive, base = setup.chain(), setup.drive(), np.empty(9)
    motion_at(drive, t, base)
    bend = np.diff(setup.start()[0] if q is None else q, prepend=base[4]) - chain.rest
    past = np.abs(bend) - chain.max_bend
    i = int(np.argmax(past))
    if past[i] > PASSED:
        raise InvalidInput(
            f"{who} starts past a limit: joint {i - int(setup.torque_driven)} is bent by {bend[i]:+.4g} rad from rest",
            got=float(bend[i]),
            allowed=f"at most max_bend = {chain.max_bend[i]:.4g} rad",
            fix="Give a q0 that bends less there, or max_bend = inf for a joint that turns freely",
        )


def depths(pegs: Pegs, joints: Array) -> Array:
    """Return how deep each link is in each obstacle (n, m), m; negative where it is clear; joints (n + 1, 2), m.

    A link across a wall counts as deep as the nearer of its ends is far from it, and the reach.
    """
    begin, end = joints[:-1], joints[1:]
    n, m = begin.shape[0], pegs.x.size
    result = np.full((n, m), -np.inf)
    for p in range(m):
        centre, along = np.array([pegs.x[p], pegs.y[p]]), np.array([pegs.ux[p], pegs.uy[p]])
        if pegs.span[p] == 0.0:
            link = end - begin
            part = np.clip(((centre - begin) * link).sum(axis=1) / (link**2).sum(axis=1), 0.0, 1.0)
            result[:, p] = pegs.reach[p] - np.hypot(*(begin + part[:, None] * link - centre).T)
            continue
        s, d = (joints - centre) @ along, (joints - centre) @ np.array([-along[1], along[0]])
        if pegs.span[p] == np.inf:
            result[:, p] = pegs.reach[p] - d[1:]
            continue
        within = (s[1:] >= 0.0) & (s[1:] <= pegs.span[p])
        result[within, p] = pegs.reach[p] - np.abs(d[1:][within])
        crossing = d[:-1] * d[1:] < 0.0
        part = np.where(crossing, d[:-1] / np.where(crossing, d[:-1] - d[1:], 1.0), 0.0)
        at = s[:-1] + part * (s[1:] - s[:-1])
        across = crossing & (at >= 0.0) & (at <= pegs.span[p])
        result[across, p] = pegs.reach[p] + np.minimum(np.abs(d[:-1]), np.abs(d[1:]))[across]
    result[: pegs.first] = -np.inf
    return result
