"""The task of a cast: swing a rope so that it winds round a target and holds."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from hyperflex.budget import Budget, OutOfTime
from hyperflex.checks import Array
from hyperflex.interfaces import RopeState
from hyperflex.model import Peg
from hyperflex.planning.ensemble import pieces_in_contact, scenario_scores, strikes_in_plane, verify_members
from hyperflex.planning.moves import PUMPING, Moves
from hyperflex.planning.options import SearchOptions
from hyperflex.planning.outcome import CastOutcome
from hyperflex.planning.planner import Candidate, Task, Verified
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import (
    MODEL,
    RolloutBatch,
    WindingScores,
    free_sides,
    robust_values,
    simulate_contact,
)
from hyperflex.planning.swings import MIN_SPEED, State, Strike, Swing, SwingSearch
from hyperflex.planning.swings_in_contact import SwingsInContact
from hyperflex.planning.uncertainty import Scenario, Uncertainty

# Moves after the strike: strokes still made, then the end of the last move, in half turns towards the target's side,
# and the rest before it, in periods, in which a short tail comes to rest. Of 461 swings that struck 43 targets 53 wound
# with the first, 95 with one of the first eight of these and 100 with any of 15 without a rest
FINISHES = (
    (2, 0.5, 0.0),
    (0, 1.0, 0.0),
    (0, 0.5, 0.0),
    (0, 0.5, 2.0),
    (1, 0.5, 0.0),
    (0, -0.5, 2.0),
    (2, 1.0, 0.0),
    (0, -1.0, 0.0),
    (0, 1.0, 2.0),
    (2, -0.5, 0.0),
)


class WindTask(Task):
    """Wind a rope round a target.

    Parameters
    ----------
    problem : Problem
    peg : Peg
    options : SearchOptions
    uncertainty : Uncertainty, optional
        With it candidates are compared, and verified, in sampled scenarios as well.
    start : sequence of Moves
        Moves to begin with.
    seen : sequence of (Moves, RopeState)
        The last of the first moves of a cast, one more each time, and the state of the rope after them, as it was
        measured: the search goes on from these as well. What is simulated, and verified, begins with the last that
        applies.
    anew : bool
        Whether the search begins from the start, too, if there are any that were seen.
    longest : float
        Time until the strike of a rope that swings on through contact, s; by default that of the problem.

    Attributes
    ----------
    most_turns : float
        Greatest number of turns that the rope made in a rollout at any time.
    furthest : int
        What the best rollout reached: 0 too few turns, 1 the turns required, 2 also at the end, 3 also clear of arm and
        obstacles.
    """

    def __init__(
        self,
        problem: Problem,
        peg: Peg,
        options: SearchOptions,
        uncertainty: Uncertainty | None = None,
        start: Sequence[Moves] = (),
        seen: Sequence[tuple[Moves, RopeState]] = (),
        anew: bool = True,
        longest: float = 0.0,
    ) -> None:
        self.problem, self.peg, self.options, self.batch, self.enough = problem, peg, options, options.batch, 1.0
        self.sides = free_sides(problem, problem.beside(peg))
        cuts = self._cuts = pieces_in_contact(problem, peg, options.coarse)
        pieces = max(options.pieces, cuts + 1)
        self.contact, self.finer = problem.cut(cuts), problem.cut(pieces)
        chains = problem, problem.cut(pieces)
        made = list[Swing]()
        for moves, now in seen:
            states = tuple(State(now.t, now.q, now.qd).cut(parts) for parts in (1, pieces))
            made.append(Swing(moves, states, parent=made[-1] if made else None))
        self.search = SwingSearch(chains, peg, self.sides, np.random.default_rng(options.seed), options, made, anew)
        long = replace(self.contact, time=longest or problem.time)
        self.pumping = SwingsInContact(
            (long, self.finer), peg, self.sides, np.random.default_rng([options.seed, 2]), options
        )
        self.order = 1 + np.random.default_rng([options.seed, 1]).permutation(len(FINISHES) - 1)  # of the last moves
        self._again = list[Strike]()  # to be tried with other last moves
        self.scenarios: list[Scenario] = []
        if uncertainty is not None:
            self.scenarios = uncertainty.sample(options.scenarios, problem, peg, seed=[9001, options.seed])
        self.most_turns, self.furthest, self._flights = 0.0, 0, 0
        self._start = [replace(one, dwell=0.0) for one in start if one.side in self.sides]
        self._samples = self._draws = 0
        self._anew = anew or not seen
        self._winds_freely = self._winds_on = False  # whether the rope winds after free flight, and through contact
        self._spent = [0.0, 0.0]  # s, since the target stops free swings: on these, and on swings through contact

    def sample(self, found: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Return swings that strike: those given, then free ones, and through contact where the target stops these.

        Both kinds get the same time, also for their rollouts and verifications.
        """
        new: Sequence[Strike] = ()
        while not new:
            self._count()
            budget.report()
            budget.check()
            if self._start:
                given, self._start = self._start, []
                new = [replace(one, score=math.inf, given=True) for one in self.search.start(given, budget)]
            elif self._again:
                new, self._again = self._again, []
            else:
                through = self._stopped and self._spent[True] <= self._spent[False]
                some = [one for one in found if isinstance(one, Strike) and one.through_contact == through]
                before = budget.elapsed
                new = self._through_contact(some, budget) if through else self._free(some, budget)
                self._charge([through], budget.elapsed - before)
        self._count()
        return list(new)

    def _free(self, found: list[Strike], budget: Budget) -> list[Strike]:
        """Return free swings that strike: by turns from the beam search, near the best ones, and with other ends."""
        self._samples += 1
        best, wound = self._some(found), self._some([one for one in found if one.winds])
        if wound and self._samples % 3 == 0:
            return [self.other_ends(wound[self.search.random.integers(len(wound))])]
        if self.options.members and self._samples % 2 == 0 and (best or self.search.passes):
            new = self.search.vary(best, budget)[: max(1, self.options.members // 2)]
            nearly = bool(best) and best[0].score > self.options.nearly * self.problem.criteria.turns
            return [replace(one, score=math.inf) for one in new] if nearly else new  # else they wait for better swings
        return self.search.extend(budget)

    @property
    def _stopped(self) -> bool:
        """Whether the beam search has begun again, and no free swing wound the rope before others did."""
        return self._anew and self.search.passes > 0 and (self._winds_on or not self._winds_freely)

    def _charge(self, through: Sequence[bool], seconds: float) -> None:
        """Charge the time of a step to its swings, each `through` contact or free."""
        for each in through if self._stopped else ():
            self._spent[each] += seconds / len(through)

    def _through_contact(self, found: list[Strike], budget: Budget) -> list[Strike]:
        """Return swings in contact that nearly wind: by turns from the beam search, near the best, with other ends."""
        self._draws += 1
        best, wound = self._some(found), self._some([one for one in found if one.winds])
        if wound and self._draws % 3 == 0:
            return [self.other_ends(wound[self.search.random.integers(len(wound))])]
        if best and self._draws % 3 == 1:
            new = self.pumping.vary(best, budget)
        else:
            new = self.pumping.extend(budget)
        return [replace(one, score=math.inf) for one in new]

    def _some(self, found: list[Strike]) -> list[Strike]:
        """Return the first of some strikes that are not alike."""
        return _distinct(found[: 4 * self.options.parents], self.options.parents)

    def _count(self) -> None:
        flights = self.search.runs + self.pumping.runs
        self.runs, self._flights = self.runs + flights - self._flights, flights

    def rollout(self, some: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Simulate strikes in contact with some last moves; simulate those that wind with shorter links, too.

        A strike whose rope winds with the first last moves, but does not stay, is tried with others later.
        """
        swings, before = [one for one in some if isinstance(one, Strike)], budget.elapsed
        pairs = [(one, moves) for one in swings for moves in one.follow or self.finishes(one)]
        states = [one.states[0] if one.through_contact else one.states[0].cut(self._cuts) for one, _ in pairs]
        sweeping = [not (one.through_contact or one.given) for one, _ in pairs]
        wound = self._wind(self.contact, [moves for _, moves in pairs], states, budget, sweeping)
        found, good, required = list[Candidate](), list[Strike](), self.problem.criteria.turns
        reached = (wound.most >= required).astype(int) + np.isfinite(wound.slip) + (wound.turns >= required)
        self.furthest = max(self.furthest, int(reached.max(initial=0)))
        self.most_turns = max(self.most_turns, float(wound.most.max(initial=0.0)))
        for one in swings:
            rows = [k for k, (other, _) in enumerate(pairs) if other is one]
            k = max(rows, key=lambda row: (wound.turns[row] >= required, wound.score[row]))
            winds = bool(wound.most[rows].max() >= required)
            moves = pairs[k][1].waiting(float(wound.dwell[k]))
            tried = replace(one, moves=moves, score=float(wound.score[k]), winds=winds)
            self._winds_on |= winds and one.through_contact
            self._winds_freely |= winds and not (one.through_contact or one.given)
            if wound.turns[k] >= required:
                good.append(tried)
                continue
            found.append(tried)
            if not one.follow and winds and one.tried + len(rows) < len(FINISHES):
                self._again.append(replace(one, tried=one.tried + len(rows), score=math.inf))
        found += self._confirmed(good, budget)
        self._charge([one.through_contact for one in swings], budget.elapsed - before)
        return found

    def _wind(
        self,
        problem: Problem,
        moves: Sequence[Moves],
        states: Sequence[State],
        budget: Budget,
        sweeping: Sequence[bool] = (),
    ) -> WindingScores:
        """Simulate moves in contact on a chain, each from the state of its strike."""
        motions = [one.motion(problem.limits, state.t) for one, state in zip(moves, states, strict=True)]
        q, qd = np.stack([each.q for each in states]), np.stack([each.qd for each in states])
        batch = RolloutBatch([problem.rope] * len(moves), [self.peg] * len(moves), motions, q, qd)
        self.runs += len(moves)
        begin = np.array([each.t for each in states])
        return simulate_contact(problem, batch, begin, budget, sweeping=sweeping, periods=MODEL.periods)

    def _confirmed(self, good: list[Strike], budget: Budget) -> list[Candidate]:
        """Return strikes that wind after they were simulated with shorter links as well, and in scenarios."""
        if not good:
            return []
        states = [one.states[-1] for one in good]
        seen = self._wind(self.finer, [one.moves for one in good], states, budget)
        found, criteria = list[Candidate](), self.problem.criteria
        for one, value, turns, slip, dwell in zip(
            good, *(each.tolist() for each in (seen.score, seen.turns, seen.slip, seen.dwell)), strict=True
        ):
            winds, value = turns >= criteria.turns and slip < criteria.max_slip, min(one.score, value)
            one = replace(one, moves=one.moves.waiting(dwell))
            if winds and self.scenarios:
                value = 3.0 * float(np.mean(self._values(one.moves, self.scenarios[:8], budget)))
            found.append(replace(one, score=value, good=winds))
        return found

    def _values(self, moves: Moves, scenarios: Sequence[Scenario], budget: Budget) -> Array:
        """Return the values of moves in scenarios; see :func:`robust_values`."""
        self.runs += 2 * len(scenarios)
        found = scenario_scores(self.problem, moves, scenarios, self._cuts, budget, MODEL.stiction)
        return robust_values(found, self.problem)

    def finishes(self, strike: Strike) -> list[Moves]:
        """Return the moves of a swing with the next last moves: first the first of FINISHES, then some others."""
        order = [0, *self.order][strike.tried :][: self.options.finishes if strike.tried else 1]
        towards = 1.0 if self.peg.x >= self.problem.arm.pivot[0] else -1.0
        some = (FINISHES[k] for k in order)
        return [self._ended(strike.moves, strike.t, more, towards * end * math.pi, rest) for more, end, rest in some]

    def _ended(self, moves: Moves, t: float, more: int, end: float, rest: float, speed: float = 0.9) -> Moves:
        """Return moves that strike at t, s, with more strokes, a rest, in periods, and a last move to `end`, rad."""
        wait = self._wait(moves, t)
        for _ in range(more):
            moves, wait = pumped(self.problem, moves, wait), 0.0
        return moves.then(end, wait + rest * self.problem.period, speed)

    def _wait(self, moves: Moves, t: float) -> float:
        """Return how long the arm rests at least after moves that strike at t, s."""
        return max(0.0, t - moves.stops(self.problem.limits)) + 2.0 * MODEL.step

    def other_ends(self, one: Strike) -> Strike:
        """Return a strike with last moves to try next: by turns near the best ones, and any."""
        limits, random, follow = self.problem.limits, self.search.random, list[Moves]()
        moves = one.moves.cut(one.t, limits)
        made = moves.ends.size
        for k in range(self.options.batch):
            if k % 2 and one.moves.ends.size > made:
                follow.append(self.search.varied(one.moves, made, self._wait(moves, one.t)))
            else:
                end, speed = random.uniform(*limits.angles), random.uniform(MIN_SPEED, 1.0)
                rest = max(0.0, random.uniform(-2.0, 2.0))  # a tail that must pass the arm needs it to go at once
                follow.append(self._ended(moves, one.t, int(random.integers(3)), end, rest, speed))
        return replace(one, follow=tuple(follow), score=math.inf)

    def _unsettled(self, outcome: CastOutcome) -> bool:
        """Whether a rope that is wound in the end fails because it slips or loses turns as it swings."""
        criteria, slip = self.problem.criteria, outcome.slip
        enough = abs(outcome.turns) >= criteria.turns and not outcome.refused
        return enough and (not outcome.wound or criteria.max_slip <= slip < math.inf)

    def alike(self, one: Candidate, other: Candidate) -> bool:
        """Whether two candidates swing alike until the strike."""
        return _alike(one, other)

    def verify(self, one: Candidate, budget: Budget) -> Verified:
        """Verify moves in an ensemble: as planned, with shorter links, and in scenarios.

        A rope that is wound in the end, but slips or loses turns while it is watched, as it still swings, is given
        time to settle once: the `periods` of rollouts.
        """
        before = budget.elapsed
        try:
            return self._verified(one, budget)
        finally:
            self._charge([isinstance(one, Strike) and one.through_contact], budget.elapsed - before)

    def _verified(self, one: Candidate, budget: Budget) -> Verified:
        """Verify moves; see :meth:`verify`, which charges the time to their kind of swing."""
        pieces, problem, since = self.options.pieces, self.problem, 0.0
        if isinstance(one, Strike) and one.swing and (last := one.swing.last_of(self.search.seen)):
            since, q, qd = last.states[0]
            problem = replace(problem, side=one.moves.side, q0=tuple(q), qd0=tuple(qd))
        finer = [problem.cut(each) for each in ((pieces, pieces - 1) if pieces > 2 else (pieces,))]
        found = verify_members(problem, finer, self.peg, one, budget, since)
        if any(each is not None and self._unsettled(each) for each in (found.outcome, found.finer_outcome)):
            waits = replace(one, moves=one.moves.waiting(MODEL.periods * self.problem.period))
            with suppress(OutOfTime):
                again = verify_members(problem, finer, self.peg, waits, budget, since)
                one, found = (one, found) if again.message else (waits, again)
        most, seen = self.pumping.problem.time, found.outcome
        if isinstance(one, Strike) and one.through_contact and not found.message and seen.strike_time > most:
            found = replace(found, message=f"it strikes at {seen.strike_time:.2f} s, {most:.2f} s allowed", margin=-1.0)
        if found.message or not self.scenarios:
            return found
        values = self._values(one.moves, self.scenarios, budget)
        aside = math.nan if found.outcome is None else found.outcome.aside
        share = float(((values >= 0.8) & strikes_in_plane(self.problem, self.scenarios, aside)).mean())
        return replace(found, margin=share if found.margin >= 1.0 else 0.7 * share)


def pumped(problem: Problem, moves: Moves, wait: float = 0.0) -> Moves:
    """Return moves with one more stroke that keeps step with the swing, the other way than the last, after a `wait`, s.

    Strokes go as far as the motor's range allows, 0.95 half turns at most.
    """
    limits, angles = problem.limits, moves.angles(problem.limits)
    sense = float(np.sign(angles[-2] - angles[-1])) if angles.size > 1 else float(-moves.side)
    stroke = min(0.95 * math.pi, limits.angles[1] - limits.angles[0])
    duration = float(limits.fastest_moves([stroke])[0][0])
    rest = max(0.02, PUMPING - duration / problem.period) * problem.period
    return moves.then(float(np.clip(angles[-1] + sense * stroke, *limits.angles)), max(wait, rest))


def _alike(one: Candidate, other: Candidate, apart: float = 0.1) -> bool:
    """Whether strokes and rests before the strike differ by little: half turns, and s."""
    if one.moves.side != other.moves.side:
        return False
    k = min(one.moves.ends.size, other.moves.ends.size)
    before = max(1, int(np.searchsorted(np.cumsum(one.moves.rests[:k] + 0.1), one.t)) - 1)
    ends = np.abs(one.moves.ends[:before] - other.moves.ends[:before]).max(initial=0.0) / math.pi
    rests = np.abs(one.moves.rests[:before] - other.moves.rests[:before]).max(initial=0.0)
    return bool(max(ends, rests) < apart and abs(one.t - other.t) < 0.5)


def _distinct(some: Sequence[Strike], count: int) -> list[Strike]:
    """Return the first strikes, `count` at most, that are not alike."""
    found = list[Strike]()
    for one in sorted(some, key=lambda each: -each.score):
        if len(found) < count and not any(_alike(one, other) for other in found):
            found.append(one)
    return found
