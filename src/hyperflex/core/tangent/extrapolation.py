"""Directions of a derivative (changes of chain, drive and base motion), and the tangent of an extrapolated step."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core.assign import assign
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import Array, sincos, sines
from hyperflex.core.chain.drive import ANGLE, TORQUE, X, Y, polynomial, segment, within
from hyperflex.core.integrate.steps import begin_columns, end_columns
from hyperflex.core.jit import inlined, kernel, non_allocating, zeros
from hyperflex.core.tangent import air as dg
from hyperflex.core.tangent import step as tg
from hyperflex.core.tangent.step import K

TIP_MASS, GRAVITY_X, GRAVITY_Y = range(3)  # columns of Directions.whole
# what base_change writes
ACC_X, ACC_Y, ALPHA, RATE, TURN, MOTOR, PLACE_X, PLACE_Y, SPEED_X, SPEED_Y = range(10)
CHANGES = 10


class Directions(NamedTuple):
    """Changes of everything that a run depends on but its start; p = 2 b directions, in b pairs."""

    links: Array  # (b, 2, n, SEEDS): of the links' parameters, see core/tangent/step.py
    whole: Array  # (p, 3): of tip mass, kg, and gravity, m/s^2
    parameters: npt.NDArray[np.bool_]  # (b,) whether links, or the torque on the first one, change
    driven: npt.NDArray[np.int64]  # (p,) row of the following that changes the drive, -1: none does
    breaks: Array  # (m, k + 1), s
    coef: Array  # (m, k, 4, 6)
    arm: Array  # (m,) of the arm's length, m


@kernel
def cycle_shift(drive, part, breaks):  # type: ignore[no-untyped-def]
    """Change of the beginning of the period that the Segment `part` lies in, s; `breaks` (k + 1,) as in Directions."""
    if part.offset == 0.0:
        return 0.0
    last, first = drive.breaks.size - 1, drive.loop
    cycle = round(part.offset / (drive.breaks[last] - drive.breaks[first]))
    return cycle * (breaks[last] - breaks[first])


@non_allocating
def end_shift(drive, part, breaks):  # type: ignore[no-untyped-def]
    """Change of the time at which the Segment `part` ends, s."""
    return cycle_shift(drive, part, breaks) + breaks[part.last + 1]


@inlined
def moved(c, dc, s, ds):  # type: ignore[no-untyped-def]
    """Change of a polynomial c (6,), of its rate and of its second derivative at s by dc (6,) and ds."""
    _, rate, second = polynomial(c, s)
    third = 6.0 * c[3] + s * (24.0 * c[4] + s * 60.0 * c[5])
    value, slope, bend = polynomial(dc, s)
    return value + rate * ds, slope + second * ds, bend + third * ds


@non_allocating
def base_change(drive, part, t, shift, directions, m, out):  # type: ignore[no-untyped-def]
    """Change of the first joint's motion at time t within the Segment `part`.

    Parameters
    ----------
    drive, part, directions : Drive, Segment, Directions
    t, shift : float, s, and its own change
    m : int, row of ``directions.breaks``, ``coef`` and ``arm``
    out : (CHANGES,) out: acceleration x, y (m/s^2); of the arm alpha (rad/s^2), rate, angle; motor torque (N m);
        position x, y (m); velocity x, y (m/s)
    """
    j, s, still = within(drive, part, t)
    breaks = directions.breaks[m]
    k = drive.breaks.size - 1
    if still:
        ds = breaks[k] - breaks[k - 1] if s > 0.0 else 0.0
    else:
        ds = shift - cycle_shift(drive, part, breaks) - breaks[j]
    angle, rate, alpha = polynomial(drive.coef[j, ANGLE], s)
    turn, d_rate, d_alpha = moved(drive.coef[j, ANGLE], directions.coef[m, j, ANGLE], s, ds)
    x, vx, ax = moved(drive.coef[j, X], directions.coef[m, j, X], s, ds)
    y, vy, ay = moved(drive.coef[j, Y], directions.coef[m, j, Y], s, ds)
    torque = polynomial(drive.coef[j, TORQUE], s)[0]
    motor = moved(drive.coef[j, TORQUE], directions.coef[m, j, TORQUE], s, ds)[0]
    if still:
        rate = alpha = d_rate = d_alpha = vx = vy = ax = ay = motor = 0.0
    if abs(torque) >= drive.torque_limit:
        motor = 0.0
    sin, cos = sincos(angle)
    length, longer = drive.arm_length, directions.arm[m]
    zx, zy = cos * alpha - sin * rate * rate, sin * alpha + cos * rate * rate
    out[ACC_X] = ax + longer * zx + length * (cos * d_alpha - zy * turn - 2.0 * sin * rate * d_rate)
    out[ACC_Y] = ay + longer * zy + length * (sin * d_alpha + zx * turn + 2.0 * cos * rate * d_rate)
    out[ALPHA] = d_alpha
    out[RATE] = d_rate
    out[TURN] = turn
    out[MOTOR] = motor
    out[PLACE_X] = x + longer * sin + length * cos * turn
    out[PLACE_Y] = y - longer * cos + length * sin * turn
    out[SPEED_X] = vx + (longer * rate + length * d_rate) * cos - length * sin * turn * rate
    out[SPEED_Y] = vy + (longer * rate + length * d_rate) * sin + length * cos * turn * rate


@kernel
def place_changes(drive, directions, t, out):  # type: ignore[no-untyped-def]
    """Change of the first joint's position at times t (T,) to out (T, 2, p), m."""
    moved = np.zeros(CHANGES)
    for k in range(t.size):
        part = segment(drive, t[k])
        for x, m in enumerate(directions.driven):
            if m >= 0:
                base_change(drive, part, t[k], 0.0, directions, m, moved)
                out[k, 0, x], out[k, 1, x] = moved[PLACE_X], moved[PLACE_Y]


CELL = 4 * K  # a pair's numbers of one link in the lanes: angle and rate, two directions each
START, NOW, SUM = 0, CELL, 2 * CELL  # the parts of what is kept of them
PARTS = 3


class TangentWorkspace(NamedTuple):
    """Working arrays of a replay; b pairs of directions, p = 2 b."""

    lanes: Array  # ((n + 2) ROW K,), and its last row
    tip: Array
    base: Array  # (9, K)
    work: Array  # (6 n,)
    errors: Array  # (2, 2 n + 2)
    store: Array  # (b, n PARTS CELL) derivatives in every lane: at the start of the step, now, summed over the columns
    weight: Array  # (CELL,) of each lane's column in the sum, where it is complete
    anew: Array  # (CELL,) 1.0 where a lane begins a column, else 0.0
    shift: Array  # (p,) change of the time at which the step starts, s
    change: Array  # (p,) change of its length, s
    stretch: Array  # (p,) the same as a part of its length
    into: Array  # (K,) how far each lane is within the step, as a part of it
    when: Array  # (K,) time of each lane, s
    moved: Array  # (CHANGES,)
    ys: Array  # (3, 2 n + 2) states at the beginning, middle and end of a step, and their derivatives in time
    dys: Array
    nodes: Array  # (3, 2 n, p) derivatives of angles and rates there
    bends: Array  # (3, n, p) of accelerations
    out: Array  # (2 n + 2,) result of a step
    air: Array  # ((n + 2) ROW K,) as in tangent.air; empty without drag


@kernel
def new_tangent_workspace(chain, pairs):  # type: ignore[no-untyped-def]
    """Working arrays for a chain and a number of pairs."""
    n = chain.length.size
    lanes, tip = ln.rows(ln.COLUMNS, n)
    ln.load(ln.COLUMNS, chain, lanes, tip)
    p, width, of_pairs = 2 * pairs, 2 * n + 2, (pairs, n * PARTS * CELL)
    step = zeros((9, K), 6 * n, (2, width), of_pairs, CELL, CELL, p, p, p, K, K, CHANGES, (3, width), (3, width))
    nodes = zeros((3, 2 * n, p), (3, n, p), width)
    return TangentWorkspace(lanes, tip, *step, *nodes, dg.new_air(chain))  # type: ignore[call-arg]


@non_allocating
def set_ends(drive, part, directions, b, workspace):  # type: ignore[no-untyped-def]
    """Put the changes of the base's motion and of the tip mass into the first and the last row of the lanes."""
    lanes, moved, air = workspace.lanes, workspace.moved, workspace.air
    beyond = lanes.size - ln.ROW * K
    far = lanes[beyond - ln.ROW * K : beyond]
    for d in range(2):
        moved[:] = 0.0
        x = 2 * b + d
        m, (heavier, gx, gy) = directions.driven[x], directions.whole[x]
        for j in range(K):
            if m >= 0:
                late = workspace.shift[x] + workspace.into[j] * workspace.change[x]
                base_change(drive, part, workspace.when[j], late, directions, m, moved)
            at = d * K + j
            lanes[at + tg.DQ * K], lanes[at + tg.DW * K], lanes[at + tg.ALPHA * K] = (
                moved[TURN],
                moved[RATE],
                moved[ALPHA],
            )
            lanes[at + tg.PX * K], lanes[at + tg.PY * K] = moved[ACC_X] - gx, moved[ACC_Y] - gy
            lanes[at + tg.RHS * K] = moved[MOTOR]
            if air.size > 0:
                air[at + dg.DVX * K], air[at + dg.DVY * K] = moved[SPEED_X], moved[SPEED_Y]
            lanes[beyond + at + tg.BX * K] = heavier * far[ln.PX * K + j]
            lanes[beyond + at + tg.BY * K] = heavier * far[ln.PY * K + j]


@non_allocating
def enter(lanes, own, anew, begins):  # type: ignore[no-untyped-def]
    """Put the derivatives of a pair, `own` (n PARTS CELL,), into the lanes, from their start where a column begins."""
    n = own.size // (PARTS * CELL)
    for i in range(n):
        cell = lanes[((i + 1) * ln.ROW + tg.DQ) * K : ((i + 1) * ln.ROW + tg.DQ) * K + CELL]
        kept = own[i * PARTS * CELL : (i + 1) * PARTS * CELL]
        if begins:
            for x in range(anew.size):  # a length that the compiler does not know: it would write a short loop out
                cell[x] = kept[NOW + x] + anew[x] * (kept[START + x] - kept[NOW + x])
        else:
            for x in range(CELL):
                cell[x] = kept[NOW + x]


@non_allocating
def leave(lanes, own, weight, ends):  # type: ignore[no-untyped-def]
    """Take the derivatives of one pair out of the lanes, and add the columns that are complete to their sum."""
    n = own.size // (PARTS * CELL)
    for i in range(n):
        cell = lanes[((i + 1) * ln.ROW + tg.DQ) * K : ((i + 1) * ln.ROW + tg.DQ) * K + CELL]
        kept = own[i * PARTS * CELL : (i + 1) * PARTS * CELL]
        if ends:
            for x in range(weight.size):
                kept[SUM + x] += weight[x] * cell[x]
        for x in range(CELL):
            kept[NOW + x] = cell[x]


@non_allocating
def set_start(values, store):  # type: ignore[no-untyped-def]
    """Make derivatives (2 n, p) the start in every lane of `store` (b, n PARTS CELL)."""
    n = values.shape[0] // 2
    for b in range(store.shape[0]):
        for i in range(n):
            cell = store[b, i * PARTS * CELL : (i * PARTS + 1) * CELL]
            for j in range(K):
                cell[j] = values[i, 2 * b]
                cell[K + j] = values[i, 2 * b + 1]
                cell[2 * K + j] = values[n + i, 2 * b]
                cell[3 * K + j] = values[n + i, 2 * b + 1]


@non_allocating
def sum_columns(store, values):  # type: ignore[no-untyped-def]
    """Sum the lanes of the sums in `store` to derivatives (2 n, p), and set them back."""
    n = values.shape[0] // 2
    for b in range(store.shape[0]):
        for i in range(n):
            cell = store[b, (i * PARTS + 2) * CELL : (i + 1) * PARTS * CELL]
            for x in range(4):
                part = 0.0
                for j in range(K):
                    part += cell[x * K + j]
                values[i + n * (x // 2), 2 * b + x % 2] = part
            cell[:] = 0.0


@non_allocating
def begin_pairs(reaction, lanes, air, base):  # type: ignore[no-untyped-def]
    """Work out what the pairs have in common, after a step of ``lanes.euler``."""
    tg.prepare(reaction, lanes)
    if air.size > 0:
        dg.begin(lanes, base, air)


@non_allocating
def step_pair(reaction, lanes, air, links, stretch):  # type: ignore[no-untyped-def]
    """Derivatives of that step for changes of everything, see ``step.step``."""
    if air.size > 0:
        dg.write_torques(lanes, air, links)
    tg.step(reaction, tg.ALL, lanes, links, stretch)


@kernel
def tangent_step(chain, drive, part, table, t, step, y, out, directions, result, workspace):  # type: ignore[no-untyped-def]
    """One extrapolated step, as ``steps.extrapolate``, with the derivatives of its result.

    Parameters
    ----------
    chain, drive, part, table, directions : Chain, Drive, Segment, Scheme, Directions
    t, step : float, s
    y, out : (2 n + 2,) state before the step, and after it (out)
    result : (2 n, p) out, derivatives of the angles and rates after the step
    workspace : TangentWorkspace
        ``store`` holds the derivatives before the step, ``shift`` and ``change`` those of t and `step`
    """
    for x in range(workspace.stretch.size):
        workspace.stretch[x] = workspace.change[x] / step
    n = chain.length.size
    assign(out, y)
    sines(y[:n], workspace.work, 0)
    # by name: to take an array out of a tuple within the loop over the pairs costs as much as a third of the step
    lanes, store, anew, weight = workspace.lanes, workspace.store, workspace.anew, workspace.weight
    reaction = chain.reaction
    own, links, stretch, air = directions.parameters, directions.links, workspace.stretch, workspace.air
    for turn in range(table.column.shape[0]):
        begin_columns(chain, drive, part, table, turn, t, step, y, lanes, workspace.tip, workspace.base, workspace.work)
        tg.save_trig(lanes)
        ln.euler(ln.COLUMNS, reaction, ln.MORE, lanes, workspace.tip, workspace.base)
        begin_pairs(reaction, lanes, air, workspace.base)
        for x in range(CELL):
            col, done = table.column[turn, x % K], table.done[turn, x % K]
            weight[x] = table.best[col] if col > 0 and done == col - 1 else 0.0
            anew[x] = 1.0 if turn == 0 or (col > 0 and done == 0) else 0.0
        for j in range(K):
            workspace.into[j] = table.done[turn, j] / max(table.column[turn, j], 1)
            workspace.when[j] = t + workspace.into[j] * step
        begins, ends = anew.any(), weight.any()
        for b in range(own.size):
            enter(lanes, store[b], anew, begins)
            set_ends(drive, part, directions, b, workspace)
            longer = stretch[2 * b : 2 * b + 2]
            if air.size > 0 or own[b] or longer[0] != 0.0 or longer[1] != 0.0:
                step_pair(reaction, lanes, air, links[b], longer)
            else:
                tg.step(reaction, tg.STATE, lanes, links[b], longer)
            leave(lanes, store[b], weight, ends)
        end_columns(table, turn, y, out, workspace.errors, lanes, workspace.work[2 * n : 4 * n + 2])
    sum_columns(workspace.store, result)
