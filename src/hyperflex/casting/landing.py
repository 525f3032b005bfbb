"""What becomes of a strike: the run beside the peg from shortly before it, and how well the rope is wound then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex.casting.throw import Throw
from hyperflex.casting.thrower import Thrower
from hyperflex.checks import Array
from hyperflex.model import Arm, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.simulation import simulate_batch

COARSE_TOL, COARSE_STEP = 1e-3, 1e-3  # m, s, of runs in a search
SAMPLE_TIME = 0.02  # s
SETTLE = 2.5  # s, watched after strike and stop
LAST = 0.8  # s at the end, over which the rope must stay wound
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
    threads : int, optional
    """
    begin = state[0]
    motions = [throw.motion(thrower.limits).shifted(-start) for throw, start in zip(throws, begin, strict=True)]
    return settle([thrower.rope], [peg], motions, state, arm=thrower.arm, threads=threads)


def settle(
    ropes: Sequence[Rope],
    pegs: Sequence[Peg],
    motions: Sequence[Motion],
    state: tuple[Array, Array, Array],
    *,
    arm: Arm,
    threads: int | None = None,
) -> Landings:
    """Run ropes beside pegs from shortly before their strikes.

    Parameters
    ----------
    ropes, pegs : (M,) or (1,) sequences
        One each, or one for all.
    motions : (M,) sequence of Motion
        From the start of each run on, which is their t = 0; they end.
    state : (t, q, qd)
        As for :func:`land`.
    arm : Arm
    threads : int, optional
    """
    begin, q, qd = state
    span = np.maximum([float(motion.breaks[-1]) for motion in motions], 0.5) + SETTLE
    t: Array = SAMPLE_TIME * np.arange(1.0, np.ceil(span.max() / SAMPLE_TIME) + 1.0)
    batch = simulate_batch(
        list(ropes) * (1 if len(ropes) > 1 else len(motions)),
        list(motions),
        arm=arm,
        duration=float(t[-1]),
        q0=q,
        qd0=qd,
        t_eval=t,
        tol=COARSE_TOL,
        contact_step=COARSE_STEP,
        refine=False,
        pegs=[[peg] for peg in pegs],
        keep=("turns",),
        threads=threads,
    )
    return judge(t, batch.values["turns"][..., 0], span, begin)


def judge(t: Array, turns: Array, span: Array, begin: Array) -> Landings:
    """Score runs by their turns (M, T) at times t (T,), each as far as its span (M,), s; they began at `begin` (M,)."""
    inside = t <= span[:, None] + 1e-9
    ending = inside & (t >= span[:, None] - LAST)
    good = np.isfinite(turns).all(axis=1)
    seen = np.nan_to_num(turns)
    sense = np.sign(np.where(ending, seen, 0.0).sum(axis=1))
    stays = np.where(ending, sense[:, None] * seen, np.inf).min(axis=1)
    stays = np.where(good, np.maximum(stays, 0.0), 0.0)
    most = np.where(inside, np.abs(seen), 0.0).max(axis=1)
    score = np.minimum(stays, ENOUGH) + PASSING * np.minimum(most, ENOUGH) - LATE * begin
    return Landings(np.where(good, score, -1.0), stays)
