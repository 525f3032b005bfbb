"""The run loop: error control, restarts at switches, output between steps, a mark to go on from."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core import lanes as ln
from hyperflex.core import status
from hyperflex.core.chain import Array, accelerations, energies, sines
from hyperflex.core.drive import base_state, segment
from hyperflex.core.jit import kernel
from hyperflex.core.steppers import extrapolate, rates, runge_kutta
from hyperflex.core.stepsize import LARGEST_STEP, SMALLEST_STEP, allowed, fitted, lasting, longer, shorter


class Limits(NamedTuple):
    """What bounds a run."""

    stop: float  # s, run until here
    tol: float  # m, error allowed in the position of any joint, of a step and of SHARE seconds
    lever: Array  # (n,) m, how far a link's angle moves mass: the larger of its length and its radius of gyration
    reach: float  # m, length of the chain
    fall: float  # J, weight times length: the scale of the chain's energy at rest
    fixed: float  # s, fixed Runge-Kutta step; 0.0: extrapolation with error control
    budget: int  # steps of one call, so that callers can show progress and be interrupted


class Progress(NamedTuple):
    """Where a run is; all arrays are changed in place."""

    y: Array  # (2 n + 2,) angles, rates, work put in, energy dissipated
    mark: Array  # (2 n + 2,) the state before the first step that was cut short to end at `stop`
    clock: Array  # (CLOCK,) see the names below; the mark's time is -inf while no step has been cut
    log: Array  # (m, 2) length and end of the first m steps that succeed, s


# AFTER: first step that succeeded after the last switch, where the motion is least smooth; tried first at the next one
# FRESH: 1.0 from a switch until a step has succeeded behind it
# LAST, SIZE: length and error of the last step that succeeded since the last switch; LAST is 0.0 where there is none
# MARK: where these six stand again as they were at the mark
T, STEP, AFTER, FRESH, LAST, SIZE, MARK = range(7)
INDEX, TAKEN, REJECTED, CLOCK = range(2 * MARK, 2 * MARK + 4)
ENERGY = 10.0  # see error_norm
TINY = 1e-300  # J, keeps a chain without weight and motion from dividing by zero


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


@kernel
def error_norm(chain, limits, y, error, step, work):  # type: ignore[no-untyped-def]
    """Error of a step in units of what is allowed: of any joint's position, of its velocity, of energy.

    Work and dissipation may err by ENERGY tol / reach of the chain's energy. Without that bound sharp dry friction,
    which hardly moves a joint while it changes sign, would leave the energy balance unchecked. `work` is (6 n,)
    scratch.
    """
    n = chain.length.size
    sines(y[:n], work, 0)
    x = vx = z = vz = worst = 0.0
    ux = uz = kinetic = 0.0  # velocity of the joint and the links' energy, both as seen from the chain's first joint
    time = lasting(step)
    for i in range(n):
        sin, cos = work[i], work[n + i]
        a = limits.lever[i] * error[i]
        b = limits.lever[i] * error[n + i] * time
        x += cos * a
        z += sin * a
        vx += cos * b
        vz += sin * b
        position, velocity = x * x + z * z, vx * vx + vz * vz
        if not (position + velocity < np.inf):  # also where it is not a number, which max would pass over
            return np.inf
        worst = max(worst, position, velocity)
        w = y[n + i]
        cx, cz = ux + chain.com[i] * cos * w, uz + chain.com[i] * sin * w
        kinetic += 0.5 * (chain.mass[i] * (cx * cx + cz * cz) + chain.inertia[i] * w * w)
        ux += chain.length[i] * cos * w
        uz += chain.length[i] * sin * w
    kinetic += 0.5 * chain.tip_mass * (ux * ux + uz * uz)
    energy = abs(error[2 * n] - error[2 * n + 1]) * limits.reach / (ENERGY * (limits.fall + kinetic) + TINY)
    if not (energy < np.inf):
        return np.inf
    return max(math.sqrt(worst), energy) / allowed(limits.tol, step)


@kernel
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

    Angles follow the polynomial of degree 8 through angles, rates and accelerations; rates are its derivative; work
    and dissipation follow one of degree 5. Not for the step behind a switch, where friction settles (docs/models.md).
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


@kernel
def switched(clock):  # type: ignore[no-untyped-def]
    """Note that the motion switches here: the next step is no longer than what succeeded after the last switch."""
    clock[STEP] = min(clock[STEP], clock[AFTER])
    clock[FRESH] = 1.0
    clock[LAST] = 0.0


class Scratch(NamedTuple):
    """Working arrays of a run."""

    out: Array  # (2 n + 2,) state after the step
    error: Array  # (2 n + 2,)
    ys: Array  # (3, 2 n + 2) states at the beginning, middle and end of a step, and their derivatives
    dys: Array
    stage: Array  # (3, 2 n + 2)
    work: Array  # (6 n,)
    grip: Array  # (n,) as in chain.accelerations
    base: Array  # (9, lanes)
    lanes: Array  # ((n + 2) ROW lanes,)
    tip: Array  # (ROW lanes,)


@kernel
def scratch(chain):  # type: ignore[no-untyped-def]
    """Working arrays for a chain, its parameters loaded into the lanes."""
    n = chain.length.size
    lanes, tip = ln.rows(ln.COLUMNS, n)
    ln.load(ln.COLUMNS, chain, lanes, tip)
    return Scratch(
        np.empty(2 * n + 2),
        np.zeros(2 * n + 2),
        np.empty((3, 2 * n + 2)),
        np.empty((3, 2 * n + 2)),
        np.empty((3, 2 * n + 2)),
        np.empty(6 * n),
        np.ones(n),
        np.zeros((9, len(ln.COLUMNS))),
        lanes,
        tip,
    )


@kernel
def advance(chain, drive, part, table, fixed, t, step, y, out, room):  # type: ignore[no-untyped-def]
    """Take one step of the wanted integrator from y at t to `out`; `room` is a Scratch."""
    if fixed > 0.0:
        runge_kutta(chain, drive, part, t, step, y, room.grip, out, room.stage, room.work)
    else:
        extrapolate(chain, drive, part, table, t, step, y, out, room.error, room.lanes, room.tip, room.base, room.work)


@kernel
def write_until(clock, t_out, t, y, y_out):  # type: ignore[no-untyped-def]
    """Write state y to every output up to time t that is not written yet."""
    while clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] <= t:
        y_out[int(clock[INDEX])] = y
        clock[INDEX] += 1


@kernel
def write_between(chain, drive, part, table, fixed, clock, step, room, t_out, y, y_out):  # type: ignore[no-untyped-def]
    """Write the outputs strictly within the step from y at clock[T] to ``room.out``."""
    t = clock[T]
    end = t + step
    if clock[INDEX] >= t_out.size or t_out[int(clock[INDEX])] >= end:
        return
    ys, dys = room.ys, room.dys
    ys[0], ys[2] = y, room.out
    while clock[FRESH] == 1.0 and clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] < end:
        index = int(clock[INDEX])
        advance(chain, drive, part, table, fixed, t, t_out[index] - t, y, y_out[index], room)
        clock[INDEX] += 1
    advance(chain, drive, part, table, fixed, t, 0.5 * step, y, ys[1], room)
    for k in range(3):
        rates(chain, drive, part, t + 0.5 * k * step, ys[k], room.grip, dys[k], room.work)
    while clock[INDEX] < t_out.size and t_out[int(clock[INDEX])] < end:
        index = int(clock[INDEX])
        interpolate(2.0 * (t_out[index] - t) / step - 1.0, step, ys, dys, y_out[index])
        clock[INDEX] += 1


@kernel
def mark_here(progress):  # type: ignore[no-untyped-def]
    """Remember the state from which an unbroken run would go on (unless an earlier one is remembered)."""
    clock = progress.clock
    if clock[MARK] == -np.inf:
        progress.mark[:] = progress.y
        clock[MARK : 2 * MARK] = clock[:MARK]


@kernel
def run(chain, drive, table, limits, progress, t_out, y_out):  # type: ignore[no-untyped-def]
    """Run until ``limits.stop`` or until the budget is spent; O(n) a step.

    Parameters
    ----------
    chain, drive, table, limits, progress : Chain, Drive, Scheme, Limits, Progress
    t_out : (m,) increasing times, s, at which to write the state
    y_out : (m, 2 n + 2) out; row k is written once the run has passed t_out[k]

    Returns
    -------
    int : OK, RUNNING (call again), STEP_TOO_SMALL or NOT_FINITE; `progress` tells how far it came.
    """
    y, clock = progress.y, progress.clock
    room = scratch(chain)
    fixed = limits.fixed
    write_until(clock, t_out, clock[T], y, y_out)
    part = segment(drive, clock[T])
    for _ in range(limits.budget):
        t = clock[T]
        if t >= limits.stop:
            break
        if t >= part.end:
            part = segment(drive, t)
        end = min(part.end, limits.stop)
        wanted = fixed if fixed > 0.0 else min(clock[STEP], LARGEST_STEP)
        step = fitted(wanted, end - t) if fixed == 0.0 else min(wanted, end - t)
        cut = step >= end - t
        if step < wanted and limits.stop < part.end:
            mark_here(progress)
        advance(chain, drive, part, table, fixed, t, step, y, room.out, room)
        clock[TAKEN] += 1
        if fixed > 0.0:
            size = 0.0 if np.abs(room.out).max() < np.inf else np.inf
        else:
            size = error_norm(chain, limits, room.out, room.error, step, room.work)
            if cut and step < SMALLEST_STEP and size < np.inf:
                size = 0.0  # an end a few rounding errors away: there is nothing to control
        if not (size <= 1.0):
            clock[REJECTED] += 1
            clock[STEP] = shorter(step, size, table.order)
            if fixed > 0.0:
                return status.NOT_FINITE
            if clock[STEP] < SMALLEST_STEP:
                return status.STEP_TOO_SMALL
            continue
        t_new = end if cut else t + step
        succeeded = int(clock[TAKEN] - clock[REJECTED]) - 1
        if succeeded < progress.log.shape[0]:
            progress.log[succeeded, 0], progress.log[succeeded, 1] = step, t_new
        write_between(chain, drive, part, table, fixed, clock, t_new - t, room, t_out, y, y_out)
        y[:] = room.out
        clock[T] = t_new
        write_until(clock, t_out, t_new, y, y_out)
        if fixed == 0.0:
            grown = longer(step, size, clock[LAST], clock[SIZE], table.order)
            clock[STEP] = max(grown, clock[STEP]) if step < wanted else grown
            clock[LAST], clock[SIZE] = step, size
            if clock[FRESH] == 1.0:
                clock[AFTER] = clock[STEP]
                clock[FRESH] = 0.0
            if t_new >= part.end:
                switched(clock)
    return status.RUNNING if clock[T] < limits.stop else status.OK


@kernel
def observe(chain, drive, t, y, qdd, base_out, scalars):  # type: ignore[no-untyped-def]
    """What a run looks like at given states: accelerations, base motion, energies, motor torque.

    Parameters
    ----------
    t : (m,) times, s; y : (m, 2 n + 2) states
    qdd : (m, n) out, rad/s^2
    base_out : (m, 9) out, motion of the first joint (``drive.base_state``)
    scalars : (m, 5) out: kinetic and potential energy, J; force x, y on the rope, N, and torque through joint 0, N m
    """
    n = chain.length.size
    work, grip = np.empty(6 * n), np.ones(n)
    for k in range(t.size):
        base = base_out[k]
        torque = base_state(drive, segment(drive, t[k]), t[k], base)
        q, w = y[k, :n], y[k, n : 2 * n]
        fx, fy, moment = accelerations(chain, q, w, grip, base[:7], torque, 0.0, qdd[k], work)
        kinetic, potential = energies(chain, q, w, (base[7], base[8], base[5], base[6], base[4], base[3]))
        scalars[k, 0], scalars[k, 1] = kinetic, potential
        scalars[k, 2], scalars[k, 3], scalars[k, 4] = fx, fy, moment + torque
