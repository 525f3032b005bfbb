"""Tangent of air drag, two directions at a time in SIMD lanes (M.33).

They stand in lanes of their own, ``air``, laid out as those of ``chain.lanes``: row 0 is the first joint, rows 1..n are
the links, row n + 1 is what lies beyond the tip, where nothing acts. A step leaves in them what all directions share;
each direction's changes of angles and rates are copied in, and the changes of the torques on the links out.
"""

import numpy as np

from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.air import drag_slopes, link_drag
from hyperflex.core.jit import inlined, kernel, non_allocating
from hyperflex.core.tangent import step as tg

# of a link: sine, cosine, length, rate; force across it and moment, N and N m, for a unit of drag; its drag
SIN, COS, LENGTH, W, FORCE, MOMENT, DRAG = range(7)
# integrals of ``drag_slopes``; velocity along the normal's derivative, m/s; drag |v| v at the far joint, N/m; the air's
# force on all beyond the link, across it and along its normal's derivative, N
FIRST, SECOND, THIRD, SIDE, END, BEYOND, ASIDE = range(7, 14)
# velocity of the far joint, force on the link and all beyond it
VX, VY, FX, FY = range(14, 18)
# changes, of both directions: of angle, rate, velocity of the far joint, force across the link, moment, force on it
# and all beyond it; of the torque
DQ, DW, DVX, DVY, DFORCE, DMOMENT, DFX, DFY, TORQUE = range(18, 36, 2)
ROW = 36
K = tg.K


@kernel
def new_air(chain):  # type: ignore[no-untyped-def]
    """Lanes ((n + 2) ROW K,) for a chain; none where it has no drag."""
    return np.zeros((chain.length.size + 2) * ROW * K if chain.drag.any() else 0)


@non_allocating
def begin(lanes, base, air):  # type: ignore[no-untyped-def]
    """Work out what all directions share from the lanes after ``tangent.step.prepare``; `base` (9, K) as there."""
    n = air.size // (ROW * K) - 2
    for j in range(K):
        air[VX * K + j] = base[5, j]
        air[VY * K + j] = base[6, j]
    for i in range(1, n + 1):
        for j in range(K):
            at, own = i * ROW * K + j, i * ln.ROW * K + j
            air[at + SIN * K], air[at + COS * K] = lanes[own + tg.SIN * K], lanes[own + tg.COS * K]
            air[at + LENGTH * K], air[at + W * K] = lanes[own + ln.LENGTH * K], lanes[own + tg.BEFORE * K]
            air[at + DRAG * K] = lanes[own + ln.DRAG * K]
    for i in range(1, n + 1):
        row = air[(i - 1) * ROW * K : (i + 1) * ROW * K]
        for up in range(K):
            at = ROW * K + up
            sin, cos, drag = row[at + SIN * K], row[at + COS * K], row[at + DRAG * K]
            vx, vy, length = row[up + VX * K], row[up + VY * K], row[at + LENGTH * K]
            turn = length * row[at + W * K]
            across = vx * cos + vy * sin
            row[at + FORCE * K], row[at + MOMENT * K] = link_drag(1.0, length, across, turn)
            first, second, third = drag_slopes(drag, length, across, turn)
            row[at + FIRST * K], row[at + SECOND * K], row[at + THIRD * K] = first, second, third
            row[at + SIDE * K] = vy * cos - vx * sin
            row[at + END * K] = drag * abs(across + turn) * (across + turn)
            row[at + VX * K] = vx + turn * cos
            row[at + VY * K] = vy + turn * sin
    for way in range(n):
        i = n - way
        row = air[i * ROW * K : (i + 2) * ROW * K]
        for at in range(K):
            down = ROW * K + at
            sin, cos, force = row[at + SIN * K], row[at + COS * K], row[at + DRAG * K] * row[at + FORCE * K]
            fx, fy = row[down + FX * K], row[down + FY * K]
            row[at + BEYOND * K], row[at + ASIDE * K] = fx * cos + fy * sin, fy * cos - fx * sin
            row[at + FX * K], row[at + FY * K] = fx - force * cos, fy - force * sin


@inlined
def outward(row, j, d, longer, more):  # type: ignore[no-untyped-def]
    """One link and direction from motor to tip, for changes of its length, m, and of its drag, kg/m^2.

    `d` is 0, or K for the second direction.
    """
    at, own, up = ROW * K + j, ROW * K + j + d, j + d
    sin, cos, length = row[at + SIN * K], row[at + COS * K], row[at + LENGTH * K]
    w, second, end = row[at + W * K], row[at + SECOND * K], row[at + END * K]
    dq, dw = row[own + DQ * K], row[own + DW * K]
    vx, vy = row[up + DVX * K], row[up + DVY * K]
    across = vx * cos + vy * sin + row[at + SIDE * K] * dq
    force = row[at + FIRST * K] * across + second * dw + end * longer
    moment = second * across + row[at + THIRD * K] * dw + length * end * longer
    row[own + DFORCE * K] = force + row[at + FORCE * K] * more
    row[own + DMOMENT * K] = moment + row[at + MOMENT * K] * more
    turn, side = longer * w + length * dw, length * w * dq
    row[own + DVX * K] = vx + (turn * cos - side * sin)
    row[own + DVY * K] = vy + (turn * sin + side * cos)


@inlined
def inward(row, j, d, longer):  # type: ignore[no-untyped-def]
    """One link and direction from tip to motor: the change of the torque on it; `d` as for :func:`outward`."""
    own, down = j + d, ROW * K + j + d
    sin, cos, length = row[j + SIN * K], row[j + COS * K], row[j + LENGTH * K]
    dq, change, force = row[own + DQ * K], row[own + DFORCE * K], row[j + DRAG * K] * row[j + FORCE * K]
    fx, fy = row[down + DFX * K], row[down + DFY * K]
    torque = length * (fx * cos + fy * sin + row[j + ASIDE * K] * dq) + longer * row[j + BEYOND * K]
    row[own + TORQUE * K] = torque - row[own + DMOMENT * K]
    row[own + DFX * K] = fx - (change * cos - force * dq * sin)
    row[own + DFY * K] = fy - (change * sin + force * dq * cos)


@non_allocating
def write_torques(lanes, air, links):  # type: ignore[no-untyped-def]
    """Write the changes of the torques to RHS of the links in `lanes`, for changes of their angles and rates there.

    Parameters
    ----------
    lanes, links : as in ``tangent.step.step``, which adds them
    air : ((n + 2) ROW K,) after :func:`begin`; row 0 holds the changes of the first joint's velocity, DVX and DVY
    """
    n = air.size // (ROW * K) - 2
    for i in range(1, n + 1):
        for x in range(4 * K):  # DQ and DW, both directions
            air[(i * ROW + DQ) * K + x] = lanes[(i * ln.ROW + tg.DQ) * K + x]
    for i in range(1, n + 1):
        row = air[(i - 1) * ROW * K : (i + 1) * ROW * K]
        longer, longer_two = links[0, i - 1, tg.LENGTH], links[1, i - 1, tg.LENGTH]
        more, more_two = links[0, i - 1, tg.DRAG], links[1, i - 1, tg.DRAG]
        for j in range(K):
            outward(row, j, 0, longer, more)
            outward(row, j, K, longer_two, more_two)
    for way in range(n):
        i = n - way
        row = air[i * ROW * K : (i + 2) * ROW * K]
        longer, longer_two = links[0, i - 1, tg.LENGTH], links[1, i - 1, tg.LENGTH]
        for j in range(K):
            inward(row, j, 0, longer)
            inward(row, j, K, longer_two)
    for i in range(1, n + 1):
        for x in range(2 * K):
            lanes[(i * ln.ROW + tg.RHS) * K + x] = air[(i * ROW + TORQUE) * K + x]
