"""Observed quantities of a run at given states: accelerations, motion of the first joint, energies, loads."""

import numpy as np

from hyperflex.core.assign import assign
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import BASE_SIZE, energies
from hyperflex.core.chain.drive import base_size, motion_at
from hyperflex.core.jit import inlined, kernel
from hyperflex.core.stiction import find_modes, new_stiction_workspace


@inlined
def enter_state(j, chain, q, w, trig, base, torque, lanes, tip, motion):  # type: ignore[no-untyped-def]
    """Put a state into lane j to compute its accelerations, without a step of ``lanes.euler``.

    `trig` (2 n,) holds sines and cosines of q; `base` (9 or more,) goes to `motion` (9 or more, k), and `torque` is
    that of the first joint's motor, N m.
    """
    k = len(ln.COLUMNS)
    ln.set_state(j, q, w, trig, lanes)
    ln.set_base(j, chain, base, motion)
    tip[ln.STEP * k + j], tip[ln.EXTERNAL * k + j] = 0.0, torque


def senses(chain, drive, t, y):  # type: ignore[no-untyped-def]
    """Sense in which each joint slips (m, n), 1.0 or -1.0, or 0.0 where it sticks, at t (m,), y (m, 2 n or more).

    Without dry friction the sense has no effect: one row of 1.0.
    """
    dry = chain.dry.any()
    slip = np.ones((t.size if dry else 1, chain.length.size))
    if dry:
        write_senses(chain, drive, t, y, slip)
    return slip


@kernel
def write_senses(chain, drive, t, y, slip):  # type: ignore[no-untyped-def]
    """Write the result of :func:`senses` for a chain with dry friction to `slip`."""
    n = chain.length.size
    base, workspace = np.empty(base_size(drive)), new_stiction_workspace(n)
    for m in range(t.size):
        torque = motion_at(drive, t[m], base)
        find_modes(chain, y[m, :n], y[m, n : 2 * n], base, torque, 1.0, slip[m], workspace)


@kernel
def observe(chain, drive, t, y, slip, qdd, base_out, scalars):  # type: ignore[no-untyped-def]
    """Write accelerations, base motion, energies and motor torque at given states of a run.

    Parameters
    ----------
    t, y, slip : (m,) times, s; (m, 2 n or more) states; (m, n) or (1, n) as :func:`senses` returns it
    qdd : (m, n) out, rad/s^2
    base_out : (m, 9) out, motion of the first joint (``drive.base_state``)
    scalars : (m, 5) out: kinetic and potential energy, J; force x, y on the rope, N, and torque through joint 0, N m
    """
    n, k = chain.length.size, len(ln.COLUMNS)
    lanes, tip = ln.rows(ln.COLUMNS, n)
    ln.load(ln.COLUMNS, chain, lanes, tip)
    base, trig, motion = np.empty(base_size(drive)), np.empty(2 * n), np.zeros((base_size(drive), k))
    for first in range(0, t.size, k):
        last = min(first + k, t.size)
        for m in range(first, last):  # unused lanes keep their old state, or a chain at rest
            q, w = y[m, :n], y[m, n : 2 * n]
            torque = motion_at(drive, t[m], base)
            assign(base_out[m], base[:BASE_SIZE])
            scalars[m, 0], scalars[m, 1] = energies(chain, q, w, base, trig)
            enter_state(m - first, chain, q, w, trig, base, torque, lanes, tip, motion)
            if slip.shape[0] == t.size:  # else all slip, as in the lanes
                ln.set_lane_slip(ln.COLUMNS, m - first, lanes, slip[m])
        ln.euler(ln.COLUMNS, chain.reaction, ln.MORE, lanes, tip, motion)
        for m in range(first, last):
            j = m - first
            for i in range(n):
                qdd[m, i] = lanes[((i + 1) * ln.ROW + ln.ALPHA) * k + j]
            fx, fy, moment = ln.base_load(lanes, lanes[ln.ROW * k :], k, j, len(chain.reaction) - 1.0, motion)
            scalars[m, 2], scalars[m, 3], scalars[m, 4] = fx, fy, moment + tip[ln.EXTERNAL * k + j]
