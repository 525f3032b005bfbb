"""The members of a batch: their parameters, their drives, and how they enter a lane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core import lanes as ln
from hyperflex.core.chain import Array, Chain, energies, sincos
from hyperflex.core.drive import ANGLE, ROUNDING, TORQUE, X, Y, polynomial
from hyperflex.core.jit import kernel


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
    bears: tuple[int, ...]  # as in Chain
    fixed: float  # s, a step chosen beforehand; 0.0: error control
    best: Array  # (p + 1,) weights of the columns, as in Scheme
    other: Array


LENGTH, MASS, COM, INERTIA, VISCOUS, STIFFNESS, REST, DRY, LEVER = range(9)
TIP_MASS, GRAVITY_X, GRAVITY_Y, ARM_LENGTH, TORQUE_LIMIT = range(5)
# what a lane keeps about its member
FIRST_STEP = 0.01  # s, tried first; error control does the rest
TIME, STEP, AFTER, ORIGIN, END, WANTED, FRESH = range(7)


@kernel
def enter(members, terms, m, lanes, j, lane, energy):  # type: ignore[no-untyped-def]
    """Put member m into lane j: parameters, state at the start, clock (7,) and energies (4,)."""
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
        row[ln.GRIP * k + j] = 1.0
        row[ln.LEVER * k + j] = link[LEVER, i]
        row[ln.Q_START * k + j] = members.start[m, i]
        row[ln.W_START * k + j] = members.start[m, n + i]
    tip = lanes[(n + 1) * ln.ROW * k :]
    tip[ln.AXX * k + j] = members.whole[m, TIP_MASS]
    tip[ln.AYY * k + j] = members.whole[m, TIP_MASS]
    energy[0], energy[1] = members.start[m, 2 * n], members.start[m, 2 * n + 1]
    lane[TIME], lane[STEP], lane[END], lane[AFTER] = terms.begin, FIRST_STEP, terms.begin, np.inf


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
            terms.bears,
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
