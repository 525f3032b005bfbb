"""When a cast succeeds: if it does so in each member of an ensemble.

Members are the rope as planned, the rope with shorter links, and for a robust plan sampled scenarios. How much of each
criterion is to spare in the members is the margin.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Flags
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import Peg, divided
from hyperflex.planning.moves import Moves
from hyperflex.planning.options import SearchOptions, WindCriteria
from hyperflex.planning.outcome import CastOutcome, require_holding_force, verify_cast
from hyperflex.planning.planner import Candidate, Verified
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import RolloutBatch, WindingScores, winding_scores
from hyperflex.planning.uncertainty import Scenario, Uncertainty
from hyperflex.planning.verification import CAST_ACCURACY

# Of runs with shorter links; near the peg they may be longer than the 0.3 radii of the run as planned. Casts of two
# long ropes took 0.4 and 0.8 of the time that they take with 0.3. A rope of such links holds up to 7 % less than the
# capstan equation allows (friction 0.5, two turns), and up to 3 % less with 0.3
FINER = CAST_ACCURACY._replace(ratio=0.5)
SAME_PASS = 0.25  # periods, by which strikes in one pass differ at most: the next pass is half a period later
COUNTED = 8  # samples of an estimate that are simulated at once
STREAM = 7001  # of the random numbers of an estimate, apart from those of a search


@dataclass(frozen=True)
class Spare:
    """Amounts to spare with which the margin of a wound rope is 1.

    Parameters
    ----------
    turns : float
        Turns beyond those required; below, two of 20 plans failed an independent run.
    slip : float
        Fraction of the allowed slip that is not used.
    clearance : float
        Distance from arm, shaft and obstacles beyond that required, m: with shorter links one of 0.2 mm was -0.9 mm.
    falling : float
        Turns beyond those required of a rope whose end lies on top of the target: it loses them if it falls.
    delay : float
        Time between the strikes of two members, s. Those of throws that succeed agree to a sample or two.
    """

    turns: float = 0.1
    slip: float = 0.6
    clearance: float = 3e-3
    falling: float = 1.0
    delay: float = 0.05


SPARE = Spare()


def verify_members(
    problem: Problem, finer: Sequence[Problem], peg: Peg, one: Candidate, budget: Budget, since: float = 0.0
) -> Verified:
    """Verify moves on the rope as planned, and on the same with shorter links, in one or two ways.

    Near the peg the run with shorter links may have the longer ones: it tests the links of the whole rope.

    The second way is for a rope that strikes the target at another time with shorter links, if in the same pass: then
    both ways must agree. And for a rope that comes off after its first touch and winds later: what it does in between
    depends on little, so that two runs may agree by chance. The first member to fail ends the other. A candidate whose
    runs take more than three quarters of the remaining time fails. Where the problem begins in the middle of the moves,
    `since` is the time there, s.
    """
    motion, share = one.moves.motion(problem.limits, since), budget.share(0.75)
    members = [(problem, CAST_ACCURACY), *((each, FINER) for each in finer)]
    failed = list[int]()

    def run(k: int) -> CastOutcome:
        which, accuracy = members[k]
        outcome = verify_cast(which, peg, motion, accuracy=accuracy, time_budget=share)
        outcome = require_holding_force(outcome, peg, problem.criteria, share)
        if not outcome.success:
            failed.append(k)
            share.cancel()
        return outcome

    with ThreadPoolExecutor(min(2, budget.threads)) as pool:
        found = list(pool.map(run, (1, 0)))[::-1]  # most fail with shorter links, and that run takes less time
    budget.check()
    if failed and failed[0] == 0:
        return Verified(one, found[0], None, found[0].message, -1.0)
    more = len(members) > 2
    second = found[1] if failed else repeatable(found[0], found[1], SAME_PASS * problem.period if more else SPARE.delay)
    late, links = any(each.strike_time > each.touch_time for each in found), "shorter"
    apart = abs(found[1].strike_time - found[0].strike_time) > SPARE.delay
    if not second.message and more and (late or apart):
        found.append(repeatable(found[1 if apart else 0], run(2)))
        budget.check()
        second, links = (found[2], "other") if found[2].message else (second, links)
    first = None if 0 in failed else found[0]  # it did not end
    message = f"with {links} links {second.message}" if second.message else ""
    return Verified(one, first, second, message, -1.0 if message else margin(problem.criteria, *found))


def repeatable(first: CastOutcome, finer: CastOutcome, most: float = SPARE.delay) -> CastOutcome:
    """Return the outcome with shorter links, as failed if both do not agree on what a real rope does.

    That is so if the rope winds the other way, strikes the target more than `most` s sooner or later, or passes arm,
    shaft or obstacle with little to spare and less than the difference of both runs.
    """
    if not finer.success:
        return finer
    delay, given, now = finer.strike_time - first.strike_time, first.spare_clearance, finer.spare_clearance
    if first.turns * finer.turns < 0.0:
        return replace(finer, message="it winds the other way: the swing is left to chance")
    if abs(delay) > most:
        how = f"strikes the peg {abs(delay):.2f} s {'later' if delay > 0.0 else 'sooner'}"
        return replace(finer, message=f"it {how}, {most:.2g} allowed: the swing is left to chance")
    if min(given, now) < min(SPARE.clearance, abs(given - now)):
        how = f"with {1e3 * now:.1f} mm to spare, not {1e3 * given:.1f} mm"
        return replace(finer, message=f"it passes arm, shaft or obstacle {how}: whether it touches is left to chance")
    return finer


def margin(criteria: WindCriteria, *outcomes: CastOutcome) -> float:
    """Return how much of each criterion is to spare in all outcomes, over what is usual: the least."""
    parts, turns = [], [abs(each.turns) for each in outcomes]
    for each, made in zip(outcomes, turns, strict=True):
        more = made - criteria.turns
        parts += [more / SPARE.turns, (1.0 - each.slip / criteria.max_slip) / SPARE.slip]
        parts += [1.0 / max(each.load_ratio, 1e-9), each.spare_clearance / SPARE.clearance]
        parts += [] if each.tip_hangs else [more / SPARE.falling]
        parts += [0.0] if each.folded else []
    spread = max(turns) - min(turns)
    parts.append((min(turns) - criteria.turns) / max(spread, 1e-9))
    return max(0.0, min(parts))


@dataclass(frozen=True)
class SuccessProbability:
    """Number of sampled scenarios in which moves succeed; 0 samples: not estimated, as no time remained."""

    successes: int
    samples: int

    def __post_init__(self) -> None:
        checks.count("samples", self.samples, least=0)
        if not 0 <= self.successes <= self.samples:
            allowed = f"0 to {self.samples}"
            raise InvalidInput("there are more successes than samples", got=self.successes, allowed=allowed)

    @property
    def estimate(self) -> float:
        """Successes over samples; NaN without samples."""
        return self.successes / self.samples if self.samples else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability (Wilson, 1927); 0 to 1 without samples."""
        if not self.samples:
            return 0.0, 1.0
        from scipy.stats import binomtest

        low, high = binomtest(self.successes, self.samples).proportion_ci(method="wilson")
        return float(low), float(high)

    def __str__(self) -> str:
        if not self.samples:
            return "not estimated, no time was left"
        low, high = self.interval
        counts = f"{self.successes} of {self.samples}"
        return f"{100 * self.estimate:.0f} % ({100 * low:.0f} to {100 * high:.0f} %, {counts})"


@interruptible()
def estimate_success_probability(
    problem: Problem,
    peg: Peg,
    moves: Moves,
    uncertainty: Uncertainty | None = None,
    *,
    samples: int = 40,
    aside: float = 0.0,
    time_budget: float | Budget | None = None,
    options: SearchOptions | None = None,
) -> SuccessProbability:
    """Estimate how often moves wind the rope, clear of arm and obstacles, and it stays wound, in sampled scenarios.

    The moves are made in open loop: they start when planned, apart from the timing noise of each scenario.

    Parameters
    ----------
    uncertainty : Uncertainty, optional
        By default that of a realistic identification. The scenarios of a search are others in any case.
    samples : int
    aside : float
        Distance of the rope from the plane at its first touch over its angle out of it at the start, m/rad: a
        scenario with a tilt that leads to more than the criteria's ``max_sideways`` fails; NaN fails them all.
    time_budget : float or Budget, optional
        Time by the clock, s. Fewer samples are counted if it ends before; it is not used with an executor.
    options : SearchOptions, optional
        Seed, threads, executor and chunk size, COUNTED samples by default.

    Returns
    -------
    SuccessProbability
    """
    options = options or SearchOptions()
    known = uncertainty or Uncertainty()
    scenarios = known.sample(samples, problem, peg, seed=[STREAM, options.seed])
    estimate = _Estimate(problem, moves, pieces_in_contact(problem, peg, options.coarse), aside)
    return count_successes(estimate, scenarios, time_budget, options)


def pieces_in_contact(problem: Problem, peg: Peg, coarse: float) -> int:
    """Return into how many pieces links are cut, so that the longest has so many radii of target and rope at most."""
    return max(1, math.ceil(float(problem.rope.length.max()) / (coarse * (peg.radius + problem.rope.radius))))


def scenario_scores(
    problem: Problem, moves: Moves, scenarios: Sequence[Scenario], pieces: int, budget: Budget, stiction: float = 0.0
) -> WindingScores:
    """Simulate moves in scenarios, each link cut into pieces; `stiction` as of :class:`RolloutBatch`."""
    motion = moves.motion(problem.limits)
    motions = [each.executed_motion(motion) for each in scenarios]
    chain, cut = problem.cut(pieces), [divided(each.rope, pieces) for each in scenarios]
    batch = RolloutBatch.from_start(chain, cut, [each.peg for each in scenarios], motions, stiction)
    return winding_scores(chain, batch, budget, moves.dwell)


def strikes_in_plane(problem: Problem, scenarios: Sequence[Scenario], aside: float) -> Flags:
    """Return in which scenarios the rope strikes within ``max_sideways`` (M,); `aside` is in m/rad of the tilt."""
    most = problem.criteria.max_sideways
    return np.array([math.isinf(most) or abs(each.tilt) * aside <= most for each in scenarios])


@dataclass(frozen=True)
class _Estimate:
    """Counts the scenarios in which moves succeed; it can be sent to an executor."""

    problem: Problem
    moves: Moves
    pieces: int
    aside: float = 0.0

    def __call__(self, scenarios: Sequence[Scenario], budget: Budget | None = None) -> int:
        found = scenario_scores(self.problem, self.moves, scenarios, self.pieces, budget or Budget(threads=1))
        winds = found.turns >= self.problem.criteria.turns
        return int((winds & strikes_in_plane(self.problem, scenarios, self.aside)).sum())


def count_successes(
    work: Callable[..., int], scenarios: Sequence[Any], time_budget: float | Budget | None, options: SearchOptions
) -> SuccessProbability:
    """Count the successes in scenarios until the time is over; on an executor without a limit.

    `work` takes some scenarios, and a budget unless it runs on an executor.
    """
    if options.executor is not None:
        from hyperflex.executor import checked_chunks, refuse_lost, run_chunks

        executor, size = checked_chunks(options.executor, options.chunk_size, COUNTED)
        found: dict[int, int] = {}
        refuse_lost(run_chunks(work, scenarios, executor, size, found.__setitem__), "samples")
        return SuccessProbability(sum(found.values()), len(scenarios))
    budget = Budget.of(time_budget, threads=options.threads)
    successes = counted = 0
    while counted < len(scenarios) and not budget.expired:
        some = scenarios[counted : counted + COUNTED]
        now = work(some, budget)
        if budget.expired:  # some were cut short
            break
        successes, counted = successes + now, counted + len(some)
    return SuccessProbability(successes, counted)
