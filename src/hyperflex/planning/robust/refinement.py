"""Robust refinement of throws: successive halving of candidates in sampled scenarios, then CMA-ES about the best."""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.outcome import MIN_TURNS
from hyperflex.planning.robust.scenario_rollouts import nominal_strike_times, scenario_scores
from hyperflex.planning.robust.uncertainty import Scenario, Uncertainty
from hyperflex.planning.search.candidates import Candidate, near, same_swing
from hyperflex.planning.search.contact_phase import TIME_BUDGET, WindingScores
from hyperflex.planning.search.evolution import CmaEs
from hyperflex.planning.search.throw_search import ThrowSearch
from hyperflex.planning.time_budget import OutOfTime
from hyperflex.simulation import Deadline

POOL, HALVING = 16, (4, 4, 8)  # candidates at first, and scenarios of each round; the better half goes on
EACH = 4  # candidates of one swing while there are others: they mostly fail in the same scenarios
MEMBERS, SCENARIOS = 8, 6  # of a generation
COMMON = 16  # scenarios in which a challenger is compared with the incumbent
NARROW = 0.1  # step size of CMA-ES, relative to that of the nominal search
SHADE = 0.2  # weight of the score beside a success
MAX_SCORE = 3.0  # score above which more does not count
ALIKE = 0.02  # points that differ by less are one
COMMON_STREAM, GENERATION_STREAM, CONFIRM_STREAM, CMA_STREAM = 9001, 9002, 9003, 9004  # of random numbers


@dataclass(eq=False)
class RobustCandidate:
    """A candidate with its successes and values in the scenarios so far; the first COMMON are the same for all."""

    candidate: Candidate
    successes: list[bool] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    @property
    def mean(self) -> float:
        """Mean value; a success counts one."""
        return float(np.mean(self.values)) if self.values else -1.0

    @property
    def common_mean(self) -> float:
        """Mean value in the common scenarios."""
        return float(np.mean(self.values[:COMMON]))


class RobustRefinement:
    """Successive halving of the candidates of a nominal search, then CMA-ES about the best, in sampled scenarios.

    `left` returns the time that is left, s; without
    any no second round is begun, nor a generation that takes more. `order` holds the candidates, best first.

    Notes
    -----
    All candidates of a round or a generation meet the same scenarios, so that luck does not choose among them. Each
    generation has new scenarios: a fit to a fixed few does not hold in others. The best of a generation becomes the
    incumbent only if it is better in the COMMON scenarios, and again with as many new ones added: of many challengers
    one would win in the same scenarios by luck.
    """

    def __init__(
        self, search: ThrowSearch, uncertainty: Uncertainty, *, left: Callable[[], float] = lambda: math.inf
    ) -> None:
        self.search, self.uncertainty, self.left = search, uncertainty, left
        self.common = self._scenarios(max(sum(HALVING), COMMON), COMMON_STREAM)
        self.order: list[RobustCandidate] = []
        self.runs = self.generations = 0
        self._optimizer: Any = None
        self._duration = 0.0  # s, of the last generation

    def _scenarios(self, count: int, *stream: int) -> list[Scenario]:
        seed = [stream[0], self.search.seed, *stream[1:]]
        return self.uncertainty.sample(count, self.search.cast_setup, self.search.peg, seed=seed)

    @property
    def incumbent(self) -> RobustCandidate:
        """The best candidate so far."""
        return self.order[0]

    def run(self, report: Callable[[], None] | None = None) -> None:
        """Evolve until no time is left or the incumbent succeeds in all its scenarios."""
        while self.order and (left := self.left()) > self._duration and not self.always_succeeds():
            self.evolve()
            self._duration = max(0.0, left - self.left()) if left < math.inf else 0.0
            if report is not None:
                report()

    def drop(self, some: Collection[RobustCandidate]) -> None:
        """Remove candidates; CMA-ES goes on about the best that is left."""
        if any(one in some for one in self.order):
            self.order = [one for one in self.order if one not in some]
            self._optimizer = None

    def best(self, count: int) -> list[RobustCandidate]:
        """Return the incumbent and others, `count` at most, of other swings first, after the common scenarios."""
        some: list[RobustCandidate] = []
        for one in self.order:
            if not any(same_swing(one.candidate, other.candidate) for other in some):
                some.append(one)
        some = [*some[:count], *(one for one in self.order if one not in some)][:count]
        self.evaluate_common(some)
        return some

    def evaluate_common(self, some: Sequence[RobustCandidate]) -> None:
        """Evaluate each in the common scenarios that it has not been evaluated in yet."""
        for one in some:
            self.evaluate([one], self.common[len(one.values) : COMMON])

    def always_succeeds(self) -> bool:
        """Whether the incumbent has succeeded in all its scenarios, COMMON at least."""
        return len(self.incumbent.successes) >= COMMON and all(self.incumbent.successes)

    def halve(self, found: Sequence[Candidate], seeded: Sequence[Candidate] = ()) -> None:
        """Compare candidates, those `seeded` among them, by successive halving."""
        runners = [RobustCandidate(candidate) for candidate in _pool(found, seeded)]
        done = 0
        for count in HALVING:
            if done and self.left() <= 0.0:
                break
            self.evaluate(runners, self.common[done : done + count])
            done += count
            runners.sort(key=lambda one: -one.mean)
            self.order = runners + self.order
            runners = runners[: max(1, len(runners) // 2)]
        self.order = [*runners, *(one for one in dict.fromkeys(self.order) if one not in runners)]

    def evolve(self) -> None:
        """Evaluate one generation about the incumbent in new scenarios; its best may become the incumbent."""
        incumbent = self.incumbent
        side = incumbent.candidate.side
        if self._optimizer is None:
            random = np.random.default_rng([CMA_STREAM, self.search.seed, self.generations])
            spreads = self.search.parametrizations[side].spreads()
            self._optimizer = CmaEs(incumbent.candidate.x, NARROW, spreads, MEMBERS, random)
        points = self._optimizer.ask()
        fresh = self._scenarios(SCENARIOS, GENERATION_STREAM, self.generations)
        runners = [RobustCandidate(one) for one in self.candidates(side, [np.asarray(x) for x in points])]
        self.evaluate(runners, fresh)
        self._optimizer.tell(points, [-one.mean for one in runners])
        self.generations += 1
        challenger = RobustCandidate(max(runners, key=lambda one: one.mean).candidate)
        missing = len(incumbent.successes)
        self.evaluate([challenger], self.common[:COMMON])
        if missing < COMMON:
            self.evaluate([incumbent], self.common[missing:COMMON])
        if challenger.mean <= incumbent.common_mean:
            return
        again = self._scenarios(COMMON, CONFIRM_STREAM, self.generations)
        self.evaluate([challenger, incumbent], again)
        if challenger.mean > float(np.mean(incumbent.values[:COMMON] + incumbent.values[-COMMON:])):
            self.order.insert(0, challenger)

    def candidates(self, side: int, points: list[Array]) -> list[Candidate]:
        """Return points as throws that are cut at their strikes in the nominal scenario."""
        cast_setup = self.search.cast_setup
        throws = [self.search.parametrizations[side].throw(x) for x in points]
        times = nominal_strike_times(cast_setup, self.search.peg, throws, threads=self.search.threads)
        self.runs += len(points)
        cut = [
            throw if np.isnan(t) else throw.cut(float(t), cast_setup.limits)
            for throw, t in zip(throws, times, strict=True)
        ]
        return [Candidate(0.0, 0.0, side, x, throw) for x, throw in zip(points, cut, strict=True)]

    def evaluate(self, runners: Sequence[RobustCandidate], scenarios: Sequence[Scenario]) -> None:
        """Simulate each candidate in each scenario, and add its successes and values; OutOfTime if no time is left."""
        if not (runners and scenarios):
            return
        pairs = [(one.candidate.throw, scenario) for one in runners for scenario in scenarios]
        end = Deadline(TIME_BUDGET, self.left)
        found = scenario_scores(self.search.cast_setup, pairs, time_budget=end, threads=self.search.threads)
        self.runs += 2 * len(pairs)
        if self.left() < 0.0:  # some were cut short
            raise OutOfTime
        won = (found.turns >= MIN_TURNS).reshape(len(runners), -1)
        values = robust_values(found).reshape(won.shape)
        for one, successes, each in zip(runners, won, values, strict=True):
            one.successes += successes.tolist()
            one.values += each.tolist()


def robust_values(found: WindingScores) -> Array:
    """Return the values (M,) of throws: one for a success, and SHADE at most for the score."""
    return np.asarray((found.turns >= MIN_TURNS) + SHADE * np.clip(found.score / MAX_SCORE, -1.0, 1.0))


def _pool(found: Sequence[Candidate], seeded: Sequence[Candidate] = ()) -> list[Candidate]:
    """Return distinct candidates: those seeded, the best that wind, EACH of a swing, then more, then others."""
    chosen: list[Candidate] = list(seeded)
    more: list[Candidate] = []
    others: list[Candidate] = []
    for one in sorted(found, key=lambda one: (one.turns < MIN_TURNS, -one.score)):
        crowded = sum(same_swing(one, other) for other in chosen) >= EACH
        among = others if one.turns < MIN_TURNS else more if crowded else chosen
        if len(among) < POOL and not any(near(one, other, ALIKE) for other in chosen + more + others):
            among.append(one)
    return (chosen + more + others)[:POOL]
