"""Swings through contact: a beam search for swings that wind a rope although the target stops each of them.

Beside the hanging rope, or near the arm, the target leaves no room for a free swing with enough energy. Yet each stroke
moves the rope on, and its tail swings further round the target. So strokes are simulated in contact, and those swings
go on that wind furthest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

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


@dataclass(frozen=True, eq=False)
class Pumped(Swing):
    """A swing in contact, with times, s, angles (T, n), rad, and rates, rad/s, after its last stroke."""

    after: tuple[Array, Array, Array] = field(default=(np.zeros(0),) * 3)

    def state(self, t: float) -> State:
        """Return the state at the last sample until a time, s, or at the first one."""
        times, q, qd = self.after
        k = max(0, int(np.searchsorted(times, t + 1e-9)) - 1)
        return State(float(times[k]), q[k], qd[k])


class SwingsInContact(SwingSearch):
    """Search for swings in contact that wind a peg; arguments are as of :class:`SwingSearch`.

    The first of the `chains` is that of runs in contact.
    """

    def __init__(
        self,
        chains: Sequence[Problem],
        peg: Peg,
        sides: list[int],
        random: np.random.Generator,
        options: SearchOptions,
    ) -> None:
        width, rests = max(1, options.width // DEARER), max(1, options.rests // 2)
        super().__init__(chains, peg, sides, random, replace(options, width=width, rests=rests))

    def _strikes(self, tries: list[Try], budget: Budget, onward: bool = True) -> tuple[list[Strike], list[Swing]]:
        """Simulate tries in contact; return those that nearly wind, the best first, and swings to be continued."""
        if not tries:
            return [], []
        problem, limits, required = self.problem, self.problem.limits, self.problem.criteria.turns
        begins = [one.moves.starts(limits)[one.swing.moves.ends.size] for one in tries]
        starts = [
            one.swing.state(at) if isinstance(one.swing, Pumped) else one.swing.states[0]
            for one, at in zip(tries, begins, strict=True)
        ]
        motions = [one.moves.motion(limits, state.t) for one, state in zip(tries, starts, strict=True)]
        q, qd = np.stack([each.q for each in starts]), np.stack([each.qd for each in starts])
        batch = RolloutBatch([problem.rope] * len(tries), [self.peg] * len(tries), motions, q, qd)
        spans = [one.until - state.t for one, state in zip(tries, starts, strict=True)]
        self.runs += len(tries)
        found, swings = list[Strike](), list[tuple[int, Swing]]()
        for k, (one, samples) in enumerate(zip(tries, swing_in_contact(problem, batch, spans, budget), strict=True)):
            t, turns, angles, rates = samples
            if not t.size:
                continue
            base: Array = np.asarray(problem.arm.tip(motions[k].angle(t)))
            clear, t = self._clear(angles, base), t + starts[k].t
            furthest = int(np.abs(turns[:clear]).argmax()) if clear else 0
            made = abs(float(turns[furthest])) if clear else 0.0
            row = int(np.searchsorted(t, one.moves.stops(limits)))
            if made >= self.options.nearly * required:
                unwound = np.flatnonzero(np.sign(turns[furthest]) * turns[:furthest] < UNWOUND)
                first = int(unwound[-1]) if unwound.size else 0
                if t[first] < problem.time:
                    states = State(float(t[first]), angles[first], rates[first]), State(0.0, *self.chains[1].start)
                    follow = () if onward else (one.moves,)
                    strike = Strike(one.moves, made, float(t[first]), False, one.swing, states, follow, pumped=True)
                    found.append(strike)
            if onward and row < min(clear, t.size):
                state, after = State(float(t[row]), angles[row], rates[row]), (t[row:], angles[row:], rates[row:])
                swings.append((k, Pumped(one.moves, (state,), made, one.swing, after)))
        found = sorted(found, key=lambda each: -each.score)[: self.options.batch]
        return found, [one for _, one in best_swings(swings, self.options.width, self.options.siblings)]

    def _clear(self, q: Array, base: Array) -> int:
        """Return after how many samples (T, n) a rope comes too near its arm, the shaft or an obstacle."""
        problem, rope = self.problem, self.problem.rope
        near = samples_clear_of_arm(rope, problem.arm, q[None], base[None], problem.clearance)
        return int(min(near[0], clear_samples([rope], problem.obstacles, q[None], base[None], problem.clearance)[0]))
