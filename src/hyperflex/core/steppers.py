"""One step of each integrator. The state y (2 n + 2,) holds angles, rates, work put in and energy dissipated."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core import lanes as ln
from hyperflex.core.chain import accelerations, friction_power, sines
from hyperflex.core.drive import base_state
from hyperflex.core.jit import kernel


class Scheme(NamedTuple):
    """Extrapolated linearly implicit Euler of fixed order p: column j takes j substeps, j = 1..p, packed into lanes."""

    order: int
    column: npt.NDArray[np.int64]  # (rounds, lanes) column that a lane works on in a round, 0: idle
    done: npt.NDArray[np.int64]  # (rounds, lanes) substeps of that column taken before
    best: npt.NDArray[np.float64]  # (p + 1,) weights of the columns in the result of order p
    other: npt.NDArray[np.float64]  # (p + 1,) in the result of order p - 1 beside it, for the error estimate


def scheme(order: int) -> Scheme:
    """Build the table of the given order (2..7; seven fills four lanes without a gap)."""
    best, other = np.zeros(order + 1), np.zeros(order + 1)
    for j in range(1, order + 1):
        best[j] = math.prod(j / (j - k) for k in range(1, order + 1) if k != j)
        if j > 1:
            other[j] = math.prod(j / (j - k) for k in range(2, order + 1) if k != j)
    lanes = len(ln.COLUMNS)
    column = np.zeros((order, lanes), dtype=np.int64)
    for lane in range(lanes):  # lane 0: column p; then p - j with j, which together take p substeps as well
        long = order - lane
        short = order - long
        if long >= short and long > 0:
            column[:long, lane] = long
            if 0 < short < long:
                column[long:, lane] = short
    done = np.zeros_like(column)
    for turn in range(1, order):
        done[turn] = np.where(column[turn] == column[turn - 1], done[turn - 1] + 1, 0)
    return Scheme(order, column, done, best, other)


@kernel
def begin_columns(chain, drive, part, table, turn, t, step, y, lanes, tip, base, trig):  # type: ignore[no-untyped-def]
    """Make the lanes ready for a round: the state where a column begins, the base's motion, the step of each lane.

    Arguments are those of ``extrapolate``; `trig` holds the sines and cosines of the angles in `y`.
    """
    k = len(ln.COLUMNS)
    n = chain.length.size
    motion = np.empty(9)
    for j in range(k):
        col = table.column[turn, j]
        done = table.done[turn, j]
        if col > 0 and done == 0:
            for i in range(n):
                lanes[((i + 1) * ln.ROW + ln.Q) * k + j] = y[i]
                lanes[((i + 1) * ln.ROW + ln.W) * k + j] = y[n + i]
                lanes[((i + 1) * ln.ROW + ln.SIN) * k + j] = trig[i]
                lanes[((i + 1) * ln.ROW + ln.COS) * k + j] = trig[n + i]
            lanes[ln.WORK * k + j] = y[2 * n]
            lanes[ln.LOST * k + j] = y[2 * n + 1]
        h = step / col if col > 0 else 0.0
        tip[ln.STEP * k + j] = h
        tip[ln.EXTERNAL * k + j] = base_state(drive, part, t + done * h, motion)
        for s in range(9):
            base[s, j] = motion[s]
        base[0, j] -= chain.gx
        base[1, j] -= chain.gy


@kernel
def end_columns(table, turn, y, out, error, lanes):  # type: ignore[no-untyped-def]
    """Add the columns that a round has completed to the result and to the error estimate."""
    k = len(ln.COLUMNS)
    n = (y.size - 2) // 2
    for j in range(k):
        col = table.column[turn, j]
        if col > 0 and table.done[turn, j] == col - 1:
            best = table.best[col]
            gap = best - table.other[col]
            for i in range(n):
                dq = lanes[((i + 1) * ln.ROW + ln.Q) * k + j] - y[i]
                dw = lanes[((i + 1) * ln.ROW + ln.W) * k + j] - y[n + i]
                out[i] += best * dq
                out[n + i] += best * dw
                error[i] += gap * dq
                error[n + i] += gap * dw
            work = lanes[ln.WORK * k + j] - y[2 * n]
            dissipated = lanes[ln.LOST * k + j] - y[2 * n + 1]
            out[2 * n] += best * work
            out[2 * n + 1] += best * dissipated
            error[2 * n] += gap * work
            error[2 * n + 1] += gap * dissipated


@kernel
def extrapolate(chain, drive, part, table, t, step, y, out, error, lanes, tip, base, trig):  # type: ignore[no-untyped-def]
    """Take one extrapolated step from y at time t; O(p^2 n / lanes).

    Parameters
    ----------
    chain, drive, part, table : Chain, Drive, Segment that holds t..t + step, Scheme
    y, out, error : (2 n + 2,) state, new state (out), its difference to the result of one order less (out)
    lanes, tip : as ``lanes.rows`` makes them, loaded with the chain's parameters and the senses of slipping
    base, trig : (9, lanes), (2 n,) scratch
    """
    out[:] = y  # the weights, up to 389 in size, multiply increments: their rounding must not scale the state itself
    error[:] = 0.0
    sines(y[: (y.size - 2) // 2], trig, 0)
    for turn in range(table.column.shape[0]):
        begin_columns(chain, drive, part, table, turn, t, step, y, lanes, tip, base, trig)
        ln.euler(ln.COLUMNS, chain.bears, ln.MORE, lanes, tip, base)
        end_columns(table, turn, y, out, error, lanes)


@kernel
def rates(chain, drive, part, t, y, grip, dy, work):  # type: ignore[no-untyped-def]
    """Exact time derivative of the state, written to dy (2 n + 2,); `work` is (6 n,) scratch."""
    n = chain.length.size
    base = np.empty(9)
    torque = base_state(drive, part, t, base)
    w = y[n : 2 * n]
    fx, fy, moment = accelerations(chain, y[:n], w, grip, base[:7], torque, 0.0, dy[n : 2 * n], work)
    dy[:n] = w
    dy[2 * n] = fx * base[5] + fy * base[6] + moment * base[3] + torque * w[0]
    dy[2 * n + 1] = friction_power(chain, w, grip, base[3])


@kernel
def runge_kutta(chain, drive, part, t, step, y, grip, out, stage, work):  # type: ignore[no-untyped-def]
    """Take one classical fourth-order Runge-Kutta step; `stage` is (3, 2 n + 2) scratch, `work` (6 n,)."""
    point, slope, total = stage[0], stage[1], stage[2]
    rates(chain, drive, part, t, y, grip, slope, work)
    total[:] = slope
    for k in range(3):
        part_step = step if k == 2 else 0.5 * step
        point[:] = y + part_step * slope
        rates(chain, drive, part, t + part_step, point, grip, slope, work)
        total += slope if k == 2 else 2.0 * slope
    out[:] = y + (step / 6.0) * total
