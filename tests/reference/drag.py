"""Air drag on links by quadrature: forces at points along each link, projected on the rates by their Jacobians.

Each link is cut where the velocity across it changes its sign, and either part has Gauss's points: the integrands are
polynomials of at most the fourth degree there. The package integrates by closed forms and hands forces from link to
link instead. Arguments may be complex or of extended precision.
"""

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

Real = npt.NDArray[Any]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(5)


def points(links: Any, i: int, across: Any, rate: Any) -> tuple[Real, Real]:
    """Places along link i and their weights, m, for a velocity ``across + s rate`` across it."""
    length = links.length[i] + 0 * across
    near, far = np.real(across), np.real(across + length * rate)
    ends = [0 * length, -across / rate, length] if near * far < 0 else [0 * length, length]
    nodes, weights = NODES.astype(ends[0].dtype), WEIGHTS.astype(ends[0].dtype)
    parts = list(pairwise(ends))
    return (
        np.concatenate([a + (b - a) * (nodes + 1) / 2 for a, b in parts]),
        np.concatenate([(b - a) * weights / 2 for a, b in parts]),
    )


def forces(links: Any, q: Real, w: Real, velocity: Real) -> tuple[Real, Real, Any]:
    """Generalised forces (n,), N m, on the rates of links; force (2,), N, on all; and the power that the air takes, W.

    `velocity` (2,) is that of the first joint, m/s.
    """
    n = len(q)
    across = np.stack([np.cos(q), np.sin(q)], axis=-1)
    generalised, total, power = 0 * q * w, 0 * velocity * w[0], 0 * w[0]
    start = velocity + 0 * total
    for i in range(n):
        places, weights = points(links, i, np.sum(start * across[i]), w[i])
        for s, weight in zip(places, weights, strict=True):
            jacobian = np.zeros((2, n), generalised.dtype)
            jacobian[:, :i] = (links.length[:i, None] * across[:i]).T
            jacobian[:, i] = s * across[i]
            v = np.sum((velocity + jacobian @ w) * across[i])
            force = -links.drag[i] * np.sign(np.real(v)) * v * v * weight * across[i]
            generalised = generalised + jacobian.T @ force
            total = total + force
            power = power - np.sum(force * (velocity + jacobian @ w))
        start = start + links.length[i] * w[i] * across[i]
    return generalised, total, power
