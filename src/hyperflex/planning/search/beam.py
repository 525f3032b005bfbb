"""Beam search over free swings, stroke by stroke.

Each swing is continued with several rests and strokes. Of the swings that do not strike at once, those with the most
energy are continued in turn, if they are nearly the same with shorter links: a rope that goes slack is unpredictable.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Peg, Rope, divided
from hyperflex.motion import Motion, arm_moves
from hyperflex.planning.clearance import samples_clear_of_arm
from hyperflex.planning.problem import Problem
from hyperflex.planning.search import strikes
from hyperflex.planning.search.rollouts import RolloutBatch, usable_threads
from hyperflex.planning.throw import MIN_STROKE, STROKE
from hyperflex.simulation import Deadline

WIDTH, EACH = 12, 2  # swings of a side that are continued, and how many of them after the same strokes
RESTS, MAX_REST = 5, 0.6  # rests that are tried after a stroke, and the longest of them, in periods
SIZES = ((1.0, 1.0), (0.5, 0.9), (0.15, 0.5))  # of the strokes tried after each rest, relative to the usual stroke
# Of a first look, and every second one: six of ten targets were struck well enough with these alone, nine with all in
# 2.5 times the time
FULL = SIZES[:1]
ENOUGH = 6  # strikes that are worth a try, after which a beam search may end
BACK = 3  # strokes before the first strike from which a search begins again
WATCHED = 0.7  # periods after a stroke in which a strike is looked for
FINER = 3  # pieces of each link, as in the last verification
# Of the tip with shorter links after a stroke, in rope lengths: up to the first, and to twice the least of all swings
# where that is less than the second. Of a cord on a fast arm none was within the first after two strokes
MAX_DEVIATION, MAX_LEAST = 0.005, 0.02


class Strike(NamedTuple):
    """Strokes from rest with a strike at the end."""

    score: float
    side: int
    strokes: tuple[float, ...]  # rad
    rests: tuple[float, ...]  # s, before each
    t: float  # s
    after: float  # s since the last stroke's end; below 0 where it comes in that stroke


class _Swing(NamedTuple):
    """Strokes without a strike, and samples of the rest after them until a strike, if there is one."""

    energy: float
    side: int
    strokes: tuple[float, ...]
    rests: tuple[float, ...]
    angle: float  # rad, of the arm
    end: float  # s, of the last stroke
    delay: float  # s from there to the first sample
    q: Array
    qd: Array

    def ready(self, time: float, most: int) -> bool:
        return self.end < time and len(self.strokes) < most


class _Continuation(NamedTuple):
    """A stroke after a swing: after a rest, s, from sample `at` of the swing, to arm angle `angle`, rad."""

    swing: _Swing
    rest: float
    at: int
    angle: float
    duration: float  # s
    motion: Motion


class BeamSearch:
    """Beam search over the swings of a rope; it can be continued, and begun again with other rests and strokes.

    Parameters
    ----------
    problem : Problem
        Its time is not used.
    peg : Peg
    sides : sequence of {-1, 1}
        Sides on which the arm may start.
    random : Generator
        Source of the rests and strokes that are tried.
    threads : int, optional
    sizes : sequence of (low, high)
        Of strokes, relative to the usual one; of each pair one is drawn.
    """

    def __init__(
        self,
        problem: Problem,
        peg: Peg,
        sides: Sequence[int],
        random: np.random.Generator,
        threads: int | None = None,
        sizes: Sequence[tuple[float, float]] = SIZES,
    ) -> None:
        self.problem, self.peg, self.threads, self.runs = problem, peg, threads, 0
        self._sizes = sizes
        self._random, self._period = random, problem.period
        self._strikes: list[Strike] = []
        self._moves: dict[tuple[float, float], Motion] = {}  # full strokes go to and fro between the same angles
        q, qd = (part[None] for part in problem.start)
        self._swings = [_Swing(0.0, side, (), (), problem.limits.start_angle(side), 0.0, 0.0, q, qd) for side in sides]
        self._levels = {0: self._swings}  # swings by their number of strokes, as they were first reached

    def restart(self, sizes: Sequence[tuple[float, float]]) -> None:
        """Begin again with strokes of other sizes, BACK strokes before the first strike: those before pump alone.

        Where nothing was struck it begins in the middle of the strokes made.
        """
        strokes = [len(one.strokes) - BACK for one in self._strikes] or [len(self._levels) // 2]
        self._sizes, self._swings = sizes, self._levels[max(0, min(strokes))]

    def ready(self, time: float, most: int) -> bool:
        """Whether any swing of less than `most` strokes ends before `time`, s."""
        return any(one.ready(time, most) for one in self._swings)

    def extend(
        self, time: float, most: int, left: Callable[[], float] | None = None, enough: float = np.inf
    ) -> list[Strike]:
        """Continue all swings that are ready until none is, or no time is left; return new strikes, best first.

        Swings of at most `most` strokes end, and strikes come, before `time`, s. `left` returns the time that is left,
        s. It ends as well where ENOUGH new strikes score `enough`.
        """
        known = len(self._strikes)
        while self.ready(time, most) and (left is None or left() > 0.0):
            if sum(one.score >= enough and one.t < time for one in self._strikes[known:]) >= ENOUGH:
                break
            later = [one for one in self._swings if not one.ready(time, most)]
            budget = None if left is None else Deadline(np.inf, left)
            struck, onward = self._continue([one for one in self._swings if one.ready(time, most)], budget)
            self._strikes += struck
            self._swings = later + onward
            for strokes in {len(one.strokes) for one in onward} - self._levels.keys():
                self._levels[strokes] = [one for one in onward if len(one.strokes) == strokes]
        return sorted((one for one in self._strikes[known:] if one.t < time), key=lambda one: -one.score)

    def _continue(self, swings: list[_Swing], budget: Deadline | None) -> tuple[list[Strike], list[_Swing]]:
        """Add a stroke to each swing; return the strikes, and the swings that are continued."""
        tries = [one for swing in swings for one in self._continuations(swing)]
        if not tries:
            return [], []
        self.runs += len(tries)
        step, rope = strikes.SAMPLE_TIME, self.problem.rope
        span = max(one.duration for one in tries) + WATCHED * self._period
        t = step * np.arange(np.ceil(span / step) + 1.0)
        flights, q, qd, seen = self._flown(tries, t, budget)
        ended = np.array([int(np.ceil(one.duration / step)) for one in tries])
        energy = self._energy(tries, q, qd, ended)
        unfolded = strikes.samples_unfolded(rope, q)
        struck: list[Strike] = []
        onward: list[tuple[int, _Swing]] = []
        for k, (swing, rest, _, end, time, _) in enumerate(tries):
            strokes, rests = (*swing.strokes, abs(end - swing.angle)), (*swing.rests, rest)
            if np.isfinite(seen.t[k]):
                at = swing.end + rest + float(seen.t[k])
                struck.append(Strike(float(seen.score[k]), swing.side, strokes, rests, at, float(seen.t[k]) - time))
            first = int(ended[k])
            last = int(seen.clear[k]) if np.isnan(seen.t[k]) else round(float(seen.t[k]) / step) + 1
            last = min(last, int(unfolded[k]))
            some = q[k, first:last], qd[k, first:last]
            if first < last and all(np.isfinite(each).all() for each in some):
                delay, stop = float(t[first]) - time, swing.end + rest + time
                new = _Swing(float(energy[k]), swing.side, strokes, rests, end, stop, delay, *map(np.copy, some))
                onward.append((k, new))
        likely = _best(onward, 2 * WIDTH)
        onward = self._clear_of_arm([each for each in onward if each[0] in likely], flights, t, q, ended)
        confirmed = self._confirmed(flights, [k for k, _ in onward], ended, q, budget)
        best = _best([each for each in onward if each[0] in confirmed], WIDTH)
        return struck, [one for k, one in onward if k in best]

    def _flown(
        self, tries: list[_Continuation], t: Array, budget: Deadline | None
    ) -> tuple[RolloutBatch, Array, Array, strikes.Strikes]:
        """Simulate continuations (M,) to times t (T,), s; return them, q and qd (M, T, n), and their strikes.

        An equal part of them on each thread, what is computed from its samples, too.
        """
        rope, arm = self.problem.rope, self.problem.arm
        q = np.stack([one.swing.q[one.at] for one in tries])
        qd = np.stack([one.swing.qd[one.at] for one in tries])
        whole = RolloutBatch([rope] * len(tries), [self.peg] * len(tries), [one.motion for one in tries], q, qd)

        def part(rows: Sequence[int]) -> tuple[Array, Array, strikes.Strikes]:
            some = whole.select(rows)
            given: dict[str, Any] = {"keep": ("q", "qd"), "time_budget": budget, "threads": 1}
            batch = some.run(arm, t[1:], tol=strikes.COARSE_TOL, **given)
            q = np.concatenate([some.q[:, None], batch.q], axis=1)
            qd = np.concatenate([some.qd[:, None], batch.qd], axis=1)
            return q, qd, strikes.find_strikes(self.problem, self.peg, some.motions, t, q, qd, own_arm=False)

        shares = np.array_split(np.arange(len(tries)), min(len(tries), usable_threads(self.threads)))
        parts = [rows.tolist() for rows in shares]
        with ThreadPoolExecutor(len(parts)) as pool:
            q_parts, qd_parts, seen = zip(*pool.map(part, parts), strict=True)
        return whole, np.concatenate(q_parts), np.concatenate(qd_parts), strikes.joined(seen)

    def _clear_of_arm(
        self, onward: list[tuple[int, _Swing]], flights: RolloutBatch, t: Array, q: Array, ended: Array
    ) -> list[tuple[int, _Swing]]:
        """Swings by their rows of q (M, T, n), with the samples before the rope comes too near its arm, if any."""
        rows, arm = [k for k, _ in onward], self.problem.arm
        base = np.array([strikes.arm_tip(arm, flights.motions[k], t)[0] for k in rows]).reshape(len(rows), t.size, 2)
        clear = samples_clear_of_arm(self.problem.rope, arm, q[rows], base, self.problem.clearance) - ended[rows]
        return [
            (k, one._replace(q=one.q[:count], qd=one.qd[:count]))
            for (k, one), count in zip(onward, clear.tolist(), strict=True)
            if count > 0
        ]

    def _confirmed(
        self, flights: RolloutBatch, rows: list[int], ended: Array, q: Array, budget: Deadline | None
    ) -> set[int]:
        """Rows of q (M, T, n) whose tip at sample `ended` (M,) is nearly the same with shorter links, run alike.

        Up to MAX_DEVIATION, or twice what the row differs that differs least, but by less than MAX_LEAST.
        """
        if not rows:
            return set()
        rope = self.problem.rope
        # Without limits of its own: a joint of the given rope bends further than one between shorter links may
        finer, some, last = divided(rope.replace(max_bend=np.inf), FINER), flights.select(rows), ended[rows]
        some = replace(
            some,
            ropes=[finer] * len(rows),
            q=np.repeat(some.q, FINER, axis=1),
            qd=np.repeat(some.qd, FINER, axis=1),
        )
        t = strikes.SAMPLE_TIME * np.arange(1.0, last.max() + 1.0)
        how: dict[str, Any] = {"tol": strikes.COARSE_TOL, "time_budget": budget, "threads": self.threads}
        batch = some.run(self.problem.arm, t, keep=("q",), **how)
        self.runs += len(rows)
        there = _tip(finer, batch.q[np.arange(len(rows)), last - 1])
        away = np.hypot(*(there - _tip(rope, q[rows, last])).T) / rope.total_length
        most = max(MAX_DEVIATION, min(2.0 * float(np.nanmin(away, initial=np.inf)), MAX_LEAST))
        return {k for k, off in zip(rows, away, strict=True) if off < most}

    def _continuations(self, swing: _Swing) -> list[_Continuation]:
        """Return the strokes that are tried after a swing, within its samples."""
        limits, step, tries = self.problem.limits, strikes.SAMPLE_TIME, []
        usual = min(STROKE, limits.angles[1] - limits.angles[0])
        sense = -swing.side * (1 if len(swing.strokes) % 2 == 0 else -1)
        rests = (np.arange(RESTS) + self._random.uniform()) * MAX_REST * self._period / RESTS
        rests = rests if swing.strokes else np.zeros(1)
        for rest in rests:
            at = int(rest / step)
            ends: set[float] = set()
            for low, high in self._sizes if at < len(swing.q) else ():
                way = self._random.uniform(low, high) * usual
                end = float(np.clip(swing.angle + sense * way, *limits.angles))
                if sense * (end - swing.angle) > MIN_STROKE and end not in ends:
                    ends.add(end)
                    motion = self._move(swing.angle, end)
                    time = float(motion.breaks[-1])
                    tries.append(_Continuation(swing, swing.delay + at * step, at, end, time, motion))
        return tries

    def _move(self, start: float, end: float) -> Motion:
        """Return the fastest move between two arm angles, rad; the same one where it was asked for before."""
        if (start, end) not in self._moves:
            (time,), ramp = self.problem.limits.fastest_moves([end - start])
            self._moves[start, end] = arm_moves([start, end], [0.0], [time], ramp)
        return self._moves[start, end]

    def _energy(self, tries: list[_Continuation], q: Array, qd: Array, at: Array) -> Array:
        """Energy (M,), J, at samples `at` (M,), where the arm rests, of point masses at the links' centres of mass."""
        rope, arm, rows = self.problem.rope, self.problem.arm, np.arange(len(tries))
        angle = np.array([one.angle for one in tries])
        base = np.stack([np.sin(angle), -np.cos(angle)], axis=1) * arm.length + np.array(arm.pivot)
        places, speeds = strikes.mass_points(rope, q[rows, at], qd[rows, at], base, np.zeros_like(base))
        mass = np.append(rope.mass, rope.tip_mass)
        return np.asarray((mass * (0.5 * (speeds**2).sum(axis=2) - places @ np.array(rope.gravity))).sum(axis=1))


def _tip(rope: Rope, q: Array) -> Array:
    """Position of the tip relative to the first joint (M, 2), m, of ropes at angles q (M, n)."""
    return np.stack([(rope.length * np.sin(q)).sum(axis=1), -(rope.length * np.cos(q)).sum(axis=1)], axis=1)


def _best(swings: list[tuple[int, _Swing]], width: int) -> set[int]:
    """Rows with the most energy: `width` of each side, of these EACH that differ in the last stroke alone."""
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
