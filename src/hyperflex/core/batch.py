"""Many rollouts side by side: each lane runs a member of its own, with its own step, and takes the next one when done.

No number of one lane ever enters another, so a member's result does not depend on its neighbours or on the threads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core import lanes as ln
from hyperflex.core import status
from hyperflex.core.chain import Array, Chain, energies, sincos
from hyperflex.core.drive import ANGLE, ROUNDING, TORQUE, X, Y, polynomial
from hyperflex.core.jit import kernel
from hyperflex.core.rollout import LARGEST_STEP, SHARE, SMALLEST_STEP


class Members(NamedTuple):
    """What the members of a batch are made of; drives lie one after the other, member m's from first[m] on."""

    links: Array  # (m, 9, n): length, mass, com, inertia, viscous, stiffness, rest, dry, lever
    whole: Array  # (m, 5): tip mass, gravity x, y, arm length, torque limit
    start: Array  # (m, 2 n + 2) states at begin
    breaks: Array  # (sum of k + 1,), s
    coef: Array  # (sum of k + 1, 4, 6); the last row of each member is not used
    loop: npt.NDArray[np.int64]  # (m,) as in Drive
    first: npt.NDArray[np.int64]  # (m + 1,)


class Terms(NamedTuple):
    """What the members have in common."""

    begin: float  # s
    tol: float  # m
    reaction: float
    dry_rate: float
    has_dry: bool
    fixed: float  # s, a step chosen beforehand; 0.0: error control
    best: Array  # (p + 1,) weights of the columns, as in Scheme
    other: Array


LENGTH, MASS, COM, INERTIA, VISCOUS, STIFFNESS, REST, DRY, LEVER = range(9)
TIP_MASS, GRAVITY_X, GRAVITY_Y, ARM_LENGTH, TORQUE_LIMIT = range(5)
# what a lane keeps about its member
TIME, STEP, AFTER, ORIGIN, END, WANTED, FRESH = range(7)


@kernel
def enter(members, m, lanes, j):  # type: ignore[no-untyped-def]
    """Put member m into lane j: parameters and state at the start."""
    k = len(ln.MEMBERS)
    n = members.links.shape[2]
    link = members.links[m]
    for i in range(n):
        row = lanes[(i + 1) * ln.ROW * k : (i + 2) * ln.ROW * k]
        ma = link[MASS, i] * link[COM, i]
        row[ln.LENGTH * k + j] = link[LENGTH, i]
        row[ln.MA * k + j] = ma
        row[ln.INERTIA * k + j] = link[INERTIA, i] + ma * link[COM, i]
        row[ln.MASS * k + j] = link[MASS, i]
        row[ln.VISCOUS * k + j] = link[VISCOUS, i]
        row[ln.STIFFNESS * k + j] = link[STIFFNESS, i]
        row[ln.REST * k + j] = link[REST, i]
        row[ln.DRY * k + j] = link[DRY, i]
        row[ln.LEVER * k + j] = link[LEVER, i]
        row[ln.Q_START * k + j] = members.start[m, i]
        row[ln.W_START * k + j] = members.start[m, n + i]
    tip = lanes[(n + 1) * ln.ROW * k :]
    tip[ln.AXX * k + j] = members.whole[m, TIP_MASS]
    tip[ln.AYY * k + j] = members.whole[m, TIP_MASS]


@kernel
def piece(members, m, t, coef, lane):  # type: ignore[no-untyped-def]
    """Find the piece of member m's drive that holds from t on; copies its coefficients, notes its origin and end."""
    first = members.first[m]
    count = members.first[m + 1] - first - 1
    breaks = members.breaks[first : first + count + 1]
    t += ROUNDING * (1.0 + abs(t))  # as in drive.segment
    if t < breaks[0] or (t >= breaks[count] and members.loop[m] < 0):  # standing still
        j = 0 if t < breaks[0] else count - 1
        lane[ORIGIN] = t
        lane[END] = breaks[0] if t < breaks[0] else np.inf
        coef[:] = 0.0
        since = 0.0 if t < breaks[0] else breaks[count] - breaks[count - 1]
        for channel in range(TORQUE):
            coef[channel, 0] = polynomial(members.coef[first + j, channel], since)[0]
        return
    offset = 0.0
    j = 0
    if t >= breaks[count]:
        j = members.loop[m]
        period = breaks[count] - breaks[j]
        cycle = np.floor((t - breaks[j]) / period)
        if cycle * period + breaks[count] <= t:
            cycle += 1.0
        offset = cycle * period
    while j < count - 1 and offset + breaks[j + 1] <= t:
        j += 1
    lane[ORIGIN] = offset + breaks[j]
    lane[END] = offset + breaks[j + 1]
    coef[:] = members.coef[first + j]


@kernel
def base_motion(coef, since, whole, base):  # type: ignore[no-untyped-def]
    """Motion of the first joint `since` the piece began, less gravity, for ``lanes.euler``; returns the torque."""
    angle, rate, alpha = polynomial(coef[ANGLE], since)
    _, vx, ax = polynomial(coef[X], since)
    _, vy, ay = polynomial(coef[Y], since)
    torque = polynomial(coef[TORQUE], since)[0]
    sin, cos = sincos(angle)
    length = whole[ARM_LENGTH]
    base[0] = ax + length * (cos * alpha - sin * rate * rate) - whole[GRAVITY_X]
    base[1] = ay + length * (sin * alpha + cos * rate * rate) - whole[GRAVITY_Y]
    base[2] = alpha
    base[3] = rate
    base[4] = angle
    base[5] = vx + length * cos * rate
    base[6] = vy + length * sin * rate
    return min(max(torque, -whole[TORQUE_LIMIT]), whole[TORQUE_LIMIT])


@kernel
def begin_column(width, lanes, sums):  # type: ignore[no-untyped-def]
    """Set every lane back to the state at the start of its step; with `sums`, also clear the extrapolated sums."""
    k = len(width)
    n = lanes.size // (ln.ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * k : (i + 1) * ln.ROW * k]
        for j in range(k):
            row[ln.Q * k + j] = row[ln.Q_START * k + j]
            row[ln.W * k + j] = row[ln.W_START * k + j]
        if sums:
            for j in range(k):
                row[ln.Q_SUM * k + j] = 0.0
                row[ln.W_SUM * k + j] = 0.0
                row[ln.Q_GAP * k + j] = 0.0
                row[ln.W_GAP * k + j] = 0.0


@kernel
def end_column(width, lanes, best, gap):  # type: ignore[no-untyped-def]
    """Add the increments of a finished column to the result and to the error estimate."""
    k = len(width)
    n = lanes.size // (ln.ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * k : (i + 1) * ln.ROW * k]
        for j in range(k):
            dq = row[ln.Q * k + j] - row[ln.Q_START * k + j]
            dw = row[ln.W * k + j] - row[ln.W_START * k + j]
            row[ln.Q_SUM * k + j] += best * dq
            row[ln.W_SUM * k + j] += best * dw
            row[ln.Q_GAP * k + j] += gap * dq
            row[ln.W_GAP * k + j] += gap * dw


@kernel
def measure(width, lanes):  # type: ignore[no-untyped-def]
    """Largest squared errors of any joint's position and velocity, left in WORST and WORST_V of the last link."""
    k = len(width)
    n = lanes.size // (ln.ROW * k) - 2
    for i in range(1, n + 1):
        row = lanes[(i - 1) * ln.ROW * k : (i + 1) * ln.ROW * k]
        for j in range(k):
            sin, cos = sincos(row[(ln.AT + ln.Q_START) * k + j] + row[(ln.AT + ln.Q_SUM) * k + j])
            a = row[(ln.AT + ln.LEVER) * k + j] * row[(ln.AT + ln.Q_GAP) * k + j]
            b = row[(ln.AT + ln.LEVER) * k + j] * row[(ln.AT + ln.W_GAP) * k + j]
            x = row[(ln.UP + ln.ERR_X) * k + j] + cos * a
            y = row[(ln.UP + ln.ERR_Y) * k + j] + sin * a
            vx = row[(ln.UP + ln.ERR_VX) * k + j] + cos * b
            vy = row[(ln.UP + ln.ERR_VY) * k + j] + sin * b
            row[(ln.AT + ln.ERR_X) * k + j] = x
            row[(ln.AT + ln.ERR_Y) * k + j] = y
            row[(ln.AT + ln.ERR_VX) * k + j] = vx
            row[(ln.AT + ln.ERR_VY) * k + j] = vy
            worst = row[(ln.UP + ln.WORST) * k + j]
            worst_v = row[(ln.UP + ln.WORST_V) * k + j]
            position = x * x + y * y
            velocity = vx * vx + vy * vy
            row[(ln.AT + ln.WORST) * k + j] = position if position > worst else worst
            row[(ln.AT + ln.WORST_V) * k + j] = velocity if velocity > worst_v else worst_v


@kernel
def extrapolate_lanes(members, terms, member, lane, coef, energy, lanes, base):  # type: ignore[no-untyped-def]
    """One extrapolated step in every lane, of the length WANTED; results stay in the sums of `lanes` and `energy`."""
    k = len(ln.MEMBERS)
    n = members.links.shape[2]
    step = lanes[((n + 1) * ln.ROW + ln.STEP) * k :]
    order = terms.best.size - 1
    energy[:, 2:] = 0.0
    for col in range(1, order + 1):
        begin_column(ln.MEMBERS, lanes, col == 1)
        for j in range(k):
            step[j] = lane[j, WANTED] / col
            lanes[ln.WORK * k + j] = 0.0
            lanes[ln.DISSIPATED * k + j] = 0.0
        for s in range(col):
            for j in range(k):
                if member[j] >= 0:
                    since = lane[j, TIME] - lane[j, ORIGIN] + s * step[j]
                    lanes[ln.EXTERNAL * k + j] = base_motion(coef[j], since, members.whole[member[j]], base[j])
            ln.euler(ln.MEMBERS, lanes, base, terms.reaction, terms.dry_rate, terms.has_dry)
        end_column(ln.MEMBERS, lanes, terms.best[col], terms.best[col] - terms.other[col])
        for j in range(k):
            energy[j, 2] += terms.best[col] * lanes[ln.WORK * k + j]
            energy[j, 3] += terms.best[col] * lanes[ln.DISSIPATED * k + j]
    measure(ln.MEMBERS, lanes)


@kernel
def accept(lanes, n, j, energy):  # type: ignore[no-untyped-def]
    """Make the result of lane j's step the start of its next one."""
    k = len(ln.MEMBERS)
    for i in range(1, n + 1):
        row = lanes[i * ln.ROW * k : (i + 1) * ln.ROW * k]
        row[ln.Q_START * k + j] += row[ln.Q_SUM * k + j]
        row[ln.W_START * k + j] += row[ln.W_SUM * k + j]
    energy[j, 0] += energy[j, 2]
    energy[j, 1] += energy[j, 3]


@kernel
def write(lanes, n, j, energy, out):  # type: ignore[no-untyped-def]
    """Copy the state of lane j to ``out`` (2 n + 2,)."""
    k = len(ln.MEMBERS)
    for i in range(n):
        out[i] = lanes[((i + 1) * ln.ROW + ln.Q_START) * k + j]
        out[n + i] = lanes[((i + 1) * ln.ROW + ln.W_START) * k + j]
    out[2 * n] = energy[j, 0]
    out[2 * n + 1] = energy[j, 1]


@kernel
def judge(terms, lanes, n, j, lane):  # type: ignore[no-untyped-def]
    """Error of lane j's step in units of what is allowed; 0 for a fixed step, inf where it is not finite."""
    k = len(ln.MEMBERS)
    last = lanes[n * ln.ROW * k : (n + 1) * ln.ROW * k]
    step = lane[WANTED]
    finite = abs(last[ln.ERR_VX * k + j]) + abs(last[ln.ERR_VY * k + j]) < np.inf
    worst = max(last[ln.WORST * k + j], step * step * last[ln.WORST_V * k + j])
    if not finite or not (worst < np.inf):
        return np.inf
    if terms.fixed > 0.0:
        return 0.0
    return math.sqrt(worst) / (terms.tol * min(1.0, step / SHARE))


@kernel
def run_block(members, terms, low, high, t_out, y_out, codes, reached):  # type: ignore[no-untyped-def]
    """Run members low..high - 1; each step ends at a break of the drive or at an output at the latest.

    Parameters
    ----------
    members, terms : Members, Terms
    low, high : int
    t_out : (T,) increasing times after ``terms.begin``, s; the run ends at the last one
    y_out : (high - low, T, 2 n + 2) out, states
    codes : (high - low,) out, status codes
    reached : (high - low,) out, s
    """
    k = len(ln.MEMBERS)
    n = members.links.shape[2]
    lanes = np.zeros((n + 2) * ln.ROW * k)
    base = np.zeros((k, 9))
    coef = np.zeros((k, 4, 6))
    lane = np.zeros((k, 7))
    energy = np.zeros((k, 4))  # work and dissipation at the start of the step, and their increments
    member = np.full(k, -1)
    index = np.zeros(k, dtype=np.int64)
    coming = low
    order = terms.best.size - 1
    while True:
        busy = 0
        for j in range(k):
            if member[j] < 0 and coming < high:
                member[j], index[j] = coming, 0
                enter(members, coming, lanes, j)
                energy[j, 0], energy[j, 1] = members.start[coming, 2 * n], members.start[coming, 2 * n + 1]
                lane[j, TIME], lane[j, STEP], lane[j, END] = terms.begin, 0.01, terms.begin
                lane[j, AFTER] = np.inf
                coming += 1
            lane[j, WANTED] = 0.0
            if member[j] >= 0:
                busy += 1
                t = lane[j, TIME]
                if t >= lane[j, END]:
                    piece(members, member[j], t, coef[j], lane[j])
                    lane[j, STEP] = min(lane[j, STEP], lane[j, AFTER])
                    lane[j, FRESH] = 1.0
                end = min(lane[j, END], t_out[index[j]])
                wanted = terms.fixed if terms.fixed > 0.0 else min(lane[j, STEP], LARGEST_STEP)
                lane[j, WANTED] = end - t if t + wanted * (1.0 + 1e-9) >= end else wanted
        if busy == 0:
            return
        extrapolate_lanes(members, terms, member, lane, coef, energy, lanes, base)
        for j in range(k):
            if member[j] < 0:
                continue
            m = member[j] - low
            size = judge(terms, lanes, n, j, lane[j])
            step = lane[j, WANTED]
            end = min(lane[j, END], t_out[index[j]])
            cut = lane[j, TIME] + step * (1.0 + 1e-9) >= end
            if cut and step < SMALLEST_STEP and size < np.inf:
                size = 0.0  # as in rollout.run
            if size <= 1.0:
                accept(lanes, n, j, energy)
                lane[j, TIME] = end if cut else lane[j, TIME] + step
                grown = step * min(3.0, 0.9 * max(size, 1e-12) ** (-1.0 / order))
                lane[j, STEP] = max(grown, lane[j, STEP]) if cut else grown
                if lane[j, FRESH] == 1.0:
                    lane[j, AFTER] = lane[j, STEP]
                    lane[j, FRESH] = 0.0
                if cut and t_out[index[j]] <= lane[j, TIME]:
                    write(lanes, n, j, energy, y_out[m, index[j]])
                    index[j] += 1
                if index[j] == t_out.size:
                    codes[m], reached[m], member[j] = status.OK, lane[j, TIME], -1
                continue
            lane[j, STEP] = step * (max(0.2, 0.9 * size ** (-1.0 / order)) if size < np.inf else 0.2)
            if terms.fixed > 0.0 or lane[j, STEP] < SMALLEST_STEP:
                codes[m] = status.NOT_FINITE if terms.fixed > 0.0 else status.STEP_TOO_SMALL
                reached[m], member[j] = lane[j, TIME], -1


@kernel
def energy_block(members, terms, low, high, t, y, kinetic, potential):  # type: ignore[no-untyped-def]
    """Energies of members low..high - 1 at times t (T,) and states y (high - low, T, 2 n + 2); outputs (.., T), J."""
    n = members.links.shape[2]
    coef = np.empty((4, 6))
    lane = np.empty(7)
    for m in range(low, high):
        link, whole = members.links[m], members.whole[m]
        chain = Chain(
            link[LENGTH],
            link[MASS],
            link[COM],
            link[INERTIA],
            link[VISCOUS],
            link[DRY],
            link[STIFFNESS],
            link[REST],
            whole[TIP_MASS],
            whole[GRAVITY_X],
            whole[GRAVITY_Y],
            terms.reaction,
            terms.dry_rate,
        )
        for k in range(t.size):
            piece(members, m, t[k], coef, lane)
            since = t[k] - lane[ORIGIN]
            angle, rate, _ = polynomial(coef[ANGLE], since)
            x, vx, _ = polynomial(coef[X], since)
            yy, vy, _ = polynomial(coef[Y], since)
            sin, cos = sincos(angle)
            reach = whole[ARM_LENGTH]
            base = (
                x + reach * sin,
                yy - reach * cos,
                vx + reach * cos * rate,
                vy + reach * sin * rate,
                angle,
                rate,
            )
            state = y[m - low, k]
            kinetic[m - low, k], potential[m - low, k] = energies(chain, state[:n], state[n : 2 * n], base)
