"""The robust part of a search: throws that win in most of the worlds that may be met, not only in the one expected."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Peg
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.robust import scenarios as flights
from hyperflex.planning.robust.uncertainty import Draw, Uncertainty
from hyperflex.planning.search.candidates import Landing, same_swing
from hyperflex.planning.search.contact_phase import Landings
from hyperflex.planning.search.evolution import evolution
from hyperflex.planning.search.parametrization import Genes
from hyperflex.planning.wind.outcome import WOUND
from hyperflex.planning.wind.throw import Throw

POOL, HEATS = 16, (4, 4, 8)  # throws that are raced, and the worlds of each heat; the better half goes on
EACH = 4  # throws of one swing that are raced while there are others: they mostly fail in the same worlds
MEMBERS, WORLDS = 8, 6  # of a generation of the refinement
JUDGED = 16  # worlds in which a challenger meets the champion
NARROW = 0.1  # spread of the refinement, in parts of the nominal search's first one
SHADE = 0.2  # what a good score counts beside a win
BEST = 3.0  # score from which on more does not count
ALIKE = 0.02  # points that differ by less are one
RACE, REFINE, CONFIRM, EVOLVE = 9001, 9002, 9003, 9004  # streams of random numbers


@dataclass(eq=False)
class Runner:
    """A throw that is raced, and what it came to in each world until now."""

    landing: Landing
    wins: list[bool] = field(default_factory=list)
    worth: list[float] = field(default_factory=list)

    @property
    def mean(self) -> float:
        """Mean worth; wins count one."""
        return float(np.mean(self.worth)) if self.worth else -1.0

    @property
    def judged(self) -> float:
        """The same in the common worlds alone, of which all meet the same ones first."""
        return float(np.mean(self.worth[:JUDGED]))


class Hardening:
    """A race of the throws that a nominal search found, then CMA-ES about the best, all in common worlds.

    Parameters
    ----------
    thrower : Thrower
    peg : Peg
    genes : dict of int to Genes
        Of each side, as the nominal search has them.
    uncertainty : Uncertainty
    left : function, optional
        Returns the time that is left, s: without any no second heat is begun, nor a generation that takes more.
    seed : int
    threads : int, optional

    Notes
    -----
    All throws of a heat or a generation meet the same worlds, so that luck does not choose among them. Each generation
    has fresh worlds, since what is fitted to a fixed few does not hold in others; a generation's best replaces the
    champion only if it beats it in the JUDGED worlds that all challengers meet, and then with as many fresh ones added:
    of many challengers one would win in the same worlds by luck.
    """

    def __init__(
        self,
        thrower: Thrower,
        peg: Peg,
        genes: dict[int, Genes],
        uncertainty: Uncertainty,
        *,
        left: Callable[[], float] = lambda: math.inf,
        seed: int = 0,
        threads: int | None = None,
    ) -> None:
        self.thrower, self.peg, self.genes, self.uncertainty = thrower, peg, genes, uncertainty
        self.left, self.seed, self.threads = left, seed, threads
        self.worlds = uncertainty.draws(max(sum(HEATS), JUDGED), thrower, peg, seed=[RACE, seed])
        self.order: list[Runner] = []  # best first
        self.runs = self.generations = 0
        self._evolution: Any = None
        self._took = 0.0  # s, of the last generation

    @property
    def champion(self) -> Runner:
        """The best until now."""
        return self.order[0]

    def go(self, report: Callable[[], None] | None = None) -> None:
        """Refine until the time is over or the champion wins every time."""
        while self.order and (left := self.left()) > self._took and not self.sure():
            self.refine()
            self._took = max(0.0, left - self.left()) if left < math.inf else 0.0
            if report is not None:
                report()

    def drop(self, some: Collection[Runner]) -> None:
        """Take throws out: what is refined next is the best of those left."""
        if any(one in some for one in self.order):
            self.order = [one for one in self.order if one not in some]
            self._evolution = None

    def best(self, count: int) -> list[Runner]:
        """Return the champion and others, `count` at most, of other swings first; all have met the common worlds."""
        some: list[Runner] = []
        for one in self.order:
            if not any(same_swing(one.landing, other.landing) for other in some):
                some.append(one)
        some = [*some[:count], *(one for one in self.order if one not in some)][:count]
        self.judge(some)
        return some

    def judge(self, some: Sequence[Runner]) -> None:
        """Let each meet the common worlds that it has not met yet."""
        for one in some:
            self.meet([one], self.worlds[len(one.worth) : JUDGED])

    def sure(self) -> bool:
        """Whether the champion has won in all the worlds that it has met."""
        return len(self.champion.wins) >= JUDGED and all(self.champion.wins)

    def race(self, found: Sequence[Landing], seeded: Sequence[Landing] = ()) -> None:
        """Let throws run in heats, those that are `seeded` among them; the better half of each goes on."""
        runners = [Runner(landing) for landing in _apart(found, seeded)]
        met = 0
        for worlds in HEATS:
            if met and self.left() <= 0.0:
                break
            self.meet(runners, self.worlds[met : met + worlds])
            met += worlds
            runners.sort(key=lambda one: -one.mean)
            self.order = runners + self.order
            runners = runners[: max(1, len(runners) // 2)]
        self.order = [*runners, *(one for one in dict.fromkeys(self.order) if one not in runners)]

    def refine(self) -> None:
        """One generation about the champion, in fresh worlds; its best may take the champion's place."""
        side = self.champion.landing.side
        if self._evolution is None:
            random = np.random.default_rng([EVOLVE, self.seed, self.generations])
            spreads = self.genes[side].spreads()
            self._evolution = evolution(self.champion.landing.x, NARROW, spreads, MEMBERS, random)
        points = self._evolution.ask()
        fresh = self.uncertainty.draws(WORLDS, self.thrower, self.peg, seed=[REFINE, self.seed, self.generations])
        runners = [Runner(one) for one in self.landings(side, [np.asarray(x) for x in points])]
        self.meet(runners, fresh)
        self._evolution.tell(points, [-one.mean for one in runners])
        self.generations += 1
        best = max(runners, key=lambda one: one.mean)
        challenger = Runner(best.landing)
        missing = len(self.champion.wins)
        self.meet([challenger], self.worlds[:JUDGED])
        if missing < JUDGED:
            self.meet([self.champion], self.worlds[missing:JUDGED])
        champion = self.champion
        if challenger.mean <= float(np.mean(champion.worth[:JUDGED])):
            return
        again = self.uncertainty.draws(JUDGED, self.thrower, self.peg, seed=[CONFIRM, self.seed, self.generations])
        self.meet([challenger, champion], again)
        if challenger.mean > float(np.mean(champion.worth[:JUDGED] + champion.worth[-JUDGED:])):
            self.order.insert(0, challenger)

    def landings(self, side: int, points: list[Array]) -> list[Landing]:
        """Return points as throws that are cut where they should strike."""
        throws = [self.genes[side].throw(x) for x in points]
        times = flights.strike(self.thrower, self.peg, throws, threads=self.threads)
        self.runs += len(points)
        cut = [
            throw if np.isnan(t) else throw.cut(float(t), self.thrower.limits)
            for throw, t in zip(throws, times, strict=True)
        ]
        return [Landing(0.0, 0.0, side, x, throw) for x, throw in zip(points, cut, strict=True)]

    def meet(self, runners: Sequence[Runner], worlds: Sequence[Draw]) -> None:
        """Let each runner meet each world."""
        if not (runners and worlds):
            return
        pairs: list[tuple[Throw, Draw]] = [(one.landing.throw, world) for one in runners for world in worlds]
        found = flights.ends(
            flights.from_rest(self.thrower, pairs), self.thrower.arm, self.thrower.time, threads=self.threads
        )
        self.runs += 2 * len(pairs)
        won = (found.turns >= WOUND).reshape(len(runners), -1)
        values = worth(found).reshape(won.shape)
        for one, wins, worths in zip(runners, won, values, strict=True):
            one.wins += wins.tolist()
            one.worth += worths.tolist()


def worth(found: Landings) -> Array:
    """Return what landings (M,) are worth: a win one, and a little for a better score."""
    return np.asarray((found.turns >= WOUND) + SHADE * np.clip(found.score / BEST, -1.0, 1.0))


def _apart(found: Sequence[Landing], seeded: Sequence[Landing] = ()) -> list[Landing]:
    """Return throws that differ: those seeded, the best that wind, EACH of a swing, then more of these, then others."""
    chosen: list[Landing] = list(seeded)
    more: list[Landing] = []
    others: list[Landing] = []
    for one in sorted(found, key=lambda one: (one.turns < WOUND, -one.score)):
        crowded = sum(same_swing(one, other) for other in chosen) >= EACH
        among = others if one.turns < WOUND else more if crowded else chosen
        if len(among) < POOL and not any(_alike(one, other) for other in chosen + more + others):
            among.append(one)
    return (chosen + more + others)[:POOL]


def _alike(one: Landing, other: Landing) -> bool:
    return one.side == other.side and bool(np.abs(one.x - other.x).max() <= ALIKE)
