"""A run gone through again along its recorded steps, with its derivatives in any number of directions.

The steps stay what they were, so the result is the derivative of the very numbers that the run gave: each step keeps
its length but for one that ends at a switch, at an event or at an output, whose time depends on a direction.
"""

from __future__ import annotations

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.drive import segment
from hyperflex.core.integrate.progress import DEGREE, END, JOINT, LENGTH, MODES
from hyperflex.core.integrate.steps import rates
from hyperflex.core.jit import kernel
from hyperflex.core.tangent import directions as dr
from hyperflex.core.tangent.dense_output import write_inside
from hyperflex.core.tangent.events import chatters, end_along, end_at_event, hold_outputs, turning_for
from hyperflex.core.tangent.extrapolation import room_for, spread, step_along


@kernel
def write_end(chain, drive, part, t, y, grip, room, values, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Write the state at the end of a step, and its derivatives at that very time, where the step's end moves too."""
    assign(y_out, y)
    assign_rows(dy_out, values)
    if room.shift.any():
        rates(chain, drive, part, t, y, grip, room.dys[0], room.work)
        for b in range(room.shift.shape[0]):
            for d in range(2):
                for i in range(2 * grip.size):
                    dy_out[i, 2 * b + d] -= room.dys[0, i] * room.shift[b, d]


@kernel
def set_change(drive, part, t_new, stop, directions, room):  # type: ignore[no-untyped-def]
    """Change of the length of the step that ends at t_new: none, unless a switch or the end of the run cuts it.

    For events see core/tangent/events.py.
    """
    for b in range(directions.kind.size):
        for d in range(2):
            m = directions.driven[b, d]
            room.change[b, d] = -room.shift[b, d] if t_new >= part.end or t_new >= stop else 0.0
            if m >= 0 and t_new >= part.end:
                room.change[b, d] += dr.end_shift(drive, part, directions.breaks[m])


@kernel
def replay(chain, drive, tables, steps, begin, start, directions, t_out, y_out, dy_out):  # type: ignore[no-untyped-def]
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
    """
    room = room_for(chain, directions.kind.size)
    turn = turning_for(chain, drive, directions)
    sticks = steps.shape[1] > JOINT
    grip, joint = np.ones(chain.length.size), -1
    y = y_out[0].copy()
    values = start.copy()
    t, index, fresh = begin, 1, False
    part = segment(drive, t)
    stop = steps[-1, END]
    for m in range(steps.shape[0]):
        step, t_new = steps[m, LENGTH], steps[m, END]
        table = tables[int(steps[m, DEGREE]) - tables[0].order]
        if t >= part.end:
            part = segment(drive, t)
        set_change(drive, part, t_new, stop, directions, room)
        if sticks:
            assign(grip, steps[m, MODES:])
            joint = int(steps[m, JOINT])
            ln.set_grip(ln.COLUMNS, room.lanes, grip)
            ln.set_grip(ln.COLUMNS, turn.room.lanes, grip)
        spread(values, room.store)
        step_along(chain, drive, part, table, t, step, y, room.out, directions, room.nodes[2], room)
        assign(room.ys[0], y)
        assign(room.ys[2], room.out)
        assign_rows(room.nodes[0], values)
        if joint >= 0 and t_new < min(part.end, stop) and not chatters(drive, part, t, step, y, grip, joint, turn):
            end_at_event(chain, drive, part, table, t, step, y, values, grip, joint, directions, room, turn)
        if sticks:
            end_along(chain, drive, part, t, step, y, values, grip, joint, directions, room, turn)
        last = index
        while last < t_out.size and t_out[last] < t_new:
            last += 1
        times, states, slopes = t_out[index:last], y_out[index:last], dy_out[index:last]
        if last > index and fresh:
            change = room.change.copy()
            for b in range(change.shape[0]):
                for d in range(change.shape[1]):
                    room.change[b, d] = -room.shift[b, d]
            for k in range(times.size):
                step_along(chain, drive, part, table, t, times[k] - t, y, states[k], directions, slopes[k], room)
            assign_rows(room.change, change)
        elif last > index:
            write_inside(chain, drive, part, table, t, t_new - t, y, times, directions, room, states, slopes)
        if last > index and not grip.all():
            hold_outputs(chain, drive, part, t, y, values, grip, times, directions, room, turn, states, slopes)
        index = last
        assign(y, room.ys[2])
        assign_rows(values, room.nodes[2])
        for b in range(room.shift.shape[0]):
            for d in range(room.shift.shape[1]):
                room.shift[b, d] += room.change[b, d]
        fresh = t_new >= part.end or joint >= 0
        t = t_new
        while index < t_out.size and t_out[index] <= t:
            write_end(chain, drive, part, t, y, grip, room, values, y_out[index], dy_out[index])
            index += 1
