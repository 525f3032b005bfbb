"""How often an insertion succeeds where slot and timing are not quite as planned, by free swings in scenarios."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.interruption import interruptible
from hyperflex.model import DEFAULT_TOL, Peg, Rope, recut
from hyperflex.motion import Motion
from hyperflex.planning.clearance import FINE, clear_samples, obstacle_gaps, samples_clear_of_arm
from hyperflex.planning.insert.slot import Slot, frame, nearest_passage, tip_speed
from hyperflex.planning.problem import Problem
from hyperflex.planning.robust.scenario_rollouts import STREAM, SuccessProbability
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.tip.outcome import sample_times
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.verification import FOLD, at_limits, limit_bend
from hyperflex.simulation import Deadline

FINER = 2.5  # times the links, in scenarios and in the second verification
PLACE, TIMING = 2e-3, 2e-3  # m, s: usual standard deviations of the slot's place and of each stroke's start
SAMPLES, TOGETHER = 100, 25  # of an estimate; those simulated at once


def usual_uncertainty() -> Uncertainty:
    """Return the uncertainty of a known rope on a motor that is nearly in time, before a slot nearly in its place."""
    return Uncertainty(length=0.0, mass=0.0, friction=0.0, mu=0.0, lag=0.0, timing=TIMING, place=PLACE)


def insert_scenarios(
    problem: Problem,
    slot: Slot,
    strokes: Strokes,
    uncertainty: Uncertainty,
    samples: int,
    seed: int | Sequence[int],
) -> list[tuple[Rope, Slot, Motion]]:
    """Return rope, with FINER times the links, slot and motion of the arm in sampled scenarios.

    A peg in its gap stands for the slot there.
    """
    peg, motion = Peg(slot.x, slot.y, 0.5 * slot.width), strokes.motion(problem.limits)
    scenarios = uncertainty.sample(samples, problem, peg, seed=seed)
    return [
        (finer_rope(each.rope), replace(slot, x=each.peg.x, y=each.peg.y), each.executed_motion(motion))
        for each in scenarios
    ]


def finer_rope(rope: Rope) -> Rope:
    """Return a rope cut into FINER times as many links."""
    return recut(rope, round(FINER * rope.n_links))


@interruptible()
def estimate_insert_probability(
    problem: Problem,
    slot: Slot,
    strokes: Strokes,
    near: float,
    uncertainty: Uncertainty | None = None,
    *,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int | None = None,
    time_budget: float = math.inf,
) -> SuccessProbability:
    """Estimate how often strokes bring the tip through a slot to its depth without a touch, in sampled scenarios.

    Parameters
    ----------
    near : float
        When the tip is inside as planned, s.
    uncertainty : Uncertainty, optional
        By default the slot is 2 mm off and each stroke 2 ms (standard deviations), and the rope as planned.
    samples, seed, threads
        As of :func:`hyperflex.planning.estimate_success_probability`.
    time_budget : float
        Time by the clock, s, without compiling. Samples are counted TOGETHER at once: fewer than asked where there is
        no time for all, and none where the first of them take longer.

    Returns
    -------
    SuccessProbability

    Notes
    -----
    Scenarios are free flights, looked at every 2 ms. One succeeds if the tip comes to its depth, no faster than the
    slot asks, the rope touches no wall until then, keeps clear of arm, shaft and obstacles, as verified runs ask, and
    is not folded flat before: its contact with itself is not simulated. The motor's torque is not looked at.
    """
    clock = Clock()
    known = uncertainty or usual_uncertainty()
    stream = [STREAM, checks.count("seed", seed, least=0)]
    drawn = insert_scenarios(problem, slot, strokes, known, samples, stream)
    t = sample_times(near)
    won = done = 0

    def left() -> float:
        return time_budget - clock.spent

    while done < samples and left() > 0.0:
        some = drawn[done : done + TOGETHER]
        flights = _flights(problem, some, t, Deadline(math.inf, left), threads)
        entered = [
            left() > 0.0 and _enters(problem, rope, where, near, t, q, problem.arm.tip(motion.angle(t)))
            for (rope, where, motion), q in zip(some, flights, strict=True)
        ]
        if left() < 0.0:  # some were cut short
            break
        won, done = won + sum(entered), done + len(some)
    return SuccessProbability(won, done)


def _flights(
    problem: Problem,
    drawn: Sequence[tuple[Rope, Slot, Motion]],
    t: Array,
    time_budget: Deadline,
    threads: int | None,
) -> Array:
    """Return the link angles (M, T, n), rad, of free flights at times t (T,), s; NaN in those cut short."""
    ropes, _, motions = zip(*drawn, strict=True)
    batch = RolloutBatch.from_start(replace(problem, rope=ropes[0]), ropes, [], motions)
    how: dict[str, Any] = {"tol": DEFAULT_TOL, "keep": ("q",), "time_budget": time_budget, "threads": threads}
    return batch.run(problem.arm, t, **how).q


def _enters(problem: Problem, rope: Rope, slot: Slot, near: float, t: Array, q: Array, base: Array) -> bool:
    """Whether a free flight passes what a verified run is asked for next to time `near`, s, as far as it can tell.

    Angles q (T, n), rad, of the links, and places `base` (T, 2), m, of the first joint at times t (T,), s.
    """
    joints = rope.joints(q, base)
    depth, offset = frame(slot, joints)
    way = nearest_passage(depth[:, -1], slot.depth, t, near)
    if way is None:
        return False
    end, until = way[1], slice(way[1] + 1)
    fast = tip_speed(t, depth[:, -1], offset[:, -1], end) > slot.max_speed
    if depth[end, -1] < slot.depth or fast or _touches(slot, rope.radius, joints[until], depth[until], offset[until]):
        return False
    return _keeps_clear(problem, rope, q, base) and not at_limits(limit_bend(rope), q[until], -FOLD).any()


def _touches(slot: Slot, radius: float, joints: Array, depth: Array, offset: Array) -> bool:
    """Whether a rope touches a wall at samples with joints (T, n + 1, 2), m, or passes by less than runs take off.

    `depth` and `offset` (T, n + 1), m, are those of the joints, `radius`, m, is the rope's.
    """
    least, aside = radius + 0.5 * FINE, 0.5 * slot.width + slot.wall
    beyond, across = (np.stack([each[:, :-1], each[:, 1:]]) for each in (depth, offset))
    near = (beyond.max(axis=0) >= -least) & (beyond.min(axis=0) <= slot.tube + least)
    near &= (across.max(axis=0) >= -aside - least) & (across.min(axis=0) <= aside + least)
    row, link = np.nonzero(near)
    gaps = obstacle_gaps(slot.walls, joints[row, link], joints[row, link + 1])
    return bool((gaps <= least).any())


def _keeps_clear(problem: Problem, rope: Rope, q: Array, base: Array) -> bool:
    """Whether a flight keeps as clear of arm, shaft and obstacles as verified runs must, with what these take off."""
    least, flight = problem.clearance, (q[None], base[None])
    arm = samples_clear_of_arm(rope, problem.arm, *flight, least + 0.5 * FINE)
    others = clear_samples([rope], problem.obstacles, *flight, max(least, 0.0) + 0.5 * FINE)
    return bool(min(arm[0], others[0]) == len(q))
