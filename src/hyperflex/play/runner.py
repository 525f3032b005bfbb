"""The thread that advances a session in real time, and the commands of the page."""

import threading
import time
import traceback
from collections.abc import Callable, Mapping
from typing import Any, Literal

from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.planning import AnyPlan, CastOutcome
from hyperflex.play.folder import Opened
from hyperflex.play.planning_process import PlanningProcess, PlanningTask
from hyperflex.play.session import Session
from hyperflex.report import FRAME_RATE

_LATE = 0.1  # s, by which frames may be late; then they are omitted


class Runner:
    """Runs a session.

    Parameters
    ----------
    session : Session

    Attributes
    ----------
    news : threading.Condition
        Its lock guards session and runner; it is notified of each new frame and each change of :meth:`scene`.
    frame : bytes
        The newest frame, from :meth:`Session.frame`.
    number, version : int
        Count frames, and changes of :meth:`scene`.
    watchers : int
        Number of open pages; without any the simulation pauses.
    plan : CastPlan, WhipPlan, InsertPlan or None
        The last plan that was made or opened.
    """

    def __init__(self, session: Session) -> None:
        self.session, self.frame, self.watchers, self.paused = session, session.frame(), 0, False
        self.plan: AnyPlan | None = None
        self.number, self.version, self.news = 0, 0, threading.Condition()
        self._notice, self._late = "", False
        self._usual: float | None = None  # the speed, while a plan is shown in slow motion
        self._planning: PlanningProcess | None = None
        self._reported, self.closed = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._run, name="hyperflex play", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End thread and planning."""
        self.closed.set()
        self.session.cancel()  # a request may be simulating up to the strike of a plan, and all wait for it
        self._thread.join()
        with self.news:
            self._cancel()
            self.news.notify_all()

    def scene(self) -> dict[str, Any]:
        """Return the state of the page in addition to the frames."""
        plan, busy, search = self.plan, self._planning, None
        if busy is not None:
            spent = time.monotonic() - busy.begun if busy.begun else 0.0
            search = {"kind": busy.task.kind, "spent": spent, "budget": busy.task.time_budget}
            search["found"] = busy.best is not None
        shown: dict[str, Any] | None = None
        if plan is not None:
            shown = {"kind": plan.kind, "success": plan.success, "message": plan.message}
            shown["simulated"] = plan.seen is not None
        own = {"paused": self.paused, "notice": self._notice, "late": self._late, "plan": shown, "planning": search}
        return self.session.scene() | own

    def act(self, name: str) -> None:
        """Execute the action of a button; InvalidInput if the button does not exist, or there is nothing to do."""
        session = self.session
        moves: dict[str, Callable[[], None]] = {
            "hang": session.hang,
            "swing": session.swing,
            "cast": lambda: session.play(self._required(success=True).setup(), "cast"),
            "wind": self._wind,
        }
        actions = moves | {
            "plan": lambda: self._plan("cast"),
            "whip": lambda: self._plan("whip"),
            "cancel": self._cancel,
            "pause": self._pause,
            "step": self._step,
        }
        if name not in actions:
            raise InvalidInput("there is no such button", got=name, allowed=", ".join(actions))
        with self.news:
            self._notice = ""
            if self._usual is not None and name in ("hang", "swing", "cast"):
                session.change({"speed": self._usual})
                self._usual = None
            actions[name]()
            self.paused = self.paused and name not in moves
            self.changed(name in moves or name == "step")

    def change(self, values: Mapping[str, object]) -> None:
        """Change settings, see :meth:`Session.change`."""
        with self.news:
            self.session.change(values)
            self.changed()

    def open(self, given: Opened) -> None:
        """Start with the set-up or plan of a file, and its motor limits."""
        with self.news:
            self.session.play(given.setup, "file", limits=given.limits, rope=given.rope)
            self.plan, self.paused = given.plan, False
            self.changed()

    def changed(self, picture: bool = True) -> None:
        """Send the scene to the pages, and with a changed `picture` also a new frame while the simulation pauses."""
        self.version += 1
        if picture:
            self.frame, self.number = self.session.frame(), self.number + 1
        self.news.notify_all()

    def _run(self) -> None:
        due = time.monotonic()
        while not self.closed.wait(max(due - time.monotonic(), 1e-3)):  # s, for commands between frames that are late
            with self.news:
                self._poll_planning()
                now = time.monotonic()
                late, due = now - due > _LATE, max(due + 1.0 / FRAME_RATE, now - _LATE)
                if self.paused or not self.watchers:
                    due = now + 1.0 / FRAME_RATE
                    continue
                if late != self._late:
                    self._late, self.version = late, self.version + 1
                self._advance()

    def _advance(self) -> None:
        try:
            self.frame = self.session.advance(self.session.settings.speed / FRAME_RATE)
            self.number += 1
            self.news.notify_all()
        except Exception as error:  # noqa: BLE001 last resort: the page must stay usable
            self.paused, self._notice = True, str(error)
            if not isinstance(error, HyperflexError):
                traceback.print_exc()
                self._notice = f"This is a bug in hyperflex: {error}. Please report it with the terminal's output."
            self.changed(picture=False)

    def _poll_planning(self) -> None:
        if self._planning is None:
            return
        found, known = self._planning.result(), self.plan
        if isinstance(found, str):
            self._notice = found
        else:
            self.plan = found or self._planning.best or known
        if found is not None:
            self._planning = None
        if found or self.plan is not known or time.monotonic() - self._reported > 0.25:  # s
            self._reported = time.monotonic()
            self.changed(picture=False)

    def _plan(self, kind: Literal["cast", "whip"]) -> None:
        if self._planning is not None:
            raise InvalidInput("a plan is being made", fix="Wait for it, or cancel it")
        session, settings = self.session, self.session.settings
        where = (session.rope, session.arm, settings.target, session.obstacles)
        self._planning = PlanningProcess(PlanningTask(kind, *where, session.limits, settings.time_budget))

    def _cancel(self) -> None:
        if self._planning is not None:
            self._planning.cancel()
            self._planning = None

    def _wind(self) -> None:
        """Show the plan at a quarter of its speed, from 0.5 s before the rope strikes."""
        plan = self._required()
        seen = plan.seen
        strike = seen.strike_time if isinstance(seen, CastOutcome) else seen.t if seen else 0.0
        self.session.play(plan.setup(), "cast", skip=max(0.0, strike - 0.5))  # NaN: it never strikes
        if self._usual is None:
            self._usual = self.session.settings.speed
        self.session.change({"speed": 0.25})

    def _required(self, *, success: bool = False) -> AnyPlan:
        """Return the plan; InvalidInput if there is none, if it was not simulated, or, if required, if it fails."""
        if self.plan is None or self.plan.seen is None or (success and not self.plan.success):
            why = "no plan has been made yet" if self.plan is None else f"the plan fails: {self.plan.message}"
            raise InvalidInput(why, fix="Plan first, for a target that the rope reaches")
        return self.plan

    def _pause(self) -> None:
        self.paused = not self.paused

    def _step(self) -> None:
        self.paused = True
        self.session.advance(self.session.settings.speed / FRAME_RATE)
