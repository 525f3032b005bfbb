"""Planning in a process of its own, so that the rope goes on moving, and can be cancelled at once."""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import time
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Literal, NamedTuple

from hyperflex.errors import HyperflexError
from hyperflex.model import Arm, Obstacle, Peg, Rope
from hyperflex.planning import CastPlan, MotorLimits, WhipPlan, plan_cast, plan_whip

NICENESS = 10
_END_TIMEOUT = 0.5  # s until a process that does not end is killed
_COMMAND = "import sys; from hyperflex.play.planning_process import work; work(int(sys.argv[1]))"


class PlanningTask(NamedTuple):
    """What is planned: a cast round the target, or a whip to its centre, past obstacles; `time_budget` in s."""

    kind: Literal["cast", "whip"]
    rope: Rope
    arm: Arm
    target: Peg
    obstacles: tuple[Obstacle, ...]
    limits: MotorLimits
    time_budget: float

    def plan(self) -> CastPlan | WhipPlan:
        """Plan it, and leave one processor to others."""
        given: dict[str, Any] = {"time_budget": self.time_budget, "threads": max(1, (os.cpu_count() or 2) - 1)}
        given["obstacles"] = self.obstacles
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
        self.task, self.begun = task, 0.0
        self._answers, answers = Pipe(duplex=False)
        command = [
            sys.executable,
            "-c",
            _COMMAND,
            str(answers.fileno()),
        ]  # a program of its own: no main module runs twice
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, pass_fds=[answers.fileno()])
        answers.close()
        if self._process.stdin is not None:
            with self._process.stdin as told, contextlib.suppress(OSError):  # it has ended: there will be no answer
                told.write(pickle.dumps(task))

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
        try:
            self._process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._answers.close()


def work(descriptor: int) -> None:
    """Read a task from standard input; send that the search begins (None), then the plan or what went wrong."""
    answers: Connection = Connection(descriptor, readable=False)
    task: PlanningTask = pickle.load(sys.stdin.buffer)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the page, which ends this process
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    try:
        answers.send(None)
        answers.send(task.plan())
    except HyperflexError as error:
        answers.send(str(error))
