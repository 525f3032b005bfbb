"""Free swings, stroke by stroke: a beam search for swings that strike a target with much energy.

Each swing is continued with several rests and strokes. Of the swings that do not strike at once, those with the most
energy are continued in turn, if they are nearly the same with shorter links: a rope that goes slack is unpredictable.
"""

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.model import Peg, Rope, divided
from hyperflex.motion import Motion, arm_moves
from hyperflex.planning.moves import MIN_MOVE, Moves
from hyperflex.planning.options import SearchOptions
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import MODEL, RolloutBatch, find_strikes, mass_points
from hyperflex.planning.tasks.task import Candidate


@dataclass(frozen=True, eq=False)
class Strike(Candidate):
    """A swing until it strikes at `t`, s, with angles q (n,), rad, and rates qd (n,), rad/s, there.

    `follow` are the moves to try in contact, which agree with `moves` until the strike; empty: not drawn yet.
    """

    q: Array = field(default_factory=lambda: np.zeros(0))
    qd: Array = field(default_factory=lambda: np.zeros(0))
    follow: tuple[Moves, ...] = ()


class _Swing(NamedTuple):
    """Strokes without a strike, and samples (T, n) of the rest after them until a strike, if there is one."""

    energy: float
    moves: Moves
    angle: float  # rad, of the arm
    end: float  # s, of the last stroke
    delay: float  # s from there to the first sample
    q: Array
    qd: Array


class _Stroke(NamedTuple):
    """A stroke after a rest, s, from sample `at` of a swing, to arm angle `angle`, rad, in a duration, s."""

    swing: _Swing
    rest: float
    at: int
    angle: float
    duration: float
    motion: Motion


class Beam:
    """Beam search over the swings of a rope from each of some sides."""

    def __init__(
        self, problem: Problem, peg: Peg, sides: list[int], random: np.random.Generator, options: SearchOptions
    ) -> None:
        self.problem, self.peg, self.random, self.options, self.runs = problem, peg, random, options, 0
        q, qd = (part[None] for part in problem.start)
        none: Array = np.zeros(0)
        begin = [
            _Swing(0.0, Moves(side, none, none), problem.limits.start_angle(side), 0.0, 0.0, q, qd) for side in sides
        ]
        self._levels, self._swings, self._passes = [begin], begin, 0
        self._first = math.inf  # strokes before the first strike

    def extend(self, budget: Budget) -> list[Strike]:
        """Continue all swings by a stroke; return the strikes. After the last stroke the search begins again.

        It begins again with other rests and strokes some strokes before the first strike, or in the middle.
        """
        tries = [one for swing in self._swings for one in self._strokes(swing)]
        if not tries:
            first = min(self._first, len(self._levels) // 2 + self.options.back)
            self._levels = self._levels[: max(0, int(first) - self.options.back) + 1]
            self._swings, self._passes = self._levels[-1], self._passes + 1
            tries = [one for swing in self._swings for one in self._strokes(swing)]
        self.runs += len(tries)
        arm, rope, step = self.problem.arm, self.problem.rope, MODEL.step
        q, qd = (np.stack([getattr(one.swing, name)[one.at] for one in tries]) for name in ("q", "qd"))
        flights = RolloutBatch([rope] * len(tries), [self.peg] * len(tries), [one.motion for one in tries], q, qd)
        span = max(one.duration for one in tries) + self.options.watched * self.problem.period
        t, later, rates = flights.fly(arm, span, budget)
        t = np.append(0.0, t)
        q, qd = (np.concatenate([a[:, None], b], axis=1) for a, b in ((q, later), (qd, rates)))
        seen = find_strikes(self.problem, self.peg, flights, t, q, qd)
        ended = np.array([math.ceil(one.duration / step) for one in tries])
        until = np.where(np.isfinite(seen.t), np.round(np.nan_to_num(seen.t) / step) + 1, t.size)
        whole = np.minimum(seen.clear, until)
        found, onward = list[Strike](), list[tuple[int, _Swing]]()
        for k, (swing, rest, _, angle, duration, _) in enumerate(tries):
            moves, stop = swing.moves.then(angle, rest), swing.end + rest + duration
            if math.isfinite(seen.t[k]):
                at = swing.end + rest + float(seen.t[k])
                if at < self.problem.time:
                    found.append(Strike(moves, float(seen.score[k]), at, q=seen.q[k], qd=seen.qd[k]))
                    self._first = min(self._first, moves.ends.size)
            some = slice(int(ended[k]), int(whole[k]))
            if some.start < some.stop and np.isfinite(q[k, some]).all():
                energy = _energy(rope, _base(self.problem, angle), q[k, some.start], qd[k, some.start])
                delay = float(t[some.start]) - duration
                onward.append((k, _Swing(energy, moves, angle, stop, delay, q[k, some].copy(), qd[k, some].copy())))
        likely = _best(onward, 2 * self.options.width, self.options.siblings)
        kept = self._predictable(flights, likely, ended, q, budget)
        self._swings = [one for _, one in _best(kept, self.options.width, self.options.siblings)]
        self._levels.append(self._swings)
        return found

    def _strokes(self, swing: _Swing) -> list[_Stroke]:
        """Return the strokes that are tried after a swing, within its samples and the time."""
        limits, step, options, tries = self.problem.limits, MODEL.step, self.options, list[_Stroke]()
        if swing.end >= self.problem.time:
            return tries
        usual = min(options.stroke * math.pi, limits.angles[1] - limits.angles[0])
        sense = -swing.moves.side * (1 if swing.moves.ends.size % 2 == 0 else -1)
        longest = options.longest_rest * self.problem.period
        rests = (np.arange(options.rests) + self.random.uniform()) * longest / options.rests
        sizes = ((1.0, 1.0),) if self._passes == 0 else ((1.0, 1.0), (0.15, 0.9))
        for rest in rests.tolist() if swing.moves.ends.size else [0.0]:
            at, ends = int(rest / step), list[float]()
            for low, high in sizes if at < len(swing.q) else ():
                end = float(np.clip(swing.angle + sense * self.random.uniform(low, high) * usual, *limits.angles))
                if sense * (end - swing.angle) > MIN_MOVE and end not in ends:
                    ends.append(end)
                    (duration,), ramp = limits.fastest_moves([end - swing.angle])
                    motion = arm_moves([swing.angle, end], [0.0], [duration], ramp)
                    tries.append(_Stroke(swing, swing.delay + at * step, at, end, float(duration), motion))
        return tries

    def _predictable(
        self, flights: RolloutBatch, onward: list[tuple[int, _Swing]], ended: Array, q: Array, budget: Budget
    ) -> list[tuple[int, _Swing]]:
        """Return the swings that are nearly at the same place after the stroke with shorter links.

        That is within a part of the rope's length, root mean square by mass, or the median of all.
        """
        if not (onward and self.options.pieces > 1):
            return onward
        rows, pieces, rope = [k for k, _ in onward], self.options.pieces, self.problem.rope
        # Without limits of its own: a joint of the given rope bends further than one between shorter links may
        finer, some, last = divided(rope.replace(max_bend=np.inf), pieces), flights.select(rows), ended[rows]
        q0, qd0 = (np.repeat(each, pieces, axis=1) for each in (some.q, some.qd))
        some = replace(some, ropes=[finer] * len(rows), q=q0, qd=qd0)
        _, there, _ = some.fly(self.problem.arm, MODEL.step * float(last.max()), budget)
        self.runs += len(rows)
        away = _ends(finer, there[np.arange(len(rows)), last - 1])[:, pieces - 1 :: pieces] - _ends(rope, q[rows, last])
        off = np.sqrt(((away**2).sum(axis=2) * rope.mass).sum(axis=1) / rope.mass.sum()) / rope.total_length
        most = max(self.options.deviation, float(np.median(np.nan_to_num(off, nan=np.inf))))
        return [each for each, one in zip(onward, off, strict=True) if one <= most]


def _base(problem: Problem, angle: float) -> Array:
    """Place of the rope's first joint (2,), m, at an arm angle, rad."""
    return np.asarray(problem.arm.length * np.array([math.sin(angle), -math.cos(angle)]) + np.array(problem.arm.pivot))


def _energy(rope: Rope, base: Array, q: Array, qd: Array) -> float:
    """Energy, J, of a rope at angles q (n,), rad, and rates qd (n,), rad/s, that hangs from an arm at rest."""
    places, speeds = mass_points(rope, q, qd, base, np.zeros(2))
    mass = np.append(rope.mass, rope.tip_mass)
    return float((mass * (0.5 * (speeds**2).sum(axis=1) - places @ np.array(rope.gravity))).sum())


def _ends(rope: Rope, q: Array) -> Array:
    """Ends of the links relative to the first joint (M, n, 2), m, of ropes at angles q (M, n)."""
    return np.asarray(np.cumsum(np.stack([rope.length * np.sin(q), -rope.length * np.cos(q)], axis=-1), axis=1))


def _best(swings: list[tuple[int, _Swing]], width: int, siblings: int) -> list[tuple[int, _Swing]]:
    """Return the swings with the most energy: `width` of each side, of these few that differ in the last stroke."""
    kept, count = list[tuple[int, _Swing]](), Counter[tuple[int, ...]]()
    for k, one in sorted(swings, key=lambda each: -each[1].energy):
        side = one.moves.side
        parent = (side, hash(one.moves.ends[:-1].tobytes() + one.moves.rests[:-1].tobytes()))
        if count[side,] < width and count[parent] < siblings:
            count[side,] += 1
            count[parent] += 1
            kept.append((k, one))
    return kept
