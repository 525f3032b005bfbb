"""The contact phase of throws: coarse batch rollouts beside the peg from shortly before the strike, and their score."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Obstacle, Setup
from hyperflex.motion import hold_arm
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.clearance import sampled_clearance, sampled_obstacle_gaps
from hyperflex.planning.outcome import MIN_TURNS
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.search.strikes import arm_tip
from hyperflex.planning.verification import at_limits, limit_bend
from hyperflex.simulation import Batch, Deadline, check_outside
from hyperflex.winding import slid

COARSE_TOL, COARSE_STEP = 1e-3, 1e-3  # m, s, of runs in a search; coarser ones of wound ropes took longer, not less
SAMPLE_TIME = 0.02  # s
SETTLING_TIME = 2.5  # s simulated after the arm's stop
CHECK_TIME, MIN_HOPE = 0.9, 0.75  # s after the stop at which a run is looked at; with fewer turns it ends there
TOGETHER = 0.5  # s, greatest difference of the stops of one batch
SLIP, SLIP_COST = 0.02, 1.0  # m of slip from CHECK_TIME on that cost half of so many turns; more costs more
TIME_BUDGET = 6.0  # s of processor time for a run; most take a hundredth of it
LAST, LAST_CHECK = 0.8, 0.3  # s at the end of a run for which the turns must stay; the same at CHECK_TIME
MAX_TURNS = 3.0  # turns above which more do not count
PASSING = 0.25  # weight of a turn that is undone again
LATE_COST = 0.02  # turns that a second of delay costs
# Turns that a rope costs that comes too near its arm, and up to as many more the longer it is there; half of these in s
ARM_COST, ARM_TIME = 0.5, 0.3
# A rope that is folded flat keeps of its score PLAIN and FOLDED of the rest: others come first. Coarse ropes have no
# joint limits: where throws fold when verified they bent by 2.1 times the limit or more, else by half of it at most
PLAIN, FOLDED = 1.0, 0.1


@dataclass(frozen=True, eq=False)
class WindingScores:
    """Scores of M throws.

    `score` (M,): greater is better; turns that stay, and a little for turns that do not and for an early strike.
    `turns` (M,): turns that stay, the least over the last LAST seconds; 0 if a run failed.
    """

    score: Array
    turns: Array


def simulate_contact(
    batch: RolloutBatch,
    begin: Array,
    *,
    arm: Arm,
    clearance: float = -np.inf,
    time_budget: float | Deadline = TIME_BUDGET,
    threads: int | None = None,
) -> WindingScores:
    """Simulate ropes (M,) with pegs from shortly before their strikes, under motions that end.

    A strike that begins later, at `begin` (M,), s, lowers the score. A rope that comes within `clearance`, m, of its
    arm or shaft, or an obstacle, counts as one that comes undone, whose score is lower the longer it is there.
    `time_budget` is the processor time of each run, s, or a deadline; a run that takes more has failed.
    """
    stops = np.maximum([float(motion.breaks[-1]) for motion in batch.motions], 0.5)
    score, turns = np.empty(stops.size), np.empty(stops.size)
    for rows in _similar_stops(stops):
        some, budget = batch.select(rows), (time_budget, threads)
        found = _simulate_contact(some, stops[rows], begin[rows], arm, clearance, *budget)
        score[rows], turns[rows] = found.score, found.turns
    return WindingScores(score, turns)


def _similar_stops(stops: Array) -> list[list[int]]:
    """Return rows in groups with stops at about the same time: a batch runs until the last of its stops."""
    order = np.argsort(stops, kind="stable")
    groups = np.floor((stops[order] - stops[order[0]]) / TOGETHER)
    return [rows.tolist() for rows in np.split(order, np.flatnonzero(np.diff(groups)) + 1)]


def _simulate_contact(
    batch: RolloutBatch,
    stops: Array,
    begin: Array,
    arm: Arm,
    clearance: float,
    time_budget: float | Deadline,
    threads: int | None,
) -> WindingScores:
    """As :func:`simulate_contact`, for runs with stops at about the same time.

    Runs with fewer than MIN_HOPE turns CHECK_TIME after the stop end there, and count MIN_HOPE turns at most. So do
    those that came too near the arm until then, but their score is that of MIN_TURNS at most, less what the arm costs.
    """
    early: Array = SAMPLE_TIME * np.arange(1.0, np.ceil((stops.max() + CHECK_TIME) / SAMPLE_TIME) + 1.0)
    late: Array = SAMPLE_TIME * np.arange(1.0, np.ceil((SETTLING_TIME - CHECK_TIME) / SAMPLE_TIME) + 1.0)
    run = _run(batch, early, arm, time_budget, threads)
    turns = run.values["turns"][..., 0]
    found = score_winding(early, turns, stops + CHECK_TIME, begin, last=LAST_CHECK)
    hopeful, barely = (
        found.score - np.maximum(np.minimum(found.turns, MAX_TURNS) - k, 0.0) for k in (MIN_TURNS, MIN_HOPE)
    )
    found = WindingScores(barely, np.minimum(found.turns, MIN_HOPE))
    on = np.flatnonzero(np.abs(np.nan_to_num(turns[:, -1])) >= MIN_HOPE)
    after = float(early[-1])
    clear = [k for k in on if _clear_of_peg(batch, int(k), run.q[k, -1], after, arm)]
    near = np.array([_time_near_arm(batch, int(k), run.q[k], early, arm, clearance) for k in clear])
    for k, time in zip(clear, near, strict=True):
        if time > 0.0:
            found.score[k] = hopeful[k] - ARM_COST * (1.0 + time / (time + ARM_TIME))
    on = np.array(clear, dtype=np.int64)[near == 0.0]
    if on.size:
        some = batch.select(on.tolist())
        motions = [motion.shifted(-after) for motion in some.motions]
        some = replace(some, motions=motions, q=run.q[on, -1], qd=run.qd[on, -1])
        further = _run(some, late, arm, time_budget, threads)
        whole = np.concatenate([turns[on], further.values["turns"][..., 0]], axis=1)
        ended = score_winding(np.append(early, after + late), whole, stops[on] + SETTLING_TIME, begin[on])
        for k in np.flatnonzero(ended.turns >= MIN_TURNS):
            ended.score[k] -= SLIP_COST * _slip(some, int(k), further.q[k], late, arm)
        found.score[on], found.turns[on] = ended.score, ended.turns
    for k in np.flatnonzero(found.score > PLAIN):
        if at_limits(limit_bend(batch.ropes[int(k)]), run.q[k]).any():
            found.score[k] = PLAIN + FOLDED * (found.score[k] - PLAIN)
    return found


def _clear_of_peg(batch: RolloutBatch, k: int, q: Array, t: float, arm: Arm) -> bool:
    """Whether rope k at angles q keeps clear of its peg at time t, s: a coarse run may leave it too deep."""
    return starts_outside(Setup(batch.ropes[k], batch.motions[k], arm, pegs=(batch.pegs[k],)), t, q)


def _time_near_arm(batch: RolloutBatch, k: int, q: Array, t: Array, arm: Arm, clearance: float) -> float:
    """Time, s, that rope k at angles q (T, n) at times t (T,), s, is too near arm or obstacles at samples."""
    rope, near = batch.ropes[k], np.zeros(t.size, dtype=bool)
    base = arm_tip(arm, batch.motions[k], t)[0]
    if clearance > -np.inf:
        near |= sampled_clearance(rope, arm, q, base) <= clearance
    if batch.obstacles:
        near |= sampled_obstacle_gaps(rope, batch.obstacles, q, base) <= max(clearance, 0.0)
    return SAMPLE_TIME * int(near.sum())


def starts_outside(setup: Setup, *start: Any) -> bool:
    """Whether a rope keeps clear of its pegs at the start, as of :func:`check_outside`."""
    try:
        check_outside(setup, *start)
    except InvalidInput:
        return False
    return True


def free_sides(cast_setup: CastSetup, pegs: Sequence[Obstacle]) -> list[int]:
    """Return the sides on which the arm may stand at first without the rope in one of the `pegs`."""
    may = [side for side in (-1, 1) if cast_setup.side in (side, 0)]
    (q, _), angle = cast_setup.start, cast_setup.limits.start_angle
    starts = [Setup(cast_setup.rope, hold_arm(angle(side)), cast_setup.arm, pegs=tuple(pegs)) for side in may]
    return [side for side, start in zip(may, starts, strict=True) if starts_outside(start, 0.0, q)]


def check_start(cast_setup: CastSetup) -> None:
    """Raise InvalidInput if the rope begins in an obstacle on all sides."""
    if not free_sides(cast_setup, cast_setup.obstacles):
        fix = "Move it; the rope hangs from the arm, which points to one side"
        raise InvalidInput("the rope begins in an obstacle, whatever the arm's side", fix=fix)


def _run(batch: RolloutBatch, t: Array, arm: Arm, time_budget: float | Deadline, threads: int | None) -> Batch:
    """Simulate coarsely to the last of the times t (T,), s."""
    return batch.run(
        arm,
        t,
        tol=COARSE_TOL,
        contact_step=COARSE_STEP,
        refine=False,
        pegs=[[peg] for peg in batch.pegs],
        keep=("turns", "q", "qd"),
        time_budget=time_budget,
        threads=threads,
    )


def _slip(batch: RolloutBatch, k: int, q: Array, t: Array, arm: Arm) -> float:
    """Slip of rope k in samples q (T, n) at times t (T,), s: 1/2 for SLIP metres, and 1 for a rope that comes off."""
    rope = batch.ropes[k]
    links = rope.length[:, None] * np.stack([np.sin(q), -np.cos(q)], axis=-1)
    base = arm_tip(arm, batch.motions[k], t)[0][:, None]
    joints = np.concatenate([base, base + np.cumsum(links, axis=1)], axis=1)
    way = float(np.abs(slid(rope, batch.pegs[k], q, joints)).max())
    return way / (way + SLIP) if np.isfinite(way) else 1.0


def score_winding(t: Array, turns: Array, span: Array, begin: Array, *, last: float = LAST) -> WindingScores:
    """Score runs by their turns (M, T) at times t (T,), each up to its span (M,), with strikes at `begin` (M,), all s.

    Turns that stay are the least over the `last` seconds of the span.
    """
    inside = t <= span[:, None] + 1e-9
    ending = inside & (t >= span[:, None] - last)
    good = np.isfinite(turns).all(axis=1)
    seen = np.nan_to_num(turns)
    sense = np.sign(np.where(ending, seen, 0.0).sum(axis=1))
    stays = np.where(ending, sense[:, None] * seen, np.inf).min(axis=1)
    stays = np.where(good, np.maximum(stays, 0.0), 0.0)
    most = np.where(inside, np.abs(seen), 0.0).max(axis=1)
    score = np.minimum(stays, MAX_TURNS) + PASSING * np.minimum(most, MAX_TURNS) - LATE_COST * begin
    return WindingScores(np.where(good, score, -1.0), stays)
