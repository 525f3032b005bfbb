"""Drive of the chain: arm angle, pivot and motor torque as piecewise polynomials."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core.chain.articulated_body import BASE_SIZE, sincos
from hyperflex.core.jit import inlined, non_allocating

ANGLE, X, Y, TORQUE = range(4)  # channels of Drive.coef; then the torques of motors in joints 1, 2, ...
ROUNDING = 1e-12  # relative; about a thousand times the rounding error


class Drive(NamedTuple):
    """Piecewise polynomials of arm angle (rad), pivot x, y (m) and torques of the chain's joints from the first (N m).

    Piece j holds from breaks[j] to breaks[j + 1] with coefficients coef[j]: 4 channels, one more for each joint up to
    the last one with a motor, 6 ascending powers of the time since breaks[j]. After the last break the pieces from
    `loop` on repeat for ever; if `loop` is negative, and before the first break, the end values are constant.
    """

    breaks: npt.NDArray[np.float64]  # (k + 1,), s
    coef: npt.NDArray[np.float64]  # (k, 4 or more, 6)
    switch: npt.NDArray[np.bool_]  # (k + 1,) where acceleration or torque jumps: integration restarts there
    loop: int  # first repeated piece, -1: none
    arm_length: float  # m, from the pivot to the first joint
    torque_limit: float  # N m, of the first joint's motor


class Segment(NamedTuple):
    """The smooth part of a drive around a time: between two switches."""

    start: float
    end: float  # s, absolute; may be inf
    offset: float  # s, beginning of the period
    first: int  # pieces first..last; first > last where the drive is at rest
    last: int


@non_allocating
def segment(drive, t):  # type: ignore[no-untyped-def]
    """Return the Segment that begins at or before t and ends after it; at a switch, within rounding, the later."""
    breaks = drive.breaks
    k = breaks.size - 1
    t += ROUNDING * (1.0 + abs(t))  # cycles are sums and products, so the same instant is computed in several ways
    if t < breaks[0]:
        return Segment(-np.inf, breaks[0], 0.0, 0, -1)
    offset = 0.0
    begin = 0
    if t >= breaks[k]:
        if drive.loop < 0:
            return Segment(breaks[k], np.inf, 0.0, k, k - 1)
        begin = drive.loop
        period = breaks[k] - breaks[begin]
        cycle = np.floor((t - breaks[begin]) / period)
        if cycle * period + breaks[k] <= t:  # the division rounded down at the end of a cycle
            cycle += 1.0
        offset = cycle * period
    j = begin
    while j < k - 1 and offset + breaks[j + 1] <= t:
        j += 1
    first = j
    while first > begin and not drive.switch[first]:
        first -= 1
    last = j
    while last < k - 1 and not drive.switch[last + 1]:
        last += 1
    end = offset + breaks[last + 1]
    if last == k - 1 and drive.loop < 0 and not drive.switch[k]:  # the drive comes to rest without a jump
        end = np.inf
    return Segment(offset + breaks[first], end, offset, first, last)


@non_allocating
def within(drive, part, t):  # type: ignore[no-untyped-def]
    """Return the piece j at time t within Segment `part`, the time s into it, and whether the drive is at rest.

    Before the first break and after the last one s is that of the constant values.
    """
    k = drive.breaks.size - 1
    if part.first == 0 and part.last < 0:
        return 0, 0.0, True
    if part.last < part.first or (drive.loop < 0 and t > drive.breaks[k]):
        return k - 1, drive.breaks[k] - drive.breaks[k - 1], True
    j = part.first
    while j < part.last and part.offset + drive.breaks[j + 1] <= t:
        j += 1
    return j, t - (part.offset + drive.breaks[j]), False


@inlined
def base_size(drive):  # type: ignore[no-untyped-def]
    """Size of the output of :func:`base_state`: the motion, and torques on links up to the last one with a motor."""
    motors = drive.coef.shape[1] - TORQUE - 1
    return BASE_SIZE + motors + 1 if motors > 0 else BASE_SIZE


@inlined
def polynomial(c, t):  # type: ignore[no-untyped-def]
    """Value, first and second derivative at t of the polynomial with ascending coefficients c (6,)."""
    value = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * c[5]))))
    rate = c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * (4.0 * c[4] + t * 5.0 * c[5])))
    second = 2.0 * c[2] + t * (6.0 * c[3] + t * (12.0 * c[4] + t * 20.0 * c[5]))
    return value, rate, second


@inlined
def write_base(length, arm, x, y, base, at, stride):  # type: ignore[no-untyped-def]
    """Write the motion of a joint at the end of an arm to ``base[at + stride i]``, as :func:`base_state` orders it.

    `length` is that of the arm, m; `arm`, `x`, `y` are angle and pivot, each with its first and second derivative.
    """
    angle, rate, alpha = arm
    sin, cos = sincos(angle)
    base[at] = x[2] + length * (cos * alpha - sin * rate * rate)
    base[at + stride] = y[2] + length * (sin * alpha + cos * rate * rate)
    base[at + 2 * stride], base[at + 3 * stride], base[at + 4 * stride] = alpha, rate, angle
    base[at + 5 * stride] = x[1] + length * cos * rate
    base[at + 6 * stride] = y[1] + length * sin * rate
    base[at + 7 * stride] = x[0] + length * sin
    base[at + 8 * stride] = y[0] - length * cos


@non_allocating
def motion_at(drive, t, base):  # type: ignore[no-untyped-def]
    """Write the motion of the first joint at time t as :func:`base_state` does; return the motor torque, N m."""
    return base_state(drive, segment(drive, t), t, base)


@non_allocating
def base_state(drive, part, t, base):  # type: ignore[no-untyped-def]
    """Motion of the first joint at time t within the Segment `part`.

    Writes ``base`` (9 or more,): acceleration x, y (m/s^2); alpha, rate, angle of the arm (rad/s^2, rad/s, rad);
    velocity x, y (m/s); position x, y (m). If `base` is large enough (:func:`base_size`), the torques of motors in
    inner joints on each link, N m, follow: one acts on its joint's link, and with the opposite torque on the link
    before it. Returns the torque of the first joint's motor, N m.
    """
    j, s, still = within(drive, part, t)
    angle, rate, alpha = polynomial(drive.coef[j, ANGLE], s)
    x, vx, ax = polynomial(drive.coef[j, X], s)
    y, vy, ay = polynomial(drive.coef[j, Y], s)
    torque, _, _ = polynomial(drive.coef[j, TORQUE], s)
    if still:
        rate = alpha = vx = ax = vy = ay = torque = 0.0
    write_base(drive.arm_length, (angle, rate, alpha), (x, vx, ax), (y, vy, ay), base, 0, 1)
    beyond = 0.0
    for i in range(base.size - BASE_SIZE - 1, -1, -1):
        own = polynomial(drive.coef[j, TORQUE + i], s)[0] if i > 0 and not still else 0.0
        base[BASE_SIZE + i] = own - beyond
        beyond = own
    return min(max(torque, -drive.torque_limit), drive.torque_limit)
