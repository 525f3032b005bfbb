"""A third derivation, to check the dense reference: Lagrange's equations with exact numerical derivatives.

The Lagrangian is written from positions and velocities alone (:func:`tests.reference.dense.energies`). The momentum is
a central difference in w, exact because the kinetic energy is quadratic; derivatives in q and in time are complex
steps, exact to rounding.
"""

from typing import Any

import numpy as np

from tests.reference.dense import Links, Real, energies

TINY = 1e-30  # complex step: its square vanishes beside one, so the derivative has no truncation error


def residual(links: Links, q: Real, w: Real, alpha: Real, base: Real) -> tuple[Real, Real]:
    """What Lagrange's equations leave over, without friction: generalised forces (n,) and the base's force (2,)."""
    t = 1j * TINY
    angle, rate = base[4], base[3]
    point, speed, push = np.array([0.3, -0.2]), base[5:7], base[:2]
    q_t, w_t = q + w * t, w + alpha * t
    point_t, speed_t, angle_t = point + speed * t, speed + push * t, angle + rate * t
    momentum_rate = np.array([_momentum(links, q_t, w_t, point_t, speed_t, i) for i in range(len(q))]).imag / TINY
    pull = np.array(
        [_lagrangian(links, q + t * _unit(q, i), w, point, speed, angle).imag / TINY for i in range(len(q))]
    )
    # The base's force: rate of the whole momentum, less the weight. Momentum is dT/d(speed), quadratic again.
    momentum = np.array(
        [
            energies(links, q_t, w_t, point_t, speed_t + e, angle_t)[0]
            - energies(links, q_t, w_t, point_t, speed_t - e, angle_t)[0]
            for e in np.eye(2)
        ]
    )
    weight = (np.sum(links.mass) + links.tip_mass) * np.array([links.gx, links.gy])
    return momentum_rate - pull, momentum.imag / TINY / 2 - weight


def friction_force(links: Links, w: Real, rate: float) -> Real:
    """Generalised friction force (n,) of relative joints with reaction: minus the slope of a dissipation function."""
    t = 1j * TINY
    return -np.array([_rayleigh(links, w + t * _unit(w, i), rate).imag / TINY for i in range(len(w))])


def _rayleigh(links: Links, w: Real, rate: float) -> Any:
    slip = w - np.append(rate, w[:-1])
    return np.sum(0.5 * links.viscous * slip**2 + links.dry * np.sign(slip.real) * slip)


def _lagrangian(links: Links, q: Real, w: Real, point: Real, speed: Real, angle: Any) -> Any:
    kinetic, potential = energies(links, q, w, point, speed, angle)
    return kinetic - potential


def _momentum(links: Links, q: Real, w: Real, point: Real, speed: Real, i: int) -> Any:
    e = _unit(q, i)
    return (energies(links, q, w + e, point, speed)[0] - energies(links, q, w - e, point, speed)[0]) / 2


def _unit(like: Real, i: int) -> Real:
    e = np.zeros(len(like))
    e[i] = 1.0
    return e
