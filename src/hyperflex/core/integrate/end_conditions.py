"""Event functions that may end a run, and margins of the joint limits."""

import math
from typing import NamedTuple

import numpy as np

from hyperflex.core.chain.articulated_body import sincos
from hyperflex.core.jit import kernel, non_allocating

NOTHING, CROSSES, PEAK, PHASE, ANGLE = range(5)


class Until(NamedTuple):
    """What ends a run; the meaning of the numbers a to d depends on the kind.

    CROSSES: a, b point, m; c, d unit vector. PEAK: none. PHASE: a phase, rad; b time constant, s.
    ANGLE: a angle, rad; b number of the link in the chain, or -1.0 for a prescribed arm.
    """

    kind: int
    a: float
    b: float
    c: float
    d: float
    sense: float  # 1.0 or -1.0: the reading must rise or fall through zero; 0.0: either
    after: float  # s, absolute; nothing ends the run before


NEVER = Until(NOTHING, 0.0, 0.0, 0.0, 0.0, 0.0, -math.inf)


@non_allocating
def tip_motion(chain, q, w, alpha, base):  # type: ignore[no-untyped-def]
    """Position, m, velocity, m/s, and acceleration, m/s^2, of the tip: (x, y, vx, vy, ax, ay)."""
    x, y, vx, vy, ax, ay = base[7], base[8], base[5], base[6], base[0], base[1]
    for i in range(q.size):
        sin, cos = sincos(q[i])
        length, rate2 = chain.length[i], w[i] * w[i]
        x += length * sin
        y -= length * cos
        vx += length * cos * w[i]
        vy += length * sin * w[i]
        ax += length * (cos * alpha[i] - sin * rate2)
        ay += length * (sin * alpha[i] + cos * rate2)
    return x, y, vx, vy, ax, ay


@non_allocating
def event_value(until, chain, q, w, alpha, base):  # type: ignore[no-untyped-def]
    """Reading of a state and its slope (0.0 for PEAK, where it is not known).

    CROSSES: distance beyond the line, m. PEAK: less half the growth of the squared tip speed, m^2/s^3. PHASE: distance
    of (c dx/dt, x) from the ray of the phase, on the side of later phases, m. ANGLE: angle beyond, rad.
    """
    if until.kind == ANGLE:
        link = int(until.b)
        return (base[4] - until.a, base[3]) if link < 0 else (q[link] - until.a, w[link])
    x, y, vx, vy, ax, ay = tip_motion(chain, q, w, alpha, base)
    if until.kind == CROSSES:
        return (x - until.a) * until.c + (y - until.b) * until.d, vx * until.c + vy * until.d
    if until.kind == PEAK:
        return -(vx * ax + vy * ay), 0.0
    sin, cos = math.sin(until.a), math.cos(until.a)
    return x * cos - until.b * vx * sin, vx * cos - until.b * ax * sin


@non_allocating
def limit_gap(chain, i, angle, rate):  # type: ignore[no-untyped-def]
    """Gap of joint i, at a relative angle and rate, to the nearer of its limits, rad, and how fast the gap grows."""
    bend = angle - chain.rest[i]
    return chain.max_bend[i] - abs(bend), -rate if bend > 0.0 else rate


@non_allocating
def limits(chain, q, w, base, out):  # type: ignore[no-untyped-def]
    """Write the gaps of all joints to their limits, rad, and how they grow to ``out[:, n : 2 * n]``."""
    n = q.size
    up, up_rate = base[4], base[3]
    for i in range(n):
        out[0, n + i], out[1, n + i] = limit_gap(chain, i, q[i] - up, w[i] - up_rate)
        up, up_rate = q[i], w[i]


@non_allocating
def watched_sense(until, value, slope, t):  # type: ignore[no-untyped-def]
    """Sense in which a reading is watched from the beginning of a step: margin = sense * reading; 0.0: not watched."""
    if until.kind == NOTHING or t < until.after:
        return 0.0
    if until.sense != 0.0:
        return -until.sense if -until.sense * value > 0.0 else 0.0
    if value != 0.0:
        return 1.0 if value > 0.0 else -1.0
    return 1.0 if slope > 0.0 else -1.0


@kernel
def on_right_side(until, chain, q, w, base):  # type: ignore[no-untyped-def]
    """False where a phase is passed on the opposite ray, half a turn away."""
    if until.kind != PHASE:
        return True
    x, _, vx, _, _, _ = tip_motion(chain, q, w, np.zeros(q.size), base)
    return x * math.sin(until.a) + until.b * vx * math.cos(until.a) > 0.0
