"""Events within a step: what ends a run, margins of joint limits, and the root search for the first event.

Every event is a margin that falls from above zero to zero: of each joint that may stick (``stiction.margins``), of each
joint to its limits where a chain has limits (``limits``), and in the last column of the event that ends the run. A
margin comes with its slope where that is known.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain.articulated_body import ONE_SIDED, Array, can_stick, sincos, sticks_often
from hyperflex.core.chain.drive import base_state
from hyperflex.core.integrate.step_size import allowed, lasting
from hyperflex.core.jit import inlined, kernel, non_allocating, zeros
from hyperflex.core.stiction import (
    STICTION,
    constraint_torques,
    margins,
    margins_of,
    midpoint_state,
    project_stuck,
    stop_joints,
    stuck_power,
)

# Whether a run checks for events: tuples, whose length the compiler knows, so that it omits the event search
UNWATCHED, WATCHED = (), (0,)
NOTHING, CROSSES, PEAK, PHASE, ANGLE = range(5)


class Until(NamedTuple):
    """The event that ends a run; the meaning of the numbers a to d depends on the kind.

    CROSSES: a, b point, m; c, d unit vector. PEAK: none. PHASE: a phase, rad; b time constant, s.
    ANGLE: a angle, rad; b number of the link in the chain, or -1.0 for a prescribed arm.
    """

    kind: int
    a: float
    b: float
    c: float
    d: float
    sense: float  # 1.0 or -1.0: the reading must rise or fall through zero; 0.0: either
    after: float  # s, absolute; earlier events are ignored


NEVER = Until(NOTHING, 0.0, 0.0, 0.0, 0.0, 0.0, -math.inf)


@non_allocating
def tip_motion(chain, q, w, alpha, base):  # type: ignore[no-untyped-def]
    """Position, m, velocity, m/s, and acceleration, m/s^2, of the tip: (x, y, vx, vy, ax, ay)."""
    x, y, vx, vy, ax, ay = base[7], base[8], base[5], base[6], base[0], base[1]
    for i in range(q.size):
        sin, cos = sincos(q[i])
        length, rate2 = chain.length[i], w[i] * w[i]
        x += length * sin
        y -= length * cos
        vx += length * cos * w[i]
        vy += length * sin * w[i]
        ax += length * (cos * alpha[i] - sin * rate2)
        ay += length * (sin * alpha[i] + cos * rate2)
    return x, y, vx, vy, ax, ay


@non_allocating
def event_value(until, chain, q, w, alpha, base):  # type: ignore[no-untyped-def]
    """Reading of a state and its slope (0.0 for PEAK, where it is unknown).

    CROSSES: distance beyond the line, m. PEAK: minus half the growth rate of the squared tip speed, m^2/s^3. PHASE:
    distance of (c dx/dt, x) from the ray of the phase, on the side of later phases, m. ANGLE: angle beyond, rad.
    """
    if until.kind == ANGLE:
        link = int(until.b)
        return (base[4] - until.a, base[3]) if link < 0 else (q[link] - until.a, w[link])
    x, y, vx, vy, ax, ay = tip_motion(chain, q, w, alpha, base)
    if until.kind == CROSSES:
        return (x - until.a) * until.c + (y - until.b) * until.d, vx * until.c + vy * until.d
    if until.kind == PEAK:
        return -(vx * ax + vy * ay), 0.0
    sin, cos = math.sin(until.a), math.cos(until.a)
    return x * cos - until.b * vx * sin, vx * cos - until.b * ax * sin


@non_allocating
def limit_gap(chain, i, angle, rate):  # type: ignore[no-untyped-def]
    """Gap of joint i, at a relative angle and rate, to the nearer of its limits, rad, and its growth rate."""
    bend = angle - chain.rest[i]
    return chain.max_bend[i] - abs(bend), -rate if bend > 0.0 else rate


@non_allocating
def limits(chain, q, w, base, out):  # type: ignore[no-untyped-def]
    """Write the gaps of all joints to their limits, rad, and their growth rates to ``out[:, n : 2 * n]``."""
    n = q.size
    up, up_rate = base[4], base[3]
    for i in range(n):
        out[0, n + i], out[1, n + i] = limit_gap(chain, i, q[i] - up, w[i] - up_rate)
        up, up_rate = q[i], w[i]


@non_allocating
def watched_sense(until, value, slope, t):  # type: ignore[no-untyped-def]
    """Sense in which a reading is checked from the beginning of a step: margin = sense * reading; 0.0: not checked."""
    if until.kind == NOTHING or t < until.after:
        return 0.0
    if until.sense != 0.0:
        return -until.sense if -until.sense * value > 0.0 else 0.0
    if value != 0.0:
        return 1.0 if value > 0.0 else -1.0
    return 1.0 if slope > 0.0 else -1.0


@kernel
def on_right_side(until, chain, q, w, base):  # type: ignore[no-untyped-def]
    """False where a phase is passed on the opposite ray, half a turn away."""
    if until.kind != PHASE:
        return True
    x, _, vx, _, _, _ = tip_motion(chain, q, w, np.zeros(q.size), base)
    return x * math.sin(until.a) + until.b * vx * math.cos(until.a) > 0.0


class EventSearch(NamedTuple):
    """Constants of the search for the first event of a step."""

    # of a step at which a margin is evaluated
    points: int = 16
    # attempts that are checked for hidden events; later ones only if they end at an event
    glances: int = 3
    # of the allowed velocity error: largest reversed rate of a joint when it is stopped
    stopped: float = 1e-3
    # fraction of dry friction by which the load of a joint may exceed it at its release, at most, and
    latest: float = 0.01
    # this fraction for each unit of tol / reach
    late: float = 2e3
    # attempts after which the span is halved for any margins; twice as many end the search
    attempts: int = 40


EVENTS: Final = EventSearch()

DONE, EVENT, AGAIN = range(3)
LOW, HIGH, TRIES, SIDE = range(4)  # of Search.span: s, s, attempts so far, end of the span that moved last


class Search(NamedTuple):
    """Search for the first event of a step, for its margins (m,) and joints (n,), over all its attempts.

    Margins come with their slopes (2, m), at several lengths of the step; inf without an event.
    """

    span: Array  # (4,) the first event lies between LOW and HIGH
    low: Array  # at LOW, without an event; initially the beginning of the step
    high: Array  # at HIGH, with an event, if HIGH is finite
    here: Array  # of the present attempt
    middle: Array  # in the middle of the present attempt, inf if unknown
    late: Array  # (m,) allowed overshoot of a margin at the end of a step
    locked: Array  # (m,) 1.0 for a margin without slope (stuck joints), else 0.0
    alpha: Array  # (n,) accelerations at the beginning of the step
    power: Array  # (3,) of stuck joints, see stiction.stuck_loss
    before: Array  # (9 or more,) motion of the first joint at the beginning of the step, in the middle and at the end
    between: Array
    after: Array


@kernel
def new_searches(count, m, n, base):  # type: ignore[no-untyped-def]
    """Searches over m margins of chains of n links: a Search whose arrays have `count` rows, see :func:`search_of`.

    `base` is the size of the motion of the first joint (``drive.base_size``).
    """
    margins = np.full((4, count, 2, m), np.inf)
    others = zeros((count, m), (count, m), (count, n), (count, 3), (count, base), (count, base), (count, base))
    return Search(np.zeros((count, 4)), margins[0], margins[1], margins[2], margins[3], *others)


@inlined
def search_of(every, j):  # type: ignore[no-untyped-def]
    """Return the search in row j of the arrays of :func:`new_searches`."""
    margins = every.low[j], every.high[j], every.here[j], every.middle[j], every.late[j], every.locked[j]
    return Search(
        every.span[j], *margins, every.alpha[j], every.power[j], every.before[j], every.between[j], every.after[j]
    )


@non_allocating
def begin_search(chain, drive, part, t, tol, step, y, slip, widen, decided, search, tools):  # type: ignore[no-untyped-def]
    """Begin the search within a step from state y at time t, with the margins of the joints there.

    Parameters
    ----------
    tol, step : error allowed, m, of a step of this length, s; 0.0: the step must end exactly at the event
    slip, widen : modes (n,), factor on the tolerance of the dry friction
    decided : modes were determined here, and the StictionWorkspace `tools` contains the constraint torques
    """
    n, span = slip.size, search.span
    torque = base_state(drive, part, t, search.before)
    if not decided:
        constraint_torques(chain, y[:n], y[n : 2 * n], slip, search.before, torque, tools)
    margins_of(chain, y[n : 2 * n], slip, search.before, widen, tools, search.low)
    assign(search.alpha, tools.alpha)
    search.power[0] = stuck_power(chain, y[n : 2 * n], slip, tools.load)
    span[LOW], span[HIGH], span[TRIES], span[SIDE] = 0.0, np.inf, 0.0, 0.0
    search.middle[:] = np.inf
    search.late[:] = 0.0
    for i in range(n):
        search.locked[i] = 1.0 - slip[i] * slip[i]
    if tol > 0.0 and sticks_often(chain):
        allow_lateness(search, chain, tol, step)


@non_allocating
def end_margins(chain, until, sense, q, w, alpha, base, out):  # type: ignore[no-untyped-def]
    """Write the margins of joint limits and, in the last column, of the end of the run to ``out`` (2, m)."""
    last = out.shape[1] - 1
    if sense != 0.0:
        value, slope = event_value(until, chain, q, w, alpha, base)
        out[0, last], out[1, last] = sense * value, sense * slope
    if last > q.size:
        limits(chain, q, w, base, out)


@non_allocating
def assess_attempt(chain, drive, part, until, sense, t, step, y, slip, widen, search, tools, out):  # type: ignore[no-untyped-def]
    """Assess an attempt to step from y to ``out`` (2 n + 2,), like :func:`assess_step`; holds stuck joints there.

    Parameters as for :func:`begin_search`; `until`, `sense`: the event that ends the run, and its
    :func:`watched_sense`.
    """
    n, limited = slip.size, search.late.size > slip.size + 1
    torque = base_state(drive, part, min(t + step, part.end), search.after)
    project_stuck(chain, slip, y, search.before, out, search.after)
    margins(chain, out[:n], out[n : 2 * n], slip, search.after, torque, widen, tools, search.here)
    search.power[2] = stuck_power(chain, out[n : 2 * n], slip, tools.load)
    end_margins(chain, until, sense, out[:n], out[n : 2 * n], tools.alpha, search.after, search.here)
    peaks = sense != 0.0 and until.kind == PEAK
    first = search.span[TRIES] == 0.0 and (can_stick(chain) or limited or peaks)
    if first or (len(chain.reaction) == len(ONE_SIDED) and not slip.all()):
        midpoint_state(step, y[:n], y[n : 2 * n], search.alpha, out, tools)
        torque = base_state(drive, part, t + 0.5 * step, search.between)
        q, w = tools.state[:n], tools.state[n:]
        margins(chain, q, w, slip, search.between, torque, widen, tools, search.middle)
        search.power[1] = stuck_power(chain, w, slip, tools.load)
        if peaks or limited:
            end_margins(chain, until, sense if peaks else 0.0, q, w, tools.alpha, search.between, search.middle)
    verdict, length = assess_step(search, step)
    if verdict == EVENT:
        stop_joints(chain, slip, search.here, out, search.after)
    return verdict, length


@non_allocating
def allow_lateness(search, chain, tol, step):  # type: ignore[no-untyped-def]
    """Set by how much a step of length `step`, s, may overshoot its event for an error `tol`, m."""
    longest = reach = 0.0
    for i in range(chain.length.size):
        longest, reach = max(longest, chain.length[i]), reach + chain.length[i]
    rate = EVENTS.stopped * allowed(tol, step, 0.0) / (lasting(step) * longest)
    part = min(EVENTS.latest, EVENTS.late * tol / reach)
    for i in range(chain.length.size):
        search.late[i] = rate if search.locked[i] == 0.0 else part


@non_allocating
def margin_polynomial(low, high, i, length, aim, x):  # type: ignore[no-untyped-def]
    """Margin i plus `aim` at the part x in (0, 1] of an interval, s, divided by x: a cubic by both (value, slope)."""
    v0, s0, v1, s1 = low[0, i], low[1, i] * length, high[0, i], high[1, i] * length
    return ((v0 + aim) / x + s0) + x * (3.0 * (v1 - v0) - 2.0 * s0 - s1 + x * (2.0 * (v0 - v1) + s0 + s1))


@non_allocating
def margin_within(search, high, i, length, aim, x):  # type: ignore[no-untyped-def]
    """Number with the sign of margin i plus `aim` at the part x in (0, 1] of the length, s, from LOW to `high`.

    Margins with slopes follow cubics through both ends and, where it is known, the middle; those of stuck joints the
    parabola, or the straight line.
    """
    low, middle = search.low, search.middle
    if search.locked[i] == 1.0:
        v0, vm, v1 = low[0, i], middle[0, i], high[0, i]
        bend = 2.0 * (v0 - 2.0 * vm + v1) if vm < np.inf else 0.0
        return (v0 + aim) / x + (v1 - v0) - bend * (1.0 - x)
    if middle[0, i] == np.inf:
        return margin_polynomial(low, high, i, length, aim, x)
    if x <= 0.5:
        return margin_polynomial(low, middle, i, 0.5 * length, aim, 2.0 * x)
    return margin_polynomial(middle, high, i, 0.5 * length, aim, 2.0 * x - 1.0)


@non_allocating
def first_negative(search, high, i, length, aim, most):  # type: ignore[no-untyped-def]
    """First of ``EVENTS.points`` parts of the length, s, at which margin i plus `aim` is negative; else `most`."""
    for k in range(1, EVENTS.points):
        x = k / EVENTS.points
        if x >= most or margin_within(search, high, i, length, aim, x) < 0.0:
            return min(x, most)
    return most


@non_allocating
def stays_positive(search, i, length):  # type: ignore[no-untyped-def]
    """Whether the cubics through margin i, with a middle, stay positive: their Bernstein coefficients are."""
    v0, s0, v1, s1 = search.low[0, i], search.low[1, i], search.here[0, i], search.here[1, i]
    vm, sm, third = search.middle[0, i], search.middle[1, i], length / 6.0
    return min(v0, v0 + third * s0, vm - third * sm, vm, vm + third * sm, v1 - third * s1) >= 0.0


@non_allocating
def hidden_event(search, length):  # type: ignore[no-untyped-def]
    """Fraction of the length, s, from LOW to the end of an attempt at which an event may be hidden; else 1.0.

    Margins with an event at the end do not count.
    """
    part = 1.0
    for i in range(search.locked.size):
        v0, vm, v1 = search.low[0, i], search.middle[0, i], search.here[0, i]
        if v0 == np.inf or v1 == np.inf or is_past(search, search.here, i):
            continue
        if search.locked[i] == 0.0 and not (vm < np.inf and stays_positive(search, i, length)):
            part = first_negative(search, search.here, i, length, 0.0, part)
        elif search.locked[i] == 1.0 and vm < np.inf:
            bend = v0 - 2.0 * vm + v1
            x = 0.25 * (3.0 * v0 - 4.0 * vm + v1) / bend if bend > 0.0 else 0.0  # the parabola's lowest point
            if 0.03 < x < part and margin_within(search, search.here, i, length, 0.0, x) < 0.0:
                part = x
    return part


@non_allocating
def is_past(search, margin, i):  # type: ignore[no-untyped-def]
    """Whether the event of margin i has occurred; a margin that is zero up to rounding must not be growing."""
    if search.locked[i] == 0.0 and i < search.locked.size - 1 and margin[1, i] > 0.0:
        return margin[0, i] < -STICTION.still
    return margin[0, i] < 0.0 or (margin[0, i] == 0.0 and search.locked[i] == 0.0)


@non_allocating
def fall(search, i, step):  # type: ignore[no-untyped-def]
    """Rate at which margin i falls at the end of an attempt of length `step`, s: by its slope, else the secant."""
    if search.locked[i] == 0.0:
        return -search.here[1, i]
    return (search.low[0, i] - search.here[0, i]) / (step - search.span[LOW])


@non_allocating
def first_past(search, margin):  # type: ignore[no-untyped-def]
    """Return the first margin whose event has occurred, -1: none."""
    for i in range(search.locked.size):
        if is_past(search, margin, i):
            return i
    return -1


@non_allocating
def assess_step(search, step):  # type: ignore[no-untyped-def]
    """Assess an attempt of length `step`, s, whose margins are in ``search.here``.

    Returns
    -------
    verdict : DONE (accept the step, which contains no event), EVENT (accept it; it ends at one) or AGAIN
    length : of the next attempt, s

    Notes
    -----
    A step of ``STICTION.quick`` or less cannot hide an event: its interior would be rounding. The span shrinks by the
    cubics' zeros, for stuck joints by the rule of Anderson and Bjorck (1973), and finally by halving. A step that ends
    at an event ends after it, within ``STICTION.instant``: attempts aim at the middle of this interval.
    """
    span = search.span
    span[TRIES] += 1.0
    if span[LOW] > 0.0:
        search.middle[:] = np.inf  # it belongs to a complete attempt, and the search has passed its beginning
    over = False
    near = True
    for i in range(search.locked.size):
        if is_past(search, search.here, i):
            over = True
            past = max(STICTION.instant * fall(search, i, step), search.late[i])
            near = near and search.here[0, i] >= -past
    clear = not over and span[HIGH] == np.inf
    ends = clear or (over and (near or step - span[LOW] <= STICTION.instant or span[TRIES] > 2 * EVENTS.attempts))
    at = step
    if step > STICTION.quick and (span[TRIES] <= EVENTS.glances or (ends and over and span[TRIES] <= EVENTS.attempts)):
        at = span[LOW] + hidden_event(search, step - span[LOW]) * (step - span[LOW])
    if ends and at >= step:
        return EVENT if over else DONE, step
    if clear or not over:
        search.middle[:] = np.inf
    if clear:
        return AGAIN, at
    side = 1.0 if over else -1.0
    kept = search.low if over else search.high
    if side == span[SIDE]:
        replaced = search.high if over else search.low
        for i in range(search.locked.size):
            if search.locked[i] == 1.0:
                left = 1.0 - search.here[0, i] / replaced[0, i] if abs(replaced[0, i]) > 0.0 else 0.5
                kept[0, i] *= left if left > 0.0 else 0.5
    span[SIDE] = side
    if over:
        span[HIGH] = step
        assign_rows(search.high, search.here)
    else:
        span[LOW] = step
        assign_rows(search.low, search.here)
    if at >= step:
        at = estimate_event_time(search)
    search.middle[:] = np.inf
    return AGAIN, at


@non_allocating
def first_part(search, i, length, most):  # type: ignore[no-untyped-def]
    """Fraction of the span, of the given length, s, at which margin i should overshoot by half the allowed amount.

    At most `most`.
    """
    aim = 0.5 * search.late[i]
    at = first_negative(search, search.high, i, length, aim, most)
    if margin_within(search, search.high, i, length, aim, at) < 0.0:
        before = max(0.0, at - 1.0 / EVENTS.points)
        for _ in range(38):  # to 2e-13 of the span
            x = 0.5 * (before + at)
            if margin_within(search, search.high, i, length, aim, x) < 0.0:
                at = x
            else:
                before = x
    return at


@non_allocating
def estimate_event_time(search):  # type: ignore[no-untyped-def]
    """Expected position of the first event in the span, s."""
    span = search.span
    length = span[HIGH] - span[LOW]
    if length <= STICTION.instant:
        return span[HIGH]
    at = 1.0
    for i in range(search.locked.size):
        if is_past(search, search.high, i):
            at = first_part(search, i, length, at)
    if span[TRIES] > EVENTS.attempts:
        at = 0.5
    instant = STICTION.instant
    return min(max(span[LOW] + at * length + 0.45 * instant, span[LOW] + 0.9 * instant), span[HIGH] - 0.9 * instant)
