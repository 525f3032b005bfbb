"""Tangent of the dense output: outputs within a step, with derivatives."""

import numpy as np

from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.articulated_body import sines
from hyperflex.core.chain.drive import base_state
from hyperflex.core.integrate.dense_output import basis, enter_state, interpolate
from hyperflex.core.jit import kernel, non_allocating
from hyperflex.core.tangent import step as tg
from hyperflex.core.tangent.extrapolation import CELL, PARTS, K, begin_pairs, enter, set_ends, step_pair, tangent_step


@kernel
def acceleration_derivatives(chain, drive, part, t, step, directions, workspace):  # type: ignore[no-untyped-def]
    """Accelerations at beginning, middle and end of a step, and their derivatives, from ``ys`` and ``nodes``."""
    n = chain.length.size
    lanes, ys, dys = workspace.lanes, workspace.ys, workspace.dys
    workspace.anew[:] = 1.0
    motion = np.empty(9)
    for j in range(K):
        node = min(j, 2)
        workspace.into[j] = 0.5 * node
        workspace.when[j] = t + 0.5 * node * step
        torque = base_state(drive, part, workspace.when[j], motion)
        q, w = ys[node, :n], ys[node, n : 2 * n]
        sines(q, workspace.work, 0)
        enter_state(j, chain, q, w, workspace.work, motion, torque, lanes, workspace.tip, workspace.base)
    tg.save_trig(ln.COLUMNS, lanes)
    ln.euler(ln.COLUMNS, chain.reaction, ln.MORE, lanes, workspace.tip, workspace.base)
    begin_pairs(chain.reaction, lanes, workspace.air, workspace.base)
    for j in range(3):
        for i in range(n):
            dys[j, i] = ys[j, n + i]
            dys[j, n + i] = lanes[((i + 1) * ln.ROW + ln.ALPHA) * K + j]
    workspace.stretch[:] = 0.0
    for b in range(directions.kind.size):
        for i in range(n):
            cell = workspace.store[b, i * PARTS * CELL : (i * PARTS + 1) * CELL]
            for x in range(CELL):
                lane, d, rate = min(x % K, 2), (x // K) % 2, x // (2 * K)
                cell[x] = workspace.nodes[lane, rate * n + i, 2 * b + d]
        enter(lanes, workspace.store[b], workspace.anew, True)
        set_ends(drive, part, directions, b, workspace)
        step_pair(chain.reaction, lanes, workspace.air, directions.links[b], workspace.stretch[b])
        for i in range(n):
            for d in range(2):
                for j in range(3):
                    workspace.bends[j, i, 2 * b + d] = lanes[((i + 1) * ln.ROW + tg.ALPHA + d) * K + j]


@kernel
def tangent_dense_output(t, step, t_out, workspace, y_out, dy_out):  # type: ignore[no-untyped-def]
    """States (m, 2 n + 2) and derivatives (m, 2 n, p) at times t_out (m,) in a step from t, from the nodes."""
    n, p = workspace.bends.shape[1], workspace.bends.shape[2]
    half = 0.5 * step
    weights = np.empty((t_out.size, 3, 9))
    longer, moving = np.empty(p), np.empty((t_out.size, p))
    for x in range(p):
        longer[x] = 0.5 * workspace.change[x // 2, x % 2]
    for m in range(t_out.size):
        theta = (t_out[m] - t) / half - 1.0
        interpolate(theta, step, workspace.ys, workspace.dys, y_out[m])
        for order in range(3):
            basis(order, theta, weights[m, order])
        for x in range(p):
            moving[m, x] = -(workspace.shift[x // 2, x % 2] + (theta + 1.0) * longer[x]) / half
    late = moving.any() or longer.any()
    for i in range(n):  # all times of a link together: its nodes stay in the cache
        for m in range(t_out.size):
            combine(weights[m], half, i, workspace.nodes, workspace.bends, dy_out[m, i], dy_out[m, n + i])
            if late:
                add_time_shift(
                    weights[m], half, i, workspace.ys, workspace.dys, moving[m], longer, dy_out[m, i], dy_out[m, n + i]
                )


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
    """Add what follows from the change of an output's place in its step, `moving` (p,), and of half the step (p,)."""
    n = (ys.shape[1] - 2) // 2
    speed = grown = bend = grown_w = 0.0
    for k in range(3):
        q, w, a = ys[k, i], ys[k, n + i], dys[k, n + i]
        speed += weight[1, k] * q + half * (weight[1, 3 + k] * w + half * weight[1, 6 + k] * a)
        bend += weight[2, k] * q + half * (weight[2, 3 + k] * w + half * weight[2, 6 + k] * a)
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
