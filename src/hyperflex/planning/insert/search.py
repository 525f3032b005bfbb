"""The search for an insertion: random swings whose tip nearly enters a slot, and the feasibility check by them."""

import math
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.clearance import clear_samples
from hyperflex.planning.insert.slot import Slot, find_crossings, frame, passages, tip_speed
from hyperflex.planning.problem import Problem
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.swings import random_swings, simulate_swings
from hyperflex.planning.tip.task import NEVER, Left, TipCandidate

SAMPLE_TIME = 0.01  # s: of swings in a search
SWINGS, TOGETHER = 512, 64  # random swings; those between two looks at the time
MAX_COST = 0.12  # m, cost of the cheapest swing up to which a slot is feasible
HARD_COST = 2.5  # m per m: of what strokes move less easily than all of an entry to one side
TIME_COST = 0.004  # m/s: of equal entries the sooner one is less uncertain
SPEED_COST = 0.03  # m per fraction by which the tip is too fast: chosen so that swings at half the speed come first


@dataclass(frozen=True)
class InsertFeasibility:
    """Result of the feasibility check of a slot.

    `distance` is that of the place asked for the tip from the arm's pivot, m. `cost`, m, is that of the cheapest swing:
    how far from the middle of the gap the rope goes through, and HARD_COST times how much that changes from the tip's
    entry to the depth asked, what lacks to that depth, and how deep other parts of the rope lie in the walls. `message`
    tells why the slot is not feasible.
    """

    distance: float
    cost: float
    message: str

    @property
    def feasible(self) -> bool:
        """Whether the slot is feasible."""
        return not self.message


def missing_length(problem: Problem, slot: Slot) -> float:
    """Return by how much arm and rope are too short for the depth asked, m; <= 0 if they are not."""
    return _distance(problem, slot) - problem.rope.total_length - problem.arm.length


def check_insert_feasibility(problem: Problem, slot: Slot, candidates: list[TipCandidate] | None) -> InsertFeasibility:
    """Check whether a slot is within the rope's length and close enough to what a swing does; None: none is known."""
    distance, short = _distance(problem, slot), missing_length(problem, slot)
    cost = candidates[0].cost if candidates else math.inf
    message = ""
    if short > 0.0:
        message = f"out of reach: the rope ends {short:.2f} m short of that depth"
    elif candidates is None:
        message = "interrupted before the swings were made"
    elif cost > MAX_COST:
        message = "out of reach: in no swing does the tip go through near to it, in that direction"
    return InsertFeasibility(distance, cost, message)


def _distance(problem: Problem, slot: Slot) -> float:
    """Distance of the place asked for the tip from the arm's pivot, m."""
    return math.hypot(*(slot.point + slot.depth * slot.axes[0] - problem.arm.pivot))


def score_entries(
    problem: Problem, slot: Slot, strokes: list[Strokes], threads: int | None = None
) -> tuple[Array, Array]:
    """Simulate free swings (M) from rest; return cost (M,), m, and time, s, of the cheapest entry of each.

    Of a rope that touches an obstacle what comes before counts.
    """
    t, batch, angle, _ = simulate_swings(problem, strokes, SAMPLE_TIME, threads)
    rope, base = problem.rope, problem.arm.tip(angle)
    clear = clear_samples([rope] * len(strokes), problem.obstacles, batch.q, base, problem.clearance)
    scored = [
        cheapest_entry(slot, rope.radius, t[:rows], rope.joints(q[:rows], first[:rows])) if rows else (NEVER, math.nan)
        for q, first, rows in zip(batch.q, base, clear, strict=True)
    ]
    cost, at = np.array(scored).T
    return np.where(np.isfinite(batch.q).all(axis=(1, 2)), cost, NEVER), at


def cheapest_entry(slot: Slot, radius: float, t: Array, joints: Array) -> tuple[float, float]:
    """Return cost, m, and time, s, of the cheapest entry of a run by its joints (T, n + 1, 2), m."""
    depth, offset = frame(slot, joints)
    ways = passages(depth[:, -1], slot.depth)
    if not ways:
        return NEVER, math.nan
    found = find_crossings(slot, radius, depth, offset)
    mouth = np.full(t.size, np.nan)
    mouth[found.row[found.tip]] = found.offset[found.tip]
    best = (NEVER, math.nan)
    for begin, end in ways:
        part = depth[begin - 1, -1] / (depth[begin - 1, -1] - depth[begin, -1])
        enters = offset[begin - 1, -1] + part * (offset[begin, -1] - offset[begin - 1, -1])
        inside = offset[begin : end + 1, -1] if slot.tube > 0.0 else ()
        least, most = np.min(off := np.concatenate([mouth[begin : end + 1], [enters], inside])), np.max(off)
        if not math.isfinite(most):  # the rope hangs on the far side, and the tip comes back to it
            continue
        lacks = max(0.0, slot.depth - float(depth[end, -1]))
        others = (found.row <= end) & ~(found.tip & (found.row >= begin))
        struck = float(np.max(-found.gap, where=others, initial=0.0))
        hard = float(most - least) + lacks + struck
        cost = 0.5 * abs(float(least + most)) + HARD_COST * hard + TIME_COST * float(t[end])
        cost += SPEED_COST * max(0.0, tip_speed(t, depth[:, -1], offset[:, -1], end) / slot.max_speed - 1.0)
        best = min(best, (cost, float(t[end])))
    return best


def insert_candidates(problem: Problem, slot: Slot, left: Left, threads: int | None = None) -> list[TipCandidate]:
    """Return random swings whose tip enters a slot, the cheapest first; of those that there is time for.

    The first TOGETHER are simulated in any case. `left` returns the time that is left, s.
    """
    strokes, found = random_swings(problem, SWINGS, slot.walls), []
    for low in range(0, SWINGS, TOGETHER):
        if low and left() < 0.0:
            break
        some = strokes[low : low + TOGETHER]
        cost, t = score_entries(problem, slot, some, threads)
        found += [TipCandidate(float(cost[k]), float(t[k]), some[k]) for k in np.flatnonzero(cost < NEVER)]
    return sorted(found, key=lambda one: one.cost)
