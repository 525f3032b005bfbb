"""Batch rollouts of ropes that each have a peg and a motion of their own, in free flight or in contact."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Obstacle, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.planning.problem import Problem
from hyperflex.simulation import Batch, simulate_batch


@dataclass(frozen=True, eq=False)
class RolloutBatch:
    """A batch of M rollouts, each with a rope, a peg and a motion of its own.

    Motions begin with the rollout, at t = 0; without contact `pegs` may be empty. `q`, rad, and `qd`, rad/s, (M, n) are
    those at the start, `since`, s, the time of the throw there. In contact there are the pegs `behind`, too, which
    the rope is to run behind; `obstacles`, not to be touched, are not simulated.
    """

    ropes: Sequence[Rope]
    pegs: Sequence[Peg]
    motions: Sequence[Motion]
    q: Array
    qd: Array
    since: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()
    behind: tuple[Peg, ...] = ()

    @classmethod
    def from_start(
        cls, problem: Problem, ropes: Sequence[Rope], pegs: Sequence[Peg], motions: Sequence[Motion]
    ) -> "RolloutBatch":
        """Return rollouts of ropes (M,) from the start of a cast set-up."""
        q, qd = (np.tile(part, (len(ropes), 1)) for part in problem.start)
        return cls(ropes, pegs, motions, q, qd, obstacles=problem.obstacles, behind=problem.behind)

    @classmethod
    def from_state(
        cls, ropes: Sequence[Rope], pegs: Sequence[Peg], motions: Sequence[Motion], state: RopeState
    ) -> "RolloutBatch":
        """Return rollouts (M,) that go on from an observed state, under motions on the clock of the throw."""
        q, qd = (np.broadcast_to(part, (len(ropes), part.size)) for part in (state.q, state.qd))
        return cls(ropes, pegs, [motion.shifted(-state.t) for motion in motions], q, qd, state.t)

    def __len__(self) -> int:
        return len(self.ropes)

    def select(self, rows: Sequence[int]) -> "RolloutBatch":
        """Return some of the rollouts."""
        ropes, pegs = [self.ropes[m] for m in rows], [self.pegs[m] for m in rows]
        motions = [self.motions[m] for m in rows]
        return replace(self, ropes=ropes, pegs=pegs, motions=motions, q=self.q[list(rows)], qd=self.qd[list(rows)])

    def run(self, arm: Arm, t: Array, **options: Any) -> Batch:
        """Simulate to the last of the times t (T,), s, with samples there; `options` as for ``simulate_batch``."""
        return simulate_batch(
            list(self.ropes),
            list(self.motions),
            arm=arm,
            duration=float(t[-1]),
            q0=self.q,
            qd0=self.qd,
            t_eval=t,
            **options,
        )


def usable_threads(threads: int | None) -> int:
    """Return a number of threads, by default one a processor; raises InvalidInput if it cannot be used."""
    if threads is None:
        return os.cpu_count() or 1
    return checks.count("threads", threads, most=checks.MOST_THREADS)
