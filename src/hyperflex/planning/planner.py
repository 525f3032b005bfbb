"""The course of a plan: rounds of swings, then of throws beside the peg; what looks good is verified."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from hyperflex.model import divided
from hyperflex.planning.robust.refinement import Hardening, Runner
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.search.candidates import Landing
from hyperflex.planning.search.contact_phase import SLIDING
from hyperflex.planning.search.search import Search
from hyperflex.planning.search.strikes import TURNS_ENOUGH, USED
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.wind.holding import bearing
from hyperflex.planning.wind.outcome import SLIP, WOUND, Cast, verify
from hyperflex.planning.wind.reachability import reach
from hyperflex.planning.wind.throw import Throw

GENERATIONS = 5  # of free swings in a round
SETTLED, ROUNDS = 1.03, 2  # a round that gains less than this factor is idle; so many idle ones, and the peg is next
PROMISING, WORTHY = 0.5, 0.8  # energy ratio of swings that need not take longer, and of those that are worth a try
LEAST_TAIL = 0.5  # turns of tail that a swing is taken to have for that, at least
NEARLY = 0.9  # score of a throw beside the peg that is worth being refined though all swings hurry
EARLY, LONGER = 0.1, 1.5  # part of the patience after which swings that promise less may take longer, and how much
FREE = 0.2  # part of the patience in which swings that hurry are not tried beside the peg before they are worth it
SWINGING = 0.5  # part of the patience after which the search goes on beside the peg in any case
RESTART = 12  # generations beside the peg from one place
ALIKE = 0.05  # points that differ by less are one
FINER = (2, 3)  # pieces of each link in the verifications after the first
NOMINAL = 0.5  # part of the patience that a search for a robust plan gives to the world that is expected
HARDENING = 0.8  # part of it after which that search only verifies
HAZARD = 0.3  # by which a throw with nothing in hand must be worth more than one with, to be the plan
SEARCHING = 0.85  # part of the patience after which nothing new is begun but verifications
LONGEST, LEAST_LONG = 0.25, 3.0  # part of the patience, and processor time, s, that a verification may take
TRIES = 3  # throws verified at most between two generations
STEADY = 0.4  # part of the slip allowed, beyond which a throw that holds is kept, but a better one sought
GRIP = 1.0  # part of what the rope can bear, of which the same is true
BOTH = 2  # verifications that succeed where a plan stands
ALIKE_TURNS = 0.5  # by which the turns of both verifications may differ: beyond, one of them winds once more

NONE = (False, False, 0.0)  # value of no throw
Verified = tuple[Throw | None, Cast | None, Cast | None]  # a throw as it is given, and on shorter links


class Course:
    """Rounds of a search until a plan stands or patience ends.

    Parameters
    ----------
    search : Search
    patience : float
        Of the search in the world that is expected, s.
    longer : bool
        Whether a cast may take LONGER times as long where swings that the search allows promise too little.
    """

    def __init__(self, search: Search, patience: float, *, longer: bool = False) -> None:
        self.search, self.patience, self.longer, self.clock = search, patience, longer, Clock()
        search.left = lambda: SEARCHING * patience - self.spent
        thrower = search.thrower
        self.finer = [replace(thrower, rope=divided(thrower.rope, k)) for k in FINER]
        self.rounds = 0
        self.tail = float(np.clip(reach(thrower, search.peg).room - USED, LEAST_TAIL, TURNS_ENOUGH))
        self.checked: list[Landing] = []
        self.seen: list[Verified] = []
        self.best: Verified = (None, None, None)

    @property
    def spent(self) -> float:
        """Time that counts as patience, s."""
        return self.clock.spent

    def go(self, report: Callable[[float], None] | None) -> None:
        """Search until a plan stands or patience ends."""
        score, idle, close = 0.0, 0, 0
        while not self.search.runs or (self.spent < SEARCHING * self.patience and not self.done()):
            hurried = close > 0 and self.search.hurried
            settled = idle >= ROUNDS * (2 if hurried and score < WORTHY * self.tail else 1)
            if (
                hurried
                and score < PROMISING * self.tail
                and self.longer
                and (settled or self.spent > EARLY * self.patience)
            ):
                self.lengthen()
                score, idle, close = 0.0, 0, 0
            elif close % RESTART and self.near(hurried) and (settled or self.spent > SWINGING * self.patience):
                self.search.refine()
                close += 1
            else:
                before, score = score, self.swing()
                idle = idle + 1 if 0.0 < score < SETTLED * before + 0.01 else 0
                if self.due(score, settled):
                    self.search.try_ends()
                self.search.restart()
                close = 1
            self.look()
            if report is not None:
                report(min(self.spent, self.patience))
        self.settle()

    def due(self, score: float, settled: bool) -> bool:
        """Whether the best swings are to be tried beside the peg now."""
        if self.spent > SEARCHING * self.patience:
            return not self.search.landings
        return score >= WORTHY * self.tail or settled or not self.search.hurried or self.spent > FREE * self.patience

    def near(self, hurried: bool) -> bool:
        """Whether a throw beside the peg is worth being refined: better swings help more where all are hurried."""
        landings = self.search.landings
        return bool(landings) and (not hurried or landings[0].score >= NEARLY)

    def lengthen(self) -> None:
        """Begin anew with swings that take longer."""
        self.longer, self.rounds = False, 0
        self.search.lengthen(LONGER)
        self.checked.clear()

    def swing(self) -> float:
        """A round of free swings, by turns stroke by stroke and in whole; returns the best score so far."""
        self.rounds += 1
        if self.rounds % 2:
            return self.search.climb()
        score = 0.0
        for _ in range(GENERATIONS):
            score = max(score, self.search.swing())
            if self.spent > SEARCHING * self.patience:
                break
        return score

    def done(self) -> bool:
        """Whether a plan stands, with something in hand."""
        return _secure(self.best)

    def look(self) -> None:
        """Verify the best throws that were not verified yet, as many at once as there are threads."""
        for _ in range(TRIES):
            if self.done() or (self.spent > SEARCHING * self.patience and self.best[0] is not None):
                return
            self.search.screen()
            found = self.fresh()
            if not found:
                return
            self.check(found)

    def settle(self) -> None:
        """Verify the best throw of all where none that winds was found."""
        if self.best[0] is None and self.search.landings:
            self.check(self.search.landings[:1])

    def harden(self, uncertainty: Uncertainty, report: Callable[[float], None] | None) -> None:
        """Look for the throw that wins in most worlds, for what patience is left; what is not secure is dropped."""
        self.patience /= NOMINAL
        search, known, some = self.search, dict[Runner, Verified](), list[Runner]()
        work = Hardening(
            search.thrower,
            search.peg,
            search.genes,
            uncertainty,
            left=lambda: HARDENING * self.patience - self.spent,
            seed=search.seed,
            threads=search.threads,
        )
        try:
            work.race(search.landings, [one for one in self.checked if one.throw is self.best[0]])
            seen = [found for found in self.seen if not _unfinished(found)]
            known |= {one: found for one in work.order for found in seen if found[0] is one.landing.throw}
            work.judge([one for one, found in known.items() if _stands(found)])
            while True:
                work.drop([one for one, found in known.items() if not _secure(found)])
                work.go(None if report is None else lambda: report(self.spent))
                if not work.order or work.champion in known or (some and self.spent > self.patience):
                    break
                if max((_value(*each) for each in known.items()), default=NONE) >= (True, True, work.champion.mean):
                    break
                some = [one for one in work.best(search.workers) if one not in known]
                for one, found in zip(some, self.outcomes([one.landing for one in some]), strict=True):
                    known[one] = found
        finally:
            search.runs += work.runs
            chosen = max(known, key=lambda one: _value(one, known[one]), default=None)
            if chosen is not None and (_stands(known[chosen]) or not _stands(self.best)):
                self.best = known[chosen]

    def fresh(self) -> list[Landing]:
        """Return throws that wind and are like none that was verified, nor like each other."""
        found: list[Landing] = []
        sure = (one for one in self.search.landings if one.firm and one.turns >= WOUND)
        for one in sure:
            if len(found) == self.search.workers:
                break
            if all(one.side != old.side or np.abs(one.x - old.x).max() > ALIKE for old in self.checked + found):
                found.append(one)
        return found

    def check(self, some: Sequence[Landing]) -> None:
        """Verify throws and keep one that is better than the best until now; what fails counts less in the search."""
        for found, (throw, cast, finer) in zip(some, self.outcomes(some), strict=True):
            worse = finer or cast
            if worse is not None and not worse.success:
                self.search.correct(found, abs(worse.turns), abs(worse.turns) - SLIDING)
            if self.best[0] is None or _rank(cast, finer) > _rank(*self.best[1:]):
                self.best = (throw, cast, finer)

    def outcomes(self, some: Sequence[Landing]) -> Iterator[Verified]:
        """Verify throws at once."""
        self.checked += some
        with ThreadPoolExecutor(max(1, len(some))) as pool:
            for one, found in zip(some, pool.map(self.verified, some), strict=True):
                self.seen.append((one.throw, *found))
                yield self.seen[-1]

    def verified(self, found: Landing) -> tuple[Cast, Cast | None]:
        """Verify a throw on the rope as it is given; then, if it winds and holds, with shorter and shorter links.

        Of these the one that fails is returned, or the one whose turns differ most. What is left to chance differs from
        one length of links to another, hardly from one step to another. The last may lack time: then the others tell.
        """
        thrower, peg = self.search.thrower, self.search.peg
        motion = found.throw.motion(thrower.limits)
        longest = min(LONGEST * self.patience, 0.5 * (self.patience - self.spent))
        cast = bearing(verify(thrower, peg, motion, patience=max(longest, LEAST_LONG)), peg, self.search.hold)
        if not cast.success:
            return cast, None
        worst: Cast | None = None
        for each in self.finer:
            finer = verify(each, peg, motion, patience=max(self.patience - self.spent, LEAST_LONG))
            if worst is not None and finer.run is None:
                break
            finer = bearing(finer, peg, self.search.hold)
            if not finer.success:
                return cast, finer
            if worst is None or abs(finer.turns - cast.turns) > abs(worst.turns - cast.turns):
                worst = finer
        return cast, worst


def steady(cast: Cast) -> bool:
    """Whether a rope that holds is far from slipping, and did not fold through itself on the way."""
    return cast.slipped <= STEADY * SLIP and cast.grip <= GRIP and not cast.folded


def _stands(found: Verified) -> bool:
    """Whether all verifications of a throw succeed."""
    return _rank(*found[1:])[0] == BOTH


def _secure(found: Verified) -> bool:
    """Whether a throw stands, with something in hand."""
    return _rank(*found[1:])[:3] == (BOTH, True, True)


def _unfinished(found: Verified) -> bool:
    """Whether a throw was not verified to its end for want of time."""
    return any(cast is not None and cast.run is None for cast in found[1:])


def _value(runner: Runner, found: Verified) -> tuple[bool, bool, float]:
    """What a throw that was raced is worth as a plan."""
    return _stands(found), not _unfinished(found), runner.judged - (0.0 if _secure(found) else HAZARD)


def _rank(cast: Cast | None, finer: Cast | None) -> tuple[int, bool, bool, float]:
    """Verifications that succeed, as many turns in both, something in hand; then the turns."""
    if cast is None or finer is None:
        return 0, False, False, 0.0 if cast is None else abs(cast.turns)
    alike = abs(cast.turns - finer.turns) < ALIKE_TURNS
    good = int(cast.success) + int(finer.success)
    return good, alike, steady(cast) and steady(finer), min(abs(cast.turns), abs(finer.turns))


def why_not(cast: Cast | None, finer: Cast | None, interrupted: bool) -> str:
    """Say why a cast fails, "" if it does not."""
    if cast is None:
        return "interrupted before any throw was verified" if interrupted else "no throw was found that strikes it"
    if cast.reason:
        return cast.reason
    if finer is None:
        return "interrupted before it was verified with shorter links"
    return f"with shorter links {finer.reason}" if finer.reason else ""
