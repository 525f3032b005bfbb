"""How joints slip or stick where a run stands, and the step that ends at the next event."""

from __future__ import annotations

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import PRINTED, can_stick
from hyperflex.core.chain.drive import base_state
from hyperflex.core.integrate.end_conditions import NOTHING, PEAK, arm, limits, reading, right_side
from hyperflex.core.integrate.event_search import AGAIN, EVENT, TRIES, begin, first_late, judge, late
from hyperflex.core.integrate.progress import CHATTER, PENDING, REJECTED, TAKEN, T, advance
from hyperflex.core.jit import kernel
from hyperflex.core.stiction.constraint_torques import come_to_rest, hold, margins, middle, stuck_power, widened
from hyperflex.core.stiction.slip_modes import settled


@kernel
def settle(chain, drive, part, progress, room):  # type: ignore[no-untyped-def]
    """Decide the modes of the joints where a run stands; False where no modes obey the law, or joints chatter."""
    y, grip, clock = progress.y, progress.grip, progress.clock
    n = grip.size
    torque = base_state(drive, part, clock[T], room.after)
    now, before = room.after[:7], room.out[:n]
    good, chatter = settled(chain, y[:n], y[n : 2 * n], now, torque, clock[CHATTER], grip, before, room.bench)
    clock[CHATTER] = chatter
    ln.set_grip(ln.COLUMNS, room.lanes, grip)
    return good


@kernel
def end_margins(chain, until, sense, q, w, alpha, base, last, out):  # type: ignore[no-untyped-def]
    """Margins of the joints' limits, and in column `last` that of what may end the run, to ``out`` (2, last + 1)."""
    if sense != 0.0:
        value, slope = reading(until, chain, q, w, alpha, base)
        out[0, last], out[1, last] = sense * value, sense * slope
    if last > q.size:
        limits(chain, q, w, base, out)


@kernel
def locate(chain, drive, part, table, terms, progress, step, room):  # type: ignore[no-untyped-def]
    """Shorten the step to ``room.out`` until it holds no event, or ends at its first one; `terms` are the Limits.

    Returns
    -------
    step : float, s
    event : int, 0: none; 1: a joint changes its mode; 2: what ends the run has happened; 3: a joint is at its limit
    joint : int, the one that changes its mode, -1 where none does
    """
    until = terms.until
    y, grip, clock, search, tools = progress.y, progress.grip, progress.clock, room.search, room.bench
    n, last = grip.size, room.locked.size - 1
    limited = last > n
    t, widen, stuck, sticks = clock[T], widened(clock[CHATTER], n), not grip.all(), can_stick(chain)
    for i in range(n):
        room.locked[i] = 1.0 - grip[i] * grip[i]
    torque = base_state(drive, part, t, room.before)
    margins(chain, y[:n], y[n : 2 * n], grip, room.before[:7], torque, widen, tools, search.low)
    assign(room.alpha, tools.alpha)
    room.power[0] = stuck_power(chain, y[n : 2 * n], grip, tools.load)
    begin(search)
    sense = 0.0
    room.locked[last] = 1.0 if until.kind == PEAK else 0.0
    if until.kind != NOTHING:
        value, slope = reading(until, chain, y[:n], y[n : 2 * n], room.alpha, room.before)
        sense = arm(until, value, slope, t)
        if until.kind == PEAK and sense == 0.0 and clock[PENDING] > 0.0:
            return 0.0, 2, -1  # the speed grew until here, and falls from here on
        search.low[:, last] = np.inf
        search.here[:, last] = np.inf
    end_margins(chain, until, sense, y[:n], y[n : 2 * n], room.alpha, room.before, last, search.low)
    while True:
        out = room.out
        torque = base_state(drive, part, min(t + step, part.end), room.after)
        hold(chain, grip, y, room.before, out, room.after)
        margins(chain, out[:n], out[n : 2 * n], grip, room.after[:7], torque, widen, tools, search.here)
        room.power[2] = stuck_power(chain, out[n : 2 * n], grip, tools.load)
        end_margins(chain, until, sense, out[:n], out[n : 2 * n], tools.alpha, room.after, last, search.here)
        first = search.span[TRIES] == 0.0 and (sticks or limited or (sense != 0.0 and until.kind == PEAK))
        if first or (stuck and len(chain.bears) == len(PRINTED)):
            middle(step, y[:n], y[n : 2 * n], room.alpha, out, tools)
            torque = base_state(drive, part, t + 0.5 * step, room.between)
            bend = tools.state
            margins(chain, bend[:n], bend[n:], grip, room.between[:7], torque, widen, tools, tools.margin)
            assign_rows(search.middle[:, :n], tools.margin)
            room.power[1] = stuck_power(chain, bend[n:], grip, tools.load)
            if sense != 0.0 and until.kind == PEAK:
                value, slope = reading(until, chain, bend[:n], bend[n:], tools.alpha, room.between)
                search.middle[0, last] = sense * value
            if limited:
                limits(chain, bend[:n], bend[n:], room.between, search.middle)
        verdict, length = judge(room.locked, search, step)
        if verdict == EVENT:
            come_to_rest(chain, grip, search.here, out, room.after)
        if verdict != AGAIN:
            clock[PENDING] = search.here[0, last] if sense != 0.0 else 0.0
            joint = first_late(room.locked, search.here) if verdict == EVENT else -1
            if verdict == EVENT and joint >= n and joint < last:
                return step, 3, joint
            if verdict == EVENT and late(room.locked, search.here, last):
                good = right_side(until, chain, out[:n], out[n : 2 * n], room.after)
                clock[PENDING] = 0.0
                return step, 2 if good else 1, joint
            return step, 1 if verdict == EVENT else 0, joint
        step = length
        clock[TAKEN] += 1
        clock[REJECTED] += 1
        advance(chain, drive, part, table, terms.fixed, t, step, y, grip, out, room)
