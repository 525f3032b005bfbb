"""Event sensitivity: derivatives of stuck joints and of steps that end at an event.

A stuck joint keeps its angle in every direction. A step that ends at an event is as long as it takes the event's margin
to fall to zero (core/integrate/event_search.py), so its length has a derivative: less that of the margin over the
margin's slope. The slope is the derivative along one more direction, in which nothing changes but the step's length.
"""

from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.chain.drive import base_state
from hyperflex.core.jit import kernel, non_allocating
from hyperflex.core.stiction.constraint_torques import (
    QUICK,
    StictionWorkspace,
    at_rest,
    constraint_torques,
    margins,
    new_stiction_workspace,
    project_stuck,
    stop_joints,
    stops,
)
from hyperflex.core.tangent import directions as dr
from hyperflex.core.tangent.dense_output import acceleration_derivatives
from hyperflex.core.tangent.directions import Directions
from hyperflex.core.tangent.extrapolation import TangentWorkspace, new_tangent_workspace, set_start, tangent_step


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
    n, p, k = chain.length.size, 2 * directions.kind.size, drive.breaks.size - 1
    longer = Directions(
        np.zeros((1, 2, n, directions.links.shape[3])),
        np.zeros((1, 2, 3)),
        np.full(1, dr.LINKS + dr.ENDS),
        np.zeros((1, 2), dtype=np.int64),
        np.zeros((1, k + 1)),
        np.zeros((1, k, 4, 6)),
        np.zeros(1),
    )
    workspace = new_tangent_workspace(chain, 1)
    workspace.change[0, 0] = 1.0
    moved = np.zeros((2, p, dr.CHANGES))
    return EventWorkspace(workspace, longer, new_stiction_workspace(n), np.zeros(9), np.zeros(9), moved[0], moved[1])


@non_allocating
def base_changes(drive, part, t, late, directions, moved):  # type: ignore[no-untyped-def]
    """Write the changes (p, CHANGES) of the base's motion at a time t, s, that itself changes by `late` (b, 2)."""
    for x in range(moved.shape[0]):
        m = directions.driven[x // 2, x % 2]
        moved[x] = 0.0
        if m >= 0:
            dr.base_change(drive, part, t, late[x // 2, x % 2], directions, m, moved[x])


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
                    values[n, x] = moved[x, dr.RATE]
                    values[0, x] = moved[x, dr.TURN] + (before[0, x] - moved_before[x, dr.TURN])


@non_allocating
def stop_joints_tangent(slip, margin, moved, values):  # type: ignore[no-untyped-def]
    """Give the rates' derivatives of joints that stick, or have just come to rest, those of their parents."""
    n = slip.size
    for i in range(n):
        if slip[i] == 0.0 or stops(margin, i):
            for x in range(values.shape[1]):
                values[n + i, x] = values[n + i - 1, x] if i > 0 else moved[x, dr.RATE]


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
    row, kind = n + joint, dr.RATE
    values, grown = workspace.nodes[2], turn.workspace.nodes[2]
    if slip[joint] == 0.0:
        out = workspace.ys[2]
        torque = base_state(drive, part, min(t + step, part.end), turn.after)
        constraint_torques(chain, out[:n], out[n : 2 * n], slip, turn.after[:7], torque, turn.stiction)
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
        row, kind = joint, dr.ALPHA
        values, grown = workspace.bends[2], turn.workspace.bends[2]
    moved = np.zeros((1, dr.CHANGES))
    dr.base_change(drive, part, t + step, 1.0, turn.longer, 0, moved[0])
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
    return step < QUICK and at_rest(y[n + joint], y[n + joint - 1] if joint > 0 else turn.before[3])


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
        workspace.change[x // 2, x % 2] = change
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
        margins(chain, out[:n], out[n : 2 * n], slip, turn.after[:7], torque, 1.0, turn.stiction, margin)
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
