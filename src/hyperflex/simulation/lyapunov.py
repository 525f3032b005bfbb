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
from hyperflex.simulation.arguments import setup_of
from hyperflex.simulation.outcome import refuse_failure
from hyperflex.simulation.rollouts import finish_rollout, prepare_rollout, rollout_limits
from hyperflex.simulation.runs import simulate

NUDGE = 1e-5  # of the rope's length: far above the runs' own errors, far below where growth is no longer proportional
MOST_NUDGES = 1000
FINE = 1e-9  # of the rope's length: the tolerance of all runs


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
        Number of perturbed runs, each with random changes of all angles and rates.
    seed : int
        For the nudges.
    sample_time : float
        Time between two renormalisations, s, and between the times of the result.

    Raises
    ------
    InvalidInput
        If an argument cannot be used.
    SimulationError
        If one of the runs fails.

    Notes
    -----
    The tolerance of the runs is 1e-9 of the rope's length, the perturbations are 1e-5 of it. Every `sample_time` each
    perturbation is rescaled to its initial size in its current direction (Benettin et al. 1980,
    doi:10.1007/BF02128236), so it neither saturates nor falls below the errors of the runs. The cost is about 4 (1 +
    nudges) runs at the default tolerance. This is an estimate: a few perturbations may miss a short growth.

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
    seed = checks.count("seed", seed, least=0)
    spacing = checks.number("sample_time", sample_time, sign="positive", unit="s")
    reach = full.rope.total_length
    fine = replace(full, tol=FINE * reach, method="extrapolation", step=None)
    t = np.linspace(0.0, full.duration, max(2, math.ceil(full.duration / spacing - 1e-9) + 1))
    q, w = _states(fine, t)
    directions = _first_nudges(fine, count, np.random.default_rng(seed))
    size, displacement = np.ones((count, t.size)), np.ones((count, t.size))
    for m, nudge in enumerate(directions):
        for k in range(1, t.size):
            nudge, grown, moved = _drift(fine, t[k - 1 : k + 1], (q[k - 1], w[k - 1]), (q[k], w[k]), nudge)
            displacement[m, k] = size[m, k - 1] * moved
            size[m, k] = size[m, k - 1] * grown
    return Predictability(t, size, displacement, full.tol)


def _states(setup: Setup, t: Array) -> tuple[Array, Array]:
    """Angles and rates (T, n) of the whole chain, a torque-driven arm first."""
    run = simulate(setup, t_eval=t)
    if not setup.torque_driven:
        return run.q, run.qd
    return np.column_stack([run.arm_angle, run.q]), np.column_stack([run.arm_rate, run.qd])


def _swing_time(setup: Setup) -> float:
    """Time scale between changes of velocity and changes of position, s."""
    pull = math.hypot(*setup.rope.gravity)
    return math.sqrt(setup.rope.total_length / max(pull, setup.rope.total_length))


def _measures(setup: Setup, q: Array, change: Array) -> tuple[float, float]:
    """Size of a small change (2, n) of angles and rates, m, and how far it displaces the worst joint, m."""
    across = setup.chain().length[:, None] * np.stack([np.cos(q), np.sin(q)], axis=1)
    moved, hastened = (float(np.hypot(*np.cumsum(part[:, None] * across, axis=0).T).max()) for part in change)
    return max(moved, _swing_time(setup) * hastened), moved


def _first_nudges(setup: Setup, count: int, rng: np.random.Generator) -> list[Array]:
    """Random changes (2, n) of all angles and rates, each as large as NUDGE of the length."""
    q = setup.start()[0]
    reach = NUDGE * setup.rope.total_length
    changes = []
    for _ in range(count):
        change = rng.normal(0.0, 1.0, (2, q.size))
        for row, haste in ((0, 1.0), (1, _swing_time(setup))):
            alone = np.zeros_like(change)
            alone[0] = change[row]
            change[row] *= reach / (haste * _measures(setup, q, alone)[1])
        changes.append(change)
    return changes


def _drift(
    setup: Setup, t: Array, start: tuple[Array, Array], end: tuple[Array, Array], nudge: Array
) -> tuple[Array, float, float]:
    """Run from `start` plus `nudge` over t (2,): the new nudge, as large as the first; its growth; its displacement."""
    chain = setup.chain()
    nudged = (start[0] + nudge[0], start[1] + nudge[1])
    run = prepare_rollout(chain, setup.drive(), nudged, t, rollout_limits(setup, chain, float(t[1])))
    refuse_failure(finish_rollout(run), run)
    n = chain.length.size
    change = np.stack([run.y[1, :n] - end[0], run.y[1, n : 2 * n] - end[1]])
    unit = NUDGE * setup.rope.total_length
    size, moved = _measures(setup, end[0], change)
    if not size > 0.0:  # not a trace of the nudge is left: go on with the least that could be seen
        return nudge, FINE / NUDGE, 0.0
    return change * (unit / size), size / unit, moved / unit
