"""The planar chain of rigid links: its parameters, the O(n) sweep, energies and mass-matrix entries.

Absolute link angles q: 0 hangs down, positive towards +x; d = (sin q, -cos q) points from a link's motor-side joint to
its far joint, n = (cos q, sin q). Joint i joins link i - 1 to link i; the parent of link 0 is the arm or the wall.
The derivation is in docs/models.md; equation numbers below refer to it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core.jit import inlined, kernel

Array = npt.NDArray[np.float64]


class Chain(NamedTuple):
    """Parameters of a chain, one entry a link (SI units); see :class:`hyperflex.model.Rope` for their meaning."""

    length: Array
    mass: Array
    com: Array
    inertia: Array
    viscous: Array
    dry: Array
    stiffness: Array
    rest: Array
    tip_mass: float
    gx: float
    gy: float
    reaction: float  # 1.0: friction acts back on the parent link; 0.0: as printed in the paper's (4)
    dry_rate: float  # rad/s, width of the smoothed Coulomb law dry * tanh(rate / dry_rate)


_TWO_OVER_PI = 2.0 / math.pi
_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding and taking it away rounds to the nearest integer
# pi / 2 in three parts; the first two have so few bits that a whole multiple of up to 2**20 of them is exact
_PIO2_A = float.fromhex("0x1.921fb50000000p+0")
_PIO2_B = float.fromhex("0x1.110b460000000p-26")
_PIO2_C = float.fromhex("0x1.1a62633145c07p-54")


@inlined
def sincos(x):  # type: ignore[no-untyped-def]
    """Sine and cosine of x (rad), |x| < 1e6, error below 3e-16 absolute; unlike libm's it runs in SIMD lanes.

    The argument is reduced to |y| <= pi / 4 and the Taylor series is summed up to y**15 and y**16, whose first
    neglected terms are 5e-17 and 3e-18.
    """
    k = (x * _TWO_OVER_PI + _ROUND) - _ROUND
    y = ((x - k * _PIO2_A) - k * _PIO2_B) - k * _PIO2_C
    j = k - 4.0 * ((k * 0.25 + _ROUND) - _ROUND)  # quadrant: -2, -1, 0, 1 or 2
    z = y * y
    s = -1.0 / 1307674368000.0
    s = s * z + 1.0 / 6227020800.0
    s = s * z - 1.0 / 39916800.0
    s = s * z + 1.0 / 362880.0
    s = s * z - 1.0 / 5040.0
    s = s * z + 1.0 / 120.0
    s = s * z - 1.0 / 6.0
    s = s * z * y + y
    c = 1.0 / 20922789888000.0
    c = c * z - 1.0 / 87178291200.0
    c = c * z + 1.0 / 479001600.0
    c = c * z - 1.0 / 3628800.0
    c = c * z + 1.0 / 40320.0
    c = c * z - 1.0 / 720.0
    c = c * z + 1.0 / 24.0
    c = c * z * z - 0.5 * z + 1.0
    p = j * j
    cj = 1.0 - p * (7.0 - p) / 6.0  # cos(j pi / 2) and sin(j pi / 2), exact, without a branch
    sj = j * (4.0 - p) / 3.0
    return s * cj + c * sj, c * cj - s * sj


@inlined
def link_step(link, joint, sin, cos, rate2, beyond):  # type: ignore[no-untyped-def]
    """One link of the sweep from tip to motor, (M.8)-(M.12).

    Parameters
    ----------
    link : (length, mass * com, inertia about the motor-side joint, mass)
    joint : (T, T_back, kappa, kappa_back)
        Joint torque T - kappa (alpha - alpha_up) on this link, N m; the part ``_back`` of it acts on the parent.
    sin, cos, rate2 : float
        Of this link's angle; its squared angular rate.
    beyond : (axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, s, beta)
        Answer of everything beyond this link's far joint, where p is that joint's acceleration less gravity and
        alpha the acceleration of this link: force A p + f alpha + b, torque u.p + s alpha + beta.

    Returns
    -------
    at : tuple
        The same answer at this link's motor-side joint.
    back : (r / D, ex / D, ey / D, kappa / D)
        For the way back: alpha = r / D - (e / D).p + (kappa / D) alpha_up.
    """
    length, ma, inertia, mass = link
    torque, torque_back, kappa, kappa_back = joint
    axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, s, beta = beyond
    anx = axx * cos + axy * sin
    any_ = ayx * cos + ayy * sin
    adx = axx * sin - axy * cos
    ady = ayx * sin - ayy * cos
    inv = 1.0 / (inertia + kappa + s + length * (length * (cos * anx + sin * any_) + cos * (fx + ux) + sin * (fy + uy)))
    ex = ma * cos + length * (axx * cos + ayx * sin) + ux  # moment on this link for a unit acceleration of its joint
    ey = ma * sin + length * (axy * cos + ayy * sin) + uy
    gx = (ma * cos + length * anx + fx) * inv  # force at the joint for a unit moment on this link
    gy = (ma * sin + length * any_ + fy) * inv
    r = (
        torque
        - beta
        - length * (cos * bx + sin * by)
        + length * rate2 * (length * (cos * adx + sin * ady) + ux * sin - uy * cos)
    )
    kd = kappa_back * inv
    at = (
        axx + mass - gx * ex,
        axy - gx * ey,
        ayx - gy * ex,
        ayy + mass - gy * ey,
        gx * kappa,
        gy * kappa,
        bx - rate2 * (length * adx + ma * sin) + gx * r,
        by - rate2 * (length * ady - ma * cos) + gy * r,
        kd * ex,
        kd * ey,
        kappa_back - kd * kappa,
        torque_back - kd * r,
    )
    return at, (r * inv, ex * inv, ey * inv, kappa * inv)


@inlined
def joint_torque(chain, i, angle, rate, h):  # type: ignore[no-untyped-def]
    """Torque of joint i at relative angle and rate, as ``link_step`` wants it; h > 0 makes it implicit over a step h.

    Returns (T, T_back, kappa, kappa_back), N m and kg m^2.
    """
    friction = -chain.viscous[i] * rate
    slope = chain.viscous[i]
    if chain.dry[i] != 0.0:
        u = math.tanh(rate / chain.dry_rate)
        friction -= chain.dry[i] * u
        slope += chain.dry[i] / chain.dry_rate * (1.0 - u * u)
    k = chain.stiffness[i]
    spring = -k * (angle - chain.rest[i] + h * rate)
    return (
        friction + spring,
        chain.reaction * friction + spring,
        h * slope + h * h * k,
        chain.reaction * h * slope + h * h * k,
    )


@kernel
def accelerations(chain, q, w, base, torque, h, alpha, work):  # type: ignore[no-untyped-def]
    """Angular accelerations of all links by one sweep to the motor and one back; O(n).

    Parameters
    ----------
    chain : Chain
    q, w : (n,) angles, rad, and rates, rad/s
    base : (7,) acceleration x, y of the first joint, m/s^2; alpha, rate, angle of the parent; velocity x, y, m/s
    torque : float, external torque on link 0, N m
    h : float, 0.0 for the exact accelerations of (1); a step, s, for implicit joints (M.13)
    alpha : (n,) out, rad/s^2
    work : (n, 8) scratch

    Returns
    -------
    (Fx, Fy, N) : force on the rope at its first joint, N, and torque through that joint without `torque`, N m.
    """
    n = q.size
    zero = 0.0
    at = (chain.tip_mass, zero, zero, chain.tip_mass, zero, zero, zero, zero, zero, zero, zero, zero)
    for k in range(n):
        i = n - 1 - k
        angle = q[i] - (q[i - 1] if i > 0 else base[4])
        rate = w[i] - (w[i - 1] if i > 0 else base[3])
        t, t_back, kappa, kappa_back = joint_torque(chain, i, angle, rate, h)
        if i == 0:
            t += torque
        ma = chain.mass[i] * chain.com[i]
        link = (chain.length[i], ma, chain.inertia[i] + ma * chain.com[i], chain.mass[i])
        sin, cos = sincos(q[i])
        at, back = link_step(link, (t, t_back, kappa, kappa_back), sin, cos, w[i] * w[i], at)
        work[i, 0], work[i, 1], work[i, 2], work[i, 3] = back
        work[i, 4] = sin
        work[i, 5] = cos
    px = base[0] - chain.gx
    py = base[1] - chain.gy
    up = base[2]
    fx = at[0] * px + at[1] * py + at[4] * up + at[6]
    fy = at[2] * px + at[3] * py + at[5] * up + at[7]
    moment = at[8] * px + at[9] * py + at[10] * up + at[11]
    for i in range(n):
        up = work[i, 0] - work[i, 1] * px - work[i, 2] * py + work[i, 3] * up
        alpha[i] = up
        rate2 = w[i] * w[i]
        px += chain.length[i] * (work[i, 5] * up - work[i, 4] * rate2)
        py += chain.length[i] * (work[i, 4] * up + work[i, 5] * rate2)
    return fx, fy, moment


@kernel
def friction_power(chain, w, base_rate):  # type: ignore[no-untyped-def]
    """Power that friction takes from the chain at rates w (n,), rad/s, and parent's rate; W."""
    power = 0.0
    up = base_rate
    for i in range(w.size):
        rate = w[i] - up
        torque = chain.viscous[i] * rate
        if chain.dry[i] != 0.0:
            torque += chain.dry[i] * math.tanh(rate / chain.dry_rate)
        power += torque * (w[i] - chain.reaction * up)
        up = w[i]
    return power


@kernel
def energies(chain, q, w, base):  # type: ignore[no-untyped-def]
    """Kinetic and potential energy (gravity and springs; zero with all at the origin), J.

    `base`: (6,) position x, y of the first joint, its velocity x, y, angle and rate of the parent.
    """
    x, y, vx, vy, angle, _ = base
    kinetic = 0.0
    potential = 0.0
    for i in range(q.size):
        sin, cos = sincos(q[i])
        a = chain.com[i]
        cvx = vx + a * cos * w[i]
        cvy = vy + a * sin * w[i]
        kinetic += 0.5 * chain.mass[i] * (cvx * cvx + cvy * cvy) + 0.5 * chain.inertia[i] * w[i] * w[i]
        potential -= chain.mass[i] * (chain.gx * (x + a * sin) + chain.gy * (y - a * cos))
        bend = q[i] - angle - chain.rest[i]
        potential += 0.5 * chain.stiffness[i] * bend * bend
        x += chain.length[i] * sin
        y -= chain.length[i] * cos
        vx += chain.length[i] * cos * w[i]
        vy += chain.length[i] * sin * w[i]
        angle = q[i]
    kinetic += 0.5 * chain.tip_mass * (vx * vx + vy * vy)
    potential -= chain.tip_mass * (chain.gx * x + chain.gy * y)
    return kinetic, potential


@kernel
def mass_matrix(chain, q, out):  # type: ignore[no-untyped-def]
    """Mass matrix (n, n) in absolute angles: M_ij = l_i p_j cos(q_i - q_j), i < j (M.4); kg m^2, written to `out`."""
    n = q.size
    outer = chain.tip_mass  # mass beyond link j
    for k in range(n):
        j = n - 1 - k
        p = chain.mass[j] * chain.com[j] + chain.length[j] * outer
        own = chain.mass[j] * chain.com[j] * chain.com[j] + chain.length[j] * chain.length[j] * outer
        out[j, j] = chain.inertia[j] + own
        for i in range(j):
            out[i, j] = chain.length[i] * p * math.cos(q[i] - q[j])
            out[j, i] = out[i, j]
        outer += chain.mass[j]
