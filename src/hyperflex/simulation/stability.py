"""Stability limit of the explicit Runge-Kutta integrator."""

import math

import numpy as np

from hyperflex.checks import Array
from hyperflex.core import joint_law
from hyperflex.core.chain.articulated_body import Chain, mass_matrix
from hyperflex.errors import InvalidInput

RK4_LINKS = 1000  # beyond, eigenvalues of dense matrices take minutes


def runge_kutta_limit(chain: Chain) -> float:
    """Longest stable step of the classical Runge-Kutta method for a chain that hangs straight, s.

    The linearised chain M qdd + C qd + K q = 0 has the eigenvalues z; a step h is stable while the method's growth
    factor |1 + hz + (hz)^2 / 2 + (hz)^3 / 6 + (hz)^4 / 24| stays below 1 for all of them. Aligned links have the least
    inertia against relative motion of neighbours, so no other posture has a faster friction mode. For a uniform
    friction-bound cable this is 2.785 m l^2 / (48 eta). Infinite for a chain without gravity and joint torques.

    Raises InvalidInput for more than RK4_LINKS links.
    """
    n = chain.length.size
    if n > RK4_LINKS:
        raise InvalidInput(
            "method='rk4', a check, is not there for so many links",
            got=n,
            allowed=f"up to {RK4_LINKS}",
            fix="Take method='extrapolation', whose step does not shrink with the links",
        )
    mass = np.empty((n, n))
    mass_matrix(chain, np.zeros(n), mass)
    relative = np.eye(n) - np.eye(n, k=-1)

    def resistance(by_rate: float, by_angle: float) -> Array:
        own, back = joint_law.jacobian(chain.joints, len(chain.reaction) - 1.0, by_rate, by_angle)
        return np.asarray((np.diag(own) - np.diag(back[1:], k=1)) @ relative)

    weight = math.hypot(chain.gx, chain.gy) * first_moment(chain)
    damping, stiffness = resistance(1.0, 0.0), resistance(0.0, 1.0) + np.diag(weight)
    system = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]]
    )
    z = np.linalg.eigvals(system)
    if not z.any():  # nothing but inertia: every step is stable
        return math.inf
    z = z[np.abs(z) > 1e-9 * np.abs(z).max()]
    low, high = 0.0, 3.0 / float(np.abs(z).max())
    for _ in range(40):
        middle = 0.5 * (low + high)
        hz = middle * z
        growth = np.abs(1.0 + hz * (1.0 + hz / 2.0 * (1.0 + hz / 3.0 * (1.0 + hz / 4.0)))).max()
        low, high = (middle, high) if growth <= 1.0 + 1e-9 else (low, middle)
    return low


def first_moment(chain: Chain) -> Array:
    """Mass times lever of each link and of all beyond it about the link's motor-side joint (n,), kg m; p in (M.4)."""
    outer = np.cumsum(chain.mass[::-1])[::-1] - chain.mass + chain.tip_mass
    return np.asarray(chain.mass * chain.com + chain.length * outer)
