"""Dense output: Hermite interpolation within a step, and what is observed at a sample."""

import math

import numpy as np

from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array, dry_joints, energies
from hyperflex.core.chain.drive import base_state, segment
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
        lanes[((i + 1) * ln.ROW + ln.Q) * k + j] = q[i]
        lanes[((i + 1) * ln.ROW + ln.W) * k + j] = w[i]
        lanes[((i + 1) * ln.ROW + ln.SIN) * k + j] = trig[i]
        lanes[((i + 1) * ln.ROW + ln.COS) * k + j] = trig[n + i]
    tip[ln.STEP * k + j] = 0.0
    tip[ln.EXTERNAL * k + j] = torque
    for s in range(9):
        motion[s, j] = base[s]
    motion[0, j] -= chain.gx
    motion[1, j] -= chain.gy


def observe(chain, drive, t, y, qdd, base_out, scalars):  # type: ignore[no-untyped-def]
    """Write accelerations, base motion, energies and motor torque at given states of a run.

    Parameters
    ----------
    t : (m,) times, s; y : (m, 2 n + 2) states; at each, stiction holds what it can (``stiction.find_modes``)
    qdd : (m, n) out, rad/s^2
    base_out : (m, 9) out, motion of the first joint (``drive.base_state``)
    scalars : (m, 5) out: kinetic and potential energy, J; force x, y on the rope, N, and torque through joint 0, N m
    """
    observe_states(chain, drive, dry_joints(chain.dry), t, y, qdd, base_out, scalars)


@kernel
def observe_states(chain, drive, dry, t, y, qdd, base_out, scalars):  # type: ignore[no-untyped-def]
    """Do what :func:`observe` does; `dry` is SLIDING or STICKING."""
    n, k = chain.length.size, len(ln.COLUMNS)
    slip, workspace = np.ones(n), new_stiction_workspace(n)
    lanes, tip = ln.rows(ln.COLUMNS, n)
    ln.load(ln.COLUMNS, chain, lanes, tip)
    motion = np.zeros((9, k))
    for first in range(0, t.size, k):
        last = min(first + k, t.size)
        for m in range(first, last):  # lanes that are left over hold what they held, or a chain at rest
            base, q, w, trig = base_out[m], y[m, :n], y[m, n : 2 * n], workspace.work
            torque = base_state(drive, segment(drive, t[m]), t[m], base)
            if len(dry) > 0:
                find_modes(chain, q, w, base[:7], torque, 1.0, slip, workspace)
                ln.set_lane_slip(ln.COLUMNS, m - first, lanes, slip)
            point = (base[7], base[8], base[5], base[6], base[4], base[3])
            scalars[m, 0], scalars[m, 1] = energies(chain, q, w, point, trig)
            enter_state(m - first, chain, q, w, trig, base, torque, lanes, tip, motion)
        ln.euler(ln.COLUMNS, chain.reaction, ln.MORE, lanes, tip, motion)
        for m in range(first, last):
            j = m - first
            for i in range(n):
                qdd[m, i] = lanes[((i + 1) * ln.ROW + ln.ALPHA) * k + j]
            px, py, up = motion[0, j], motion[1, j], motion[2, j]
            top, answers, reaction_factor = lanes[: ln.ROW * k], lanes[ln.ROW * k :], len(chain.reaction) - 1.0
            fx, fy, moment = ln.base_load(top, answers, k, j, reaction_factor, px, py, up)
            scalars[m, 2], scalars[m, 3], scalars[m, 4] = fx, fy, moment + tip[ln.EXTERNAL * k + j]
