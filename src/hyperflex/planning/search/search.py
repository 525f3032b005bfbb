"""The search for a throw: free swings towards promising strikes, then the strikes' last moves beside the peg."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Peg, Setup, divided
from hyperflex.motion import hold
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.search import contact_phase as landing
from hyperflex.planning.search import strikes
from hyperflex.planning.search.beam import FINER, Beam, Strike
from hyperflex.planning.search.candidates import Landing, Swing, apart, corrected, unsure
from hyperflex.planning.search.evolution import evolution
from hyperflex.planning.search.parametrization import LAST, Genes
from hyperflex.planning.wind.outcome import WOUND
from hyperflex.planning.wind.throw import Throw
from hyperflex.simulation.contact.start import check_outside

MEMBERS, LANDING_MEMBERS = 32, 16  # of a generation of free swings, and of one beside the peg
KEPT = 4  # of a generation's swings that may be tried beside the peg
TRIED = 4  # swings of a round that are tried beside the peg
# What is tried after a strike: strokes still made, then the last move, in half turns, after a rest in periods
MORE, ENDS, RESTS = (0.5, 1.5, 2.5), (-1.0, -0.5, 0.0, 0.5, 1.0), (0.0, 0.05)
RARE, LEAST = 10.0, 0.5  # of how many runs one takes very long; processor time that each may take in any case, s
UNTIL = 2.0 * strikes.SAMPLE_TIME  # s after a strike, until which the arm rests that rested before it
LATE = 0.5  # part of the time allowed
FIRM = 32  # swings at once that are flown with shorter links too, and then kept
NARROW = 0.25  # spread of a search beside the peg, in parts of the first one's


@dataclass(eq=False)
class Search:
    """A search for throws: free swings, stroke by stroke and by CMA-ES, then by CMA-ES beside the peg.

    Parameters
    ----------
    thrower : Thrower
    peg : Peg
    seed : int
    threads : int, optional
    hold : float
        Pull that the wound rope should bear, N: for who verifies what was found.
    """

    thrower: Thrower
    peg: Peg
    seed: int = 0
    threads: int | None = None
    hold: float = 0.0
    swings: list[Swing] = field(default_factory=list, init=False)
    landings: list[Landing] = field(default_factory=list, init=False)
    runs: int = field(default=0, init=False)
    # s that the search may still take, if it is bounded
    left: Callable[[], float] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._beam: Beam | None = None
        self._begin()

    def lengthen(self, factor: float) -> None:
        """Begin anew, for casts that may take so many times as long; what was found until now is forgotten."""
        self.thrower = replace(self.thrower, time=factor * self.thrower.time)
        self._begin()

    def _begin(self) -> None:
        sides = [side for side in (-1, 1) if _clear(self.thrower, self.peg, side)]
        self.genes = {side: Genes(self.thrower, side) for side in sides}
        self._free = {side: self._evolution(g.centre(), 1.0, MEMBERS, g) for side, g in self.genes.items()}
        self.swings.clear()
        self.landings.clear()
        self._tried: list[Swing] = []
        self._close: tuple[int, Any] | None = None

    def _evolution(self, centre: Array, size: float, members: int, genes: Genes) -> Any:
        return evolution(centre, size, genes.spreads(), members, self._random)

    @property
    def _finer(self) -> Thrower:
        """The same with shorter links."""
        return replace(self.thrower, rope=divided(self.thrower.rope, FINER))

    @property
    def workers(self) -> int:
        """Threads that it may use."""
        return self.threads or os.cpu_count() or 1

    def climb(self) -> float:
        """Free swings stroke by stroke: goes on with those at hand if time was added, else anew.

        Returns the best score so far.
        """
        self._check()
        time, most = self.thrower.time, max(genes.strokes for genes in self.genes.values())
        if self._beam is None or not self._beam.ready(time, most):
            self._beam = Beam(self.thrower, self.peg, list(self.genes), self._random, self.threads)
        before = self._beam.runs
        found = self._beam.go(time, most, self.left)
        self.runs += self._beam.runs - before

        def swing(one: Strike) -> Swing:
            genes = self.genes[one.side]
            rest = max(genes.rest, one.after + UNTIL)
            return Swing(one.score, one.side, genes.point(one.strokes, one.rests, rest), one.t)

        return self._keep(list(map(swing, found)))

    def _keep(self, found: list[Swing]) -> float:
        """Keep the best of some swings that are not alike, as far as they do the same with shorter links.

        Returns the best score so far.
        """
        some = apart(sorted(found, key=lambda one: -one.score), (), FIRM)
        if some:
            throws = [self.genes[one.side].throw(one.x).cut(self.thrower.time, self.thrower.limits) for one in some]
            again = strikes.fly(self._finer, self.peg, throws, threads=self.threads).score
            self.runs += len(some)
            for one, score in zip(some, again, strict=True):
                self.swings.append(one._replace(score=min(one.score, float(score))))
            self.swings.sort(key=lambda one: -one.score)
        return self.swings[0].score if self.swings else strikes.NEVER

    def _check(self) -> None:
        if not self.genes:
            raise InvalidInput("the rope starts inside the target on either side of the arm", got=self.peg)

    def swing(self) -> float:
        """One generation of free swings from each side; returns the best score so far."""
        self._check()
        asked = {side: strategy.ask() for side, strategy in self._free.items()}
        each = max(1, self.workers // len(asked))

        def flown(side: int) -> strikes.Strikes:
            throws = [self.genes[side].throw(x) for x in asked[side]]
            return strikes.fly(self.thrower, self.peg, throws, threads=each)

        with ThreadPoolExecutor(len(asked)) as pool:
            flights = dict(zip(asked, pool.map(flown, asked), strict=True))
        kept: list[Swing] = []
        for side, found in flights.items():
            points = asked[side]
            self._free[side].tell(points, list(-found.score))
            self.runs += len(points)
            best = [k for k in np.argsort(-found.score)[:KEPT] if found.score[k] > 0.0]
            kept += [Swing(float(found.score[k]), side, np.asarray(points[k]), float(found.t[k])) for k in best]
        return self._keep(kept)

    @property
    def hurried(self) -> bool:
        """Whether the best swings strike late in the time that they have, or none does at all."""
        times = [one.t for one in self.swings[:KEPT]]
        return not times or float(np.median(times)) > LATE * self.thrower.time

    def try_ends(self) -> None:
        """Run the best swings that were not tried yet beside the peg, with several last moves each."""
        fresh = apart(self.swings, self._tried, TRIED)
        self._tried += fresh
        for side in self.genes:
            points = [
                np.append(one.x[:-LAST], [more, end, rest, 1.0])
                for one in fresh
                if one.side == side
                for more in MORE
                for end in ENDS
                for rest in (RESTS if more < 1.0 else RESTS[:1])
            ]
            if points:
                self.land(side, points)

    def refine(self) -> None:
        """One generation of throws beside the peg, about the best one."""
        if self._close is None:
            best = self.landings[0]
            self._close = best.side, self._evolution(best.x, NARROW, LANDING_MEMBERS, self.genes[best.side])
        side, strategy = self._close
        points = strategy.ask()
        strategy.tell(points, list(-self.land(side, points)))

    def restart(self) -> None:
        """Let the next :meth:`refine` begin from the best throw of then."""
        self._close = None

    def screen(self) -> None:
        """Run the best throws that wind again with shorter links, until the best one winds with these too."""
        while (self.left is None or self.left() > 0.0) and (some := unsure(self.landings)):
            throws = [one.throw for one in some]
            found = strikes.fly(self._finer, self.peg, throws, threads=self.threads)
            self.runs += 2 * len(some)
            score, turns = np.full(len(some), strikes.NEVER), np.zeros(len(some))
            struck = np.flatnonzero(np.isfinite(found.t))
            if struck.size:
                again = self._landed(self._finer, [throws[k] for k in struck], found.part(struck.tolist()))
                score[struck], turns[struck] = again.score, again.turns
            for one, value, left in zip(some, score, turns, strict=True):
                self.correct(one, float(left), float(value))

    def correct(self, one: Landing, turns: float, score: float) -> None:
        """Let a throw count what a better run made of it; if it does not wind then, go on about another."""
        self.landings = corrected(self.landings, one, turns, score)
        if turns < WOUND:
            self.restart()

    def allowance(self, members: int) -> float:
        """Processor time for each of so many runs, s: one in RARE may take all of it before the patience is over."""
        if self.left is None:
            return landing.PATIENCE
        each = RARE * max(self.left(), 0.0) * self.workers / members
        return float(np.clip(each, LEAST, landing.PATIENCE))

    def land(self, side: int, points: list[Array]) -> Array:
        """Run points beside the peg, keep what they led to, and return their scores (M,)."""
        throws = [self.genes[side].throw(x) for x in points]
        found = self._flown(points, throws)
        score = found.score.copy()
        struck = np.flatnonzero(np.isfinite(found.t))
        self.runs += len(points)
        if struck.size:
            cut = [throws[k].cut(float(found.t[k]), self.thrower.limits) for k in struck]
            ended = self._landed(self.thrower, cut, found.part(struck.tolist()))
            score[struck] = ended.score
            for k, throw, value, turns in zip(struck, cut, ended.score, ended.turns, strict=True):
                self.landings.append(Landing(float(value), float(turns), side, np.asarray(points[k]), throw))
            self.landings.sort(key=lambda one: -one.score)
        score[~np.isfinite(found.t)] = np.minimum(score[~np.isfinite(found.t)], 0.0)
        return score

    def _landed(self, thrower: Thrower, throws: list[Throw], struck: strikes.Strikes) -> landing.Landings:
        """Run throws beside the peg from their strikes."""
        state = struck.t, struck.q, struck.qd
        patience = self.allowance(len(throws))
        return landing.land(thrower, self.peg, throws, state, patience=patience, threads=self.threads)

    def _flown(self, points: list[Array], throws: list[Throw]) -> strikes.Strikes:
        """First strikes of throws before their last moves; those that differ in these alone are flown once."""
        keys = [x[:-LAST].tobytes() for x in points]
        order = list(dict.fromkeys(keys))
        self.runs += len(order)
        some = [throws[keys.index(key)].cut(self.thrower.time, self.thrower.limits) for key in order]
        found = strikes.fly(self.thrower, self.peg, some, threads=self.threads)
        return found.part([order.index(key) for key in keys])


def _clear(thrower: Thrower, peg: Peg, side: int) -> bool:
    """Whether a rope that hangs from the arm on one side keeps clear of the peg."""
    try:
        check_outside(Setup(thrower.rope, hold(thrower.limits.start(side)), thrower.arm, pegs=(peg,)))
    except InvalidInput:
        return False
    return True
