"""Tangent of one linearly implicit Euler step, two directions at a time.

A direction is a change of the state, of the parameters, of the base's motion or of the step's length. Its first-order
effect obeys the equations of the step with another right-hand side, (M.19)-(M.22), so the factors of the step in the
lanes are reused: no sine, no division. The slots below are in the lanes' rows, in place of those that only whole
rollouts use; two directions together make a loop body that is large enough for the compiler to use packed instructions
(core/chain/lanes.py says more; tests/core/test_tangent.py checks it). As there, a quantity is at its slot times K from
the offset of its row and lane, and at K more for the second direction.
"""

from hyperflex.core import joint_law
from hyperflex.core.chain import lanes as ln
from hyperflex.core.jit import inlined, non_allocating, read, write

K = len(ln.COLUMNS)
# derivatives of angle and rate, of the right-hand side over D; on the way to the motor those of the answer's constant
# terms, on the way back those of the far joint's acceleration and of the link's (each for both directions)
DQ, DW, RHS, BX, BY, BETA = range(ln.Q_START, ln.Q_START + 12, 2)
PX, PY, ALPHA = BX, BY, BETA
# rate before the step, sine and cosine of the angle
BEFORE, SIN, COS = range(DQ + 12, DQ + 15)
# factors of the derivatives of angle and rate in the moment and in the force (M.21), in slots that are free after a
# step
BY_STATE = BY_Q, BY_W, QX, QY, WX, WY = ln.RD, ln.S, ln.BETA, ln.DISSIPATED, ln.LOST, ln.WORK
# the seeds of a direction for one link: changes of its parameters
LENGTH, MASS, MA, INERTIA, VISCOUS, STIFFNESS, REST, DRY, DRAG = range(9)
SEEDS = 9
MOTORS = ln.EXTERNAL  # in row 0: more than 0.0 where inner joints have motors, whose torques RHS of the links holds
STATE, ALL = (), (0,)  # tuples, for the compiler to know: see ``step``


@inlined
def joint_motion(row, up, at, first):  # type: ignore[no-untyped-def]
    """Difference of a joint's angle at the end of the step, less the rest angle, and of its rate before the step."""
    q, rest, w, h = read(row, K, at, (ln.Q, ln.REST, BEFORE, ln.STEP))
    q_up, w_up, alpha_up = read(row, K, up, (ln.Q, ln.W, ln.ALPHA))
    up_end = w_up + first * h * alpha_up  # row 0 is the parent's motion before the step
    return q - q_up - rest - first * h * up_end, w - up_end + h * alpha_up


@non_allocating
def save_trig(lanes):  # type: ignore[no-untyped-def]
    """Keep the sines and cosines that ``lanes.euler`` will overwrite; called before it."""
    n = lanes.size // (ln.ROW * K) - 2
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * K : (i + 1) * ln.ROW * K]
        for j in range(K):
            write(row, K, j, (SIN, COS), read(row, K, j, (ln.SIN, ln.COS)))


@non_allocating
def prepare(reaction, lanes):  # type: ignore[no-untyped-def]
    """Compute BEFORE and BY_Q to WY from the results of ``lanes.euler``; once per step, for all directions."""
    reaction_factor = len(reaction) - 1.0
    n = lanes.size // (ln.ROW * K) - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ln.ROW * K : (i + 2) * ln.ROW * K]
        for j in range(K):
            up, at, down = ln.UP * K + j, ln.AT * K + j, ln.DOWN * K + j
            length, ma, w_end, h = read(row, K, at, (ln.LENGTH, ln.MA, ln.W, ln.STEP))
            sin, cos, far_x, far_y, alpha = read(row, K, at, (SIN, COS, *ln.MOTION))
            w, (px, py) = w_end - h * alpha, read(row, K, up, (ln.PX, ln.PY))
            axx, axy, ayy, fx, fy, bx, by, _, _, ayx, ux, uy = ln.load_answer(row, K, down, reaction_factor)
            force_x = axx * far_x + axy * far_y + fx * alpha + bx
            force_y = ayx * far_x + ayy * far_y + fy * alpha + by
            vx, vy = sin * alpha + cos * w * w, sin * w * w - cos * alpha
            avx, avy = axx * vx + axy * vy, ayx * vx + ayy * vy
            adx, ady = axx * sin - axy * cos, ayx * sin - ayy * cos
            by_q = ma * (px * sin - py * cos) + length * (sin * force_x - cos * force_y + ux * vx + uy * vy)
            by_q += length * length * (cos * avx + sin * avy)
            by_w = 2.0 * length * w * (ux * sin - uy * cos + length * (cos * adx + sin * ady))
            force_by_q = length * avx + ma * vx, length * avy + ma * vy
            force_by_w = 2.0 * w * (length * adx + ma * sin), 2.0 * w * (length * ady - ma * cos)
            write(row, K, at, (*BY_STATE, BEFORE), (by_q, by_w, *force_by_q, *force_by_w, w))


@inlined
def link_factors(row, at, down, reaction_factor):  # type: ignore[no-untyped-def]
    """Factors of the derivatives of a link's state and of the response beyond it, (M.21)."""
    length, inv, h, sin, cos = read(row, K, at, (ln.LENGTH, ln.INV, ln.STEP, SIN, COS))
    nx, ny, joint = length * cos, length * sin, read(row, K, at, ln.JOINT)
    gx, gy, back = read(row, K, at, (ln.EX, ln.EY, ln.KD))
    by_q, by_w, qx, qy, wx, wy = read(row, K, at, BY_STATE)
    if reaction_factor == 0.0:  # else A is symmetric and f = u
        axy, fx, fy, ayx, ux, uy = read(row, K, down, (ln.AXY, ln.FX, ln.FY, ln.AYX, ln.UX, ln.UY))
        gx += inv * (ny * (axy - ayx) + fx - ux)
        gy += inv * (nx * (ayx - axy) + fy - uy)
        back = joint_law.jacobian(joint, reaction_factor, h, h * h)[1] * inv
    slopes = (
        *joint_law.jacobian(joint, reaction_factor, 1.0, h),
        joint_law.jacobian(joint, reaction_factor, 0.0, 1.0)[0],
    )
    return (by_q, by_w, nx, ny), (qx, qy), (wx, wy), (gx, gy, inv, back), slopes


@inlined
def link_sources(row, up, at, down, seed, bend, rate, external, reaction_factor):  # type: ignore[no-untyped-def]
    """Right-hand sides that stem from a change of parameters and of the step's length, (M.22).

    `seed` contains the link's SEEDS and the relative change of the step, `external` is the change of the torque on the
    link. Returns (moment, joint torque, its reaction on the parent, force x, y).
    """
    length, mass, ma, inertia, viscous, stiffness, rest, dry, stretch = seed
    sin, cos, w, far_x, far_y, alpha = read(row, K, at, (SIN, COS, BEFORE, *ln.MOTION))
    axx, axy, ayy, fx, fy, bx, by, _, _, ayx, ux, uy = ln.load_answer(row, K, down, reaction_factor)
    px, py, alpha_up = read(row, K, up, ln.MOTION)
    lever, slip, h = read(row, K, at, (ln.LENGTH, ln.SLIP, ln.STEP))
    zx, zy = cos * alpha - sin * w * w, sin * alpha + cos * w * w
    azx, azy = axx * zx + axy * zy, ayx * zx + ayy * zy
    pull_x = axx * far_x + axy * far_y + fx * alpha + bx + lever * azx
    pull_y = ayx * far_x + ayy * far_y + fy * alpha + by + lever * azy
    moment = external - inertia * alpha - ma * (cos * px + sin * py)
    moment -= length * (ux * zx + uy * zy + cos * pull_x + sin * pull_y)
    joint, own, change = read(row, K, at, ln.JOINT), (viscous, dry, stiffness, rest), alpha - alpha_up
    torque, torque_back = joint_law.variation(joint, own, reaction_factor, bend, rate, change, slip, h, stretch)
    fx, fy = mass * px + ma * zx + length * azx, mass * py + ma * zy + length * azy
    return moment, torque, torque_back, fx, fy


@inlined
def up_one(row, up, at, down, factors, source):  # type: ignore[no-untyped-def]
    """One link and direction from tip to motor: the derivatives of the constant terms of the response.

    `up`, `at`, `down`: offsets of this direction.
    """
    (by_q, by_w, nx, ny), (qx, qy), (wx, wy), (gx, gy, inv, back), (slope, slope_back, stiffness) = factors
    moment, torque, torque_back, fx, fy = source
    (dq, dw), (dq_up, dw_up) = read(row, K, at, (DQ, DW)), read(row, K, up, (DQ, DW))
    turn, bend = dw - dw_up, stiffness * (dq - dq_up)
    bx, by, beta = read(row, K, down, (BX, BY, BETA))
    early = by_q * dq + by_w * dw - slope * turn - bend + (moment + torque)  # the values available last enter last
    r = (early - beta) - (nx * bx + ny * by)
    bx, by = (bx - (qx * dq + wx * dw - fx)) + gx * r, (by - (qy * dq + wy * dw - fy)) + gy * r
    beta = (torque_back - slope_back * turn - bend) - back * r
    write(row, K, at, (RHS, BX, BY, BETA), (inv * r, bx, by, beta))


@inlined
def back_one(row, j, d, change, stretch):  # type: ignore[no-untyped-def]
    """One link and direction from motor to tip, and the Euler step of the derivatives; `change` is of its length.

    `d` is 0, or K for the second direction.
    """
    at, own, up = ln.AT * K + j, ln.AT * K + j + d, ln.UP * K + j + d
    h, length, alpha, w_end = read(row, K, at, (ln.STEP, ln.LENGTH, ln.ALPHA, ln.W))
    w, sin, cos, kd, ex, ey = read(row, K, at, (BEFORE, SIN, COS, ln.KD, ln.EX, ln.EY))
    zx, zy = cos * alpha - sin * w * w, sin * alpha + cos * w * w
    (dq, dw, rhs), (px, py, alpha_up) = read(row, K, own, (DQ, DW, RHS)), read(row, K, up, (PX, PY, ALPHA))
    change_alpha = rhs + kd * alpha_up - (ex * px + ey * py)
    turn = 2.0 * w * dw
    px = (px - (length * (zy * dq + sin * turn) - change * zx)) + length * cos * change_alpha
    py = (py + (length * (zx * dq + cos * turn) + change * zy)) + length * sin * change_alpha
    dw += h * (change_alpha + stretch * alpha)
    write(row, K, own, (PX, PY, ALPHA, DQ, DW), (px, py, change_alpha, dq + h * (dw + stretch * w_end), dw))


@inlined
def load_seed(links, i, stretch):  # type: ignore[no-untyped-def]
    """Seeds of link i of one direction, `links` (n, SEEDS), and the relative change of the step, as numbers."""
    own = links[i]
    return own[LENGTH], own[MASS], own[MA], own[INERTIA], own[VISCOUS], own[STIFFNESS], own[REST], own[DRY], stretch


@non_allocating
def step(reaction, sources, lanes, links, stretch):  # type: ignore[no-untyped-def]
    """Derivatives of the step of ``lanes.euler`` for two directions; call ``prepare`` first.

    Parameters
    ----------
    reaction : as in Chain
    sources : ALL, or STATE if only state, base and tip mass change: then `links` and `stretch` are zero
    lanes : ((n + 2) ROW K,) DQ and DW of the links are advanced in place. Row 0 contains the changes of the base: DQ,
        DW of its angle and rate, PX, PY, ALPHA of its accelerations, and RHS, the change of the torque on link 0, N m;
        the last row contains BX, BY of the tip mass. With drag or motors in inner joints RHS of the links is the change
        of the air's torques, see ``tangent.air``, and of the motors'
    links : (2, n, SEEDS) changes of the links' parameters
    stretch : (2,) relative change of the step's length in every lane
    """
    reaction_factor, still = len(reaction) - 1.0, (0.0, 0.0, 0.0, 0.0, 0.0)
    n = lanes.size // (ln.ROW * K) - 2
    loaded = 1.0 if lanes[ln.DRAG * K] > 0.0 or lanes[MOTORS * K] > 0.0 else 0.0
    for way in range(n):
        i = n - way
        first = 1.0 if i == 1 else 0.0
        row = lanes[(i - 1) * ln.ROW * K : (i + 2) * ln.ROW * K]
        one = load_seed(links[0], i - 1, stretch[0])
        two = load_seed(links[1], i - 1, stretch[1])
        for j in range(K):
            up, at, down = ln.UP * K + j, ln.AT * K + j, ln.DOWN * K + j
            factors, source, second = link_factors(row, at, down, reaction_factor), still, still
            if len(sources) > 0:
                bend, rate = joint_motion(row, up, at, first)
                torque = first * row[up + RHS * K] + loaded * row[at + RHS * K]
                source = link_sources(row, up, at, down, one, bend, rate, torque, reaction_factor)
                torque = first * row[up + RHS * K + K] + loaded * row[at + RHS * K + K]
                second = link_sources(row, up, at, down, two, bend, rate, torque, reaction_factor)
            up_one(row, up, at, down, factors, source)
            up_one(row, up + K, at + K, down + K, factors, second)
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ln.ROW * K : (i + 1) * ln.ROW * K]
        longer, longer_two = links[0, i - 1, LENGTH], links[1, i - 1, LENGTH]
        change, change_two = stretch[0], stretch[1]
        if len(sources) == 0:
            longer = longer_two = change = change_two = 0.0
        for j in range(K):
            back_one(row, j, 0, longer, change)
            back_one(row, j, K, longer_two, change_two)
