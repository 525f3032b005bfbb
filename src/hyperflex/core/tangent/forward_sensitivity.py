"""Forward sensitivity of a recorded run, for any number of directions, with the tangents of outputs and events.

The steps stay as they were, so the result is the derivative of the numbers that the run returned: each step keeps its
length, except a step that ends at a switch, at an event or at an output whose time depends on a direction.

A stuck joint keeps its angle in every direction. A step that ends at an event is as long as the event's margin takes to
fall to zero (``integrate.events``), so its length has a derivative: minus that of the margin over the margin's slope.
The slope is the derivative along one more direction, in which nothing changes but the step's length.
"""

from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array, sines
from hyperflex.core.chain.drive import base_state, segment
from hyperflex.core.integrate.interpolation import basis
from hyperflex.core.integrate.observation import enter_state
from hyperflex.core.integrate.rollout import DEGREE, END, JOINT, LENGTH, MODES
from hyperflex.core.integrate.steps import rates
from hyperflex.core.jit import inlined, kernel, non_allocating, zeros
from hyperflex.core.stiction import (
    STICTION,
    StictionWorkspace,
    at_rest,
    constraint_torques,
    margins,
    new_stiction_workspace,
    project_stuck,
    stop_joints,
    stops,
)
from hyperflex.core.tangent import step as tg
from hyperflex.core.tangent.extrapolation import (
    ALPHA,
    CELL,
    CHANGES,
    PARTS,
    RATE,
    TURN,
    Directions,
    TangentWorkspace,
    base_change,
    begin_pairs,
    end_shift,
    enter,
    new_tangent_workspace,
    set_ends,
    set_start,
    step_pair,
    tangent_step,
)
from hyperflex.core.tangent.step import K


@kernel
def acceleration_derivatives(chain, drive, part, t, step, directions, workspace):  # type: ignore[no-untyped-def]
    """Accelerations at beginning, middle and end of a step, and their derivatives, from ``ys`` and ``nodes``."""
    n = chain.length.size
    lanes, ys, dys = workspace.lanes, workspace.ys, workspace.dys
    workspace.anew[:] = 1.0
    motion = np.empty(9)
    for j in range(K):
        node = min(j, 2)
        workspace.into[j] = 0.5 * node
        workspace.when[j] = t + 0.5 * node * step
        torque = base_state(drive, part, workspace.when[j], motion)
        q, w = ys[node, :n], ys[node, n : 2 * n]
        sines(q, workspace.work, 0)
        enter_state(j, chain, q, w, workspace.work, motion, torque, lanes, workspace.tip, workspace.base)
    tg.save_trig(lanes)
    ln.euler(ln.COLUMNS, chain.reaction, ln.MORE, lanes, workspace.tip, workspace.base)
    begin_pairs(chain.reaction, lanes, workspace.air, workspace.base)
    for j in range(3):
        for i in range(n):
            dys[j, i] = ys[j, n + i]
            dys[j, n + i] = lanes[((i + 1) * ln.ROW + ln.ALPHA) * K + j]
    workspace.stretch[:] = 0.0
    for b in range(directions.parameters.size):
        for i in range(n):
            cell = workspace.store[b, i * PARTS * CELL : (i * PARTS + 1) * CELL]
            for x in range(CELL):
                lane, d, rate = min(x % K, 2), (x // K) % 2, x // (2 * K)
                cell[x] = workspace.nodes[lane, rate * n + i, 2 * b + d]
        enter(lanes, workspace.store[b], workspace.anew, True)
        set_ends(drive, part, directions, b, workspace)
        still = workspace.stretch[2 * b : 2 * b + 2]
        step_pair(chain.reaction, lanes, workspace.air, directions.links[b], still)
        for i in range(n):
            for d in range(2):
                for j in range(3):
                    workspace.bends[j, i, 2 * b + d] = lanes[((i + 1) * ln.ROW + tg.ALPHA + d) * K + j]


@kernel
def tangent_dense_output(t, step, t_out, workspace, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Angles and rates (m, 2 n + 2) and derivatives (m, 2 n, p) at times t_out (m,) in a step from t, from the nodes.

    Angles follow the polynomial of degree 8 through angles, rates and accelerations; rates are its derivative. Not for
    the step behind a switch, where friction settles (docs/models.md).
    """
    n, p, ys, dys = workspace.bends.shape[1], workspace.bends.shape[2], workspace.ys, workspace.dys
    half = 0.5 * step
    weights = np.empty((t_out.size, 3, 9))
    longer, moving = np.empty(p), np.empty((t_out.size, p))
    for x in range(p):
        longer[x] = 0.5 * workspace.change[x]
    for m in range(t_out.size):
        theta = (t_out[m] - t) / half - 1.0
        for order in range(3):
            basis(order, theta, weights[m, order])
        for x in range(p):
            moving[m, x] = -(workspace.shift[x] + (theta + 1.0) * longer[x]) / half
    late = moving.any() or longer.any()
    for i in range(n):  # all times of a link together: its nodes stay in the cache
        for m in range(t_out.size):
            weight, dq, dw = weights[m], dy_out[m, i], dy_out[m, n + i]
            y_out[m, i] = weighed(weight[0], half, i, ys, dys)
            y_out[m, n + i] = weighed(weight[1], half, i, ys, dys) / half
            combine(weight, half, i, workspace.nodes, workspace.bends, dq, dw)
            if late:
                add_time_shift(weight, half, i, ys, dys, moving[m], longer, dq, dw)


@inlined
def weighed(weight, half, i, ys, dys):  # type: ignore[no-untyped-def]
    """Sum of link i's angle, rate and acceleration at the nodes, in units of half the step; `weight` is (9,)."""
    n, total = (ys.shape[1] - 2) // 2, 0.0
    for k in range(3):
        total += weight[k] * ys[k, i] + half * (weight[3 + k] * ys[k, n + i] + half * weight[6 + k] * dys[k, n + i])
    return total


@non_allocating
def combine(weight, half, i, nodes, bends, dq, dw):  # type: ignore[no-untyped-def]
    """Derivatives (p,) of link i's angle and rate from those at the nodes; `weight` is (3, 9)."""
    n = bends.shape[1]
    dq[:] = 0.0
    dw[:] = 0.0
    for k in range(3):
        a, b, c = weight[0, k], weight[0, 3 + k] * half, weight[0, 6 + k] * half * half
        e, f, g = weight[1, k] / half, weight[1, 3 + k], weight[1, 6 + k] * half
        q, w, bend = nodes[k, i], nodes[k, n + i], bends[k, i]
        for x in range(dq.size):
            dq[x] += a * q[x] + b * w[x] + c * bend[x]
            dw[x] += e * q[x] + f * w[x] + g * bend[x]


@non_allocating
def add_time_shift(weight, half, i, ys, dys, moving, longer, dq, dw):  # type: ignore[no-untyped-def]
    """Add what follows from the change of an output's place in its step, `moving` (p,), and of half the step (p,)."""
    n = (ys.shape[1] - 2) // 2
    speed, bend = weighed(weight[1], half, i, ys, dys), weighed(weight[2], half, i, ys, dys)
    grown = grown_w = 0.0
    for k in range(3):
        w, a = ys[k, n + i], dys[k, n + i]
        grown += weight[0, 3 + k] * w + 2.0 * half * weight[0, 6 + k] * a
        grown_w += weight[1, 3 + k] * w + 2.0 * half * weight[1, 6 + k] * a
    grown_w -= speed / half
    for x in range(dq.size):
        dq[x] += speed * moving[x] + grown * longer[x]
        dw[x] += (bend * moving[x] + grown_w * longer[x]) / half


@kernel
def write_within_step(chain, drive, part, table, t, step, y, t_out, directions, workspace, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Write states and derivatives at times t_out (m,) within a step, whose ends are in the nodes in `workspace`."""
    workspace.change[:] *= 0.5
    tangent_step(
        chain, drive, part, table, t, 0.5 * step, y, workspace.ys[1], directions, workspace.nodes[1], workspace
    )
    workspace.change[:] *= 2.0
    acceleration_derivatives(chain, drive, part, t, step, directions, workspace)
    tangent_dense_output(t, step, t_out, workspace, y_out, dy_out)


class EventWorkspace(NamedTuple):
    """Working arrays of a replay with stiction."""

    workspace: TangentWorkspace  # of the step whose length alone changes
    longer: Directions  # a pair without any change of its own
    stiction: StictionWorkspace
    before: Array  # (9,) motion of the first joint at the beginning of the step, and at another time
    after: Array
    moved_before: Array  # (p, CHANGES) its changes
    moved: Array


@kernel
def new_event_workspace(chain, drive, directions):  # type: ignore[no-untyped-def]
    """Working arrays for a chain, its drive and a number of directions."""
    n, p, k = chain.length.size, 2 * directions.parameters.size, drive.breaks.size - 1
    links, whole = zeros((1, 2, n, directions.links.shape[3]), (2, 3))
    parameters, driven = np.ones(1, dtype=np.bool_), np.zeros(2, dtype=np.int64)
    longer = Directions(links, whole, parameters, driven, *zeros((1, k + 1), (1, k, 4, 6), 1))
    workspace = new_tangent_workspace(chain, 1)
    workspace.change[0] = 1.0
    return EventWorkspace(workspace, longer, new_stiction_workspace(n), *zeros(9, 9, (p, CHANGES), (p, CHANGES)))


@non_allocating
def base_changes(drive, part, t, late, directions, moved):  # type: ignore[no-untyped-def]
    """Write the changes (p, CHANGES) of the base's motion at a time t, s, that itself changes by `late` (p,)."""
    for x in range(moved.shape[0]):
        m = directions.driven[x]
        moved[x] = 0.0
        if m >= 0:
            base_change(drive, part, t, late[x], directions, m, moved[x])


@non_allocating
def project_stuck_tangent(slip, before, moved_before, moved, values):  # type: ignore[no-untyped-def]
    """Project derivatives (2 n, p) onto stuck joints, as ``project_stuck`` does the state; `before` are earlier."""
    n = slip.size
    for i in range(n):
        if slip[i] == 0.0:
            for x in range(values.shape[1]):
                if i > 0:
                    values[n + i, x] = values[n + i - 1, x]
                    values[i, x] = values[i - 1, x] + (before[i, x] - before[i - 1, x])
                else:
                    values[n, x] = moved[x, RATE]
                    values[0, x] = moved[x, TURN] + (before[0, x] - moved_before[x, TURN])


@non_allocating
def stop_joints_tangent(slip, margin, moved, values):  # type: ignore[no-untyped-def]
    """Give the rates' derivatives of joints that stick, or have just come to rest, those of their parents."""
    n = slip.size
    for i in range(n):
        if slip[i] == 0.0 or stops(margin, i):
            for x in range(values.shape[1]):
                values[n + i, x] = values[n + i - 1, x] if i > 0 else moved[x, RATE]


@non_allocating
def relative(values, row, i, x, moved, kind):  # type: ignore[no-untyped-def]
    """Difference of a row's derivative along direction x between joint i's link and its parent."""
    return values[row, x] - (values[row - 1, x] if i > 0 else moved[x, kind])


@kernel
def margin_derivatives(chain, drive, part, t, step, y, slip, joint, directions, workspace, turn):  # type: ignore[no-untyped-def]
    """Derivatives (p,) of the margin of `joint` at the end of the step, and along the step's length.

    A stuck joint is at its limit where, let go, it would not accelerate: its margin is that acceleration.
    """
    n = slip.size
    row, kind = n + joint, RATE
    values, grown = workspace.nodes[2], turn.workspace.nodes[2]
    if slip[joint] == 0.0:
        out = workspace.ys[2]
        torque = base_state(drive, part, min(t + step, part.end), turn.after)
        constraint_torques(chain, out[:n], out[n : 2 * n], slip, turn.after, torque, turn.stiction)
        free = slip.copy()
        free[joint] = -1.0 if turn.stiction.load[joint] > 0.0 else 1.0
        for one, way in ((workspace, directions), (turn.workspace, turn.longer)):
            assign(one.ys[0], y)
            assign(one.ys[1], out)
            assign(one.ys[2], out)
            assign_rows(one.nodes[1], one.nodes[2])
            ln.set_slip(ln.COLUMNS, one.lanes, free)
            acceleration_derivatives(chain, drive, part, t, step, way, one)
            ln.set_slip(ln.COLUMNS, one.lanes, slip)
        row, kind = joint, ALPHA
        values, grown = workspace.bends[2], turn.workspace.bends[2]
    moved = np.zeros((1, CHANGES))
    base_change(drive, part, t + step, 1.0, turn.longer, 0, moved[0])
    slope = relative(grown, row, joint, 0, moved, kind)
    base_changes(drive, part, t + step, workspace.shift, directions, turn.moved)
    result = np.empty(values.shape[1])
    for x in range(result.size):
        result[x] = relative(values, row, joint, x, turn.moved, kind)
    return result, slope


@non_allocating
def is_chatter(drive, part, t, step, y, slip, joint, turn):  # type: ignore[no-untyped-def]
    """Whether the event at the end of a step is but rounding: of a joint at rest, within a step that is too short."""
    n = slip.size
    base_state(drive, part, t, turn.before)
    return step < STICTION.quick and at_rest(y[n + joint], y[n + joint - 1] if joint > 0 else turn.before[3])


@kernel
def event_sensitivity(chain, drive, part, table, t, step, y, values, slip, joint, directions, workspace, turn):  # type: ignore[no-untyped-def]
    """Let the step in ``workspace.nodes`` end where `joint` changes its mode; sets ``workspace.change``."""
    extra = turn.workspace
    set_start(np.zeros((2 * slip.size, 2)), extra.store)
    tangent_step(chain, drive, part, table, t, step, y, extra.out, turn.longer, extra.nodes[2], extra)
    margin, slope = margin_derivatives(chain, drive, part, t, step, y, slip, joint, directions, workspace, turn)
    set_start(values, workspace.store)  # where it was before
    for x in range(margin.size):
        change = -margin[x] / slope if slope != 0.0 else 0.0
        workspace.change[x] = change
        for i in range(2 * slip.size):
            workspace.nodes[2, i, x] += change * extra.nodes[2, i, 0]


@kernel
def tangent_step_end(chain, drive, part, t, step, y, values, slip, joint, directions, workspace, turn):  # type: ignore[no-untyped-def]
    """Hold stuck joints at the end of a step, in ``ys[2]`` and ``nodes[2]``, and those at rest after it.

    `y`, `values`: state and derivatives (2 n, p) before the step. `joint`: whose change of mode ends the step, or -1.
    """
    n = slip.size
    out = workspace.ys[2]
    base_state(drive, part, t, turn.before)
    torque = base_state(drive, part, min(t + step, part.end), turn.after)
    project_stuck(chain, slip, y, turn.before, out, turn.after)
    base_changes(drive, part, t, workspace.shift, directions, turn.moved_before)
    base_changes(drive, part, t + step, workspace.shift + workspace.change, directions, turn.moved)
    project_stuck_tangent(slip, values, turn.moved_before, turn.moved, workspace.nodes[2])
    if joint >= 0:
        margin = turn.stiction.margin
        margins(chain, out[:n], out[n : 2 * n], slip, turn.after, torque, 1.0, turn.stiction, margin)
        stop_joints(chain, slip, margin, out, turn.after)
        stop_joints_tangent(slip, margin, turn.moved, workspace.nodes[2])


@kernel
def project_outputs(chain, drive, part, t, y, values, slip, t_out, directions, workspace, turn, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Hold stuck joints at outputs (m,) within a step from t, whose beginning is in `y` and `values`."""
    still = np.zeros_like(workspace.shift)
    base_state(drive, part, t, turn.before)
    base_changes(drive, part, t, workspace.shift, directions, turn.moved_before)
    for k in range(t_out.size):
        base_state(drive, part, t_out[k], turn.after)
        project_stuck(chain, slip, y, turn.before, y_out[k], turn.after)
        base_changes(drive, part, t_out[k], still, directions, turn.moved)
        project_stuck_tangent(slip, values, turn.moved_before, turn.moved, dy_out[k])


@non_allocating
def write_end(chain, drive, part, t, y, slip, workspace, values, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Write the state at the end of a step, and its derivatives at that very time, where the step's end moves too."""
    assign(y_out, y)
    assign_rows(dy_out, values)
    if workspace.shift.any():
        rates(chain, drive, part, t, y, slip, workspace.dys[0], workspace.work)
        for i in range(2 * slip.size):
            for x in range(workspace.shift.size):
                dy_out[i, x] -= workspace.dys[0, i] * workspace.shift[x]


@non_allocating
def set_change(drive, part, t_new, stop, directions, workspace):  # type: ignore[no-untyped-def]
    """Change of the length of the step that ends at t_new: none, unless a switch or the end of the run cuts it.

    For events see :func:`event_sensitivity`.
    """
    for x, m in enumerate(directions.driven):
        workspace.change[x] = -workspace.shift[x] if t_new >= part.end or t_new >= stop else 0.0
        if m >= 0 and t_new >= part.end:
            workspace.change[x] += end_shift(drive, part, directions.breaks[m])


@kernel
def forward_sensitivities(chain, drive, tables, steps, begin, start, directions, t_out, y_out, dy_out, halt):  # type: ignore[no-untyped-def]
    """Go through a recorded run again; O(n p) a step.

    Parameters
    ----------
    chain, drive, directions : Chain, Drive, Directions
    tables : tuple of Scheme, of successive orders
    steps : (m, 3) or (m, 4 + n), as in ``rollout.Progress.log``
    begin : float, s
    start : (2 n, p) derivatives of angles and rates at `begin`
    t_out : (T,) increasing times, s
    y_out : (T, 2 n + 2) out, angles and rates; row 0 holds the state at `begin` when called, and t_out[0] is `begin`
    dy_out : (T, 2 n, p) out, but for row 0
    halt : (1,) another value than 0, set from another thread, ends it at the next step
    """
    workspace = new_tangent_workspace(chain, directions.parameters.size)
    turn = new_event_workspace(chain, drive, directions)
    sticks = steps.shape[1] > JOINT
    slip, joint = np.ones(chain.length.size), -1
    y = y_out[0].copy()
    values = start.copy()
    t, index, fresh = begin, 1, False
    part = segment(drive, t)
    stop = steps[-1, END]
    for m in range(steps.shape[0]):
        if halt[0]:
            return
        step, t_new = steps[m, LENGTH], steps[m, END]
        table = tables[int(steps[m, DEGREE]) - tables[0].order]
        if t >= part.end:
            part = segment(drive, t)
        set_change(drive, part, t_new, stop, directions, workspace)
        if sticks:
            assign(slip, steps[m, MODES:])
            joint = int(steps[m, JOINT])
            ln.set_slip(ln.COLUMNS, workspace.lanes, slip)
            ln.set_slip(ln.COLUMNS, turn.workspace.lanes, slip)
        set_start(values, workspace.store)
        tangent_step(chain, drive, part, table, t, step, y, workspace.out, directions, workspace.nodes[2], workspace)
        assign(workspace.ys[0], y)
        assign(workspace.ys[2], workspace.out)
        assign_rows(workspace.nodes[0], values)
        if joint >= 0 and t_new < min(part.end, stop) and not is_chatter(drive, part, t, step, y, slip, joint, turn):
            event_sensitivity(chain, drive, part, table, t, step, y, values, slip, joint, directions, workspace, turn)
        if sticks:
            tangent_step_end(chain, drive, part, t, step, y, values, slip, joint, directions, workspace, turn)
        last = index
        while last < t_out.size and t_out[last] < t_new:
            last += 1
        times, states, slopes = t_out[index:last], y_out[index:last], dy_out[index:last]
        if last > index and fresh:
            change = workspace.change.copy()
            for x in range(change.size):
                workspace.change[x] = -workspace.shift[x]
            for k in range(times.size):
                tangent_step(chain, drive, part, table, t, times[k] - t, y, states[k], directions, slopes[k], workspace)
            assign(workspace.change, change)
        elif last > index:
            write_within_step(chain, drive, part, table, t, t_new - t, y, times, directions, workspace, states, slopes)
        if last > index and not slip.all():
            project_outputs(chain, drive, part, t, y, values, slip, times, directions, workspace, turn, states, slopes)
        index = last
        assign(y, workspace.ys[2])
        assign_rows(values, workspace.nodes[2])
        for x in range(workspace.shift.size):
            workspace.shift[x] += workspace.change[x]
        fresh = t_new >= part.end or joint >= 0
        t = t_new
        while index < t_out.size and t_out[index] <= t:
            write_end(chain, drive, part, t, y, slip, workspace, values, y_out[index], dy_out[index])
            index += 1
