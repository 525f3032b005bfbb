"""One step of each integrator: extrapolated implicit Euler with its dense output, Runge-Kutta.

The state y (2 n + 2,) holds angles, rates, work put in and energy dissipated.

Dense output: a column that takes j substeps h = H / j has the states Y_j(t) = y(t) + h e_1(t) + h^2 e_2(t) + ... in the
step, where all e_k are zero at its beginning (Hairer and Ostermann 1990, doi:10.1007/BF01386410). The p (p + 1) / 2
substeps of the columns 1..p determine all terms in h^k (t - t_0)^m with k + m <= p, and thus y(t) to the order of the
step, at the cost of sums. If this is not accurate enough, Hermite interpolation uses states and derivatives at the
beginning, middle and end of the step.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core.assign import assign
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import BASE_SIZE, Array, accelerations, lost_power, motor_torque, sines
from hyperflex.core.chain.drive import base_size, base_state
from hyperflex.core.jit import inlined, kernel, non_allocating, read, summing, write, zeros

MOST_SUBSTEPS = 40  # rounds times lanes of order 8, and a spare round
# Fractions of the step at which the error is evaluated (where friction settles, and in the middle), and its weight:
# while friction settles, estimates are half of the error. At most ERRORS, for ``rollout.error_norms``
LOOKS = ((0.125, 2.0), (0.5, 1.0))


def polynomials(order, column, done):  # type: ignore[no-untyped-def]
    """Weights of the substeps as polynomials of the elapsed fraction of the step.

    Parameters
    ----------
    order : int, of the dense output
    column, done : (rounds, lanes) int, as in ``steps.Scheme``; the columns beyond 1..order help as well

    Returns
    -------
    (order, rounds lanes) : row m - 1 contains the coefficients of part^m; the smallest ones if they are not unique
    """
    used = column.ravel() > 0
    step = 1.0 / column.ravel()[used]
    part = (done.ravel()[used] + 1) * step
    terms = [(k, m) for k in range(order) for m in range(1, order - k + 1)]
    weights = np.linalg.pinv(np.array([step**k * part**m for k, m in terms]))
    found = np.zeros((order, used.size))
    found[:, used] = weights[:, [terms.index((0, m)) for m in range(1, order + 1)]].T
    return found


@non_allocating
def write_increments(lanes, j, y, out):  # type: ignore[no-untyped-def]
    """Write the state of lane j minus the initial state y (2 n + 2,) of the step to ``out`` (2 n + 2,)."""
    k, n = len(ln.COLUMNS), (y.size - 2) // 2
    for i in range(n):
        q, w = read(lanes, k, (i + 1) * ln.ROW * k + j, (ln.Q, ln.W))
        out[i], out[n + i] = q - y[i], w - y[n + i]
    work, lost = read(lanes, k, j, (ln.WORK, ln.LOST))
    out[2 * n], out[2 * n + 1] = work - y[2 * n], lost - y[2 * n + 1]


@summing
def weigh_terms(terms, part, weight):  # type: ignore[no-untyped-def]
    """Weights of the substeps at the fraction `part` of the step, 0..1, from their polynomials (p, ...)."""
    weight[:] = 0.0
    for m in range(terms.shape[0] - 1, -1, -1):
        for s in range(weight.size):
            weight[s] = (weight[s] + terms[m, s]) * part


@summing
def add_substeps(weight, kept, out):  # type: ignore[no-untyped-def]
    """Add to `out` (2 n + 2,) the kept substeps, each times its weight.

    `weight` (s,): s is a multiple of 4 (of whole rounds), and at most the number of rows of `kept`.
    """
    for s in range(0, weight.size, 4):  # four at a time: `out` is read and written a quarter as often
        a, b, c, d = weight[s], weight[s + 1], weight[s + 2], weight[s + 3]
        for i in range(out.size):
            out[i] += (a * kept[s, i] + b * kept[s + 1, i]) + (c * kept[s + 2, i] + d * kept[s + 3, i])


@kernel
def new_substeps(n):  # type: ignore[no-untyped-def]
    """Room for the substeps of a chain of n links (MOST_SUBSTEPS, 2 n + 2), and for their weights."""
    return zeros((MOST_SUBSTEPS, 2 * n + 2), MOST_SUBSTEPS)


ROUNDING = 3e-16  # m, of a position of a metre or two
ERRORS = 3  # estimates of a step's error, of successive orders: their trend reveals a coincidental agreement


class Scheme(NamedTuple):
    """Extrapolated linearly implicit Euler of order p: column j takes j substeps, j = 1..p, packed into lanes."""

    order: int
    column: npt.NDArray[np.int64]  # (rounds, lanes) column that a lane works on in a round, 0: idle
    done: npt.NDArray[np.int64]  # (rounds, lanes) substeps of that column taken before
    best: Array  # (p + 1,) weights of the columns in the result of order p
    gaps: (
        Array  # (ERRORS, p + 1) in its difference to a result of order p - 1, the error estimate; then in those of the
    )
    # results of order p - 1 and p - 2 from the first p - 1 and p - 2 columns
    rounding: float  # m, effect of the weights on rounding errors of positions of a few metres


def scheme(order: int) -> Scheme:
    """Build the table of the given order (2 or more)."""
    column, done = _packed(order)
    best = _weights(1, order, order)
    gaps = [_weights(1, last, order) - _weights(2, last, order) for last in range(order, order - ERRORS, -1)]
    return Scheme(
        order,
        column,
        done,
        best,
        np.array(gaps),
        ROUNDING * np.abs(best).sum(),
    )


def _weights(first: int, last: int, order: int) -> Array:
    """Weights (order + 1,) of columns first..last in their extrapolated value (Neville's at step 0)."""
    weights = np.zeros(order + 1)
    for j in range(first, last + 1):
        weights[j] = math.prod(j / (j - k) for k in range(first, last + 1) if k != j)
    return weights


def _packed(order: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Columns (rounds, lanes) in as few rounds as possible, and the substeps taken before.

    Each column, the longest first, is placed where it fits best.
    """
    lanes = len(ln.COLUMNS)
    rounds = max(order, -(-order * (order + 1) // 2 // lanes))
    column, done, used = np.zeros((rounds, lanes), int), np.zeros((rounds, lanes), int), [0] * lanes
    for j in range(order, 0, -1):
        lane = max((lane for lane in range(lanes) if used[lane] + j <= rounds), key=used.__getitem__)
        rows = slice(used[lane], used[lane] + j)
        column[rows, lane], done[rows, lane] = j, range(j)
        used[lane] += j
    return column, done


def _courses(most: int) -> tuple[Array, Array]:
    """Weights of the substeps of each order up to `most`: their polynomials, and those in the errors at LOOKS."""
    course = np.zeros((most + 1, most, MOST_SUBSTEPS))
    errors = np.zeros((most + 1, len(LOOKS), MOST_SUBSTEPS))
    for order in range(2, most + 1):
        table = scheme(order)
        substeps = table.column.size
        course[order, :order, :substeps] = gap = polynomials(order, table.column, table.done)
        gap[:-1] -= polynomials(order - 1, table.column, table.done)
        powers = [count * part ** np.arange(1, order + 1) for part, count in LOOKS]
        errors[order, :, :substeps] = np.array(powers) @ gap
    return course, errors


MOST_ORDER = 8  # higher ones would exceed the accuracy of the polynomial between steps, and rounding
COURSE, COURSE_ERRORS = _courses(MOST_ORDER)


@inlined
def begin_columns(chain, drive, part, table, turn, t, step, y, lanes, tip, base, trig):  # type: ignore[no-untyped-def]
    """Prepare the lanes for a round: the state at the start of a column, the base's motion, the step of each lane.

    Arguments as for ``extrapolate``; `trig` contains the sines and cosines of the angles in `y`.
    """
    k, n = len(ln.COLUMNS), chain.length.size
    motion = np.empty(base.shape[0])
    for j in range(k):
        col, done = table.column[turn, j], table.done[turn, j]
        if col > 0 and done == 0:
            ln.set_state(j, y[:n], y[n : 2 * n], trig, lanes)
            write(lanes, k, j, (ln.WORK, ln.LOST), (y[2 * n], y[2 * n + 1]))
        h = step / col if col > 0 else 0.0
        tip[ln.STEP * k + j] = h
        tip[ln.EXTERNAL * k + j] = base_state(drive, part, t + done * h, motion)
        ln.set_base(j, chain, motion, base)


@inlined
def end_columns(table, turn, y, out, errors, lanes, increments):  # type: ignore[no-untyped-def]
    """Add the columns that a round has completed to the result and to the error estimates.

    `increments` (2 n + 2,) is scratch.
    """
    for j in range(len(ln.COLUMNS)):
        col = table.column[turn, j]
        if col > 0 and table.done[turn, j] == col - 1:
            best, gap, lower, lowest = table.best[col], table.gaps[0, col], table.gaps[1, col], table.gaps[2, col]
            write_increments(lanes, j, y, increments)
            for i in range(y.size):
                out[i] += best * increments[i]
                errors[0, i] += gap * increments[i]
                errors[1, i] += lower * increments[i]
                errors[2, i] += lowest * increments[i]


@kernel
def extrapolate(chain, drive, part, table, t, step, y, out, errors, kept, lanes, tip, base, work):  # type: ignore[no-untyped-def]
    """Take one extrapolated step from y at time t; O(p^2 n / lanes).

    Parameters
    ----------
    chain, drive, part, table : Chain, Drive, Segment that holds t..t + step, Scheme
    y, out : (2 n + 2,) state, new state (out)
    errors : (ERRORS, 2 n + 2) out, error estimates of the result, and of the results of one and two orders less
    kept : (MOST_SUBSTEPS, 2 n + 2) out, the substeps (:func:`write_increments`); (0, ...) if they are not needed
    lanes, tip : as ``lanes.rows`` makes them, loaded with the chain's parameters and the senses of slipping
    base, work : (base_size(drive), lanes), (6 n,) scratch
    """
    assign(
        out, y
    )  # the weights, up to 389 in size, multiply increments, so that their rounding does not scale the state
    errors[:] = 0.0
    n = (y.size - 2) // 2
    sines(y[:n], work, 0)
    for turn in range(table.column.shape[0]):
        begin_columns(chain, drive, part, table, turn, t, step, y, lanes, tip, base, work)
        ln.euler(ln.COLUMNS, chain.reaction, ln.MORE, lanes, tip, base)
        end_columns(table, turn, y, out, errors, lanes, work[2 * n : 4 * n + 2])
        if kept.shape[0] > 0:
            for j in range(len(ln.COLUMNS)):
                write_increments(lanes, j, y, kept[turn * len(ln.COLUMNS) + j])


@kernel
def rates(chain, drive, part, t, y, slip, dy, work):  # type: ignore[no-untyped-def]
    """Exact time derivative of the state, written to dy (2 n + 2,); `work` is (6 n,) scratch."""
    n = chain.length.size
    base = np.empty(base_size(drive))
    torque = base_state(drive, part, t, base)
    w = y[n : 2 * n]
    fx, fy, moment = accelerations(chain, y[:n], w, slip, base, torque, 0.0, dy[n : 2 * n], work)
    assign(dy[:n], w)
    dy[2 * n] = fx * base[5] + fy * base[6] + moment * base[3]
    for i in range(max(1, base.size - BASE_SIZE)):
        dy[2 * n] += motor_torque(base, torque, i) * w[i]
    dy[2 * n + 1] = lost_power(chain, w, slip, base, work)


@non_allocating
def runge_kutta(chain, drive, part, t, step, y, slip, out, stage, work):  # type: ignore[no-untyped-def]
    """Take one classical fourth-order Runge-Kutta step; `stage` is (3, 2 n + 2) scratch, `work` (6 n,)."""
    point, slope, total = stage[0], stage[1], stage[2]
    rates(chain, drive, part, t, y, slip, slope, work)
    assign(total, slope)
    for k in range(3):
        part_step = step if k == 2 else 0.5 * step
        for i in range(y.size):
            point[i] = y[i] + part_step * slope[i]
        rates(chain, drive, part, t + part_step, point, slip, slope, work)
        for i in range(y.size):
            total[i] += slope[i] if k == 2 else 2.0 * slope[i]
    for i in range(y.size):
        out[i] = y[i] + (step / 6.0) * total[i]


def _hermite(derivatives: int) -> Array:
    """Coefficients (basis, power) of the Hermite basis on -1, 0, 1 with the given derivatives (0..k) at each node."""
    count = 3 * (derivatives + 1)
    rows = [
        [math.perm(power, d) * node ** (power - d) if power >= d else 0.0 for power in range(count)]
        for d in range(derivatives + 1)
        for node in (-1.0, 0.0, 1.0)
    ]
    return np.linalg.inv(np.array(rows)).T.copy()


_ANGLES = _hermite(2)  # (9, 9): value, first and second derivative at three nodes
_SUMS = _hermite(1)  # (6, 6): value and first derivative


@non_allocating
def basis(order, theta, weight):  # type: ignore[no-untyped-def]
    """Derivative of the given order of the interpolation's basis (9,) at theta; of values, rates and accelerations."""
    for b in range(9):
        total = 0.0
        for k in range(order, 9):
            factor = 1.0
            for m in range(order):
                factor *= k - m
            total += _ANGLES[b, k] * factor * theta ** (k - order)
        weight[b] = total


@kernel
def interpolate(theta, step, ys, dys, out):  # type: ignore[no-untyped-def]
    """State at theta in -1..1 within a step from its values ys (3, 2 n + 2) and derivatives dys at -1, 0, 1.

    Angles follow the polynomial of degree 8 through angles, rates and accelerations; rates are its derivative; work and
    dissipation follow one of degree 5. Not for the step after a switch, in which friction settles (docs/models.md).
    """
    n = (ys.shape[1] - 2) // 2
    half = 0.5 * step
    value = np.empty(9)
    slope = np.empty(9)
    basis(0, theta, value)
    basis(1, theta, slope)
    for i in range(n):
        q = w = 0.0
        for k in range(3):
            rate = half * ys[k, n + i]
            bend = half * half * dys[k, n + i]
            q += value[k] * ys[k, i] + value[3 + k] * rate + value[6 + k] * bend
            w += slope[k] * ys[k, i] + slope[3 + k] * rate + slope[6 + k] * bend
        out[i] = q
        out[n + i] = w / half
    for i in range(2 * n, 2 * n + 2):
        total = 0.0
        for b in range(6):
            node = b % 3
            weight = 0.0
            for k in range(6):
                weight += _SUMS[b, k] * theta**k
            total += weight * (ys[node, i] if b < 3 else half * dys[node, i])
        out[i] = total
