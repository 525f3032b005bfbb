"""Articulated-body algorithm of the planar chain (Featherstone), energies, mass matrix.

Absolute link angles q: 0 hangs down, positive towards +x; d = (sin q, -cos q) points from a link's motor-side joint to
its far joint, n = (cos q, sin q). Joint i joins link i - 1 to link i; the parent of link 0 is the arm or the wall.
The derivation is in docs/models.md; equation numbers below refer to it.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core import joint_law
from hyperflex.core.chain.air import air_loads
from hyperflex.core.jit import constant, inlined, kernel, non_allocating, read, write

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
    drag: Array
    max_bend: Array
    tip_mass: float
    gx: float
    gy: float
    reaction: tuple[int, ...]  # one entry for each link on which a joint's friction acts: MUTUAL or ONE_SIDED

    @property
    def joints(self) -> tuple[Array, Array, Array, Array]:
        """All joints in the form of ``joint_law``."""
        return self.viscous, self.dry, self.stiffness, self.rest


# The compiler knows the length of a tuple, so each friction model gets kernels of its own.
MUTUAL = (0, 0)  # the link and its parent
ONE_SIDED = (0,)  # the link alone, as printed in the paper's (4)

BASE_SIZE = (
    9  # numbers of the first joint's motion, before the torques of motors in inner joints (``drive.base_state``)
)
WAY_BACK = tuple(range(4))  # of ``accelerations``' scratch, for each link
MANY_DRY = 16  # number of joints with dry friction from which their events determine the length of steps

_ONE_OVER_PI = 1.0 / math.pi
_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding and subtracting it rounds to the nearest integer
# pi in three parts; the first two have so few bits that a whole multiple of up to 2**20 of them is exact
_PI_A = float.fromhex("0x1.921fb50000000p+1")
_PI_B = float.fromhex("0x1.110b460000000p-25")
_PI_C = float.fromhex("0x1.1a62633145c07p-53")


@inlined
def sincos(x):  # type: ignore[no-untyped-def]
    """Sine and cosine of x (rad), |x| < 1e6, error below 3e-16 absolute; unlike libm's it runs in SIMD lanes.

    The argument is reduced to |y| <= pi / 2 by k half turns. (sin y - y) / y**3 and (cos y - 1 + y**2 / 2) / y**4 are
    polynomials in y**2 of degree 7 and 6, fitted there to the least greatest error (2e-18 and 6e-17 in the result).
    """
    k = (x * _ONE_OVER_PI + _ROUND) - _ROUND
    y = ((x - k * _PI_A) - k * _PI_B) - k * _PI_C
    odd = k - 2.0 * ((k * 0.5 + _ROUND) - _ROUND)  # -1 or 1 for an odd number of half turns, else 0
    sign = 1.0 - 2.0 * odd * odd
    z = y * y
    s = 2.7313970680544804e-15
    s = s * z - 7.643966058026537e-13
    s = s * z + 1.6058977158119707e-10
    s = s * z - 2.5052107614049077e-08
    s = s * z + 2.755731921913234e-06
    s = s * z - 0.0001984126984125481
    s = s * z + 0.008333333333333316
    s = s * z - 0.16666666666666666
    s = s * z * y + y
    c = 4.646439229147203e-14
    c = c * z - 1.1466252669080595e-11
    c = c * z + 2.0876681574932355e-09
    c = c * z - 2.755731857363305e-07
    c = c * z + 2.480158729891546e-05
    c = c * z - 0.0013888888888884772
    c = c * z + 0.04166666666666666
    c = c * z * z - 0.5 * z + 1.0
    return sign * s, sign * c


@inlined
def link_step(link, joint, free, reaction_factor, sin, cos, rate2, beyond):  # type: ignore[no-untyped-def]
    """One link of the sweep from tip to motor, (M.8)-(M.12).

    Parameters
    ----------
    link : (length, mass * com, inertia about the motor-side joint, mass)
    joint : (T, T_back, kappa, kappa_back)
        Joint torque T - kappa (alpha - alpha_up) on this link, N m; the part ``_back`` of it acts on the parent.
    free : float
        1.0; 0.0 for a stuck joint, which transmits any torque, so that alpha = alpha_up.
    reaction_factor : float
        Part of the torque of a stuck joint that acts on the parent: 1.0, or 0.0 for the printed friction model.
    sin, cos, rate2 : float
        Of this link's angle; its squared angular rate.
    beyond : (axx, axy, ayy, fx, fy, bx, by, s, beta, ayx, ux, uy)
        Response of the chain beyond this link's far joint, where p is the acceleration of that joint minus gravity and
        alpha the acceleration of this link: force A p + f alpha + b, torque u.p + s alpha + beta.

    Returns
    -------
    at : tuple
        The response at this link's motor-side joint.
    back : (r inv, ex inv, ey inv, k, inv)
        For the backward pass: alpha = inv (r - e.p) + k alpha_up, with inv = 1 / D and k = kappa / D; 0 and 1 if stuck.

    If friction is mutual, axy = ayx and f = u; callers pass the same value twice and the compiler removes the
    duplicates. Sums are grouped so that the response of the link beyond, which is available late, enters last.
    """
    length, ma, inertia, mass = link
    torque, torque_back, kappa, kappa_back = joint
    axx, axy, ayy, fx, fy, bx, by, s, beta, ayx, ux, uy = beyond
    lc = length * cos
    ls = length * sin
    lx = lc * axx + ls * axy
    ly = lc * ayx + ls * ayy
    gx = ma * cos + lx + fx  # force at the motor-side joint for a unit acceleration of this link
    gy = ma * sin + ly + fy
    ex = ma * cos + (lc * axx + ls * ayx) + ux  # moment on this link for a unit acceleration of its joint
    ey = ma * sin + (lc * axy + ls * ayy) + uy
    own = inertia + s
    cross = lc * (fx + ux) + ls * (fy + uy)
    rigid = (own + cross) + (lc * lx + ls * ly)  # D without kappa
    inv = free / (((own + kappa) + cross) + (lc * lx + ls * ly))
    lock = 1.0 - free
    k = kappa * inv + lock
    k_back = kappa_back * inv + reaction_factor * lock
    hx = rate2 * (ls * axx - lc * axy) - bx
    hy = rate2 * (ls * ayx - lc * ayy) - by
    r = torque - beta + (lc * hx + ls * hy) + rate2 * (ls * ux - lc * uy)
    turn = r * inv
    pull = ma * rate2
    at = (
        axx + mass - (gx * ex) * inv,
        axy - (gx * ey) * inv,
        ayy + mass - (gy * ey) * inv,
        gx * k,
        gy * k,
        gx * turn - hx - pull * sin,
        gy * turn - hy + pull * cos,
        k_back * rigid,
        torque_back - k_back * r,
        ayx - (gy * ex) * inv,
        k_back * ex,
        k_back * ey,
    )
    return at, (turn, ex * inv, ey * inv, k, inv)


@inlined
def mutual(beyond):  # type: ignore[no-untyped-def]
    """Return the response for friction that acts on both links: ayx = axy, (ux, uy) = (fx, fy)."""
    return *beyond[:9], beyond[1], beyond[3], beyond[4]


@inlined
def sines(q, out, at):  # type: ignore[no-untyped-def]
    """Write the sines of q (n,), rad, to ``out`` from `at` on, and then the cosines; runs in SIMD lanes."""
    n = q.size
    for i in range(n):
        sin, cos = sincos(q[i])
        out[at + i] = sin
        out[at + n + i] = cos


@inlined  # it returns references to arrays, which callers may not count
def chain_of_rows(rows, tip_mass, gx, gy, reaction):  # type: ignore[no-untyped-def]
    """Chain from its properties of links, `rows` (10 or more, n), in the order of its fields, and the rest."""
    links = (rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7], rows[8], rows[9])
    return Chain(*links, tip_mass, gx, gy, reaction)


@kernel
def with_dry(chain, dry):  # type: ignore[no-untyped-def]
    """Return the chain with other dry friction (n,), N m."""
    return Chain(*chain[:5], constant(dry), *chain[6:])  # type: ignore[call-arg]


@inlined
def relative(values, i, parent):  # type: ignore[no-untyped-def]
    """Difference between the value of link i and that of its parent, `parent` for the first link."""
    return values[i] - (values[i - 1] if i > 0 else parent)


@inlined
def motor_torque(base, torque, i):  # type: ignore[no-untyped-def]
    """Torque of all motors on link i, N m: `torque` of the first joint's motor, and those of inner joints in `base`."""
    return (torque if i == 0 else 0.0) + (base[BASE_SIZE + i] if BASE_SIZE + i < base.size else 0.0)


@inlined
def joint_of(chain, i):  # type: ignore[no-untyped-def]
    """Joint i in the form of ``joint_law``."""
    return chain.viscous[i], chain.dry[i], chain.stiffness[i], chain.rest[i]


@non_allocating
def accelerations(chain, q, w, slip, base, torque, h, alpha, work):  # type: ignore[no-untyped-def]
    """Angular accelerations of all links by one sweep to the motor and one back; O(n).

    Parameters
    ----------
    chain : Chain
    q, w : (n,) angles, rad, and rates, rad/s
    slip : (n,) sense in which each joint slips, 1.0 or -1.0; 0.0: it is stuck. Without dry friction 1.0
    base : (9 or more,) motion of the first joint and torques on the links, as ``drive.base_state`` writes it
    torque : float, external torque on link 0, N m
    h : float, 0.0 for the exact accelerations of (1); a step, s, for implicit joints (M.13)
    alpha : (n,) out, rad/s^2
    work : (6 n,) scratch

    Returns
    -------
    (Fx, Fy, N) : force on the rope at its first joint, N, and torque through that joint without `torque`, N m.
    """
    n = q.size
    reaction_factor = len(chain.reaction) - 1.0
    sines(q, work, 4 * n)
    air_x, air_y, _ = air_loads(chain, w, base, work, 0, 4)
    at = (chain.tip_mass, 0.0, chain.tip_mass, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for way in range(n):
        i = n - 1 - way
        angle = relative(q, i, base[4])
        rate = relative(w, i, base[3])
        t, t_back, kappa, kappa_back = joint_law.torques(joint_of(chain, i), reaction_factor, angle, rate, slip[i], h)
        t += work[4 * i] + motor_torque(base, torque, i)
        ma = chain.mass[i] * chain.com[i]
        link = (chain.length[i], ma, chain.inertia[i] + ma * chain.com[i], chain.mass[i])
        joint = (t, t_back, kappa, kappa_back)
        if reaction_factor == 1.0:
            at = mutual(at)
        at, back = link_step(
            link, joint, slip[i] * slip[i], reaction_factor, work[4 * n + i], work[5 * n + i], w[i] * w[i], at
        )
        write(work, 1, 4 * i, WAY_BACK, back[:4])
    px = base[0] - chain.gx
    py = base[1] - chain.gy
    up = base[2]
    axx, axy, ayy, fx, fy, bx, by, s, beta, ayx, ux, uy = at
    fx = axx * px + axy * py + fx * up + bx - air_x
    fy = ayx * px + ayy * py + fy * up + by - air_y
    moment = ux * px + uy * py + s * up + beta
    for i in range(n):
        r, ex, ey, k = read(work, 1, 4 * i, WAY_BACK)
        alpha[i] = up = r - ex * px - ey * py + k * up
        rate2, sin, cos = w[i] * w[i], work[4 * n + i], work[5 * n + i]
        px += chain.length[i] * (cos * up - sin * rate2)
        py += chain.length[i] * (sin * up + cos * rate2)
    return fx, fy, moment


# Whether dry friction may hold a joint: tuples, whose length the compiler knows, so that it omits stiction
SLIDING, STICKING = (), (0,)


@inlined
def can_stick(chain):  # type: ignore[no-untyped-def]
    """Whether dry friction may hold a joint."""
    return chain.dry.any()


@inlined
def has_limits(chain):  # type: ignore[no-untyped-def]
    """Whether any joint has a limit."""
    least = np.inf
    for limit in chain.max_bend:
        least = min(least, limit)
    return least < np.inf


@inlined
def sticks_often(chain):  # type: ignore[no-untyped-def]
    """Whether MANY_DRY joints or more may stick, so that their events, not the error, set the length of steps."""
    dry = 0
    for i in range(chain.dry.size):
        dry += chain.dry[i] > 0.0
    return dry >= MANY_DRY


@non_allocating
def lost_power(chain, w, slip, base, work):  # type: ignore[no-untyped-def]
    """Power that friction and the air take from the chain, W; arguments as ``accelerations`` takes and leaves them."""
    _, _, power = air_loads(chain, w, base, work, 0, 4)
    reaction_factor = len(chain.reaction) - 1.0
    up = base[3]
    for i in range(w.size):
        power += joint_law.power(joint_of(chain, i), reaction_factor, w[i], up, slip[i])
        up = w[i]
    return power


@non_allocating
def energies(chain, q, w, base, trig):  # type: ignore[no-untyped-def]
    """Kinetic and potential energy (gravity and springs; zero with all at the origin), J.

    `base` (9,) is the motion of the first joint (``drive.base_state``). The links' sines and cosines are written to the
    scratch array `trig` (2 n or more,).
    """
    angle, vx, vy, x, y = base[4], base[5], base[6], base[7], base[8]
    kinetic = potential = 0.0
    n = q.size
    sines(q, trig, 0)
    for i in range(n):
        sin, cos = trig[i], trig[n + i]
        a = chain.com[i]
        cvx = vx + a * cos * w[i]
        cvy = vy + a * sin * w[i]
        kinetic += 0.5 * chain.mass[i] * (cvx * cvx + cvy * cvy) + 0.5 * chain.inertia[i] * w[i] * w[i]
        potential -= chain.mass[i] * (chain.gx * (x + a * sin) + chain.gy * (y - a * cos))
        potential += joint_law.spring_energy(joint_of(chain, i), q[i] - angle)
        x += chain.length[i] * sin
        y -= chain.length[i] * cos
        vx += chain.length[i] * cos * w[i]
        vy += chain.length[i] * sin * w[i]
        angle = q[i]
    kinetic += 0.5 * chain.tip_mass * (vx * vx + vy * vy)
    potential -= chain.tip_mass * (chain.gx * x + chain.gy * y)
    return kinetic, potential


@kernel
def joints(length, q, base, out):  # type: ignore[no-untyped-def]
    """Joints from the first, `base` (T, 2), to the tip, `out` (T, n + 1, 2), m, at link angles q (T, n), rad.

    `length` (n,) is that of the links, m.
    """
    rows, n = q.shape
    reduced, trig = np.empty(n), np.empty(2 * n)
    for row in range(rows):
        x, y = base[row, 0], base[row, 1]
        out[row, 0, 0], out[row, 0, 1] = x, y
        for i in range(n):
            reduced[i] = q[row, i] if abs(q[row, i]) < 1e6 else q[row, i] % (2.0 * math.pi)  # in the range of sincos
        sines(reduced, trig, 0)
        for i in range(n):
            x += length[i] * trig[i]
            y -= length[i] * trig[n + i]
            out[row, i + 1, 0], out[row, i + 1, 1] = x, y


@non_allocating
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
