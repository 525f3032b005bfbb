"""Derivatives where joints stick, and of steps that end where a joint changes its mode.

A stuck joint keeps its angle in every direction. A step that ends at an event is as long as it takes the event's margin
to fall to zero (core/integrate/event_search.py), so its length has a derivative: less that of the margin over the
margin's slope. The slope is the derivative along one more direction, in which nothing changes but the step's length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.chain.drive import base_state
from hyperflex.core.jit import kernel
from hyperflex.core.stiction.constraint_torques import (
    QUICK,
    Bench,
    at_rest,
    bear,
    bench,
    come_to_rest,
    hold,
    margins,
    stops,
)
from hyperflex.core.tangent import directions as dr
from hyperflex.core.tangent.dense_output import bends_along
from hyperflex.core.tangent.directions import Directions
from hyperflex.core.tangent.extrapolation import Room, room_for, spread, step_along


class Turning(NamedTuple):
    """Working arrays of a replay with stiction."""

    room: Room  # of the step whose length alone changes
    longer: Directions  # a pair without any change of its own
    bench: Bench
    before: Array  # (9,) motion of the first joint at the beginning of the step, and at another time
    after: Array
    moved_before: Array  # (p, CHANGES) its changes
    moved: Array


@kernel
def turning_for(chain, drive, directions):  # type: ignore[no-untyped-def]
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
    room = room_for(chain, 1)
    room.change[0, 0] = 1.0
    moved = np.zeros((2, p, dr.CHANGES))
    return Turning(room, longer, bench(n), np.zeros(9), np.zeros(9), moved[0], moved[1])


@kernel
def base_moves(drive, part, t, late, directions, moved):  # type: ignore[no-untyped-def]
    """Write the changes (p, CHANGES) of the base's motion at a time t, s, that itself changes by `late` (b, 2)."""
    for x in range(moved.shape[0]):
        m = directions.driven[x // 2, x % 2]
        moved[x] = 0.0
        if m >= 0:
            dr.base_change(drive, part, t, late[x // 2, x % 2], directions, m, moved[x])


@kernel
def hold_along(grip, before, moved_before, moved, values):  # type: ignore[no-untyped-def]
    """Take rounding off derivatives (2 n, p) of stuck joints, as ``stick.hold`` off the state; `before` are earlier."""
    n = grip.size
    for i in range(n):
        if grip[i] == 0.0:
            for x in range(values.shape[1]):
                if i > 0:
                    values[n + i, x] = values[n + i - 1, x]
                    values[i, x] = values[i - 1, x] + (before[i, x] - before[i - 1, x])
                else:
                    values[n, x] = moved[x, dr.RATE]
                    values[0, x] = moved[x, dr.TURN] + (before[0, x] - moved_before[x, dr.TURN])


@kernel
def rest_along(grip, margin, moved, values):  # type: ignore[no-untyped-def]
    """Give the rates' derivatives of joints that stick, or have just come to rest, those of their parents."""
    n = grip.size
    for i in range(n):
        if grip[i] == 0.0 or stops(margin, i):
            for x in range(values.shape[1]):
                values[n + i, x] = values[n + i - 1, x] if i > 0 else moved[x, dr.RATE]


@kernel
def relative(values, row, i, x, moved, kind):  # type: ignore[no-untyped-def]
    """Difference of a row's derivative along direction x between joint i's link and its parent."""
    return values[row, x] - (values[row - 1, x] if i > 0 else moved[x, kind])


@kernel
def margin_rates(chain, drive, part, t, step, y, grip, joint, directions, room, turn):  # type: ignore[no-untyped-def]
    """Derivatives (p,) of the margin of `joint` at the end of the step in the rooms' nodes, and along its length.

    A stuck joint is at its limit where, let go, it would not accelerate: its margin is that acceleration.
    """
    n = grip.size
    row, kind = n + joint, dr.RATE
    values, grown = room.nodes[2], turn.room.nodes[2]
    if grip[joint] == 0.0:
        out = room.ys[2]
        torque = base_state(drive, part, min(t + step, part.end), turn.after)
        bear(chain, out[:n], out[n : 2 * n], grip, turn.after[:7], torque, turn.bench)
        free = grip.copy()
        free[joint] = -1.0 if turn.bench.load[joint] > 0.0 else 1.0
        for one, way in ((room, directions), (turn.room, turn.longer)):
            one.ys[0], one.ys[1], one.ys[2] = y, out, out
            one.nodes[1] = one.nodes[2]
            ln.set_grip(ln.COLUMNS, one.lanes, free)
            bends_along(chain, drive, part, t, step, way, one)
            ln.set_grip(ln.COLUMNS, one.lanes, grip)
        row, kind = joint, dr.ALPHA
        values, grown = room.bends[2], turn.room.bends[2]
    moved = np.zeros((1, dr.CHANGES))
    dr.base_change(drive, part, t + step, 1.0, turn.longer, 0, moved[0])
    slope = relative(grown, row, joint, 0, moved, kind)
    base_moves(drive, part, t + step, room.shift, directions, turn.moved)
    result = np.empty(values.shape[1])
    for x in range(result.size):
        result[x] = relative(values, row, joint, x, turn.moved, kind)
    return result, slope


@kernel
def chatters(drive, part, t, step, y, grip, joint, turn):  # type: ignore[no-untyped-def]
    """Whether the event at the end of a step is but rounding: of a joint at rest, within a step that is too short."""
    n = grip.size
    base_state(drive, part, t, turn.before)
    return step < QUICK and at_rest(y[n + joint], y[n + joint - 1] if joint > 0 else turn.before[3])


@kernel
def end_at_event(chain, drive, part, table, t, step, y, values, grip, joint, directions, room, turn):  # type: ignore[no-untyped-def]
    """Let the step in ``room.nodes`` end where `joint` changes its mode: sets ``room.change``, the end follows."""
    extra = turn.room
    spread(np.zeros((2 * grip.size, 2)), extra.store)
    step_along(chain, drive, part, table, t, step, y, extra.out, turn.longer, extra.nodes[2], extra)
    margin, slope = margin_rates(chain, drive, part, t, step, y, grip, joint, directions, room, turn)
    spread(values, room.store)  # where it was before
    for x in range(margin.size):
        change = -margin[x] / slope if slope != 0.0 else 0.0
        room.change[x // 2, x % 2] = change
        for i in range(2 * grip.size):
            room.nodes[2, i, x] += change * extra.nodes[2, i, 0]


@kernel
def end_along(chain, drive, part, t, step, y, values, grip, joint, directions, room, turn):  # type: ignore[no-untyped-def]
    """Hold stuck joints at the end of a step, in ``room.ys[2]`` and ``room.nodes[2]``, and those at rest after it.

    `y`, `values`: state and derivatives (2 n, p) before the step. `joint`: whose change of mode ends the step, or -1.
    """
    n = grip.size
    out = room.ys[2]
    base_state(drive, part, t, turn.before)
    torque = base_state(drive, part, min(t + step, part.end), turn.after)
    hold(chain, grip, y, turn.before, out, turn.after)
    base_moves(drive, part, t, room.shift, directions, turn.moved_before)
    base_moves(drive, part, t + step, room.shift + room.change, directions, turn.moved)
    hold_along(grip, values, turn.moved_before, turn.moved, room.nodes[2])
    if joint >= 0:
        margin = turn.bench.margin
        margins(chain, out[:n], out[n : 2 * n], grip, turn.after[:7], torque, 1.0, turn.bench, margin)
        come_to_rest(chain, grip, margin, out, turn.after)
        rest_along(grip, margin, turn.moved, room.nodes[2])


@kernel
def hold_outputs(chain, drive, part, t, y, values, grip, t_out, directions, room, turn, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Hold stuck joints at outputs (m,) within a step from t, whose beginning is in `y` and `values`."""
    still = np.zeros_like(room.shift)
    base_state(drive, part, t, turn.before)
    base_moves(drive, part, t, room.shift, directions, turn.moved_before)
    for k in range(t_out.size):
        base_state(drive, part, t_out[k], turn.after)
        hold(chain, grip, y, turn.before, y_out[k], turn.after)
        base_moves(drive, part, t_out[k], still, directions, turn.moved)
        hold_along(grip, values, turn.moved_before, turn.moved, dy_out[k])
