"""The insertion as a task of the tip: the rope in the middle of a slot from the tip's entry to the depth asked."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL
from hyperflex.planning.insert.chance import FINER, PLACE, finer_rope
from hyperflex.planning.insert.entry import Entry, entry_residuals, entry_shortfall, find_entry
from hyperflex.planning.insert.outcome import InsertOutcome, verify_insert
from hyperflex.planning.insert.search import score_entries
from hyperflex.planning.insert.slot import Slot
from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.aim import WINDOW
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.task import AFTER, NEVER, TipCandidate, TipTask, Verified
from hyperflex.simulation import Deadline

# Chosen on slots 3, 9 and 20 of the benchmark, which searches about swings of two or three strokes did not enter.
DIRECT, READY = 8, 0.02  # swings aimed before any search; m, cost at which a search ends
ROUNDS = 4  # of a search that goes on
FREE = 4  # strokes: their 8 parameters are more than three offsets, the depth and a gap or two; 5 or 6 find no more
MORE = 2  # strokes that are added where a search goes on
LATE = 0.2  # swing periods before an entry, after which a stroke does not reach the tip
TIGHTER = 5.0  # times, by which the tolerance of the second verification is less
# m, distance from the walls below which a rope must not pass where both verified runs differ by more than it: a third
# run may touch. Of seven insertions they differ by 0.0 to 2.1 mm; one of 0.8 mm, 1.6 mm less than at first, held
NARROW = 5e-4


class InsertTask(TipTask[Entry]):
    """Bring the tip through a slot, from swings that nearly do."""

    close, direct, ready, rounds = 2e-3, DIRECT, READY, ROUNDS

    def __init__(self, problem: Problem, slot: Slot, swings: list[TipCandidate]) -> None:
        self.problem, self.slot, self.swings = problem, slot, swings
        self.finer = replace(problem, rope=finer_rope(problem.rope))

    def candidates(self) -> list[TipCandidate]:
        """Return the swings, the cheapest first."""
        return self.swings

    def score(self, strokes: list[Strokes], threads: int | None, until: float) -> tuple[Array, Array]:
        """Return cost, m, and time, s, of the cheapest entry of each swing."""
        sooner = replace(self.problem, time=min(self.problem.time, until))
        return score_entries(sooner, self.slot, strokes, threads)

    def starts(self) -> Iterator[TipCandidate]:
        """Yield the cheapest swing of each side and number of strokes, then the second of each, and so on."""
        alike, number = Counter[tuple[int, int]](), list[int]()
        for each in self.swings:
            cut = each.strokes.cut(each.t + WINDOW, self.problem.limits)
            alike[kind := (cut.side, cut.ends.size)] += 1
            number.append(alike[kind])
        for k in np.argsort(number, kind="stable").tolist():
            yield self.swings[k]

    def freed(self, found: TipCandidate, number: int) -> TipCandidate:
        """Return a swing with strokes enough to vary all that an entry is asked for, and with more each time."""
        limits, late = self.problem.limits, LATE * self.problem.period
        cut = found.strokes.cut(found.t + WINDOW, limits)
        more = cut.with_more(FREE + number * MORE, found.t - late, limits)
        (cost,), (t,) = self.score([more], 1, found.t + AFTER)
        self.runs += 1
        return TipCandidate(float(cost), float(t), more) if cost < NEVER else found._replace(strokes=cut)

    def find(self, strokes: Strokes, near: float) -> Entry | None:
        """Return the way through the slot that ends next to time `near`, s."""
        return find_entry(self.problem, self.slot, strokes, near)

    def residuals(self, aim: Entry) -> tuple[Array, Array]:
        """Return the rope's offsets from the middle of the gap, and depth and other gaps if they fail."""
        return entry_residuals(self.problem, self.slot, aim)

    def shortfall(self, aim: Entry) -> float:
        """Return by how much offsets, depth and gaps fail, m, 0 if they do not."""
        return entry_shortfall(self.problem, self.slot, aim)

    def uncertainty(self, aim: Entry) -> float:
        """Return how uncertain the rope's way through the gap is, in parts of the room that it leaves on one side."""
        room = 0.5 * self.slot.width - self.problem.rope.radius - float(np.abs(aim.offset).max())
        return math.hypot(aim.position_std, PLACE) / max(room, 1e-9)

    def verify(self, aim: Entry, end: Deadline | None) -> Verified:
        """Simulate an insertion beside the walls, with the links as planned, and with more at a tighter tolerance."""
        motion = aim.strokes.motion(self.problem.limits)
        outcome = verify_insert(self.problem, self.slot, motion, aim.t, time_budget=end)
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
        finer = finer if finer is None or self.slot.touching else foreseen(outcome, finer)
        return Verified(aim, outcome, finer, failure(outcome, finer))


def foreseen(first: InsertOutcome, finer: InsertOutcome) -> InsertOutcome:
    """Return an outcome with finer links, as failed if both runs do not tell whether a real rope touches the walls.

    That is so if it passes them by less than NARROW, and by less than its distances in both runs differ.
    """
    given, now = first.wall_clearance, finer.wall_clearance
    if finer.message or min(given, now) >= min(NARROW, abs(given - now)):
        return finer
    how = f"{1e3 * now:.1f} mm, not {1e3 * given:.1f} mm, from the walls"
    return replace(finer, message=f"it passes {how}: whether it touches is left to chance")


def failure(outcome: InsertOutcome | None, finer: InsertOutcome | None) -> str:
    """Return why an insertion fails, empty if it succeeds."""
    if outcome is None:
        return "in the verified run the tip does not go through the slot"
    if outcome.message:
        return outcome.message
    if finer is None:
        return f"with {FINER:g} times the links the tip does not go through the slot"
    return f"with {FINER:g} times the links {finer.message}" if finer.message else ""
