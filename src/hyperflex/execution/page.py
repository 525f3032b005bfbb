"""A page in the browser that shows a run on a drive as it happens, with a button that stops it."""

import json
import math
import os
import signal
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib import resources
from typing import Any

from hyperflex.checks import ByName
from hyperflex.execution.stream import FIELDS, MotionStream
from hyperflex.interfaces import RopeState
from hyperflex.local_page import LocalServer, send
from hyperflex.planning import CastPlan

SHOWN = 10.0  # s of the drive's past that the page draws
POINTS = 200  # of it


class RunPage(LocalServer):
    """Serves a run to browsers on this machine. Its stop button ends the drive's process: the torque is switched off.

    It is no emergency stop: that is a switch that cuts the supply.

    Parameters
    ----------
    plan : CastPlan
    port : int
        0: any that is free; see `address`.
    motor : str
        The drive, in words.

    Raises
    ------
    InvalidInput
        If the port is taken, or not allowed.
    """

    def __init__(self, plan: CastPlan, port: int = 0, motor: str = "a drive") -> None:
        super().__init__(port)
        self.plan, self.motor, self.phase, self.over = plan, motor, "preparing", False
        self._drive: MotionStream | None = None
        self._source: Any = None
        self._state: Callable[[], RopeState | None] = lambda: None
        self.start()

    def say(self, phase: str) -> None:
        """Show a phase of the run, a line."""
        self.phase = phase

    def attach(self, drive: MotionStream, state: Callable[[], RopeState | None], source: Any = None) -> None:
        """Show a drive from now on, the rope's newest state that `state` returns, and markers that a `source` sees."""
        self._drive, self._state, self._source = drive, state, source

    def end(self, verdict: str) -> None:
        """Show how the run ended; there is nothing to stop any more."""
        self.phase, self.over = verdict, True

    def stop(self) -> bool:
        """Switch the torque off at once, then end the run as Ctrl-C does; return whether the device confirmed."""
        confirmed = self._drive is None or self._drive.stop()
        if not self.over:
            os.kill(os.getpid(), signal.SIGINT)
        return confirmed

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Answer with the page or the newest figures, or stop the run."""
        if request.path == "/":
            send(request, resources.files(__package__).joinpath("templates/run.html").read_text("utf-8"), "text/html")
        elif request.path == "/state":
            send(request, json.dumps(self.figures()), "application/json")
        elif request.path == "/stop" and request.command == "POST":
            send(request, json.dumps({"off": self.stop()}), "application/json")
        else:
            request.send_error(HTTPStatus.NOT_FOUND)

    def figures(self) -> ByName:
        """Return what the page shows: phase, arm, goal and drive, their past, and the rope if it is seen."""
        problem, peg = self.plan.problem, self.plan.target
        shown: ByName = {
            "motor": self.motor,
            "phase": self.phase,
            "over": self.over,
            "limits": problem.limits.angles,
        }
        shown |= {"pivot": problem.arm.pivot, "reach": problem.arm.length + problem.rope.total_length}
        shown |= {"peg": [peg.x, peg.y, peg.radius], "rope": None, "now": None, "past": []}
        if self._drive is None:
            return shown
        log = self._drive.log()
        rows = log.rows[-math.ceil(SHOWN * log.rate) :: max(1, round(SHOWN * log.rate / POINTS))]
        if not len(log.rows):
            return shown
        now = dict(zip(FIELDS, log.rows[-1].tolist(), strict=True))
        shown["now"] = {name: value if math.isfinite(value) else None for name, value in now.items()}
        shown["now"]["missed"] = log.missed
        columns = [FIELDS.index(name) for name in ("sent", "goal_angle", "angle")]
        shown["past"] = rows[:, columns].round(5).tolist()
        tip = problem.arm.tip(now["angle"])
        shown["arm"] = tip.tolist()
        state = self._state()
        if state is not None:
            shown["rope"] = problem.rope.joints(state.q, tip).round(4).tolist()
        shown["markers"] = [places.round(4).tolist() for _, places in getattr(self._source, "spots", [])[-1:]]
        return shown
