"""The planner of casts: rounds of free swings, then of throws in contact; the best candidates are verified."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from hyperflex.model import DEFAULT_CONTACT_STEP
from hyperflex.planning.feasibility import SWING, Feasibility, check_feasibility
from hyperflex.planning.outcome import CastOutcome, require_holding_force, verify_cast
from hyperflex.planning.problem import Problem
from hyperflex.planning.search.candidates import Candidate, distinct, same_swing
from hyperflex.planning.search.contact_phase import SLIP_COST
from hyperflex.planning.search.strikes import HANGING_TAIL, MAX_TAIL
from hyperflex.planning.search.throw_search import SOUND, ThrowSearch
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.wind.cast_plan import CastPlan
from hyperflex.planning.wind.verified import (
    SPARE_TURNS,
    Asked,
    Verified,
    both,
    covers,
    failure,
    foreseen,
    may_fall,
    promise,
    rank,
    succeeds,
    with_margin,
    worst_of,
)
from hyperflex.simulation import Deadline

GENERATIONS, BY_TURNS = 5, 3  # of free swings in a round by CMA-ES, which is every third one: beam search finds more
MIN_GROWTH, IDLE_ROUNDS = 1.03, 2  # a round that gains less than this factor is idle; after so many contact is next
WORTHY = 0.5  # energy ratio of swings that are worth a try, relative to the feasibility check's where that is below 1
MIN_TAIL = 0.5  # turns of tail, at least, that a swing is taken to have for that
NEARLY = 0.9  # score of a throw in contact that is worth being refined though all swings strike late
# Fraction of the time until which throws without a margin are not verified to the end, nor others without so many turns
# and so much score to spare: of throws with these 37 of 46 held when verified, of others 13 of 33
EARLY, SPARE_SCORE = 0.05, 0.25
FOLDING = 0.5  # fraction of the time until which throws that slip are not verified, nor ropes folded flat simulated on
# Fraction of the time, s at least, after which a search without a plan begins anew: five that found none in 40 s took
# 7 to 16 with other random numbers. Both grow with the square of the time until the strike; else 2, not 4, of 6 stood
ANEW, SHORT = 0.15, 5.0
FREE = 0.2  # fraction of the time in which late swings are not tried in contact before they are worth it
SWINGING = 0.5  # fraction of the time after which the search goes on in contact in any case
RESTART = 12  # generations in contact from one candidate
LEAST = 1.0  # score of throws that wind and are worth a verification: less have those that slip by more than 2 cm
ALIKE = 0.05  # points that differ by less are one
# Pieces of each link in verifications beside the first, without a margin, and for ropes that end on top of the peg. Of
# 283 plans with halves beside the first three failed a judge's run; thirds refute two of them, which had a margin
FINER = (3, 2, 5)
FINER_STEP = 4e-4  # s, contact step there, twice the usual one: of 20 casts the turns differ by 0.003 at most
SEARCHING = 0.85  # fraction of the time after which only verifications are begun
LONGEST = 0.25  # fraction of the time that a first verification may take, or half of what is left
LOOK = 1.0  # s; steps of a run between two looks at the clock may take as long on a busy machine
TRIES = 3  # looks at new candidates at most between two generations
# A margin, and a full turn of contact that nobody asked for, are sought until so many times the time of the first plan.
# All 45 plans for targets of two ropes that stood with 1.5 were confirmed by a judge, with a margin or without
BETTER = 1.25
FULL_TURN = 2.0 * np.pi  # rad of contact that a search goes on for where the rope is long enough, if none is asked for
STANDS = "a cast stands; one with a margin is sought"


class CastPlanner:
    """Rounds of a search until a plan succeeds with a margin or the `time_budget` of the nominal search, s, is over.

    `full_turn`: whether a margin includes contact of a full turn where the rope is long enough. `enough`: time spent,
    s, after which a plan without a margin ends the search, too; BETTER times that of the first by default. `clock`
    tells the time spent, from now on by default. `more` is by how much scores must be higher for the turns asked.
    """

    def __init__(
        self,
        search: ThrowSearch,
        time_budget: float,
        *,
        full_turn: bool = True,
        enough: float | None = None,
        clock: Clock | None = None,
    ) -> None:
        self.search, self.time_budget, self.clock, self.enough = search, time_budget, clock or Clock(), enough
        search.left = lambda: min(SEARCHING * time_budget, self.until) - self.spent
        problem = search.problem
        self.finer = [problem.cut(k) for k in FINER]
        self.rounds, self.verifying, self.more = 0, 1.0, problem.more_turns
        asked = problem, replace(problem, contact=FULL_TURN)
        known, full = (check_feasibility(each, search.peg) for each in asked)
        self.asked = Asked(problem.turns, FULL_TURN * (full_turn and full.available_turns >= full.needed_turns))
        tail = float(np.clip(known.available_turns - HANGING_TAIL, MIN_TAIL, MAX_TAIL + self.more))
        self.worthy = WORTHY * tail * float(np.clip(known.energy_ratio, SWING.energy_ratio, 1.0))
        self.checked: list[Candidate] = []
        self.waiting: list[tuple[Verified, Candidate]] = []  # that succeed in two verifications without a margin
        self.verified: list[Verified] = []
        self.best: Verified = (None, None, None)
        self.first, self.ended = np.inf, False  # time spent until a plan stood, s; whether who hears of plans ended it
        self.hear: Callable[[], bool | None] | None = None  # called when a plan stands, and when a better one does

    @property
    def spent(self) -> float:
        """Time spent without compiling, s."""
        return self.clock.spent

    @property
    def until(self) -> float:
        """Time spent, s, after which a plan that stands is not improved any more."""
        return BETTER * self.first if self.enough is None else max(self.first, self.enough)

    def left(self) -> float:
        """Return the time that is left for verifications, s, less what lies between two looks at it."""
        most = self.verifying * self.time_budget - min(LOOK, 0.05 * self.time_budget)
        return min(most, self.until) - self.spent

    def run(self, report: Callable[..., None] | None) -> None:
        """Search until a plan succeeds with a margin or the time is over; `report` gets the time spent and words."""
        score, idle, contact, begun, problem = 0.0, 0, 0, self.spent, self.search.problem
        each = max(ANEW * self.time_budget, SHORT) * max(1.0, problem.time / replace(problem, time=0.0).time) ** 2
        if self.search.candidates:
            self.verify_new()
        while not (self.late or self.done()):
            if not (self.stands or self.waiting) and begun + each < self.spent < SEARCHING * self.time_budget - each:
                self.search.begin_anew()
                score, idle, contact, begun, self.rounds = 0.0, 0, 0, self.spent, 0
            self.search.allow_folding(not self.stands and self.spent > FOLDING * self.time_budget)
            late = contact > 0 and self.search.late
            settled = idle >= IDLE_ROUNDS * (2 if late and score < self.worthy else 1)
            refine = contact % RESTART > 0 and self.worth_refining(late)
            if refine and (settled or self.spent > SWINGING * self.time_budget):
                self.search.evolve_throws()
                contact += 1
            else:
                before, score = score, self.swing()
                idle = idle + 1 if 0.0 < score < MIN_GROWTH * before + 0.01 else 0
                if self.contact_due(score, settled):
                    self.try_worthy()
                self.search.restart()
                contact = 1
            self.verify_new()
            if report is not None:
                report(min(self.spent, self.time_budget), STANDS if self.stands else "planning")
        self.search.remember()
        self.verify_best()

    @property
    def stands(self) -> bool:
        """Whether a plan succeeds."""
        return succeeds(self.best)

    @property
    def early(self) -> bool:
        """Whether throws without a margin wait."""
        return self.spent <= EARLY * self.time_budget

    def try_worthy(self) -> None:
        """Try the best swings in contact, and others that are worth it until a plan stands; then with other moves."""
        self.search.try_last_moves()
        for _ in range(TRIES - 1):
            self.verify_new()
            if self.stands or self.late or not self.search.untried(self.worthy):
                break
            self.search.try_last_moves()
        if not (self.stands or self.late or self.search.winds):
            self.search.try_last_moves(fresh=False)

    @property
    def late(self) -> bool:
        """Whether only verifications are begun."""
        return self.spent > SEARCHING * self.time_budget

    def contact_due(self, score: float, settled: bool) -> bool:
        """Whether the best swings are to be tried in contact now."""
        if self.late:
            return not self.search.candidates
        return score >= self.worthy or settled or not self.search.late or self.spent > FREE * self.time_budget

    def worth_refining(self, late: bool) -> bool:
        """Whether a candidate is worth being refined: better swings help more if all strike late."""
        candidates = self.search.candidates
        return bool(candidates) and (not late or candidates[0].score >= NEARLY + self.more)

    def swing(self) -> float:
        """Make a round of free swings, one in BY_TURNS by CMA-ES, others by beam search; return the best score so far.

        A beam search that has found swings worth a try is gone on with in the next round.
        """
        if self.search.climbing or (self.rounds + 1) % BY_TURNS:
            score = self.search.beam_search(self.worthy)
            self.rounds += not self.search.climbing
            return score
        self.rounds += 1
        return max((self.search.evolve_swings() for _ in range(GENERATIONS) if not self.late), default=0.0)

    def done(self) -> bool:
        """Whether a plan succeeds with a margin, and covers a full turn where the rope is long enough.

        Such a full turn is sought until BETTER times the time of the first plan, a margin until `until`.
        """
        long = self.spent > BETTER * self.first
        good = with_margin(self.best, self.asked) and (long or covers(self.best, self.asked))
        return self.ended or self.spent > self.until or good

    def verify_new(self) -> None:
        """Verify the best candidates that were not verified yet, twice each; then the best that has no margin."""
        for _ in range(TRIES):
            if self.done() or (self.late and self.best[0] is not None):
                return
            self.search.confirm()
            if not (some := self.fresh()):
                break
            self.look(some)
            if not self.stands:
                self.verify_waiting()
        if self.stands:
            known = rank(self.best, self.asked)[:-1]
            self.waiting = [each for each in self.waiting if promise(each[0], self.asked)[:-1] > known]
        self.verify_waiting()

    def verify_waiting(self) -> None:
        """Verify the best throw that has no margin with shorter links, unless it is early."""
        if self.waiting and not (self.early or self.done()):
            seen, one = self.waiting.pop(0)
            self.check([one], [seen])

    def look(self, some: Sequence[Candidate]) -> None:
        """Verify candidates twice, all at once; those that succeed without a margin wait for more verifications."""
        self.checked += some
        with ThreadPoolExecutor(max(1, len(some))) as pool:
            seen = list(pool.map(self.verify_twice, some))
        for one, (first, second) in zip(some, seen, strict=True):
            found = one.throw, first, second
            if first.success and (second is None or second.success) and not with_margin(found, self.asked):
                self.waiting.append((found, one))
            else:
                self.verified.append(found)
                if not self.ended:
                    self.take([one], [found])
        self.waiting.sort(key=lambda each: promise(each[0], self.asked), reverse=True)

    def verify_best(self) -> None:
        """Verify the best throw without a margin if no plan stands, or the best candidate if none was verified."""
        if self.waiting and not self.stands:
            seen, one = self.waiting.pop(0)
            self.check([one], [seen])
        if self.best[0] is None and self.search.candidates:
            self.check(self.search.candidates[:1])

    def fresh(self) -> list[Candidate]:
        """Return confirmed candidates that wind, unlike those verified and each other; early on none that barely do."""
        last = not self.stands and self.spent > FOLDING * self.time_budget
        least, score = max(self.asked.turns, self.search.problem.contact / FULL_TURN), LEAST if last else SOUND
        if self.early and self.search.swings:  # not where given throws are tried before any swing
            least, score = least + SPARE_TURNS, SOUND + SPARE_SCORE
        some, score = self.search.candidates, score + self.more
        winding = (one for one in some if one.confirmed and one.turns >= least and one.score >= score)
        return distinct(winding, self.checked, max(1, self.search.workers // 2), ALIKE)

    def keep(self, one: Candidate, found: Verified) -> bool:
        """Take a verified candidate as the best if it is; correct its score if it fails. Whether it is the best."""
        worse = found[2] or found[1]
        if worse is not None and not worse.success:
            self.search.correct(one, abs(worse.turns), abs(worse.turns) - SLIP_COST)
            self.waiting.sort(key=lambda each: same_swing(each[1], one))  # those of the same swing last
        if best := self.best[0] is None or rank(found, self.asked) > rank(self.best, self.asked):
            self.best = found
        return best

    def check(self, some: Sequence[Candidate], seen: Sequence[Verified] = ()) -> None:
        """Verify candidates, keep the best, and correct the scores of those that fail; `seen` are those seen twice."""
        self.take(some, self.outcomes(some, seen))

    def take(self, some: Sequence[Candidate], found: Sequence[Verified]) -> None:
        """Keep the best of verified candidates, and tell it if it stands; correct the scores of those that fail."""
        better = [self.keep(*each) for each in zip(some, found, strict=True)]
        if any(better):
            self.tell()

    def tell(self) -> None:
        """Tell the best plan, if it stands."""
        if self.stands:
            self.first = min(self.first, self.spent)
            self.ended = self.ended or (self.hear is not None and bool(self.hear()))

    def outcomes(self, some: Sequence[Candidate], seen: Sequence[Verified] = ()) -> list[Verified]:
        """Verify candidates, as many at once as there are threads for."""
        self.checked += [one for one in some if not any(one is other for other in self.checked)]
        with ThreadPoolExecutor(max(1, min(len(some), self.search.workers // 2))) as pool:
            ended = pool.map(self.verify, some, *([seen] if seen else []))
            found: list[Verified] = [(one.throw, *each) for one, each in zip(some, ended, strict=True)]
        self.verified += found
        return found

    def verify(self, one: Candidate, seen: Verified | None = None) -> tuple[CastOutcome, CastOutcome | None]:
        """Verify a throw on the rope as given and with links of a third; without a margin of half the length, too.

        `seen` are the first two outcomes if these are known; the last run is made beside the third where both are
        needed. Of those with shorter links the one that fails is returned, or the one whose turns differ most:
        unpredictable throws differ with the length of the links.
        """
        first, second = seen[1:] if seen else self.verify_twice(one)
        if first is None or second is None or not second.success or with_margin((None, first, second), self.asked):
            return first, second  # type: ignore[return-value] # there is a first one

        def third() -> CastOutcome:
            return foreseen(first, self.run_once(self.finer[1], one, self.left, FINER_STEP))

        alone = may_fall(self.asked, first, second)  # if not, the last one is needed where the third succeeds
        found, last = (third(), None) if alone else self.beside(third, self.finer[2], one)
        finer = [second, found]
        worst = worst_of(first, finer)
        if worst.success and not may_fall(self.asked, first, *finer):
            last = foreseen(first, last or self.run_once(self.finer[2], one, self.left, FINER_STEP))
            worst = worst_of(first, [worst, last]) if last.success else last
        return first, worst

    def verify_twice(self, one: Candidate) -> tuple[CastOutcome, CastOutcome | None]:
        """Verify a throw on the rope as given and, beside that, with links of a third unless that fails."""
        until = self.spent + max(LONGEST * self.time_budget, 0.5 * self.left())
        given = self.search.problem, one, lambda: min(until - self.spent, self.left()), DEFAULT_CONTACT_STEP
        first, second = self.beside(partial(self.run_once, *given), self.finer[0], one)
        return first, foreseen(first, second) if first.success else None

    def beside(self, begin: Callable[[], CastOutcome], cut: Problem, one: Candidate) -> tuple[CastOutcome, CastOutcome]:
        """Verify a throw, and beside that with links cut, which ends where the first run fails."""

        def other(failed: Callable[[], bool]) -> CastOutcome:
            return self.run_once(cut, one, lambda: -1.0 if failed() else self.left(), FINER_STEP)

        return both(begin, other, self.search.workers)

    def run_once(self, problem: Problem, one: Candidate, left: Callable[[], float], step: float) -> CastOutcome:
        """Simulate a throw on a rope with a contact `step`, s, and a tug at its end, in the time that is `left`, s."""
        peg, budget, motion = self.search.peg, Deadline(np.inf, left), one.throw.motion(problem.limits)
        outcome = verify_cast(problem, peg, motion, contact_step=step, time_budget=budget)
        return require_holding_force(outcome, peg, self.search.holding_force, budget)

    def plan(self, known: Feasibility, interrupted: bool = False) -> CastPlan:
        """Return the plan so far; if nothing was verified, with the best candidate. `interrupted`: by Ctrl-C."""
        search, (throw, outcome, finer) = self.search, self.best
        throw = search.candidates[0].throw if throw is None and search.candidates else throw
        message = failure(outcome, finer, interrupted)
        if outcome is None and not (search.runs or interrupted):
            message = "the time budget was over before the search began"
        found = (throw, outcome, finer, message, search.runs, self.spent, interrupted)
        return CastPlan(search.problem, search.peg, known, *found)
