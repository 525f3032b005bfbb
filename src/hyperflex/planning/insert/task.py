"""The insertion as a task of the tip: the rope in the middle of a slot from the tip's entry to the depth asked."""

import math
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.insert.chance import FINER, PLACE, finer_rope
from hyperflex.planning.insert.entry import Entry, entry_residuals, entry_shortfall, find_entry
from hyperflex.planning.insert.outcome import InsertOutcome, verify_insert
from hyperflex.planning.insert.search import score_entries
from hyperflex.planning.insert.slot import Slot
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.task import TipCandidate, TipTask, Verified
from hyperflex.simulation import Deadline

TIGHTER = 5.0  # times, by which the tolerance of the second verification is less


class InsertTask(TipTask[Entry]):
    """Bring the tip through a slot, from swings that nearly do."""

    close, direct = 2e-3, 32

    def __init__(self, cast_setup: CastSetup, slot: Slot, swings: list[TipCandidate]) -> None:
        self.cast_setup, self.slot, self.swings = cast_setup, slot, swings
        self.finer = replace(cast_setup, rope=finer_rope(cast_setup.rope))

    def candidates(self) -> list[TipCandidate]:
        """Return the swings, the cheapest first."""
        return self.swings

    def score(self, strokes: list[Strokes], threads: int | None) -> tuple[Array, Array]:
        """Return cost, m, and time, s, of the cheapest entry of each swing."""
        return score_entries(self.cast_setup, self.slot, strokes, threads)

    def find(self, strokes: Strokes, near: float) -> Entry | None:
        """Return the way through the slot that ends next to time `near`, s."""
        return find_entry(self.cast_setup, self.slot, strokes, near)

    def residuals(self, aim: Entry) -> tuple[Array, Array]:
        """Return the rope's offsets from the middle of the gap, and depth and other gaps if they fail."""
        return entry_residuals(self.cast_setup, self.slot, aim)

    def shortfall(self, aim: Entry) -> float:
        """Return by how much offsets, depth and gaps fail, m, 0 if they do not."""
        return entry_shortfall(self.cast_setup, self.slot, aim)

    def uncertainty(self, aim: Entry) -> float:
        """Return how uncertain the rope's way through the gap is, in parts of the room that it leaves on one side."""
        room = 0.5 * self.slot.width - self.cast_setup.rope.radius - float(np.abs(aim.offset).max())
        return math.hypot(aim.position_std, PLACE) / max(room, 1e-9)

    def verify(self, aim: Entry, end: Deadline | None) -> Verified:
        """Simulate an insertion beside the walls, with the links as planned, and with more at a tighter tolerance."""
        motion = aim.strokes.motion(self.cast_setup.limits)
        outcome = verify_insert(self.cast_setup, self.slot, motion, aim.t, time_budget=end)
        if outcome is None or outcome.message:
            return Verified(aim, outcome, None, failure(outcome, None))
        finer = verify_insert(
            self.finer,
            self.slot,
            motion,
            aim.t,
            tol=DEFAULT_TOL / TIGHTER,
            contact_step=0.5 * DEFAULT_CONTACT_STEP,
            time_budget=end,
        )
        return Verified(aim, outcome, finer, failure(outcome, finer))


def failure(outcome: InsertOutcome | None, finer: InsertOutcome | None) -> str:
    """Return why an insertion fails, empty if it succeeds."""
    if outcome is None:
        return "in the verified run the tip does not go through the slot"
    if outcome.message:
        return outcome.message
    if finer is None:
        return f"with {FINER:g} times the links the tip does not go through the slot"
    return f"with {FINER:g} times the links {finer.message}" if finer.message else ""
