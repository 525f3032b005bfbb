"""Predictability: growth of small errors and the largest Lyapunov exponent."""

import math
from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import Rope, Setup, SetupFields
from hyperflex.motion import Motion
from hyperflex.simulation.runs import setup_of
from hyperflex.simulation.sensitivity import AngleJacobian

MOST_NUDGES = 1000
FINE = 1e-9  # of the rope's length: the tolerance of the run
LEAST = 1e-30  # factor by which a nudge shrinks at most between two times: of less nothing would be left


@dataclass(frozen=True, eq=False, repr=False)
class Predictability:
    """Growth of small errors along a run; made by :func:`predictability`.

    The size of an error is the largest displacement of a joint or, if larger, the largest change of a joint's velocity
    times the swing time sqrt(length / g), at most 1 s. An error that only oscillates therefore keeps its size.

    Attributes
    ----------
    t : (T,) float64
        Times, s.
    size : (m, T) float64
        Size of each perturbation relative to its initial size; 1 at t[0].
    displacement : (m, T) float64
        Largest displacement of a joint, in the same unit: at most `size`.
    tol : float
        Tolerance of the set-up, m.
    """

    t: Array
    size: Array
    displacement: Array
    tol: float

    def __repr__(self) -> str:
        worst = f"an error grows up to {float(self.growth.max()):.3g}-fold"
        return f"<Predictability over {self.t[0]:g} to {self.t[-1]:g} s, {len(self.size)} nudges: {worst}>"

    @property
    def growth(self) -> Array:
        """Displacement of the worst joint by the worst nudge, in units of the nudge at the start (T,)."""
        return np.asarray(self.displacement.max(axis=0), dtype=np.float64)

    @property
    def amplification(self) -> Array:
        """By how much the worst error made at any earlier time has grown, at least 1 (T,)."""
        since = self.displacement / np.minimum.accumulate(self.size, axis=1)
        return np.asarray(np.maximum(1.0, since.max(axis=0)), dtype=np.float64)

    def exponent(self, begin: float | None = None, end: float | None = None) -> float:
        """Return the largest finite-time Lyapunov exponent between two times, 1/s; by default of the whole run.

        If it is positive, errors grow by e in each 1/exponent seconds. Over a short time it includes the transient in
        which the perturbations turn into the direction of fastest growth: exclude the beginning if that matters.
        `begin` and `end`, s, are rounded to the nearest of `t`; InvalidInput if there is no time between them.
        """
        first, last = (
            int(np.argmin(np.abs(self.t - (default if at is None else checks.number(name, at, unit="s")))))
            for name, at, default in (("begin", begin, self.t[0]), ("end", end, self.t[-1]))
        )
        if first >= last:
            raise InvalidInput("no time lies between begin and end", got=[begin, end], allowed="begin < end, in s")
        ratios = self.size[:, last] / self.size[:, first]
        return float(np.log(ratios.max()) / (self.t[last] - self.t[first]))

    def horizon(self, allowed: float) -> float:
        """Return the time, s, up to which an error of `tol`, made anywhere on the way, stays below `allowed`, m.

        `allowed` is the largest displacement of any joint that still means something. Infinite if the error stays below
        it for the whole run; 0.0 if it is less than `tol`; InvalidInput if it is not a number > 0.
        """
        limit = checks.number("allowed", allowed, sign="positive", unit="m") / self.tol
        if limit < 1.0:
            return 0.0
        grown = self.amplification
        if not (grown > limit).any():
            return math.inf
        late = int(np.argmax(grown > limit))
        before, after = np.log(grown[late - 1 : late + 1])  # between two times errors grow by powers
        part = (math.log(limit) - before) / (after - before)
        return float(self.t[late - 1] + part * (self.t[late] - self.t[late - 1]))


@interruptible()
def predictability(
    rope: Rope | Setup,
    motion: Motion | None = None,
    *,
    nudges: int = 3,
    seed: int = 0,
    sample_time: float = 0.05,
    **setup: Unpack[SetupFields],
) -> Predictability:
    """Measure the growth of small errors along a run, and thereby the time for which it is predictable.

    Parameters
    ----------
    rope, motion, **setup
        As in :func:`hyperflex.simulate`. `tol` is the initial error, m, of :meth:`Predictability.horizon`.
    nudges : int
        Number of perturbations, random changes of all angles and rates.
    seed : int
        For the nudges.
    sample_time : float
        Time between two renormalisations, s, and between the times of the result.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.
    SimulationError
        If the run fails.

    Notes
    -----
    The tolerance of the run is 1e-9 of the rope's length. The perturbations are infinitesimal: exact derivatives of the
    computed run, as of :func:`hyperflex.sensitivities`. Every `sample_time` each is rescaled to its initial size in its
    current direction (Benettin et al. 1980, doi:10.1007/BF02128236). This is an estimate: a few perturbations may miss
    a short growth. The run is in free flight: obstacles are refused.

    Examples
    --------
    >>> import hyperflex as hf
    >>> rods = hf.Rope(length=[0.5, 0.5], mass=[0.1, 0.1])
    >>> growth = hf.predictability(rods, duration=4.0, q0=[3.0, 2.5], tol=1e-6)
    >>> bool(growth.exponent() > 1.0), bool(growth.horizon(1e-3) < 4.0)
    (True, True)
    """
    full, _ = setup_of(rope, {**setup, "motion": motion})
    count = checks.count("nudges", nudges, most=MOST_NUDGES)
    rng = np.random.default_rng(checks.count("seed", seed, least=0))
    spacing = checks.number("sample_time", sample_time, sign="positive", unit="s")
    fine = replace(full, tol=FINE * full.rope.total_length, method="extrapolation", step=None)
    run = AngleJacobian(fine, most=count)
    t = np.linspace(0.0, full.duration, max(2, math.ceil(full.duration / spacing - 1e-9) + 1))
    (q, qd), changes = full.start(), _first_nudges(full, count, rng)
    size, displacement = np.ones((count, t.size)), np.ones((count, t.size))
    for k in range(1, t.size):
        (*_, q), (*_, qd), dq, dqd = run(t[k - 1 : k + 1], q, qd, changes=changes.reshape(count, 2 * q.size))
        changes = np.stack([dq[-1].T, dqd[-1].T], axis=1)
        moved, hastened = _displaced(full, q, changes).T
        grown = np.maximum(np.maximum(moved, hastened), LEAST)
        displacement[:, k], size[:, k] = size[:, k - 1] * moved, size[:, k - 1] * grown
        changes /= grown[:, None, None]
    return Predictability(t, size, displacement, full.tol)


def _displaced(setup: Setup, q: Array, changes: Array) -> Array:
    """Displacement of the worst joint (..., 2), m, by small changes (..., 2, n) of angles, and of rates in a swing."""
    reach = setup.rope.total_length
    swing_time = math.sqrt(reach / max(math.hypot(*setup.rope.gravity), reach))
    across = setup.chain().length[:, None] * np.stack([np.cos(q), np.sin(q)], axis=1)
    places = np.cumsum(changes[..., None] * across, axis=-2)
    return np.asarray(np.linalg.norm(places, axis=-1).max(axis=-1) * [1.0, swing_time])


def _first_nudges(setup: Setup, count: int, rng: np.random.Generator) -> Array:
    """Random changes (count, 2, n) of all angles and rates, each of the size 1."""
    q = setup.start()[0]
    changes = rng.normal(0.0, 1.0, (count, 2, q.size))
    return np.asarray(changes / _displaced(setup, q, changes)[..., None])
