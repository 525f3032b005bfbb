"""Members of a batch: parameters, drives, and how a member enters a lane."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array, Chain, chain_of_rows, energies, sincos
from hyperflex.core.chain.drive import ANGLE, ROUNDING, TORQUE, X, Y, polynomial
from hyperflex.core.jit import inlined, non_allocating


class Members(NamedTuple):
    """What the members of a batch are made of; drives lie one after the other, member m's from first[m] on."""

    links: Array  # (m, 11, n): the fields of a Chain in their order, and the lever
    whole: Array  # (m, 5): tip mass, gravity x, y, arm length, torque limit
    start: Array  # (m, 2 n + 2) states at begin
    breaks: Array  # (sum of k + 1,), s
    coef: Array  # (sum of k + 1, 4, 6); the last row of each member is not used
    loop: npt.NDArray[np.int64]  # (m,) as in Drive
    first: npt.NDArray[np.int64]  # (m + 1,)
    clock: Array  # (m, 3) STEP, AFTER and CHATTER of each, changed in place: a batch that goes on needs them


class Terms(NamedTuple):
    """What the members have in common."""

    begin: float  # s
    tol: float  # m
    reaction: tuple[int, ...]  # as in Chain
    fixed: float  # s, a step chosen beforehand; 0.0: error control
    best: Array  # (p + 1,) weights of the columns, as in Scheme
    gap: Array  # in the error estimate
    rounding: float  # m, as in Scheme


LENGTH, LEVER = Chain._fields.index("length"), Chain._fields.index("tip_mass")  # rows of ``links``
TIP_MASS, GRAVITY_X, GRAVITY_Y, ARM_LENGTH, TORQUE_LIMIT = range(5)
# a lane's clock, s: as in rollout, with the piece of the drive that holds and the step wanted next
# RETRY: 1.0 while a step is being shortened to end at an event
TIME, STEP, AFTER, RESTARTED, LAST, SIZE, UNDECIDED, CHATTER, ORIGIN, END, NEXT_STEP, RETRY, CLOCK = range(13)
# What moves the first joints, in lanes: slot * k + lane. Coefficients of four channels, what hardly changes, the time
# since the piece began; then the torque on link 0 and what ``drive.base_state`` gives, less gravity
COEF, ARM, GX, GY, LIMIT, SINCE, EXTERNAL, BASE, PATH = 0, 24, 25, 26, 27, 28, 29, 30, 39


@non_allocating
def enter(members, terms, m, lanes, tip, path, j, lane, energy):  # type: ignore[no-untyped-def]
    """Put member m into lane j: parameters, state at the start, clock (CLOCK,) and energies (4,)."""
    k = len(ln.MEMBERS)
    n = members.links.shape[2]
    whole = members.whole[m]
    ln.load_lane(ln.MEMBERS, j, chain_of(members, terms, m, whole[GRAVITY_X], whole[GRAVITY_Y]), lanes, tip)
    for i in range(n):
        row = lanes[(i + 1) * ln.ROW * k : (i + 2) * ln.ROW * k]
        row[ln.LEVER * k + j] = members.links[m, LEVER, i]
        row[ln.Q_START * k + j] = members.start[m, i]
        row[ln.W_START * k + j] = members.start[m, n + i]
        row[ln.SIN_START * k + j], row[ln.COS_START * k + j] = sincos(members.start[m, i])
    path[ARM * k + j], path[LIMIT * k + j] = whole[ARM_LENGTH], whole[TORQUE_LIMIT]
    path[GX * k + j], path[GY * k + j] = whole[GRAVITY_X], whole[GRAVITY_Y]
    energy[0], energy[1] = members.start[m, 2 * n], members.start[m, 2 * n + 1]
    lane[:] = 0.0
    lane[TIME] = lane[END] = terms.begin
    lane[STEP], lane[AFTER], lane[CHATTER] = members.clock[m]


@non_allocating
def save_clock(members, m, lane):  # type: ignore[no-untyped-def]
    """Keep what member m, in the lane with the clock `lane` (CLOCK,), needs to go on."""
    members.clock[m, 0], members.clock[m, 1], members.clock[m, 2] = lane[STEP], lane[AFTER], lane[CHATTER]


@non_allocating
def piece(members, m, t, path, j, lane):  # type: ignore[no-untyped-def]
    """Find the piece of member m's drive that holds from t on; copies its coefficients, notes its origin and end."""
    k = len(ln.MEMBERS)
    which, still, lane[ORIGIN], lane[END] = find_piece(members, m, t)
    for channel in range(4):
        coef = members.coef[which, channel]
        for power in range(6):
            path[(COEF + channel * 6 + power) * k + j] = 0.0 if still >= 0.0 else coef[power]
        if still >= 0.0 and channel != TORQUE:
            path[(COEF + channel * 6) * k + j] = polynomial(coef, still)[0]


@non_allocating
def find_piece(members, m, t):  # type: ignore[no-untyped-def]
    """Row of ``members.coef`` that holds for member m from t on, time at which it stands still there, origin and end.

    The second is negative where the drive does not stand still.
    """
    first = members.first[m]
    count = members.first[m + 1] - first - 1
    breaks = members.breaks[first : first + count + 1]
    t += ROUNDING * (1.0 + abs(t))  # as in drive.segment
    if t < breaks[0] or (t >= breaks[count] and members.loop[m] < 0):  # standing still
        if t < breaks[0]:
            return first, 0.0, t, breaks[0]
        return first + count - 1, breaks[count] - breaks[count - 1], t, np.inf
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
    return first + j, -1.0, offset + breaks[j], offset + breaks[j + 1]


@inlined
def lane_polynomial(path, k, j, channel, t):  # type: ignore[no-untyped-def]
    """Value, first and second derivative at t of a channel of lane j, as ``drive.polynomial``."""
    i = (COEF + 6 * channel) * k + j
    return polynomial((path[i], path[i + k], path[i + 2 * k], path[i + 3 * k], path[i + 4 * k], path[i + 5 * k]), t)


@non_allocating
def base_motion(width, path):  # type: ignore[no-untyped-def]
    """Torque on link 0 (EXTERNAL) and motion of the first joint (BASE) in every lane, at the time SINCE."""
    k = len(width)
    for j in range(k):
        t = path[SINCE * k + j]
        angle, rate, alpha = lane_polynomial(path, k, j, ANGLE, t)
        x, vx, ax = lane_polynomial(path, k, j, X, t)
        y, vy, ay = lane_polynomial(path, k, j, Y, t)
        torque, _, _ = lane_polynomial(path, k, j, TORQUE, t)
        limit = path[LIMIT * k + j]
        torque = limit if torque > limit else torque
        path[EXTERNAL * k + j] = -limit if torque < -limit else torque
        sin, cos = sincos(angle)
        length = path[ARM * k + j]
        path[BASE * k + j] = ax + length * (cos * alpha - sin * rate * rate) - path[GX * k + j]
        path[(BASE + 1) * k + j] = ay + length * (sin * alpha + cos * rate * rate) - path[GY * k + j]
        path[(BASE + 2) * k + j] = alpha
        path[(BASE + 3) * k + j] = rate
        path[(BASE + 4) * k + j] = angle
        path[(BASE + 5) * k + j] = vx + length * cos * rate
        path[(BASE + 6) * k + j] = vy + length * sin * rate
        path[(BASE + 7) * k + j] = x + length * sin
        path[(BASE + 8) * k + j] = y - length * cos


@inlined
def chain_of(members, terms, m, gx, gy):  # type: ignore[no-untyped-def]
    """Chain of member m in the gravity (gx, gy), m/s^2."""
    return chain_of_rows(members.links[m], members.whole[m, TIP_MASS], gx, gy, terms.reaction)


@non_allocating
def observe_block(members, terms, low, high, t, y, kinetic, potential, joint, trig):  # type: ignore[no-untyped-def]
    """Energies and first joints of members low..high - 1 at times t (T,) and states y (high - low, T, 2 n + 2).

    Outputs: kinetic, potential (high - low, T), J; joint (high - low, T, 2), position of the first joint, m. `trig`
    (2 n,) is scratch.
    """
    n = members.links.shape[2]
    for m in range(low, high):
        whole = members.whole[m]
        chain = chain_of(members, terms, m, whole[GRAVITY_X], whole[GRAVITY_Y])
        for k in range(t.size):
            which, still, origin, _ = find_piece(members, m, t[k])
            since = still if still >= 0.0 else t[k] - origin
            angle, rate, _ = polynomial(members.coef[which, ANGLE], since)
            x, vx, _ = polynomial(members.coef[which, X], since)
            yy, vy, _ = polynomial(members.coef[which, Y], since)
            if still >= 0.0:
                rate = vx = vy = 0.0
            sin, cos = sincos(angle)
            reach = whole[ARM_LENGTH]
            x += reach * sin
            yy -= reach * cos
            joint[m - low, k, 0], joint[m - low, k, 1] = x, yy
            state = y[m - low, k]
            base = (x, yy, vx + reach * cos * rate, vy + reach * sin * rate, angle, rate)
            kinetic[m - low, k], potential[m - low, k] = energies(chain, state[:n], state[n : 2 * n], base, trig)
