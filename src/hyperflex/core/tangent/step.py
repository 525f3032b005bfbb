"""Tangent of one linearly implicit Euler step, two directions at a time.

A direction is a change of the state, of the parameters, of the base's motion or of the step's length. What follows
from it to first order obeys the step's own equations with another right-hand side, (M.19)-(M.22), so the factors that
the step has left in the lanes are used again: no sine, no division. The slots below are in the lanes' rows, in the
place of what only whole rollouts need; two directions together make a loop body that is large enough for the compiler
to turn into packed instructions (core/chain/lanes.py says more; tests/core/test_tangent.py checks it). As there, a
quantity is at its slot times K from the offset of its row and lane, and at K more for the second direction.
"""

from hyperflex.core import joint_law
from hyperflex.core.chain import lanes as ln
from hyperflex.core.jit import inlined, non_allocating

K = len(ln.COLUMNS)
# derivatives of angle and rate, of the right-hand side over D; on the way to the motor those of the answer's constant
# terms, on the way back those of the far joint's acceleration and of the link's (each for both directions)
DQ, DW, RHS, BX, BY, BETA = range(ln.Q_START, ln.Q_START + 12, 2)
PX, PY, ALPHA = BX, BY, BETA
# rate before the step, sine and cosine of the angle
BEFORE, SIN, COS = range(DQ + 12, DQ + 15)
# what multiplies the derivatives of angle and rate in the moment and in the force (M.21), in slots that are free
# once a step is taken
BY_Q, BY_W, QX, QY, WX, WY = ln.RD, ln.S, ln.BETA, ln.DISSIPATED, ln.LOST, ln.WORK
# the seeds of a direction for one link: changes of its parameters
LENGTH, MASS, MA, INERTIA, VISCOUS, STIFFNESS, REST, DRY, DRAG = range(9)
SEEDS = 9
STATE, ALL = (), (0,)  # tuples, for the compiler to know: see ``step``


@inlined
def joint_motion(row, up, at, first):  # type: ignore[no-untyped-def]
    """Difference of a joint's angle at the end of the step, less the rest angle, and of its rate before the step."""
    h, alpha_up = row[at + ln.STEP * K], row[up + ln.ALPHA * K]
    up_end = row[up + ln.W * K] + first * h * alpha_up  # row 0 is the parent's motion before the step
    rate = row[at + BEFORE * K] - up_end + h * alpha_up
    bend = row[at + ln.Q * K] - row[up + ln.Q * K] - row[at + ln.REST * K]
    return bend - first * h * up_end, rate


@non_allocating
def save_trig(lanes):  # type: ignore[no-untyped-def]
    """Keep the sines and cosines that ``lanes.euler`` will overwrite; comes before it."""
    n = lanes.size // (ln.ROW * K) - 2
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * K : (i + 1) * ln.ROW * K]
        for j in range(K):
            row[SIN * K + j] = row[ln.SIN * K + j]
            row[COS * K + j] = row[ln.COS * K + j]


@non_allocating
def prepare(reaction, lanes):  # type: ignore[no-untyped-def]
    """Work out BEFORE and BY_Q to WY from what ``lanes.euler`` has left; once a step, for all directions."""
    reaction_factor = len(reaction) - 1.0
    n = lanes.size // (ln.ROW * K) - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ln.ROW * K : (i + 2) * ln.ROW * K]
        for j in range(K):
            up, at, down = ln.UP * K + j, ln.AT * K + j, ln.DOWN * K + j
            length, ma = row[at + ln.LENGTH * K], row[at + ln.MA * K]
            sin, cos, alpha = row[at + SIN * K], row[at + COS * K], row[at + ln.ALPHA * K]
            w = row[at + ln.W * K] - row[at + ln.STEP * K] * alpha
            axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, _, _ = ln.load_answer(row, K, down, reaction_factor)
            far_x, far_y = row[at + ln.PX * K], row[at + ln.PY * K]
            force_x = axx * far_x + axy * far_y + fx * alpha + bx
            force_y = ayx * far_x + ayy * far_y + fy * alpha + by
            vx, vy = sin * alpha + cos * w * w, sin * w * w - cos * alpha
            avx, avy = axx * vx + axy * vy, ayx * vx + ayy * vy
            adx, ady = axx * sin - axy * cos, ayx * sin - ayy * cos
            by_q = ma * (row[up + ln.PX * K] * sin - row[up + ln.PY * K] * cos)
            by_q += length * (sin * force_x - cos * force_y + ux * vx + uy * vy)
            row[at + BY_Q * K] = by_q + length * length * (cos * avx + sin * avy)
            row[at + BY_W * K] = 2.0 * length * w * (ux * sin - uy * cos + length * (cos * adx + sin * ady))
            row[at + QX * K] = length * avx + ma * vx
            row[at + QY * K] = length * avy + ma * vy
            row[at + WX * K] = 2.0 * w * (length * adx + ma * sin)
            row[at + WY * K] = 2.0 * w * (length * ady - ma * cos)
            row[at + BEFORE * K] = w


@inlined
def link_factors(row, at, down, reaction_factor):  # type: ignore[no-untyped-def]
    """What multiplies the derivatives of a link's state and of the answer beyond it, (M.21)."""
    length, inv = row[at + ln.LENGTH * K], row[at + ln.INV * K]
    nx, ny = length * row[at + COS * K], length * row[at + SIN * K]
    h, joint = row[at + ln.STEP * K], ln.joint_in(row, K, at)
    gx, gy, back = row[at + ln.EX * K], row[at + ln.EY * K], row[at + ln.KD * K]
    if reaction_factor == 0.0:  # else A is symmetric and f = u
        _, axy, ayx, _, fx, fy, _, _, ux, uy, _, _ = ln.load_answer(row, K, down, reaction_factor)
        gx += inv * (ny * (axy - ayx) + fx - ux)
        gy += inv * (nx * (ayx - axy) + fy - uy)
        back = joint_law.jacobian(joint, reaction_factor, h, h * h)[1] * inv
    return (
        (row[at + BY_Q * K], row[at + BY_W * K], nx, ny),
        (row[at + QX * K], row[at + QY * K]),
        (row[at + WX * K], row[at + WY * K]),
        (gx, gy, inv, back),
        (*joint_law.jacobian(joint, reaction_factor, 1.0, h), joint_law.jacobian(joint, reaction_factor, 0.0, 1.0)[0]),
    )


@inlined
def link_sources(row, up, at, down, seed, bend, rate, external, reaction_factor):  # type: ignore[no-untyped-def]
    """Right-hand sides that stem from a change of parameters and of the step's length, (M.22).

    `seed` holds the link's SEEDS and the relative change of the step, `external` is the change of the torque on the
    link. Returns (moment, joint torque, the same back on the parent, force x, y).
    """
    length, mass, ma, inertia, viscous, stiffness, rest, dry, stretch = seed
    sin, cos, alpha, h = row[at + SIN * K], row[at + COS * K], row[at + ln.ALPHA * K], row[at + ln.STEP * K]
    w = row[at + BEFORE * K]
    axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, _, _ = ln.load_answer(row, K, down, reaction_factor)
    px, py = row[up + ln.PX * K], row[up + ln.PY * K]
    far_x, far_y = row[at + ln.PX * K], row[at + ln.PY * K]
    zx, zy = cos * alpha - sin * w * w, sin * alpha + cos * w * w
    azx, azy = axx * zx + axy * zy, ayx * zx + ayy * zy
    lever = row[at + ln.LENGTH * K]
    pull_x = axx * far_x + axy * far_y + fx * alpha + bx + lever * azx
    pull_y = ayx * far_x + ayy * far_y + fy * alpha + by + lever * azy
    moment = external - inertia * alpha - ma * (cos * px + sin * py)
    moment -= length * (ux * zx + uy * zy + cos * pull_x + sin * pull_y)
    change = alpha - row[up + ln.ALPHA * K]
    joint, own, slip = ln.joint_in(row, K, at), (viscous, dry, stiffness, rest), row[at + ln.SLIP * K]
    torque, torque_back = joint_law.variation(joint, own, reaction_factor, bend, rate, change, slip, h, stretch)
    fx, fy = mass * px + ma * zx + length * azx, mass * py + ma * zy + length * azy
    return moment, torque, torque_back, fx, fy


@inlined
def up_one(row, up, at, down, factors, source):  # type: ignore[no-untyped-def]
    """One link and direction from tip to motor: the derivatives of the answer's constant terms.

    `up`, `at`, `down`: offsets of this direction.
    """
    (by_q, by_w, nx, ny), (qx, qy), (wx, wy), (gx, gy, inv, back), (slope, slope_back, stiffness) = factors
    moment, torque, torque_back, fx, fy = source
    dq, dw = row[at + DQ * K], row[at + DW * K]
    turn = dw - row[up + DW * K]
    bend = stiffness * (dq - row[up + DQ * K])
    bx, by = row[down + BX * K], row[down + BY * K]
    early = by_q * dq + by_w * dw - slope * turn - bend + (moment + torque)  # what comes late enters last
    r = (early - row[down + BETA * K]) - (nx * bx + ny * by)
    row[at + RHS * K] = inv * r
    row[at + BX * K] = (bx - (qx * dq + wx * dw - fx)) + gx * r
    row[at + BY * K] = (by - (qy * dq + wy * dw - fy)) + gy * r
    row[at + BETA * K] = (torque_back - slope_back * turn - bend) - back * r


@inlined
def back_one(row, j, d, change, stretch):  # type: ignore[no-untyped-def]
    """One link and direction from motor to tip, and the Euler step of the derivatives; `change` is of its length.

    `d` is 0, or K for the second direction.
    """
    at, own, up = ln.AT * K + j, ln.AT * K + j + d, ln.UP * K + j + d
    h, length, w = row[at + ln.STEP * K], row[at + ln.LENGTH * K], row[at + BEFORE * K]
    sin, cos, alpha = row[at + SIN * K], row[at + COS * K], row[at + ln.ALPHA * K]
    zx, zy = cos * alpha - sin * w * w, sin * alpha + cos * w * w
    dq, dw = row[own + DQ * K], row[own + DW * K]
    px, py = row[up + PX * K], row[up + PY * K]
    change_alpha = row[own + RHS * K] + row[at + ln.KD * K] * row[up + ALPHA * K]
    change_alpha -= row[at + ln.EX * K] * px + row[at + ln.EY * K] * py
    turn = 2.0 * w * dw
    row[own + ALPHA * K] = change_alpha
    row[own + PX * K] = (px - (length * (zy * dq + sin * turn) - change * zx)) + length * cos * change_alpha
    row[own + PY * K] = (py + (length * (zx * dq + cos * turn) + change * zy)) + length * sin * change_alpha
    dw += h * (change_alpha + stretch * alpha)
    row[own + DW * K] = dw
    row[own + DQ * K] = dq + h * (dw + stretch * row[at + ln.W * K])


@inlined
def load_seed(links, i, stretch):  # type: ignore[no-untyped-def]
    """Seeds of link i of one direction, `links` (n, SEEDS), and the relative change of the step, as numbers."""
    own = links[i]
    return own[LENGTH], own[MASS], own[MA], own[INERTIA], own[VISCOUS], own[STIFFNESS], own[REST], own[DRY], stretch


@non_allocating
def step(reaction, sources, lanes, links, stretch):  # type: ignore[no-untyped-def]
    """Derivatives of the step of ``lanes.euler`` for two directions; ``prepare`` comes first.

    Parameters
    ----------
    reaction : as in Chain
    sources : ALL, or STATE where nothing changes but state, base and tip mass: `links` and `stretch` are all zero then
    lanes : ((n + 2) ROW K,) DQ and DW of the links are advanced in place. Row 0 holds what the base does: DQ, DW of its
        angle and rate, PX, PY, ALPHA of its accelerations, and RHS, the change of the torque on link 0, N m; the last
        row BX, BY of what hangs beyond the tip. With drag RHS of the links is the change of the air's torques, see
        ``tangent.air``
    links : (2, n, SEEDS) changes of the links' parameters
    stretch : (2,) relative change of the step's length in every lane
    """
    reaction_factor, still = len(reaction) - 1.0, (0.0, 0.0, 0.0, 0.0, 0.0)
    n = lanes.size // (ln.ROW * K) - 2
    airy = 1.0 if lanes[ln.DRAG * K] > 0.0 else 0.0
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
                torque = first * row[up + RHS * K] + airy * row[at + RHS * K]
                source = link_sources(row, up, at, down, one, bend, rate, torque, reaction_factor)
                torque = first * row[up + RHS * K + K] + airy * row[at + RHS * K + K]
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
