"""Batch rollouts of ropes that each have a peg and a motion of their own, in free flight or in contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Arm, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.simulation import Batch, simulate_batch
from hyperflex.simulation.time_budget import INTERRUPTED


@dataclass(frozen=True, eq=False)
class RolloutBatch:
    """A batch of M rollouts, each with a rope, a peg and a motion.

    Attributes
    ----------
    ropes, pegs, motions : (M,) sequences
        Motions begin with the rollout, at t = 0. Without contact `pegs` may be empty.
    q, qd : (M, n) float64
        Angles, rad, and rates, rad/s, at the start.
    since : float
        Time of the throw at the start of the rollout, s.
    """

    ropes: Sequence[Rope]
    pegs: Sequence[Peg]
    motions: Sequence[Motion]
    q: Array
    qd: Array
    since: float = 0.0

    @classmethod
    def from_rest(cls, ropes: Sequence[Rope], pegs: Sequence[Peg], motions: Sequence[Motion]) -> RolloutBatch:
        """Return rollouts of ropes (M,) that hang at rest."""
        q = np.array([np.full(rope.n_links, rope.hanging_angle) for rope in ropes])
        return cls(ropes, pegs, motions, q, np.zeros_like(q))

    def __len__(self) -> int:
        return len(self.ropes)

    def select(self, rows: Sequence[int]) -> RolloutBatch:
        """Return some of the rollouts."""
        ropes, pegs = [self.ropes[m] for m in rows], [self.pegs[m] for m in rows]
        motions = [self.motions[m] for m in rows]
        return RolloutBatch(ropes, pegs, motions, self.q[list(rows)], self.qd[list(rows)], self.since)

    def run(self, arm: Arm, t: Array, **options: Any) -> Batch:
        """Simulate to the last of the times t (T,), s, with samples there; `options` as for ``simulate_batch``."""
        batch = simulate_batch(
            list(self.ropes),
            list(self.motions),
            arm=arm,
            duration=float(t[-1]),
            q0=self.q,
            qd0=self.qd,
            t_eval=t,
            **options,
        )
        return not_interrupted(batch)


def simulate_swings(cast_setup: CastSetup, motions: Sequence[Motion], t: Array, **options: Any) -> Batch:
    """Simulate free swings from rest at t = 0 under motions (M,), with samples at times t (T,), s.

    `options` as for ``simulate_batch``. Raises KeyboardInterrupt if Ctrl-C ended the batch.
    """
    rope, arm, duration = cast_setup.rope, cast_setup.arm, float(t[-1])
    return not_interrupted(simulate_batch(rope, list(motions), arm=arm, duration=duration, t_eval=t, **options))


def not_interrupted(batch: Batch) -> Batch:
    """Return the batch.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C ended the batch: it keeps the members that are done and marks the rest, and a search must not go on
        with these.
    """
    if INTERRUPTED in batch.status:
        raise KeyboardInterrupt
    return batch
