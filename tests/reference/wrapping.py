"""A rope laid round a peg by geometry alone, and the set-up that pulls at both its ends."""

import math

import numpy as np

import hyperflex as hf
from tests.reference.dense import Real

ARM = 0.3  # m


def laid(length: Real, start: tuple[float, float], axis: float, swept: float) -> Real:
    """Angles (n,) of links that run straight down to a circle about the origin, round it, and straight away from it.

    The first joint is at `start`, left of the circle of radius `axis`; after the angle `swept`, rad, counterclockwise,
    the rope is straight. Each link on the circle is tangent to it.
    """
    q, (x, y), before = np.zeros(len(length)), start, 0.0
    for i, size in enumerate(length):
        if before == swept:
            q[i] = swept
        elif before > 0.0 or y < size:
            far = math.hypot(x, y)
            outward = math.atan2(y, x)
            tangent = outward + math.pi - math.asin(min(axis / far, 1.0))  # leaves the centre on the left
            angle = tangent + 0.5 * math.pi  # link angles count from straight down
            angle += 2.0 * math.pi * round((before - angle) / (2.0 * math.pi))
            q[i] = before = min(max(angle, before), swept)
        x, y = x + size * math.sin(q[i]), y - size * math.cos(q[i])
    return q


def capstan(rope: hf.Rope, peg: hf.Peg, swept: float, times: Real, ratios: Real, **changes: object) -> hf.Setup:
    """A rope without weight, 1 N at its tip, and a multiple of 1 N at its other end by a torque on an arm."""
    axis = (peg.radius + rope.radius) * (1.0 + 1e-6)
    heavy = float(np.max(ratios))
    return hf.Setup(
        rope,
        arm=hf.Arm(length=ARM, inertia=1e-3 * ARM**2 * max(heavy, 1.0), pivot=(-axis - ARM, 0.1)),
        torque=hf.torque_profile(times, ARM * np.asarray(ratios)),
        q0=laid(rope.length, (-axis, 0.1), axis, swept),
        arm_angle0=0.5 * math.pi,
        duration=float(times[-1]),
        pegs=(peg,),
        tip_force=(math.sin(swept), -math.cos(swept)),
        **changes,
    )


def slipped(run: hf.Trajectory, swept: float) -> Real:
    """Way (T,) that the tip has gone against its pull, m."""
    return -(run.tip - run.tip[0]) @ np.array([math.sin(swept), -math.cos(swept)])
