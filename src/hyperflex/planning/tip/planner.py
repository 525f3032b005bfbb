"""The planner of tasks of the tip: swings are aimed one after the other, and the best ones are verified."""

import math
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

from hyperflex.planning.time_budget import Clock, OutOfTime
from hyperflex.planning.tip.aim import aim_strokes
from hyperflex.planning.tip.swings import StrokeSearch
from hyperflex.planning.tip.task import Aimed, TipCandidate, TipTask, Verified
from hyperflex.simulation import Deadline

SEARCHING = 0.8  # fraction of the time after which plans are only verified
STALLED = 0.9  # of the cost: a search that leaves more does not go on, else the same one does so again and again
PLANS = 3  # plans that do what is asked, of which the least uncertain one that succeeds is taken; if none, the next


class TipPlanner:
    """Aims swings until enough of them do what is asked or the `time_budget`, s without compiling, is over."""

    def __init__(self, task: TipTask[Any], time_budget: float, seed: int, threads: int | None) -> None:
        self.task, self.time_budget, self.seed, self.threads = task, time_budget, seed, threads
        self.clock = Clock()
        self.end = Deadline(math.inf, lambda: self.time_budget - self.clock.spent)
        self.aims: list[Aimed] = []
        self._seen: list[Aimed] = []  # that were verified
        self._best: Verified | None = None
        self._unverified = "interrupted before it was verified"

    def left(self) -> float:
        """Return the time that is left for the search, s."""
        return SEARCHING * self.time_budget - self.clock.spent

    def run(self, report: Callable[[], None] | None) -> None:
        """Aim and verify until a plan succeeds, all swings were aimed, or no time is left; `report` is called often."""
        aimed = self._aimed()
        while self._add(aimed, report):
            self.verify()
            if self.succeeds or self.left() < 0.0:
                return
        self.verify()

    def _aimed(self) -> Iterator[Aimed | None]:
        """Aim one swing after the other, the cheapest first, then what searches about them find.

        After each search begun the cheapest one of those before it goes on, and one more swing is aimed as it is.
        """
        candidates, begun, count = iter(self.task.candidates()), list[tuple[TipCandidate, int]](), 0
        for found in islice(candidates, self.task.direct):
            yield aim_strokes(self.task, found, self.left)
        for start in self.task.starts():
            begun.sort(key=lambda each: each[0].cost)
            for found, number in [(start, 0), *begun[:1]]:
                search = StrokeSearch(self.task, self.task.freed(found, number), self.seed + count, self.threads)
                best, count = search.run(self.left), count + 1
                yield aim_strokes(self.task, best, self.left)
                begun = [each for each in begun if each[0] is not found]
                if self.task.ready <= best.cost < STALLED * found.cost and number + 1 < self.task.rounds:
                    begun.append((best, number + 1))
            for other in islice(candidates, 1):
                yield aim_strokes(self.task, other, self.left)

    def _add(self, aimed: Iterator[Aimed | None], report: Callable[[], None] | None) -> bool:
        """Keep plans until enough do what is asked, or no time is left; return False where there are no more."""
        for aim in aimed:
            if aim is not None:
                self.aims.append(aim)
                self.aims.sort(key=self.rank)
            if report is not None:
                report()
            if self.left() < 0.0 or sum(self.rank(one)[0] == 0.0 for one in self._unseen()) >= PLANS:
                return True
        return False

    def _unseen(self) -> list[Aimed]:
        """Plans that were not verified yet, the best first."""
        return [one for one in self.aims if not any(one is other for other in self._seen)]

    @property
    def succeeds(self) -> bool:
        """Whether the best plan was verified and succeeds."""
        return self._best is not None and not self._best.message

    def rank(self, aim: Aimed) -> tuple[float, float]:
        """By how much a plan fails, then how uncertain it is; less is better."""
        return self.task.shortfall(aim), self.task.uncertainty(aim)

    def verify(self) -> None:
        """Verify the best plan, and while none succeeds those after it that do what is asked by the search.

        Those verified before are left out. The best is then the first that succeeds, else the first of all.
        """
        for aim in self._unseen()[:PLANS]:
            if self._best is not None and self.rank(aim)[0] > 0.0:
                break
            try:
                found = self.task.verify(aim, self.end)
            except OutOfTime:
                self._unverified = "the time budget ended before it was verified"
                break
            self._seen.append(aim)
            if self._best is None or not found.message:
                self._best = found
            if not found.message:
                break

    def fields(self, nothing: str) -> dict[str, Any]:
        """Return the fields of a plan of the best strokes; its message is `nothing` where none were found."""
        if (best := self.best) is None:
            return {"message": nothing, "runs": self.task.runs}
        aim, outcome, finer, message = best
        found = {"strokes": aim.strokes, "position_std": aim.position_std, "outcome": outcome, "finer_outcome": finer}
        return found | {"message": message, "runs": self.task.runs}

    @property
    def best(self) -> Verified | None:
        """The best plan, verified or not yet; None if none was found."""
        if self._best is None and self.aims:
            return Verified(self.aims[0], None, None, self._unverified)
        return self._best
