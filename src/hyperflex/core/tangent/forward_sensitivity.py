"""Forward sensitivity of a recorded run along any directions: changes of chain, drive and base, outputs and events.

The steps are unchanged, so the result is the derivative of the computed run: each step keeps its length, except a step
that ends at a switch, at an event or at an output whose time depends on a direction.

A stuck joint keeps its angle in every direction. A step that ends at an event lasts until the event's margin is zero
(``integrate.events``), so its length has a derivative: minus that of the margin over the margin's slope. The slope is
the derivative along one more direction, the last but one, in which only the step's length changes.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core.assign import assign, assign_rows
from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import BASE_SIZE, Array, sincos, sines
from hyperflex.core.chain.drive import ANGLE, TORQUE, X, Y, base_size, base_state, polynomial, segment, within
from hyperflex.core.integrate.observation import enter_state
from hyperflex.core.integrate.rollout import DEGREE, END, JOINT, LENGTH, MODES
from hyperflex.core.integrate.steps import ERRORS, basis, begin_columns, end_columns, rates
from hyperflex.core.jit import inlined, kernel, non_allocating, read, write, zeros
from hyperflex.core.stiction import (
    STICTION,
    StictionWorkspace,
    at_rest,
    constraint_torques,
    margins,
    new_stiction_workspace,
    project_stuck,
    stop_joints,
    stops,
)
from hyperflex.core.tangent import air as dg
from hyperflex.core.tangent import step as tg
from hyperflex.core.tangent.step import K

TIP_MASS, GRAVITY_X, GRAVITY_Y = range(3)  # columns of Directions.whole
# what base_change writes
ACC_X, ACC_Y, ALPHA, RATE, TURN, MOTOR, PLACE_X, PLACE_Y, SPEED_X, SPEED_Y = range(10)
CHANGES = 10


class Directions(NamedTuple):
    """Changes of all inputs of a run except its start; p = 2 b directions, in b pairs."""

    links: Array  # (b, 2, n, SEEDS): of the links' parameters, see core/tangent/step.py
    whole: Array  # (p, 3): of tip mass, kg, and gravity, m/s^2
    parameters: npt.NDArray[np.bool_]  # (b,) whether links, or the torque on the first one, change
    driven: npt.NDArray[np.int64]  # (p,) row of the following arrays that changes the drive, -1: none
    breaks: Array  # (m, k + 1), s
    coef: Array  # (m, k, 4 or more, 6)
    arm: Array  # (m,) of the arm's length, m


@kernel
def cycle_shift(drive, part, breaks):  # type: ignore[no-untyped-def]
    """Change of the beginning of the period that the Segment `part` lies in, s; `breaks` (k + 1,) as in Directions."""
    if part.offset == 0.0:
        return 0.0
    last, first = drive.breaks.size - 1, drive.loop
    cycle = round(part.offset / (drive.breaks[last] - drive.breaks[first]))
    return cycle * (breaks[last] - breaks[first])


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
    out : (CHANGES or more,) out: acceleration x, y (m/s^2); of the arm alpha (rad/s^2), rate, angle; motor torque
        (N m); position x, y (m); velocity x, y (m/s); then, if `out` is large enough, torques on the links as in
        ``base_state``
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
    beyond = 0.0
    for i in range(out.size - 1, CHANGES - 1, -1):
        channel = TORQUE + i - CHANGES
        change = moved(drive.coef[j, channel], directions.coef[m, j, channel], s, ds)[0]
        own = change if i > CHANGES and not still else 0.0
        out[i] = own - beyond
        beyond = own
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
START, NOW, SUM = 0, CELL, 2 * CELL  # the stored parts
PARTS = 3


class TangentWorkspace(NamedTuple):
    """Working arrays of a replay; b pairs of directions, p = 2 b."""

    lanes: Array  # ((n + 2) ROW K,), and its last row
    tip: Array
    base: Array  # (9 or more, K)
    work: Array  # (6 n,)
    errors: Array  # (ERRORS, 2 n + 2)
    store: Array  # (b, n PARTS CELL) derivatives in every lane: at the start of the step, now, summed over the columns
    weight: Array  # (CELL,) weight of each lane's column in the sum, if it is complete
    anew: Array  # (CELL,) 1.0 where a lane begins a column, else 0.0
    shift: Array  # (p,) change of the time at which the step starts, s
    change: Array  # (p,) change of its length, s
    stretch: Array  # (p,) relative change of its length
    into: Array  # (K,) elapsed fraction of the step in each lane
    when: Array  # (K,) time of each lane, s
    moved: Array  # (CHANGES or more,)
    ys: Array  # (3, 2 n + 2) states at the beginning, middle and end of a step, and their derivatives in time
    dys: Array
    nodes: Array  # (3, 2 n, p) derivatives of angles and rates there
    bends: Array  # (3, n, p) of accelerations
    out: Array  # (2 n + 2,) result of a step
    air: Array  # ((n + 2) ROW K,) as in tangent.air; empty without drag
    stiction: StictionWorkspace
    base_before: Array  # (9 or more,) motion of the first joint at the beginning of the step, and at another time
    base_after: Array
    moves_before: Array  # (p, CHANGES or more) its changes
    moves: Array


@kernel
def new_tangent_workspace(chain, drive, pairs):  # type: ignore[no-untyped-def]
    """Working arrays for a chain, its drive and a number of pairs."""
    n = chain.length.size
    lanes, tip = ln.rows(ln.COLUMNS, n)
    ln.load(ln.COLUMNS, chain, lanes, tip)
    p, width, of_pairs, base = 2 * pairs, 2 * n + 2, (pairs, n * PARTS * CELL), base_size(drive)
    changes = CHANGES + base - BASE_SIZE
    lanes[tg.MOTORS * K] = base - BASE_SIZE
    step = zeros(
        (base, K), 6 * n, (ERRORS, width), of_pairs, CELL, CELL, p, p, p, K, K, changes, (3, width), (3, width)
    )
    nodes = zeros((3, 2 * n, p), (3, n, p), width)
    ends = new_stiction_workspace(n), *zeros(base, base, (p, changes), (p, changes))
    return TangentWorkspace(lanes, tip, *step, *nodes, dg.new_air(chain), *ends)  # type: ignore[call-arg]


@non_allocating
def set_ends(drive, part, directions, b, workspace):  # type: ignore[no-untyped-def]
    """Put the changes of the base's motion, the motors' torques and the tip mass into the rows of the lanes."""
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
            write(lanes, K, at, (tg.DQ, tg.DW, tg.RHS), (moved[TURN], moved[RATE], moved[MOTOR]))
            write(lanes, K, at, (tg.PX, tg.PY, tg.ALPHA), (moved[ACC_X] - gx, moved[ACC_Y] - gy, moved[ALPHA]))
            for i in range(moved.size - CHANGES):
                lanes[((i + 1) * ln.ROW + tg.RHS) * K + at] = moved[CHANGES + i]
            if air.size > 0:
                write(air, K, at, (dg.DVX, dg.DVY), (moved[SPEED_X], moved[SPEED_Y]))
            px, py = read(far, K, j, (ln.PX, ln.PY))
            write(lanes, K, beyond + at, (tg.BX, tg.BY), (heavier * px, heavier * py))


@non_allocating
def enter(lanes, own, anew, begins):  # type: ignore[no-untyped-def]
    """Put the derivatives of a pair, `own` (n PARTS CELL,), into the lanes, initial ones where a column begins."""
    n = own.size // (PARTS * CELL)
    for i in range(n):
        cell = lanes[((i + 1) * ln.ROW + tg.DQ) * K : ((i + 1) * ln.ROW + tg.DQ) * K + CELL]
        kept = own[i * PARTS * CELL : (i + 1) * PARTS * CELL]
        if begins:
            for x in range(anew.size):  # a length unknown to the compiler, which would unroll a short loop
                cell[x] = kept[NOW + x] + anew[x] * (kept[START + x] - kept[NOW + x])
        else:
            for x in range(CELL):
                cell[x] = kept[NOW + x]


@non_allocating
def leave(lanes, own, weight, ends):  # type: ignore[no-untyped-def]
    """Take the derivatives of one pair out of the lanes, and add the complete columns to their sum."""
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
def set_start(nodes, store):  # type: ignore[no-untyped-def]
    """Make derivatives (m, 2 n, p) the start in the lanes of `store` (b, n PARTS CELL); further lanes get the last."""
    n = nodes.shape[1] // 2
    for b in range(store.shape[0]):
        for i in range(n):
            cell = store[b, i * PARTS * CELL : (i * PARTS + 1) * CELL]
            for j in range(K):
                values = nodes[min(j, nodes.shape[0] - 1)]
                cell[j] = values[i, 2 * b]
                cell[K + j] = values[i, 2 * b + 1]
                cell[2 * K + j] = values[n + i, 2 * b]
                cell[3 * K + j] = values[n + i, 2 * b + 1]


@non_allocating
def sum_columns(store, values):  # type: ignore[no-untyped-def]
    """Add up the lanes of the sums in `store` to derivatives (2 n, p), and reset them."""
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
    """Compute the quantities common to all pairs, after a step of ``lanes.euler``."""
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
    """One extrapolated step, like ``steps.extrapolate``, with the derivatives of its result.

    Parameters
    ----------
    chain, drive, part, table, directions : Chain, Drive, Segment, Scheme, Directions
    t, step : float, s
    y, out : (2 n + 2,) state before the step, and after it (out)
    result : (2 n, p) out, derivatives of the angles and rates after the step
    workspace : TangentWorkspace
        ``store`` contains the derivatives before the step, ``shift`` and ``change`` those of t and `step`
    """
    for x in range(workspace.stretch.size):
        workspace.stretch[x] = workspace.change[x] / step
    n = chain.length.size
    assign(out, y)
    sines(y[:n], workspace.work, 0)
    # by name: reading an array from a tuple within the loop over the pairs costs a third of the step
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


@kernel
def acceleration_derivatives(chain, drive, part, t, step, directions, workspace):  # type: ignore[no-untyped-def]
    """Accelerations at beginning, middle and end of a step, and their derivatives, from ``ys`` and ``nodes``."""
    n = chain.length.size
    lanes, ys, dys = workspace.lanes, workspace.ys, workspace.dys
    workspace.anew[:] = 1.0
    motion = np.empty(base_size(drive))
    for j in range(K):
        node = min(j, 2)
        workspace.into[j] = 0.5 * node
        workspace.when[j] = t + 0.5 * node * step
        torque = base_state(drive, part, workspace.when[j], motion)
        q, w = ys[node, :n], ys[node, n : 2 * n]
        sines(q, workspace.work, 0)
        enter_state(j, chain, q, w, workspace.work, motion, torque, lanes, workspace.tip, workspace.base)
    tg.save_trig(lanes)
    ln.euler(ln.COLUMNS, chain.reaction, ln.MORE, lanes, workspace.tip, workspace.base)
    begin_pairs(chain.reaction, lanes, workspace.air, workspace.base)
    for j in range(3):
        for i in range(n):
            dys[j, i] = ys[j, n + i]
            dys[j, n + i] = lanes[((i + 1) * ln.ROW + ln.ALPHA) * K + j]
    workspace.stretch[:] = 0.0
    set_start(workspace.nodes, workspace.store)
    for b in range(directions.parameters.size):
        enter(lanes, workspace.store[b], workspace.anew, True)
        set_ends(drive, part, directions, b, workspace)
        still = workspace.stretch[2 * b : 2 * b + 2]
        step_pair(chain.reaction, lanes, workspace.air, directions.links[b], still)
        for i in range(n):
            for d in range(2):
                for j in range(3):
                    workspace.bends[j, i, 2 * b + d] = lanes[((i + 1) * ln.ROW + tg.ALPHA + d) * K + j]


@kernel
def tangent_dense_output(t, step, t_out, workspace, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Angles and rates (m, 2 n + 2) and derivatives (m, 2 n, p) at times t_out (m,) in a step from t, from the nodes.

    Angles follow the polynomial of degree 8 through angles, rates and accelerations; rates are its derivative. Not for
    the step after a switch, in which friction settles (docs/models.md).
    """
    n, p, ys, dys = workspace.bends.shape[1], workspace.bends.shape[2], workspace.ys, workspace.dys
    half = 0.5 * step
    weights = np.empty((t_out.size, 3, 9))
    longer, moving = np.empty(p), np.empty((t_out.size, p))
    for x in range(p):
        longer[x] = 0.5 * workspace.change[x]
    for m in range(t_out.size):
        theta = (t_out[m] - t) / half - 1.0
        for order in range(3):
            basis(order, theta, weights[m, order])
        for x in range(p):
            moving[m, x] = -(workspace.shift[x] + (theta + 1.0) * longer[x]) / half
    late = moving.any() or longer.any()
    for i in range(n):  # all times of one link at a time: its nodes stay in the cache
        for m in range(t_out.size):
            weight, dq, dw = weights[m], dy_out[m, i], dy_out[m, n + i]
            y_out[m, i] = weighed(weight[0], half, i, ys, dys)
            y_out[m, n + i] = weighed(weight[1], half, i, ys, dys) / half
            combine(weight, half, i, workspace.nodes, workspace.bends, dq, dw)
            if late:
                add_time_shift(weight, half, i, ys, dys, moving[m], longer, dq, dw)


@inlined
def weighed(weight, half, i, ys, dys):  # type: ignore[no-untyped-def]
    """Sum of link i's angle, rate and acceleration at the nodes, in units of half the step; `weight` is (9,)."""
    n, total = (ys.shape[1] - 2) // 2, 0.0
    for k in range(3):
        total += weight[k] * ys[k, i] + half * (weight[3 + k] * ys[k, n + i] + half * weight[6 + k] * dys[k, n + i])
    return total


@non_allocating
def combine(weight, half, i, nodes, bends, dq, dw):  # type: ignore[no-untyped-def]
    """Derivatives (p,) of link i's angle and rate from those at the nodes; `weight` is (3, 9)."""
    n = bends.shape[1]
    dq[:] = 0.0
    dw[:] = 0.0
    for k in range(3):
        a, b, c = weight[0, k], weight[0, 3 + k] * half, weight[0, 6 + k] * half * half
        e, f, g = weight[1, k] / half, weight[1, 3 + k], weight[1, 6 + k] * half
        q, w, bend = nodes[k, i], nodes[k, n + i], bends[k, i]
        for x in range(dq.size):
            dq[x] += a * q[x] + b * w[x] + c * bend[x]
            dw[x] += e * q[x] + f * w[x] + g * bend[x]


@non_allocating
def add_time_shift(weight, half, i, ys, dys, moving, longer, dq, dw):  # type: ignore[no-untyped-def]
    """Add the effects of changes of an output's position in its step, `moving` (p,), and of half the step (p,)."""
    n = (ys.shape[1] - 2) // 2
    speed, bend = weighed(weight[1], half, i, ys, dys), weighed(weight[2], half, i, ys, dys)
    grown = grown_w = 0.0
    for k in range(3):
        w, a = ys[k, n + i], dys[k, n + i]
        grown += weight[0, 3 + k] * w + 2.0 * half * weight[0, 6 + k] * a
        grown_w += weight[1, 3 + k] * w + 2.0 * half * weight[1, 6 + k] * a
    grown_w -= speed / half
    for x in range(dq.size):
        dq[x] += speed * moving[x] + grown * longer[x]
        dw[x] += (bend * moving[x] + grown_w * longer[x]) / half


@kernel
def write_within_step(chain, drive, part, table, t, step, y, t_out, directions, workspace, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Write states and derivatives at times t_out (m,) within a step, whose ends are in the nodes in `workspace`."""
    workspace.change[:] *= 0.5
    tangent_step(
        chain, drive, part, table, t, 0.5 * step, y, workspace.ys[1], directions, workspace.nodes[1], workspace
    )
    workspace.change[:] *= 2.0
    acceleration_derivatives(chain, drive, part, t, step, directions, workspace)
    tangent_dense_output(t, step, t_out, workspace, y_out, dy_out)


def with_step_length(directions):  # type: ignore[no-untyped-def]
    """Return Directions with one more pair, for :func:`event_sensitivity`: only the length of steps changes."""
    more = zip(directions, (1, 2, 1, 2, 1, 1, 1), strict=True)
    longer = Directions(*(np.concatenate([each, np.zeros((k, *each.shape[1:]), each.dtype)]) for each, k in more))
    longer.driven[-2:] = directions.arm.size  # the base moves with the ends of the steps
    return longer


@non_allocating
def base_changes(drive, part, t, late, directions, moved):  # type: ignore[no-untyped-def]
    """Write the changes (p, CHANGES or more) of the base's motion at a time t, s, that changes by `late` (p,)."""
    for x in range(moved.shape[0]):
        m = directions.driven[x]
        moved[x] = 0.0
        if m >= 0:
            base_change(drive, part, t, late[x], directions, m, moved[x])


@non_allocating
def project_stuck_tangent(slip, before, moved_before, moved, values):  # type: ignore[no-untyped-def]
    """Project derivatives (2 n, p) onto stuck joints, like ``project_stuck`` the state; `before` are earlier ones."""
    n = slip.size
    for i in range(n):
        if slip[i] == 0.0:
            for x in range(values.shape[1]):
                if i > 0:
                    values[n + i, x] = values[n + i - 1, x]
                    values[i, x] = values[i - 1, x] + (before[i, x] - before[i - 1, x])
                else:
                    values[n, x] = moved[x, RATE]
                    values[0, x] = moved[x, TURN] + (before[0, x] - moved_before[x, TURN])


@non_allocating
def stop_joints_tangent(slip, margin, moved, values):  # type: ignore[no-untyped-def]
    """Set the rates' derivatives of joints that stick, or have just stopped, to those of their parents."""
    n = slip.size
    for i in range(n):
        if slip[i] == 0.0 or stops(margin, i):
            for x in range(values.shape[1]):
                values[n + i, x] = values[n + i - 1, x] if i > 0 else moved[x, RATE]


@non_allocating
def relative(values, row, i, x, moved, kind):  # type: ignore[no-untyped-def]
    """Difference of a row's derivative along direction x between joint i's link and its parent."""
    return values[row, x] - (values[row - 1, x] if i > 0 else moved[x, kind])


@kernel
def margin_derivatives(chain, drive, part, t, step, y, slip, joint, directions, workspace):  # type: ignore[no-untyped-def]
    """Derivatives (p,) of the margin of `joint` at the end of the step.

    A stuck joint is at its limit if, when released, it would not accelerate: its margin is this acceleration.
    """
    n = slip.size
    row, kind, values = n + joint, RATE, workspace.nodes[2]
    if slip[joint] == 0.0:
        out = workspace.ys[2]
        torque = base_state(drive, part, min(t + step, part.end), workspace.base_after)
        constraint_torques(chain, out[:n], out[n : 2 * n], slip, workspace.base_after, torque, workspace.stiction)
        free = slip.copy()
        free[joint] = -1.0 if workspace.stiction.load[joint] > 0.0 else 1.0
        assign(workspace.ys[1], out)
        assign_rows(workspace.nodes[1], workspace.nodes[2])
        ln.set_slip(ln.COLUMNS, workspace.lanes, free)
        acceleration_derivatives(chain, drive, part, t, step, directions, workspace)
        ln.set_slip(ln.COLUMNS, workspace.lanes, slip)
        row, kind, values = joint, ALPHA, workspace.bends[2]
    base_changes(drive, part, t + step, workspace.shift + workspace.change, directions, workspace.moves)
    result = np.empty(values.shape[1])
    for x in range(result.size):
        result[x] = relative(values, row, joint, x, workspace.moves, kind)
    return result


@non_allocating
def is_chatter(drive, part, t, step, y, slip, joint, workspace):  # type: ignore[no-untyped-def]
    """Whether the event at the end of a step is only rounding: of a joint at rest, in a step that is too short."""
    n = slip.size
    base_state(drive, part, t, workspace.base_before)
    return step < STICTION.quick and at_rest(y[n + joint], y[n + joint - 1] if joint > 0 else workspace.base_before[3])


@kernel
def event_sensitivity(chain, drive, part, t, step, y, values, slip, joint, directions, workspace):  # type: ignore[no-untyped-def]
    """End the step in ``workspace.nodes`` at the change of the mode of `joint`; sets ``workspace.change``."""
    margin = margin_derivatives(chain, drive, part, t, step, y, slip, joint, directions, workspace)
    set_start(values.reshape((1, values.shape[0], values.shape[1])), workspace.store)  # where it was before
    slope, nodes = margin[-2], workspace.nodes[2]
    for x in range(margin.size - 2):
        change = -margin[x] / slope if slope != 0.0 else 0.0
        workspace.change[x] = change
        for i in range(2 * slip.size):
            nodes[i, x] += change * nodes[i, margin.size - 2]


@kernel
def tangent_step_end(chain, drive, part, t, step, y, values, slip, joint, directions, workspace):  # type: ignore[no-untyped-def]
    """Hold stuck joints at the end of a step, in ``ys[2]`` and ``nodes[2]``, and those at rest after it.

    `y`, `values`: state and derivatives (2 n, p) before the step. `joint`: whose change of mode ends the step, or -1.
    """
    n = slip.size
    out = workspace.ys[2]
    base_state(drive, part, t, workspace.base_before)
    torque = base_state(drive, part, min(t + step, part.end), workspace.base_after)
    project_stuck(chain, slip, y, workspace.base_before, out, workspace.base_after)
    base_changes(drive, part, t, workspace.shift, directions, workspace.moves_before)
    base_changes(drive, part, t + step, workspace.shift + workspace.change, directions, workspace.moves)
    project_stuck_tangent(slip, values, workspace.moves_before, workspace.moves, workspace.nodes[2])
    if joint >= 0:
        margin = workspace.stiction.margin
        margins(chain, out[:n], out[n : 2 * n], slip, workspace.base_after, torque, 1.0, workspace.stiction, margin)
        stop_joints(chain, slip, margin, out, workspace.base_after)
        stop_joints_tangent(slip, margin, workspace.moves, workspace.nodes[2])


@kernel
def project_outputs(chain, drive, part, t, y, values, slip, t_out, directions, workspace, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Hold stuck joints at outputs (m,) within a step from t, whose initial state is in `y` and `values`."""
    still = np.zeros_like(workspace.shift)
    base_state(drive, part, t, workspace.base_before)
    base_changes(drive, part, t, workspace.shift, directions, workspace.moves_before)
    for k in range(t_out.size):
        base_state(drive, part, t_out[k], workspace.base_after)
        project_stuck(chain, slip, y, workspace.base_before, y_out[k], workspace.base_after)
        base_changes(drive, part, t_out[k], still, directions, workspace.moves)
        project_stuck_tangent(slip, values, workspace.moves_before, workspace.moves, dy_out[k])


@non_allocating
def write_end(chain, drive, part, t, y, slip, workspace, values, y_out, dy_out):  # type: ignore[no-untyped-def]
    """Write the state at the end of a step, and its derivatives at this fixed time if the step's end moves."""
    assign(y_out, y)
    assign_rows(dy_out, values)
    if workspace.shift.any():
        rates(chain, drive, part, t, y, slip, workspace.dys[0], workspace.work)
        for i in range(2 * slip.size):
            for x in range(workspace.shift.size):
                dy_out[i, x] -= workspace.dys[0, i] * workspace.shift[x]


@non_allocating
def set_change(drive, part, t_new, stop, directions, workspace):  # type: ignore[no-untyped-def]
    """Change of the length of the step that ends at t_new: none, unless a switch or the end of the run cuts it.

    For events see :func:`event_sensitivity`.
    """
    for x, m in enumerate(directions.driven):
        workspace.change[x] = -workspace.shift[x] if t_new >= part.end or t_new >= stop else 0.0
        if m >= 0 and t_new >= part.end:
            breaks = directions.breaks[m]
            workspace.change[x] += cycle_shift(drive, part, breaks) + breaks[part.last + 1]


@kernel
def forward_sensitivities(chain, drive, tables, steps, begin, start, directions, t_out, y_out, dy_out, halt):  # type: ignore[no-untyped-def]
    """Replay a recorded run; O(n p) per step.

    Parameters
    ----------
    chain, drive, directions : Chain, Drive, Directions
    tables : tuple of Scheme, of successive orders
    steps : (m, 3) or (m, 4 + n), as in ``rollout.Progress.log``
    begin : float, s
    start : (2 n, p) derivatives of angles and rates at `begin`; with stiction as of :func:`with_step_length`
    t_out : (T,) increasing times, s
    y_out : (T, 2 n + 2) out, angles and rates; row 0 holds the state at `begin` when called, and t_out[0] is `begin`
    dy_out : (T, 2 n, p) out, except row 0
    halt : (1,) another value than 0, set from another thread, ends it at the next step
    """
    workspace = new_tangent_workspace(chain, drive, directions.parameters.size)
    sticks = steps.shape[1] > JOINT
    slip, joint = np.ones(chain.length.size), -1
    y = y_out[0].copy()
    values = start.copy()
    t, index, fresh = begin, 1, False
    part = segment(drive, t)
    stop = steps[-1, END]
    for m in range(steps.shape[0]):
        if halt[0]:
            return
        step, t_new = steps[m, LENGTH], steps[m, END]
        table = tables[int(steps[m, DEGREE]) - tables[0].order]
        if t >= part.end:
            part = segment(drive, t)
        set_change(drive, part, t_new, stop, directions, workspace)
        if sticks:
            assign(slip, steps[m, MODES:])
            joint = int(steps[m, JOINT])
            ln.set_slip(ln.COLUMNS, workspace.lanes, slip)
            workspace.shift[-2:] = values[:, -2:] = 0.0
            workspace.change[-2:] = 1.0 if joint >= 0 else 0.0
        set_start(values.reshape((1, values.shape[0], values.shape[1])), workspace.store)
        tangent_step(chain, drive, part, table, t, step, y, workspace.out, directions, workspace.nodes[2], workspace)
        assign(workspace.ys[0], y)
        assign(workspace.ys[2], workspace.out)
        assign_rows(workspace.nodes[0], values)
        if (
            joint >= 0
            and t_new < min(part.end, stop)
            and not is_chatter(drive, part, t, step, y, slip, joint, workspace)
        ):
            event_sensitivity(chain, drive, part, t, step, y, values, slip, joint, directions, workspace)
        if sticks:
            workspace.change[-2:] = 0.0
            tangent_step_end(chain, drive, part, t, step, y, values, slip, joint, directions, workspace)
        last = index
        while last < t_out.size and t_out[last] < t_new:
            last += 1
        times, states, slopes = t_out[index:last], y_out[index:last], dy_out[index:last]
        if last > index and fresh:
            change = workspace.change.copy()
            for x in range(change.size):
                workspace.change[x] = -workspace.shift[x]
            for k in range(times.size):
                tangent_step(chain, drive, part, table, t, times[k] - t, y, states[k], directions, slopes[k], workspace)
            assign(workspace.change, change)
        elif last > index:
            write_within_step(chain, drive, part, table, t, t_new - t, y, times, directions, workspace, states, slopes)
        if last > index and not slip.all():
            project_outputs(chain, drive, part, t, y, values, slip, times, directions, workspace, states, slopes)
        index = last
        assign(y, workspace.ys[2])
        assign_rows(values, workspace.nodes[2])
        for x in range(workspace.shift.size):
            workspace.shift[x] += workspace.change[x]
        fresh = t_new >= part.end or joint >= 0
        t = t_new
        while index < t_out.size and t_out[index] <= t:
            write_end(chain, drive, part, t, y, slip, workspace, values, y_out[index], dy_out[index])
            index += 1
