"""How often an insertion succeeds where slot and timing are not quite as planned, by free swings in scenarios."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.interruption import interruptible
from hyperflex.model import DEFAULT_TOL, Peg, Rope, recut
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.clearance import FINE, obstacle_gaps
from hyperflex.planning.insert.slot import Slot, find_crossings, frame, nearest_passage
from hyperflex.planning.robust.scenario_rollouts import STREAM, SuccessProbability
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.tip.outcome import sample_times
from hyperflex.planning.tip.strokes import Strokes

FINER = 2.5  # times the links, in scenarios and in the second verification
PLACE, TIMING = 2e-3, 2e-3  # m, s: usual standard deviations of the slot's place and of each stroke's start
CLOSELY = 50  # samples before the entry at which the walls' ends are looked at, too
SAMPLES, TOGETHER = 100, 25  # of an estimate; those simulated at once


def usual_uncertainty() -> Uncertainty:
    """Return the uncertainty of a known rope on a motor that is nearly in time, before a slot nearly in its place."""
    return Uncertainty(length=0.0, mass=0.0, friction=0.0, mu=0.0, lag=0.0, timing=TIMING, place=PLACE)


def insert_scenarios(
    cast_setup: CastSetup,
    slot: Slot,
    strokes: Strokes,
    uncertainty: Uncertainty,
    samples: int,
    seed: int | Sequence[int],
) -> list[tuple[Rope, Slot, Motion]]:
    """Return rope, with FINER times the links, slot and motion of the arm in sampled scenarios.

    A peg in its gap stands for the slot there.
    """
    peg, motion = Peg(slot.x, slot.y, 0.5 * slot.width), strokes.motion(cast_setup.limits)
    scenarios = uncertainty.sample(samples, cast_setup, peg, seed=seed)
    return [
        (finer_rope(each.rope), replace(slot, x=each.peg.x, y=each.peg.y), each.executed_motion(motion))
        for each in scenarios
    ]


def finer_rope(rope: Rope) -> Rope:
    """Return a rope cut into FINER times as many links."""
    return recut(rope, round(FINER * rope.n_links))


@interruptible()
def estimate_insert_probability(
    cast_setup: CastSetup,
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
        Time by the clock after which no more samples are begun, s, without compiling; TOGETHER of them always are.
    """
    clock = Clock()
    known = uncertainty or usual_uncertainty()
    stream = [STREAM, checks.count("seed", seed, least=0)]
    drawn = insert_scenarios(cast_setup, slot, strokes, known, samples, stream)
    t = sample_times(near)
    won = done = 0
    while done < samples and (clock.spent < time_budget or not done):
        some = drawn[done : done + TOGETHER]
        won += sum(
            _enters(where, rope.radius, near, t, joints)
            for (rope, where, _), joints in zip(some, _joints(cast_setup, some, t, threads), strict=True)
        )
        done += len(some)
    return SuccessProbability(won, done)


def _joints(
    cast_setup: CastSetup, drawn: Sequence[tuple[Rope, Slot, Motion]], t: Array, threads: int | None
) -> Iterator[Array]:
    """Yield the joints (T, n + 1, 2), m, of free swings at times t (T,), s."""
    arm = cast_setup.arm
    ropes, _, motions = zip(*drawn, strict=True)
    run = RolloutBatch.from_start(replace(cast_setup, rope=ropes[0]), ropes, [], motions).run(
        arm, t, tol=DEFAULT_TOL, keep=("q",), threads=threads
    )
    for rope, motion, q in zip(ropes, motions, run.q, strict=True):
        yield rope.joints(q, arm.tip(motion.angle(t)))


def _enters(slot: Slot, radius: float, near: float, t: Array, joints: Array) -> bool:
    """Whether the tip of a run comes to the depth next to time `near`, s, and the rope crosses no wall until then."""
    depth, offset = frame(slot, joints)
    way = nearest_passage(depth[:, -1], slot.depth, t, near)
    if way is None:
        return False
    end, found = way[1], find_crossings(slot, radius, depth, offset)
    if depth[end, -1] < slot.depth or (found.gap[found.row <= end] <= 0.0).any():
        return False
    # what verified runs take off their clearance counts here as well
    near_by = joints[max(0, way[0] - CLOSELY) : end + 1]
    return bool(obstacle_gaps(slot.walls, near_by[:, :-1], near_by[:, 1:]).min() > radius + 0.5 * FINE)
