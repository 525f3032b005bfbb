"""Step-size control: from the error, its trend, and the time that is left."""

import math
from typing import Final

from hyperflex.core.jit import non_allocating

FIRST_STEP: Final = 0.01  # s, tried first; error control does the rest
LARGEST_STEP: Final = 0.25  # s
WATCHED: Final = 0.01  # s, longest step while something may end the run; what comes and goes within one may be missed
SMALLEST_STEP: Final = 1e-10  # s
SHARE: Final = 0.02  # s; shorter steps may err only in proportion, or a thousand of them would add up unseen
CHEAPER: Final = 0.9  # another order is taken where it is to cost less than this part of the work
SAFETY: Final = 0.8  # 0.9 saves no time: it trades steps for rejected ones
OFTEN: Final = 2.2  # as many times as long as what an event left of the last step the next is tried
MOST: Final = 3.0  # a step is at most so many times as long as the last one
LEAST: Final = 0.2
TINY: Final = 1e-12


@non_allocating
def fitted(wanted, left):  # type: ignore[no-untyped-def]
    """Length of a step, s, where `wanted` is good and `left` is left: all of it, half of it, or what is wanted.

    Two equal steps to an end are better than a good one and a stub.
    """
    if wanted * (1.0 + 1e-9) >= left:
        return left
    return 0.5 * left if wanted > 0.5 * left else wanted


@non_allocating
def longer(step, size, last, last_size, order):  # type: ignore[no-untyped-def]
    """Length of the step after one that met the tolerance.

    Parameters
    ----------
    step, size : float
        Its length, s, and its error in units of what is allowed.
    last, last_size : float
        Of the step before; `last` is 0.0 where there is none of the same kind.
    order : int
        The error of a step of length h is proportional to h^order.

    Notes
    -----
    If errors grow from step to step by a factor, they are expected to go on doing so (predictive control, Gustafsson
    1994, doi:10.1145/198429.198437).
    """
    factor = SAFETY * max(size, TINY) ** (-1.0 / order)
    if last > 0.0:
        trend = (step / last) * (max(last_size, TINY) / max(size, TINY)) ** (1.0 / order)
        factor *= min(1.0, trend)
    return step * min(MOST, max(LEAST, factor))


@non_allocating
def cheapest(tables, least, most, order, step, lower_size, grown, longest):  # type: ignore[no-untyped-def]
    """Order of the next step, and its length, s: the order whose rounds for each second are fewest.

    Parameters
    ----------
    tables : tuple of Scheme, of successive orders
    least, most : int
        Orders allowed.
    order, step : int, float
        Of the last step, and its length, s.
    lower_size : float
        The error that it would have made at an order less, in units of what is allowed.
    grown : float
        Good length of the next step at the same order, s.

    Notes
    -----
    What an order more would have given is not known; it is tried where this order beats the one below by as much
    (Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.9).
    """
    here = order - tables[0].order
    rounds = tables[here].column.shape[0]
    rounds_below = tables[here - 1].column.shape[0]
    lower = longer(step, lower_size, 0.0, 0.0, order - 1)
    work, work_below = rounds / min(grown, longest), rounds_below / min(lower, longest)
    if order > least and work_below < CHEAPER * work:
        return order - 1, lower
    if order < most and work < CHEAPER * work_below:
        return order + 1, grown * tables[here + 1].column.shape[0] / rounds
    return order, grown


@non_allocating
def shorter(step, size, order):  # type: ignore[no-untyped-def]
    """Length of the next attempt after a step whose error was too large (`size` > 1, or not finite)."""
    return step * (max(LEAST, SAFETY * size ** (-1.0 / order)) if size < float("inf") else LEAST)


@non_allocating
def until_next_event(step, taken):  # type: ignore[no-untyped-def]
    """Longest step, s, to try after one of the length `step` that an event ended after `taken`, s."""
    return step * max(0.5, math.sqrt(OFTEN * taken / step))


@non_allocating
def allowed(tol, step, rounding):  # type: ignore[no-untyped-def]
    """Error that a step may make, m: `tol`, and its share of that where it is short, but not less than rounding.

    Where stiff friction settles, steps of nanoseconds are tried. Their share is beyond the arithmetic, and shorter
    ones would only make it smaller. `rounding` is ``Scheme.rounding``.
    """
    return max(tol * min(1.0, step / SHARE), min(tol, rounding))


@non_allocating
def is_rounding(size, tol, step, rounding):  # type: ignore[no-untyped-def]
    """Whether a step's error, `size` in units of what is allowed, is rounding, which says nothing of its length.

    With a tight `tol` rounding is no small part of it. Short steps, as events leave them, would then stay short.
    """
    return size * allowed(tol, step, rounding) <= rounding


@non_allocating
def lasting(step):  # type: ignore[no-untyped-def]
    """Time, s, for which an error of a velocity made in a step counts: the geometric mean of the step and SHARE.

    One that lasts (a vibration) moves joints for SHARE at least, however short the step; one that friction wipes out
    counts for less than its step. Weighed by the step alone, a thousand short ones would add up unseen; weighed by
    SHARE, steps would have to resolve how friction settles.
    """
    return math.sqrt(step * max(step, SHARE))
