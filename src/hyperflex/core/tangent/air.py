"""Tangent of air drag, two directions at a time in SIMD lanes (M.33).

They use separate lanes, ``air``, with the layout of ``chain.lanes``: row 0 is the first joint, rows 1..n are the links,
row n + 1 lies beyond the tip, where no force acts. A step stores the quantities common to all directions there; each
direction's changes of angles and rates are copied in, and the changes of the torques on the links out.
"""

import numpy as np

from hyperflex.core.chain import lanes as ln
from hyperflex.core.chain.air import drag_slopes, link_drag
from hyperflex.core.jit import inlined, kernel, non_allocating, read, write
from hyperflex.core.tangent import step as tg

# of a link: sine, cosine, length, rate and drag
LINK = SIN, COS, LENGTH, W, DRAG = tuple(range(5))
# force across it and moment, N and N m, for a unit of drag; integrals of ``drag_slopes``; velocity along the normal's
# derivative, m/s; drag |v| v at the far joint, N/m
SLOPES = FORCE, MOMENT, FIRST, SECOND, THIRD, SIDE, END = tuple(range(5, 12))
# the air's force on the chain beyond the link, across it and along its normal's derivative, N
BEYOND, ASIDE = range(12, 14)
# velocity of the far joint, force on the link and all beyond it
VX, VY, FX, FY = range(14, 18)
# changes, of both directions: of angle, rate, velocity of the far joint, force across the link, moment, force on it
# and all beyond it; of the torque
DQ, DW, DVX, DVY, DFORCE, DMOMENT, DFX, DFY, TORQUE = range(18, 36, 2)
ROW = 36
K = tg.K


@kernel
def new_air(chain):  # type: ignore[no-untyped-def]
    """Lanes ((n + 2) ROW K,) for a chain; none without drag."""
    return np.zeros((chain.length.size + 2) * ROW * K if chain.drag.any() else 0)


@non_allocating
def begin(lanes, base, air):  # type: ignore[no-untyped-def]
    """Compute what all directions share from the lanes after ``tangent.step.prepare``; `base` (9, K) as there."""
    n = air.size // (ROW * K) - 2
    for j in range(K):
        write(air, K, j, (VX, VY), (base[5, j], base[6, j]))
    for i in range(1, n + 1):
        for j in range(K):
            link = read(lanes, K, i * ln.ROW * K + j, (tg.SIN, tg.COS, ln.LENGTH, tg.BEFORE, ln.DRAG))
            write(air, K, i * ROW * K + j, LINK, link)
    for i in range(1, n + 1):
        row = air[(i - 1) * ROW * K : (i + 1) * ROW * K]
        for up in range(K):
            at = ROW * K + up
            (sin, cos, length, w, drag), (vx, vy) = read(row, K, at, LINK), read(row, K, up, (VX, VY))
            turn, across = length * w, vx * cos + vy * sin
            write(row, K, at, (FORCE, MOMENT), link_drag(1.0, length, across, turn))
            write(row, K, at, (FIRST, SECOND, THIRD), drag_slopes(drag, length, across, turn))
            end = drag * abs(across + turn) * (across + turn)
            write(row, K, at, (SIDE, END, VX, VY), (vy * cos - vx * sin, end, vx + turn * cos, vy + turn * sin))
    for way in range(n):
        i = n - way
        row = air[i * ROW * K : (i + 2) * ROW * K]
        for at in range(K):
            sin, cos, drag, force = read(row, K, at, (SIN, COS, DRAG, FORCE))
            fx, fy = read(row, K, ROW * K + at, (FX, FY))
            write(row, K, at, (BEYOND, ASIDE), (fx * cos + fy * sin, fy * cos - fx * sin))
            write(row, K, at, (FX, FY), (fx - drag * force * cos, fy - drag * force * sin))


@inlined
def outward(row, j, d, longer, more):  # type: ignore[no-untyped-def]
    """One link and direction from motor to tip, for changes of its length, m, and of its drag, kg/m^2.

    `d` is 0, or K for the second direction.
    """
    at, own, up = ROW * K + j, ROW * K + j + d, j + d
    sin, cos, length, w, _ = read(row, K, at, LINK)
    unit_force, unit_moment, first, second, third, aside, end = read(row, K, at, SLOPES)
    (dq, dw), (vx, vy) = read(row, K, own, (DQ, DW)), read(row, K, up, (DVX, DVY))
    across = vx * cos + vy * sin + aside * dq
    force = first * across + second * dw + end * longer + unit_force * more
    moment = second * across + third * dw + length * end * longer + unit_moment * more
    turn, side = longer * w + length * dw, length * w * dq
    velocity = vx + (turn * cos - side * sin), vy + (turn * sin + side * cos)
    write(row, K, own, (DFORCE, DMOMENT, DVX, DVY), (force, moment, *velocity))


@inlined
def inward(row, j, d, longer):  # type: ignore[no-untyped-def]
    """One link and direction from tip to motor: the change of the torque on it; `d` as for :func:`outward`."""
    sin, cos, length, _, drag = read(row, K, j, LINK)
    (dq, change, moment), (fx, fy) = (
        read(row, K, j + d, (DQ, DFORCE, DMOMENT)),
        read(row, K, ROW * K + j + d, (DFX, DFY)),
    )
    unit_force, beyond, aside = read(row, K, j, (FORCE, BEYOND, ASIDE))
    force, torque = drag * unit_force, length * (fx * cos + fy * sin + aside * dq) + longer * beyond - moment
    fx, fy = fx - (change * cos - force * dq * sin), fy - (change * sin + force * dq * cos)
    write(row, K, j + d, (TORQUE, DFX, DFY), (torque, fx, fy))


@non_allocating
def write_torques(lanes, air, links):  # type: ignore[no-untyped-def]
    """Write the changes of the torques to RHS of the links in `lanes`, for changes of their angles and rates there.

    If inner joints have motors, RHS contains the changes of their torques on entry.

    Parameters
    ----------
    lanes, links : as in ``tangent.step.step``, which adds them
    air : ((n + 2) ROW K,) after :func:`begin`; row 0 holds the changes of the first joint's velocity, DVX and DVY
    """
    n, motors = air.size // (ROW * K) - 2, lanes[tg.MOTORS * K] > 0.0
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
            motor = lanes[(i * ln.ROW + tg.RHS) * K + x] if motors else 0.0
            lanes[(i * ln.ROW + tg.RHS) * K + x] = air[(i * ROW + TORQUE) * K + x] + motor
