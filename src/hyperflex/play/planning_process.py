"""Planning in a separate process, so that the rope continues to move and planning can be cancelled at once."""

import os
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Literal, NamedTuple

from hyperflex.child import Child
from hyperflex.errors import HyperflexError
from hyperflex.model import Arm, Obstacle, Peg, Rope
from hyperflex.planning import (
    CastPlan,
    Conditions,
    MotorLimits,
    SearchOptions,
    TipTarget,
    WhipPlan,
    plan_cast,
    plan_whip,
)

_BEGIN, _FOUND, _END = range(3)  # kinds of answers: the search begins, a plan succeeds, the last plan


class PlanningTask(NamedTuple):
    """A planning task: a cast on the target or a whip to its centre, with obstacles; `time_budget` in s."""

    kind: Literal["cast", "whip"]
    rope: Rope
    arm: Arm
    target: Peg
    obstacles: tuple[Obstacle, ...]
    limits: MotorLimits
    time_budget: float

    def plan(self, on_plan: Callable[[CastPlan], None]) -> CastPlan | WhipPlan:
        """Plan, with one processor left to others; `on_plan` is called with each better plan for a cast."""
        common: dict[str, Any] = {
            "conditions": Conditions(obstacles=self.obstacles),
            "time_budget": self.time_budget,
            "options": SearchOptions(threads=max(1, (os.cpu_count() or 2) - 1)),
        }
        if self.kind == "cast":
            return plan_cast(self.rope, self.arm, self.target, self.limits, on_plan=on_plan, **common)
        return plan_whip(self.rope, self.arm, TipTarget(self.target.x, self.target.y), self.limits, **common)


class PlanningProcess:
    """A process that plans. It starts immediately.

    Attributes
    ----------
    task : PlanningTask
    begun : float
        When the search began, s of the monotonic clock; 0.0 while the process starts.
    best : CastPlan or None
        The best plan so far, during the search.
    """

    def __init__(self, task: PlanningTask) -> None:
        self.task, self.begun = task, 0.0
        self.best: CastPlan | None = None
        self._child = Child("The planning process", HyperflexError, work, task)
        self._child.launch()

    def result(self) -> CastPlan | WhipPlan | str | None:
        """Return the plan or the error message; None while there is neither."""
        try:
            while self._child.link.poll():
                kind, answer = self._child.receive(0.0)
                if kind == _END:
                    self.cancel()
                    return answer  # type: ignore[no-any-return]
                if kind == _BEGIN:
                    self.begun = time.monotonic()
                else:
                    self.best = answer
        except HyperflexError as error:
            self.cancel()
            return str(error)
        return None

    def cancel(self) -> None:
        """End the process."""
        self._child.end()


def work(link: Connection, task: PlanningTask) -> None:
    """Plan; send that the search begins, plans that succeed, and the last one."""
    with suppress(AttributeError, OSError):  # Windows has no nice
        os.nice(10)
    link.send((0, (_BEGIN, None)))
    link.send((0, (_END, task.plan(lambda plan: link.send((0, (_FOUND, plan)))))))
