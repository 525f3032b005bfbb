"""Swings through contact: a beam search for swings that wind a rope although the target stops each of them.

Beside the hanging rope, or near the arm, the target leaves no room for a free swing with enough energy. Yet each stroke
moves the rope on, and its tail swings further round the target. So strokes are simulated in contact, and those swings
go on that wind furthest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.model import Peg
from hyperflex.planning.clearance import clear_samples, samples_clear_of_arm
from hyperflex.planning.options import SearchOptions
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import RolloutBatch, swing_in_contact
from hyperflex.planning.swings import State, Strike, Swing, SwingSearch, Try, best_swings

DEARER = 4  # a stroke in contact takes more time than in free flight, so that fewer swings are continued
UNWOUND = 0.25  # turns, below which a rope leans on the peg rather than winds


class _Run(NamedTuple):
    """Times, s, turns, angles, rad, and rates, rad/s, of a rope as long as it is clear of its arm and obstacles."""

    t: Array
    turns: Array
    q: Array
    qd: Array

    @property
    def most(self) -> float:
        """Return the most turns at any time."""
        return float(np.abs(self.turns).max(initial=0.0))

    def state(self, t: float) -> State:
        """Return the state at the last sample until a time, s, or at the first one."""
        row = max(0, int(np.searchsorted(self.t, t + 1e-9)) - 1)
        return State(float(self.t[row]), self.q[row].copy(), self.qd[row].copy())


@dataclass(frozen=True, eq=False)
class Pumped(Swing):
    """A swing in contact, and its run, which goes on after the last stroke."""

    run: _Run | None = None


class SwingsInContact(SwingSearch):
    """Search for swings in contact that wind a peg; arguments are as of :class:`SwingSearch`.

    The first of the `chains` is that of runs in contact. Strokes are as long as the motor allows, and as fast as the
    options: only their rests differ. A swing that nearly winds is simulated with shorter links as well, and so are
    those that it continues: it strikes if it nearly winds with these, too.
    """

    full = True

    def __init__(
        self, chains: Sequence[Problem], peg: Peg, sides: list[int], random: np.random.Generator, options: SearchOptions
    ) -> None:
        width, rests = max(1, options.width // DEARER), max(1, (options.rests + 1) // 2)
        fewer = replace(options, speeds=(max(options.speeds),), width=width, rests=rests)
        super().__init__(chains, peg, sides, random, fewer)
        # The same swings with shorter links; None: it fails with them
        self._shorter = WeakKeyDictionary[Swing, Swing | None]()

    def _strikes(self, tries: list[Try], budget: Budget, onward: bool = True) -> tuple[list[Strike], list[Swing]]:
        """Simulate tries in contact; return those that nearly wind, the best first, and swings to be continued."""
        runs, nearly = self._simulated(0, tries, budget), self.options.nearly * self.problem.criteria.turns
        rows = [k for k, run in enumerate(runs) if run.t.size and run.most >= nearly]
        best = sorted(rows, key=lambda k: -runs[k].most)[: self.options.batch]
        pairs = [(k, before) for k in best if (before := self._with_shorter_links(tries[k].swing, budget))]
        finer = self._simulated(1, [tries[k]._replace(swing=before) for k, before in pairs], budget)
        some = [self._strike(tries[k], runs[k], other, onward) for (k, _), other in zip(pairs, finer, strict=True)]
        found, swings = [one for one in some if one is not None], list[tuple[int, Swing]]()
        if onward:
            made = [self._swing(one, run) for one, run in zip(tries, runs, strict=True)]
            swings = [(k, one) for k, one in enumerate(made) if one is not None]
        return found, [one for _, one in best_swings(swings, self.options.width, self.options.siblings)]

    def _strike(self, one: Try, run: _Run, other: _Run, onward: bool) -> Strike | None:
        """Return the strike of a try and its runs on both chains; None if it comes late, or not with shorter links.

        It strikes when it last made fewer than UNWOUND turns before it made the most.
        """
        furthest = int(np.abs(run.turns).argmax())
        sense = np.sign(run.turns[furthest])
        unwound = np.flatnonzero(sense * run.turns[:furthest] < UNWOUND)
        begin = run.state(float(run.t[unwound[-1] if unwound.size else 0]))
        made = float((sense * other.turns[other.t >= begin.t]).max(initial=0.0))
        nearly = self.options.nearly * self.problem.criteria.turns
        if begin.t >= self.problem.time or not other.t.size or made < nearly:
            return None
        states, follow, score = (begin, other.state(begin.t)), () if onward else (one.moves,), min(run.most, made)
        return Strike(one.moves, score, begin.t, False, one.swing, states, follow, through_contact=True)

    def _swing(self, one: Try, run: _Run) -> Swing | None:
        """Return the swing of a try; None if the rope was not clear until the end of its last stroke."""
        stop = one.moves.stops(self.problem.limits)
        if not run.t.size or not run.t[0] <= stop <= run.t[-1]:
            return None
        after = _Run(*(each[np.searchsorted(run.t, stop + 1e-9) - 1 :].copy() for each in run))
        return Pumped(one.moves, (run.state(stop),), run.most, one.swing, after)

    def _with_shorter_links(self, swing: Swing, budget: Budget) -> Swing | None:
        """Return the same swing with shorter links; None if it, or one that it continues, fails with them."""
        if swing.parent is None:
            return replace(swing, states=swing.states[1:])
        if swing not in self._shorter:
            until = swing.states[0].t + self.options.watched * self.problem.period
            budget.check()
            before = self._with_shorter_links(swing.parent, budget)
            one = None if before is None else Try(before, swing.moves, until)
            self._shorter[swing] = None if one is None else self._swing(one, self._simulated(1, [one], budget)[0])
        return self._shorter[swing]

    def _simulated(self, chain: int, tries: list[Try], budget: Budget) -> list[_Run]:
        """Simulate tries in contact on a chain, from swings on it."""
        if not tries:
            return []
        problem, limits, starts = self.chains[chain], self.problem.limits, list[State]()
        for one in tries:
            begin = float(one.moves.starts(limits)[one.swing.moves.ends.size])
            run = one.swing.run if isinstance(one.swing, Pumped) else None
            starts.append(one.swing.states[0] if run is None else run.state(begin))
        motions = [one.moves.motion(limits, state.t) for one, state in zip(tries, starts, strict=True)]
        q, qd = np.stack([each.q for each in starts]), np.stack([each.qd for each in starts])
        batch = RolloutBatch([problem.rope] * len(tries), [self.peg] * len(tries), motions, q, qd)
        spans = [one.until - state.t for one, state in zip(tries, starts, strict=True)]
        self.runs, runs = self.runs + len(tries), list[_Run]()
        samples = swing_in_contact(problem, batch, spans, budget)
        for motion, start, (t, turns, q, qd) in zip(motions, starts, samples, strict=True):
            clear, base = 0, np.asarray(problem.arm.tip(motion.angle(t)))
            if t.size:
                near = samples_clear_of_arm(problem.rope, problem.arm, q[None], base[None], problem.clearance)
                apart = clear_samples([problem.rope], problem.obstacles, q[None], base[None], problem.clearance)
                clear = int(min(near[0], apart[0]))
            runs.append(_Run(t[:clear] + start.t, turns[:clear], q[:clear], qd[:clear]))
        return runs
