"""Ropes that set out together: what a batch of throws is made of, in free flight and beside a peg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hyperflex.checks import Array
from hyperflex.model import Peg, Rope
from hyperflex.motion import Motion
from hyperflex.simulation import Batch

INTERRUPTED = "interrupted"  # status of a member of a batch that Ctrl-C cut short


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
