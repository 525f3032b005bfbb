"""Root search for the first event of a step.

Every event is a margin that falls from above zero to zero: of each joint that may stick
(``constraint_torques.margins``), of each joint to its limits where a chain has some (``end_conditions.limits``), and in
the last column of what is to end the run. A margin comes with its slope where that is known.
"""

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core.assign import assign_rows
from hyperflex.core.chain.articulated_body import Array
from hyperflex.core.integrate.step_size import allowed, lasting
from hyperflex.core.jit import kernel, non_allocating
from hyperflex.core.stiction.constraint_torques import INSTANT, QUICK, STILL

DONE, EVENT, AGAIN = range(3)
LOW, HIGH, TRIES, SIDE = range(4)  # of Search.span: s, s, attempts so far, end of the span that moved last
LOOKS = 16  # at a margin's course within a step
GLANCES = 3  # attempts that are searched for hidden events; later ones only if they end at an event
SOON = 0.125  # part of a span: where a margin grows at first, a cubic's zero before this is but a joint that came loose
STOPPED = 1e-3  # of the velocity that a step may err by is what a joint may turn at, the other way, when it is stopped
LATE, LATEST = 2e3, 0.01  # part of dry friction by which a joint's load exceeds it, where it is let go, for tol / reach
MAX_ATTEMPTS = 40  # attempts after which the span is halved, whatever the margins say; twice that ends the search


class Search(NamedTuple):
    """Margins and their slopes (2, m) at several lengths of the same step; inf where there is nothing to watch."""

    span: Array  # (4,) the first event lies between LOW and HIGH
    low: Array  # at LOW, where there is no event; at first the beginning of the step
    high: Array  # at HIGH, where there is one, if HIGH is finite
    here: Array  # of the present attempt
    middle: Array  # in the middle of the present attempt, inf where not known
    late: Array  # (m,) by how much a margin may be passed where a step ends


@kernel
def new_search(m):  # type: ignore[no-untyped-def]
    """A search over m margins."""
    four = np.full((4, 2, m), np.inf)
    return Search(np.array([0.0, np.inf, 0.0, 0.0]), four[0], four[1], four[2], four[3], np.zeros(m))


@non_allocating
def begin_search(search):  # type: ignore[no-untyped-def]
    """Forget earlier attempts; ``low`` holds the margins at the beginning of the step."""
    span = search.span
    span[LOW], span[HIGH], span[TRIES], span[SIDE] = 0.0, np.inf, 0.0, 0.0
    search.middle[:] = np.inf


@non_allocating
def allow_lateness(search, locked, chain, tol, step):  # type: ignore[no-untyped-def]
    """Say how much later than at its event a step of the length `step`, s, may end, by its error `tol`, m."""
    longest = reach = 0.0
    for i in range(chain.length.size):
        longest, reach = max(longest, chain.length[i]), reach + chain.length[i]
    rate = STOPPED * allowed(tol, step, 0.0) / (lasting(step) * longest)
    part = min(LATEST, LATE * tol / reach)
    for i in range(chain.length.size):
        search.late[i] = rate if locked[i] == 0.0 else part


@non_allocating
def margin_polynomial(low, high, i, length, x):  # type: ignore[no-untyped-def]
    """Margin i at the part x in (0, 1] of an interval, s, divided by x: the cubic through both ends' (value, slope)."""
    v0, s0, v1, s1 = low[0, i], low[1, i] * length, high[0, i], high[1, i] * length
    return (v0 / x + s0) + x * (3.0 * (v1 - v0) - 2.0 * s0 - s1 + x * (2.0 * (v0 - v1) + s0 + s1))


@non_allocating
def first_zero(low, high, i, length, most):  # type: ignore[no-untyped-def]
    """First part of an interval, but for its beginning, at which margin i is zero or less; `most` if that is before."""
    before, at = 0.0, most
    for k in range(1, LOOKS + 1):
        x = min(k / LOOKS, most)
        if margin_polynomial(low, high, i, length, x) <= 0.0:
            at = x
            break
        before = x
        if x == most:
            return most
    for _ in range(52):
        x = 0.5 * (before + at)
        if margin_polynomial(low, high, i, length, x) > 0.0:
            before = x
        else:
            at = x
    return at


@non_allocating
def stays_positive(search, i, length):  # type: ignore[no-untyped-def]
    """Whether the cubics through margin i, with a middle, stay positive: no Bernstein coefficient of theirs is not."""
    v0, s0, v1, s1 = search.low[0, i], search.low[1, i], search.here[0, i], search.here[1, i]
    vm, sm, third = search.middle[0, i], search.middle[1, i], length / 6.0
    return min(v0, v0 + third * s0, vm - third * sm, vm, vm + third * sm, v1 - third * s1) >= 0.0


@non_allocating
def hidden_event(locked, search, length):  # type: ignore[no-untyped-def]
    """Part of the length, s, from LOW to the end of an attempt at which an event may hide; else 1.0.

    Margins with slopes by the cubics through both ends and the middle, those of stuck joints by the parabola. Those
    that tell of an event at the end do not count.
    """
    part = 1.0
    for i in range(locked.size):
        v0, v1, vm = search.low[0, i], search.here[0, i], search.middle[0, i]
        if v0 == np.inf or v1 == np.inf or is_past(locked, search.here, i):
            continue
        if locked[i] == 0.0 and not (vm < np.inf and stays_positive(search, i, length)):
            for k in range(1, LOOKS):
                x = k / LOOKS
                if vm == np.inf:
                    value = margin_polynomial(search.low, search.here, i, length, x)
                elif x <= 0.5:
                    value = margin_polynomial(search.low, search.middle, i, 0.5 * length, 2.0 * x)
                else:
                    value = margin_polynomial(search.middle, search.here, i, 0.5 * length, 2.0 * x - 1.0)
                if value < 0.0:
                    part = min(part, x)
        elif locked[i] == 1.0 and vm < 0.0:
            part = min(part, 0.5)
        elif locked[i] == 1.0 and vm < np.inf:
            bend, slope = 2.0 * (v0 - 2.0 * vm + v1), 4.0 * vm - 3.0 * v0 - v1
            x = -0.5 * slope / bend if bend > 0.0 else 0.0
            if 0.03 < x < 0.97 and v0 + x * (slope + x * bend) < 0.0:
                part = min(part, x)
    return part


@non_allocating
def is_past(locked, margin, i):  # type: ignore[no-untyped-def]
    """Whether margin i says that its event has happened; one that hardly differs from zero must not be growing."""
    if locked[i] == 0.0 and i < locked.size - 1 and margin[1, i] > 0.0:
        return margin[0, i] < -STILL
    return margin[0, i] < 0.0 or (margin[0, i] == 0.0 and locked[i] == 0.0)


@non_allocating
def fall(locked, search, i, step):  # type: ignore[no-untyped-def]
    """How fast margin i falls at the end of an attempt of the length `step`, s: by its slope, else by the secant."""
    if locked[i] == 0.0:
        return -search.here[1, i]
    return (search.low[0, i] - search.here[0, i]) / (step - search.span[LOW])


@non_allocating
def first_past(locked, margin):  # type: ignore[no-untyped-def]
    """Return the first margin that says that its event has happened, -1: none."""
    for i in range(locked.size):
        if is_past(locked, margin, i):
            return i
    return -1


@non_allocating
def assess_step(locked, search, step):  # type: ignore[no-untyped-def]
    """Judge an attempt of the length `step`, s, whose margins are in ``search.here``.

    Parameters
    ----------
    locked : (m,) 1.0 where a margin comes without slope (stuck joints), else 0.0

    Returns
    -------
    verdict : DONE (take the step; it holds no event), EVENT (take it; it ends at one) or AGAIN
    length : of the next attempt, s

    Notes
    -----
    A step of QUICK or less hides nothing: its course would be rounding. The span shrinks by the cubics' zeros, for
    stuck joints by the rule of Anderson and Bjorck (1973), in the end by halving. A step that ends at an event ends on
    its far side, within INSTANT: attempts aim at the middle of that.
    """
    span = search.span
    span[TRIES] += 1.0
    if span[LOW] > 0.0:
        search.middle[:] = np.inf  # it is that of a whole attempt, and the search has come further than its beginning
    over = False
    near = True
    for i in range(locked.size):
        if is_past(locked, search.here, i):
            over = True
            past = max(INSTANT * fall(locked, search, i, step), search.late[i])
            near = near and search.here[0, i] >= -past
    clear = not over and span[HIGH] == np.inf
    ends = clear or (over and (near or step - span[LOW] <= INSTANT or span[TRIES] > 2 * MAX_ATTEMPTS))
    at = step
    if step > QUICK and (span[TRIES] <= GLANCES or (ends and over and span[TRIES] <= MAX_ATTEMPTS)):
        at = span[LOW] + hidden_event(locked, search, step - span[LOW]) * (step - span[LOW])
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
        for i in range(locked.size):
            if locked[i] == 1.0:
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
        at = estimate_event_time(locked, search)
    search.middle[:] = np.inf
    return AGAIN, at


@non_allocating
def first_part(locked, search, i, length, most):  # type: ignore[no-untyped-def]
    """Part of the span, of the given length, s, at which margin i should be passed by half of what is allowed.

    At most `most`. Where the middle is known, by the cubics on both sides of it, for stuck joints by the parabola.
    """
    aim = 0.5 * search.late[i]
    low, middle, high = search.low, search.middle, search.high
    if locked[i] == 1.0:
        v0, vm, v1 = max(low[0, i], 0.0) + aim, middle[0, i] + aim, high[0, i] + aim
        if not (vm < np.inf):
            return min(most, v0 / (v0 - v1)) if v1 < 0.0 else most
        bend, slope = 2.0 * (v0 - 2.0 * vm + v1), 4.0 * vm - 3.0 * v0 - v1
        root = math.sqrt(max(slope * slope - 4.0 * bend * v0, 0.0))
        return min(most, 2.0 * v0 / (root - slope)) if root > slope else most
    if not (middle[0, i] < np.inf):
        x = first_zero(low, high, i, length, most)
    else:
        x = 0.5 * first_zero(low, middle, i, 0.5 * length, min(2.0 * most, 1.0))
        if x == 0.5 and most > 0.5:
            x += 0.5 * first_zero(middle, high, i, 0.5 * length, 2.0 * most - 1.0)
    if low[1, i] > 0.0:
        x = max(x, SOON)
    return min(most, x + aim / (-high[1, i] * length)) if high[1, i] < 0.0 else x


@non_allocating
def estimate_event_time(locked, search):  # type: ignore[no-untyped-def]
    """Where in the span the first event should lie, s."""
    span = search.span
    length = span[HIGH] - span[LOW]
    if length <= INSTANT:
        return span[HIGH]
    at = 1.0
    for i in range(locked.size):
        if is_past(locked, search.high, i):
            at = first_part(locked, search, i, length, at)
    if span[TRIES] > MAX_ATTEMPTS:
        at = 0.5
    return min(max(span[LOW] + at * length + 0.45 * INSTANT, span[LOW] + 0.9 * INSTANT), span[HIGH] - 0.9 * INSTANT)
