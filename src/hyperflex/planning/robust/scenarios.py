"""What becomes of throws in drawn worlds: free flight to the strike in batch, then the run beside the peg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Arm, Peg
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.robust.uncertainty import Draw
from hyperflex.planning.search import contact_phase as landing
from hyperflex.planning.search import strikes
from hyperflex.planning.search.batch_rollout import Flights
from hyperflex.planning.search.contact_phase import Landings
from hyperflex.planning.wind.throw import Throw

AFTER = 0.5  # s after the arm has stopped within which a rope may still strike
TOGETHER = 128  # flights at once; more would fill the memory
DECIDED = 0.5  # s of free flight that are looked at, at least


def from_rest(thrower: Thrower, pairs: Sequence[tuple[Throw, Draw]]) -> Flights:
    """Return throws in drawn worlds, each rope hanging at rest."""
    ropes = [draw.rope for _, draw in pairs]
    q = np.array([np.full(rope.n_links, rope.hanging_angle) for rope in ropes])
    motions = [draw.motion(throw, thrower) for throw, draw in pairs]
    return Flights(ropes, [draw.peg for _, draw in pairs], motions, q, np.zeros_like(q))


def ends(flights: Flights, arm: Arm, time: float, *, threads: int | None = None) -> Landings:
    """Let throws fly until they strike, and then wind.

    Parameters
    ----------
    flights : Flights
    arm : Arm
    time : float
        Within which they must strike, s, as of `flights.since`; AFTER beyond the arm's stop is always looked at.
    threads : int, optional

    Returns
    -------
    Landings
        Scores and turns that stay (M,); 0 turns where nothing is struck or a run fails.
    """
    score, turns = np.full(len(flights), strikes.NEVER), np.zeros(len(flights))
    for low in range(0, len(flights), TOGETHER):
        rows = range(low, min(low + TOGETHER, len(flights)))
        part = flights.part(rows)
        t, q, qd, least = struck(part, arm, time, threads=threads)
        score[low : rows.stop] -= least
        hit = np.flatnonzero(np.isfinite(t))
        if hit.size:
            some = part.part(hit.tolist())
            motions = [motion.shifted(-at) for motion, at in zip(some.motions, t[hit], strict=True)]
            struck_there = replace(some, motions=motions, q=q[hit], qd=qd[hit])
            found = landing.settle(struck_there, t[hit] + flights.since, arm=arm, threads=threads)
            score[low + hit], turns[low + hit] = found.score, found.turns
    return Landings(score, turns)


def struck(flights: Flights, arm: Arm, time: float, *, threads: int | None = None) -> tuple[Array, Array, Array, Array]:
    """Return when throws strike, seconds after their start, and their states just before.

    Returns
    -------
    t : (M,) float64
        Last sample before the strike, s; NaN where there is none.
    q, qd : (M, n) float64
    least : (M,) float64
        Smallest gap, m.
    """
    stop = max(float(motion.breaks[-1]) for motion in flights.motions)
    span = max(time - flights.since, stop + AFTER, DECIDED)
    t, q, qd = fly(flights, arm, span, threads=threads)
    base = np.stack([strikes.arm_tip(arm, motion, t) for motion in flights.motions])
    lengths = np.stack([rope.length for rope in flights.ropes])[:, None]
    good = np.isfinite(q).all(axis=(1, 2))
    at, gap = np.zeros(len(flights), dtype=np.int64), np.zeros(len(flights))
    for peg in dict.fromkeys((peg.x, peg.y, peg.radius) for peg in flights.pegs):
        same = [m for m, one in enumerate(flights.pegs) if (one.x, one.y, one.radius) == peg]
        at[same], _, gap[same] = strikes.first(
            np.nan_to_num(q[same]), base[same], lengths[same], Peg(*peg), flights.ropes[0].radius
        )
    rows, hit = np.arange(len(flights)), (at > 0) & good
    before = np.maximum(at - 1, 0)
    return np.where(hit, t[before], np.nan), q[rows, before], qd[rows, before], gap


def fly(
    flights: Flights, arm: Arm, span: float, *, at_end: bool = False, threads: int | None = None
) -> tuple[Array, Array, Array]:
    """Return samples of free flights: t (T,), q and qd (M, T, n); `at_end` just one, after the span."""
    t: Array = strikes.SAMPLE_TIME * np.arange(1.0, np.ceil(span / strikes.SAMPLE_TIME - 1e-9) + 1.0)
    t = np.array([span]) if at_end else t
    batch = flights.run(arm, t, tol=strikes.COARSE_TOL, keep=("q", "qd"), threads=threads)
    return t, batch.q, batch.qd


def strike(thrower: Thrower, peg: Peg, throws: Sequence[Throw], *, threads: int | None = None) -> Array:
    """Return when throws (M,) strike in the world that is expected, s; NaN where they do not."""
    q = np.full((len(throws), thrower.rope.n_links), thrower.rope.hanging_angle)
    motions = [throw.motion(thrower.limits) for throw in throws]
    count = len(throws)
    batch = Flights([thrower.rope] * count, [peg] * count, motions, q, np.zeros_like(q))
    return struck(batch, thrower.arm, thrower.time, threads=threads)[0]
