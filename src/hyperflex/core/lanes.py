"""The sweep in SIMD lanes: chains side by side, each taking its own linearly implicit Euler step.

A single rollout puts the columns of its extrapolation table into the lanes (:data:`COLUMNS`); a batch puts whole
rollouts there (:data:`MEMBERS`). All lane data lie in one flat array of n + 2 rows: row 0 is the parent (arm or wall),
rows 1..n are the links, row n + 1 is what hangs beyond the tip. A row holds ROW quantities of one number a lane.

LLVM turns the inner loops over lanes into packed instructions only where it can prove that no two accesses of a loop
overlap. So each loop touches one slice of three neighbouring rows, at offsets that are constants: (UP + slot) * k + j
for the parent, (AT + slot) * k + j for the link itself, (DOWN + slot) * k + j for the link beyond, with k lanes and
lane j. The number of lanes is the length of a tuple, which the compiler knows. ``vdivpd`` in the assembly of
:func:`sweep` shows that it worked (tests/core/test_lanes.py looks).
"""

from __future__ import annotations

from hyperflex.core.chain import link_step, mutual, sincos
from hyperflex.core.jit import inlined, kernel

COLUMNS = (0,) * 4
MEMBERS = (0,) * 16

# parameters of a link
LENGTH, MA, INERTIA, MASS, VISCOUS, STIFFNESS, REST, DRY = range(8)
# state, with the sense of slipping (0: stuck); sine, cosine; (r inv, ex inv, ey inv, k, inv) for the way back; step
GRIP, Q, W, SIN, COS, RD, EX, EY, KD, INV, STEP = range(8, 19)
# on the way to the motor: the answer at the motor-side joint; AYX, UX and UY are not used where friction is mutual
AXX, AXY, AYX, AYY, FX, FY, BX, BY, UX, UY, S, BETA = range(19, 31)
# on the way back: acceleration of the far joint (less gravity), and of the link
PX, PY, ALPHA = range(31, 34)
# friction work, summed up from the tip; of the lane as a whole, in row 0: torque on link 0, work put in
DISSIPATED, EXTERNAL, WORK = range(34, 37)
# extrapolation with whole rollouts in the lanes: state at the start, result and error estimate, lever of the link,
# error of the far joint's position and velocity, and the largest squares of both so far
Q_START, W_START, Q_SUM, W_SUM, Q_GAP, W_GAP, LEVER = range(37, 44)
ERR_X, ERR_Y, ERR_VX, ERR_VY, WORST, WORST_V = range(44, 50)
ROW = 50
UP, AT, DOWN = 0, ROW, 2 * ROW


@kernel
def load(width, chain, lanes):  # type: ignore[no-untyped-def]
    """Copy the parameters of one chain into every lane of ``lanes`` ((n + 2) ROW,)."""
    k = len(width)
    n = chain.length.size
    for i in range(n):
        ma = chain.mass[i] * chain.com[i]
        row = lanes[(i + 1) * ROW * k : (i + 2) * ROW * k]
        for j in range(k):
            row[LENGTH * k + j] = chain.length[i]
            row[MA * k + j] = ma
            row[INERTIA * k + j] = chain.inertia[i] + ma * chain.com[i]
            row[MASS * k + j] = chain.mass[i]
            row[VISCOUS * k + j] = chain.viscous[i]
            row[STIFFNESS * k + j] = chain.stiffness[i]
            row[REST * k + j] = chain.rest[i]
            row[DRY * k + j] = chain.dry[i]
            row[GRIP * k + j] = 1.0
    tip = lanes[(n + 1) * ROW * k : (n + 2) * ROW * k]
    tip[:] = 0.0
    for j in range(k):
        tip[AXX * k + j] = chain.tip_mass
        tip[AYY * k + j] = chain.tip_mass


@kernel
def set_grip(width, lanes, grip):  # type: ignore[no-untyped-def]
    """Set how each joint slips in every lane, (n,) as in ``chain.accelerations``."""
    k = len(width)
    for i in range(grip.size):
        for j in range(k):
            lanes[((i + 1) * ROW + GRIP) * k + j] = grip[i]


@inlined
def load_joint(row, k, j, h, first, share):  # type: ignore[no-untyped-def]
    """Torque and slope of a link's joint as ``link_step`` takes them, and the friction work of the step."""
    stiffness = row[(AT + STIFFNESS) * k + j]
    w = row[(AT + W) * k + j]
    rate = w - row[(UP + W) * k + j]
    bend = row[(AT + Q) * k + j] - row[(UP + Q) * k + j] - row[(AT + REST) * k + j]
    spring = -stiffness * (bend + h * rate)
    friction = -row[(AT + VISCOUS) * k + j] * rate - row[(AT + DRY) * k + j] * row[(AT + GRIP) * k + j]
    slope = h * row[(AT + VISCOUS) * k + j]
    soft = h * h * stiffness
    external = first * row[(UP + EXTERNAL) * k + j]
    joint = (friction + spring + external, share * friction + spring, slope + soft, share * slope + soft)
    return joint, h * friction * (w - share * row[(UP + W) * k + j])


@inlined
def load_answer(row, k, j, share, at):  # type: ignore[no-untyped-def]
    """Answer of the row at offset ``at``, as ``link_step`` takes that of the link beyond."""
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
    return mutual(answer) if share == 1.0 else answer


@inlined
def store_answer(row, k, j, share, at, back):  # type: ignore[no-untyped-def]
    """Keep what ``link_step`` returned."""
    row[(AT + AXX) * k + j] = at[0]
    row[(AT + AXY) * k + j] = at[1]
    row[(AT + AYY) * k + j] = at[3]
    row[(AT + FX) * k + j] = at[4]
    row[(AT + FY) * k + j] = at[5]
    row[(AT + BX) * k + j] = at[6]
    row[(AT + BY) * k + j] = at[7]
    row[(AT + S) * k + j] = at[10]
    row[(AT + BETA) * k + j] = at[11]
    if share == 0.0:  # else they are AXY, FX and FY
        row[(AT + AYX) * k + j] = at[2]
        row[(AT + UX) * k + j] = at[8]
        row[(AT + UY) * k + j] = at[9]
    row[(AT + RD) * k + j] = back[0]
    row[(AT + EX) * k + j] = back[1]
    row[(AT + EY) * k + j] = back[2]
    row[(AT + KD) * k + j] = back[3]
    row[(AT + INV) * k + j] = back[4]


@kernel
def sweep(width, bears, lanes):  # type: ignore[no-untyped-def]
    """From tip to motor: the answer of the chain at each joint (M.8)-(M.13), and the friction work of the step.

    One large loop body on purpose: LLVM unrolls small loops over so few lanes before it looks for packed instructions.
    """
    k = len(width)
    share = len(bears) - 1.0
    n = lanes.size // (ROW * k) - 2
    for way in range(n):
        i = n - way
        first = 1.0 if i == 1 else 0.0  # link 0 bears the external torque
        row = lanes[(i - 1) * ROW * k : (i + 2) * ROW * k]
        for j in range(k):
            h = row[(DOWN + STEP) * k + j]
            joint, lost = load_joint(row, k, j, h, first, share)
            link = (
                row[(AT + LENGTH) * k + j],
                row[(AT + MA) * k + j],
                row[(AT + INERTIA) * k + j],
                row[(AT + MASS) * k + j],
            )
            grip = row[(AT + GRIP) * k + j]
            w = row[(AT + W) * k + j]
            sin, cos = sincos(row[(AT + Q) * k + j])
            beyond = load_answer(row, k, j, share, DOWN)
            at, back = link_step(link, joint, grip * grip, share, sin, cos, w * w, beyond)
            store_answer(row, k, j, share, at, back)
            row[(AT + STEP) * k + j] = h
            row[(AT + SIN) * k + j] = sin
            row[(AT + COS) * k + j] = cos
            row[(AT + DISSIPATED) * k + j] = row[(DOWN + DISSIPATED) * k + j] - lost


@kernel
def advance(width, lanes):  # type: ignore[no-untyped-def]
    """From motor to tip: accelerations, then w + h alpha and q + h w of the Euler step."""
    k = len(width)
    n = lanes.size // (ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ROW * k : (i + 1) * ROW * k]
        for j in range(k):
            px = row[(UP + PX) * k + j]
            py = row[(UP + PY) * k + j]
            w = row[(AT + W) * k + j]
            length = row[(AT + LENGTH) * k + j]
            sin = row[(AT + SIN) * k + j]
            cos = row[(AT + COS) * k + j]
            alpha = (
                row[(AT + RD) * k + j]
                - row[(AT + EX) * k + j] * px
                - row[(AT + EY) * k + j] * py
                + row[(AT + KD) * k + j] * row[(UP + ALPHA) * k + j]
            )
            row[(AT + ALPHA) * k + j] = alpha
            row[(AT + PX) * k + j] = px + length * (cos * alpha - sin * w * w)
            row[(AT + PY) * k + j] = py + length * (sin * alpha + cos * w * w)
            w += row[(AT + STEP) * k + j] * alpha
            row[(AT + W) * k + j] = w
            row[(AT + Q) * k + j] += row[(AT + STEP) * k + j] * w


@kernel
def euler(width, bears, lanes, base):  # type: ignore[no-untyped-def]
    """One linearly implicit Euler step in every lane, each of its own length.

    Parameters
    ----------
    width, bears : tuples whose lengths are the number of lanes, k, and of links that bear a joint's friction
    lanes : ((n + 2) ROW k,), advanced in place. EXTERNAL (N m) is read from row 0, STEP (s) from the last row;
        WORK and DISSIPATED of row 0 grow
    base : (k, 9) motion of the first joint at the beginning of each lane's step, as ``drive.base_state`` writes it,
        with gravity taken off its acceleration
    """
    k = len(width)
    top = lanes[: ROW * k]
    for j in range(k):
        top[W * k + j] = base[j, 3]
        top[Q * k + j] = base[j, 4]
    sweep(width, bears, lanes)
    row = lanes[ROW * k : 2 * ROW * k]
    for j in range(k):
        px = base[j, 0]
        py = base[j, 1]
        up = base[j, 2]
        axx, axy, ayx, ayy, fx, fy, bx, by, ux, uy, s, beta = load_answer(lanes, k, j, len(bears) - 1.0, ROW)
        fx = axx * px + axy * py + fx * up + bx
        fy = ayx * px + ayy * py + fy * up + by
        moment = ux * px + uy * py + s * up + beta
        power = fx * base[j, 5] + fy * base[j, 6] + moment * base[j, 3] + top[EXTERNAL * k + j] * row[W * k + j]
        top[WORK * k + j] += row[STEP * k + j] * power
        top[DISSIPATED * k + j] += row[DISSIPATED * k + j]
        top[PX * k + j] = px
        top[PY * k + j] = py
        top[ALPHA * k + j] = up
    advance(width, lanes)
