"""Run loop of a rollout: error control, restarts at switches, dense output."""

import math

import numpy as np

from hyperflex.core import status
from hyperflex.core.assign import assign
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import can_stick, sines, sticks_often
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.core.integrate.air import air_size
from hyperflex.core.integrate.dense_output import interpolate
from hyperflex.core.integrate.end_conditions import NOTHING
from hyperflex.core.integrate.event_location import find_event, update_modes
from hyperflex.core.integrate.progress import (
    AFTER,
    CHATTER,
    INDEX,
    JOINT,
    LAST,
    MODES,
    ORDER,
    REJECTED,
    RESTARTED,
    SIZE,
    STEP,
    TAKEN,
    UNDECIDED,
    T,
    advance,
    new_workspace,
    restart,
    save_mark,
)
from hyperflex.core.integrate.step_size import (
    LARGEST_STEP,
    MOST,
    SMALLEST_STEP,
    WATCHED,
    allowed,
    cheapest,
    fitted,
    is_rounding,
    lasting,
    longer,
    shorter,
    until_next_event,
)
from hyperflex.core.integrate.steps import COURSE, COURSE_ERRORS, rates
from hyperflex.core.integrate.substeps import MOST_SUBSTEPS, add_substeps, weigh_terms
from hyperflex.core.jit import inlined, kernel, non_allocating
from hyperflex.core.stiction.constraint_torques import QUICK, project_stuck, stuck_loss

ENERGY = 10.0  # see error_norms
SETTLED = 0.3  # part of the step behind a switch that its substeps do not tell well
TINY = 1e-300  # J, keeps a chain without weight and motion from dividing by zero


@inlined
def turned(vector, sin, cos, by):  # type: ignore[no-untyped-def]
    """Return a vector (x, y) plus `by` across a link."""
    return vector[0] + cos * by, vector[1] + sin * by


@inlined
def squared(vector):  # type: ignore[no-untyped-def]
    """Squared length of a vector (x, y)."""
    return vector[0] * vector[0] + vector[1] * vector[1]


@non_allocating
def error_norms(chain, limits, table, y, errors, step, work):  # type: ignore[no-untyped-def]
    """Sizes of two errors of a step, `errors` (2, 2 n + 2), in units of what is allowed; both inf if not finite.

    The greatest error of any joint's position, of its velocity and of energy. Work and dissipation may err by
    ENERGY tol / reach of the chain's energy. Without that bound sharp friction, which hardly moves a joint while it
    changes sign, would leave the energy balance unchecked. `work` is (6 n,) scratch.
    """
    n = chain.length.size
    sines(y[:n], work, 0)
    time = lasting(step)
    shift = drift = shift2 = drift2 = (0.0, 0.0)  # of the joint: error of its position, and what that of its rate makes
    velocity = (0.0, 0.0)  # of the joint, seen from the chain's first one
    worst = worst2 = total = kinetic = 0.0
    for i in range(n):
        sin, cos, lever, w = work[i], work[n + i], limits.lever[i], y[n + i]
        shift = turned(shift, sin, cos, lever * errors[0, i])
        drift = turned(drift, sin, cos, lever * errors[0, n + i] * time)
        shift2 = turned(shift2, sin, cos, lever * errors[1, i])
        drift2 = turned(drift2, sin, cos, lever * errors[1, n + i] * time)
        worst = max(worst, squared(shift), squared(drift))
        worst2 = max(worst2, squared(shift2), squared(drift2))
        total += squared(shift) + squared(drift) + squared(shift2) + squared(drift2)
        kinetic += chain.mass[i] * squared(turned(velocity, sin, cos, chain.com[i] * w)) + chain.inertia[i] * w * w
        velocity = turned(velocity, sin, cos, chain.length[i] * w)
    kinetic = 0.5 * (kinetic + chain.tip_mass * squared(velocity))
    known = ENERGY * (limits.fall + kinetic) + TINY
    energy = abs(errors[0, 2 * n] - errors[0, 2 * n + 1]) * limits.reach / known
    energy2 = abs(errors[1, 2 * n] - errors[1, 2 * n + 1]) * limits.reach / known
    if not (total + energy + energy2 < np.inf):  # also where one is not a number
        return np.inf, np.inf
    limit = allowed(limits.tol, step, table.rounding)
    return max(math.sqrt(worst), energy) / limit, max(math.sqrt(worst2), energy2) / limit


@kernel
def error_sizes(chain, limits, table, step, cut, workspace):  # type: ignore[no-untyped-def]
    """Error of the step to ``workspace.out`` in units of what is allowed, and what it would have been at an order less.

    `cut`: the step ends where it was told to. Fixed steps have no errors: 0.0, or inf where the state is not finite.
    """
    if limits.fixed > 0.0:
        return (0.0, 0.0) if np.abs(workspace.out).max() < np.inf else (np.inf, 0.0)
    work = workspace.stiction.work
    size, lower_size = error_norms(chain, limits, table, workspace.out, workspace.errors, step, work)
    if cut and step < SMALLEST_STEP and size < np.inf:
        size = 0.0  # an end a few rounding errors away: there is nothing to control
    return size, lower_size


@non_allocating
def choose_next_step(clock, tables, limits, sticks, step, size, lower_size, wanted, table, longest):  # type: ignore[no-untyped-def]
    """Choose order and length of the step after one of the length `step`, s, which was wanted to be `wanted` long.

    `size` is its error in units of what is allowed, `lower_size` that of an order less; `longest`, s, is for events.
    """
    order = table.order
    faint = sticks and is_rounding(size, limits.tol, step, table.rounding)
    grown = MOST * step if faint else longer(step, size, clock[LAST], clock[SIZE], order)
    if not faint:
        clock[ORDER], grown = cheapest(tables, limits.least, limits.most, order, step, lower_size, grown, longest)
    clock[STEP] = min(max(grown, clock[STEP]) if step < wanted else grown, longest)
    clock[LAST], clock[SIZE] = step if clock[ORDER] == order and not faint else 0.0, size
    if clock[RESTARTED] == 1.0:
        clock[AFTER] = clock[STEP]
        clock[RESTARTED] = 0.0


@non_allocating
def course_size(chain, limits, table, step, workspace):  # type: ignore[no-untyped-def]
    """Error of what the kept substeps say of the course of a step, in units of what the step may err.

    It is written over the errors of the step itself.
    """
    errors, weights = workspace.errors, COURSE_ERRORS[table.order]
    errors[:] = 0.0
    for look in range(2):  # of LOOKS
        add_substeps(weights[look, : table.column.size], workspace.kept, errors[look])
    return max(error_norms(chain, limits, table, workspace.out, errors, step, workspace.stiction.work))


@non_allocating
def log_step(progress, step, end, order, event, joint):  # type: ignore[no-untyped-def]
    """Keep a step that succeeded in the log, and count quick changes of the joints' modes."""
    clock = progress.clock
    succeeded = int(clock[TAKEN] - clock[REJECTED]) - 1
    if succeeded < progress.log.shape[0]:
        entry = progress.log[succeeded]
        entry[0], entry[1], entry[2] = step, end, order
        if entry.size > JOINT:
            entry[JOINT] = joint
            assign(entry[MODES:], progress.slip)
    if event == 1 and step < QUICK:
        clock[CHATTER] += 1.0
    elif step >= QUICK:
        clock[CHATTER] = 0.0


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
    """Write the outputs strictly within the step from where `progress` stands to ``workspace.out``.

    `kept` are its substeps, which tell its course where they are accurate enough; else it is interpolated through its
    middle. Where friction settles behind a switch, outputs are the ends of steps of their own.
    """
    y, slip, clock = progress.y, progress.slip, progress.clock
    fixed, none = limits.fixed, workspace.kept[:0]
    t = clock[T]
    end = t + step
    if not samples(clock, t_out, end):
        return
    ys, dys = workspace.ys, workspace.dys
    assign(ys[0], y)
    assign(ys[2], workspace.out)
    first = int(clock[INDEX])
    told = kept.shape[0] > 0 and course_size(chain, limits, table, step, workspace) <= 1.0
    settled = t + SETTLED * step if told else end
    while fixed == 0.0 and clock[RESTARTED] == 1.0 and samples(clock, t_out, settled):
        index = int(clock[INDEX])
        advance(chain, drive, part, table, fixed, t, t_out[index] - t, y, slip, y_out[index], none, workspace)
        clock[INDEX] += 1
    if told:
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
            base_state(drive, part, t_out[index], workspace.after)
            project_stuck(chain, slip, y, workspace.before, y_out[index], workspace.after)
            y_out[index, 2 * slip.size + 1] += stuck_loss(workspace.power, step, (t_out[index] - t) / step)


@non_allocating
def next_step(limits, part, clock):  # type: ignore[no-untyped-def]
    """Time at which the next step must end at the latest, s, the length that is wanted, and the length to take, s."""
    t = clock[T]
    end = min(part.end, limits.stop)
    if t < limits.until.after:
        end = min(end, limits.until.after)
    if limits.fixed > 0.0:
        return end, limits.fixed, min(limits.fixed, end - t)
    wanted = min(clock[STEP], WATCHED if limits.until.kind != NOTHING else LARGEST_STEP)
    return end, wanted, fitted(wanted, end - t)


@kernel
def run(chain, drive, tables, limits, progress, t_out, y_out):  # type: ignore[no-untyped-def]
    """Run until ``limits.stop`` or until the budget is spent; O(n) a step.

    Parameters
    ----------
    chain, drive, limits, progress : Chain, Drive, Limits, Progress
    tables : tuple of Scheme, of successive orders
    t_out : (m,) increasing times, s, at which to write the state
    y_out : (m, 2 n + 2) out; row k is written once the run has passed t_out[k]

    Returns
    -------
    int : OK, RUNNING (call again), REACHED (what ends the run), LIMIT (a joint is at its limit), or why it failed;
        `progress` tells how far it came.
    """
    y, slip, clock = progress.y, progress.slip, progress.clock
    workspace = new_workspace(chain)
    fixed = limits.fixed
    sticks, often = can_stick(chain), sticks_often(chain)
    airy = fixed == 0.0 and chain.drag.any()
    watching = sticks or limits.until.kind != NOTHING or chain.max_bend.min() < np.inf
    looked_at = fixed == 0.0 and not watching
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
        if decided and not update_modes(chain, drive, part, progress, workspace):
            return status.FRICTION
        clock[UNDECIDED] = 0.0
        end, wanted, step = next_step(limits, part, clock)
        cut = step >= end - t
        if step < wanted and limits.stop < part.end:
            save_mark(progress)
        order = min(max(int(clock[ORDER]), limits.least), limits.most)
        table = tables[order - tables[0].order]
        kept = workspace.kept[: MOST_SUBSTEPS if looked_at and samples(clock, t_out, t + step) else 0]
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
        if watching:
            taken, event, joint = find_event(chain, drive, part, table, limits, progress, step, workspace, decided)
            if taken == 0.0:
                return status.REACHED
        t_new = end if cut and taken == step else t + taken
        log_step(progress, taken, t_new, order, event, joint)
        write_between(chain, drive, part, table, limits, progress, t_new - t, kept, workspace, t_out, y_out)
        assign(y, workspace.out)
        y[y.size - 1] += stuck_loss(workspace.power, t_new - t, 1.0)
        clock[T] = t_new
        write_until(clock, t_out, t_new, y, y_out)
        if fixed == 0.0:
            longest = until_next_event(step, taken) if often and event == 1 and joint >= 0 else np.inf
            choose_next_step(clock, tables, limits, sticks, step, size, lower_size, wanted, table, longest)
        if event >= 2:
            return status.REACHED if event == 2 else status.LIMIT
        if event == 1 or t_new >= part.end:
            restart(clock)
    return status.RUNNING if clock[T] < limits.stop else status.OK
