"""A chain in space by virtual work, with nothing linearised by hand: directions, hinge angles, differences in time.

Link i points along (sin q cos x, sin x, -cos q cos x), where x is its angle out of the plane. Joints are pairs of
hinges, across the plane of the link before and across the link. Time derivatives along q(t), x(t) and derivatives by
x are differences.
"""

from typing import Any

import numpy as np

from tests.reference.dense import Real, bodies

DT = 1e-4  # s, and rad: differences of second order then err by some 1e-7


def along(q: Real, x: Real) -> Real:
    """Unit vectors (n, 3) along links."""
    return np.stack([np.sin(q) * np.cos(x), np.sin(x), -np.cos(q) * np.cos(x)], axis=-1)


def turned(frame: Real, first: float, second: float) -> Real:
    """Frame (3, 3) of a link after its hinges."""
    c, s = np.cos(first), np.sin(first)
    a, b = np.cos(second), np.sin(second)
    return frame @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) @ np.array([[1, 0, 0], [0, a, -b], [0, b, a]])


def hinges(arm: float, q: Real, x: Real) -> Real:
    """Angles (n, 2) of the hinges, rad."""
    frame, found = turned(np.eye(3), arm, 0.0), []
    for one in along(q, x):
        local = frame.T @ one
        found.append((np.arctan2(local[0], -local[2]), np.arcsin(local[1])))
        frame = turned(frame, *found[-1])
    return np.array(found)


def unbalanced(links: Any, planar: tuple[Real, Real, Real], base: Real, aside: tuple[Real, Real, Real]) -> Real:
    """Work (n,), N m, that is left for a virtual change of each x: zero for true accelerations.

    ``planar`` and ``aside`` are angles, rates and accelerations in the plane and out of it; ``base`` the acceleration
    (x, y) of the first joint, arm's angular acceleration, rate and angle, and the joint's velocity.
    """
    mass, reach = bodies(links)
    n = len(links.length)

    def at(t: float) -> tuple[Real, Real]:
        return tuple(each[0] + t * each[1] + 0.5 * t * t * each[2] for each in (planar, aside))

    def arm(t: float) -> float:
        return float(base[4] + t * base[3] + 0.5 * t * t * base[2])

    early, now, late = (along(*at(t)) for t in (-DT, 0.0, DT))
    rate, second = (late - early) / (2 * DT), (late - 2 * now + early) / DT**2
    gravity, push = np.array([links.gx, 0.0, links.gy]), np.array([base[0], 0.0, base[1]])
    force = mass[:, None] * (reach @ second + push - gravity)  # needed
    hinge = hinges(arm(0.0), *at(0.0))
    speed = (hinges(arm(DT), *at(DT)) - hinges(arm(-DT), *at(-DT))) / (2 * DT)
    rest = np.stack([links.rest, np.zeros(n)], axis=1)
    joint = -links.viscous[:, None] * speed - links.stiffness[:, None] * (hinge - rest)
    points, weights = np.polynomial.legendre.leggauss(40)
    left = np.zeros(n)
    for i in range(n):
        step = DT * np.eye(n)[i]
        q, x = at(0.0)
        turn = (along(q, x + step) - along(q, x - step)) / (2 * DT)
        work = (hinges(arm(0.0), q, x + step) - hinges(arm(0.0), q, x - step)) / (2 * DT)
        left[i] = (force * (reach @ turn)).sum() + (links.inertia[:, None] * second * turn).sum() - (joint * work).sum()
        start, lifted = np.array([base[5], 0.0, base[6]]), np.zeros(3)
        for k in range(n):
            for s, w in zip(0.5 * (1 + points) * links.length[k], 0.5 * weights * links.length[k], strict=True):
                v = start + s * rate[k]
                v = v - (v @ now[k]) * now[k]
                left[i] += w * links.drag[k] * np.linalg.norm(v) * (v @ (lifted + s * turn[k]))
            start, lifted = start + links.length[k] * rate[k], lifted + links.length[k] * turn[k]
    return left
