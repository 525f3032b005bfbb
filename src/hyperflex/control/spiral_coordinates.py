"""The tip's pseudo-energy and spiral coordinates: how far a rope has been pumped up, and the phase of its swing."""

from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array


@dataclass(frozen=True, eq=False)
class Spiral:
    """Polar coordinates of the tip's horizontal motion, (c dx/dt, x) = r (cos theta, sin theta).

    Attributes
    ----------
    t : (T,) float64
        Time, s.
    x, scaled_velocity : (T,) float64
        Horizontal tip position, and c dx/dt, m.
    r : (T,) float64
        Radius, m: the amplitude that a harmonic swing of angular frequency 1/c would have.
    theta : (T,) float64
        Phase, rad, unwrapped; a harmonic swing at 1/c advances by exactly 1/c in a second.
    c : float
        Time constant, s.
    """

    t: Array
    x: Array
    scaled_velocity: Array
    r: Array
    theta: Array
    c: float


def spiral(t: object, x: object, velocity: object, c: float) -> Spiral:
    """Turn the tip's horizontal motion into spiral coordinates.

    Parameters
    ----------
    t : (T,) array_like
        Time, s, strictly increasing, with several samples to a swing (the phase is unwrapped between neighbours).
    x, velocity : (T,) array_like
        Horizontal position, m, and velocity, m/s, of the tip.
    c : float
        Time constant sqrt(M/K), s, > 0: the square root of mass over pseudo-elastic coefficient.

    Raises
    ------
    InvalidInput
        Arrays of unequal length, values that are not finite, or a time constant that is not positive.

    Notes
    -----
    Paper eqs. (10) and (11). The printed (10) reads sqrt((c x)^2 + x^2); the derivation from (9) gives
    sqrt((c dx/dt)^2 + x^2), which is what stands here. The phase uses the two-argument arctangent, so that it keeps
    its quadrant where (11) alone would jump.

    Examples
    --------
    >>> t = np.linspace(0.0, 6.0, 601)
    >>> swing = spiral(t, 0.5 * np.sin(t / 0.4), 0.5 / 0.4 * np.cos(t / 0.4), c=0.4)
    >>> bool(np.allclose(swing.r, 0.5)), bool(np.allclose(swing.theta, t / 0.4))
    (True, True)
    """
    times = checks.times("t", t)
    place = checks.array("x", x, times.shape, unit="m")
    scale = checks.positive("c", c, "s")
    scaled = scale * checks.array("velocity", velocity, times.shape, unit="m/s")
    theta = np.unwrap(np.arctan2(place, scaled))
    return Spiral(times, place, scaled, np.hypot(scaled, place), theta, scale)


def pseudo_energy(x: Array, velocity: Array, mass: float, c: float) -> Array:
    """Return the pseudo-energy E = M/2 (dx/dt)^2 + K/2 x^2 (T,), J, with K = M / c^2.

    r of :func:`spiral` is sqrt(2 E / K). `x`, m, and `velocity`, m/s, (T,) are the tip's, `mass` M the rope's total
    mass, kg, and `c` sqrt(M/K), s. Paper eq. (9). No energy of the rope itself: a measure of the tip's horizontal
    swing.
    """
    total = checks.positive("mass", mass, "kg")
    stiffness = total / checks.positive("c", c, "s") ** 2
    return 0.5 * total * velocity**2 + 0.5 * stiffness * x**2


def driving_constant(t_move: float, t_rest: float) -> float:
    """Return the time constant c = (t_move + t_rest) / pi of a swing in step with the arm, s.

    The arm goes there and back in 2 (t_move + t_rest), so c is one over its angular frequency; the paper's 0.40 s
    and 0.34 s are this figure for its success and (inferred) failure.
    """
    whole = checks.positive("t_move", t_move, "s")
    return (whole + checks.number("t_rest", t_rest, sign="nonnegative", unit="s")) / np.pi
