"""Directions of a derivative: changes of the chain, its drive and its base motion."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.core.chain.articulated_body import Array, sincos
from hyperflex.core.chain.drive import ANGLE, TORQUE, X, Y, polynomial, segment, within
from hyperflex.core.jit import inlined, kernel, non_allocating

TIP_MASS, GRAVITY_X, GRAVITY_Y = range(3)  # columns of Directions.whole
# what base_change writes
ACC_X, ACC_Y, ALPHA, RATE, TURN, MOTOR, PLACE_X, PLACE_Y, SPEED_X, SPEED_Y = range(10)
CHANGES = 10
LINKS, ENDS = 1, 2  # links (or the torque on the first one) change; the base's motion, gravity or the tip mass do


class Directions(NamedTuple):
    """Changes of everything that a run depends on but its start; b pairs of directions."""

    links: Array  # (b, 2, n, SEEDS): of the links' parameters, see core/tangent/step.py
    whole: Array  # (b, 2, 3): of tip mass, kg, and gravity, m/s^2
    kind: npt.NDArray[np.int64]  # (b,) sum of LINKS and ENDS, where a pair changes more than the state
    driven: npt.NDArray[np.int64]  # (b, 2) row of the following that changes the drive, -1: none does
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
        for b in range(directions.kind.size):
            for d in range(2):
                m = directions.driven[b, d]
                if m >= 0:
                    base_change(drive, part, t[k], 0.0, directions, m, moved)
                    out[k, 0, 2 * b + d] = moved[PLACE_X]
                    out[k, 1, 2 * b + d] = moved[PLACE_Y]
