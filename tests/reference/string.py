"""The inextensible string with bending viscosity, by Legendre polynomials in the arc length; no chain is in it.

Unknown is the angle theta(s, t) of the tangent d = (sin, -cos), so that the length is kept; n is across it. By virtual
work, with dr = int_0^s n dtheta:

    int mu (r_tt - g) . dr ds + int B theta_st dtheta_s ds + hinge (theta_t - arm_t) dtheta at s = 0  =  0
"""

from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre
from scipy.integrate import solve_bvp, solve_ivp

Array = np.ndarray


class String:
    """A uniform string of `length`, m, density `mu`, kg/m, and bending viscosity, N m^2 s; `hinge` in N m s/rad."""

    def __init__(
        self, length: float, mu: float, viscosity: float = 0.0, hinge: float = 0.0, *, modes: int = 24
    ) -> None:
        self.length, self.mu, self.viscosity, self.hinge = length, mu, viscosity, hinge
        self.gravity, points = np.array([0.0, -9.81]), 2 * modes
        x, w = legendre.leggauss(points)
        self.s, self.weight = 0.5 * length * (x + 1.0), 0.5 * length * w
        self.shapes, eye = legendre.legvander(x, modes - 1), np.eye(points)
        self.slopes = np.stack([legendre.legval(x, legendre.legder(one)) for one in np.eye(modes)], axis=1) * 2 / length
        integrals = np.stack([legendre.legval(x, legendre.legint(one, lbnd=-1.0)) for one in eye], axis=1)
        self.cumulated = 0.5 * length * integrals @ np.linalg.inv(legendre.legvander(x, points - 1))
        self.first = (-1.0) ** np.arange(modes)  # the shapes at s = 0
        self.bending = viscosity * self.slopes.T @ (self.weight[:, None] * self.slopes)
        self.bending += hinge * np.outer(self.first, self.first)

    def fit(self, angle: Callable[[Array], Array]) -> Array:
        """Return the coefficients of theta = angle(s)."""
        return np.linalg.lstsq(self.shapes, angle(self.s), rcond=None)[0]

    def accelerations(self, c: Array, rate: Array, base: Array, arm_rate: float) -> Array:
        """Return the second derivatives of the coefficients; the base has the acceleration `base` (2,), m/s^2."""
        theta, turn = self.shapes @ c, self.shapes @ rate
        d, n = np.array([np.sin(theta), -np.cos(theta)]), np.array([np.cos(theta), np.sin(theta)])
        moved = np.einsum("pq,iq,qk->ipk", self.cumulated, n, self.shapes)  # dr by each coefficient
        weighted = self.mu * self.weight[:, None] * moved
        mass = np.einsum("ipk,ipl->kl", weighted, moved)
        given = (base - self.gravity)[:, None] - (d * turn**2) @ self.cumulated.T
        forces = -np.einsum("ipk,ip->k", weighted, given) - self.bending @ rate + self.hinge * arm_rate * self.first
        return np.linalg.solve(mass, forces)

    def run(
        self, c: Array, t: Array, motion: Callable[[float], tuple[Array, float]] | None = None, *, tol: float = 1e-9
    ) -> Array:
        """Return the coefficients (T, modes) at times t from rest; motion(t): base acceleration, arm rate."""
        still = (np.zeros(2), 0.0)

        def slope(now: float, y: Array) -> Array:
            rate = y[c.size :]
            return np.append(rate, self.accelerations(y[: c.size], rate, *(still if motion is None else motion(now))))

        start = np.append(c, np.zeros(c.size))
        # Radau: BDF of scipy computes with numbers that it has not set, and warns of some.
        return solve_ivp(slope, t[[0, -1]], start, method="Radau", t_eval=t, rtol=tol, atol=tol).y[: c.size].T

    def tip(self, c: Array) -> Array:
        """Return the tip relative to the base (T, 2), m."""
        theta = c @ self.shapes.T
        return np.stack([np.sin(theta) @ self.weight, -np.cos(theta) @ self.weight], axis=-1)


def tension(
    length: float, mu: float, angle: Callable[[Array], tuple[Array, Array]], turn: Callable[[Array], Array], s: Array
) -> Array:
    """Return the tension, N, of a string without bending viscosity at places s, by its boundary problem.

    T'' - theta'^2 T = -mu theta_t^2, T' = -mu g . d at the fixed end, T = 0 at the free one. `angle` returns theta and
    its slope, 1/m, `turn` theta_t, 1/s.
    """

    def slopes(at: Array, y: Array) -> Array:
        return np.stack([y[1], angle(at)[1] ** 2 * y[0] - mu * turn(at) ** 2])

    def ends(first: Array, last: Array) -> Array:
        return np.array([first[1] - mu * -9.81 * np.cos(angle(np.zeros(1))[0][0]), last[0]])

    nodes = np.linspace(0.0, length, 41)
    return solve_bvp(slopes, ends, nodes, np.zeros((2, 41)), tol=1e-9).sol(s)[0]
