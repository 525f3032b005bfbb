"""Batch rollouts: members, dry friction in the lanes, and the run loop.

Each lane runs one member with its own step and then takes the next. No number of one lane ever enters another, so a
member's result does not depend on its neighbours or on the threads.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core import status
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import (
    BASE_SIZE,
    SLIDING,
    STICKING,
    Array,
    Chain,
    can_stick,
    chain_of_rows,
    energies,
    sincos,
)
from hyperflex.core.chain.drive import (
    ANGLE,
    TORQUE,
    Drive,
    Segment,
    X,
    Y,
    base_state,
    motion_at,
    polynomial,
    segment,
    within,
    write_base,
)
from hyperflex.core.chain.lanes import (
    COS,
    LOST,
    MEMBERS,
    Q_GAP,
    Q_START,
    Q_SUM,
    ROW,
    SIN,
    SLIP,
    W_GAP,
    W_START,
    W_SUM,
    WORK,
    Q,
    W,
)
from hyperflex.core.integrate.events import (
    AGAIN,
    EVENT,
    NEVER,
    Search,
    assess_attempt,
    begin_search,
    new_searches,
    search_of,
)
from hyperflex.core.integrate.rollout import (
    AFTER,
    CHATTER,
    LAST,
    ORDER,
    SIZE,
    STEP,
    UNDECIDED,
    T,
    count_chatter,
    restart,
    set_next_step,
)
from hyperflex.core.integrate.step_size import (
    LARGEST_STEP,
    SMALLEST_STEP,
    STEP_SIZE,
    allowed,
    fitted,
    is_rounding,
    lasting,
    longer,
    shorter,
)
from hyperflex.core.jit import constant, inlined, kernel, non_allocating, read, write, zeros
from hyperflex.core.stiction import (
    StictionWorkspace,
    decide_modes,
    new_stiction_workspace,
    stuck_loss,
    tolerance_factor,
)


class Members(NamedTuple):
    """What the members of a batch are made of; drives lie one after the other, member m's from first[m] on."""

    links: Array  # (m, 11, n): the fields of a Chain in their order, and the lever
    whole: Array  # (m, 5): tip mass, gravity x, y, arm length, torque limit
    start: Array  # (m, 2 n + 2) states at begin
    breaks: Array  # (sum of k + 1,), s
    coef: Array  # (sum of k + 1, 4, 6); the last row of each member is not used
    switch: npt.NDArray[np.bool_]  # (sum of k + 1,) all True
    loop: npt.NDArray[np.int64]  # (m,) as in Drive
    first: npt.NDArray[np.int64]  # (m + 1,)
    clock: Array  # (m, 3) STEP, AFTER and CHATTER of each, changed in place: a batch that continues needs them


class Terms(NamedTuple):
    """What the members have in common."""

    begin: float  # s
    tol: float  # m
    reaction: tuple[int, ...]  # as in Chain
    fixed: float  # s, a step chosen beforehand; 0.0: error control
    best: Array  # (p + 1,) weights of the columns, as in Scheme
    gap: Array  # in the error estimate
    rounding: float  # m, as in Scheme
    stiction: float  # rad/s, tolerance of regularized dry friction; 0.0: joints stick


LENGTH, DRY, LEVER = map(Chain._fields.index, ("length", "dry", "tip_mass"))  # rows of ``links``
TIP_MASS, GRAVITY_X, GRAVITY_Y, ARM_LENGTH, TORQUE_LIMIT = range(5)
# a lane's clock, s: begins as in rollout; the step wanted next; RETRY: 1.0 while a step is being shortened to end at an
# event; then the Segment of the drive, and since when its coefficients count
NEXT_STEP, RETRY, START, END, OFFSET, FIRST_PIECE, LAST_PIECE, ORIGIN, CLOCK = range(ORDER, ORDER + 9)
# What moves the first joints, in lanes: slot * k + lane. Coefficients of four channels, parameters that seldom change,
# the time since the piece began; then the torque on link 0 and what ``drive.base_state`` gives, less gravity
POWERS = tuple(range(6))
COEF, ARM, GX, GY, LIMIT, SINCE, EXTERNAL, BASE, PATH = 0, 24, 25, 26, 27, 28, 29, 30, 39


@non_allocating
def enter(members, terms, m, lanes, tip, path, j, lane, energy):  # type: ignore[no-untyped-def]
    """Put member m into lane j: parameters, state at the start, clock (CLOCK,) and energies (4,)."""
    k = len(MEMBERS)
    n, whole, start = members.links.shape[2], members.whole[m], members.start[m]
    ln.load_lane(MEMBERS, j, chain_of(members, terms, m), lanes, tip)
    for i in range(n):
        at = (i + 1) * ROW * k + j
        lanes[at + ln.LEVER * k] = members.links[m, LEVER, i]
        if terms.stiction > 0.0:
            write(lanes, k, at, (ln.OWN, ln.LOSS, ln.DRY), (*read(lanes, k, at, (ln.VISCOUS, ln.DRY)), 0.0))
        write(lanes, k, at, ln.START, (start[i], start[n + i], *sincos(start[i])))
    write(
        path, k, j, (GX, GY, ARM, LIMIT), (whole[GRAVITY_X], whole[GRAVITY_Y], whole[ARM_LENGTH], whole[TORQUE_LIMIT])
    )
    energy[0], energy[1] = start[2 * n], start[2 * n + 1]
    lane[:] = 0.0
    lane[T] = lane[END] = terms.begin
    lane[STEP], lane[AFTER], lane[CHATTER] = members.clock[m]


@inlined
def drive_of(members, m):  # type: ignore[no-untyped-def]
    """Drive of member m; a step in the lanes ends at each of its breaks, as if all were switches."""
    rows, whole = slice(members.first[m], members.first[m + 1]), members.whole[m]
    breaks, coef, switch = constant(members.breaks[rows]), constant(members.coef[rows]), constant(members.switch[rows])
    return Drive(breaks, coef, switch, members.loop[m], whole[ARM_LENGTH], whole[TORQUE_LIMIT])


@inlined
def part_of(lane):  # type: ignore[no-untyped-def]
    """Segment of the drive in which a lane with such a clock is."""
    return Segment(lane[START], lane[END], lane[OFFSET], int(lane[FIRST_PIECE]), int(lane[LAST_PIECE]))


@non_allocating
def piece(members, m, t, path, j, lane):  # type: ignore[no-untyped-def]
    """Find the piece of member m's drive that holds from t on; copies its coefficients, notes its start and end."""
    k, drive = len(MEMBERS), drive_of(members, m)
    part = segment(drive, t)
    lane[START], lane[END], lane[OFFSET], lane[FIRST_PIECE], lane[LAST_PIECE] = part
    which, since, still = within(drive, part, t)
    lane[ORIGIN] = t if still else part.start
    for channel in range(4):
        coef = drive.coef[which, channel]
        for power in range(6):
            path[(COEF + channel * 6 + power) * k + j] = 0.0 if still else coef[power]
        if still and channel != TORQUE:
            path[(COEF + channel * 6) * k + j] = polynomial(coef, since)[0]


@inlined
def lane_polynomial(path, k, j, channel, t):  # type: ignore[no-untyped-def]
    """Value, first and second derivative at t of a channel of lane j, as ``drive.polynomial``."""
    return polynomial(read(path, k, (COEF + 6 * channel) * k + j, POWERS), t)


@non_allocating
def base_motion(path):  # type: ignore[no-untyped-def]
    """Torque on link 0 (EXTERNAL) and motion of the first joint (BASE) in every lane, at the time SINCE."""
    k = len(MEMBERS)
    for j in range(k):
        t = path[SINCE * k + j]
        arm, x, y = (
            lane_polynomial(path, k, j, ANGLE, t),
            lane_polynomial(path, k, j, X, t),
            lane_polynomial(path, k, j, Y, t),
        )
        torque, _, _ = lane_polynomial(path, k, j, TORQUE, t)
        limit = path[LIMIT * k + j]
        torque = limit if torque > limit else torque
        path[EXTERNAL * k + j] = -limit if torque < -limit else torque
        write_base(path[ARM * k + j], arm, x, y, path, BASE * k + j, k)
        path[BASE * k + j] -= path[GX * k + j]
        path[(BASE + 1) * k + j] -= path[GY * k + j]


@inlined
def chain_of(members, terms, m):  # type: ignore[no-untyped-def]
    """Chain of member m."""
    whole = members.whole[m]
    return chain_of_rows(members.links[m], whole[TIP_MASS], whole[GRAVITY_X], whole[GRAVITY_Y], terms.reaction)


@kernel
def observe_block(members, terms, low, high, t, y, kinetic, potential, joint):  # type: ignore[no-untyped-def]
    """Energies and first joints of members low..high - 1 at times t (T,) and states y (high - low, T, 2 n + 2).

    Outputs: kinetic, potential (high - low, T), J; joint (high - low, T, 2), position of the first joint, m.
    """
    n = members.links.shape[2]
    base, trig = np.empty(9), np.empty(2 * n)
    for m in range(low, high):
        chain, drive, row = chain_of(members, terms, m), drive_of(members, m), m - low
        for k in range(t.size):
            motion_at(drive, t[k], base)
            joint[row, k, 0], joint[row, k, 1] = base[7], base[8]
            q, w = y[row, k, :n], y[row, k, n : 2 * n]
            kinetic[row, k], potential[row, k] = energies(chain, q, w, base, trig)


class LaneStiction(NamedTuple):
    """What is kept for each of k lanes between the attempts of a step, and working arrays."""

    searches: Search  # as events.new_searches returns them
    slip: Array  # (k, n)
    start: Array  # (k, 2 n + 2) angles and rates at the beginning of the step, the last two not used
    out: Array  # (k, 2 n + 2) and at its end
    tools: StictionWorkspace


@kernel
def new_lane_stiction(n):  # type: ignore[no-untyped-def]
    """Arrays for chains of n links in all lanes."""
    k = len(MEMBERS)
    states = zeros((k, 2 * n + 2), (k, 2 * n + 2))
    return LaneStiction(new_searches(k, n + 1, n, BASE_SIZE), np.ones((k, n)), *states, new_stiction_workspace(n))  # type: ignore[call-arg]


@non_allocating
def read_start(lanes, j, out):  # type: ignore[no-untyped-def]
    """Copy angles and rates at the beginning of lane j's step to ``out`` (2 n + 2,)."""
    k, n = len(MEMBERS), (out.size - 2) // 2
    for i in range(n):
        out[i], out[n + i] = read(lanes, k, (i + 1) * ROW * k + j, (Q_START, W_START))


@non_allocating
def decide_lane_modes(members, terms, m, lanes, j, lane, friction):  # type: ignore[no-untyped-def]
    """Decide how the joints of member m in lane j slip or stick in its present state; False if they chatter."""
    k, n = len(MEMBERS), members.links.shape[2]
    start, slip, tools = friction.start[j], friction.slip[j], friction.tools
    base, before = friction.searches.before[j], friction.out[j, :n]
    read_start(lanes, j, start)
    torque = base_state(drive_of(members, m), part_of(lane), lane[T], base)
    chain, q, w = chain_of(members, terms, m), start[:n], start[n : 2 * n]
    good, lane[CHATTER] = decide_modes(chain, q, w, base, torque, lane[CHATTER], slip, before, tools)
    for i in range(n):
        write(lanes, k, (i + 1) * ROW * k + j, (SLIP, W_START), (slip[i], w[i]))
    lane[UNDECIDED] = 0.0
    return good


@non_allocating
def assess_lane(members, terms, m, lanes, j, lane, friction):  # type: ignore[no-untyped-def]
    """Assess the step of lane j as ``events.assess_attempt`` does; with AGAIN, NEXT_STEP is shorter."""
    k, n = len(MEMBERS), members.links.shape[2]
    chain, drive, part = chain_of(members, terms, m), drive_of(members, m), part_of(lane)
    start, out, slip, tools = friction.start[j], friction.out[j], friction.slip[j], friction.tools
    search, t, step = search_of(friction.searches, j), lane[T], lane[NEXT_STEP]
    widen = tolerance_factor(lane[CHATTER], n)
    if lane[RETRY] == 0.0:
        read_start(lanes, j, start)
        begin_search(chain, drive, part, t, terms.tol, step, start, slip, widen, False, search, tools)
    for i in range(n):
        q, w, dq, dw = read(lanes, k, (i + 1) * ROW * k + j, (Q_START, W_START, Q_SUM, W_SUM))
        out[i], out[n + i] = q + dq, w + dw
    call = chain, drive, part, NEVER, 0.0, t, step, start, slip, widen, search, tools, out
    verdict, lane[NEXT_STEP] = assess_attempt(*call)
    lane[RETRY] = 1.0 if verdict == AGAIN else 0.0
    return verdict


@non_allocating
def finish_lane(lanes, n, j, lane, energy, step, event, friction):  # type: ignore[no-untyped-def]
    """Make the end of lane j's step, of the length `step`, the start of its next one."""
    k, out, power = len(MEMBERS), friction.out[j], friction.searches.power[j]
    for i in range(n):
        write(lanes, k, (i + 1) * ROW * k + j, ln.START, (out[i], out[n + i], *sincos(out[i])))
    energy[j, 1] += stuck_loss(power, step, 1.0)
    power[:] = 0.0
    if event:
        restart(lane)
    count_chatter(lane, step, event)


@non_allocating
def begin_column(lanes, sums):  # type: ignore[no-untyped-def]
    """Set every lane back to the state at the start of its step; with `sums`, also clear the extrapolated sums."""
    k = len(MEMBERS)
    n = lanes.size // (ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[i * ROW * k : (i + 1) * ROW * k]
        for j in range(k):
            write(row, k, j, ln.STATE, read(row, k, j, ln.START))
        if sums:
            for j in range(k):
                write(row, k, j, ln.SUMS, (0.0, 0.0, 0.0, 0.0))


@non_allocating
def end_column(lanes, best, gap):  # type: ignore[no-untyped-def]
    """Add the increments of a finished column to the result and to the error estimate."""
    k = len(MEMBERS)
    n = lanes.size // (ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[i * ROW * k : (i + 1) * ROW * k]
        for j in range(k):
            (q, w, q_start, w_start), sums = read(row, k, j, (Q, W, Q_START, W_START)), read(row, k, j, ln.SUMS)
            dq, dw = q - q_start, w - w_start
            sums = sums[0] + best * dq, sums[1] + best * dw, sums[2] + gap * dq, sums[3] + gap * dw
            write(row, k, j, ln.SUMS, sums)


@non_allocating
def measure(lanes, tip):  # type: ignore[no-untyped-def]
    """Sine and cosine of the result, and the largest squared errors of any joint's position and velocity (in `tip`)."""
    k = len(MEMBERS)
    n = lanes.size // (ROW * k) - 2
    for j in range(k):
        write(tip, k, j, ln.ERRORS, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    for i in range(1, n + 1):
        row = lanes[i * ROW * k : (i + 1) * ROW * k]
        for j in range(k):
            q, dq, gap_q, gap_w, lever = read(row, k, j, (Q_START, Q_SUM, Q_GAP, W_GAP, ln.LEVER))
            sin, cos = sincos(q + dq)
            write(row, k, j, (SIN, COS), (sin, cos))
            x, y, vx, vy, worst, worst_v = read(tip, k, j, ln.ERRORS)
            x, y = x + cos * (lever * gap_q), y + sin * (lever * gap_q)
            vx, vy = vx + cos * (lever * gap_w), vy + sin * (lever * gap_w)
            position, velocity = x * x + y * y, vx * vx + vy * vy
            worst = position if position > worst else worst
            worst_v = velocity if velocity > worst_v else worst_v
            write(tip, k, j, ln.ERRORS, (x, y, vx, vy, worst, worst_v))


@non_allocating
def extrapolate_lanes(members, terms, lane, energy, lanes, tip, path):  # type: ignore[no-untyped-def]
    """One extrapolated step of length NEXT_STEP in every lane; the result is in the sums of `lanes` and `energy`."""
    k = len(MEMBERS)
    order = terms.best.size - 1
    base = path[BASE * k :].reshape(9, k)
    energy[:, 2:] = 0.0
    for col in range(1, order + 1):
        begin_column(lanes, col == 1)
        for j in range(k):
            tip[ln.STEP * k + j] = lane[j, NEXT_STEP] / col
            write(lanes, k, j, (WORK, LOST), (0.0, 0.0))
            path[SINCE * k + j] = lane[j, T] - lane[j, ORIGIN]
        for s in range(col):
            base_motion(path)
            for j in range(k):
                tip[ln.EXTERNAL * k + j] = path[EXTERNAL * k + j]
                path[SINCE * k + j] += tip[ln.STEP * k + j]
            if terms.stiction > 0.0:
                ln.regularize(MEMBERS, terms.stiction, lanes, base)
            if s < col - 1:
                ln.euler(MEMBERS, terms.reaction, ln.MORE, lanes, tip, base)
            else:
                ln.euler(MEMBERS, terms.reaction, ln.LAST, lanes, tip, base)
        end_column(lanes, terms.best[col], terms.gap[col])
        for j in range(k):
            energy[j, 2] += terms.best[col] * lanes[WORK * k + j]
            energy[j, 3] += terms.best[col] * lanes[LOST * k + j]
    measure(lanes, tip)


@non_allocating
def accept(lanes, n, j, energy):  # type: ignore[no-untyped-def]
    """Make the result of lane j's step the start of its next one."""
    k = len(MEMBERS)
    for i in range(1, n + 1):
        row = lanes[i * ROW * k : (i + 1) * ROW * k]
        q, w, dq, dw, sin, cos = read(row, k, j, (Q_START, W_START, Q_SUM, W_SUM, SIN, COS))
        write(row, k, j, ln.START, (q + dq, w + dw, sin, cos))
    energy[j, 0] += energy[j, 2]
    energy[j, 1] += energy[j, 3]


@non_allocating
def lane_error(terms, tip, j, step):  # type: ignore[no-untyped-def]
    """Error of lane j's step in units of what is allowed; 0 for a fixed step, inf where it is not finite."""
    k = len(MEMBERS)
    _, _, vx, vy, worst, worst_v = read(tip, k, j, ln.ERRORS)
    finite, worst = abs(vx) + abs(vy) < np.inf, max(worst, lasting(step) ** 2 * worst_v)
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
        t = lane[j, T]
        if t >= lane[j, END]:
            piece(members, member[j], t, path, j, lane[j])
            restart(lane[j])
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
        lane[T] = end if step >= end - lane[T] else lane[T] + step
        faint = sticks and is_rounding(size, terms.tol, step, terms.rounding)
        grown = STEP_SIZE.growth * step if faint else longer(step, size, lane[LAST], lane[SIZE], order)
        set_next_step(lane, step, size, grown, lane[STEP], np.inf, not faint)
        return status.OK
    if terms.fixed > 0.0:
        return status.NOT_FINITE
    lane[STEP] = shorter(step, size, order)
    return status.STEP_TOO_SMALL if lane[STEP] < SMALLEST_STEP else status.RUNNING


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
    dry = STICKING if terms.stiction == 0.0 and members.links[low:high, DRY].any() else SLIDING
    run_members(members, terms, dry, low, high, t_out, y_out, codes, reached, stop)


@kernel
def run_members(members, terms, dry, low, high, t_out, y_out, codes, reached, stop):  # type: ignore[no-untyped-def]
    """Do what :func:`run_block` does; `dry` is SLIDING or STICKING."""
    k = len(MEMBERS)
    n = members.links.shape[2]
    lanes, tip = ln.rows(MEMBERS, n)
    path = np.zeros(PATH * k)
    lane = np.zeros((k, CLOCK))
    energy = np.zeros((k, 4))  # work and dissipation at the start of the step, and their increments
    member = np.full(k, -1)
    index = np.zeros(k, dtype=np.int64)
    coming = low
    sticks = np.zeros(k, dtype=np.bool_)
    if len(dry) > 0:
        friction = new_lane_stiction(n)
    for i in range(1, n + 1):  # idle lanes are swept too: an inertia keeps their numbers finite
        lanes[(i * ROW + ln.INERTIA) * k : (i * ROW + ln.INERTIA + 1) * k] = 1.0
    while True:
        for j in range(k):
            if member[j] < 0 and coming < high:
                member[j], index[j] = coming, 0
                sticks[j] = len(dry) > 0 and can_stick(chain_of(members, terms, coming))
                enter(members, terms, coming, lanes, tip, path, j, lane[j], energy[j])
                coming += 1
        if prepare(members, terms, member, lane, index, path, t_out) == 0:
            return
        if stop[0] != 0:
            for j in range(k):
                if member[j] >= 0:
                    reached[member[j] - low] = lane[j, T]
            return
        if len(dry) > 0:
            for j in range(k):
                unsettled = sticks[j] and member[j] >= 0 and lane[j, UNDECIDED] == 1.0
                if unsettled and not decide_lane_modes(members, terms, member[j], lanes, j, lane[j], friction):
                    codes[member[j] - low], reached[member[j] - low], member[j] = status.FRICTION, lane[j, T], -1
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
            if len(dry) > 0 and sticks[j] and size <= 1.0:
                verdict = assess_lane(members, terms, member[j], lanes, j, lane[j], friction)
                if verdict == AGAIN:
                    continue
            code = control_step(terms, lane[j], end, size, sticks[j])
            if code == status.OK:
                accept(lanes, n, j, energy)
                if len(dry) > 0 and sticks[j]:
                    finish_lane(lanes, n, j, lane[j], energy, step, verdict == EVENT, friction)
                if t_out[index[j]] <= lane[j, T]:
                    out = y_out[m, index[j]]
                    read_start(lanes, j, out)
                    out[-2], out[-1] = energy[j, 0], energy[j, 1]
                    index[j] += 1
            if index[j] == t_out.size or code == status.STEP_TOO_SMALL or code == status.NOT_FINITE:
                clock = members.clock[member[j]]
                clock[0], clock[1], clock[2] = lane[j, STEP], lane[j, AFTER], lane[j, CHATTER]
                codes[m], reached[m], member[j] = code, lane[j, T], -1
