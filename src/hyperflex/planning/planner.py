"""The planner: sample moves, roll them out, verify them, until some succeed with a margin or the time is over.

A task (winding a target, a whip, an insertion) **samples** moves of the arm with a cheap score, **rolls out** some of
them with a dear one, and **verifies** those whose rollout meets the criterion.

A promising candidate unlike those that have failed is verified at once: nothing else may end the search sooner.
Otherwise each level gets an equal share of the time: the next step is made at the level that has worked least so far
among those with work to do, the dearest first. So many candidates are sampled, fewer rolled out, and few verified,
whatever each costs for a given rope. A candidate like k that have failed is verified for a share of 1 / (1 + k).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperflex.budget import Budget, OutOfTime
from hyperflex.planning.moves import Moves
from hyperflex.planning.problem import Problem

SAMPLE, ROLLOUT, VERIFY = range(3)


@dataclass(frozen=True, eq=False)
class Candidate:
    """Moves of the arm with what is known of them.

    Attributes
    ----------
    moves : Moves
    score : float
        Greater is better. Scores of samples and of rollouts need not be comparable.
    t : float
        When the moves reach their goal, s: the strike, the tip's pass, its entry.
    good : bool
        Whether a rollout meets the task's criterion, so that the candidate is worth a verification.
    """

    moves: Moves
    score: float
    t: float
    good: bool = False


@dataclass(frozen=True, eq=False)
class Verified:
    """Moves with the outcomes of their verified runs.

    Attributes
    ----------
    candidate : Candidate
    outcome, finer_outcome
        With the links as planned, and with finer links; None if there was no such run.
    message : str
        Why the moves fail; empty if they succeed.
    margin : float
        How much of each criterion is to spare, over what is usual: the least. Below 0 for moves that fail.
    """

    candidate: Candidate
    outcome: Any
    finer_outcome: Any
    message: str
    margin: float = 0.0


class Task(ABC):
    """A task of the planner.

    Attributes
    ----------
    problem : Problem
    batch : int
        Candidates that are rolled out at once.
    enough : float
        Margin with which a search ends.
    ready : float
        Least score of a sample that is rolled out before others are drawn.
    runs : int
        Simulated runs so far.
    """

    problem: Problem
    batch: int = 1
    enough: float = 0.0
    ready: float = math.inf
    runs: int = 0

    @abstractmethod
    def sample(self, found: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Return new candidates with cheap scores; none if there are no more. `found` are rollouts, the best first."""

    @abstractmethod
    def rollout(self, some: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Return candidates with dear scores, made from `some` samples: fewer, as many or more."""

    def alike(self, one: Candidate, other: Candidate) -> bool:
        """Whether two candidates are so alike that they mostly fail alike."""
        return False

    @abstractmethod
    def verify(self, one: Candidate, budget: Budget) -> Verified:
        """Verify a candidate; ends at the first reason to fail. Raises OutOfTime if the budget ends before."""


class Planner:
    """A search for moves that do a task.

    Parameters
    ----------
    task : Task
    budget : Budget
    improve : float
        A plan that succeeds without a margin is improved for this fraction of the time that it took to find, one with a
        part of the margin for as much less, and not where another verification would end later.
    on_improvement : callable, optional
        Called without arguments when a plan succeeds, and at each better one; ends the search by returning True.
    sampling : float
        Time, s, that samples took before the search.

    Attributes
    ----------
    best : Verified or None
        The best verified moves so far.
    rolled : list of Candidate
        Candidates after their rollouts, the best first.
    """

    def __init__(
        self,
        task: Task,
        budget: Budget,
        improve: float,
        on_improvement: Callable[[], bool | None] | None = None,
        sampling: float = 0.0,
    ) -> None:
        self.task, self.budget, self.improve, self.on_improvement = task, budget, improve, on_improvement
        self.best: Verified | None = None
        self.sampled: list[Candidate] = []
        self.rolled: list[Candidate] = []
        self._tried: list[Candidate] = []
        self._sampling, self._spent = sampling, [sampling, 0.0, 0.0]
        self._exhausted = self._ended = False
        self._until, self._needed = math.inf, 0.0

    @property
    def succeeds(self) -> bool:
        """Whether verified moves succeed."""
        return self.best is not None and not self.best.message

    def run(self) -> None:
        """Search until moves succeed with a margin, no time is left, or there is nothing more to try."""
        while not self._done() and (levels := self._with_work()):
            promising = self._promising()
            failed = 0 if promising is None else self._failed_alike(promising)
            shares = [1.0, 1.0, 1.0 / (1.0 + failed)]
            new = promising is not None and not failed
            level = VERIFY if new else min(levels, key=lambda one: (self._spent[one] / shares[one], -one))
            before = self.budget.elapsed
            try:
                (self._sample, self._rollout, self._verify)[level]()
            except OutOfTime:
                return
            self._spent[level] += self.budget.elapsed - before
            self.budget.report()

    def explain(self, budget: Budget) -> None:
        """Verify the best rollout if nothing was verified: its runs show why it fails. May raise OutOfTime."""
        if self.best is None and self.rolled and not budget.expired:
            self.best = self.task.verify(self.rolled[0], budget)

    def _done(self) -> bool:
        enough = self.succeeds and self.best is not None and self.best.margin >= self.task.enough
        late = self.budget.elapsed + self._needed > self._until
        return enough or self._ended or self.budget.expired or late

    def _with_work(self) -> list[int]:
        """Return the levels that have something to do."""
        waiting = self.sampled and self.sampled[0].score >= self.task.ready
        work = [] if self._exhausted or waiting else [SAMPLE]
        work += [ROLLOUT] if self.sampled else []
        return [*work, VERIFY] if self._promising() is not None else work

    def _promising(self) -> Candidate | None:
        """Return the best candidate that is worth a verification, of those least like others that have failed."""
        good = [one for one in self.rolled if one.good and not any(one is other for other in self._tried)]
        return min(good, key=lambda one: (self._failed_alike(one), -one.score), default=None)

    def _failed_alike(self, one: Candidate) -> int:
        """Return how many candidates like this one have failed; 0 once one has succeeded."""
        return 0 if self.succeeds else sum(self.task.alike(one, other) for other in self._tried)

    def _sample(self) -> None:
        found = self.task.sample(self.rolled, self.budget)
        self._exhausted = not found
        self.sampled = sorted([*self.sampled, *found], key=lambda one: -one.score)

    def _rollout(self) -> None:
        best = (self.task.batch + 1) // 2  # half of them the best, others from all of the queue
        others = np.linspace(best, len(self.sampled) - 1, self.task.batch - best).round().astype(int).tolist()
        chosen = {*range(best), *others} & {*range(len(self.sampled))}
        some = [self.sampled[k] for k in sorted(chosen)]
        self.sampled = [one for k, one in enumerate(self.sampled) if k not in chosen]
        self.rolled = sorted([*self.rolled, *self.task.rollout(some, self.budget)], key=lambda one: -one.score)

    def _verify(self) -> None:
        one = self._promising()
        if one is None:
            return
        self._tried.append(one)
        before = self.budget.elapsed
        found = self.task.verify(one, self.budget)
        if not found.message:
            self._needed = self.budget.elapsed - before  # another verification takes as long
        if self.best is None or (not found.message, found.margin) > (not self.best.message, self.best.margin):
            self.best = found
            if self.succeeds:
                missing = max(0.0, 1.0 - found.margin / self.task.enough) if self.task.enough else 0.0
                more = self.improve * missing if missing else 0.0
                self._until = min(self._until, self.budget.elapsed + more * (self._sampling + self.budget.elapsed))
                self._ended = self.on_improvement is not None and bool(self.on_improvement())
