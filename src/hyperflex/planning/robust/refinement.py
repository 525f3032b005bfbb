"""Robust refinement of throws: successive halving of candidates in sampled scenarios, then CMA-ES about the best."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.problem import Problem
from hyperflex.planning.robust.scenario_rollouts import nominal_strike_times, scenario_scores
from hyperflex.planning.robust.uncertainty import Scenario, Uncertainty
from hyperflex.planning.search.candidates import Candidate, near, same_swing
from hyperflex.planning.search.contact_phase import TIME_BUDGET, WindingScores
from hyperflex.planning.search.evolution import CmaEs
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.time_budget import OutOfTime
from hyperflex.simulation import Deadline

POOL, POOL_ROUNDS = 16, (4, 4, 8)  # candidates at first, and scenarios of each round; the better half goes on
EACH = 4  # candidates of one swing while there are others: they mostly fail in the same scenarios
MEMBERS, GENERATION_ROUNDS = 16, (2, 2, 4)  # of a generation, likewise
RACE = (8, 16, 32)  # scenarios after which a challenger that is worse than the incumbent is given up
COMMON = RACE[-1]  # scenarios that are the same for all candidates
DOUBT = 4  # scenarios in which a candidate is taken to fail besides: few successes may be luck
NARROW = 0.07  # step size of CMA-ES, relative to that of the nominal search
SHADE = 0.2  # weight of the score beside a success
MAX_SCORE = 3.0  # score above which more does not count; with more turns asked it is higher by these
ALIKE = 0.02  # points that differ by less are one
COMMON_STREAM, GENERATION_STREAM, CMA_STREAM = 9001, 9002, 9003  # of random numbers


@dataclass(eq=False)
class RobustCandidate:
    """A candidate with its successes and values in the scenarios so far.

    Those of candidates that are kept are the first common scenarios, in their order; members of a generation are
    evaluated in others.
    """

    candidate: Candidate
    successes: list[bool] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    @property
    def mean(self) -> float:
        """Mean value; a success counts one."""
        return float(np.mean(self.values)) if self.values else -1.0

    @property
    def doubted_mean(self) -> float:
        """Mean value with DOUBT scenarios more, in which it fails: for candidates that met more and fewer scenarios."""
        return sum(self.values) / (len(self.values) + DOUBT)

    @property
    def always_succeeds(self) -> bool:
        """Whether it has succeeded in all its scenarios, COMMON at least."""
        return len(self.successes) >= COMMON and all(self.successes)


class RobustRefinement:
    """Successive halving of the candidates of a nominal search, then CMA-ES from the best, in sampled scenarios.

    `left` returns the time that is left, s; without any no second round is begun, nor a generation that takes more.
    `order` holds the candidates, the incumbent first and the others by what was known of them.

    Notes
    -----
    All candidates of a round or a generation meet the same scenarios, so that luck does not choose among them. Each
    generation has new scenarios, as a fit to a fixed few does not hold in others, and is halved, too: most of its
    members fail in nearly all of them. Its best member and the new mean of CMA-ES then challenge the incumbent in the
    COMMON scenarios, which are the same for all. So the mean value of an incumbent is a little better than it would be
    in new ones.
    """

    def __init__(
        self, search: ThrowSearch, uncertainty: Uncertainty, *, left: Callable[[], float] = lambda: math.inf
    ) -> None:
        self.search, self.uncertainty, self.left = search, uncertainty, left
        self.common = self._scenarios(COMMON, COMMON_STREAM)
        self.order: list[RobustCandidate] = []
        self.runs = self.generations = 0
        self._optimizer: Any = None
        self._duration = 0.0  # s, of the longest generation

    def _scenarios(self, count: int, *stream: int) -> list[Scenario]:
        seed = [stream[0], self.search.seed, *stream[1:]]
        return self.uncertainty.sample(count, self.search.problem, self.search.peg, seed=seed)

    @property
    def incumbent(self) -> RobustCandidate:
        """The best candidate so far."""
        return self.order[0]

    @property
    def in_time(self) -> bool:
        """Whether there is time for one more generation."""
        return self.left() > self._duration

    def run(self, until: float = math.inf, report: Callable[[], None] | None = None) -> None:
        """Evolve until no time is left, or the incumbent always succeeds.

        At least one generation later also until its doubted mean is `until` or more.
        """
        while self.order and self.in_time and not self.incumbent.always_succeeds:
            left = self.left()
            try:
                self.evolve()
            except OutOfTime:
                self._duration = math.inf
                break
            if left < math.inf:
                self._duration = max(self._duration, left - self.left())
            if report is not None:
                report()
            if self.incumbent.doubted_mean >= until:
                break

    def drop(self, some: Collection[RobustCandidate]) -> None:
        """Remove candidates; without the incumbent CMA-ES begins anew from the best that is left."""
        before, self.order = self.order[:1], [one for one in self.order if one not in some]
        if self.order[:1] != before:
            self._optimizer = None

    def best(self, count: int) -> list[RobustCandidate]:
        """Return the incumbent and others, `count` at most, of other swings first."""
        some: list[RobustCandidate] = []
        for one in self.order:
            if not any(same_swing(one.candidate, other.candidate) for other in some):
                some.append(one)
        return [*some[:count], *(one for one in self.order if one not in some)][:count]

    def evaluate_common(self, one: RobustCandidate, count: int = COMMON) -> None:
        """Evaluate a candidate in those of the first `count` common scenarios that it was not evaluated in yet."""
        self.evaluate([one], self.common[len(one.values) : count])

    def halve(self, found: Sequence[Candidate], seeded: Sequence[Candidate] = ()) -> None:
        """Compare candidates, those `seeded` among them, by successive halving, as far as there is time."""
        self.order = [RobustCandidate(candidate) for candidate in _pool(found, self.search.problem.turns, seeded)]
        try:
            self._sort(self.order, self.common, POOL_ROUNDS)
        except OutOfTime:
            self._duration = math.inf

    def promote(self, some: Sequence[RobustCandidate]) -> None:
        """Evaluate candidates in as many scenarios as the best of a halving, and sort all by what is known then."""
        try:
            for one in some:
                self.evaluate_common(one, sum(POOL_ROUNDS))
        except OutOfTime:
            self._duration = math.inf
        self.order.sort(key=lambda one: -one.doubted_mean)

    def _sort(self, runners: list[RobustCandidate], scenarios: Sequence[Scenario], counts: Sequence[int]) -> None:
        """Sort candidates in place, best first, in rounds of so many scenarios; the better half goes on to the next."""
        alive, done = len(runners), 0
        for count in counts:
            if done and self.left() <= 0.0:
                break
            self.evaluate(runners[:alive], scenarios[done : done + count])
            runners[:alive] = sorted(runners[:alive], key=lambda one: -one.mean)
            alive, done = max(1, alive // 2), done + count

    def evolve(self) -> None:
        """Evaluate one generation in new scenarios; its best member, or its mean, may become the incumbent."""
        incumbent = self.incumbent
        side = incumbent.candidate.side
        if self._optimizer is None:
            random = np.random.default_rng([CMA_STREAM, self.search.seed, self.generations])
            spreads = self.search.parametrizations[side].spreads()
            self._optimizer = CmaEs(incumbent.candidate.x, NARROW, spreads, MEMBERS, random)
        points = self._optimizer.ask()
        fresh = self._scenarios(sum(GENERATION_ROUNDS), GENERATION_STREAM, self.generations)
        found = self.candidates(side, points)
        late = [one.x for one in found if self._late(one)]
        runners = [RobustCandidate(one) for one in found if not self._late(one)]
        self._sort(runners, fresh, GENERATION_ROUNDS)
        self._optimizer.tell([*(one.candidate.x for one in runners), *late], range(len(points)))
        self.generations += 1
        for candidate in [*(one.candidate for one in runners[:1]), *self.candidates(side, [self._optimizer.mean])]:
            if not self._late(candidate):
                self._challenge(candidate)

    def _late(self, one: Candidate) -> bool:
        """Whether a candidate strikes later than it may; one that does not strike does so in other scenarios."""
        return self.search.problem.time < one.t < math.inf

    def _challenge(self, candidate: Candidate) -> None:
        """Let a candidate become the incumbent if it is better in the common scenarios, and no worse before."""
        challenger, incumbent = RobustCandidate(candidate), self.incumbent
        for count in RACE:
            self.evaluate_common(challenger, count)
            self.evaluate_common(incumbent, count)
            if challenger.mean < float(np.mean(incumbent.values[:count])):
                return
        if challenger.mean > incumbent.mean:
            self.order.insert(0, challenger)

    def candidates(self, side: int, points: list[Array]) -> list[Candidate]:
        """Return points as throws that are cut at their strikes in the nominal scenario."""
        problem = self.search.problem
        throws = [self.search.parametrizations[side].throw(x) for x in points]
        given: dict[str, Any] = {"time_budget": Deadline(math.inf, self.left), "threads": self.search.threads}
        times = nominal_strike_times(problem, self.search.peg, throws, **given)
        self.runs += len(points)
        cut = [
            throw if np.isnan(t) else throw.cut(float(t), problem.limits)
            for throw, t in zip(throws, times, strict=True)
        ]
        strikes = np.where(np.isnan(times), math.inf, times)
        each = zip(points, cut, strikes, strict=True)
        return [Candidate(0.0, 0.0, side, x, throw, t=float(t)) for x, throw, t in each]

    def evaluate(self, runners: Sequence[RobustCandidate], scenarios: Sequence[Scenario]) -> None:
        """Simulate each candidate in each scenario, and add its successes and values; OutOfTime if no time is left."""
        if not (runners and scenarios):
            return
        problem = self.search.problem
        pairs = [(one.candidate.throw, scenario) for one in runners for scenario in scenarios]
        end = Deadline(TIME_BUDGET, self.left)
        found = scenario_scores(problem, pairs, time_budget=end, threads=self.search.threads)
        self.runs += 2 * len(pairs)
        if self.left() < 0.0:  # some were cut short
            raise OutOfTime
        won = (found.turns >= problem.turns).reshape(len(runners), -1)
        values = robust_values(found, problem).reshape(won.shape)
        for one, successes, each in zip(runners, won, values, strict=True):
            one.successes += successes.tolist()
            one.values += each.tolist()


def robust_values(found: WindingScores, problem: Problem) -> Array:
    """Return the values (M,) of throws: one for the turns that are asked, and SHADE at most for the score."""
    most = MAX_SCORE + problem.more_turns
    return np.asarray((found.turns >= problem.turns) + SHADE * np.clip(found.score / most, -1.0, 1.0))


def _pool(found: Sequence[Candidate], asked: float, seeded: Sequence[Candidate] = ()) -> list[Candidate]:
    """Return distinct candidates: those seeded, the best of `asked` turns, EACH of a swing, then more, then others."""
    chosen: list[Candidate] = list(seeded)
    more: list[Candidate] = []
    others: list[Candidate] = []
    for one in sorted(found, key=lambda one: (one.turns < asked, -one.score)):
        crowded = sum(same_swing(one, other) for other in chosen) >= EACH
        among = others if one.turns < asked else more if crowded else chosen
        if len(among) < POOL and not any(near(one, other, ALIKE) for other in chosen + more + others):
            among.append(one)
    return (chosen + more + others)[:POOL]
