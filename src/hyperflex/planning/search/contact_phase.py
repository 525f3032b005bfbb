"""What becomes of a strike: the run beside the peg from shortly before it, and how well the rope is wound then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Peg, Setup
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.search.batch_rollout import Flights
from hyperflex.planning.search.strikes import arm_tip
from hyperflex.planning.wind.outcome import WOUND
from hyperflex.planning.wind.throw import Throw
from hyperflex.simulation import Batch
from hyperflex.simulation.contact.start import check_outside
from hyperflex.winding import slid

COARSE_TOL, COARSE_STEP = 1e-3, 1e-3  # m, s, of runs in a search; coarser ones of wound ropes took longer, not less
SAMPLE_TIME = 0.02  # s
SETTLE = 2.5  # s, watched after strike and stop
FIRST, HOPE = 0.9, 0.75  # s after the stop when a run is looked at, and turns without which it ends there
TOGETHER = 0.5  # s by which the stops of runs in one batch differ at most
SLID, SLIDING = 0.02, 1.0  # m, slip in the last seconds from which on it costs a run so many turns; less costs less
PATIENCE = 6.0  # s of processor time for a run; most take a hundredth of it
LAST, LAST_LOST = 0.8, 0.3  # s at the end, over which the rope must stay wound; the same of runs without hope
ENOUGH = 3.0  # turns beyond which more do not count
PASSING = 0.25  # what a turn counts that is undone again
LATE = 0.02  # turns that a second of delay costs


@dataclass(frozen=True, eq=False)
class Landings:
    """How several throws ended (M,).

    Attributes
    ----------
    score : (M,) float64
        The more, the better: turns that stay, and a little for those that do not and for being early.
    turns : (M,) float64
        Turns that stay: the least over the last LAST seconds; 0 where a run failed.
    """

    score: Array
    turns: Array


def land(
    thrower: Thrower,
    peg: Peg,
    throws: Sequence[Throw],
    state: tuple[Array, Array, Array],
    *,
    patience: float = PATIENCE,
    threads: int | None = None,
) -> Landings:
    """Run throws beside a peg from shortly before their strikes.

    Parameters
    ----------
    thrower : Thrower
    peg : Peg
    throws : (M,) sequence of Throw
        Already cut: no stroke starts after the strike.
    state : (t, q, qd)
        (M,), (M, n), (M, n): where each run starts, s, rad, rad/s.
    patience : float
        Processor time for each run, s; one that takes more has failed.
    threads : int, optional
    """
    begin, q, qd = state
    motions = [throw.motion(thrower.limits).shifted(-start) for throw, start in zip(throws, begin, strict=True)]
    flights = Flights([thrower.rope] * len(motions), [peg] * len(motions), motions, q, qd)
    return settle(flights, begin, arm=thrower.arm, patience=patience, threads=threads)


def settle(
    flights: Flights, begin: Array, *, arm: Arm, patience: float = PATIENCE, threads: int | None = None
) -> Landings:
    """Run ropes beside pegs from shortly before their strikes.

    Parameters
    ----------
    flights : Flights
        (M,); their motions end.
    begin : (M,) float64
        When each strikes, s: the later, the less it scores.
    arm : Arm
    patience : float
        As for :func:`land`, s.
    threads : int, optional
    """
    stops = np.maximum([float(motion.breaks[-1]) for motion in flights.motions], 0.5)
    score, turns = np.empty(stops.size), np.empty(stops.size)
    for rows in _alike(stops):
        found = _settle(flights.part(rows), stops[rows], begin[rows], arm, patience, threads)
        score[rows], turns[rows] = found.score, found.turns
    return Landings(score, turns)


def _alike(stops: Array) -> list[list[int]]:
    """Return rows in groups that stop at about the same time: what runs on beyond its end costs time for nothing."""
    order = np.argsort(stops, kind="stable")
    groups = np.floor((stops[order] - stops[order[0]]) / TOGETHER)
    return [rows.tolist() for rows in np.split(order, np.flatnonzero(np.diff(groups)) + 1)]


def _settle(flights: Flights, stops: Array, begin: Array, arm: Arm, patience: float, threads: int | None) -> Landings:
    """As :func:`settle`, for runs that stop at about the same time.

    Those without hope end early, and count HOPE turns at most, however many they have made a moment before.
    """
    early: Array = SAMPLE_TIME * np.arange(1.0, np.ceil((stops.max() + FIRST) / SAMPLE_TIME) + 1.0)
    late: Array = SAMPLE_TIME * np.arange(1.0, np.ceil((SETTLE - FIRST) / SAMPLE_TIME) + 1.0)
    batch = _run(flights, early, arm, patience, threads)
    turns = batch.values["turns"][..., 0]
    found = judge(early, turns, stops + FIRST, begin, last=LAST_LOST)
    undone = np.maximum(np.minimum(found.turns, ENOUGH) - HOPE, 0.0)
    found = Landings(found.score - undone, np.minimum(found.turns, HOPE))
    on = np.flatnonzero(np.abs(np.nan_to_num(turns[:, -1])) >= HOPE)
    after = float(early[-1])
    on = np.array([k for k in on if _outside(flights, int(k), batch.q[k, -1], after, arm)], dtype=np.int64)
    if on.size:
        some = flights.part(on.tolist())
        motions = [motion.shifted(-after) for motion in some.motions]
        some = replace(some, motions=motions, q=batch.q[on, -1], qd=batch.qd[on, -1])
        further = _run(some, late, arm, patience, threads)
        whole = np.concatenate([turns[on], further.values["turns"][..., 0]], axis=1)
        ended = judge(np.append(early, after + late), whole, stops[on] + SETTLE, begin[on])
        for k in np.flatnonzero(ended.turns >= WOUND):
            ended.score[k] -= SLIDING * _slid(some, int(k), further.q[k], late, arm)
        found.score[on], found.turns[on] = ended.score, ended.turns
    return found


def _outside(flights: Flights, k: int, q: Array, t: float, arm: Arm) -> bool:
    """Whether the k-th rope at angles q keeps clear of its peg at time t, s: a coarse run may leave it too deep."""
    try:
        check_outside(Setup(flights.ropes[k], flights.motions[k], arm, pegs=(flights.pegs[k],)), t, q)
    except InvalidInput:
        return False
    return True


def _run(flights: Flights, t: Array, arm: Arm, patience: float, threads: int | None) -> Batch:
    """Run coarsely to the last of the times t (T,), s."""
    return flights.run(
        arm,
        t,
        tol=COARSE_TOL,
        contact_step=COARSE_STEP,
        refine=False,
        pegs=[[peg] for peg in flights.pegs],
        keep=("turns", "q", "qd"),
        patience=patience,
        threads=threads,
    )


def _slid(flights: Flights, k: int, q: Array, t: Array, arm: Arm) -> float:
    """How much of SLID the k-th one slips over the last LAST s of samples q (T, n) at times t (T,); at most 1."""
    last = t > t[-1] - LAST
    q, rope = q[last], flights.ropes[k]
    links = rope.length[:, None] * np.stack([np.sin(q), -np.cos(q)], axis=-1)
    base = arm_tip(arm, flights.motions[k], t[last])[:, None]
    joints = np.concatenate([base, base + np.cumsum(links, axis=1)], axis=1)
    way = float(np.abs(slid(rope, flights.pegs[k], q, joints)).max())
    return min(way / SLID, 1.0) if np.isfinite(way) else 1.0


def judge(t: Array, turns: Array, span: Array, begin: Array, *, last: float = LAST) -> Landings:
    """Score runs by their turns (M, T) at times t (T,), each as far as its span (M,), s; they began at `begin` (M,).

    Turns stay that are there for the `last` seconds of the span.
    """
    inside = t <= span[:, None] + 1e-9
    ending = inside & (t >= span[:, None] - last)
    good = np.isfinite(turns).all(axis=1)
    seen = np.nan_to_num(turns)
    sense = np.sign(np.where(ending, seen, 0.0).sum(axis=1))
    stays = np.where(ending, sense[:, None] * seen, np.inf).min(axis=1)
    stays = np.where(good, np.maximum(stays, 0.0), 0.0)
    most = np.where(inside, np.abs(seen), 0.0).max(axis=1)
    score = np.minimum(stays, ENOUGH) + PASSING * np.minimum(most, ENOUGH) - LATE * begin
    return Landings(np.where(good, score, -1.0), stays)
