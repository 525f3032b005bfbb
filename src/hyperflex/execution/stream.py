"""A motion streamed to a drive at a fixed rate, by a process of its own that nothing else delays."""

import gc
import math
import multiprocessing
import os
import signal
import threading
import time
from bisect import bisect_right
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE
from hyperflex.errors import DriveError, HyperflexError, InvalidInput
from hyperflex.hardware import Drive, DriveState, Goal
from hyperflex.interruption import leave_terminal
from hyperflex.motion import Motion

SPIN = 3e-4  # s before a deadline from which the process waits awake: a sleep may end so much too late
START = 60.0  # s that the process may take to start: imports, and the link
POLL = 0.01  # s between two looks at the process while waiting
ANSWER = 2.0  # s within which the process answers a request
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
)


@dataclass(frozen=True, eq=False)
class StreamLog:
    """What was sent and read, one row for each cycle with the torque on.

    Attributes
    ----------
    rows : (T, 12) float64
        Columns: times at which the goal was due, sent and answered, s since t = 0; goal (rad, rad/s, N m); the drive's
        angle, rate and torque (rad, rad/s, N m), voltage, V, and temperature, degrees Celsius, as of the last answer;
        requests in a row without an answer, up to this one.
    rate : float
        Cycles a second.
    missed : int
        Cycles that were left out because the one before took too long.
    """

    rows: Array
    rate: float
    missed: int

    def column(self, name: str) -> Array:
        """Return a column (T,) by its name, as in FIELDS."""
        return self.rows[:, FIELDS.index(checks.choice("column", name, FIELDS))]

    def angle(self, t: float | Array) -> Array:
        """Angle of the arm (K,) at times t (K,), s, as the drive reported it, interpolated, rad."""
        answered = self.column("lost") == 0
        return np.asarray(np.interp(t, self.column("received")[answered], self.column("angle")[answered]))

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
    clear : bool
        Clear a fault of the device at the start.
    waits : bool
        Whether a motion waits for a process that was late by more than a cycle, instead of being caught up with.

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
        clear: bool = False,
        waits: bool = False,
    ) -> None:
        self.connect, self.clear, self.waits = connect, clear, waits
        self.rate = checks.number("rate", rate, sign="positive", unit="Hz")
        rows = math.ceil(self.rate * checks.number("duration", duration, sign="positive", unit="s"))
        context = multiprocessing.get_context("spawn")
        self._shared = Shared(context.RawArray("d", rows * len(FIELDS)), context.RawArray("q", 2))
        self._context, self._zero, self._number, self.late = context, 0.0, 0, 0
        self.motion: Motion | None = None
        self._worker: Any = None
        self._ending, self._confirmed = threading.Lock(), True  # two threads that wait for one process lose its code

    def __enter__(self) -> Self:
        self._link, theirs = self._context.Pipe()
        arguments = (self.connect, self.clear, 1.0 / self.rate, self.waits, theirs, self._shared)
        worker: Any = self._context.Process(target=stream, args=arguments, name="motion stream", daemon=True)
        self._confirmed = False
        worker.start()
        self._worker = worker
        theirs.close()
        try:
            self._receive(0, START)
            self.start_clock()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._link.send((0, "end"))
        self._end()

    def stop(self) -> bool:
        """Switch the torque off at once and end the process; return whether the device confirmed it. For any thread."""
        worker = self._worker
        if worker is None:
            return self._confirmed
        with self._ending:
            worker.terminate()
        return self._exit_code(worker) == 0

    def _exit_code(self, worker: Any) -> int | None:
        """Wait for the end of the process; return its exit code, or None if it has not ended in time. For any thread.

        The code is 0 if the torque is off for certain.
        """
        if not wait([worker.sentinel], ANSWER):
            return None
        with self._ending:
            worker.join()
            return int(worker.exitcode)

    def _end(self) -> None:
        """Wait for the end of the process; raise if it did not confirm that the torque is off."""
        worker = self._worker
        code = self._exit_code(worker)
        for hasten in (worker.terminate, worker.kill):
            if code is None:
                hasten()
                code = self._exit_code(worker)
        self._confirmed, self._worker = code == 0, None
        why = ""
        with suppress(EOFError, OSError):
            while self._link.poll():
                _, answer = self._link.recv()
                why = f" {answer}" if isinstance(answer, Exception) else why
        self._link.close()
        if not self._confirmed:
            raise DriveError(f"The drive did not confirm that its torque is off.{why} Cut its power.")

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

    def set_motion(self, motion: Motion, at: float, torque: tuple[npt.ArrayLike, npt.ArrayLike] | None = None) -> bool:
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
        path = Path(motion.breaks.tolist(), motion.coef[:, ANGLE].tolist(), times.tolist(), values.tolist())
        taken = bool(self._ask("motion", checks.number("at", at, unit="s"), path))
        self.motion, self.late = motion if taken else self.motion, self.late + (not taken)
        return taken

    def angle(self, t: float) -> float:
        """Return the encoder's angle at a time `t` (s), rad, interpolated; the newest one for later times."""
        log = self.log()
        return float(log.angle(t)) if log.rows.size else float(self.state().angle)

    def log(self) -> StreamLog:
        """Return all cycles so far, also after the end."""
        return self._shared.log(self.rate, self._zero)

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        self.raise_if_ended()
        return int(self._worker.pid)

    def _ask(self, *request: Any) -> Any:
        self.raise_if_ended()
        self._number += 1
        with suppress(OSError):  # why it has ended is received
            self._link.send((self._number, *request))
        return self._receive(self._number, ANSWER)

    def _receive(self, number: int, patience: float) -> Any:
        """Return the answer to a request; those to earlier ones, which came late, are dropped."""
        until = time.monotonic() + patience
        while self._link.poll(max(0.0, until - time.monotonic())):
            answered, value = self._take()
            if answered == number:
                return value
        raise DriveError(f"The process of the drive has not answered for {patience:g} s.")

    def _take(self) -> tuple[int, Any]:
        """Return the next answer and the number of its request; raise an error that the process sent, or its end."""
        try:
            number, value = self._link.recv()
        except (EOFError, OSError):
            code = self._exit_code(self._worker)
            raise DriveError(f"The process of the drive ended with code {code}.") from None
        if isinstance(value, Exception):
            raise value
        return number, value

    def raise_if_ended(self) -> None:
        """Raise what ended the process, if it has ended."""
        if self._worker is None:
            raise InvalidInput("the motion stream is closed", fix="Use it within its with block")
        while self._link.poll():  # a late answer, or why it has ended
            self._take()


class Path(NamedTuple):
    """A motion as plain numbers: breaks, ascending coefficients of the angle, feed-forward torques and their times."""

    breaks: list[float]
    coef: list[list[float]]
    times: list[float]
    torques: list[float]

    def goal(self, t: float) -> Goal:
        """Return the goal at a time, s; before its first break and after its last one the motion stands still."""
        moment = min(max(t, self.breaks[0]), self.breaks[-1])
        k = min(bisect_right(self.breaks, moment) - 1, len(self.coef) - 1)
        s, angle, rate = moment - self.breaks[k], 0.0, 0.0
        for c in reversed(self.coef[k]):
            rate = rate * s + angle
            angle = angle * s + c
        inside = self.breaks[0] <= t < self.breaks[-1]
        return Goal(angle, rate if inside else 0.0, self._torque(t))

    def _torque(self, t: float) -> float:
        if not self.times[0] <= t < self.times[-1]:
            return 0.0
        k = bisect_right(self.times, t) - 1
        part = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        return (1.0 - part) * self.torques[k] + part * self.torques[k + 1]


class Shared:
    """Rows of the log in memory that two processes share; one writes, the other reads."""

    def __init__(self, data: Any, counts: Any) -> None:
        self._data, self._counts = data, counts  # numbers; rows written, cycles missed

    def writer(self) -> Callable[[tuple[float, ...]], None]:
        """Return a function that writes a row."""
        rows = np.frombuffer(self._data).reshape(-1, len(FIELDS))

        def write(row: tuple[float, ...]) -> None:
            rows[self._counts[0] % len(rows)] = row
            self._counts[0] += 1

        return write

    def miss(self, cycles: int) -> None:
        """Count cycles that were left out."""
        self._counts[1] += cycles

    def log(self, rate: float, zero: float) -> StreamLog:
        """Return the rows, with times since `zero`, s."""
        rows, count = np.frombuffer(self._data).reshape(-1, len(FIELDS)), int(self._counts[0])
        first = max(count - len(rows) + 1, 0)  # the oldest row of a full log may be overwritten meanwhile
        found = rows[np.arange(first, count) % len(rows)]
        found[:, :3] -= zero
        return StreamLog(found, rate, int(self._counts[1]))


def stream(
    connect: Callable[[], Drive], clear: bool, period: float, waits: bool, link: Connection, shared: Shared
) -> None:
    """Serve requests and, with the torque on, send a goal each period, s, until the parent ends or asks for the end.

    The exit code is 0 if the torque is off for certain.
    """
    leave_terminal()
    drive, ended = connect(), None

    def leave(*_: object) -> None:
        raise SystemExit(int(drive.enabled))

    signal.signal(signal.SIGTERM, leave)
    try:
        drive.connect(clear=clear)
        with drive:
            link.send((0, None))
            gc.collect()
            gc.freeze()
            gc.disable()
            with suppress(OSError, AttributeError):  # only with the right to do so
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
            _Cycle(drive, period, waits, link, shared).run()
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
    link.close()
    raise SystemExit(int(drive.enabled))


class _Cycle:
    """The loop of the process, and what it streams: paths, each from a time on."""

    def __init__(self, drive: Drive, period: float, waits: bool, link: Connection, shared: Shared) -> None:
        self.drive, self.period, self.waits, self.link, self.shared = drive, period, waits, link, shared
        self.write, self.zero = shared.writer(), 0.0
        self.paths: list[tuple[float, Path]] = []

    def run(self) -> None:
        """Serve and send until the end is asked for, or the parent has ended."""
        due = time.monotonic()
        while self.serve():
            due += self.period
            late = time.monotonic() - due
            if late > self.period:
                missed = int(late / self.period)
                if self.drive.enabled:
                    self.shared.miss(missed)
                due += missed * self.period
                self.zero += missed * self.period * self.waits
            _wait_until(due)
            if self.drive.enabled:
                self.send(due)

    def send(self, due: float) -> None:
        """Send the goal of now, and log it with the answer."""
        now = time.monotonic()
        goal = self.goal(now - self.zero)
        state = self.drive.command(goal, at=now)
        measured = (state.angle, state.rate, state.torque, state.voltage, state.temperature, float(state.lost))
        self.write((due, now, state.received, goal.angle, goal.rate, goal.torque, *measured))

    def goal(self, t: float) -> Goal:
        """Return the goal of a time, s: that of the last path that has begun."""
        while len(self.paths) > 1 and self.paths[1][0] <= t:
            del self.paths[0]
        return self.paths[0][1].goal(t)

    def hold(self, angle: float) -> None:
        """Hold an angle, rad, until the next motion."""
        self.paths = [(-math.inf, Path([-1.0, 0.0], [[angle]], [0.0], [0.0]))]

    def serve(self) -> bool:
        """Answer what the parent asks; return False at the end."""
        try:
            if not self.link.poll():
                return True
            number, kind, *values = self.link.recv()
        except (EOFError, OSError):  # the parent has ended
            return False
        if kind == "end":
            return False
        answer: Any = None
        if kind == "clock":
            if self.paths:
                self.hold(self.goal(time.monotonic() - self.zero).angle)
            self.zero = values[0]
        elif kind == "motion":
            answer = self.take(*values)
        elif kind == "enable":
            answer = self.drive.enable()
            self.hold(answer.angle)
        elif kind == "off":
            self.drive.off()
        elif kind == "state":
            answer = self.drive.read()
        self.link.send((number, answer))
        return True

    def take(self, at: float, path: Path) -> bool:
        """Stream a path from a time `at`, s, on; refuse one that has begun and would make the goal jump."""
        now = time.monotonic() - self.zero
        if at <= now and self.paths:
            old, new = self.goal(now), path.goal(now)
            if abs(new.angle - old.angle) > MEET[0] or abs(new.rate - old.rate) > MEET[1]:
                return False
        self.paths = [*(each for each in self.paths if each[0] < at), (at, path)]
        return True


def _wait_until(due: float) -> None:
    if (rest := due - time.monotonic() - SPIN) > 0.0:
        time.sleep(rest)
    while time.monotonic() < due:
        pass
