"""The planner's loop: sample, roll out, verify, until moves succeed with a margin or the time is over.

A promising candidate unlike those that have failed is verified at once: nothing else may end the search sooner.
Otherwise each level gets an equal share of the time: the next step is made at the level that has worked least so far
among those with work to do, the dearest first. So many candidates are sampled, fewer rolled out, and few verified,
whatever each costs for a given rope.
"""

from collections.abc import Callable

import numpy as np

from hyperflex.budget import Budget, OutOfTime
from hyperflex.planning.tasks.task import Candidate, Task, Verified

SAMPLE, ROLLOUT, VERIFY = range(3)


class Planner:
    """A search for moves that do a task.

    Parameters
    ----------
    task : Task
    budget : Budget
    improve : float
        A plan that succeeds without a margin is improved for this fraction of the time that it took to find, one with a
        part of the margin for as much less.
    on_improvement : callable, optional
        Called without arguments when a plan succeeds, and at each better one; ends the search by returning True.

    Attributes
    ----------
    best : Verified or None
        The best verified moves so far.
    rolled : list of Candidate
        Candidates after their rollouts, the best first.
    """

    def __init__(
        self, task: Task, budget: Budget, improve: float, on_improvement: Callable[[], bool | None] | None = None
    ) -> None:
        self.task, self.budget, self.improve, self.on_improvement = task, budget, improve, on_improvement
        self.best: Verified | None = None
        self.sampled: list[Candidate] = []
        self.rolled: list[Candidate] = []
        self._tried: list[Candidate] = []
        self._spent = [0.0, 0.0, 0.0]
        self._exhausted = self._ended = False
        self._until = float("inf")

    @property
    def succeeds(self) -> bool:
        """Whether verified moves succeed."""
        return self.best is not None and not self.best.message

    def run(self) -> None:
        """Search until moves succeed with a margin, no time is left, or there is nothing more to try."""
        while not self._done() and (levels := self._with_work()):
            promising = self._promising()
            new = promising is not None and not self._failed_alike(promising)
            level = VERIFY if new else min(levels, key=lambda one: (self._spent[one], -one))
            before = self.budget.elapsed
            try:
                (self._sample, self._rollout, self._verify)[level]()
            except OutOfTime:
                return
            self._spent[level] += self.budget.elapsed - before
            self.budget.report()

    def _done(self) -> bool:
        enough = self.succeeds and self.best is not None and self.best.margin >= self.task.enough
        return enough or self._ended or self.budget.expired or self.budget.elapsed > self._until

    def _with_work(self) -> list[int]:
        """Return the levels that have something to do."""
        work = [] if self._exhausted else [SAMPLE]
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
        found = self.task.verify(one, self.budget)
        if self.best is None or (not found.message, found.margin) > (not self.best.message, self.best.margin):
            self.best = found
            if self.succeeds:
                missing = max(0.0, 1.0 - found.margin / self.task.enough) if self.task.enough else 0.0
                more = self.improve * missing if missing else 0.0
                self._until = min(self._until, (1.0 + more) * self.budget.elapsed)
                self._ended = self.on_improvement is not None and bool(self.on_improvement())
