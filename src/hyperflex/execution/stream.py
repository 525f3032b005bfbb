"""A motion streamed to a drive at a fixed rate, by a process of its own that nothing else delays."""

import math
import multiprocessing
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.child import ANSWER, Child, Records, run_in_real_time, serve
from hyperflex.errors import DriveError, HyperflexError, InvalidInput
from hyperflex.hardware import Drive, DriveState, Goal
from hyperflex.motion import Motion, hold_arm

SPIN = 3e-4  # s before a deadline from which the process waits awake: a sleep may end so much too late
POLL = 0.01  # s between two looks at the process while waiting
MEET = 2e-3, 0.05  # rad and rad/s by which goals of a motion that comes late may differ from those of the one before
FIELDS = (
    "scheduled",
    "sent",
    "received",
    "goal_angle",
    "goal_rate",
    "goal_torque",
    "angle",
    "rate",
    "torque",
    "voltage",
    "temperature",
    "lost",
    "missed",
)


@dataclass(frozen=True, eq=False)
class StreamLog:
    """What was sent and read, one row for each cycle with the torque on.

    Attributes
    ----------
    rows : (T, 13) float64
        Columns: times at which the goal was due, sent and answered, s since t = 0; goal (rad, rad/s, N m); the drive's
        angle, rate and torque (rad, rad/s, N m), voltage, V, and temperature, degrees Celsius, as of the last answer;
        requests in a row without an answer, up to this one; cycles left out before it, because one took too long.
    rate : float
        Cycles a second.
    """

    rows: Array
    rate: float

    def column(self, name: str) -> Array:
        """Return a column (T,) by its name, as in FIELDS."""
        return self.rows[:, FIELDS.index(checks.choice("column", name, FIELDS))]

    def angle(self, t: float | Array) -> Array:
        """Angle of the arm (K,) at times t (K,), s, as the drive reported it, interpolated, rad."""
        answered = self.column("lost") == 0
        return np.asarray(np.interp(t, self.column("received")[answered], self.column("angle")[answered]))

    @property
    def missed(self) -> int:
        """Cycles that were left out."""
        return int(self.column("missed").sum())

    @property
    def jitter(self) -> Array:
        """Time (T,) from the due time to the sending of each goal, s."""
        return self.column("sent") - self.column("scheduled")

    @property
    def tracking_error(self) -> Array:
        """Angle less goal (T,), rad, where the drive answered; NaN elsewhere."""
        error = self.column("angle") - self.column("goal_angle")
        return np.where(self.column("lost") > 0, np.nan, error)


class MotionStream:
    """Streams motions to a drive from a separate process (a :class:`hyperflex.interfaces.Motor`).

    Use it as a context manager, in a program with ``if __name__ == "__main__":``, for the process starts as a new
    interpreter. Nothing moves before :meth:`enable`. At the end of the block, and when this program ends in any way,
    the process switches the torque off; when the process itself dies, the device's watchdog does.

    Parameters
    ----------
    connect : callable
        Returns the drive, not yet connected; it is called in the process and is sent there (a function of a module, or
        a ``functools.partial`` of one).
    rate : float
        Goals a second, Hz.
    duration : float
        Longest time for which rows are logged, s; later cycles replace the oldest.
    clear_fault : bool
        Clear a fault of the device at the start.
    waits : bool
        Whether a motion waits for a process that was late by more than a cycle, instead of being caught up with.
    patience : float
        Time, s, without a request or a call of :meth:`raise_if_ended` after which this program counts as hanging: once
        its motion is over, the process switches the torque off and ends.

    Attributes
    ----------
    late : int
        Motions that arrived too late to be taken up without a jump; the one before went on.
    motion : Motion or None
        The newest one that was taken up since the clock was started; None before it.

    Raises
    ------
    DriveError
        If the drive cannot be connected; later, from any method, once it is in fault or the process has ended; at the
        end of the block, if the device did not confirm that its torque is off.
    """

    def __init__(
        self,
        connect: Callable[[], Drive],
        *,
        rate: float = 200.0,
        duration: float = 300.0,
        clear_fault: bool = False,
        waits: bool = False,
        patience: float = 5.0,
    ) -> None:
        self.rate = checks.positive("rate", rate, "Hz")
        rows = math.ceil(self.rate * checks.positive("duration", duration, "s"))
        self._records = Records(rows, len(FIELDS))
        self._alive = multiprocessing.get_context("spawn").RawValue("d")  # when this program last showed that it is, s
        patience = checks.positive("patience", patience, "s")
        arguments = connect, clear_fault, 1.0 / self.rate, waits, self._records, self._alive, patience
        self._child = Child("The process of the drive", DriveError, stream, *arguments)
        self._zero, self.late = 0.0, 0
        self.motion: Motion | None = None

    def __enter__(self) -> Self:
        self._zero = self._child.start()
        return self

    def __exit__(self, _kind: object = None, raised: object = None, _trace: object = None) -> None:
        self._child.send("end")
        error = self._child.end(ANSWER)
        if self._child.code != 0:
            causes = [f"{each} " for each in (raised or error,) if isinstance(each, HyperflexError)]
            raise DriveError(f"{''.join(causes)}The drive did not confirm that its torque is off. Cut its power.")

    def stop(self) -> bool:
        """Switch the torque off at once and end the process; return whether the device confirmed it. For any thread."""
        return self._child.stop() == 0

    def start_clock(self, at: float | None = None) -> None:
        """Make a moment of the monotonic clock, s, or now, t = 0; what is held then is held until the next motion."""
        self._zero = time.monotonic() if at is None else checks.number("at", at, unit="s")
        self.motion = None
        self._ask("clock", self._zero)

    @property
    def now(self) -> float:
        """Time since t = 0, s."""
        return time.monotonic() - self._zero

    def enable(self) -> DriveState:
        """Switch the torque on; the arm holds where it is. Return the state."""
        return checks.instance("answer", self._ask("enable"), DriveState)

    def off(self) -> None:
        """Switch the torque off."""
        self._ask("off")

    def state(self) -> DriveState:
        """Return the newest state of the drive, with the torque on or off."""
        return checks.instance("answer", self._ask("state"), DriveState)

    def set_motion(self, motion: Motion, at: float, torque: tuple[ArrayLike, ArrayLike] | None = None) -> bool:
        """Stream a motion from a time `at` (s) on; see :class:`hyperflex.interfaces.Motor`.

        `torque` are times (K,), s, and feed-forward torques (K,), N m, between which the torque is interpolated; it is
        zero before and after them. False: it came too late to be taken up without a jump, and the one before goes on.
        """
        checks.instance("motion", motion, Motion)
        if motion.loop >= 0:
            raise InvalidInput("a motion that repeats is not streamed", allowed="a motion that ends")
        times = values = np.zeros(1)
        if torque is not None:
            times = checks.times("torque times", torque[0])
            values = checks.array("torque", torque[1], times.shape, unit="N m")
        taken = bool(self._ask("motion", checks.number("at", at, unit="s"), Path(motion, times, values)))
        self.motion, self.late = motion if taken else self.motion, self.late + (not taken)
        return taken

    def angle(self, t: float) -> float:
        """Return the encoder's angle at a time `t` (s), rad, interpolated; the newest one for later times."""
        log = self.log()
        return float(log.angle(t)) if log.rows.size else float(self.state().angle)

    def log(self) -> StreamLog:
        """Return all cycles so far, also after the end."""
        rows = self._records.read()
        rows[:, :3] -= self._zero
        return StreamLog(rows, self.rate)

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._child.pid

    def raise_if_ended(self) -> None:
        """Raise what ended the process, if it has ended."""
        self._alive.value = time.monotonic()
        self._child.raise_if_ended()

    def _ask(self, *request: Any) -> Any:
        self._alive.value = time.monotonic()
        return self._child.ask(*request)


class Path(NamedTuple):
    """A motion with feed-forward torques (K,), N m, at times (K,), s: interpolated, and zero before and after them."""

    motion: Motion
    times: Array
    torques: Array

    def goal(self, t: float) -> Goal:
        """Return the goal at a time, s."""
        torque = np.interp(t, self.times, self.torques, 0.0, 0.0)
        return Goal(float(self.motion.angle(t)), float(self.motion.rate(t)), float(torque))


def stream(
    link: Connection,
    connect: Callable[[], Drive],
    clear_fault: bool,
    period: float,
    waits: bool,
    records: Records,
    alive: Any,
    patience: float,
) -> None:
    """Serve requests and, with the torque on, send a goal each period, s, until the parent ends or asks for the end.

    It also ends when the motion is over and the parent has not been `alive`, a time, for a patience, s. The exit code
    is 0 if the torque is off for certain.
    """
    drive, ended = connect(), None

    def leave(*_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # a second signal does not interrupt the end
        raise SystemExit

    signal.signal(signal.SIGTERM, leave)
    try:
        drive.connect(clear_fault=clear_fault)
        with drive:
            cycle = _Cycle(drive, period, waits, link, records)
            link.send((0, cycle.zero))
            run_in_real_time()
            cycle.run(lambda: alive.value + patience)
    except HyperflexError as error:
        ended = error
    except SystemExit:
        ended = DriveError("The process of the drive was ended by a signal.")
    except OSError:  # the parent has ended
        pass
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # its exit code says what the torque is
    if ended is not None:
        with suppress(OSError):
            link.send((0, ended))
    raise SystemExit(int(drive.enabled))


class _Cycle:
    """The loop of the process, and what it streams: paths, each from a time on."""

    def __init__(self, drive: Drive, period: float, waits: bool, link: Connection, records: Records) -> None:
        self.drive, self.period, self.waits, self.link, self.records = drive, period, waits, link, records
        self.zero, self.missed = time.monotonic(), 0
        self.paths: list[tuple[float, Path]] = []
        self.answers: dict[str, Callable[..., Any]] = {
            "clock": self.set_clock,
            "motion": self.take,
            "enable": self.enable,
            "off": drive.off,
            "state": drive.read,
        }

    def run(self, patient: Callable[[], float]) -> None:
        """Serve and send until the end is asked for or the parent has ended; after a motion be `patient`."""
        due = time.monotonic()
        while serve(self.link, self.answers):
            due += self.period
            late = time.monotonic() - due
            self.missed = max(0, int(late / self.period))
            due += self.missed * self.period
            self.zero += self.missed * self.period * self.waits
            time.sleep(max(0.0, due - time.monotonic() - SPIN))
            while time.monotonic() < due:
                pass
            if self.drive.enabled:
                self.send(due)
                if due > max(patient(), self.zero + self.paths[-1][1].motion.breaks[-1]):
                    raise DriveError("The program has been silent since its motion was over. The torque is off.")

    def send(self, due: float) -> None:
        """Send the goal of now, and log it with the answer."""
        now = time.monotonic()
        goal = self.goal(now - self.zero)
        state = self.drive.command(goal, at=now)
        measured = state.angle, state.rate, state.torque, state.voltage, state.temperature, state.lost
        self.records.write((due, now, state.received, goal.angle, goal.rate, goal.torque, *measured, self.missed))

    def goal(self, t: float) -> Goal:
        """Return the goal of a time, s: that of the last path that has begun."""
        while len(self.paths) > 1 and self.paths[1][0] <= t:
            del self.paths[0]
        return self.paths[0][1].goal(t)

    def hold(self, angle: float) -> None:
        """Hold an angle, rad, until the next motion."""
        self.paths = [(-math.inf, Path(hold_arm(angle), np.zeros(1), np.zeros(1)))]

    def set_clock(self, zero: float) -> None:
        """Make a moment of the monotonic clock, s, t = 0, and hold the goal of now."""
        if self.paths:
            self.hold(self.goal(time.monotonic() - self.zero).angle)
        self.zero = zero

    def enable(self) -> DriveState:
        """Switch the torque on, and hold the arm where it is."""
        state = self.drive.enable()
        self.hold(state.angle)
        return state

    def take(self, at: float, path: Path) -> bool:
        """Stream a path from a time `at`, s, on; refuse one that has begun and would make the goal jump."""
        now = time.monotonic() - self.zero
        if at <= now and self.paths:
            old, new = self.goal(now), path.goal(now)
            if abs(new.angle - old.angle) > MEET[0] or abs(new.rate - old.rate) > MEET[1]:
                return False
        self.paths = [*(each for each in self.paths if each[0] < at), (at, path)]
        return True
