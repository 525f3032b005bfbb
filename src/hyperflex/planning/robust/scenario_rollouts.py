"""Throws in sampled scenarios: batch rollouts, and the success probability that they estimate."""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.executor import checked_chunks, refuse_lost, run_chunks
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, Peg
from hyperflex.planning.clearance import clear_samples, samples_clear_of_arm
from hyperflex.planning.problem import Problem
from hyperflex.planning.robust.uncertainty import Scenario, Uncertainty
from hyperflex.planning.search import strikes
from hyperflex.planning.search.contact_phase import TIME_BUDGET, WindingScores, simulate_contact
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.throw import Throw
from hyperflex.planning.time_budget import Clock
from hyperflex.simulation import Deadline

AFTER_STOP = 0.5  # s after the arm's stop within which a strike still counts
COUNTED = 8  # samples of an estimate between two looks at the time
TOGETHER = 128  # rollouts at once; more would fill the memory
MIN_FLIGHT = 0.5  # s of free flight, at least
Z_95 = 1.959963984540054  # standard deviations on either side that hold 95 %
SAMPLES = 40
STREAM = 7001  # random stream of an estimate, apart from those of a search


def scenario_scores(
    problem: Problem,
    pairs: Sequence[tuple[Throw, Scenario]],
    *,
    time_budget: float | Deadline = TIME_BUDGET,
    threads: int | None = None,
) -> WindingScores:
    """Simulate throws in scenarios (M), each rope from its start; see :func:`winding_scores`."""
    motions = [scenario.motion(throw, problem) for throw, scenario in pairs]
    ropes, pegs = [each.rope for _, each in pairs], [each.peg for _, each in pairs]
    batch = RolloutBatch.from_start(problem, ropes, pegs, motions)
    return winding_scores(batch, problem, time_budget=time_budget, threads=threads)


def winding_scores(
    batch: RolloutBatch,
    problem: Problem,
    *,
    time_budget: float | Deadline = TIME_BUDGET,
    threads: int | None = None,
) -> WindingScores:
    """Simulate throws (M,) in free flight until they strike, and in contact from there.

    They must strike within the time of the set-up, on the clock of `batch.since`; a strike until AFTER_STOP after the
    arm's stop counts in any case. Turns are 0 without a strike or if a run fails, and too few for a rope that comes too
    near arm, shaft or an obstacle, as in a verification. Ropes and pegs are those of the batch.
    """
    score, turns = np.full(len(batch), strikes.NEVER), np.zeros(len(batch))
    for low in range(0, len(batch), TOGETHER):
        rows = range(low, min(low + TOGETHER, len(batch)))
        part = batch.select(rows)
        end = Deadline(math.inf, time_budget.left) if isinstance(time_budget, Deadline) else None
        t, q, qd, gap = first_strikes(part, problem, time_budget=end, threads=threads)
        score[low : rows.stop] -= gap
        hit = np.flatnonzero(np.isfinite(t))
        if hit.size:
            some = part.select(hit.tolist())
            motions = [motion.shifted(-at) for motion, at in zip(some.motions, t[hit], strict=True)]
            struck = replace(some, motions=motions, q=q[hit], qd=qd[hit])
            begin = t[hit] + batch.since
            found = simulate_contact(struck, begin, problem, time_budget=time_budget, threads=threads)
            score[low + hit], turns[low + hit] = found.score, found.turns
    return WindingScores(score, turns)


def first_strikes(
    batch: RolloutBatch, problem: Problem, *, time_budget: Deadline | None = None, threads: int | None = None
) -> tuple[Array, Array, Array, Array]:
    """Simulate free flight until the first strikes; one before which the rope came too near its arm is none.

    Those that are not done within a `time_budget` do not strike.

    Returns
    -------
    t : (M,) float64
        Last sample before the strike, s from the start of the rollout; NaN without a strike.
    q, qd : (M, n) float64
        State there, rad and rad/s.
    gap : (M,) float64
        Smallest gap until then, m.
    """
    arm, clearance = problem.arm, problem.clearance
    least = max(problem.time - batch.since, MIN_FLIGHT)
    until = np.array([max(least, float(motion.breaks[-1]) + AFTER_STOP) for motion in batch.motions])
    t, q, qd = free_flight(batch, arm, float(until.max()), time_budget=time_budget, threads=threads)
    base = np.stack([strikes.arm_tip(arm, motion, t)[0] for motion in batch.motions])
    lengths = np.stack([rope.length for rope in batch.ropes])
    finite: Array = np.asarray(np.isfinite(q).all(axis=2))
    at, gap = np.zeros(len(batch), dtype=np.int64), np.zeros(len(batch))
    for peg in dict.fromkeys((peg.x, peg.y, peg.radius) for peg in batch.pegs):
        same = [m for m, one in enumerate(batch.pegs) if (one.x, one.y, one.radius) == peg]
        at[same], _, gap[same] = strikes.first_contact(
            q[same], base[same], lengths[same], Peg(*peg), batch.ropes[0].radius
        )
    rows, before = np.arange(len(batch)), np.maximum(at - 1, 0)
    good = np.where(finite.all(axis=1), t.size, finite.argmin(axis=1)) > at  # until the strike
    good &= (t[before] <= until) & (at <= clear_samples(batch.ropes, batch.obstacles, q, base, clearance))
    for m in np.flatnonzero(good & (at > 0)).tolist():
        one = slice(m, m + 1)
        good[m] = at[m] <= samples_clear_of_arm(batch.ropes[m], arm, q[one], base[one], clearance, at[one])[0]
    hit = (at > 0) & good
    return np.where(hit, t[before], np.nan), q[rows, before], qd[rows, before], gap


def free_flight(
    batch: RolloutBatch,
    arm: Arm,
    span: float,
    *,
    at_end: bool = False,
    time_budget: Deadline | None = None,
    threads: int | None = None,
) -> tuple[Array, Array, Array]:
    """Simulate free flight for a span, s; return samples t (T,), q and qd (M, T, n). `at_end`: of the end alone."""
    t: Array = strikes.SAMPLE_TIME * np.arange(1.0, np.ceil(span / strikes.SAMPLE_TIME - 1e-9) + 1.0)
    t = np.array([span]) if at_end else t
    given: dict[str, Any] = {"time_budget": time_budget, "threads": threads}
    run = batch.run(arm, t, tol=strikes.COARSE_TOL, keep=("q", "qd"), **given)
    return t, run.q, run.qd


def nominal_strike_times(
    problem: Problem,
    peg: Peg,
    throws: Sequence[Throw],
    *,
    time_budget: Deadline | None = None,
    threads: int | None = None,
) -> Array:
    """Return the times (M,), s, at which throws strike in the nominal scenario; NaN without a strike."""
    motions = [throw.motion(problem.limits) for throw in throws]
    batch = RolloutBatch.from_start(problem, [problem.rope] * len(throws), [peg] * len(throws), motions)
    return first_strikes(batch, problem, time_budget=time_budget, threads=threads)[0]


@dataclass(frozen=True)
class SuccessProbability:
    """Number of sampled scenarios in which a throw succeeds; 0 samples: not estimated, as no time was left."""

    successes: int
    samples: int

    def __post_init__(self) -> None:
        checks.count("samples", self.samples, least=0)
        if not 0 <= self.successes <= self.samples:
            raise InvalidInput(
                "there are more successes than samples", got=self.successes, allowed=f"0 to {self.samples}"
            )

    @property
    def estimate(self) -> float:
        """Successes over samples; NaN without samples."""
        return self.successes / self.samples if self.samples else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability (Wilson, 1927); 0 to 1 without samples."""
        if not self.samples:
            return 0.0, 1.0
        n, p, z = self.samples, self.estimate, Z_95
        centre = (p + z**2 / (2.0 * n)) / (1.0 + z**2 / n)
        half = z / (1.0 + z**2 / n) * math.sqrt(p * (1.0 - p) / n + z**2 / (4.0 * n**2))
        low, high = max(0.0, centre - half), min(1.0, centre + half)
        return (0.0 if self.successes == 0 else low), (1.0 if self.successes == n else high)

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
    throw: Throw,
    uncertainty: Uncertainty | None = None,
    *,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int | None = None,
    time_budget: float = math.inf,
    executor: Executor | None = None,
    chunk_size: int | None = None,
) -> SuccessProbability:
    """Estimate how often a throw winds, clear of arm and obstacles, and stays wound, by simulation of scenarios.

    The throw is made in open loop: its moves start when planned, apart from the timing noise of each scenario. By
    default the uncertainty is that of a realistic identification. The scenarios of a search are others in any case.
    With a `time_budget`, s, by the clock, fewer samples may be counted, as the result tells, and none where COUNTED of
    them take longer. It counts only without an `executor`, on which chunks of `chunk_size` samples are simulated,
    COUNTED by default (see ``docs/how-to/many-machines.md``; WorkerLost if they kill its workers).
    """
    known = uncertainty or Uncertainty()
    scenarios = known.sample(samples, problem, peg, seed=[STREAM, checks.count("seed", seed, least=0)])
    executor, size = checked_chunks(executor, chunk_size, COUNTED)
    if executor is not None:
        wins: dict[int, int] = {}
        work = partial(_wins, problem=problem, throw=throw, threads=threads or 1)
        refuse_lost(run_chunks(work, scenarios, executor, size, wins.__setitem__), "samples")
        return SuccessProbability(sum(wins.values()), len(scenarios))
    clock, won, counted = Clock(), 0, 0

    def left() -> float:
        return time_budget - clock.spent

    while counted < samples and left() > 0.0:
        some = [(throw, scenario) for scenario in scenarios[counted : counted + COUNTED]]
        end = Deadline(TIME_BUDGET, left)
        found = scenario_scores(problem, some, time_budget=end, threads=threads)
        if left() < 0.0:  # some were cut short
            break
        won, counted = won + int((found.turns >= problem.turns).sum()), counted + len(some)
    return SuccessProbability(won, counted)


def _wins(scenarios: list[Scenario], problem: Problem, throw: Throw, threads: int) -> int:
    """Return in how many scenarios a throw succeeds."""
    found = scenario_scores(problem, [(throw, scenario) for scenario in scenarios], threads=threads)
    return int((found.turns >= problem.turns).sum())
