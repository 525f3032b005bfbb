"""Motion of a planar chain out of its plane, to first order: O(n) for each step and each motion.

Link i leans by a small angle phi_i out of the plane of the run q(t); x holds these angles, v their rates. The equations
are (M.40)-(M.45) of docs/models.md: those of a straight chain across the plane, M x'' = -K x - joints - air + loads.

Joints are hinges across the plane and across the link (universal joints), which resist bending alike in all directions
and carry twist. A link's small rotation is the vector rho = phi c + s d in the plane, c = d x z; its part s along the
link is the twist that the links before have given to it.
"""

import math

import numpy as np

from hyperflex.core import joint_law
from hyperflex.core.chain.air import drag_slopes, link_drag
from hyperflex.core.chain.articulated_body import joint_of, relative, sines
from hyperflex.core.chain.drive import motion_at
from hyperflex.core.jit import kernel, non_allocating

# rows of the work space for the planar motion at a time: sines and cosines, rates, stiffness K, torque of each joint and
# its friction, resistance of the air (three moments), speed along the link, forces on the link
SIN, COS, RATE, STIFF, TORQUE, FRICTION, AIR, ALONG, FX, FY = 0, 1, 2, 3, 4, 5, 6, 9, 10, 11
ROWS = 12
GAMMA = 0.5 + math.sqrt(3.0) / 6.0  # of the two-stage implicit Runge-Kutta method of order 3 (Crouzeix 1975)
SLOW = 1e-9  # rad/s: dry friction of a joint that turns slower holds it fast


@non_allocating
def planar_loads(chain, q, w, a, base, push, out):  # type: ignore[no-untyped-def]
    """Write what the planar motion q, w, a (n,) of a chain is to its motion sideways to the rows of `out` (ROWS, n).

    `base` (9,) is the motion of the first joint (``drive.base_state``), `push` a force on the tip, N, as (x, y).
    """
    n = q.size
    flat = out.reshape(-1)
    sines(q, flat, 0)
    px, py, vx, vy = base[0], base[1], base[5], base[6]
    for i in range(n):
        sin, cos, length, rate = out[SIN, i], out[COS, i], chain.length[i], w[i]
        bend_x, bend_y = a[i] * cos - rate * rate * sin, a[i] * sin + rate * rate * cos
        across, turn = vx * cos + vy * sin, length * rate
        resistance, _ = link_drag(chain.drag[i], length, across, turn)
        first, second, third = drag_slopes(chain.drag[i], length, across, turn)
        out[RATE, i], out[ALONG, i] = rate, vx * sin - vy * cos
        out[AIR, i], out[AIR + 1, i], out[AIR + 2, i] = 0.5 * first, 0.5 * second, 0.5 * third
        out[FX, i] = chain.mass[i] * (px + chain.com[i] * bend_x - chain.gx) + resistance * cos
        out[FY, i] = chain.mass[i] * (py + chain.com[i] * bend_y - chain.gy) + resistance * sin
        px, py = px + length * bend_x, py + length * bend_y
        vx, vy = vx + turn * cos, vy + turn * sin
        joint, bent = joint_of(chain, i), relative(q, i, base[4])
        speed = relative(w, i, base[3])
        out[TORQUE, i] = joint_law.friction(joint, speed, np.sign(speed)) + joint_law.spring(joint, bent)
        out[FRICTION, i] = chain.viscous[i] + chain.dry[i] / (abs(speed) + SLOW)
    sx, sy = chain.tip_mass * (px - chain.gx) - push[0], chain.tip_mass * (py - chain.gy) - push[1]
    for way in range(n):
        i = n - 1 - way
        sin, cos, fx, fy = out[SIN, i], out[COS, i], out[FX, i], out[FY, i]
        pull = chain.length[i] * (sin * sx - cos * sy) + chain.com[i] * (sin * fx - cos * fy)
        out[STIFF, i] = chain.inertia[i] * w[i] * w[i] - pull
        sx, sy = sx + fx, sy + fy


@non_allocating
def side_loads(chain, at, x, v, load, torque, force, moment, carry):  # type: ignore[no-untyped-def]
    """Torques (n, m), N m, and forces (n, m), N, that act on the links across the plane, but inertia; (M.41)-(M.43).

    Parameters
    ----------
    at : (ROWS, n), of ``planar_loads``
    x, v : (n, m) angles out of the plane, rad, and rates, rad/s, of m motions
    load : (2, n) given forces across the plane, N, and their moments about the links' first joints, N m
    torque, force : (n, m) out
    moment : (n, m) scratch
    carry : (5, m) scratch: rho and its rate, and the velocity of the joint
    """
    n, m = x.shape
    carry[:] = 0.0
    for i in range(n):
        sin, cos, rate, along = at[SIN, i], at[COS, i], at[RATE, i], at[ALONG, i]
        rub, stiff, twisting = at[FRICTION, i], chain.stiffness[i], at[TORQUE, i]
        first, second, third = at[AIR, i], at[AIR + 1, i], at[AIR + 2, i]
        for j in range(m):
            lean, swing = x[i, j], v[i, j]
            before = -cos * carry[0, j] - sin * carry[1, j]  # rotation of the link before, about c and d of this link
            twist = sin * carry[0, j] - cos * carry[1, j]
            before_rate = rate * twist - cos * carry[2, j] - sin * carry[3, j]
            twist_rate = sin * carry[2, j] - cos * carry[3, j] - rate * before
            moment[i, j] = rub * (swing - before_rate) + stiff * (lean - before) - twisting * twist
            a, b = swing - twist * rate, lean * rate + twist_rate
            carry[0, j], carry[1, j] = twist * sin - lean * cos, -lean * sin - twist * cos
            carry[2, j], carry[3, j] = b * sin - a * cos, -a * sin - b * cos
            drift = carry[4, j] - lean * along
            force[i, j] = load[0, i] - first * drift - second * swing
            torque[i, j] = load[1, i] - second * drift - third * swing - at[STIFF, i] * lean
            carry[4, j] += chain.length[i] * swing
    carry[:2] = 0.0
    beyond = 0.0
    for way in range(n):
        i = n - 1 - way
        sin, cos, twisting = at[SIN, i], at[COS, i], at[TORQUE, i] - beyond
        beyond = at[TORQUE, i]
        for j in range(m):
            own, along = moment[i, j], sin * carry[0, j] - cos * carry[1, j] + twisting * x[i, j]
            torque[i, j] -= own + cos * carry[0, j] + sin * carry[1, j]
            carry[0, j], carry[1, j] = along * sin - own * cos, -own * sin - along * cos


@non_allocating
def side_accelerations(chain, at, h, torque, force, out, link, answer):  # type: ignore[no-untyped-def]
    """Accelerations `out` (n, m), rad/s^2, of links that lean, under torques and forces (n, m) across the plane.

    ``out`` comes with a guess. Over a step h, s, stiffness and friction are implicit as of a straight chain (M.44):
    M out = torque - (h friction + h^2 stiffness)(out - guess).

    `link` (3, n) and `answer` (2, m) are scratch.
    """
    n, m = out.shape
    answer[:] = 0.0
    inert, pull, turn = chain.tip_mass, 0.0, 0.0
    for way in range(n):
        i = n - 1 - way
        length, ma = chain.length[i], chain.mass[i] * chain.com[i]
        kappa = h * at[FRICTION, i] + h * h * chain.stiffness[i]
        stiff = h * h * at[STIFF, i]
        e = ma + length * inert + pull
        own = chain.inertia[i] + ma * chain.com[i] + stiff + turn + length * (length * inert + 2.0 * pull)
        inv = 1.0 / (own + kappa)
        link[0, i], link[1, i], link[2, i] = e * inv, kappa * inv, inv
        for j in range(m):
            guess = out[i, j]
            up = out[i - 1, j] if i > 0 else 0.0
            back = kappa * (guess - up)
            r = torque[i, j] + stiff * guess + back - answer[1, j] - length * answer[0, j]
            torque[i, j] = r
            answer[0, j] += link[0, i] * r - force[i, j]
            answer[1, j] = back - link[1, i] * r
        inert, pull, turn = inert + chain.mass[i] - e * link[0, i], e * link[1, i], own * link[1, i]
    answer[:] = 0.0
    for i in range(n):
        for j in range(m):
            out[i, j] = link[2, i] * torque[i, j] - link[0, i] * answer[0, j] + link[1, i] * answer[1, j]
            answer[1, j] = out[i, j]
            answer[0, j] += chain.length[i] * out[i, j]


@non_allocating
def between(values, k, part, out):  # type: ignore[no-untyped-def]
    """Write angle, rate and acceleration `out` (3, n) at a part of the way from sample k to the next; quintic Hermite.

    `values` are samples (T,) of the time and (T, n) of the other three.
    """
    t, q, w, a = values
    h, s = t[k + 1] - t[k], part
    r = 1.0 - s
    for i in range(q.shape[1]):
        rise = q[k + 1, i] - q[k, i]
        c1, c2 = h * w[k, i], 0.5 * h * h * a[k, i]
        f0, f1, f2 = rise - c1 - c2, h * w[k + 1, i] - c1 - 2.0 * c2, h * h * a[k + 1, i] - 2.0 * c2
        c3, c4, c5 = 10.0 * f0 - 4.0 * f1 + 0.5 * f2, -15.0 * f0 + 7.0 * f1 - f2, 6.0 * f0 - 3.0 * f1 + 0.5 * f2
        out[0, i] = q[k, i] + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
        out[1, i] = (c1 + s * (2.0 * c2 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))) / h
        out[2, i] = (2.0 * c2 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))) / (h * h)


@kernel
def lean(chain, drive, values, load, push, x, v, parts, angles, rates):  # type: ignore[no-untyped-def]
    """Integrate m motions out of the plane over the samples of a run.

    Parameters
    ----------
    chain, drive : Chain, Drive
    values : (t (T,), q, w, a (T, n)), of the run
    load, push : as of ``side_loads`` and ``planar_loads``
    x, v : (n, m) at the first sample, rad and rad/s; those at the last one are left there
    parts : steps from sample to sample
    angles, rates : (T, n, m) out, rad and rad/s, or (0, n, m) for none
    """
    n, m = x.shape
    at, planar, base = np.empty((ROWS, n)), np.empty((3, n)), np.empty(9)
    torque, force, moment = np.empty((n, m)), np.empty((n, m)), np.empty((n, m))
    carry, link, answer = np.empty((5, m)), np.empty((3, n)), np.empty((2, m))
    acc, first = np.zeros((n, m)), np.zeros((n, m))
    xs, vs = np.empty((n, m)), np.empty((n, m))
    t = values[0]
    kept = angles.shape[0] > 0
    if kept:
        angles[0], rates[0] = x, v
    for k in range(t.size - 1):
        h = (t[k + 1] - t[k]) / parts
        for part in range(parts):
            for stage in range(2):
                c = GAMMA if stage == 0 else 1.0 - GAMMA
                s = (part + c) / parts
                between(values, k, s, planar)
                motion_at(drive, t[k] + s * (t[k + 1] - t[k]), base)
                planar_loads(chain, planar[0], planar[1], planar[2], base, push, at)
                step = GAMMA * h
                # the stage begins as an explicit one with what is known of the first, first; acc is its guess
                known = 0.0 if stage == 0 else (1.0 - 2.0 * GAMMA) * h
                for i in range(n):
                    for j in range(m):
                        begun = v[i, j] + known * first[i, j]
                        vs[i, j] = begun + step * acc[i, j]
                        xs[i, j] = x[i, j] + known * (v[i, j] + step * first[i, j]) + step * vs[i, j]
                side_loads(chain, at, xs, vs, load, torque, force, moment, carry)
                side_accelerations(chain, at, step, torque, force, acc, link, answer)
                if stage == 0:
                    first[:] = acc
            for i in range(n):
                for j in range(m):
                    one, two = first[i, j], acc[i, j]
                    early = v[i, j] + GAMMA * h * one
                    late = v[i, j] + (1.0 - 2.0 * GAMMA) * h * one + GAMMA * h * two
                    x[i, j] += 0.5 * h * (early + late)
                    v[i, j] += 0.5 * h * (one + two)
        if kept:
            angles[k + 1], rates[k + 1] = x, v
