"""Batch rollouts: each lane runs one member with its own step and then takes the next.

No number of one lane ever enters another, so a member's result does not depend on its neighbours or on the threads.
"""

import math

import numpy as np

from hyperflex.core import status
from hyperflex.core.batch.members import (
    AFTER,
    BASE,
    CLOCK,
    END,
    EXTERNAL,
    LAST,
    NEXT_STEP,
    ORIGIN,
    PATH,
    RESTARTED,
    RETRY,
    SINCE,
    SIZE,
    STEP,
    TIME,
    UNDECIDED,
    base_motion,
    chain_of,
    enter,
    piece,
    save_clock,
)
from hyperflex.core.batch.stiction import assess_lane, decide_lane_modes, finish_lane, new_lane_stiction
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import can_stick, sincos
from hyperflex.core.integrate.event_search import AGAIN, EVENT
from hyperflex.core.integrate.step_size import (
    LARGEST_STEP,
    MOST,
    SMALLEST_STEP,
    allowed,
    fitted,
    is_rounding,
    lasting,
    longer,
    shorter,
)
from hyperflex.core.jit import kernel, non_allocating


@non_allocating
def begin_column(width, lanes, sums):  # type: ignore[no-untyped-def]
    """Set every lane back to the state at the start of its step; with `sums`, also clear the extrapolated sums."""
    k = len(width)
    n = lanes.size // (ln.ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * k : (i + 1) * ln.ROW * k]
        for j in range(k):
            row[ln.Q * k + j] = row[ln.Q_START * k + j]
            row[ln.W * k + j] = row[ln.W_START * k + j]
            row[ln.SIN * k + j] = row[ln.SIN_START * k + j]
            row[ln.COS * k + j] = row[ln.COS_START * k + j]
        if sums:
            for j in range(k):
                row[ln.Q_SUM * k + j] = 0.0
                row[ln.W_SUM * k + j] = 0.0
                row[ln.Q_GAP * k + j] = 0.0
                row[ln.W_GAP * k + j] = 0.0


@non_allocating
def end_column(width, lanes, best, gap):  # type: ignore[no-untyped-def]
    """Add the increments of a finished column to the result and to the error estimate."""
    k = len(width)
    n = lanes.size // (ln.ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * k : (i + 1) * ln.ROW * k]
        for j in range(k):
            dq = row[ln.Q * k + j] - row[ln.Q_START * k + j]
            dw = row[ln.W * k + j] - row[ln.W_START * k + j]
            row[ln.Q_SUM * k + j] += best * dq
            row[ln.W_SUM * k + j] += best * dw
            row[ln.Q_GAP * k + j] += gap * dq
            row[ln.W_GAP * k + j] += gap * dw


@non_allocating
def measure(width, lanes, tip):  # type: ignore[no-untyped-def]
    """Sine and cosine of the result, and the largest squared errors of any joint's position and velocity (in `tip`)."""
    k = len(width)
    n = lanes.size // (ln.ROW * k) - 2
    for slot in range(ln.ERR_X, ln.WORST_V + 1):
        tip[slot * k : (slot + 1) * k] = 0.0
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * k : (i + 1) * ln.ROW * k]
        for j in range(k):
            sin, cos = sincos(row[ln.Q_START * k + j] + row[ln.Q_SUM * k + j])
            row[ln.SIN * k + j] = sin
            row[ln.COS * k + j] = cos
            a = row[ln.LEVER * k + j] * row[ln.Q_GAP * k + j]
            b = row[ln.LEVER * k + j] * row[ln.W_GAP * k + j]
            x = tip[ln.ERR_X * k + j] + cos * a
            y = tip[ln.ERR_Y * k + j] + sin * a
            vx = tip[ln.ERR_VX * k + j] + cos * b
            vy = tip[ln.ERR_VY * k + j] + sin * b
            tip[ln.ERR_X * k + j] = x
            tip[ln.ERR_Y * k + j] = y
            tip[ln.ERR_VX * k + j] = vx
            tip[ln.ERR_VY * k + j] = vy
            worst = tip[ln.WORST * k + j]
            worst_v = tip[ln.WORST_V * k + j]
            position = x * x + y * y
            velocity = vx * vx + vy * vy
            tip[ln.WORST * k + j] = position if position > worst else worst
            tip[ln.WORST_V * k + j] = velocity if velocity > worst_v else worst_v


@non_allocating
def extrapolate_lanes(members, terms, lane, energy, lanes, tip, path):  # type: ignore[no-untyped-def]
    """One extrapolated step of length NEXT_STEP in every lane; the result is in the sums of `lanes` and `energy`."""
    k = len(ln.MEMBERS)
    order = terms.best.size - 1
    base = path[BASE * k :].reshape(9, k)
    energy[:, 2:] = 0.0
    for col in range(1, order + 1):
        begin_column(ln.MEMBERS, lanes, col == 1)
        for j in range(k):
            tip[ln.STEP * k + j] = lane[j, NEXT_STEP] / col
            lanes[ln.WORK * k + j] = 0.0
            lanes[ln.LOST * k + j] = 0.0
            path[SINCE * k + j] = lane[j, TIME] - lane[j, ORIGIN]
        for s in range(col):
            base_motion(ln.MEMBERS, path)
            for j in range(k):
                tip[ln.EXTERNAL * k + j] = path[EXTERNAL * k + j]
                path[SINCE * k + j] += tip[ln.STEP * k + j]
            if s < col - 1:
                ln.euler(ln.MEMBERS, terms.reaction, ln.MORE, lanes, tip, base)
            else:
                ln.euler(ln.MEMBERS, terms.reaction, ln.LAST, lanes, tip, base)
        end_column(ln.MEMBERS, lanes, terms.best[col], terms.gap[col])
        for j in range(k):
            energy[j, 2] += terms.best[col] * lanes[ln.WORK * k + j]
            energy[j, 3] += terms.best[col] * lanes[ln.LOST * k + j]
    measure(ln.MEMBERS, lanes, tip)


@non_allocating
def accept(lanes, n, j, energy):  # type: ignore[no-untyped-def]
    """Make the result of lane j's step the start of its next one."""
    k = len(ln.MEMBERS)
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * k : (i + 1) * ln.ROW * k]
        row[ln.Q_START * k + j] += row[ln.Q_SUM * k + j]
        row[ln.W_START * k + j] += row[ln.W_SUM * k + j]
        row[ln.SIN_START * k + j] = row[ln.SIN * k + j]
        row[ln.COS_START * k + j] = row[ln.COS * k + j]
    energy[j, 0] += energy[j, 2]
    energy[j, 1] += energy[j, 3]


@non_allocating
def write(lanes, n, j, energy, out):  # type: ignore[no-untyped-def]
    """Copy the state of lane j to ``out`` (2 n + 2,)."""
    k = len(ln.MEMBERS)
    for i in range(n):
        out[i] = lanes[((i + 1) * ln.ROW + ln.Q_START) * k + j]
        out[n + i] = lanes[((i + 1) * ln.ROW + ln.W_START) * k + j]
    out[2 * n] = energy[j, 0]
    out[2 * n + 1] = energy[j, 1]


@non_allocating
def lane_error(terms, tip, j, step):  # type: ignore[no-untyped-def]
    """Error of lane j's step in units of what is allowed; 0 for a fixed step, inf where it is not finite."""
    k = len(ln.MEMBERS)
    finite = abs(tip[ln.ERR_VX * k + j]) + abs(tip[ln.ERR_VY * k + j]) < np.inf
    worst = max(tip[ln.WORST * k + j], lasting(step) ** 2 * tip[ln.WORST_V * k + j])
    if not finite or not (worst < np.inf):
        return np.inf
    if terms.fixed > 0.0 or step < SMALLEST_STEP:  # so short only where it is cut: nothing to control
        return 0.0
    return math.sqrt(worst) / allowed(terms.tol, step, terms.rounding)


@non_allocating
def prepare(members, terms, member, lane, index, path, t_out):  # type: ignore[no-untyped-def]
    """Choose the length of every lane's next step (NEXT_STEP); returns the number of lanes at work."""
    busy = 0
    for j in range(member.size):
        if member[j] >= 0 and lane[j, RETRY] == 1.0:  # its step is being shortened
            busy += 1
            continue
        lane[j, NEXT_STEP] = 0.0
        if member[j] < 0:
            continue
        busy += 1
        t = lane[j, TIME]
        if t >= lane[j, END]:
            piece(members, member[j], t, path, j, lane[j])
            lane[j, STEP] = min(lane[j, STEP], lane[j, AFTER])
            lane[j, RESTARTED] = lane[j, UNDECIDED] = 1.0
            lane[j, LAST] = 0.0
        left = min(lane[j, END], t_out[index[j]]) - t
        if terms.fixed > 0.0:
            lane[j, NEXT_STEP] = min(terms.fixed, left)
        else:
            lane[j, NEXT_STEP] = fitted(min(lane[j, STEP], LARGEST_STEP), left)
    return busy


@non_allocating
def control_step(terms, lane, end, size, sticks):  # type: ignore[no-untyped-def]
    """Note a step of the error `size` in a lane's clock, where a chain `sticks` or not, and choose the next; a code."""
    order = terms.best.size - 1
    step = lane[NEXT_STEP]
    if size <= 1.0:
        lane[TIME] = end if step >= end - lane[TIME] else lane[TIME] + step
        faint = sticks and is_rounding(size, terms.tol, step, terms.rounding)
        grown = MOST * step if faint else longer(step, size, lane[LAST], lane[SIZE], order)
        lane[STEP] = max(grown, lane[STEP]) if step < lane[STEP] else grown
        lane[LAST], lane[SIZE] = 0.0 if faint else step, size
        if lane[RESTARTED] == 1.0:
            lane[AFTER] = lane[STEP]
            lane[RESTARTED] = 0.0
        return status.OK
    if terms.fixed > 0.0:
        return status.NOT_FINITE
    lane[STEP] = shorter(step, size, order)
    return status.STEP_TOO_SMALL if lane[STEP] < SMALLEST_STEP else status.RUNNING


@kernel
def run_block(members, terms, low, high, t_out, y_out, codes, reached, stop):  # type: ignore[no-untyped-def]
    """Run members low..high - 1; each step ends at a break of the drive or at an output at the latest.

    Parameters
    ----------
    members, terms : Members, Terms
    low, high : int
    t_out : (T,) increasing times after ``terms.begin``, s; the run ends at the last one
    y_out : (high - low, T, 2 n + 2) out, states
    codes : (high - low,) out, status codes
    reached : (high - low,) out, s
    stop : (1,) int64; once another thread makes it 1, the block ends: members at work keep their codes as they were
    """
    k = len(ln.MEMBERS)
    n = members.links.shape[2]
    lanes, tip = ln.rows(ln.MEMBERS, n)
    path = np.zeros(PATH * k)
    lane = np.zeros((k, CLOCK))
    energy = np.zeros((k, 4))  # work and dissipation at the start of the step, and their increments
    member = np.full(k, -1)
    index = np.zeros(k, dtype=np.int64)
    coming = low
    sticks, friction = np.zeros(k, dtype=np.bool_), new_lane_stiction(n)
    for i in range(1, n + 1):  # idle lanes are swept too: an inertia keeps their numbers finite
        lanes[(i * ln.ROW + ln.INERTIA) * k : (i * ln.ROW + ln.INERTIA + 1) * k] = 1.0
    while True:
        for j in range(k):
            if member[j] < 0 and coming < high:
                member[j], index[j] = coming, 0
                sticks[j] = can_stick(chain_of(members, terms, coming, 0.0, 0.0))
                enter(members, terms, coming, lanes, tip, path, j, lane[j], energy[j])
                coming += 1
        if prepare(members, terms, member, lane, index, path, t_out) == 0:
            return
        if stop[0] != 0:
            for j in range(k):
                if member[j] >= 0:
                    reached[member[j] - low] = lane[j, TIME]
            return
        for j in range(k):
            unsettled = sticks[j] and member[j] >= 0 and lane[j, UNDECIDED] == 1.0
            if unsettled and not decide_lane_modes(members, terms, member[j], lanes, path, j, lane[j], friction):
                codes[member[j] - low], reached[member[j] - low], member[j] = status.FRICTION, lane[j, TIME], -1
        extrapolate_lanes(members, terms, lane, energy, lanes, tip, path)
        for j in range(k):
            if member[j] < 0:
                continue
            m = member[j] - low
            end = min(lane[j, END], t_out[index[j]])
            size = lane_error(terms, tip, j, lane[j, NEXT_STEP])
            step, verdict = lane[j, NEXT_STEP], 0
            if lane[j, RETRY] == 1.0 and size < np.inf:
                size = min(size, 1.0)  # its longer attempt was good
            if sticks[j] and size <= 1.0:
                verdict = assess_lane(members, terms, member[j], lanes, path, j, lane[j], friction)
                if verdict == AGAIN:
                    continue
            code = control_step(terms, lane[j], end, size, sticks[j])
            if code == status.OK:
                accept(lanes, n, j, energy)
                if sticks[j]:
                    finish_lane(lanes, n, j, lane[j], energy, step, verdict == EVENT, friction)
                if t_out[index[j]] <= lane[j, TIME]:
                    write(lanes, n, j, energy, y_out[m, index[j]])
                    index[j] += 1
            if index[j] == t_out.size or code == status.STEP_TOO_SMALL or code == status.NOT_FINITE:
                save_clock(members, member[j], lane[j])
                codes[m], reached[m], member[j] = code, lane[j, TIME], -1
