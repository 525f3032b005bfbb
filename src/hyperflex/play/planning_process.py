"""Planning in a separate process, so that the rope continues to move and planning can be cancelled at once."""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Literal, NamedTuple

from hyperflex.errors import HyperflexError, InvalidInput
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

_BEGIN, _FOUND, _END = range(3)  # kinds of answers: the search begins, a plan succeeds, the last plan or an error
_COMMAND = "import sys; from hyperflex.play.planning_process import work; work(int(sys.argv[1]))"


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
        if sys.platform == "win32":  # no process inherits a pipe there by its number
            fix = "Plan by hyperflex cast, and open its cast.toml here"
            raise InvalidInput("the page does not plan on Windows", fix=fix)
        self.task, self.begun = task, 0.0
        self.best: CastPlan | None = None
        self._answers, answers = Pipe(duplex=False)
        number = answers.fileno()
        command = [sys.executable, "-c", _COMMAND, str(number)]  # a separate program: no main module runs twice
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, pass_fds=[number])
        answers.close()
        if self._process.stdin is not None:
            with self._process.stdin as stream, contextlib.suppress(OSError):  # it has ended: there will be no answer
                stream.write(pickle.dumps(task))

    def result(self) -> CastPlan | WhipPlan | str | None:
        """Return the plan or the error message; None while there is neither."""
        try:
            while self._answers.poll():
                kind, answer = self._answers.recv()
                if kind == _END:
                    self.cancel()
                    return answer  # type: ignore[no-any-return]
                if kind == _BEGIN:
                    self.begun = time.monotonic()
                else:
                    self.best = answer
        except (EOFError, OSError):
            self.cancel()
            return "the planning process ended without an answer"
        return None

    def cancel(self) -> None:
        """End the process."""
        self._process.terminate()
        try:
            self._process.wait(0.5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._answers.close()


def work(descriptor: int) -> None:
    """Read a task from standard input; send that the search begins, plans that succeed, and how it ended."""
    answers: Connection = Connection(descriptor, readable=False)
    task: PlanningTask = pickle.load(sys.stdin.buffer)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the page, which ends this process
    with contextlib.suppress(OSError):
        os.nice(10)
    try:
        answers.send((_BEGIN, None))
        answers.send((_END, task.plan(lambda plan: answers.send((_FOUND, plan)))))
    except HyperflexError as error:
        answers.send((_END, str(error)))
