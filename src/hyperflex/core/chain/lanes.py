"""The articulated-body sweep in SIMD lanes, with linearly implicit Euler steps.

A single rollout puts the columns of its extrapolation table into the lanes (:data:`COLUMNS`); a batch puts whole
rollouts there (:data:`MEMBERS`). All lane data lie in one flat array of n + 2 rows: row 0 is the parent (arm or wall),
rows 1..n are the links, row n + 1 is what hangs beyond the tip. A row holds ROW quantities of one number a lane.

LLVM turns the inner loops over lanes into packed instructions only where it can prove that no two accesses of a loop
overlap. So each loop touches one slice of three neighbouring rows, at offsets that are constants: of lane j of k,
UP * k + j for the parent, AT * k + j for the link itself, DOWN * k + j for the link beyond, and a quantity is at its
slot times k from there. The number of lanes is the length of a tuple, which the compiler knows.

What is handed from link to link, the answer on the way to the motor and the acceleration on the way back, stands in
the links' own rows for COLUMNS. In wider lanes that would be more memory than the cache gives back in time, so there
it stands in one place, the last row, which is an array of its own: with lanes enough, LLVM's test that two arrays do
not overlap pays.
"""

import numpy as np

from hyperflex.core import joint_law
from hyperflex.core.chain.air import link_drag
from hyperflex.core.chain.articulated_body import BASE_SIZE, joint_of, link_step, mutual, sincos
from hyperflex.core.jit import inlined, kernel, non_allocating, read, write

COLUMNS = (0,) * 4
MEMBERS = (0,) * 16
# Whether another Euler step follows, which needs the sines of the new angles; tuples too, for the compiler to know
MORE, LAST = (0,), ()

# parameters of a link
LINK = LENGTH, MA, INERTIA, MASS = tuple(range(4))
JOINT = VISCOUS, DRY, STIFFNESS, REST = tuple(range(4, 8))
# state, with the sense of slipping (0: stuck); sine, cosine; (r inv, ex inv, ey inv, k, inv) for the way back; step
SLIP, INV, STEP = range(8, 11)
STATE = Q, W, SIN, COS = tuple(range(11, 15))
BACK = RD, EX, EY, KD = tuple(range(15, 19))
# on the way to the motor: the answer at the motor-side joint; AYX, UX and UY are not used where friction is mutual
ANSWER = AXX, AXY, AYY, FX, FY, BX, BY, S, BETA, AYX, UX, UY = tuple(range(19, 31))
SYMMETRIC = ANSWER[:9]
# on the way back: acceleration of the far joint (less gravity), and of the link; `advance` hands them on
MOTION = PX, PY, ALPHA = tuple(range(31, 34))
# friction work of a step, summed up from the tip; torque of air and motor on the link; of the lane as a whole, in row
# 0: work and loss
DISSIPATED, EXTERNAL, WORK, LOST = range(34, 38)
# extrapolation with whole rollouts in the lanes: state at the start, result and error estimate, lever of the link;
# in the last row: error of the joint's position and velocity, and the largest squares of both so far
START = Q_START, W_START, _, _ = tuple(range(38, 42))
SUMS = Q_SUM, W_SUM, Q_GAP, W_GAP = tuple(range(42, 46))
LEVER = 46
ERRORS = tuple(range(47, 53))
DRAG = 53  # of the link; in row 0 more than 0.0 where any link of the lane has drag
# of the joint, where dry friction is regularized: VISCOUS is then what stands for both
OWN, LOSS = 54, 55
ROW = 56
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
    write(lanes, k, j, (DRAG, FX, FY, S), (0.0, 0.0, 0.0, 0.0))
    for i in range(chain.length.size):
        ma, at = chain.mass[i] * chain.com[i], (i + 1) * ROW * k + j
        write(lanes, k, at, LINK, (chain.length[i], ma, chain.inertia[i] + ma * chain.com[i], chain.mass[i]))
        write(lanes, k, at, JOINT, joint_of(chain, i))
        write(lanes, k, at, (DRAG, EXTERNAL, SLIP), (chain.drag[i], 0.0, 1.0))
        lanes[DRAG * k + j] += chain.drag[i]
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
def set_state(j, q, w, trig, lanes):  # type: ignore[no-untyped-def]
    """Write angles and rates (n,), and sines and cosines `trig` (2 n,), to lane j of COLUMNS."""
    k, n = len(COLUMNS), q.size
    for i in range(n):
        write(lanes, k, (i + 1) * ROW * k + j, STATE, (q[i], w[i], trig[i], trig[n + i]))


@inlined
def set_base(j, chain, motion, base):  # type: ignore[no-untyped-def]
    """Write the motion (9 or more,) of the first joint to lane j of `base` (9 or more, k), less gravity."""
    for s in range(motion.size):
        base[s, j] = motion[s]
    base[0, j] -= chain.gx
    base[1, j] -= chain.gy


@inlined
def load_joint(row, k, up, at, h, reaction_factor):  # type: ignore[no-untyped-def]
    """Torque and slope of a link's joint as ``link_step`` takes them, and the friction work of the step."""
    joint, slip = read(row, k, at, JOINT), row[at + SLIP * k]
    (q, w), (q_up, w_up) = read(row, k, at, (Q, W)), read(row, k, up, (Q, W))
    t, t_back, kappa, kappa_back = joint_law.torques(joint, reaction_factor, q - q_up, w - w_up, slip, h)
    lost = h * joint_law.power(joint, reaction_factor, w, w_up, slip)
    return (t + row[at + EXTERNAL * k], t_back, kappa, kappa_back), lost


@inlined
def load_answer(row, k, at, reaction_factor):  # type: ignore[no-untyped-def]
    """Answer at the offset `at`, as ``link_step`` takes the answer of the link beyond."""
    return mutual(read(row, k, at, SYMMETRIC)) if reaction_factor == 1.0 else read(row, k, at, ANSWER)


@inlined
def store_answer(row, k, at, reaction_factor, answer):  # type: ignore[no-untyped-def]
    """Keep an answer at the offset `at`."""
    write(row, k, at, SYMMETRIC, answer[:9])
    if reaction_factor == 0.0:  # else they are AXY, FX and FY
        write(row, k, at, (AYX, UX, UY), answer[9:])


@non_allocating
def air(width, lanes, base):  # type: ignore[no-untyped-def]
    """Add the torques of the air to EXTERNAL of the links, (M.32); its force and power go to FX, FY and S of row 0.

    `base` as in :func:`euler`. Velocities of the joints pass through PX and PY, forces through BX, BY and BETA.
    """
    k = len(width)
    n = lanes.size // (ROW * k) - 2
    for j in range(k):
        write(lanes, k, j, (PX, PY), (base[5, j], base[6, j]))
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ROW * k : (i + 1) * ROW * k]
        for j in range(k):
            up, at = UP * k + j, AT * k + j
            (vx, vy), (length, w, sin, cos) = read(row, k, up, (PX, PY)), read(row, k, at, (LENGTH, W, SIN, COS))
            write(row, k, at, (PX, PY), (vx + length * w * cos, vy + length * w * sin))
    for way in range(n):
        i = n - way
        motor = 1.0 if i == 1 or base.shape[0] > BASE_SIZE else 0.0
        row = lanes[(i - 1) * ROW * k : (i + 2) * ROW * k]
        for j in range(k):
            up, at, down = UP * k + j, AT * k + j, DOWN * k + j
            drag, length, w, sin, cos, external = read(row, k, at, (DRAG, LENGTH, W, SIN, COS, EXTERNAL))
            (vx, vy), (fx, fy, power) = read(row, k, up, (PX, PY)), read(row, k, down, (BX, BY, BETA))
            across = vx * cos + vy * sin
            force, moment = link_drag(drag, length, across, length * w)
            row[at + EXTERNAL * k] = length * (cos * fx + sin * fy) - moment + motor * external
            whole = fx - force * cos, fy - force * sin, power + force * across + moment * w
            write(row, k, at, (BX, BY, BETA), whole)
    for j in range(k):
        write(lanes, k, j, (FX, FY, S), read(lanes, k, ROW * k + j, (BX, BY, BETA)))


@non_allocating
def regularize(width, tolerance, lanes, base):  # type: ignore[no-untyped-def]
    """Give each joint the viscous friction that stands for its own (OWN) and dry friction (LOSS) at its present rate.

    `tolerance`, rad/s, as in ``joint_law.regularized``, `base` as in :func:`euler`.
    """
    k = len(width)
    n = lanes.size // (ROW * k) - 2
    for j in range(k):
        lanes[W * k + j] = base[3, j]
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ROW * k : (i + 1) * ROW * k]
        for j in range(k):
            up, at = UP * k + j, AT * k + j
            joint = row[at + OWN * k], row[at + LOSS * k], 0.0, 0.0
            row[at + VISCOUS * k], _, _, _ = joint_law.regularized(joint, row[at + W * k] - row[up + W * k], tolerance)


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
        store_answer(tip, k, j, reaction_factor, (mass, 0.0, mass, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        tip[DISSIPATED * k + j] = 0.0
    for way in range(n):
        i = n - way
        row = lanes[(i - 1) * ROW * k : (i + (1 if one_place else 2)) * ROW * k]
        answers = tip if one_place else row
        for j in range(k):
            up, at = UP * k + j, AT * k + j
            near, far = (j, j) if one_place else (at, DOWN * k + j)
            h = answers[far + STEP * k]
            joint, lost = load_joint(row, k, up, at, h, reaction_factor)
            slip, w, sin, cos = read(row, k, at, (SLIP, W, SIN, COS))
            link, beyond = read(row, k, at, LINK), load_answer(answers, k, far, reaction_factor)
            answer, back = link_step(link, joint, slip * slip, reaction_factor, sin, cos, w * w, beyond)
            store_answer(answers, k, near, reaction_factor, answer)
            write(row, k, at, BACK, back[:4])
            answers[near + DISSIPATED * k] = answers[far + DISSIPATED * k] + lost
            if not one_place:
                row[at + INV * k] = back[4]
                row[at + STEP * k] = h


@non_allocating
def advance(width, more, lanes, tip):  # type: ignore[no-untyped-def]
    """From motor to tip: accelerations, w + h alpha, q + h w and, with MORE, its sine and cosine for the next step."""
    k = len(width)
    one_place = k > len(COLUMNS)
    n = lanes.size // (ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ROW * k : (i + 1) * ROW * k]
        place = tip if one_place else row
        for j in range(k):
            at = AT * k + j
            near, far = (j, j) if one_place else (UP * k + j, at)
            (px, py, alpha_up), h = read(place, k, near, MOTION), place[far + STEP * k]
            (q, w, sin, cos), length = read(row, k, at, STATE), row[at + LENGTH * k]
            rd, ex, ey, kd = read(row, k, at, BACK)
            alpha = rd - ex * px - ey * py + kd * alpha_up
            x, y = px + length * (cos * alpha - sin * w * w), py + length * (sin * alpha + cos * w * w)
            write(place, k, far, MOTION, (x, y, alpha))
            w += h * alpha
            q += h * w
            write(row, k, at, (Q, W), (q, w))
            if len(more) > 0:
                write(row, k, at, (SIN, COS), sincos(q))


@inlined
def base_load(top, answers, k, j, reaction_factor, base):  # type: ignore[no-untyped-def]
    """Force x, y on lane j's chain at its first joint, which moves as `base` (9 or more, k), and torque through it."""
    px, py, up = base[0, j], base[1, j], base[2, j]
    axx, axy, ayy, fx, fy, bx, by, s, beta, ayx, ux, uy = load_answer(answers, k, j, reaction_factor)
    air_x, air_y = read(top, k, j, (FX, FY))
    moment = ux * px + uy * py + s * up + beta
    return axx * px + axy * py + fx * up + bx - air_x, ayx * px + ayy * py + fy * up + by - air_y, moment


@non_allocating
def euler(width, reaction, more, lanes, tip, base):  # type: ignore[no-untyped-def]
    """One linearly implicit Euler step in every lane, each of its own length.

    Parameters
    ----------
    width, reaction : tuples whose lengths are the number of lanes, k, and of links that bear a joint's friction
    more : MORE or LAST
    lanes : ((n + 2) ROW k,), advanced in place; WORK and LOST of row 0 grow
    tip : (ROW k,) the last row, see :func:`rows`; EXTERNAL (N m) and STEP (s) are read from it
    base : (9 or more, k) motion of the first joint, and torques on the links, at the beginning of each lane's step, as
        ``drive.base_state`` writes them, with gravity taken off the acceleration
    """
    k = len(width)
    top = lanes[: ROW * k]
    for j in range(k):
        write(top, k, j, (W, Q), (base[3, j], base[4, j]))
        lanes[(ROW + EXTERNAL) * k + j] = tip[EXTERNAL * k + j]
    for i in range(base.shape[0] - BASE_SIZE):
        for j in range(k):
            lanes[((i + 1) * ROW + EXTERNAL) * k + j] = base[BASE_SIZE + i, j] + (
                tip[EXTERNAL * k + j] if i == 0 else 0.0
            )
    if top[DRAG * k : (DRAG + 1) * k].any():
        air(width, lanes, base)
    sweep(width, reaction, lanes, tip)
    one_place = k > len(COLUMNS)
    answers = tip if one_place else lanes[ROW * k : 2 * ROW * k]
    start = answers if one_place else top
    row = lanes[ROW * k : 2 * ROW * k]
    for j in range(k):
        fx, fy, moment = base_load(top, answers, k, j, len(reaction) - 1.0, base)
        power = fx * base[5, j] + fy * base[6, j] + moment * base[3, j] + tip[EXTERNAL * k + j] * row[W * k + j]
        h = answers[STEP * k + j]
        top[WORK * k + j] += h * power
        top[LOST * k + j] += answers[DISSIPATED * k + j] + h * top[S * k + j]
        write(start, k, j, MOTION, (base[0, j], base[1, j], base[2, j]))
    for i in range(base.shape[0] - BASE_SIZE):
        for j in range(k):
            power = base[BASE_SIZE + i, j] * lanes[((i + 1) * ROW + W) * k + j]
            top[WORK * k + j] += answers[STEP * k + j] * power
    advance(width, more, lanes, tip)
