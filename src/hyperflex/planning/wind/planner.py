"""The planner of casts: rounds of free swings, then of throws in contact; the best candidates are verified."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from hyperflex.model import divided
from hyperflex.planning.outcome import MAX_SLIP, MIN_TURNS, CastOutcome, require_holding_force, verify_cast
from hyperflex.planning.robust.refinement import RobustCandidate, RobustRefinement
from hyperflex.planning.robust.uncertainty import Uncertainty
from hyperflex.planning.search.candidates import Candidate, distinct
from hyperflex.planning.search.contact_phase import SLIP_COST
from hyperflex.planning.search.strikes import HANGING_TAIL, MAX_TAIL
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.throw import Throw
from hyperflex.planning.time_budget import Clock, OutOfTime
from hyperflex.planning.wind.cast_plan import CastPlan
from hyperflex.planning.wind.feasibility import Feasibility, check_feasibility
from hyperflex.simulation import Deadline

GENERATIONS = 5  # of free swings in a round
MIN_GROWTH, IDLE_ROUNDS = 1.03, 2  # a round that gains less than this factor is idle; after so many contact is next
PROMISING, WORTHY = 0.5, 0.8  # energy ratio of swings that need no more time, and of swings that are worth a try
MIN_TAIL = 0.5  # turns of tail, at least, that a swing is taken to have for that
NEARLY = 0.9  # score of a throw in contact that is worth being refined though all swings strike late
EARLY, LONGER = 0.1, 1.5  # fraction of the time after which swings that promise less may take longer; how much longer
FREE = 0.2  # fraction of the time in which late swings are not tried in contact before they are worth it
SWINGING = 0.5  # fraction of the time after which the search goes on in contact in any case
RESTART = 12  # generations in contact from one candidate
ALIKE = 0.05  # points that differ by less are one
FINER = (2, 3)  # pieces of each link in the verifications after the first
NOMINAL = 0.5  # fraction of the time of a robust plan for the search in the nominal scenario
# Fractions of it after which a robust plan is only verified, and after which its success probability is estimated
REFINING, VERIFYING = 0.7, 0.88
NO_MARGIN_COST = 0.3  # value by which a throw without a margin must be better than one with a margin
SEARCHING = 0.85  # fraction of the time after which only verifications are begun
LONGEST, MIN_BUDGET = 0.25, 3.0  # fraction of the time, and processor time, s, for a first verification
LOOK = 1.0  # s; steps of a run between two looks at the clock may take as long on a busy machine
TRIES = 3  # verifications at most between two generations
SLIP_MARGIN = 0.4  # fraction of MAX_SLIP above which a throw that holds is kept, but a better one sought
LOAD_MARGIN = 1.0  # load ratio for which the same holds
BOTH = 2  # verifications that succeed for a plan that succeeds
FULL_TURN = 2.0 * np.pi  # rad of contact that a search goes on for where the rope is long enough, if none is asked for
MAX_DIFFERENCE = 0.5  # turns between both verifications; above, one of them winds once more

STANDS = "a cast stands; one with a margin is sought"
NONE = (False, False, 0.0)  # value of no throw
Verified = tuple[Throw | None, CastOutcome | None, CastOutcome | None]  # throw, outcome, outcome with shorter links


class CastPlanner:
    """Rounds of a search until a plan succeeds with a margin or the `time_budget` of the nominal search, s, is over.

    `longer`: whether a cast may take LONGER times as long if the swings that the search allows promise too little.
    `full_turn`: whether a margin includes contact of a full turn where the rope is long enough.
    """

    def __init__(
        self, search: ThrowSearch, time_budget: float, *, longer: bool = False, full_turn: bool = True
    ) -> None:
        self.search, self.time_budget, self.longer, self.clock = search, time_budget, longer, Clock()
        search.left = lambda: SEARCHING * time_budget - self.spent
        cast_setup = search.cast_setup
        self.finer = [replace(cast_setup, rope=divided(cast_setup.rope, k)) for k in FINER]
        self.rounds, self.verifying = 0, 1.0
        tail = check_feasibility(cast_setup, search.peg).available_turns - HANGING_TAIL
        full = check_feasibility(replace(cast_setup, contact=FULL_TURN), search.peg)
        self.contact = FULL_TURN if full_turn and full.available_turns >= full.needed_turns else 0.0
        self.tail = float(np.clip(tail, MIN_TAIL, MAX_TAIL))
        self.checked: list[Candidate] = []
        self.verified: list[Verified] = []
        self.best: Verified = (None, None, None)

    @property
    def spent(self) -> float:
        """Time spent without compiling, s."""
        return self.clock.spent

    def left(self) -> float:
        """Return the time that is left for verifications, s, less what lies between two looks at it."""
        return self.verifying * self.time_budget - min(LOOK, 0.05 * self.time_budget) - self.spent

    def run(self, report: Callable[..., None] | None) -> None:
        """Search until a plan succeeds with a margin or the time is over; `report` gets the time spent and words."""
        score, idle, contact = 0.0, 0, 0
        while not self.search.runs or (self.spent < SEARCHING * self.time_budget and not self.done()):
            late = contact > 0 and self.search.late
            settled = idle >= IDLE_ROUNDS * (2 if late and score < WORTHY * self.tail else 1)
            if (
                late
                and score < PROMISING * self.tail
                and self.longer
                and (settled or self.spent > EARLY * self.time_budget)
            ):
                self.lengthen()
                score, idle, contact = 0.0, 0, 0
            elif (
                contact % RESTART
                and self.worth_refining(late)
                and (settled or self.spent > SWINGING * self.time_budget)
            ):
                self.search.evolve_throws()
                contact += 1
            else:
                before, score = score, self.swing()
                idle = idle + 1 if 0.0 < score < MIN_GROWTH * before + 0.01 else 0
                if self.contact_due(score, settled):
                    self.search.try_last_moves()
                self.search.restart()
                contact = 1
            self.verify_new()
            if report is not None:
                words = STANDS if _succeeds(self.best) else "planning"
                report(min(self.spent, self.time_budget), words)
        self.verify_best()

    def contact_due(self, score: float, settled: bool) -> bool:
        """Whether the best swings are to be tried in contact now."""
        if self.spent > SEARCHING * self.time_budget:
            return not self.search.candidates
        return score >= WORTHY * self.tail or settled or not self.search.late or self.spent > FREE * self.time_budget

    def worth_refining(self, late: bool) -> bool:
        """Whether a candidate is worth being refined: better swings help more if all strike late."""
        candidates = self.search.candidates
        return bool(candidates) and (not late or candidates[0].score >= NEARLY)

    def lengthen(self) -> None:
        """Begin anew with swings that take longer."""
        self.longer, self.rounds = False, 0
        self.search.lengthen(LONGER)
        self.checked.clear()

    def swing(self) -> float:
        """Make a round of free swings, by turns beam search and CMA-ES; return the best score so far."""
        self.rounds += 1
        if self.rounds % 2:
            return self.search.beam_search()
        score = 0.0
        for _ in range(GENERATIONS):
            score = max(score, self.search.evolve_swings())
            if self.spent > SEARCHING * self.time_budget:
                break
        return score

    def done(self) -> bool:
        """Whether a plan succeeds with a margin, and covers a full turn where the rope is long enough."""
        return _with_margin(self.best) and _covers(self.best, self.contact)

    def verify_new(self) -> None:
        """Verify the best candidates that were not verified yet, as many at once as there are threads."""
        for _ in range(TRIES):
            if self.done() or (self.spent > SEARCHING * self.time_budget and self.best[0] is not None):
                return
            self.search.confirm()
            found = self.fresh()
            if not found:
                return
            self.check(found)

    def verify_best(self) -> None:
        """Verify the best candidate if none was verified."""
        if self.best[0] is None and self.search.candidates:
            self.check(self.search.candidates[:1])

    def refine_robustly(self, uncertainty: Uncertainty, report: Callable[[float], None] | None) -> None:
        """Search, in the time that is left, for the throw that succeeds in most scenarios.

        Candidates without a margin in the nominal scenario are dropped.
        """
        self.time_budget, self.verifying = self.time_budget / NOMINAL, VERIFYING
        search, known, some = self.search, dict[RobustCandidate, Verified](), list[RobustCandidate]()
        refinement = RobustRefinement(search, uncertainty, left=lambda: REFINING * self.time_budget - self.spent)
        try:
            refinement.halve(search.candidates, [one for one in self.checked if one.throw is self.best[0]])
            complete = [found for found in self.verified if not _incomplete(found)]
            known |= {one: found for one in refinement.order for found in complete if found[0] is one.candidate.throw}
            refinement.evaluate_common([one for one, found in known.items() if _succeeds(found)])
            while True:
                refinement.drop([one for one, found in known.items() if not _with_margin(found)])
                refinement.run(None if report is None else lambda: report(self.spent))
                if not refinement.order or refinement.incumbent in known or (some and self.spent > self.time_budget):
                    break
                best = max((_value(*each) for each in known.items()), default=NONE)
                if best >= (True, True, refinement.incumbent.mean):
                    break
                some = [one for one in refinement.best(search.workers) if one not in known]
                for one, found in zip(some, self.outcomes([one.candidate for one in some]), strict=True):
                    known[one] = found
        except OutOfTime:
            some = [one for one in refinement.order[: search.workers] if one not in known]
            known |= zip(some, self.outcomes([one.candidate for one in some]), strict=True)
        finally:
            search.runs += refinement.runs
            chosen = max(known, key=lambda one: _value(one, known[one]), default=None)
            if chosen is not None and (_succeeds(known[chosen]) or not _succeeds(self.best)):
                self.best = known[chosen]

    def fresh(self) -> list[Candidate]:
        """Return confirmed candidates that wind, and are not like one that was verified nor like each other."""
        least = max(MIN_TURNS, self.search.cast_setup.contact / FULL_TURN)
        winding = (one for one in self.search.candidates if one.confirmed and one.turns >= least)
        return distinct(winding, self.checked, self.search.workers, ALIKE)

    def check(self, some: Sequence[Candidate]) -> None:
        """Verify candidates, keep the best, and correct the scores of those that fail."""
        for found, (throw, outcome, finer) in zip(some, self.outcomes(some), strict=True):
            worse = finer or outcome
            if worse is not None and not worse.success:
                self.search.correct(found, abs(worse.turns), abs(worse.turns) - SLIP_COST)
            new = (throw, outcome, finer)
            if self.best[0] is None or self.rank(new) > self.rank(self.best):
                self.best = new

    def rank(self, found: Verified) -> tuple[int, bool, bool, bool, float]:
        """Verifications that succeed; whether they agree, have a margin and cover enough of the peg; the turns."""
        good, alike, margin, turns = _rank(*found[1:])
        return good, alike, margin, _covers(found, self.contact), turns

    def outcomes(self, some: Sequence[Candidate]) -> list[Verified]:
        """Verify candidates at once."""
        self.checked += some
        with ThreadPoolExecutor(max(1, len(some))) as pool:
            found: list[Verified] = [
                (one.throw, *seen) for one, seen in zip(some, pool.map(self.verify, some), strict=True)
            ]
        self.verified += found
        return found

    def verify(self, found: Candidate) -> tuple[CastOutcome, CastOutcome | None]:
        """Verify a throw on the rope as given; then, if it winds and holds, with shorter and shorter links.

        Of these the outcome that fails is returned, or the one whose turns differ most: unpredictable throws differ
        with the length of the links. The last may run out of time; then the others count.
        """
        cast_setup, peg, force = self.search.cast_setup, self.search.peg, self.search.holding_force
        motion = found.throw.motion(cast_setup.limits)
        longest = max(min(LONGEST * self.time_budget, 0.5 * self.left()), MIN_BUDGET)
        first, later = Deadline(longest, self.left), Deadline(np.inf, self.left)
        outcome = require_holding_force(verify_cast(cast_setup, peg, motion, time_budget=first), peg, force, later)
        if not outcome.success:
            return outcome, None
        worst: CastOutcome | None = None
        for each in self.finer:
            finer = verify_cast(each, peg, motion, time_budget=later)
            if worst is not None and not finer.completed:
                break
            finer = require_holding_force(finer, peg, force, later)
            if not finer.success:
                return outcome, finer
            if worst is None or abs(finer.turns - outcome.turns) > abs(worst.turns - outcome.turns):
                worst = finer
        return outcome, worst

    def plan(self, known: Feasibility, interrupted: bool = False) -> CastPlan:
        """Return the plan so far; if nothing was verified, with the best candidate. `interrupted`: by Ctrl-C."""
        search, (throw, outcome, finer) = self.search, self.best
        if throw is None and search.candidates:
            throw = search.candidates[0].throw
        message = failure(outcome, finer, interrupted)
        found = (throw, outcome, finer, message, search.runs, self.spent, interrupted)
        return CastPlan(search.cast_setup, search.peg, known, *found)


def steady(outcome: CastOutcome) -> bool:
    """Whether a rope that holds does so with a margin, and was not folded flat before."""
    return outcome.slip <= SLIP_MARGIN * MAX_SLIP and outcome.load_ratio <= LOAD_MARGIN and not outcome.folded


def _succeeds(found: Verified) -> bool:
    """Whether all verifications of a throw succeed."""
    return _rank(*found[1:])[0] == BOTH


def _covers(found: Verified, contact: float) -> bool:
    """Whether the rope covers so much of the peg in all verifications, rad."""
    return all(outcome is not None and outcome.contact_angle >= contact for outcome in found[1:])


def _with_margin(found: Verified) -> bool:
    """Whether all verifications of a throw succeed with a margin."""
    return _rank(*found[1:])[:3] == (BOTH, True, True)


def _incomplete(found: Verified) -> bool:
    """Whether a verification of a throw ran out of time."""
    return any(outcome is not None and not outcome.completed for outcome in found[1:])


def _value(one: RobustCandidate, found: Verified) -> tuple[bool, bool, float]:
    """Value of a robust candidate as a plan."""
    cost = 0.0 if _with_margin(found) else NO_MARGIN_COST
    return _succeeds(found), not _incomplete(found), one.common_mean - cost


def _rank(outcome: CastOutcome | None, finer: CastOutcome | None) -> tuple[int, bool, bool, float]:
    """Verifications that succeed; whether their turns agree; whether both have a margin; the turns."""
    if outcome is None or finer is None:
        return 0, False, False, 0.0 if outcome is None else abs(outcome.turns)
    alike = abs(outcome.turns - finer.turns) < MAX_DIFFERENCE
    good = int(outcome.success) + int(finer.success)
    return good, alike, steady(outcome) and steady(finer), min(abs(outcome.turns), abs(finer.turns))


def failure(outcome: CastOutcome | None, finer: CastOutcome | None, interrupted: bool) -> str:
    """Return why a cast fails; empty if it succeeds."""
    if outcome is None:
        return "interrupted before any throw was verified" if interrupted else "no throw was found that strikes it"
    if outcome.message:
        return outcome.message
    if finer is None:
        return "interrupted before it was verified with shorter links"
    return f"with shorter links {finer.message}" if finer.message else ""
