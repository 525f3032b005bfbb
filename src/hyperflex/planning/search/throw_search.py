"""The search for a throw: first over free swings with promising strikes, then over the last moves in contact."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Peg
from hyperflex.planning.problem import MIN_TURNS, Problem
from hyperflex.planning.search import contact_phase, strikes
from hyperflex.planning.search.beam import FINER, FULL, SIZES, BeamSearch, Strike
from hyperflex.planning.search.candidates import Candidate, Swing, corrected, distinct, same_swing, unconfirmed
from hyperflex.planning.search.evolution import CmaEs
from hyperflex.planning.search.known_strikes import KnownStrikes, strokes_of
from hyperflex.planning.search.rollouts import RolloutBatch, usable_threads
from hyperflex.planning.throw import LAST, MOVES, Throw, ThrowParametrization
from hyperflex.simulation import Deadline

MEMBERS, CONTACT_MEMBERS = 32, 16  # of a generation of free swings, and of one in contact
KEPT = 4  # swings of a generation that may be tried in contact
TRIED = 8  # swings that are tried in contact at once
SOUND = MIN_TURNS  # score of throws of so many turns that neither slip nor are folded flat on the way
AFTER = (0.5, 2.5)  # strokes still made after the strike by given throws
UNTIL = 2.0 * strikes.SAMPLE_TIME  # s after a strike, until which the arm rests that rested before it
LATE = 0.5  # fraction of the time allowed
LATER = 1.0  # s after a known strike, until which the same swing with other links, or a varied one, is to strike
CONFIRMED = 12  # swings at once that are simulated with shorter links too, and then kept
# Where after so many tries no throw winds, pieces of each link in contact: coarse links miss some about a small peg, or
# when slack
MAX_FAILED, PIECES = 3, 2
REMEMBERED = 16  # best candidates of a search that are taken back after others
NARROW = 0.25  # step size of CMA-ES in contact, relative to that of free swings


@dataclass(eq=False)
class ThrowSearch:
    """A search for throws: over free swings by beam search and by CMA-ES, then by CMA-ES in contact with the peg.

    Swings and candidates are kept best first; `runs` counts the simulated runs. `holding_force`, N, is the pull that
    the wound rope must withstand; it is used where the candidates are verified. `left` returns the time that is left
    for the search, s; None for no limit. `threads` is one a processor by default. `folding`: whether ropes that are
    folded flat are simulated on in contact.
    """

    problem: Problem
    peg: Peg
    seed: int = 0
    threads: int | None = None
    holding_force: float = 0.0
    swings: list[Swing] = field(default_factory=list, init=False)
    candidates: list[Candidate] = field(default_factory=list, init=False)
    runs: int = field(default=0, init=False)
    left: Callable[[], float] | None = field(default=None, init=False)
    folding: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        sides = contact_phase.free_sides(self.problem, self.problem.beside(self.peg))
        self.parametrizations = {side: ThrowParametrization(self.problem, side) for side in sides}
        self._known = KnownStrikes(self.problem.cut(FINER), self.peg)
        self._in_contact = self.problem  # its links are those of runs in contact
        self._forgotten: list[Candidate] = []
        self.begin_anew()

    def begin_anew(self) -> None:
        """Forget swings and candidates, and search on with other random numbers."""
        self._forgotten += self.candidates[:REMEMBERED]
        self.swings, self.candidates = [], []
        self._beam: BeamSearch | None = None
        self._restarts = 0  # of the beam search
        self._free: dict[int, Any] = {}  # made when it is needed: to import it takes seconds
        self._contact: tuple[int, Any, float] | None = None
        self._failed_tries = 0  # tries of last moves while no throw winds
        self._try_again()

    def _try_again(self) -> None:
        self._tried: list[Swing] = []  # in contact
        self._made: list[int] = []  # how many of the MOVES each of them was tried with
        self._centres: list[Candidate] = []  # from which evolutions in contact began

    def remember(self) -> None:
        """Take back the best candidates that were forgotten."""
        self.candidates = sorted([*self.candidates, *self._forgotten], key=lambda one: -one.score)
        self._forgotten = []

    def allow_folding(self, allow: bool) -> None:
        """Whether ropes folded flat are simulated on in contact; where that is new all swings are tried again."""
        if allow and not self.folding:
            self._try_again()
        self.folding = allow

    def _cma_es(self, centre: Array, size: float, members: int, side: int) -> Any:
        return CmaEs(centre, size, self.parametrizations[side].spreads(), members, self._random)

    @property
    def workers(self) -> int:
        """Number of threads."""
        return usable_threads(self.threads)

    @property
    def climbing(self) -> bool:
        """Whether the last beam search can be continued."""
        most = max(each.strokes for each in self.parametrizations.values())
        return self._beam is not None and self._beam.ready(self.problem.time, most)

    def beam_search(self, enough: float = np.inf) -> float:
        """Search free swings stroke by stroke; continues the last beam search if it can be, else begins again.

        It ends where some swings score `enough`. The first one makes full strokes alone, as every second one after it
        does; where none of its swings scores that, the next one follows at once. Returns the best score so far.
        """
        contact_phase.check_sides(self.parametrizations, self.peg)
        time, most = self.problem.time, max(each.strokes for each in self.parametrizations.values())
        first = self._beam is None
        if self._beam is None:
            sides = list(self.parametrizations)
            self._beam = BeamSearch(self.problem, self.peg, sides, self._random, self.threads, FULL)
        elif not self.climbing:
            self._beam.restart((FULL, SIZES)[self._restarts % 2])
            self._restarts += 1
        before = self._beam.runs
        found = self._beam.extend(time, most, self.left, enough)
        self.runs += self._beam.runs - before

        def swing(one: Strike) -> Swing:
            throws = self.parametrizations[one.side]
            rest = max(throws.rest, one.after + UNTIL)
            return Swing(one.score, one.side, throws.point(one.strokes, one.rests, rest), one.t)

        best = self._keep(list(map(swing, found)))
        return self.beam_search(enough) if first and best < enough and not self.climbing else best

    def _keep(self, found: list[Swing]) -> float:
        """Keep the best distinct swings, with the lower of their scores with these and with shorter links.

        Returns the best score so far.
        """
        some = distinct(sorted(found, key=lambda one: -one.score), self.swings, CONFIRMED)
        if some:
            throws = [
                self.parametrizations[one.side].throw(one.x).cut(self.problem.time, self.problem.limits) for one in some
            ]
            again = self._strikes(self._known.finer, throws, until=max(one.t for one in some) + LATER)
            self.runs += len(some)
            for k, one in enumerate(some):
                t = float(again.t[k])
                if np.isfinite(t):
                    self._known.add(one.side, one.x, again.select([k]))
                    one = one._replace(t=t)
                self.swings.append(one._replace(score=min(one.score, float(again.score[k]))))
            self.swings.sort(key=lambda one: -one.score)
        return self.swings[0].score if self.swings else strikes.NEVER

    def _strikes(
        self, problem: Problem, throws: list[Throw], threads: int | None = None, until: float = np.inf
    ) -> strikes.Strikes:
        motions = [throw.motion(problem.limits) for throw in throws]
        budget = None if self.left is None else Deadline(np.inf, self.left)
        given: dict[str, Any] = {"time_budget": budget, "threads": threads or self.threads, "until": until}
        return strikes.simulate_strikes(problem, self.peg, motions, **given)

    def evolve_swings(self) -> float:
        """Simulate one generation of free swings from each side; return the best score so far."""
        contact_phase.check_sides(self.parametrizations, self.peg)
        for side in self.parametrizations.keys() - self._free.keys():
            self._free[side] = self._cma_es(self.parametrizations[side].centre(), 1.0, MEMBERS, side)
        asked = {side: optimizer.ask() for side, optimizer in self._free.items()}
        each = max(1, self.workers // len(asked))

        def simulated(side: int) -> strikes.Strikes:
            return self._strikes(self.problem, [self.parametrizations[side].throw(x) for x in asked[side]], each)

        with ThreadPoolExecutor(len(asked)) as pool:
            found = dict(zip(asked, pool.map(simulated, asked), strict=True))
        kept: list[Swing] = []
        for side, struck in found.items():
            points = asked[side]
            self._free[side].tell(points, list(-struck.score))
            self.runs += len(points)
            best = [k for k in np.argsort(-struck.score)[:KEPT] if struck.score[k] > 0.0]
            kept += [Swing(float(struck.score[k]), side, np.asarray(points[k]), float(struck.t[k])) for k in best]
        return self._keep(kept)

    @property
    def late(self) -> bool:
        """Whether the best swings strike late in the time allowed, or none strikes."""
        times = [one.t for one in self.swings[:KEPT]]
        return not times or float(np.median(times)) > LATE * self.problem.time

    @property
    def winds(self) -> bool:
        """Whether a throw in contact winds."""
        return any(one.turns >= self.problem.turns for one in self.candidates)

    def untried(self, score: float) -> bool:
        """Whether a swing of such a score was not tried in contact yet."""
        return bool(self._fresh(score, 1))

    def _fresh(self, score: float, count: int) -> list[Swing]:
        """Return the best swings that were not tried in contact yet, `count` at most, of at least such a score."""
        return distinct((one for one in self.swings if one.score >= score), self._tried, count)

    def try_last_moves(self, *, fresh: bool = True) -> None:
        """Simulate swings in contact with last moves: the best ones that were not tried yet, with the first of MOVES.

        Where there are none, or without `fresh` ones, those tried with the fewest moves get the next ones. After
        MAX_FAILED tries in which no throw winds all are tried again with shorter links.
        """
        self._failed_tries += bool(self.candidates) and not self.winds
        if self._failed_tries == MAX_FAILED and self._in_contact is self.problem:
            self._in_contact = self.problem.cut(PIECES)
            self._try_again()
        some = self._fresh(0.0, TRIED) if fresh else []
        self._tried += some
        self._made += [0] * len(some)
        least = min(self._made, default=len(MOVES))
        if least == len(MOVES):
            return
        rows = [k for k, made in enumerate(self._made) if made == least]
        rows = sorted(rows, key=lambda k: -self._tried[k].score)[:TRIED]
        towards = 1.0 if self.peg.x >= self.problem.arm.pivot[0] else -1.0
        points = [
            (self._tried[k].side, np.append(self._tried[k].x[:-LAST], [more, towards * end, rest, 1.0]))
            for k in rows
            for more, end, rest in MOVES[least]
        ]
        self.evaluate(points, max(self._tried[k].t for k in rows) + LATER)
        for k in rows:
            self._made[k] += 1

    def try_throws(self, throws: Sequence[Throw]) -> None:
        """Simulate given throws in contact: their strokes until they strike, and then some more of them."""
        points = [
            (side, np.append(each.repeated(one)[:-LAST], [more, one.end / np.pi, 0.0, one.speed]))
            for side, each in self.parametrizations.items()
            for one in throws
            if one.side == side
            for more in AFTER
        ]
        if points:
            self.evaluate(points)

    def evolve_throws(self) -> None:
        """Simulate one generation of throws in contact, about the best candidate where this is not known to be vain."""
        if self._contact is None:
            best = self._unrefined()
            self._contact = best.side, self._cma_es(best.x, NARROW, CONTACT_MEMBERS, best.side), best.t + LATER
        side, optimizer, until = self._contact
        points = optimizer.ask()
        optimizer.tell(points, list(-self.evaluate([(side, x) for x in points], until)))

    def _unrefined(self) -> Candidate:
        """Return the best candidate that winds or whose swing no evolution began from; after all from the best on."""
        for one in self.candidates:
            if one.turns >= self.problem.turns or not any(same_swing(one, other) for other in self._centres):
                break
        else:
            one, self._centres = self.candidates[0], []
        self._centres.append(one)
        return one

    def restart(self) -> None:
        """Let the next :meth:`evolve_throws` begin anew, from another candidate where none winds."""
        self._contact = None

    def confirm(self) -> None:
        """Simulate the best throws that wind with shorter links, until the best one winds with these too."""
        while (self.left is None or self.left() > 0.0) and (some := unconfirmed(self.candidates, self.problem.turns)):
            throws = [one.throw for one in some]
            known = [self._known.find(one.side, one.x, one.t) for one in some]
            new = [k for k, each in enumerate(known) if each is None]
            if new:
                seen = self._strikes(self._known.finer, [throws[k] for k in new])
                known = [seen.select([new.index(k)]) if each is None else each for k, each in enumerate(known)]
            found = strikes.joined([each for each in known if each is not None])
            self.runs += len(new) + len(some)
            score, turns = np.full(len(some), strikes.NEVER), np.zeros(len(some))
            struck = np.flatnonzero(np.isfinite(found.t))
            if struck.size:
                again = self._wind(self._known.finer, [throws[k] for k in struck], found.select(struck.tolist()))
                score[struck], turns[struck] = again.score, again.turns
            for one, value, left in zip(some, score, turns, strict=True):
                self.correct(one, float(left), float(value))

    def correct(self, one: Candidate, turns: float, score: float) -> None:
        """Correct a candidate by a better run; if it does not wind then, restart from another one."""
        self.candidates = corrected(self.candidates, one, turns, score, self.problem.turns)
        if turns < self.problem.turns and any(one.x is each.x for each in self.candidates):
            self.restart()

    def evaluate(self, points: Sequence[tuple[int, Array]], until: float = np.inf) -> Array:
        """Simulate points (M), each after its side, in contact; keep those that strike as candidates; return scores.

        Strikes come `until` a time, s, at most.
        """
        throws = [self.parametrizations[side].throw(x) for side, x in points]
        found = self._first_strikes(points, throws, until)
        score = found.score.copy()
        struck = np.flatnonzero(np.isfinite(found.t))
        self.runs += len(points)
        if struck.size:
            cut = [throws[k].cut(float(found.t[k]), self.problem.limits) for k in struck]
            ended = self._wind(self._in_contact, cut, found.select(struck.tolist()))
            score[struck] = ended.score
            for k, throw, value, turns in zip(struck, cut, ended.score, ended.turns, strict=True):
                side, x = points[int(k)]
                self.candidates.append(
                    Candidate(float(value), float(turns), side, np.asarray(x), throw, t=float(found.t[k]))
                )
            self.candidates.sort(key=lambda one: -one.score)
        score[~np.isfinite(found.t)] = np.minimum(score[~np.isfinite(found.t)], 0.0)
        return score

    def _wind(self, problem: Problem, throws: list[Throw], struck: strikes.Strikes) -> contact_phase.WindingScores:
        """Simulate throws (M), which are already cut, in contact from their strikes."""
        motions = [throw.motion(problem.limits).shifted(-t) for throw, t in zip(throws, struck.t, strict=True)]
        count, budget = len(motions), contact_phase.run_budget(self.left, self.workers / len(motions))
        ropes, pegs, walls = [problem.rope] * count, [self.peg] * count, problem.obstacles
        batch = RolloutBatch(ropes, pegs, motions, struck.q, struck.qd, obstacles=walls, behind=problem.behind)
        given: dict[str, Any] = {"folding": self.folding, "time_budget": budget, "threads": self.threads}
        return contact_phase.simulate_contact(batch, struck.t, problem, sweeping=True, **given)

    def _first_strikes(self, points: Sequence[tuple[int, Array]], throws: list[Throw], until: float) -> strikes.Strikes:
        """Strikes of throws before their last moves, on the links of contact: known ones, others simulated once."""
        keys = [strokes_of(side, x) for side, x in points]
        found: dict[tuple[int, bytes], strikes.Strikes] = {}
        new: dict[tuple[int, bytes], Throw] = {}
        for key, (side, x), throw in zip(keys, points, throws, strict=True):
            if key not in found and key not in new:
                if (known := self._known.on_links(self._in_contact, side, x, throw)) is not None:
                    found[key] = known
                else:
                    new[key] = throw.cut(self.problem.time, self.problem.limits)
        if new:
            self.runs += len(new)
            seen = self._strikes(self._in_contact, list(new.values()), until=until)
            found |= {key: seen.select([k]) for k, key in enumerate(new)}
        return strikes.joined([found[key] for key in keys])
