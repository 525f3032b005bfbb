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
UP, AT = 0, ROW


@kernel
def new_air(width, chain):  # type: ignore[no-untyped-def]
    """Lanes ((n + 2) ROW k,) for a chain; none where it has no drag."""
    return np.zeros((chain.length.size + 2) * ROW * len(width) if chain.drag.any() else 0)


@non_allocating
def begin(width, lanes, base, air):  # type: ignore[no-untyped-def]
    """Work out what all directions share from the lanes after ``tangent.step.prepare``; `base` (9, k) as there."""
    k = len(width)
    n = air.size // (ROW * k) - 2
    for j in range(k):
        air[VX * k + j] = base[5, j]
        air[VY * k + j] = base[6, j]
    for i in range(1, n + 1):
        for j in range(k):
            air[(i * ROW + SIN) * k + j] = lanes[(i * ln.ROW + tg.SIN) * k + j]
            air[(i * ROW + COS) * k + j] = lanes[(i * ln.ROW + tg.COS) * k + j]
            air[(i * ROW + LENGTH) * k + j] = lanes[(i * ln.ROW + ln.LENGTH) * k + j]
            air[(i * ROW + W) * k + j] = lanes[(i * ln.ROW + tg.BEFORE) * k + j]
            air[(i * ROW + DRAG) * k + j] = lanes[(i * ln.ROW + ln.DRAG) * k + j]
    for i in range(1, n + 1):
        row = air[(i - 1) * ROW * k : (i + 1) * ROW * k]
        for j in range(k):
            sin, cos, drag = row[(AT + SIN) * k + j], row[(AT + COS) * k + j], row[(AT + DRAG) * k + j]
            vx, vy, length = row[(UP + VX) * k + j], row[(UP + VY) * k + j], row[(AT + LENGTH) * k + j]
            turn = length * row[(AT + W) * k + j]
            across = vx * cos + vy * sin
            row[(AT + FORCE) * k + j], row[(AT + MOMENT) * k + j] = link_drag(1.0, length, across, turn)
            first, second, third = drag_slopes(drag, length, across, turn)
            row[(AT + FIRST) * k + j], row[(AT + SECOND) * k + j], row[(AT + THIRD) * k + j] = first, second, third
            row[(AT + SIDE) * k + j] = vy * cos - vx * sin
            row[(AT + END) * k + j] = drag * abs(across + turn) * (across + turn)
            row[(AT + VX) * k + j] = vx + turn * cos
            row[(AT + VY) * k + j] = vy + turn * sin
    for way in range(n):
        i = n - way
        row = air[i * ROW * k : (i + 2) * ROW * k]
        for j in range(k):
            sin, cos, force = row[SIN * k + j], row[COS * k + j], row[DRAG * k + j] * row[FORCE * k + j]
            fx, fy = row[(ROW + FX) * k + j], row[(ROW + FY) * k + j]
            row[BEYOND * k + j], row[ASIDE * k + j] = fx * cos + fy * sin, fy * cos - fx * sin
            row[FX * k + j], row[FY * k + j] = fx - force * cos, fy - force * sin


@inlined
def outward(row, k, j, d, longer, more):  # type: ignore[no-untyped-def]
    """One link and direction from motor to tip, for changes of its length, m, and of its drag, kg/m^2."""
    sin, cos, length = row[(AT + SIN) * k + j], row[(AT + COS) * k + j], row[(AT + LENGTH) * k + j]
    w, second, end = row[(AT + W) * k + j], row[(AT + SECOND) * k + j], row[(AT + END) * k + j]
    dq, dw = row[(AT + DQ + d) * k + j], row[(AT + DW + d) * k + j]
    vx, vy = row[(UP + DVX + d) * k + j], row[(UP + DVY + d) * k + j]
    across = vx * cos + vy * sin + row[(AT + SIDE) * k + j] * dq
    force = row[(AT + FIRST) * k + j] * across + second * dw + end * longer
    moment = second * across + row[(AT + THIRD) * k + j] * dw + length * end * longer
    row[(AT + DFORCE + d) * k + j] = force + row[(AT + FORCE) * k + j] * more
    row[(AT + DMOMENT + d) * k + j] = moment + row[(AT + MOMENT) * k + j] * more
    turn, side = longer * w + length * dw, length * w * dq
    row[(AT + DVX + d) * k + j] = vx + (turn * cos - side * sin)
    row[(AT + DVY + d) * k + j] = vy + (turn * sin + side * cos)


@inlined
def inward(row, k, j, d, longer):  # type: ignore[no-untyped-def]
    """One link and direction from tip to motor: the change of the torque on it."""
    sin, cos, length = row[SIN * k + j], row[COS * k + j], row[LENGTH * k + j]
    dq, change, force = row[(DQ + d) * k + j], row[(DFORCE + d) * k + j], row[DRAG * k + j] * row[FORCE * k + j]
    fx, fy = row[(ROW + DFX + d) * k + j], row[(ROW + DFY + d) * k + j]
    torque = length * (fx * cos + fy * sin + row[ASIDE * k + j] * dq) + longer * row[BEYOND * k + j]
    row[(TORQUE + d) * k + j] = torque - row[(DMOMENT + d) * k + j]
    row[(DFX + d) * k + j] = fx - (change * cos - force * dq * sin)
    row[(DFY + d) * k + j] = fy - (change * sin + force * dq * cos)


@non_allocating
def write_torques(width, lanes, air, links):  # type: ignore[no-untyped-def]
    """Write the changes of the torques to RHS of the links in `lanes`, for changes of their angles and rates there.

    Parameters
    ----------
    width, lanes, links : as in ``tangent.step.step_all``, which adds them
    air : ((n + 2) ROW k,) after :func:`begin`; row 0 holds the changes of the first joint's velocity, DVX and DVY
    """
    k = len(width)
    n = air.size // (ROW * k) - 2
    for i in range(1, n + 1):
        for x in range(4 * k):  # DQ and DW, both directions
            air[(i * ROW + DQ) * k + x] = lanes[(i * ln.ROW + tg.DQ) * k + x]
    for i in range(1, n + 1):
        row = air[(i - 1) * ROW * k : (i + 1) * ROW * k]
        one_length, two_length = links[0, i - 1, tg.LENGTH], links[1, i - 1, tg.LENGTH]
        one_drag, two_drag = links[0, i - 1, tg.DRAG], links[1, i - 1, tg.DRAG]
        for j in range(k):
            outward(row, k, j, 0, one_length, one_drag)
            outward(row, k, j, 1, two_length, two_drag)
    for way in range(n):
        i = n - way
        row = air[i * ROW * k : (i + 2) * ROW * k]
        one_length, two_length = links[0, i - 1, tg.LENGTH], links[1, i - 1, tg.LENGTH]
        for j in range(k):
            inward(row, k, j, 0, one_length)
            inward(row, k, j, 1, two_length)
    for i in range(1, n + 1):
        for x in range(2 * k):
            lanes[(i * ln.ROW + tg.RHS) * k + x] = air[(i * ROW + TORQUE) * k + x]
