"""Free swings found stroke by stroke: those that gain most energy without striking, and the strikes on their way.

A beam search: each swing is continued with several rests and strokes; of what does not strike at once the swings with
the most energy are continued in turn, if they are much the same with shorter links: else the rope went slack and what
it does then is left to chance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import swing_period
from hyperflex.model import Peg, Rope, divided
from hyperflex.motion import Motion, moves
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.search import strikes
from hyperflex.planning.search.batch_rollout import Flights
from hyperflex.planning.search.parametrization import STROKE
from hyperflex.planning.wind.throw import LEAST_STROKE

WIDTH, EACH = 12, 2  # swings of a side that are continued, and how many of them after the same strokes
RESTS, LONGEST = 5, 0.6  # rests that are tried after a stroke, and the longest of them, in periods
SIZES = ((1.0, 1.0), (0.5, 0.9), (0.15, 0.5))  # of the strokes that are tried after each rest, in usual ones
WATCHED = 0.7  # periods after a stroke in which a strike is looked for
FINER = 3  # pieces of each link, as in the last verification
ASTRAY = 0.005  # rope lengths by which the tip may then be elsewhere after a stroke


class Strike(NamedTuple):
    """Strokes from rest that end in a strike."""

    score: float
    side: int
    strokes: tuple[float, ...]  # rad
    rests: tuple[float, ...]  # s, before each
    t: float  # s
    after: float  # s since the last stroke's end; below 0 where it comes in that stroke


class _Swing(NamedTuple):
    """Strokes that do not strike while the arm rests then, and samples from there on; of those until a strike."""

    energy: float
    side: int
    strokes: tuple[float, ...]
    rests: tuple[float, ...]
    angle: float  # rad, of the arm
    spent: float  # s, until the last stroke's end
    late: float  # s from there to the first sample
    q: Array
    qd: Array


class _Try(NamedTuple):
    """A stroke after a swing: `rest` s after the stroke before, from sample `at` of the swing to arm angle `end`."""

    swing: _Swing
    rest: float
    at: int
    end: float
    time: float  # s, that it takes
    motion: Motion


class Beam:
    """A beam search of swings of a hanging rope; it can be asked to go on.

    Parameters
    ----------
    thrower : Thrower
        Its time is not looked at.
    peg : Peg
    sides : sequence of {-1, 1}
        From which the arm may start.
    random : Generator
        Of the rests and strokes that are tried.
    threads : int, optional
    """

    def __init__(
        self, thrower: Thrower, peg: Peg, sides: Sequence[int], random: np.random.Generator, threads: int | None = None
    ) -> None:
        self.thrower, self.peg, self.threads, self.runs = thrower, peg, threads, 0
        self._random, self._period = random, swing_period(thrower.rope)
        hanging = np.full((1, thrower.rope.n_links), thrower.rope.hanging_angle)
        self._struck: list[Strike] = []
        still = np.zeros_like(hanging)
        self._swings = [
            _Swing(0.0, side, (), (), thrower.limits.start(side), 0.0, 0.0, hanging, still) for side in sides
        ]

    def ready(self, time: float, most: int) -> bool:
        """Whether there are swings of less than so many strokes whose last one ends before a time, s."""
        return any(_ready(one, time, most) for one in self._swings)

    def go(self, time: float, most: int, left: Callable[[], float] | None = None) -> list[Strike]:
        """Continue all swings that are ready while time is left, s; return the strikes before a time, s, best first."""
        while self.ready(time, most) and (left is None or left() > 0.0):
            later = [one for one in self._swings if not _ready(one, time, most)]
            struck, onward = self._continue([one for one in self._swings if _ready(one, time, most)])
            self._struck += struck
            self._swings = later + onward
        return sorted((one for one in self._struck if one.t < time), key=lambda one: -one.score)

    def _continue(self, swings: list[_Swing]) -> tuple[list[Strike], list[_Swing]]:
        """One more stroke after each swing."""
        tries = [one for swing in swings for one in self._tries(swing)]
        if not tries:
            return [], []
        self.runs += len(tries)
        step, rope, arm = strikes.SAMPLE_TIME, self.thrower.rope, self.thrower.arm
        span = max(one.time for one in tries) + WATCHED * self._period
        t = step * np.arange(np.ceil(span / step) + 1.0)
        q = np.stack([one.swing.q[one.at] for one in tries])
        qd = np.stack([one.swing.qd[one.at] for one in tries])
        motions = [one.motion for one in tries]
        flights = Flights([rope] * len(tries), [self.peg] * len(tries), motions, q, qd)
        batch = flights.run(arm, t[1:], tol=strikes.COARSE_TOL, keep=("q", "qd"), threads=self.threads)
        q = np.concatenate([q[:, None], batch.q], axis=1)
        qd = np.concatenate([qd[:, None], batch.qd], axis=1)
        seen = strikes.found(self.thrower, self.peg, motions, t, q, qd)
        ended = np.array([int(np.ceil(one.time / step)) for one in tries])
        energy = self._energy(motions, q, qd, t, ended)
        struck: list[Strike] = []
        onward: list[tuple[int, _Swing]] = []
        for k, (swing, rest, _, end, time, _) in enumerate(tries):
            strokes, rests = (*swing.strokes, abs(end - swing.angle)), (*swing.rests, rest)
            if np.isfinite(seen.t[k]):
                at = swing.spent + rest + float(seen.t[k])
                struck.append(Strike(float(seen.score[k]), swing.side, strokes, rests, at, float(seen.t[k]) - time))
            first = int(ended[k])
            last = t.size if np.isnan(seen.t[k]) else round(float(seen.t[k]) / step) + 1
            some = q[k, first:last], qd[k, first:last]
            if first < last and all(np.isfinite(each).all() for each in some):
                late, spent = float(t[first]) - time, swing.spent + rest + time
                new = _Swing(float(energy[k]), swing.side, strokes, rests, end, spent, late, *map(np.copy, some))
                onward.append((k, new))
        likely = _best(onward, 2 * WIDTH)
        firm = self._firm(flights, [k for k, _ in onward if k in likely], ended, q)
        best = _best([each for each in onward if each[0] in firm], WIDTH)
        return struck, [one for k, one in onward if k in best]

    def _firm(self, flights: Flights, rows: list[int], ended: Array, q: Array) -> set[int]:
        """Those flights of q (M, T, n) that lead to much the same at sample `ended` (M,) with shorter links."""
        if not rows:
            return set()
        rope = self.thrower.rope
        finer, some, last = divided(rope, FINER), flights.part(rows), ended[rows]
        some = replace(
            some,
            ropes=[finer] * len(rows),
            q=np.repeat(some.q, FINER, axis=1),
            qd=np.repeat(some.qd, FINER, axis=1),
        )
        t = strikes.SAMPLE_TIME * np.arange(1.0, last.max() + 1.0)
        batch = some.run(self.thrower.arm, t, tol=strikes.COARSE_TOL, keep=("q",), threads=self.threads)
        self.runs += len(rows)
        there = _tip(finer, batch.q[np.arange(len(rows)), last - 1])
        away = np.hypot(*(there - _tip(rope, q[rows, last])).T) / rope.total_length
        return {k for k, off in zip(rows, away, strict=True) if off < ASTRAY}

    def _tries(self, swing: _Swing) -> list[_Try]:
        """Strokes that are tried after a swing, as many as its rests until a strike allow."""
        limits, step, tries = self.thrower.limits, strikes.SAMPLE_TIME, []
        usual = min(STROKE, limits.angles[1] - limits.angles[0])
        sense = -swing.side * (1 if len(swing.strokes) % 2 == 0 else -1)
        rests = (np.arange(RESTS) + self._random.uniform()) * LONGEST * self._period / RESTS
        rests = rests if swing.strokes else np.zeros(1)
        for rest in rests:
            at = int(rest / step)
            ends: set[float] = set()
            for low, high in SIZES if at < len(swing.q) else ():
                way = self._random.uniform(low, high) * usual
                end = float(np.clip(swing.angle + sense * way, *limits.angles))
                if sense * (end - swing.angle) > LEAST_STROKE and end not in ends:
                    ends.add(end)
                    (time,), ramp = limits.fastest([end - swing.angle])
                    motion = moves([swing.angle, end], [0.0], [time], ramp)
                    tries.append(_Try(swing, swing.late + at * step, at, end, float(time), motion))
        return tries

    def _energy(self, motions: list[Motion], q: Array, qd: Array, t: Array, at: Array) -> Array:
        """Energy of ropes (M,) at samples `at` (M,), when the arm rests, J; of masses at the links' centres."""
        rope, arm, rows = self.thrower.rope, self.thrower.arm, np.arange(len(motions))
        base = np.stack([strikes.arm_tip(arm, motion, t[[k]])[0] for motion, k in zip(motions, at, strict=True)])
        places, speeds = strikes.bodies(rope, q[rows, at], qd[rows, at], base, np.zeros_like(base))
        mass = np.append(rope.mass, rope.tip_mass)
        return np.asarray((mass * (0.5 * (speeds**2).sum(axis=2) - places @ np.array(rope.gravity))).sum(axis=1))


def _ready(swing: _Swing, time: float, most: int) -> bool:
    return swing.spent < time and len(swing.strokes) < most


def _tip(rope: Rope, q: Array) -> Array:
    """Place of the tip (M, 2) from the first joint, m, of ropes at angles (M, n)."""
    return np.stack([(rope.length * np.sin(q)).sum(axis=1), -(rope.length * np.cos(q)).sum(axis=1)], axis=1)


def _best(swings: list[tuple[int, _Swing]], width: int) -> set[int]:
    """Rows of those with the most energy: `width` of each side, EACH that differ in the end alone."""
    kept: set[int] = set()
    sides: Counter[int] = Counter()
    parents: Counter[tuple[int, tuple[float, ...], tuple[float, ...]]] = Counter()
    for k, one in sorted(swings, key=lambda each: -each[1].energy):
        parent = one.side, one.strokes[:-1], one.rests[:-1]
        if sides[one.side] < width and parents[parent] < EACH:
            sides[one.side] += 1
            parents[parent] += 1
            kept.add(k)
    return kept
