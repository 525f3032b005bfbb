"""The common factor of moments, frictions and stiffnesses; unknown without a known force or torque."""

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.identification.model.names import SHARE
from hyperflex.identification.model.parameters import Parameters, lumped
from hyperflex.model import RESISTANCES, Rope

PARALLEL = 0.1  # part of a direction that may lie outside of others for it to count as one of them
Mask = npt.NDArray[np.bool_]


def scaling(parameters: Parameters, x: Array) -> Array | None:
    """Return the direction (P,) in which all moments, frictions and stiffnesses grow alike, or None if there is none.

    In units of ``parameters.widths``, of length 1. It leaves the motion as it is where no known force acts: d/dx of p,
    J (about the joint) and each resistance equals their own value, the lengths between joints stay. Torques have low
    weights: one that is held hides no common factor of the moments.
    """
    now, fixed = _scaled(parameters.rope(x)), np.abs(_scaled(parameters.rope(x)))
    n = parameters.guess.n_links
    sizes = np.concatenate([np.full(n, part.max() or 1.0) for part in fixed.reshape(-1, n)])
    weights = np.where(np.arange(now.size) < 3 * n, 1.0, SHARE) / sizes
    columns = []
    for k, step in enumerate(1e-6 * parameters.widths):
        up = x.copy()
        up[k] += step
        columns.append((_scaled(parameters.rope(up)) - now) / step * parameters.widths[k])
    target = np.where(np.arange(now.size) // n == 2, 0.0, now) * weights
    matrix = np.stack(columns, axis=1) * weights[:, None]
    found: Array = np.linalg.lstsq(matrix, target, rcond=1e-8)[0]
    away = (matrix @ found - target)[: 3 * n]
    length = float(np.linalg.norm(found))
    if np.linalg.norm(away) > PARALLEL * np.linalg.norm(target[: 3 * n]) or length == 0.0:
        return None
    return found / length


def common_factor(parameters: Parameters, x: Array, unknown: Array) -> Array | None:
    """Return `scaling` where it lies among the `unknown` directions (P, k), less what does not; else None."""
    if unknown.shape[1] == 0:
        return None
    common = scaling(parameters, x)
    if common is None or np.linalg.norm(common - unknown @ (unknown.T @ common)) > PARALLEL:
        return None
    return common


def in_common_factor(parameters: Parameters, x: Array, unknown: Array) -> Mask:
    """Return which parameters (P,) stand in an unknown common factor, True also for those at 0.

    At 0 a parameter does not move along the factor, but its uncertainty grows with it: only its ratio is known.
    """
    if common_factor(parameters, x, unknown) is None:
        return np.zeros(len(parameters), dtype=bool)
    return np.array([p.kind.power == 1 and p.law not in ("taper", "pivot") for p in parameters.all])


def _scaled(rope: Rope) -> Array:
    """Return p, J, lengths between joints and all resistances in one row, (n,) of each."""
    between = np.append(rope.length[:-1], 0.0)
    return np.concatenate([*lumped(rope), between, *(getattr(rope, each.name) for each in RESISTANCES)])
