"""Planning in a process of its own, so that the rope goes on moving, and can be cancelled at once."""

import contextlib
import multiprocessing
import os
import signal
import time
from multiprocessing.connection import Connection
from typing import Any, Literal, NamedTuple

from hyperflex.errors import HyperflexError
from hyperflex.model import Arm, Peg, Rope
from hyperflex.planning import CastPlan, MotorLimits, WhipPlan, plan_cast, plan_whip

NICENESS = 10
_PATIENCE = 0.5  # s until a process that does not end is killed


class PlanningTask(NamedTuple):
    """What is planned: a cast round the target, or a whip to its centre; `time_budget` in s."""

    kind: Literal["cast", "whip"]
    rope: Rope
    arm: Arm
    target: Peg
    limits: MotorLimits
    time_budget: float

    def plan(self) -> CastPlan | WhipPlan:
        """Plan it, and leave one processor to others."""
        given: dict[str, Any] = {"time_budget": self.time_budget, "threads": max(1, (os.cpu_count() or 2) - 1)}
        if self.kind == "cast":
            return plan_cast(self.rope, self.arm, self.target, self.limits, **given)
        return plan_whip(self.rope, self.arm, (self.target.x, self.target.y), None, self.limits, **given)


class PlanningProcess:
    """A process that plans; it begins at once.

    Attributes
    ----------
    task : PlanningTask
    begun : float
        When the search began, s of the monotonic clock; 0.0 while the process starts.
    """

    def __init__(self, task: PlanningTask) -> None:
        context = multiprocessing.get_context("spawn")
        self.task, self.begun = task, 0.0
        self._answers, answers = context.Pipe(duplex=False)
        self._process = context.Process(target=_work, args=(answers, task), daemon=True)
        self._process.start()
        answers.close()

    def result(self) -> CastPlan | WhipPlan | str | None:
        """Return the plan, or what went wrong, once there is one of both; else None."""
        try:
            while self._answers.poll():
                answer = self._answers.recv()
                if answer is not None:
                    self.cancel()
                    return answer  # type: ignore[no-any-return]
                self.begun = time.monotonic()
        except (EOFError, OSError):
            self.cancel()
            return "the planning process ended without a word"
        return None

    def cancel(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join(_PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._answers.close()


def _work(answers: Connection, task: PlanningTask) -> None:
    """Say that the search begins (None), plan, and send the plan or what went wrong."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the page, which ends this process
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    try:
        answers.send(None)
        answers.send(task.plan())
    except HyperflexError as error:
        answers.send(str(error))
