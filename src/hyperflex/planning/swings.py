"""Free swings: a beam search for predictable swings with much energy, and variations of those that strike or nearly do.

A swing is simulated with the links as given and, if it may be continued or strikes, with shorter links as well, each
from its own state. Swings on which both chains agree are predictable: a rope that goes slack is not.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.model import Peg, Rope
from hyperflex.planning.moves import MIN_MOVE, Moves
from hyperflex.planning.options import SearchOptions
from hyperflex.planning.planner import Candidate
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import MODEL, RolloutBatch, Strikes, find_strikes

DELAY = 0.05  # s, between the strikes of two chains at most
GROUP = 16  # flights of nearly the same span that are simulated together
MIN_SPEED = 0.3  # of a move, over the motor's


class State(NamedTuple):
    """Time, s, angles (n,), rad, and rates (n,), rad/s, of a chain: no views, which keep a batch in memory."""

    t: float
    q: Array
    qd: Array

    def cut(self, pieces: int) -> "State":
        """Return the state of a chain with each link cut into pieces."""
        return State(self.t, np.repeat(self.q, pieces), np.repeat(self.qd, pieces))


@dataclass(frozen=True, eq=False)
class Swing:
    """Strokes without a strike, their states after the last one on each chain, and the swing that they continue.

    Swings of the greatest `merit` go on: energy, J, in free flight; turns in contact.
    """

    moves: Moves
    states: tuple[State, ...]
    merit: float = 0.0
    parent: "Swing | None" = None

    def ancestor(self, strokes: int) -> "Swing":
        """Return the swing so many strokes before, the first one at most."""
        return self if strokes == 0 or self.parent is None else self.parent.ancestor(strokes - 1)

    def last_of(self, some: Sequence["Swing"]) -> "Swing | None":
        """Return the last of some swings that this one continues; None if there is none."""
        if any(self is one for one in some):
            return self
        return None if self.parent is None else self.parent.last_of(some)


@dataclass(frozen=True, eq=False)
class Strike(Candidate):
    """A swing until it strikes at `t`, s: the states there of each chain, and the swing from which it was simulated.

    `follow` are the moves to try in contact, which agree with `moves` until the strike; empty: usual last moves, of
    which so many were `tried`. `winds`: whether the rope made the required turns with some, for however short a time. A
    swing that misses has no states; its score is below 0. `through_contact`: whether the rope had
    touched the peg before; `given`: whether the moves were given.
    """

    swing: Swing | None = None
    states: tuple[State, ...] = ()
    follow: tuple[Moves, ...] = field(default=())
    tried: int = 0
    winds: bool = False
    through_contact: bool = False
    given: bool = False


@dataclass(eq=False)
class _Lane:
    """Swings with strokes of one speed, over the motor's: those of each number of strokes, and those to continue."""

    speed: float
    swings: list[Swing]
    levels: list[list[Swing]] = field(default_factory=list)
    first: float = math.inf  # strokes before the first strike
    passes: int = 0

    def append(self, swings: list[Swing], struck: float) -> None:
        """Go on with swings that have one stroke more, after strikes with a number of strokes."""
        self.levels.append(self.swings)
        self.swings, self.first = swings, min(self.first, struck)

    def restart(self, back: int, random: np.random.Generator) -> None:
        """Go back to any stroke, but to some before the first strike, or to the middle, at most."""
        levels = [*self.levels, self.swings]
        first = min(self.first, len(levels) // 2 + back)
        keep = int(random.integers(max(0, int(first) - back) + 1))
        self.levels, self.swings, self.passes = levels[:keep], levels[keep], self.passes + 1


class Try(NamedTuple):
    """Moves that continue a swing, simulated until a time, s, at most. `whole`: with last moves after the strike."""

    swing: Swing
    moves: Moves
    until: float
    whole: bool = False


class SwingSearch:
    """Search for swings that strike a peg.

    Parameters
    ----------
    chains : sequence of Problem
        The rope with its links as given, and with shorter ones.
    peg : Peg
    sides : list of int
        Sides on which the arm may begin.
    random : numpy.random.Generator
    options : SearchOptions
    seen : sequence of Swing
        The last of the first moves of a cast as it was measured, each a stroke longer than its parent: the search goes
        on from the last, and begins again from any of them, as well.
    anew : bool
        Whether it also begins from the start, if there are any that were seen.

    Attributes
    ----------
    runs : int
        Simulated flights so far.
    passes : int
        How often the beam search has begun again.
    full : bool
        Whether all strokes are as long as the motor allows; else all but those of the first passes vary.
    """

    full = False

    def __init__(
        self,
        chains: Sequence[Problem],
        peg: Peg,
        sides: list[int],
        random: np.random.Generator,
        options: SearchOptions,
        seen: Sequence[Swing] = (),
        anew: bool = True,
    ) -> None:
        # Without limits of its own: a joint of the given rope bends further than one between shorter links may
        finer = (replace(one, rope=one.rope.replace(max_bend=np.inf)) for one in chains[1:])
        self.problem, self.chains = chains[0], (chains[0], *finer)
        self.peg, self.random, self.options = peg, random, options
        self.runs = self.passes = 0
        none, states = np.zeros(0), tuple(State(0.0, *one.start) for one in self.chains)
        self.begin = [Swing(Moves(side, none, none), states) for side in sides]
        self.seen = seen
        self._range = stroke_range(self.problem.limits.angles)
        levels = [[one] for one in seen]
        self._lanes = [_Lane(speed, self.begin) for speed in options.speeds] if anew or not seen else []
        self._lanes += [_Lane(speed, levels[-1], levels[:-1]) for speed in options.speeds[: len(seen)]]
        self._misses: list[Strike] = []

    def start(self, moves: Sequence[Moves], budget: Budget) -> list[Strike]:
        """Return the predictable strikes of whole moves, simulated from the last swing that was seen with them."""
        pairs = [(swing, one) for one in moves for swing in [*self.begin, *self.seen] if one.begins_with(swing.moves)]
        last = {id(one): (swing, one) for swing, one in pairs}.values()
        return self._strikes([Try(swing, one, self.problem.time, True) for swing, one in last], budget)[0]

    def extend(self, budget: Budget) -> list[Strike]:
        """Continue the swings of a speed by a stroke; return predictable strikes.

        When there is no time for more strokes, the next speed is on. Each speed begins again with other rests and
        strokes, after some of the strokes made.
        """
        lane = self._lanes[0]
        tries = [one for swing in lane.swings for one in self._strokes(swing, lane)]
        if not tries:
            lane.restart(self.options.back, self.random)
            self._lanes, self.passes = [*self._lanes[1:], lane], self.passes + 1
            lane = self._lanes[0]
            tries = [one for swing in lane.swings for one in self._strokes(swing, lane)]
        found, swings = self._strikes(tries, budget)
        lane.append(swings, min((one.moves.ends.size for one in found), default=math.inf))
        return found

    def vary(self, found: Sequence[Candidate], budget: Budget) -> list[Strike]:
        """Vary the last moves of the best of `found`, or of near misses, by little and by much; return the strikes."""
        parents = [one for one in found if isinstance(one, Strike)][: self.options.parents]
        parents += self._misses[: self.options.parents - len(parents)]
        tries = list[Try]()
        for _ in range(self.options.members if parents else 0):
            parent = parents[self.random.integers(len(parents))]
            swing = (parent.swing or self.begin[0]).ancestor(int(self.random.integers(self.options.back)))
            moves = self.varied(parent.moves, swing.moves.ends.size)
            until = parent.t if math.isfinite(parent.t) else parent.moves.stops(self.problem.limits)
            whole = bool(parent.states)
            tries.append(Try(swing, moves, until + self.options.watched * self.problem.period, whole))
        return self._strikes(tries, budget, onward=False)[0]

    def varied(self, moves: Moves, made: int, wait: float = 0.0) -> Moves:
        """Return moves of which all but the first `made` are varied, by little or much, after a rest of `wait`, s."""
        k = moves.ends.size
        size = self.options.spread * 10.0 ** -self.random.uniform(0.0, 1.5)
        change = size * self.random.standard_normal((3, k)) * (np.arange(k) >= made)
        rests = np.abs(moves.rests + self.problem.period * change[1])
        rests[made : made + 1] = np.maximum(rests[made : made + 1], wait)
        ends, speeds = moves.ends + math.pi * change[0], (moves.speeds + change[2]).clip(MIN_SPEED, 1.0)
        return replace(moves, ends=ends, rests=rests, speeds=speeds, dwell=0.0)

    def _strokes(self, swing: Swing, lane: _Lane) -> list[Try]:
        """Return the strokes that are tried after a swing, within the time."""
        limits, options, found = self.problem.limits, self.options, list[Try]()
        if swing.states[0].t >= self.problem.time:
            return found
        (least, greatest), count = self._range, swing.moves.ends.size
        usual = min(options.stroke * math.pi, greatest - least)
        sense, angle = -swing.moves.side * (1 if count % 2 == 0 else -1), swing.moves.angles(limits)[-1]
        if self._range != limits.angles and sense * ((greatest if sense > 0 else least) - angle) <= MIN_MOVE:
            sense = -sense
        longest = options.longest_rest * self.problem.period
        rests = (np.arange(options.rests) + self.random.uniform()) * longest / options.rests
        for rest in rests.tolist() if count else [0.0]:
            for low, high in ((1.0, 1.0),) if lane.passes == 0 or self.full else ((1.0, 1.0), (0.15, 0.9)):
                end = float(np.clip(angle + sense * self.random.uniform(low, high) * usual, least, greatest))
                if sense * (end - angle) > MIN_MOVE:
                    moves = swing.moves.then(end, rest, lane.speed)
                    found.append(Try(swing, moves, moves.stops(limits) + options.watched * self.problem.period))
        return found

    def _strikes(self, tries: list[Try], budget: Budget, onward: bool = True) -> tuple[list[Strike], list[Swing]]:
        """Simulate tries; return predictable strikes, the best first, and swings that may be continued.

        `onward`: whether any are continued.
        """
        if not tries:
            return [], []
        limits, step = self.problem.limits, MODEL.step
        stops = np.array([one.moves.stops(limits) for one in tries])
        since = np.array([one.swing.states[0].t for one in tries])
        t, q, qd, seen = self._fly(0, tries, [one.until for one in tries], budget)
        struck, swings = list[tuple[int, Strike]](), list[tuple[int, Swing]]()
        for k, (swing, moves, _, whole) in enumerate(tries):
            at, row = float(since[k] + seen.t[k]), math.ceil((stops[k] - since[k]) / step) - 1
            begins = moves.starts(limits)[swing.moves.ends.size]
            if at < self.problem.time and (swing.parent is None or begins < at):
                follow, state = (moves,) if whole else (), State(at, seen.q[k].copy(), seen.qd[k].copy())
                struck.append((k, Strike(moves, float(seen.score[k]), at, False, swing, (state,), follow)))
            clear = min(int(seen.clear[k]), t.size if math.isnan(at) else round((at - since[k]) / step))
            if onward and not whole and row < clear and np.isfinite(q[k, row]).all():
                state = State(float(since[k] + t[row]), q[k, row].copy(), qd[k, row].copy())
                energy = _energy(self.problem, moves, state)
                swings.append((k, Swing(moves, (state,), energy, swing)))
            elif math.isnan(at):
                self._misses.append(Strike(moves, float(seen.score[k]), at, swing=swing))
        self._misses = sorted(self._misses, key=lambda one: -one.score)[: self.options.parents]
        width, siblings = self.options.width, self.options.siblings
        struck = sorted(struck, key=lambda one: -one[1].score)[: self.options.batch]
        likely = best_swings(swings, 2 * width, 2 * siblings)
        for chain in range(1, len(self.chains)):
            struck, likely = self._agreed(chain, tries, struck, likely, budget)
        strikes = sorted((one for _, one in struck), key=lambda one: -one.score)
        return strikes, [one for _, one in best_swings(likely, width, siblings)]

    def _agreed(
        self,
        chain: int,
        tries: list[Try],
        struck: list[tuple[int, Strike]],
        onward: list[tuple[int, Swing]],
        budget: Budget,
    ) -> tuple[list[tuple[int, Strike]], list[tuple[int, Swing]]]:
        """Return the strikes and swings that are nearly the same on another chain, with its states.

        Strikes differ by DELAY at most; swings, after the stroke, by a part of the rope's length, root mean square by
        mass.
        """
        some: list[tuple[int, Strike | Swing]] = [*struck, *onward]
        if not some:
            return struck, onward
        ends = [one.t + 2.0 * DELAY if isinstance(one, Strike) else one.states[0].t for _, one in some]
        since = [tries[k].swing.states[0].t for k, _ in some]
        _, q, qd, seen = self._fly(chain, [tries[k] for k, _ in some], ends, budget)
        strikes, swings, rope = list[tuple[int, Strike]](), list[tuple[int, Swing]](), self.problem.rope
        apart = list[float]()
        for m, (k, one) in enumerate(some):
            at = since[m] + float(seen.t[m])
            if isinstance(one, Strike):
                if abs(at - one.t) <= DELAY:
                    states = *one.states, State(at, seen.q[m].copy(), seen.qd[m].copy())
                    strikes.append((k, replace(one, score=min(one.score, float(seen.score[m])), states=states)))
                continue
            row = round((one.states[0].t - since[m]) / MODEL.step) - 1
            state = State(one.states[0].t, q[m, row].copy(), qd[m, row].copy())
            apart.append(_apart(rope, one.states[0].q, self.chains[chain].rope, state.q))
            swings.append((k, replace(one, states=(*one.states, state))))
        usual, most = self.options.deviations
        limit = max(usual, min(2.0 * min(apart, default=0.0), most))
        return strikes, [one for one, off in zip(swings, apart, strict=True) if off <= limit]

    def _fly(
        self, chain: int, tries: list[Try], until: list[float], budget: Budget
    ) -> tuple[Array, Array, Array, Strikes]:
        """Simulate tries on a chain until times (M,), s; return times, angles and rates of samples, and first strikes.

        Samples later than that of a try may be NaN.
        """
        problem, states = self.chains[chain], [one.swing.states[chain] for one in tries]
        motions = [one.moves.motion(problem.limits, state.t) for one, state in zip(tries, states, strict=True)]
        q, qd = np.stack([each.q for each in states]), np.stack([each.qd for each in states])
        batch = RolloutBatch(
            [problem.rope] * len(tries), [self.peg] * len(tries), motions, q, qd, stiction=MODEL.stiction
        )
        spans = np.array(until) - [each.t for each in states]
        groups = np.array_split(np.argsort(spans), math.ceil(len(tries) / GROUP))  # of nearly the same span
        t: Array = MODEL.step * np.arange(1.0, math.ceil(spans.max() / MODEL.step - 1e-9) + 1.0)
        q, qd = (np.full((len(tries), t.size, problem.rope.n_links), np.nan) for _ in range(2))
        found = list[Strikes]()
        for rows in groups:
            some = batch.select(rows.tolist())
            here, *flown = some.fly(problem.arm, float(spans[rows].max()), budget)
            q[rows, : here.size], qd[rows, : here.size] = flown
            found.append(find_strikes(problem, self.peg, some, here, *flown))
        self.runs += len(tries)
        return t, q, qd, Strikes.joined(found).select(np.argsort(np.concatenate(groups)))


def stroke_range(angles: tuple[float, float]) -> tuple[float, float]:
    """Return the part of a motor's range in which its arm's tip goes aside most, rad; all if that is from side to side.

    A stroke on and back again, as from hanging to upright, would pump no swing.
    """
    least, greatest = angles
    aside = math.pi * (np.arange(math.ceil(least / math.pi - 0.5), math.floor(greatest / math.pi + 0.5)) + 0.5)
    ends = [least, *aside.tolist(), greatest]
    ways = np.abs(np.diff(np.sin(ends)))
    k = int(ways.argmax())
    return angles if ways[k] > 2.0 - 1e-9 else (ends[k], ends[k + 1])


def _energy(problem: Problem, moves: Moves, state: State) -> float:
    """Energy, J, of a rope that hangs from an arm at rest after moves."""
    rope, base = problem.rope, problem.arm.tip(moves.angles(problem.limits)[-1])
    places, speeds = rope.mass_points(state.q, state.qd, base, np.zeros(2))
    mass = np.append(rope.mass, rope.tip_mass)
    return float((mass * (0.5 * (speeds**2).sum(axis=1) - places @ np.array(rope.gravity))).sum())


def _apart(rope: Rope, q: Array, finer: Rope, angles: Array) -> float:
    """Distance of two chains of one rope with angles (n,) and (m,), rad: root mean square by mass, in rope lengths."""
    pieces = finer.n_links // rope.n_links
    away = finer.joints(angles, np.zeros(2))[pieces::pieces] - rope.joints(q, np.zeros(2))[1:]
    return float(np.sqrt(((away**2).sum(axis=1) * rope.mass).sum() / rope.mass.sum()) / rope.total_length)


def best_swings(swings: list[tuple[int, Swing]], width: int, siblings: int) -> list[tuple[int, Swing]]:
    """Return the swings of the greatest merit: `width` of each side, of these few of the same parent."""
    kept, count = list[tuple[int, Swing]](), Counter[object]()
    for k, one in sorted(swings, key=lambda each: -each[1].merit):
        side, parent = f"side {one.moves.side}", id(one.parent)
        if count[side] < width and count[parent] < siblings:
            count[side] += 1
            count[parent] += 1
            kept.append((k, one))
    return kept
