"""Linear regression of the equation of motion on J and eta (paper (4)-(6))."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.dynamics import bias, mass_matrix
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope

INSEPARABLE = 1e-10  # a singular value below this part of the largest means that J and eta cannot be told apart


@dataclass(frozen=True)
class LeastSquares:
    """The result of :func:`fit_regression`.

    Attributes
    ----------
    inertia, friction : float
        J, kg m^2, and eta, N m s/rad, not bounded.
    std : dict of str to float
        Their standard deviations, for white errors in the known torques. Noise in the columns (rates and accelerations
        by differences) biases the values, and is not covered.
    """

    inertia: float
    friction: float
    std: dict[str, float]


def regression(rope: Rope, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
    """Return Lambda (T, n, 2), torques for one unit of J and of eta in all links, and tau_id (T, n), N m: paper (5).

    Parameters
    ----------
    rope : Rope
    q, qd, qdd : (T, n) float64
        Absolute angles, rad, rates, rad/s, and accelerations, rad/s^2.
    """
    relative = np.eye(rope.n_links) - np.eye(rope.n_links, k=-1)  # from absolute to relative angles: S
    reaction = relative.T if rope.friction_model == "relative" else np.eye(rope.n_links)
    bent = qd @ relative.T
    torques = [mass_matrix(rope, a) @ c + bias(rope, a, b) for a, b, c in zip(q, qd, qdd, strict=True)]
    known = rope.inertia * qdd + (rope.friction * bent) @ reaction.T - np.reshape(torques, q.shape)
    return np.stack([qdd, bent @ reaction.T], axis=2), known


def fit_regression(rope: Rope, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> LeastSquares:
    """Find the J and eta of all links from a motion, by least squares on the equation of motion (paper (5), (6)).

    Parameters
    ----------
    rope : Rope
        Values of all other parameters. Its friction model states on which links the friction of a joint acts: both
        ("relative", -eta S^T S qd) or the outer one only ("printed", -eta S qd, as (4) prints it).
    q, qd, qdd : (T, n) array_like
        Absolute angles, rad, rates, rad/s, and accelerations, rad/s^2; samples with NaN are omitted. The rope hangs
        from a fixed point.

    Raises
    ------
    InvalidInput
        If there are fewer equations than unknowns, both have the same effect in these data, or no known term has an
        effect.

    Notes
    -----
    Dry friction counts by the sign of the joint's rate, and is 0 at rate 0.

    Examples
    --------
    >>> import numpy as np
    >>> import hyperflex as hf
    >>> rope = hf.Rope.uniform(length=1.0, mass=0.01, n_links=5, friction=6e-4)
    >>> run = hf.simulate(rope, duration=2.0, q0=np.full(5, 0.3), tol=1e-8)
    >>> f"{hf.fit_regression(rope, run.q, run.qd, run.qdd).friction:.3e}"
    '6.000e-04'
    """
    n = checks.instance("rope", rope, Rope).n_links
    angles = checks.array("q", q, (-1, n), unit="rad", gaps=True)
    rates = checks.array("qd", qd, angles.shape, unit="rad/s", gaps=True)
    accelerations = checks.array("qdd", qdd, angles.shape, unit="rad/s^2", gaps=True)
    whole = np.isfinite(angles + rates + accelerations).all(axis=1)
    return least_squares(*regression(rope, angles[whole], rates[whole], accelerations[whole]))


def least_squares(columns: Array, known: Array) -> LeastSquares:
    """Return the solution of (6) for Lambda (T, n, 2) and tau_id (T, n), N m."""
    matrix, right = columns.reshape(-1, 2), known.ravel()
    if right.size <= 2:
        raise InvalidInput("too few samples for J and eta", got=right.size, allowed="more than 2 equations")
    if not right.any():
        raise InvalidInput("nothing known acts: J and eta are fixed only up to a common factor", fix="Give it masses")
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale[scale == 0.0] = 1.0
    matrix = matrix / scale
    values, _, rank, _ = np.linalg.lstsq(matrix, right, rcond=INSEPARABLE)
    if rank < 2:
        raise InvalidInput("J and eta act alike, or one not at all, in these data", fix="Record another motion")
    variance = float(((right - matrix @ values) ** 2).sum()) / (right.size - 2)
    std = np.sqrt(variance * np.diag(np.linalg.inv(matrix.T @ matrix))) / scale
    inertia, friction = (values / scale).tolist()
    return LeastSquares(inertia, friction, dict(zip(("inertia", "friction"), std.tolist(), strict=True)))
