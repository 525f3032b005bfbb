"""Motion of a planar chain out of its plane, to first order: O(n) for each step and each motion.

Link i leans by a small angle phi_i out of the plane of the run q(t); x holds these angles, v their rates. The equations
are (M.40)-(M.45) of docs/models.md: those of a straight chain across the plane, M x'' = -K x - joints - air + loads.

Joints are hinges across the plane and across the link (universal joints), which resist bending equally in all
directions and transmit twist. A link's small rotation is the vector rho = phi c + s d in the plane, c = d x z; its
component s along the link is the twist transmitted by the links before it.
"""

import math

import numpy as np

from hyperflex.core import joint_law
from hyperflex.core.chain.air import drag_slopes, link_drag
from hyperflex.core.chain.articulated_body import joint_of, sines
from hyperflex.core.chain.drive import motion_at, polynomial
from hyperflex.core.jit import kernel, non_allocating

# rows of the work space of a stage: sines and cosines (at last of the angle to the link before), rates, stiffness K,
# torque of each joint, speed along the link, forces on the link, resistance of the air (three moments), factors of the
# sweep
SIN, COS, RATE, STIFF, TORQUE, ALONG, FX, FY, AIR, PULL, CARRY, TWIST, INVERSE, SLOPE, KAPPA = *range(9), *range(11, 17)
ROWS = 17
GAMMA = 0.5 + math.sqrt(3.0) / 6.0  # of the two-stage implicit Runge-Kutta method of order 3 (Crouzeix 1975)


@non_allocating
def planar_loads(chain, q, w, a, base, push, h, out):  # type: ignore[no-untyped-def]
    """Write the coefficients of the motion out of the plane for a planar motion q, w, a (n,) to `out` (ROWS, n).

    `base` (9,) is the motion of the first joint (``drive.base_state``), `push` a force on the tip, N, as (x, y), h the
    time, s, over which stiffness and friction are implicit (M.44); with h = 0 the factors of the sweep in `out` stay.
    """
    n = q.size
    sines(q, out.reshape(-1), 0)
    px, py, vx, vy = base[0], base[1], base[5], base[6]
    angle, speed = base[4], base[3]
    for i in range(n):
        sin, cos, length, rate, mass = out[SIN, i], out[COS, i], chain.length[i], w[i], chain.mass[i]
        bend_x, bend_y = a[i] * cos - rate * rate * sin, a[i] * sin + rate * rate * cos
        out[FX, i] = mass * (px + chain.com[i] * bend_x - chain.gx)
        out[FY, i] = mass * (py + chain.com[i] * bend_y - chain.gy)
        out[RATE, i], out[ALONG, i] = vx, vy  # of the link's first joint
        px, py = px + length * bend_x, py + length * bend_y
        vx, vy = vx + length * rate * cos, vy + length * rate * sin
        joint = joint_of(chain, i)
        out[TORQUE, i] = joint_law.friction(joint, rate - speed, 0.0) + joint_law.spring(joint, q[i] - angle)
        angle, speed = q[i], rate
    for i in range(n):  # in SIMD lanes
        sin, cos, x, y, length = out[SIN, i], out[COS, i], out[RATE, i], out[ALONG, i], chain.length[i]
        across, turn = x * cos + y * sin, length * w[i]
        resistance, _ = link_drag(chain.drag[i], length, across, turn)
        first, second, third = drag_slopes(chain.drag[i], length, across, turn)
        out[AIR, i], out[AIR + 1, i], out[AIR + 2, i] = 0.5 * first, 0.5 * second, 0.5 * third
        out[FX, i] += resistance * cos
        out[FY, i] += resistance * sin
        out[RATE, i], out[ALONG, i] = w[i], x * sin - y * cos
    sx, sy = chain.tip_mass * (px - chain.gx) - push[0], chain.tip_mass * (py - chain.gy) - push[1]
    # The chain beyond a link resists the motion of its joint (bulk) and its twist (roll; both: cross).
    bulk, cross, roll, g, e = chain.tip_mass, 0.0, 0.0, 0.0, chain.length[n - 1] * chain.tip_mass
    own = chain.length[n - 1] * e
    for way in range(n):
        i = n - 1 - way
        sin, cos, fx, fy, length, com = out[SIN, i], out[COS, i], out[FX, i], out[FY, i], chain.length[i], chain.com[i]
        out[STIFF, i] = chain.inertia[i] * w[i] * w[i] - length * (sin * sx - cos * sy) - com * (sin * fx - cos * fy)
        sx, sy = sx + fx, sy + fy
        before = 0.0
        if i > 0:
            before, up, right = chain.length[i - 1], out[SIN, i - 1], out[COS, i - 1]
            sin, cos = sin * right - cos * up, cos * right + sin * up
            out[SIN, i], out[COS, i] = sin, cos
        if h == 0.0:
            continue
        slope, kappa = h * h * out[STIFF, i], h * (chain.viscous[i] + h * chain.stiffness[i])
        inv = 1.0 / (own + chain.inertia[i] + chain.mass[i] * com * com + slope + kappa)
        e += chain.mass[i] * com
        f, p = kappa * cos + g * sin - before * e, kappa * sin - g * cos
        out[PULL, i], out[CARRY, i], out[TWIST, i], out[INVERSE, i] = e * inv, f * inv, p * inv, inv
        out[SLOPE, i], out[KAPPA, i] = slope, kappa
        bulk += chain.mass[i]
        own = before * (before * bulk - 2.0 * sin * cross) + kappa * cos * cos + roll * sin * sin - f * f * inv
        g = cos * (before * cross + sin * (kappa - roll)) - f * p * inv
        bulk, cross, roll, e = (
            bulk - e * e * inv,
            cos * cross + e * p * inv,
            kappa * sin * sin + roll * cos * cos - p * p * inv,
            before * bulk - sin * cross + e * f * inv,
        )


@non_allocating
def side_accelerations(chain, at, x, v, load, out, work):  # type: ignore[no-untyped-def]
    """Accelerations `out` (n,), rad/s^2, of links that lean by x at rates v; (M.41)-(M.44).

    Parameters
    ----------
    at : (ROWS, n), of ``planar_loads``
    x, v : (n,) angles out of the plane, rad, and rates, rad/s
    load : (2, n) given forces across the plane, N, and their moments about the links' first joints, N m
    out : (n,) contains a guess on entry, for which x and v are the values at the end of its h
    work : (3, n) scratch
    """
    n = x.size
    past = twist = a = b = aside = 0.0  # of the link before: angles, and rates of its rho; the velocity of the joint
    up = turn = 0.0  # of the link before: the guess, and its component about the link
    for i in range(n):
        sin, cos, rate, lean, swing = at[SIN, i], at[COS, i], at[RATE, i], x[i], v[i]
        before, twist = cos * past + sin * twist, cos * twist - sin * past  # about c and d of this link
        before_rate = rate * twist + cos * a + sin * b
        bent = chain.stiffness[i] * (lean - before) - at[TORQUE, i] * twist
        work[0, i] = chain.viscous[i] * (swing - before_rate) + bent - at[KAPPA, i] * (out[i] - cos * up - sin * turn)
        up, turn = out[i], cos * turn - sin * up
        past, a, b = lean, swing - twist * rate, cos * b + (rate * (lean - before) - sin * a)
        drift = aside - lean * at[ALONG, i]
        work[1, i] = load[0, i] - at[AIR, i] * drift - at[AIR + 1, i] * swing
        work[2, i] = load[1, i] - at[AIR + 1, i] * drift - at[AIR + 2, i] * swing
        aside += chain.length[i] * swing
    sin = cos = own = along = beyond = pull = carry = twist = pushed = turned = torque = 0.0  # of the link beyond
    for way in range(n):
        i = n - 1 - way
        bent, along = cos * own - sin * along, cos * along + (sin * own + (at[TORQUE, i] - beyond) * x[i])
        own, beyond = work[0, i], at[TORQUE, i]
        known = work[2, i] + bent - own + at[SLOPE, i] * out[i] - at[STIFF, i] * x[i] - chain.length[i] * pushed
        known -= sin * turned
        pushed, turned = pushed - work[1, i] + pull * torque, cos * turned + twist * torque
        work[2, i] = torque = known + carry * torque
        sin, cos, pull, carry, twist = at[SIN, i], at[COS, i], at[PULL, i], at[CARRY, i], at[TWIST, i]
    moved = up = turn = length = 0.0
    for i in range(n):
        known = at[INVERSE, i] * work[2, i] - at[PULL, i] * moved + at[TWIST, i] * turn
        moved, turn, up = moved + length * up, at[COS, i] * turn - at[SIN, i] * up, known + at[CARRY, i] * up
        out[i], length = up, chain.length[i]


@non_allocating
def between(values, k, part, out):  # type: ignore[no-untyped-def]
    """Write angle, rate and acceleration `out` (3, n) at a fraction of the interval after sample k; quintic Hermite.

    `values` are samples (T,) of the time and (T, n) of the other three.
    """
    t, q, w, a = values
    h = t[k + 1] - t[k]
    for i in range(q.shape[1]):
        c1, c2 = h * w[k, i], 0.5 * h * h * a[k, i]
        f0, f1, f2 = q[k + 1, i] - q[k, i] - c1 - c2, h * w[k + 1, i] - c1 - 2.0 * c2, h * h * a[k + 1, i] - 2.0 * c2
        c3, c4, c5 = 10.0 * f0 - 4.0 * f1 + 0.5 * f2, -15.0 * f0 + 7.0 * f1 - f2, 6.0 * f0 - 3.0 * f1 + 0.5 * f2
        out[0, i], rate, acceleration = polynomial((q[k, i], c1, c2, c3, c4, c5), part)
        out[1, i], out[2, i] = rate / h, acceleration / (h * h)


@kernel
def lean(chain, drive, values, load, push, parts, angles, rates):  # type: ignore[no-untyped-def]
    """Integrate m motions out of the plane over the samples of a run.

    Parameters
    ----------
    chain, drive : Chain, Drive
    values : (t (T,), q, w, a (T, n)), of the run
    load, push : as for ``side_accelerations`` and ``planar_loads``
    parts : steps from sample to sample
    angles, rates : (T, m, n) out, rad and rad/s; those at the first sample are given
    """
    _, m, n = angles.shape
    at, planar, base = np.empty((ROWS, n)), np.empty((3, n)), np.empty(9)
    work, xs, vs = np.empty((3, n)), np.empty(n), np.empty(n)
    acc, first = np.zeros((m, n)), np.zeros((m, n))
    t = values[0]
    for k in range(t.size - 1):
        h = (t[k + 1] - t[k]) / parts
        step = GAMMA * h
        x, v = angles[k + 1], rates[k + 1]
        x[:], v[:] = angles[k], rates[k]
        for part in range(parts):
            # position of a stage in the step, and the weight of the first stage in it
            for place, weight in ((GAMMA, 0.0), (1.0 - GAMMA, 1.0 - 2.0 * GAMMA)):
                s, known = part + place, weight * h
                between(values, k, s / parts, planar)
                motion_at(drive, t[k] + s * h, base)
                planar_loads(chain, planar[0], planar[1], planar[2], base, push, 0.0 if known else step, at)
                for j in range(m):
                    for i in range(n):
                        vs[i] = v[j, i] + known * first[j, i] + step * acc[j, i]
                        xs[i] = x[j, i] + known * (v[j, i] + step * first[j, i]) + step * vs[i]
                    side_accelerations(chain, at, xs, vs, load, acc[j], work)
                if not known:
                    first[:] = acc
            for j in range(m):
                for i in range(n):
                    x[j, i] += h * (v[j, i] + 0.5 * h * ((1.0 - GAMMA) * first[j, i] + GAMMA * acc[j, i]))
                    v[j, i] += 0.5 * h * (first[j, i] + acc[j, i])
