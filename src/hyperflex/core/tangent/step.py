"""Tangent of one linearly implicit Euler step, two directions at a time.

A direction is a change of the state, of the parameters, of the base's motion or of the step's length. What follows
from it to first order obeys the step's own equations with another right-hand side, (M.19)-(M.22), so the factors that
the step has left in the lanes are used again: no sine, no division. The slots below lie in the lanes' rows, in the
place of what only whole rollouts need; two directions together make a loop body that is large enough for the compiler
to turn into packed instructions (core/chain/lanes.py says more; tests/core/test_tangent.py looks).
"""

from hyperflex.core import joint_law
from hyperflex.core.chain import lanes as ln
from hyperflex.core.jit import inlined, non_allocating

PAIR = (0, 0)
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


@inlined
def joint_motion(row, k, j, first):  # type: ignore[no-untyped-def]
    """Difference of a joint's angle at the end of the step, less the rest angle, and of its rate before the step."""
    h = row[(ln.AT + ln.STEP) * k + j]
    up = row[(ln.UP + ln.ALPHA) * k + j]
    up_end = row[(ln.UP + ln.W) * k + j] + first * h * up  # row 0 is the parent's motion before the step
    rate = row[(ln.AT + BEFORE) * k + j] - up_end + h * up
    bend = row[(ln.AT + ln.Q) * k + j] - row[(ln.UP + ln.Q) * k + j] - row[(ln.AT + ln.REST) * k + j]
    return bend - first * h * up_end, rate


@non_allocating
def save_trig(width, lanes):  # type: ignore[no-untyped-def]
    """Keep the sines and cosines that ``lanes.euler`` will overwrite; comes before it."""
    k = len(width)
    n = lanes.size // (ln.ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * k : (i + 1) * ln.ROW * k]
        for j in range(k):
            row[SIN * k + j] = row[ln.SIN * k + j]
            row[COS * k + j] = row[ln.COS * k + j]


@non_allocating
def prepare(width, reaction, lanes):  # type: ignore[no-untyped-def]
    """Work out BEFORE and BY_Q to WY from what ``lanes.euler`` has left; once a step, for all directions."""
    k = len(width)
    reaction_factor = len(reaction) - 1.0
    n = lanes.size // (ln.ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ln.ROW * k : (i + 2) * ln.ROW * k]
        for j in range(k):
            length, ma = row[(ln.AT + ln.LENGTH) * k + j], row[(ln.AT + ln.MA) * k + j]
            sin, cos = row[(ln.AT + SIN) * k + j], row[(ln.AT + COS) * k + j]
            alpha = row[(ln.AT + ln.ALPHA) * k + j]
            w = row[(ln.AT + ln.W) * k + j] - row[(ln.AT + ln.STEP) * k + j] * alpha
            axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, _, _ = ln.load_answer(row, k, j, reaction_factor, ln.DOWN)
            far_x, far_y = row[(ln.AT + ln.PX) * k + j], row[(ln.AT + ln.PY) * k + j]
            force_x = axx * far_x + axy * far_y + fx * alpha + bx
            force_y = ayx * far_x + ayy * far_y + fy * alpha + by
            vx, vy = sin * alpha + cos * w * w, sin * w * w - cos * alpha
            avx, avy = axx * vx + axy * vy, ayx * vx + ayy * vy
            adx, ady = axx * sin - axy * cos, ayx * sin - ayy * cos
            by_q = ma * (row[(ln.UP + ln.PX) * k + j] * sin - row[(ln.UP + ln.PY) * k + j] * cos)
            by_q += length * (sin * force_x - cos * force_y + ux * vx + uy * vy)
            row[(ln.AT + BY_Q) * k + j] = by_q + length * length * (cos * avx + sin * avy)
            by_w = ux * sin - uy * cos + length * (cos * adx + sin * ady)
            row[(ln.AT + BY_W) * k + j] = 2.0 * length * w * by_w
            row[(ln.AT + QX) * k + j] = length * avx + ma * vx
            row[(ln.AT + QY) * k + j] = length * avy + ma * vy
            row[(ln.AT + WX) * k + j] = 2.0 * w * (length * adx + ma * sin)
            row[(ln.AT + WY) * k + j] = 2.0 * w * (length * ady - ma * cos)
            row[(ln.AT + BEFORE) * k + j] = w


@inlined
def link_factors(row, k, j, reaction_factor):  # type: ignore[no-untyped-def]
    """What multiplies the derivatives of a link's state and of the answer beyond it, (M.21)."""
    length, inv = row[(ln.AT + ln.LENGTH) * k + j], row[(ln.AT + ln.INV) * k + j]
    nx, ny = length * row[(ln.AT + COS) * k + j], length * row[(ln.AT + SIN) * k + j]
    h, joint = row[(ln.AT + ln.STEP) * k + j], ln.joint_in(row, k, j)
    gx, gy, back = row[(ln.AT + ln.EX) * k + j], row[(ln.AT + ln.EY) * k + j], row[(ln.AT + ln.KD) * k + j]
    if reaction_factor == 0.0:  # else A is symmetric and f = u
        _, axy, ayx, _, fx, fy, _, _, ux, uy, _, _ = ln.load_answer(row, k, j, reaction_factor, ln.DOWN)
        gx += inv * (ny * (axy - ayx) + fx - ux)
        gy += inv * (nx * (ayx - axy) + fy - uy)
        back = joint_law.jacobian(joint, reaction_factor, h, h * h)[1] * inv
    return (
        (row[(ln.AT + BY_Q) * k + j], row[(ln.AT + BY_W) * k + j], nx, ny),
        (row[(ln.AT + QX) * k + j], row[(ln.AT + QY) * k + j]),
        (row[(ln.AT + WX) * k + j], row[(ln.AT + WY) * k + j]),
        (gx, gy, inv, back),
        (*joint_law.jacobian(joint, reaction_factor, 1.0, h), joint_law.jacobian(joint, reaction_factor, 0.0, 1.0)[0]),
    )


@inlined
def link_sources(row, k, j, seed, bend, rate, reaction_factor):  # type: ignore[no-untyped-def]
    """Right-hand sides that stem from a change of parameters and of the step's length, (M.22).

    `seed` holds the link's SEEDS and the relative change of the step. Returns (moment, joint torque, the same back on
    the parent, force x, y).
    """
    length, mass, ma, inertia, viscous, stiffness, rest, dry, stretch = seed
    sin, cos = row[(ln.AT + SIN) * k + j], row[(ln.AT + COS) * k + j]
    alpha, h = row[(ln.AT + ln.ALPHA) * k + j], row[(ln.AT + ln.STEP) * k + j]
    w = row[(ln.AT + BEFORE) * k + j]
    axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, _, _ = ln.load_answer(row, k, j, reaction_factor, ln.DOWN)
    px, py = row[(ln.UP + ln.PX) * k + j], row[(ln.UP + ln.PY) * k + j]
    far_x, far_y = row[(ln.AT + ln.PX) * k + j], row[(ln.AT + ln.PY) * k + j]
    zx, zy = cos * alpha - sin * w * w, sin * alpha + cos * w * w
    azx, azy = axx * zx + axy * zy, ayx * zx + ayy * zy
    lever = row[(ln.AT + ln.LENGTH) * k + j]
    pull_x = axx * far_x + axy * far_y + fx * alpha + bx + lever * azx
    pull_y = ayx * far_x + ayy * far_y + fy * alpha + by + lever * azy
    moment = -inertia * alpha - ma * (cos * px + sin * py)
    moment -= length * (ux * zx + uy * zy + cos * pull_x + sin * pull_y)
    change = alpha - row[(ln.UP + ln.ALPHA) * k + j]
    joint, own, slip = ln.joint_in(row, k, j), (viscous, dry, stiffness, rest), row[(ln.AT + ln.SLIP) * k + j]
    torque, torque_back = joint_law.variation(joint, own, reaction_factor, bend, rate, change, slip, h, stretch)
    return (
        moment,
        torque,
        torque_back,
        mass * px + ma * zx + length * azx,
        mass * py + ma * zy + length * azy,
    )


@inlined
def up_one(row, k, j, d, factors, source):  # type: ignore[no-untyped-def]
    """One link and direction from tip to motor: the derivatives of the answer's constant terms."""
    (by_q, by_w, nx, ny), (qx, qy), (wx, wy), (gx, gy, inv, back), (slope, slope_back, stiffness) = factors
    moment, torque, torque_back, fx, fy = source
    dq, dw = row[(ln.AT + DQ + d) * k + j], row[(ln.AT + DW + d) * k + j]
    turn = dw - row[(ln.UP + DW + d) * k + j]
    bend = stiffness * (dq - row[(ln.UP + DQ + d) * k + j])
    bx, by = row[(ln.DOWN + BX + d) * k + j], row[(ln.DOWN + BY + d) * k + j]
    early = by_q * dq + by_w * dw - slope * turn - bend + (moment + torque)  # what comes late enters last
    r = (early - row[(ln.DOWN + BETA + d) * k + j]) - (nx * bx + ny * by)
    row[(ln.AT + RHS + d) * k + j] = inv * r
    row[(ln.AT + BX + d) * k + j] = (bx - (qx * dq + wx * dw - fx)) + gx * r
    row[(ln.AT + BY + d) * k + j] = (by - (qy * dq + wy * dw - fy)) + gy * r
    row[(ln.AT + BETA + d) * k + j] = (torque_back - slope_back * turn - bend) - back * r


@inlined
def back_one(row, k, j, d, w, change, stretch):  # type: ignore[no-untyped-def]
    """One link and direction from motor to tip, and the Euler step of the derivatives; `change` is of its length."""
    h, length = row[(ln.AT + ln.STEP) * k + j], row[(ln.AT + ln.LENGTH) * k + j]
    sin, cos, own = (
        row[(ln.AT + SIN) * k + j],
        row[(ln.AT + COS) * k + j],
        row[(ln.AT + ln.ALPHA) * k + j],
    )
    zx, zy = cos * own - sin * w * w, sin * own + cos * w * w
    dq, dw = row[(ln.AT + DQ + d) * k + j], row[(ln.AT + DW + d) * k + j]
    px, py = row[(ln.UP + PX + d) * k + j], row[(ln.UP + PY + d) * k + j]
    alpha = row[(ln.AT + RHS + d) * k + j] + row[(ln.AT + ln.KD) * k + j] * row[(ln.UP + ALPHA + d) * k + j]
    alpha -= row[(ln.AT + ln.EX) * k + j] * px + row[(ln.AT + ln.EY) * k + j] * py
    turn = 2.0 * w * dw
    row[(ln.AT + ALPHA + d) * k + j] = alpha
    row[(ln.AT + PX + d) * k + j] = (px - (length * (zy * dq + sin * turn) - change * zx)) + length * cos * alpha
    row[(ln.AT + PY + d) * k + j] = (py + (length * (zx * dq + cos * turn) + change * zy)) + length * sin * alpha
    dw += h * (alpha + stretch * own)
    row[(ln.AT + DW + d) * k + j] = dw
    row[(ln.AT + DQ + d) * k + j] = dq + h * (dw + stretch * row[(ln.AT + ln.W) * k + j])


@inlined
def load_seed(links, i, stretch):  # type: ignore[no-untyped-def]
    """Seeds of link i of one direction, `links` (n, SEEDS), and the relative change of the step, as numbers."""
    return (
        links[i, LENGTH],
        links[i, MASS],
        links[i, MA],
        links[i, INERTIA],
        links[i, VISCOUS],
        links[i, STIFFNESS],
        links[i, REST],
        links[i, DRY],
        stretch,
    )


@non_allocating
def step_state(width, reaction, lanes):  # type: ignore[no-untyped-def]
    """Derivatives of the step of ``lanes.euler``, for two changes of state and base alone; ``prepare`` comes first.

    Parameters
    ----------
    width : tuple whose length is the number of lanes, k
    reaction : as in Chain
    lanes : ((n + 2) ROW k,) DQ and DW of the links are advanced in place. Row 0 holds what the base does: DQ, DW of its
        angle and rate, PX, PY, ALPHA of its accelerations; the last row BX, BY of what hangs beyond the tip
    """
    k = len(width)
    reaction_factor = len(reaction) - 1.0
    n = lanes.size // (ln.ROW * k) - 2
    still = (0.0, 0.0, 0.0, 0.0, 0.0)
    for way in range(n):
        i = n - way
        row = lanes[(i - 1) * ln.ROW * k : (i + 2) * ln.ROW * k]
        for j in range(k):
            factors = link_factors(row, k, j, reaction_factor)
            up_one(row, k, j, 0, factors, still)
            up_one(row, k, j, 1, factors, still)
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ln.ROW * k : (i + 1) * ln.ROW * k]
        for j in range(k):
            w = row[(ln.AT + BEFORE) * k + j]
            back_one(row, k, j, 0, w, 0.0, 0.0)
            back_one(row, k, j, 1, w, 0.0, 0.0)


@non_allocating
def step_all(width, reaction, lanes, links, stretch):  # type: ignore[no-untyped-def]
    """Do the same for changes of everything: parameters, the step's length, the torque on link 0.

    Parameters
    ----------
    width, reaction, lanes : as in ``step_state``; RHS of row 0 holds the change of the torque on link 0, N m, and with
        drag RHS of the links that of the air's torques, see ``tangent.air``
    links : (2, n, SEEDS) changes of the links' parameters
    stretch : (2,) relative change of the step's length in every lane
    """
    k = len(width)
    reaction_factor = len(reaction) - 1.0
    n = lanes.size // (ln.ROW * k) - 2
    airy = 1.0 if lanes[ln.DRAG * k] > 0.0 else 0.0
    for way in range(n):
        i = n - way
        first = 1.0 if i == 1 else 0.0
        row = lanes[(i - 1) * ln.ROW * k : (i + 2) * ln.ROW * k]
        one = load_seed(links[0], i - 1, stretch[0])
        two = load_seed(links[1], i - 1, stretch[1])
        for j in range(k):
            bend, rate = joint_motion(row, k, j, first)
            factors = link_factors(row, k, j, reaction_factor)
            m, t, tb, x, y = link_sources(row, k, j, one, bend, rate, reaction_factor)
            m += first * row[(ln.UP + RHS) * k + j] + airy * row[(ln.AT + RHS) * k + j]
            up_one(row, k, j, 0, factors, (m, t, tb, x, y))
            m, t, tb, x, y = link_sources(row, k, j, two, bend, rate, reaction_factor)
            m += first * row[(ln.UP + RHS + 1) * k + j] + airy * row[(ln.AT + RHS + 1) * k + j]
            up_one(row, k, j, 1, factors, (m, t, tb, x, y))
    one_stretch, two_stretch = stretch[0], stretch[1]
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ln.ROW * k : (i + 1) * ln.ROW * k]
        one_length, two_length = links[0, i - 1, LENGTH], links[1, i - 1, LENGTH]
        for j in range(k):
            w = row[(ln.AT + BEFORE) * k + j]
            back_one(row, k, j, 0, w, one_length, one_stretch)
            back_one(row, k, j, 1, w, two_length, two_stretch)
