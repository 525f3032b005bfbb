"""The articulated-body sweep in SIMD lanes, with linearly implicit Euler steps.

A single rollout puts the columns of its extrapolation table into the lanes (:data:`COLUMNS`); a batch puts whole
rollouts there (:data:`MEMBERS`). All lane data lie in one flat array of n + 2 rows: row 0 is the parent (arm or wall),
rows 1..n are the links, row n + 1 is what hangs beyond the tip. A row holds ROW quantities of one number a lane.

LLVM turns the inner loops over lanes into packed instructions only where it can prove that no two accesses of a loop
overlap. So each loop touches one slice of three neighbouring rows, at offsets that are constants: (UP + slot) * k + j
for the parent, (AT + slot) * k + j for the link itself, (DOWN + slot) * k + j for the link beyond, with k lanes and
lane j. The number of lanes is the length of a tuple, which the compiler knows. ``vdivpd`` in the assembly of
:func:`sweep` shows that it worked (tests/core/test_lanes.py looks).

What is handed from link to link, the answer on the way to the motor and the acceleration on the way back, stands in
the links' own rows for COLUMNS. In wider lanes that would be more memory than the cache gives back in time, so there
it stands in one place, the last row, which is an array of its own: with lanes enough, LLVM's test that two arrays do
not overlap pays.
"""

import numpy as np

from hyperflex.core import joint_law
from hyperflex.core.chain.air import link_drag
from hyperflex.core.chain.articulated_body import link_step, mutual, sincos
from hyperflex.core.jit import inlined, kernel, non_allocating

COLUMNS = (0,) * 4
MEMBERS = (0,) * 16
# Whether another Euler step follows, which needs the sines of the new angles; tuples too, for the compiler to know
MORE, LAST = (0,), ()

# parameters of a link
LENGTH, MA, INERTIA, MASS, VISCOUS, STIFFNESS, REST, DRY = range(8)
# state, with the sense of slipping (0: stuck); sine, cosine; (r inv, ex inv, ey inv, k, inv) for the way back; step
SLIP, Q, W, SIN, COS, RD, EX, EY, KD, INV, STEP = range(8, 19)
# on the way to the motor: the answer at the motor-side joint; AYX, UX and UY are not used where friction is mutual
AXX, AXY, AYX, AYY, FX, FY, BX, BY, UX, UY, S, BETA = range(19, 31)
# on the way back: acceleration of the far joint (less gravity), and of the link; `advance` hands them on
PX, PY, ALPHA = range(31, 34)
# friction work of a step, summed up from the tip; torque of air and motor on the link; of the lane as a whole, in row
# 0: work and loss
DISSIPATED, EXTERNAL, WORK, LOST = range(34, 38)
# extrapolation with whole rollouts in the lanes: state at the start, result and error estimate, lever of the link;
# in the last row: error of the joint's position and velocity, and the largest squares of both so far
Q_START, W_START, SIN_START, COS_START, Q_SUM, W_SUM, Q_GAP, W_GAP, LEVER = range(38, 47)
ERR_X, ERR_Y, ERR_VX, ERR_VY, WORST, WORST_V = range(47, 53)
DRAG = 53  # of the link; in row 0 more than 0.0 where any link of the lane has drag
ROW = 54
UP, AT, DOWN = 0, ROW, 2 * ROW


@kernel
def rows(width, n):  # type: ignore[no-untyped-def]
    """Lanes ((n + 2) ROW k,) for n links, all zero, and their last row: part of them for COLUMNS, else an array apart.

    They begin at the edge of a cache line: packed loads that cross one cost a fifth of the speed.
    """
    k = len(width)
    size = (n + 2) * ROW * k
    memory = np.zeros(size + 8)
    begin = -(memory.ctypes.data // 8) % 8
    lanes = memory[begin : begin + size]
    if k > len(COLUMNS):
        apart = np.zeros(ROW * k + 8)
        begin = -(apart.ctypes.data // 8) % 8
        return lanes, apart[begin : begin + ROW * k]
    return lanes, lanes[size - ROW * k :]


@non_allocating
def load(width, chain, lanes, tip):  # type: ignore[no-untyped-def]
    """Copy the parameters of one chain into every lane of ``rows``."""
    for j in range(len(width)):
        load_lane(width, j, chain, lanes, tip)


@non_allocating
def load_lane(width, j, chain, lanes, tip):  # type: ignore[no-untyped-def]
    """Copy the parameters of a chain into lane j, whose joints all slip; no air has moved there yet."""
    k = len(width)
    for slot in (DRAG, FX, FY, S):
        lanes[slot * k + j] = 0.0
    for i in range(chain.length.size):
        ma = chain.mass[i] * chain.com[i]
        row = lanes[(i + 1) * ROW * k : (i + 2) * ROW * k]
        row[LENGTH * k + j] = chain.length[i]
        row[MA * k + j] = ma
        row[INERTIA * k + j] = chain.inertia[i] + ma * chain.com[i]
        row[MASS * k + j] = chain.mass[i]
        row[VISCOUS * k + j] = chain.viscous[i]
        row[STIFFNESS * k + j] = chain.stiffness[i]
        row[REST * k + j] = chain.rest[i]
        row[DRY * k + j] = chain.dry[i]
        row[DRAG * k + j] = chain.drag[i]
        lanes[DRAG * k + j] += chain.drag[i]
        row[EXTERNAL * k + j] = 0.0
        row[SLIP * k + j] = 1.0
    tip[MASS * k + j] = chain.tip_mass


@non_allocating
def set_slip(width, lanes, slip):  # type: ignore[no-untyped-def]
    """Set how each joint slips in every lane, (n,) as in ``articulated_body.accelerations``."""
    for j in range(len(width)):
        set_lane_slip(width, j, lanes, slip)


@inlined
def set_lane_slip(width, j, lanes, slip):  # type: ignore[no-untyped-def]
    """Set how each joint slips in lane j."""
    for i in range(slip.size):
        lanes[((i + 1) * ROW + SLIP) * len(width) + j] = slip[i]


@inlined
def joint_in(row, k, j):  # type: ignore[no-untyped-def]
    """Joint of a link as ``joint_law`` takes it."""
    return (
        row[(AT + VISCOUS) * k + j],
        row[(AT + DRY) * k + j],
        row[(AT + STIFFNESS) * k + j],
        row[(AT + REST) * k + j],
    )


@inlined
def load_joint(row, k, j, h, external, reaction_factor):  # type: ignore[no-untyped-def]
    """Torque and slope of a link's joint as ``link_step`` takes them, and the friction work of the step."""
    joint, slip = joint_in(row, k, j), row[(AT + SLIP) * k + j]
    w, up = row[(AT + W) * k + j], row[(UP + W) * k + j]
    angle = row[(AT + Q) * k + j] - row[(UP + Q) * k + j]
    t, t_back, kappa, kappa_back = joint_law.torques(joint, reaction_factor, angle, w - up, slip, h)
    return (t + external, t_back, kappa, kappa_back), h * joint_law.power(joint, reaction_factor, w, up, slip)


@inlined
def load_answer(row, k, j, reaction_factor, at):  # type: ignore[no-untyped-def]
    """Answer of the row at offset ``at``, as ``link_step`` takes the answer of the link beyond."""
    answer = (
        row[(at + AXX) * k + j],
        row[(at + AXY) * k + j],
        row[(at + AYX) * k + j],
        row[(at + AYY) * k + j],
        row[(at + FX) * k + j],
        row[(at + FY) * k + j],
        row[(at + BX) * k + j],
        row[(at + BY) * k + j],
        row[(at + UX) * k + j],
        row[(at + UY) * k + j],
        row[(at + S) * k + j],
        row[(at + BETA) * k + j],
    )
    return mutual(answer) if reaction_factor == 1.0 else answer


@inlined
def store_answer(row, k, j, reaction_factor, at, answer):  # type: ignore[no-untyped-def]
    """Keep an answer in the row at offset ``at``."""
    row[(at + AXX) * k + j] = answer[0]
    row[(at + AXY) * k + j] = answer[1]
    row[(at + AYY) * k + j] = answer[3]
    row[(at + FX) * k + j] = answer[4]
    row[(at + FY) * k + j] = answer[5]
    row[(at + BX) * k + j] = answer[6]
    row[(at + BY) * k + j] = answer[7]
    row[(at + S) * k + j] = answer[10]
    row[(at + BETA) * k + j] = answer[11]
    if reaction_factor == 0.0:  # else they are AXY, FX and FY
        row[(at + AYX) * k + j] = answer[2]
        row[(at + UX) * k + j] = answer[8]
        row[(at + UY) * k + j] = answer[9]


@non_allocating
def air(width, lanes, base):  # type: ignore[no-untyped-def]
    """Add the torques of the air to EXTERNAL of the links, (M.32); its force and power go to FX, FY and S of row 0.

    `base` (9, k) as in :func:`euler`. Velocities of the joints pass through PX and PY, forces through BX, BY and BETA.
    """
    k = len(width)
    n = lanes.size // (ROW * k) - 2
    for j in range(k):
        lanes[PX * k + j] = base[5, j]
        lanes[PY * k + j] = base[6, j]
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ROW * k : (i + 1) * ROW * k]
        for j in range(k):
            turn = row[(AT + LENGTH) * k + j] * row[(AT + W) * k + j]
            row[(AT + PX) * k + j] = row[(UP + PX) * k + j] + turn * row[(AT + COS) * k + j]
            row[(AT + PY) * k + j] = row[(UP + PY) * k + j] + turn * row[(AT + SIN) * k + j]
    for way in range(n):
        i = n - way
        first = 1.0 if i == 1 else 0.0
        row = lanes[(i - 1) * ROW * k : (i + 2) * ROW * k]
        for j in range(k):
            sin, cos = row[(AT + SIN) * k + j], row[(AT + COS) * k + j]
            length, w = row[(AT + LENGTH) * k + j], row[(AT + W) * k + j]
            across = row[(UP + PX) * k + j] * cos + row[(UP + PY) * k + j] * sin
            force, moment = link_drag(row[(AT + DRAG) * k + j], length, across, length * w)
            fx, fy = row[(DOWN + BX) * k + j], row[(DOWN + BY) * k + j]
            torque = length * (cos * fx + sin * fy) - moment
            row[(AT + EXTERNAL) * k + j] = torque + first * row[(AT + EXTERNAL) * k + j]
            row[(AT + BX) * k + j] = fx - force * cos
            row[(AT + BY) * k + j] = fy - force * sin
            row[(AT + BETA) * k + j] = row[(DOWN + BETA) * k + j] + force * across + moment * w
    for j in range(k):
        lanes[FX * k + j] = lanes[(ROW + BX) * k + j]
        lanes[FY * k + j] = lanes[(ROW + BY) * k + j]
        lanes[S * k + j] = lanes[(ROW + BETA) * k + j]


@non_allocating
def sweep(width, reaction, lanes, tip):  # type: ignore[no-untyped-def]
    """From tip to motor: the answer of the chain at each joint (M.8)-(M.13), and the friction work of the step.

    One large loop body on purpose: LLVM unrolls small loops over so few lanes before it looks for packed instructions.
    """
    k = len(width)
    one_place = k > len(COLUMNS)
    reaction_factor = len(reaction) - 1.0
    n = lanes.size // (ROW * k) - 2
    for j in range(k):
        mass = tip[MASS * k + j]
        store_answer(tip, k, j, reaction_factor, 0, (mass, 0.0, 0.0, mass, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        tip[DISSIPATED * k + j] = 0.0
    for way in range(n):
        i = n - way
        row = lanes[(i - 1) * ROW * k : (i + (1 if one_place else 2)) * ROW * k]
        answers = tip if one_place else row
        far, near = (0, 0) if one_place else (DOWN, AT)
        for j in range(k):
            h = answers[(far + STEP) * k + j]
            joint, lost = load_joint(row, k, j, h, row[(AT + EXTERNAL) * k + j], reaction_factor)
            link = (
                row[(AT + LENGTH) * k + j],
                row[(AT + MA) * k + j],
                row[(AT + INERTIA) * k + j],
                row[(AT + MASS) * k + j],
            )
            slip = row[(AT + SLIP) * k + j]
            w = row[(AT + W) * k + j]
            sin = row[(AT + SIN) * k + j]
            cos = row[(AT + COS) * k + j]
            beyond = load_answer(answers, k, j, reaction_factor, far)
            at, back = link_step(link, joint, slip * slip, reaction_factor, sin, cos, w * w, beyond)
            store_answer(answers, k, j, reaction_factor, near, at)
            row[(AT + RD) * k + j] = back[0]
            row[(AT + EX) * k + j] = back[1]
            row[(AT + EY) * k + j] = back[2]
            row[(AT + KD) * k + j] = back[3]
            answers[(near + DISSIPATED) * k + j] = answers[(far + DISSIPATED) * k + j] + lost
            if not one_place:
                row[(AT + INV) * k + j] = back[4]
                row[(AT + STEP) * k + j] = h


@non_allocating
def advance(width, more, lanes, tip):  # type: ignore[no-untyped-def]
    """From motor to tip: accelerations, w + h alpha, q + h w and, with MORE, its sine and cosine for the next step."""
    k = len(width)
    one_place = k > len(COLUMNS)
    n = lanes.size // (ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ROW * k : (i + 1) * ROW * k]
        place = tip if one_place else row
        near, far = (0, 0) if one_place else (UP, AT)
        for j in range(k):
            px = place[(near + PX) * k + j]
            py = place[(near + PY) * k + j]
            h = place[(far + STEP) * k + j]
            w = row[(AT + W) * k + j]
            length = row[(AT + LENGTH) * k + j]
            sin = row[(AT + SIN) * k + j]
            cos = row[(AT + COS) * k + j]
            alpha = (
                row[(AT + RD) * k + j]
                - row[(AT + EX) * k + j] * px
                - row[(AT + EY) * k + j] * py
                + row[(AT + KD) * k + j] * place[(near + ALPHA) * k + j]
            )
            place[(far + ALPHA) * k + j] = alpha
            place[(far + PX) * k + j] = px + length * (cos * alpha - sin * w * w)
            place[(far + PY) * k + j] = py + length * (sin * alpha + cos * w * w)
            w += h * alpha
            q = row[(AT + Q) * k + j] + h * w
            row[(AT + W) * k + j] = w
            row[(AT + Q) * k + j] = q
            if len(more) > 0:
                row[(AT + SIN) * k + j], row[(AT + COS) * k + j] = sincos(q)


@inlined
def base_load(top, answers, k, j, reaction_factor, px, py, up):  # type: ignore[no-untyped-def]
    """Force x, y on lane j's chain at its first joint, whose acceleration is p less gravity, and torque through it."""
    axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, s, beta = load_answer(answers, k, j, reaction_factor, 0)
    fx = axx * px + axy * py + fx * up + bx - top[FX * k + j]
    fy = ayx * px + ayy * py + fy * up + by - top[FY * k + j]
    return fx, fy, ux * px + uy * py + s * up + beta


@non_allocating
def euler(width, reaction, more, lanes, tip, base):  # type: ignore[no-untyped-def]
    """One linearly implicit Euler step in every lane, each of its own length.

    Parameters
    ----------
    width, reaction : tuples whose lengths are the number of lanes, k, and of links that bear a joint's friction
    more : MORE or LAST
    lanes : ((n + 2) ROW k,), advanced in place; WORK and LOST of row 0 grow
    tip : (ROW k,) the last row, see :func:`rows`; EXTERNAL (N m) and STEP (s) are read from it
    base : (9, k) motion of the first joint at the beginning of each lane's step, as ``drive.base_state`` writes it,
        with gravity taken off its acceleration
    """
    k = len(width)
    top = lanes[: ROW * k]
    for j in range(k):
        top[W * k + j] = base[3, j]
        top[Q * k + j] = base[4, j]
        lanes[(ROW + EXTERNAL) * k + j] = tip[EXTERNAL * k + j]
    if top[DRAG * k : (DRAG + 1) * k].any():
        air(width, lanes, base)
    sweep(width, reaction, lanes, tip)
    one_place = k > len(COLUMNS)
    answers = tip if one_place else lanes[ROW * k : 2 * ROW * k]
    start = answers if one_place else top
    row = lanes[ROW * k : 2 * ROW * k]
    for j in range(k):
        px = base[0, j]
        py = base[1, j]
        up = base[2, j]
        fx, fy, moment = base_load(top, answers, k, j, len(reaction) - 1.0, px, py, up)
        power = fx * base[5, j] + fy * base[6, j] + moment * base[3, j] + tip[EXTERNAL * k + j] * row[W * k + j]
        h = answers[STEP * k + j]
        top[WORK * k + j] += h * power
        top[LOST * k + j] += answers[DISSIPATED * k + j] + h * top[S * k + j]
        start[PX * k + j] = px
        start[PY * k + j] = py
        start[ALPHA * k + j] = up
    advance(width, more, lanes, tip)
