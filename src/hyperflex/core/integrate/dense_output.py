"""Dense output: Hermite interpolation within a step, and what is observed at a sample."""

import math

import numpy as np

from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array, energies
from hyperflex.core.chain.drive import motion_at
from hyperflex.core.jit import inlined, kernel, non_allocating
from hyperflex.core.stiction import find_modes, new_stiction_workspace


def _hermite(derivatives: int) -> Array:
    """Coefficients (basis, power) of the Hermite basis on -1, 0, 1 with the given derivatives (0..k) at each node."""
    count = 3 * (derivatives + 1)
    rows = [
        [math.perm(power, d) * node ** (power - d) if power >= d else 0.0 for power in range(count)]
        for d in range(derivatives + 1)
        for node in (-1.0, 0.0, 1.0)
    ]
    return np.linalg.inv(np.array(rows)).T.copy()


_ANGLES = _hermite(2)  # (9, 9): value, first and second derivative at three nodes
_SUMS = _hermite(1)  # (6, 6): value and first derivative


@non_allocating
def basis(order, theta, weight):  # type: ignore[no-untyped-def]
    """Derivative of the given order of the interpolation's basis (9,) at theta; of values, rates and accelerations."""
    for b in range(9):
        total = 0.0
        for k in range(order, 9):
            factor = 1.0
            for m in range(order):
                factor *= k - m
            total += _ANGLES[b, k] * factor * theta ** (k - order)
        weight[b] = total


@kernel
def interpolate(theta, step, ys, dys, out):  # type: ignore[no-untyped-def]
    """State at theta in -1..1 within a step from its values ys (3, 2 n + 2) and derivatives dys at -1, 0, 1.

    Angles follow the polynomial of degree 8 through angles, rates and accelerations; rates are its derivative; work
    and dissipation follow one of degree 5. Not for the step behind a switch, where friction settles (docs/models.md).
    """
    n = (ys.shape[1] - 2) // 2
    half = 0.5 * step
    value = np.empty(9)
    slope = np.empty(9)
    basis(0, theta, value)
    basis(1, theta, slope)
    for i in range(n):
        q = w = 0.0
        for k in range(3):
            rate = half * ys[k, n + i]
            bend = half * half * dys[k, n + i]
            q += value[k] * ys[k, i] + value[3 + k] * rate + value[6 + k] * bend
            w += slope[k] * ys[k, i] + slope[3 + k] * rate + slope[6 + k] * bend
        out[i] = q
        out[n + i] = w / half
    for i in range(2 * n, 2 * n + 2):
        total = 0.0
        for b in range(6):
            node = b % 3
            weight = 0.0
            for k in range(6):
                weight += _SUMS[b, k] * theta**k
            total += weight * (ys[node, i] if b < 3 else half * dys[node, i])
        out[i] = total


@inlined
def enter_state(j, chain, q, w, trig, base, torque, lanes, tip, motion):  # type: ignore[no-untyped-def]
    """Put a state into lane j, for its accelerations: ``lanes.euler`` takes no step of it.

    `trig` (2 n,) holds sines and cosines of q; `base` (9,) goes to `motion` (9, k), and `torque` is the motor's, N m.
    """
    k, n = len(ln.COLUMNS), q.size
    for i in range(n):
        at = (i + 1) * ln.ROW * k + j
        lanes[at + ln.Q * k], lanes[at + ln.W * k] = q[i], w[i]
        lanes[at + ln.SIN * k], lanes[at + ln.COS * k] = trig[i], trig[n + i]
    ln.set_base(j, chain, base, motion)
    tip[ln.STEP * k + j], tip[ln.EXTERNAL * k + j] = 0.0, torque


def senses(chain, drive, t, y):  # type: ignore[no-untyped-def]
    """Sense in which each joint slips (m, n), 1.0 or -1.0, or 0.0 where it sticks, at t (m,), y (m, 2 n or more).

    Without dry friction it does not matter and is 1.0.
    """
    slip = np.ones((t.size, chain.length.size))
    if chain.dry.any():
        write_senses(chain, drive, t, y, slip)
    return slip


@kernel
def write_senses(chain, drive, t, y, slip):  # type: ignore[no-untyped-def]
    """Write to `slip` what :func:`senses` returns for a chain with dry friction."""
    n = chain.length.size
    base, workspace = np.empty(9), new_stiction_workspace(n)
    for m in range(t.size):
        torque = motion_at(drive, t[m], base)
        find_modes(chain, y[m, :n], y[m, n : 2 * n], base, torque, 1.0, slip[m], workspace)


@kernel
def observe(chain, drive, t, y, slip, qdd, base_out, scalars):  # type: ignore[no-untyped-def]
    """Write accelerations, base motion, energies and motor torque at given states of a run.

    Parameters
    ----------
    t, y, slip : (m,) times, s; (m, 2 n or more) states; (m, n) as :func:`senses` returns it
    qdd : (m, n) out, rad/s^2
    base_out : (m, 9) out, motion of the first joint (``drive.base_state``)
    scalars : (m, 5) out: kinetic and potential energy, J; force x, y on the rope, N, and torque through joint 0, N m
    """
    n, k = chain.length.size, len(ln.COLUMNS)
    lanes, tip = ln.rows(ln.COLUMNS, n)
    ln.load(ln.COLUMNS, chain, lanes, tip)
    trig, motion = np.empty(2 * n), np.zeros((9, k))
    for first in range(0, t.size, k):
        last = min(first + k, t.size)
        for m in range(first, last):  # lanes that are left over hold what they held, or a chain at rest
            base, q, w = base_out[m], y[m, :n], y[m, n : 2 * n]
            torque = motion_at(drive, t[m], base)
            scalars[m, 0], scalars[m, 1] = energies(chain, q, w, base, trig)
            enter_state(m - first, chain, q, w, trig, base, torque, lanes, tip, motion)
            ln.set_lane_slip(ln.COLUMNS, m - first, lanes, slip[m])
        ln.euler(ln.COLUMNS, chain.reaction, ln.MORE, lanes, tip, motion)
        for m in range(first, last):
            j = m - first
            for i in range(n):
                qdd[m, i] = lanes[((i + 1) * ln.ROW + ln.ALPHA) * k + j]
            fx, fy, moment = ln.base_load(lanes, lanes[ln.ROW * k :], k, j, len(chain.reaction) - 1.0, motion)
            scalars[m, 2], scalars[m, 3], scalars[m, 4] = fx, fy, moment + tip[ln.EXTERNAL * k + j]
