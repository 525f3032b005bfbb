"""Ropes that set out together: what a batch of throws is made of, in free flight and beside a peg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hyperflex.checks import Array
from hyperflex.model import Arm, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.simulation import Batch, simulate_batch
from hyperflex.simulation.time_budget import INTERRUPTED


@dataclass(frozen=True, eq=False)
class Flights:
    """Throws in the air (M), each with a rope, a peg and a motion of its own.

    Attributes
    ----------
    ropes, pegs, motions : (M,) sequences
        The motions begin at `t` = 0, as does the run.
    q, qd : (M, n) float64
        Angles, rad, and rates, rad/s, at the start.
    since : float
        What time it is at the start, s.
    """

    ropes: Sequence[Rope]
    pegs: Sequence[Peg]
    motions: Sequence[Motion]
    q: Array
    qd: Array
    since: float = 0.0

    def __len__(self) -> int:
        return len(self.ropes)

    def part(self, rows: Sequence[int]) -> Flights:
        """Return some of them."""
        ropes, pegs = [self.ropes[m] for m in rows], [self.pegs[m] for m in rows]
        motions = [self.motions[m] for m in rows]
        return Flights(ropes, pegs, motions, self.q[list(rows)], self.qd[list(rows)], self.since)

    def run(self, arm: Arm, t: Array, **how: Any) -> Batch:
        """Run all of them to the last of the times t (T,), s, with samples there; `how` as for ``simulate_batch``."""
        batch = simulate_batch(
            list(self.ropes),
            list(self.motions),
            arm=arm,
            duration=float(t[-1]),
            q0=self.q,
            qd0=self.qd,
            t_eval=t,
            **how,
        )
        return finished(batch)


def finished(batch: Batch) -> Batch:
    """Return a batch whose every member came to its end, or failed.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C cut it short: a batch keeps what is done and marks the rest, and a search must not go on with that.
    """
    if INTERRUPTED in batch.status:
        raise KeyboardInterrupt
    return batch
