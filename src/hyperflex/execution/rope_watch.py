"""The rope watched while a plan is carried out: a source of its state in real time, recorded, and noticed when lost."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import EstimatorLost, HyperflexError, InvalidInput
from hyperflex.execution.stream import POLL
from hyperflex.interfaces import RopeState, StateSource
from hyperflex.model import Peg, Rope, obstacle_gaps
from hyperflex.motion import Motion
from hyperflex.planning import CastPlan
from hyperflex.recording import Recording

LOST = 0.3  # s without a state of the rope after which a cast is stopped: some ten frames of a camera


class ClockedSource(StateSource, Protocol):
    """A source of the rope's state whose t = 0 can be set: :class:`CameraRope` or :class:`EmulatedRope`."""

    @property
    def rope(self) -> Rope:
        """The rope as far as it is known by now: a camera sees its length while it hangs."""

    @property
    def contact(self) -> bool:
        """Whether states are right while the rope touches the target."""

    def start_clock(self, at: float | None = None) -> None:
        """Make a moment of the monotonic clock, s, or now, t = 0; in the latter case the rope may be anywhere."""

    def turns(self, arm_angle: Callable[[Array], Array], peg: Peg, side: int, rope: Rope) -> tuple[Array, Array]:
        """Return times (T,), s, and the turns of the rope about a peg as it was seen then (T, 2).

        Those that are likeliest, and the most that may be; NaN where they do not show. `arm_angle` returns the arm's
        angles, rad, at times, s; `side` is 1 for a rope that is to wind counterclockwise, else -1; the `rope` is as
        long as it was seen to be.
        """


class RopeWatch:
    """A source in real time: it waits for the time that is asked for, and records the rope meanwhile.

    The arm moves later than it is commanded, by the lag: the rope's state now belongs to what was commanded then. A
    source that knows no contact is recorded until the rope touches the target, about at `touch`, s.
    """

    def __init__(
        self,
        source: ClockedSource | None,
        begin: float,
        motion: Motion,
        plan: CastPlan,
        touch: float,
        *,
        lag: float,
        rate: float,
    ) -> None:
        self.source, self.begin, self.lag, self.period = source, begin, lag, 1.0 / rate
        self.plan, self.touch = plan, touch
        self.states: list[RopeState] = []
        self._motion = motion.shifted(self.lag)
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._record, name="rope recorder", daemon=True)
        self._failed: HyperflexError | None = None  # since the last state
        self._looks = 0  # since then, POLL, s, apart
        self._watching = False
        self._seen = begin

    def start(self) -> None:
        """Begin to record."""
        if self.source is not None:
            self.source.start_clock(self.begin)
            self._watching = True
            self._thread.start()

    def stop(self) -> None:
        """End the recording; a source that hangs is left alone."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join(1.0)

    @property
    def newest(self) -> RopeState | None:
        """The last state; None if the rope has not been seen for LOST, s."""
        return self.states[-1] if self.states and time.monotonic() - self._seen < LOST else None

    def raise_if_lost(self) -> None:
        """Raise why the rope has not been seen in looks of LOST, s: a busy machine pauses them like the source."""
        if not self._watching or time.monotonic() < self.begin:  # nothing is looked for, or no longer
            return
        self._looks += 1
        if self._looks * POLL > LOST:
            raise self._failed or EstimatorLost(f"The source of the rope's state has not answered for {LOST:g} s.")

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the state at a time, s, once that time has come, for a command that the arm follows at once."""
        checks.number("t", t, unit="s")
        if self.source is None:
            raise InvalidInput("there is no source of the rope's state")
        time.sleep(max(0.0, self.begin + t - time.monotonic()))
        with self._lock:
            self._motion = motion.shifted(self.lag)
            found = self.source.state(time.monotonic() - self.begin, self._motion)
        return replace(found, t=found.t - self.lag)

    def recording(self) -> Recording | None:
        """Return the observed link angles; None of fewer than two."""
        if len(self.states) < 2:
            return None
        stds = [None if each.covariance is None else np.sqrt(np.diag(each.covariance)) for each in self.states]
        noise = None
        if all(each is not None for each in stds):
            noise = np.maximum(np.array(stds)[:, : self.states[0].q.size], 1e-9)
        t, q = np.array([each.t for each in self.states]), np.array([each.q for each in self.states])
        return Recording(t, q, "angles", noise, name="a cast carried out")

    def _record(self) -> None:
        due = time.monotonic()  # a camera's process is told the motion before it begins
        while not self._over.wait(max(0.0, due - time.monotonic())):
            due += self.period
            t = time.monotonic() - self.begin
            try:
                with self._lock:
                    assert self.source is not None  # noqa: S101 the thread runs with a source alone
                    state = self.source.state(t, self._motion)
                touches = not self.source.contact and self._touches(state)
            except HyperflexError as error:
                self._failed = error
                continue
            except Exception as error:  # noqa: BLE001 whatever it is, the rope is not seen
                self._failed = EstimatorLost(f"The source of the rope's state failed: {error!r}.")
                continue
            self._failed, self._looks, self._seen = None, 0, time.monotonic()
            if state.t >= 0.0 and (not self.states or state.t > self.states[-1].t):
                self.states.append(state)
            if touches:
                self._watching = False
                return

    def _touches(self, state: RopeState) -> bool:
        """Whether the rope touches the target. One that hangs before it, early, does not."""
        problem, peg = self.plan.problem, self.plan.target
        joints = problem.rope.joints(state.q, problem.arm.tip(self._motion.angle(state.t)))
        gap = float(obstacle_gaps((peg,), joints[:-1], joints[1:]).min())
        return gap < 2.0 * problem.rope.radius and state.t > 0.5 * self.touch
