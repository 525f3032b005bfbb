"""What pictures draw: shapes of the rope between the samples of a run, and the pegs beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Peg
from hyperflex.trajectory import Trajectory

TALLEST = 1.15  # height of a picture, in widths


@dataclass(frozen=True, eq=False)
class Shapes:
    """Rope and arm at k instants.

    Attributes
    ----------
    joints : (k, n+1, 2) float64
        Joint positions, m, the tip last.
    pivots : (k, 2) float64
        The motor's shaft, m; the first joint where there is no arm.
    """

    joints: Array
    pivots: Array


def shapes(run: Trajectory, times: Array) -> Shapes:
    """Return the rope at `times` (k,), s, by cubic interpolation of angles and rates; links keep their length."""
    q = _between(run.t, run.q, run.qd, times)
    base = _between(run.t, run.base, run.base_velocity, times)
    spans = run.setup.rope.length[:, None] * np.stack([np.sin(q), -np.cos(q)], axis=-1)
    joints = np.cumsum(np.concatenate([base[:, None], spans], axis=1), axis=1)
    if run.setup.arm is None:
        return Shapes(joints, base)
    angle = _between(run.t, run.arm_angle, run.arm_rate, times)
    return Shapes(joints, base - run.setup.arm.length * np.stack([np.sin(angle), -np.cos(angle)], axis=-1))


def widened(low: Array, high: Array) -> tuple[Array, Array]:
    """Return lower left and upper right corner (2,), m, of a view that is no taller than TALLEST times its width."""
    across, up = high - low
    side = np.array([0.5 * max(0.0, up / TALLEST - across), 0.0])
    return low - side, high + side


def pegs_of(run: Trajectory) -> list[Peg]:
    """Return the round pegs that a run was simulated with."""
    return [one for one in run.setup.pegs if isinstance(one, Peg)]


def _between(t: Array, value: Array, rate: Array, times: Array) -> Array:
    from scipy.interpolate import CubicHermiteSpline

    return np.asarray(CubicHermiteSpline(t, value, rate)(times))
