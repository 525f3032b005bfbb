"""Step-size control from the error, its trend and the remaining time; error of a step by drag reversal (M.35)."""

import math
from typing import Final, NamedTuple

import numpy as np

from hyperflex.core.chain.articulated_body import sines
from hyperflex.core.chain.drive import base_state
from hyperflex.core.jit import kernel, non_allocating


class StepSize(NamedTuple):
    """Constants of the step-size control of free flight."""

    # s; the error of shorter steps is limited in proportion, so that a thousand of them do not add up unnoticed
    share: float = 0.02
    # another order is used if its cost is below this fraction
    cheaper: float = 0.9
    # 0.9 saves no time, because more steps are rejected
    safety: float = 0.8
    # times the length of the step that ended at an event, tried next
    often: float = 2.2
    # largest ratio of a step's length to the last one,
    growth: float = 3.0
    # and smallest ratio
    shrinkage: float = 0.2


STEP_SIZE: Final = StepSize()

FIRST_STEP: Final = 0.01  # s, tried first
LARGEST_STEP: Final = 0.25  # s
LONGEST_WATCHED: Final = (
    0.01  # s, longest step while an event may end the run; events that cancel within a step may be missed
)
SMALLEST_STEP: Final = 1e-10  # s


@non_allocating
def fitted(wanted, left):  # type: ignore[no-untyped-def]
    """Length of a step, s, of desired length `wanted` with the time `left`: all of it, half of it, or `wanted`.

    Two equal steps to an end are better than a long and a very short one.
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
        Its length, s, and its error in units of the allowed error.
    last, last_size : float
        Of the previous step; `last` is 0.0 without a previous step of the same kind.
    order : int
        The error of a step of length h is proportional to h^order.

    Notes
    -----
    If errors grow from step to step by a factor, they are expected to continue to do so (predictive control, Gustafsson
    1994, doi:10.1145/198429.198437).
    """
    factor = STEP_SIZE.safety * max(size, 1e-12) ** (-1.0 / order)
    if last > 0.0:
        trend = (step / last) * (max(last_size, 1e-12) / max(size, 1e-12)) ** (1.0 / order)
        factor *= min(1.0, trend)
    return step * min(STEP_SIZE.growth, max(STEP_SIZE.shrinkage, factor))


@non_allocating
def by_trend(lower_size, lowest_size):  # type: ignore[no-untyped-def]
    """Expected error of a step from its estimates at one and two orders less.

    Errors fall by a factor from order to order, and are expected to fall by it once more. An estimate far below this is
    a coincidence: columns with large errors agree, as they may if the step is too long for their series.
    """
    return lower_size * min(1.0, lower_size / lowest_size) if 0.0 < lowest_size < np.inf else 0.0


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
        Its error at one order less, in units of the allowed error.
    grown : float
        Good length of the next step at the same order, s.

    Notes
    -----
    The error at one order more is unknown; this order is tried if the present one is better than the one below by as
    much (Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.9).
    """
    here = order - tables[0].order
    rounds = tables[here].column.shape[0]
    rounds_below = tables[here - 1].column.shape[0]
    lower = longer(step, lower_size, 0.0, 0.0, order - 1)
    work, work_below = rounds / min(grown, longest), rounds_below / min(lower, longest)
    if order > least and work_below < STEP_SIZE.cheaper * work:
        return order - 1, lower
    if order < most and work < STEP_SIZE.cheaper * work_below:
        return order + 1, grown * tables[here + 1].column.shape[0] / rounds
    return order, grown


@non_allocating
def shorter(step, size, order):  # type: ignore[no-untyped-def]
    """Length of the next attempt after a step whose error was too large (`size` > 1, or not finite)."""
    factor = STEP_SIZE.safety * size ** (-1.0 / order) if size < float("inf") else 0.0
    return step * max(STEP_SIZE.shrinkage, factor)


@non_allocating
def allowed(tol, step, rounding):  # type: ignore[no-untyped-def]
    """Allowed error of a step, m: `tol`, for a short step its share of it, but not less than rounding.

    While stiff friction settles, steps of nanoseconds are tried. Their share is below rounding, and shorter ones would
    only reduce it. `rounding` is ``Scheme.rounding``.
    """
    return max(tol * min(1.0, step / STEP_SIZE.share), min(tol, rounding))


@non_allocating
def is_rounding(size, tol, step, rounding):  # type: ignore[no-untyped-def]
    """Whether a step's error, `size` in units of the allowed error, is rounding and says nothing about its length.

    With a tight `tol`, rounding is a large part of it. Short steps, as after events, would then stay short.
    """
    return size * allowed(tol, step, rounding) <= rounding


@non_allocating
def lasting(step):  # type: ignore[no-untyped-def]
    """Time, s, for which a velocity error counts: the geometric mean of the step and ``STEP_SIZE.share``.

    A persistent error (a vibration) moves joints for at least `share`, for any step length; an error that friction
    damps counts for less than its step. Weighted by the step alone, a thousand short errors would add up unnoticed;
    weighted by `share`, steps would have to resolve the settling of friction.
    """
    return math.sqrt(step * max(step, STEP_SIZE.share))


NEAR = 2.0  # substeps of the finest column from an end of a step, within which a kink is not detected


@non_allocating
def across_ends(chain, y, base, trig, out):  # type: ignore[no-untyped-def]
    """Velocities across each link at its near and far joint to ``out`` (2, n), m/s; `trig` (2 n,) is scratch.

    `y` (2 n or more,) are angles and rates, `base` (7 or more,) as in ``accelerations``.
    """
    n = out.shape[1]
    sines(y[:n], trig, 0)
    vx, vy = base[5], base[6]
    for i in range(n):
        turn = chain.length[i] * y[n + i]
        out[0, i] = vx * trig[n + i] + vy * trig[i]
        out[1, i] = out[0, i] + turn
        vx += turn * trig[n + i]
        vy += turn * trig[i]


@non_allocating
def unseen(chain, before, after, step, order):  # type: ignore[no-untyped-def]
    """Velocity error, m/s, if drag changes its sign so near an end of a step that no column resolves it.

    The error estimate detects a kink between the substeps of the finest column, which takes `order` substeps. A kink
    before the second substep or after the last one is invisible to all columns, and one within the next substep nearly
    so. This function estimates the error of these kinks.

    Parameters
    ----------
    before, after : (2, n) velocities across the links at the step's ends, see :func:`across_ends`
    step, order : s, int
    """
    length, mass, worst = 0.0, chain.tip_mass, 0.0
    for i in range(before.shape[1]):
        length += chain.length[i]
        mass += chain.mass[i]
        for end in range(2):
            first, last = before[end, i], after[end, i]
            if first * last < 0.0:
                least = min(abs(first), abs(last))
                part = least / (abs(first) + abs(last))
                if part * order < NEAR:
                    now = before if abs(first) < abs(last) else after
                    width = least / max(abs(now[1, i] - now[0, i]), least)
                    worst = max(worst, chain.drag[i] * least * least * part * width)
    return (2.0 / 3.0) * step * worst * length / mass


@kernel
def air_size(chain, drive, part, limits, table, t, step, y, workspace):  # type: ignore[no-untyped-def]
    """Error of the step from y to ``workspace.out`` by undetected kinks of air drag, in units of the allowed one."""
    base, trig, ends = workspace.search.after, workspace.stiction.work, np.empty((2, 2, chain.length.size))
    for k in range(2):
        base_state(drive, part, min(t + k * step, part.end), base)
        across_ends(chain, workspace.out if k == 1 else y, base, trig, ends[k])
    error = unseen(chain, ends[0], ends[1], step, table.order)
    return error * lasting(step) / allowed(limits.tol, step, table.rounding)
