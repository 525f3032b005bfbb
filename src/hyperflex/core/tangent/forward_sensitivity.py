"""Forward sensitivity of a recorded run, for any number of directions.

The steps stay what they were, so the result is the derivative of the very numbers that the run gave: each step keeps
its length but for one that ends at a switch, at an event or at an output, whose time depends on a direction.
"""

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.drive import segment
from hyperflex.core.integrate.progress import DEGREE, END, JOINT, LENGTH, MODES
from hyperflex.core.integrate.steps import rates
from hyperflex.core.jit import kernel, non_allocating
from hyperflex.core.tangent import directions as dr
from hyperflex.core.tangent.dense_output import write_within_step
from hyperflex.core.tangent.events import (
    event_sensitivity,
    is_chatter,
    new_event_workspace,
    project_outputs,
    tangent_step_end,
)
from hyperflex.core.tangent.extrapolation import new_tangent_workspace, set_start, tangent_step


@non_allocating
def write_end(chain, drive, part, t, y, slip, workspace, values, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Write the state at the end of a step, and its derivatives at that very time, where the step's end moves too."""
    assign(y_out, y)
    assign_rows(dy_out, values)
    if workspace.shift.any():
        rates(chain, drive, part, t, y, slip, workspace.dys[0], workspace.work)
        for b in range(workspace.shift.shape[0]):
            for d in range(2):
                for i in range(2 * slip.size):
                    dy_out[i, 2 * b + d] -= workspace.dys[0, i] * workspace.shift[b, d]


@non_allocating
def set_change(drive, part, t_new, stop, directions, workspace):  # type: ignore[no-untyped-def]
    """Change of the length of the step that ends at t_new: none, unless a switch or the end of the run cuts it.

    For events see core/tangent/events.py.
    """
    for b in range(directions.kind.size):
        for d in range(2):
            m = directions.driven[b, d]
            workspace.change[b, d] = -workspace.shift[b, d] if t_new >= part.end or t_new >= stop else 0.0
            if m >= 0 and t_new >= part.end:
                workspace.change[b, d] += dr.end_shift(drive, part, directions.breaks[m])


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
    y_out : (T, 2 n + 2) out; row 0 holds the state at `begin` when called, and t_out[0] is `begin`
    dy_out : (T, 2 n, p) out, but for row 0
    halt : (1,) another value than 0, set from another thread, ends it at the next step
    """
    workspace = new_tangent_workspace(chain, directions.kind.size)
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
            for b in range(change.shape[0]):
                for d in range(change.shape[1]):
                    workspace.change[b, d] = -workspace.shift[b, d]
            for k in range(times.size):
                tangent_step(chain, drive, part, table, t, times[k] - t, y, states[k], directions, slopes[k], workspace)
            assign_rows(workspace.change, change)
        elif last > index:
            write_within_step(chain, drive, part, table, t, t_new - t, y, times, directions, workspace, states, slopes)
        if last > index and not slip.all():
            project_outputs(chain, drive, part, t, y, values, slip, times, directions, workspace, turn, states, slopes)
        index = last
        assign(y, workspace.ys[2])
        assign_rows(values, workspace.nodes[2])
        for b in range(workspace.shift.shape[0]):
            for d in range(workspace.shift.shape[1]):
                workspace.shift[b, d] += workspace.change[b, d]
        fresh = t_new >= part.end or joint >= 0
        t = t_new
        while index < t_out.size and t_out[index] <= t:
            write_end(chain, drive, part, t, y, slip, workspace, values, y_out[index], dy_out[index])
            index += 1
