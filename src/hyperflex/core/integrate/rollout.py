"""A rollout in free flight: its state, the steps that end at events, error control, restarts at switches, outputs."""

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core import status
from hyperflex.core.assign import assign
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array, can_stick, energies, has_limits, sticks_often
from hyperflex.core.chain.drive import base_size, base_state, segment
from hyperflex.core.integrate.events import (
    AGAIN,
    EVENT,
    NOTHING,
    PEAK,
    UNWATCHED,
    WATCHED,
    Search,
    Until,
    assess_attempt,
    begin_search,
    end_margins,
    event_value,
    first_past,
    is_past,
    new_searches,
    on_right_side,
    search_of,
    watched_sense,
)
from hyperflex.core.integrate.step_size import (
    LARGEST_STEP,
    LONGEST_WATCHED,
    SMALLEST_STEP,
    STEP_SIZE,
    air_size,
    allowed,
    by_trend,
    cheapest,
    fitted,
    is_rounding,
    lasting,
    longer,
    shorter,
)
from hyperflex.core.integrate.steps import (
    COURSE,
    COURSE_ERRORS,
    ERRORS,
    MOST_SUBSTEPS,
    add_substeps,
    extrapolate,
    interpolate,
    new_substeps,
    rates,
    runge_kutta,
    weigh_terms,
)
from hyperflex.core.jit import kernel, non_allocating, zeros
from hyperflex.core.stiction import (
    STICTION,
    StictionWorkspace,
    decide_modes,
    new_stiction_workspace,
    project_stuck,
    stuck_loss,
    tolerance_factor,
)


class Limits(NamedTuple):
    """Bounds of a rollout."""

    stop: float  # s, run until here
    tol: float  # m, error allowed in the position of any joint, of a step and of SHARE seconds
    lever: Array  # (n,) m, lever of a link's angle: the larger of its length and its radius of gyration
    reach: float  # m, length of the chain
    fall: float  # J, weight times length, plus dry friction: the scale of the chain's energy at rest
    fixed: float  # s, fixed Runge-Kutta step; 0.0: extrapolation with error control
    least: int  # order of the extrapolation, also the first
    most: int
    budget: int  # steps of one call, so that callers can show progress and be interrupted
    until: Until  # event that ends the run earlier


class Progress(NamedTuple):
    """State of a rollout; all arrays are changed in place."""

    y: Array  # (2 n + 2,) angles, rates, work put in, energy dissipated
    mark: Array  # (2 n + 2,) the state before the first step that was cut short to end at `stop`
    slip: Array  # (n,) modes of the joints, as in ``articulated_body.accelerations``
    mark_slip: Array
    clock: Array  # (CLOCK,) see the names below; the mark's time is -inf until a step is shortened
    log: Array  # (m, 3) or (m, 4 + n) with stiction: of the first m steps that succeed, see below


# A row of the log: length of the step, s, its end, s, and order; with stiction also the joint whose change of mode
# ended it, else -1, and the joints' modes in the step
LENGTH, END, DEGREE, JOINT, MODES = range(5)
# AFTER: first step that succeeded after the last switch, where the motion is least smooth; tried first at the next one
# RESTARTED: 1.0 from a switch (or an event) until a step has succeeded behind it
# LAST, SIZE: length and error of the last step that succeeded since the last switch; LAST is 0.0 where there is none
# UNDECIDED: 1.0 where the modes of the joints are to be decided anew
# CHATTER: events in a row that ended very short steps
# ORDER: of the extrapolation, for the next step; taken into the limits
# MARK: from here on, copies of these nine at the mark
# PENDING: margin of what is to end the run at the end of the last step, 0.0 where it is not watched
T, STEP, AFTER, RESTARTED, LAST, SIZE, UNDECIDED, CHATTER, ORDER, MARK = range(10)
INDEX, TAKEN, REJECTED, PENDING, CLOCK = range(2 * MARK, 2 * MARK + 5)


@non_allocating
def restart(clock):  # type: ignore[no-untyped-def]
    """Record a switch of the motion: the next step is at most as long as the successful one after the last switch."""
    clock[STEP] = min(clock[STEP], clock[AFTER])
    clock[RESTARTED] = 1.0
    clock[LAST] = 0.0
    clock[UNDECIDED] = 1.0


@non_allocating
def count_chatter(clock, step, event):  # type: ignore[no-untyped-def]
    """Count quick changes of the joints' modes; `event`: one ended the step of the length `step`, s."""
    if event and step < STICTION.quick:
        clock[CHATTER] += 1.0
    elif step >= STICTION.quick:
        clock[CHATTER] = 0.0


@non_allocating
def set_next_step(clock, step, size, grown, wanted, longest, alike):  # type: ignore[no-untyped-def]
    """Set the length of the step after one of length `step`, s, whose desired length was `wanted`.

    `size` is its error, `grown` the length that it suggests, at most `longest`, s. `alike`: the next step has the same
    order, and the error is not rounding.
    """
    clock[STEP] = min(max(grown, clock[STEP]) if step < wanted else grown, longest)
    clock[LAST], clock[SIZE] = step if alike else 0.0, size
    if clock[RESTARTED] == 1.0:
        clock[AFTER] = clock[STEP]
        clock[RESTARTED] = 0.0


class Workspace(NamedTuple):
    """Working arrays of a run."""

    out: Array  # (2 n + 2,) state after the step
    errors: Array  # (ERRORS, 2 n + 2), as in steps.extrapolate
    still: Array  # (9 or more,) a first joint at rest
    ys: Array  # (3, 2 n + 2) states at the beginning, middle and end of a step, and their derivatives
    dys: Array
    stage: Array  # (3, 2 n + 2)
    base: Array  # (9 or more, lanes)
    lanes: Array  # ((n + 2) ROW lanes,)
    tip: Array  # (ROW lanes,)
    stiction: StictionWorkspace
    search: Search  # over n + 1 margins, or 2 n + 1 if a joint has limits
    kept: Array  # (MOST_SUBSTEPS, 2 n + 2) substeps of a step that contains outputs, and their weights
    weight: Array


@kernel
def new_workspace(chain, base):  # type: ignore[no-untyped-def]
    """Working arrays for a chain, its parameters loaded into the lanes; `base` is of ``drive.base_size``."""
    n = chain.length.size
    m = 2 * n + 1 if has_limits(chain) else n + 1
    lanes, tip = ln.rows(ln.COLUMNS, n)
    ln.load(ln.COLUMNS, chain, lanes, tip)
    width, stiction, search = 2 * n + 2, new_stiction_workspace(n), search_of(new_searches(1, m, n, base), 0)
    states = zeros(width, (ERRORS, width), base, (3, width), (3, width), (3, width), (base, len(ln.COLUMNS)))
    return Workspace(*states, lanes, tip, stiction, search, *new_substeps(n))  # type: ignore[call-arg]


@non_allocating
def advance(chain, drive, part, table, fixed, t, step, y, slip, out, kept, workspace):  # type: ignore[no-untyped-def]
    """Take one step of the chosen integrator from y at t to `out`; the lanes of `workspace` know `slip`.

    `kept` is as in ``steps.extrapolate``.
    """
    work, lanes, tip = workspace.stiction.work, workspace.lanes, workspace.tip
    if fixed > 0.0:
        runge_kutta(chain, drive, part, t, step, y, slip, out, workspace.stage, work)
    else:
        base = workspace.base
        extrapolate(chain, drive, part, table, t, step, y, out, workspace.errors, kept, lanes, tip, base, work)


@non_allocating
def update_modes(chain, drive, part, progress, workspace):  # type: ignore[no-untyped-def]
    """Determine the present modes of the joints; False if no modes obey the law, or joints chatter."""
    y, slip, clock = progress.y, progress.slip, progress.clock
    n = slip.size
    now, before = workspace.search.before, workspace.out[:n]
    torque = base_state(drive, part, clock[T], now)
    tools = workspace.stiction
    good, chatter = decide_modes(chain, y[:n], y[n : 2 * n], now, torque, clock[CHATTER], slip, before, tools)
    clock[CHATTER] = chatter
    ln.set_slip(ln.COLUMNS, workspace.lanes, slip)
    return good


@non_allocating
def find_event(chain, drive, part, table, terms, progress, step, kept, workspace, decided):  # type: ignore[no-untyped-def]
    """Shorten the step to ``workspace.out`` until it holds no event, or ends at its first one; `terms` are the Limits.

    `kept` as in ``steps.extrapolate``. `decided`: modes were determined at its beginning, and the constraint torques
    there are known.

    Returns
    -------
    step : float, s
    event : int, 0: none; 1: a joint changes its mode; 2: the event that ends the run; 3: a joint is at its limit
    joint : int, the one that changes its mode, else -1
    """
    y, slip, clock, until = progress.y, progress.slip, progress.clock, terms.until
    search, tools, out = workspace.search, workspace.stiction, workspace.out
    n, last, t, widen = slip.size, search.late.size - 1, clock[T], tolerance_factor(clock[CHATTER], slip.size)
    tol = 0.0 if terms.fixed > 0.0 or progress.log.shape[0] > 0 else terms.tol  # derivatives need the exact event
    begin_search(chain, drive, part, t, tol, step, y, slip, widen, decided, search, tools)
    sense = 0.0
    search.locked[last] = 1.0 if until.kind == PEAK else 0.0
    if until.kind != NOTHING:
        value, slope = event_value(until, chain, y[:n], y[n : 2 * n], search.alpha, search.before)
        sense = watched_sense(until, value, slope, t)
        if until.kind == PEAK and sense == 0.0 and clock[PENDING] > 0.0:
            return 0.0, 2, -1  # the speed has its peak here
        search.low[:, last] = np.inf
        search.here[:, last] = np.inf
    end_margins(chain, until, sense, y[:n], y[n : 2 * n], search.alpha, search.before, search.low)
    verdict = AGAIN
    while verdict == AGAIN:
        call = chain, drive, part, until, sense, t, step, y, slip, widen, search, tools, out
        verdict, step = assess_attempt(*call)
        if verdict == AGAIN:
            clock[TAKEN] += 1
            clock[REJECTED] += 1
            advance(chain, drive, part, table, terms.fixed, t, step, y, slip, out, kept, workspace)
    clock[PENDING] = search.here[0, last] if sense != 0.0 else 0.0
    if verdict != EVENT:
        return step, 0, -1
    joint = first_past(search, search.here)
    if n <= joint < last:
        return step, 3, joint
    if is_past(search, search.here, last):
        clock[PENDING] = 0.0
        good = on_right_side(until, chain, out[:n], out[n : 2 * n], search.after)
        return step, 2 if good else 1, joint
    return step, 1, joint


ENERGY = 10.0  # see error_norm
SETTLED = 0.3  # first fraction of the step after a switch, in which the dense output of its substeps is inaccurate
TINY = 1e-300  # J, avoids a division by zero for a chain without weight and motion


@non_allocating
def error_norm(limits, trig, errors, step, energy, limit):  # type: ignore[no-untyped-def]
    """Size of the `errors` (2 n + 2,) of a step in units of the allowed error, `limit`; inf if not finite.

    The largest of the errors of the joints' positions, their velocities and the energy. Errors of work and dissipation
    are limited to ENERGY tol / reach of the chain's `energy`, J. Without this limit the energy balance would be
    unchecked for sharp friction, which barely moves a joint while it changes its sign.
    """
    n = limits.lever.size
    time = lasting(step)
    x = y = vx = vy = worst = total = 0.0  # of the joint: error of its position, and the effect of its velocity error
    for i in range(n):
        shift, drift = limits.lever[i] * errors[i], limits.lever[i] * errors[n + i] * time
        x, vx = x + trig[n + i] * shift, vx + trig[n + i] * drift
        y, vy = y + trig[i] * shift, vy + trig[i] * drift
        worst = max(worst, x * x + y * y, vx * vx + vy * vy)
        total += x * x + y * y + (vx * vx + vy * vy)
    off = abs(errors[2 * n] - errors[2 * n + 1]) * limits.reach / (ENERGY * energy + TINY)
    if not (total + off < np.inf):  # also if one is not a number
        return np.inf
    return max(math.sqrt(worst), off) / limit


@non_allocating
def error_norms(chain, limits, table, step, workspace):  # type: ignore[no-untyped-def]
    """Sizes of the rows of ``workspace.errors`` (3), see :func:`error_norm`; all inf if one is not finite."""
    n, out, trig = chain.length.size, workspace.out, workspace.stiction.work
    kinetic, _ = energies(chain, out[:n], out[n : 2 * n], workspace.still, trig)
    energy, limit = limits.fall + kinetic, allowed(limits.tol, step, table.rounding)
    size = error_norm(limits, trig, workspace.errors[0], step, energy, limit)
    lower_size = error_norm(limits, trig, workspace.errors[1], step, energy, limit)
    lowest_size = error_norm(limits, trig, workspace.errors[2], step, energy, limit)
    return (size, lower_size, lowest_size) if size + lower_size + lowest_size < np.inf else (np.inf, np.inf, np.inf)


@kernel
def error_sizes(chain, limits, table, step, cut, workspace):  # type: ignore[no-untyped-def]
    """Error of the step to ``workspace.out`` in units of the allowed error, and the error at one order less.

    `cut`: the step ends at a prescribed time. Fixed steps have no error estimate: 0.0, or inf if the state is not
    finite.
    """
    if limits.fixed > 0.0:
        for x in workspace.out:
            if not abs(x) < np.inf:
                return np.inf, 0.0
        return 0.0, 0.0
    size, lower_size, lowest_size = error_norms(chain, limits, table, step, workspace)
    size = max(size, by_trend(lower_size, lowest_size))
    if cut and step < SMALLEST_STEP and size < np.inf:
        size = 0.0  # the end is a few rounding errors away: no error control
    return size, lower_size


@non_allocating
def choose_next_step(clock, tables, limits, sticks, step, size, lower_size, wanted, table, longest):  # type: ignore[no-untyped-def]
    """Choose order and length of the step after one of length `step`, s, whose desired length was `wanted`.

    `size` is its error in units of the allowed error, `lower_size` that of one order less; `longest`, s, is for events.
    """
    order = table.order
    faint = sticks and is_rounding(size, limits.tol, step, table.rounding)
    grown = STEP_SIZE.growth * step if faint else longer(step, size, clock[LAST], clock[SIZE], order)
    if not faint:
        clock[ORDER], grown = cheapest(tables, limits.least, limits.most, order, step, lower_size, grown, longest)
    set_next_step(clock, step, size, grown, wanted, longest, clock[ORDER] == order and not faint)


@non_allocating
def course_size(chain, limits, table, step, workspace):  # type: ignore[no-untyped-def]
    """Error of the dense output from the kept substeps, in units of the error allowed for the step.

    It overwrites the errors of the step itself.
    """
    errors, weights = workspace.errors, COURSE_ERRORS[table.order]
    errors[:] = 0.0
    for look in range(2):  # of LOOKS
        add_substeps(weights[look, : table.column.size], workspace.kept, errors[look])
    return max(error_norms(chain, limits, table, step, workspace))


@non_allocating
def log_step(progress, step, end, order, event, joint):  # type: ignore[no-untyped-def]
    """Record a successful step in the log, and count quick changes of the joints' modes."""
    clock = progress.clock
    succeeded = int(clock[TAKEN] - clock[REJECTED]) - 1
    if succeeded < progress.log.shape[0]:
        entry = progress.log[succeeded]
        entry[0], entry[1], entry[2] = step, end, order
        if entry.size > JOINT:
            entry[JOINT] = joint
            assign(entry[MODES:], progress.slip)
    count_chatter(clock, step, event == 1)


@non_allocating
def samples(clock, t_out, end):  # type: ignore[no-untyped-def]
    """Whether an output before the time `end`, s, is not written yet."""
    return clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] < end


@non_allocating
def write_until(clock, t_out, t, y, y_out):  # type: ignore[no-untyped-def]
    """Write state y to every output up to time t that is not written yet."""
    while clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] <= t:
        assign(y_out[int(clock[INDEX])], y)
        clock[INDEX] += 1


@non_allocating
def write_course(table, progress, step, workspace, t_out, y_out):  # type: ignore[no-untyped-def]
    """Write the outputs strictly within a step from its kept substeps."""
    y, clock, weight = progress.y, progress.clock, workspace.weight[: table.column.size]
    course = COURSE[table.order, : table.order]
    while samples(clock, t_out, clock[T] + step):
        index = int(clock[INDEX])
        weigh_terms(course, (t_out[index] - clock[T]) / step, weight)
        assign(y_out[index], y)
        add_substeps(weight, workspace.kept, y_out[index])
        clock[INDEX] += 1


@non_allocating
def write_between(chain, drive, part, table, limits, progress, step, kept, workspace, t_out, y_out):  # type: ignore[no-untyped-def]
    """Write the outputs strictly within the step from the state in `progress` to ``workspace.out``.

    `kept` are its substeps, which give the outputs if they are accurate enough; else the step is interpolated through
    its middle. While friction settles after a switch, outputs are the ends of separate steps.
    """
    y, slip, clock, search = progress.y, progress.slip, progress.clock, workspace.search
    t, first, fixed, none = clock[T], int(clock[INDEX]), limits.fixed, workspace.kept[:0]
    end, ys, dys = t + step, workspace.ys, workspace.dys
    if not samples(clock, t_out, end):
        return
    assign(ys[0], y)
    assign(ys[2], workspace.out)
    dense = kept.shape[0] > 0 and course_size(chain, limits, table, step, workspace) <= 1.0
    settled = t + SETTLED * step if dense else end
    while fixed == 0.0 and clock[RESTARTED] == 1.0 and samples(clock, t_out, settled):
        index = int(clock[INDEX])
        advance(chain, drive, part, table, fixed, t, t_out[index] - t, y, slip, y_out[index], none, workspace)
        clock[INDEX] += 1
    if dense:
        write_course(table, progress, step, workspace, t_out, y_out)
    if samples(clock, t_out, end):
        advance(chain, drive, part, table, fixed, t, 0.5 * step, y, slip, ys[1], none, workspace)
        for k in range(3):
            rates(chain, drive, part, t + 0.5 * k * step, ys[k], slip, dys[k], workspace.stiction.work)
    while samples(clock, t_out, end):
        index = int(clock[INDEX])
        interpolate(2.0 * (t_out[index] - t) / step - 1.0, step, ys, dys, y_out[index])
        clock[INDEX] += 1
    if not slip.all():
        for index in range(first, int(clock[INDEX])):
            base_state(drive, part, t_out[index], search.after)
            project_stuck(chain, slip, y, search.before, y_out[index], search.after)
            y_out[index, 2 * slip.size + 1] += stuck_loss(search.power, step, (t_out[index] - t) / step)


@non_allocating
def next_step(limits, part, clock):  # type: ignore[no-untyped-def]
    """Latest end of the next step, s, its desired length and its length, s."""
    t = clock[T]
    end = min(part.end, limits.stop)
    if t < limits.until.after:
        end = min(end, limits.until.after)
    if limits.fixed > 0.0:
        return end, limits.fixed, min(limits.fixed, end - t)
    wanted = min(clock[STEP], LONGEST_WATCHED if limits.until.kind != NOTHING else LARGEST_STEP)
    return end, wanted, fitted(wanted, end - t)


def watched(chain, until):  # type: ignore[no-untyped-def]
    """Return WATCHED if joints may stick or reach their limits, or if `until` may end the run; else UNWATCHED."""
    watches = can_stick(chain) or until.kind != NOTHING or has_limits(chain)
    return WATCHED if watches else UNWATCHED


@kernel
def run(chain, drive, tables, limits, events, progress, t_out, y_out):  # type: ignore[no-untyped-def]
    """Run until ``limits.stop`` or until the budget is spent; O(n) per step.

    Parameters
    ----------
    chain, drive, limits, progress : Chain, Drive, Limits, Progress
    tables : tuple of Scheme, of successive orders
    events : tuple, UNWATCHED or WATCHED as :func:`watched` returns it
    t_out : (m,) increasing times, s, at which to write the state
    y_out : (m, 2 n + 2) out; row k is written once the run has passed t_out[k]

    Returns
    -------
    int : OK, RUNNING (call again), REACHED (the event that ends the run), LIMIT (a joint is at its limit), or the
    failure; `progress` has the last state.
    """
    y, slip, clock = progress.y, progress.slip, progress.clock
    workspace = new_workspace(chain, base_size(drive))
    fixed = limits.fixed
    sticks, often = can_stick(chain), sticks_often(chain)
    airy = fixed == 0.0 and chain.drag.any()
    ln.set_slip(ln.COLUMNS, workspace.lanes, slip)
    write_until(clock, t_out, clock[T], y, y_out)
    part = segment(drive, clock[T])
    for _ in range(limits.budget):
        t = clock[T]
        if t >= limits.stop:
            break
        if t >= part.end:
            part = segment(drive, t)
        decided = sticks and clock[UNDECIDED] == 1.0
        if len(events) > 0 and decided and not update_modes(chain, drive, part, progress, workspace):
            return status.FRICTION
        clock[UNDECIDED] = 0.0
        end, wanted, step = next_step(limits, part, clock)
        cut = step >= end - t
        if step < wanted and limits.stop < part.end and clock[MARK] == -np.inf:
            assign(progress.mark, y)
            assign(progress.mark_slip, slip)
            assign(clock[MARK : 2 * MARK], clock[:MARK])
        order = min(max(int(clock[ORDER]), limits.least), limits.most)
        table = tables[order - tables[0].order]
        kept = workspace.kept[: MOST_SUBSTEPS if fixed == 0.0 and samples(clock, t_out, t + step) else 0]
        advance(chain, drive, part, table, fixed, t, step, y, slip, workspace.out, kept, workspace)
        clock[TAKEN] += 1
        size, lower_size = error_sizes(chain, limits, table, step, cut, workspace)
        if airy and size <= 1.0:
            size = max(size, air_size(chain, drive, part, limits, table, t, step, y, workspace))
        if not (size <= 1.0):
            clock[REJECTED] += 1
            clock[STEP] = shorter(step, size, table.order)
            if fixed > 0.0:
                return status.NOT_FINITE
            if clock[STEP] < SMALLEST_STEP:
                return status.STEP_TOO_SMALL
            continue
        taken, event, joint = step, 0, -1
        if len(events) > 0:
            taken, event, joint = find_event(
                chain, drive, part, table, limits, progress, step, kept, workspace, decided
            )
            if taken == 0.0:
                return status.REACHED
        t_new = end if cut and taken == step else t + taken
        log_step(progress, taken, t_new, order, event, joint)
        write_between(chain, drive, part, table, limits, progress, t_new - t, kept, workspace, t_out, y_out)
        assign(y, workspace.out)
        y[y.size - 1] += stuck_loss(workspace.search.power, t_new - t, 1.0)
        clock[T] = t_new
        write_until(clock, t_out, t_new, y, y_out)
        if fixed == 0.0:
            longest = np.inf
            if often and event == 1 and joint >= 0:
                longest = step * max(0.5, math.sqrt(STEP_SIZE.often * taken / step))
            choose_next_step(clock, tables, limits, sticks, step, size, lower_size, wanted, table, longest)
        if event >= 2:
            return status.REACHED if event == 2 else status.LIMIT
        if event == 1 or t_new >= part.end:
            restart(clock)
    return status.RUNNING if clock[T] < limits.stop else status.OK
