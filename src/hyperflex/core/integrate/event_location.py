"""Event location: the step that ends at the first event, and the modes after it."""

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import ONE_SIDED, can_stick, sticks_often
from hyperflex.core.chain.drive import base_state
from hyperflex.core.integrate.end_conditions import NOTHING, PEAK, event_value, limits, on_right_side, watched_sense
from hyperflex.core.integrate.event_search import (
    AGAIN,
    EVENT,
    TRIES,
    allow_lateness,
    assess_step,
    begin_search,
    first_past,
    is_past,
)
from hyperflex.core.integrate.progress import CHATTER, PENDING, REJECTED, TAKEN, T, advance
from hyperflex.core.jit import non_allocating
from hyperflex.core.stiction.constraint_torques import (
    constraint_torques,
    margins,
    margins_of,
    midpoint_state,
    project_stuck,
    stop_joints,
    stuck_power,
    tolerance_factor,
)
from hyperflex.core.stiction.slip_modes import decide_modes


@non_allocating
def update_modes(chain, drive, part, progress, workspace):  # type: ignore[no-untyped-def]
    """Decide the modes of the joints where a run stands; False where no modes obey the law, or joints chatter."""
    y, slip, clock = progress.y, progress.slip, progress.clock
    n = slip.size
    torque = base_state(drive, part, clock[T], workspace.before)
    now, before = workspace.before[:7], workspace.out[:n]
    tools = workspace.stiction
    good, chatter = decide_modes(chain, y[:n], y[n : 2 * n], now, torque, clock[CHATTER], slip, before, tools)
    clock[CHATTER] = chatter
    ln.set_slip(ln.COLUMNS, workspace.lanes, slip)
    return good


@non_allocating
def end_margins(chain, until, sense, q, w, alpha, base, last, out):  # type: ignore[no-untyped-def]
    """Margins of the joints' limits, and in column `last` that of what may end the run, to ``out`` (2, last + 1)."""
    if sense != 0.0:
        value, slope = event_value(until, chain, q, w, alpha, base)
        out[0, last], out[1, last] = sense * value, sense * slope
    if last > q.size:
        limits(chain, q, w, base, out)


@non_allocating
def begin_event(chain, drive, part, terms, progress, step, workspace, decided, widen):  # type: ignore[no-untyped-def]
    """Begin the search within a step with the margins at its start; arguments as for :func:`find_event`.

    `widen`: factor on the tolerance of the dry friction.
    """
    y, slip, search, tools = progress.y, progress.slip, workspace.search, workspace.stiction
    n, t = slip.size, progress.clock[T]
    for i in range(n):
        workspace.locked[i] = 1.0 - slip[i] * slip[i]
    if not decided:
        torque = base_state(drive, part, t, workspace.before)
        constraint_torques(chain, y[:n], y[n : 2 * n], slip, workspace.before[:7], torque, tools)
    margins_of(chain, y[n : 2 * n], slip, workspace.before, widen, tools, search.low)
    assign(workspace.alpha, tools.alpha)
    workspace.power[0] = stuck_power(chain, y[n : 2 * n], slip, tools.load)
    begin_search(search)
    if sticks_often(chain) and terms.fixed == 0.0 and progress.log.shape[0] == 0:  # derivatives ask for the very event
        allow_lateness(search, workspace.locked, chain, terms.tol, step)


@non_allocating
def find_event(chain, drive, part, table, terms, progress, step, workspace, decided):  # type: ignore[no-untyped-def]
    """Shorten the step to ``workspace.out`` until it holds no event, or ends at its first one; `terms` are the Limits.

    `decided`: modes were decided where it begins, and the constraint torques there are known.

    Returns
    -------
    step : float, s
    event : int, 0: none; 1: a joint changes its mode; 2: what ends the run has happened; 3: a joint is at its limit
    joint : int, the one that changes its mode, -1 where none does
    """
    until = terms.until
    y, slip, clock, search, tools = progress.y, progress.slip, progress.clock, workspace.search, workspace.stiction
    n, last = slip.size, workspace.locked.size - 1
    limited = last > n
    t, widen, stuck, sticks = clock[T], tolerance_factor(clock[CHATTER], n), not slip.all(), can_stick(chain)
    begin_event(chain, drive, part, terms, progress, step, workspace, decided, widen)
    sense = 0.0
    workspace.locked[last] = 1.0 if until.kind == PEAK else 0.0
    if until.kind != NOTHING:
        value, slope = event_value(until, chain, y[:n], y[n : 2 * n], workspace.alpha, workspace.before)
        sense = watched_sense(until, value, slope, t)
        if until.kind == PEAK and sense == 0.0 and clock[PENDING] > 0.0:
            return 0.0, 2, -1  # the speed grew until here, and falls from here on
        search.low[:, last] = np.inf
        search.here[:, last] = np.inf
    end_margins(chain, until, sense, y[:n], y[n : 2 * n], workspace.alpha, workspace.before, last, search.low)
    while True:
        out = workspace.out
        torque = base_state(drive, part, min(t + step, part.end), workspace.after)
        project_stuck(chain, slip, y, workspace.before, out, workspace.after)
        margins(chain, out[:n], out[n : 2 * n], slip, workspace.after[:7], torque, widen, tools, search.here)
        workspace.power[2] = stuck_power(chain, out[n : 2 * n], slip, tools.load)
        end_margins(chain, until, sense, out[:n], out[n : 2 * n], tools.alpha, workspace.after, last, search.here)
        first = search.span[TRIES] == 0.0 and (sticks or limited or (sense != 0.0 and until.kind == PEAK))
        if first or (stuck and len(chain.reaction) == len(ONE_SIDED)):
            midpoint_state(step, y[:n], y[n : 2 * n], workspace.alpha, out, tools)
            torque = base_state(drive, part, t + 0.5 * step, workspace.between)
            bend = tools.state
            margins(chain, bend[:n], bend[n:], slip, workspace.between[:7], torque, widen, tools, tools.margin)
            assign_rows(search.middle[:, :n], tools.margin)
            workspace.power[1] = stuck_power(chain, bend[n:], slip, tools.load)
            if sense != 0.0 and until.kind == PEAK:
                value, slope = event_value(until, chain, bend[:n], bend[n:], tools.alpha, workspace.between)
                search.middle[0, last] = sense * value
            if limited:
                limits(chain, bend[:n], bend[n:], workspace.between, search.middle)
        verdict, length = assess_step(workspace.locked, search, step)
        if verdict == EVENT:
            stop_joints(chain, slip, search.here, out, workspace.after)
        if verdict != AGAIN:
            clock[PENDING] = search.here[0, last] if sense != 0.0 else 0.0
            joint = first_past(workspace.locked, search.here) if verdict == EVENT else -1
            if verdict == EVENT and joint >= n and joint < last:
                return step, 3, joint
            if verdict == EVENT and is_past(workspace.locked, search.here, last):
                good = on_right_side(until, chain, out[:n], out[n : 2 * n], workspace.after)
                clock[PENDING] = 0.0
                return step, 2 if good else 1, joint
            return step, 1 if verdict == EVENT else 0, joint
        step = length
        clock[TAKEN] += 1
        clock[REJECTED] += 1
        advance(chain, drive, part, table, terms.fixed, t, step, y, slip, out, workspace.kept[:0], workspace)
