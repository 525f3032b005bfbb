"""A drive: a motor with its own controller, behind guards that are the same for every make.

A make's protocol is a :class:`Link`. :class:`Drive` owns everything that keeps gears, ropes and people safe: what may
be sent, when torque is on, and that it is off at every exit. Angles are those of the arm: 0 hangs down, pi/2 points
along +x.
"""

import atexit
import math
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from types import FrameType
from typing import Any, Protocol, Self

from hyperflex import checks
from hyperflex.errors import DriveError, InvalidInput
from hyperflex.model import MotorLimits

FIRST_STEP = 0.05  # rad; a first goal farther from the shaft than this would be a jerk (a stripped gear)
SILENCE = 0.05  # s without a valid reply after which the link counts as lost: half of a watchdog of 100 ms
SLACK = 1.02  # of a limit: goals are sampled from polynomials that reach the limit exactly, and rounded on the wire
CONFIRM = 0.2  # s for which a drive is asked again to switch its torque off, until it confirms


@dataclass(frozen=True)
class Goal:
    """What a drive is asked for: angle, rad, with its rate, rad/s, and feed-forward torque, N m.

    A drive that takes no rate or torque ignores them (:attr:`Link.takes`).
    """

    angle: float
    rate: float = 0.0
    torque: float = 0.0


@dataclass(frozen=True)
class Reading:
    """One reply of a drive.

    Attributes
    ----------
    angle, rate, torque : float
        Of the shaft, rad, rad/s and N m; torque is NaN where the drive does not tell it.
    voltage, temperature : float
        V and degrees Celsius; NaN where not told in this reply.
    enabled : bool
        Whether the torque is on.
    fault : str
        The device's fault in words, with its number; empty if it has none.
    sent, received : float
        Times of the request and of the reply on :func:`time.monotonic`, s.
    """

    angle: float
    rate: float
    torque: float
    voltage: float
    temperature: float
    enabled: bool
    fault: str
    sent: float
    received: float


@dataclass(frozen=True)
class DriveState(Reading):
    """A reading in the arm's angle, and whether it answers the last request.

    Attributes
    ----------
    stale : bool
        Whether the last request was not answered: the values are those of the last reply, at `received`.
    lost : int
        Requests in a row that were not answered.
    """

    stale: bool = False
    lost: int = 0


class NoReply(DriveError):
    """A single request got no valid reply in time: lost, late, garbled or truncated. Links raise it."""


class Link(Protocol):
    """A make's protocol. Angles are raw: radians of the shaft from the device's own zero, many turns if it counts them.

    Every call returns within `patience`, s, apart from `open`. Nothing moves before `enable`.

    Attributes
    ----------
    name : str
        Make, number and port, as messages name it ("moteus 1 on /dev/ttyACM0").
    watchdog : float
        Time, s, after which the device itself goes passive without a request.
    takes : frozenset of {"rate", "torque"}
        What it takes with an angle.
    """

    name: str
    watchdog: float
    takes: frozenset[str]

    def open(self) -> None:
        """Open the port and identify the device; DriveError says what is wrong (port, permission, rate, device)."""

    def read(self) -> Reading:
        """Return the state; NoReply without a valid reply."""

    def enable(self, limits: MotorLimits) -> None:
        """Arm the device's watchdog and limits, and switch the torque on with the present angle as goal."""

    def send(self, goal: Goal) -> Reading:
        """Send a raw goal and return the state that answers it; NoReply without a valid reply."""

    def disable(self) -> None:
        """Switch the torque off; NoReply without a reply."""

    def clear(self) -> None:
        """Clear the device's fault; the torque stays off."""

    def close(self) -> None:
        """Close the port. Never raises."""


class Drive:
    """A drive with guards. Use it as a context: its torque is off at the end, whatever happened.

    Parameters
    ----------
    link : Link
        The make's protocol.
    limits : MotorLimits
        What is never exceeded: angle, speed, acceleration and torque.
    zero : float
        Raw angle of the shaft, rad, at which the arm hangs down; see :meth:`set_zero`.
    direction : {1, -1}
        -1 if the raw angle grows clockwise, seen with +x to the right and up upwards.
    max_temperature : float
        Temperature, degrees Celsius, at which the torque is switched off.
    clock : callable
        Monotonic time, s.

    Raises
    ------
    InvalidInput
        For a goal beyond a limit, or a first goal more than 0.05 rad from the shaft; nothing is sent, and the arm holds
        the last goal until the watchdog expires.
    DriveError
        If the device is in fault, cannot be reached, or does not answer. The torque is off and the fault stays latched
        until :meth:`acknowledge`.

    Notes
    -----
    Guards, in the order in which they act: the device must be free of faults on connection; when its torque is switched
    on, its angle must lie within the limits (a counter that wrapped is named); a goal must lie within all limits, and
    near the shaft if it is the first; each reply is checked for faults, temperature, torque, an angle outside the
    limits and jumps; the device's own watchdog stops it when the host falls silent. SIGTERM and SIGHUP end the program
    through the same exit.
    """

    def __init__(
        self,
        link: Link,
        limits: MotorLimits,
        *,
        zero: float = 0.0,
        direction: int = 1,
        max_temperature: float = 70.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.link, self.limits = link, checks.instance("limits", limits, MotorLimits)
        self.zero = checks.number("zero", zero, unit="rad")
        if direction not in (1, -1):
            raise InvalidInput("direction of a drive", got=direction, allowed="1 or -1")
        self.direction = direction
        self.max_temperature = checks.number("max_temperature", max_temperature, sign="positive", unit="C")
        self._clock = clock
        self._state: DriveState | None = None
        self._fault = ""  # latched
        self._connected = self._enabled = False
        self._goal: tuple[float, Goal] | None = None  # when, and what was sent last
        self._signals: dict[int, Any] = {}

    # ------------------------------------------------------------------ connection

    def connect(self, *, clear: bool = False) -> DriveState:
        """Open the link and read the state. Nothing moves; torque that was left on is switched off.

        A device that is in fault is refused, unless `clear` acknowledges its fault.
        """
        if self._connected:
            raise DriveError(f"{self.link.name} is connected already.")
        self.link.open()
        self._connected = True
        atexit.register(self.close)
        self._catch_signals()
        try:
            state = self._first_reading()
            if state.enabled:
                self.off()
            if clear:
                self.acknowledge()
            elif state.fault:
                self._latch(f"the device reports {state.fault}")
        except BaseException:
            self.close()
            raise
        return state

    def close(self) -> None:
        """Switch the torque off and close the link; does nothing a second time."""
        if not self._connected:
            return
        atexit.unregister(self.close)
        try:
            self.off()
        finally:
            self._connected = False
            self.link.close()
            for number, handler in self._signals.items():
                signal.signal(number, handler)
            self._signals = {}

    def __enter__(self) -> Self:
        if not self._connected:
            self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ------------------------------------------------------------------ state

    @property
    def fault(self) -> str:
        """The latched fault in words; empty if there is none."""
        return self._fault

    @property
    def enabled(self) -> bool:
        """Whether the torque is on, as far as the host knows."""
        return self._enabled

    def read(self) -> DriveState:
        """Return the state; stale, with the time of its reply, if the device did not answer this request."""
        self._require_connection()
        return self._exchange(self.link.read)

    def set_zero(self, angle: float) -> float:
        """Declare the arm's present angle, rad, with the torque off; return the raw angle of the zero to be kept."""
        if self._enabled:
            raise DriveError("The zero of a drive is set with its torque off.")
        now = self._first_reading()
        raw = self.zero + self.direction * now.angle
        self.zero = raw - self.direction * checks.number("angle", angle, unit="rad")
        return self.zero

    def acknowledge(self) -> None:
        """Clear a latched fault, in the device as well; the torque stays off."""
        self._require_connection()
        self.link.clear()
        self._fault = ""
        state = self._first_reading()
        if state.fault:
            self._latch(f"the device still reports {state.fault}")

    # ------------------------------------------------------------------ motion

    def enable(self) -> DriveState:
        """Switch the torque on; the arm holds where it is."""
        self._require_connection()
        if self._fault:
            raise DriveError(f"{self.link.name}: {self._fault}. Remove the cause, then acknowledge the fault.")
        state = self._first_reading()
        self._check_turn(state)
        self._goal = None
        self._enabled = True  # before it is: an interrupt here must switch it off
        self._guarded(lambda: self.link.enable(self.limits))
        return state

    def command(self, goal: Goal) -> DriveState:
        """Check a goal against all limits, send it, and return the state that answers it.

        The first goal after :meth:`enable` must lie within 0.05 rad of the shaft. Later ones may differ from the one
        before by what the limits of speed and acceleration allow in the time since then.
        """
        self._require_connection()
        if not self._enabled or self._fault:
            why = self._fault or "its torque is off. Enable it first"
            raise DriveError(f"{self.link.name}: {why}.")
        now = self._clock()
        self._check_goal(goal, now)
        raw = Goal(self.zero + self.direction * goal.angle, self.direction * goal.rate, self.direction * goal.torque)
        self._goal = (now, goal)
        return self._exchange(lambda: self.link.send(raw))

    def off(self) -> None:
        """Switch the torque off, and ask again until the device confirms.

        Raises
        ------
        DriveError
            If it does not confirm within 0.2 s: then only its own watchdog stops it.
        """
        if not self._connected:
            return
        until = self._clock() + CONFIRM
        while True:
            with suppress(NoReply, OSError):
                self.link.disable()
                state = self.link.read()
                self._enabled = state.enabled
                if not state.enabled:
                    return
            if self._clock() > until:
                break
        watch = f"its watchdog stops it {self.link.watchdog:g} s after the last command"
        raise DriveError(f"{self.link.name} did not confirm that its torque is off; {watch}. Cut its power to be sure.")

    # ------------------------------------------------------------------ guards

    def _check_goal(self, goal: Goal, now: float) -> None:
        limits = self.limits
        for name, value in (("angle", goal.angle), ("rate", goal.rate), ("torque", goal.torque)):
            checks.number(f"goal {name}", value)
        least, greatest = limits.angles
        if not least - 1e-9 <= goal.angle <= greatest + 1e-9:
            raise InvalidInput(
                "goal is outside the motor's angles", got=goal.angle, allowed=f"{least:.4g} to {greatest:.4g} rad"
            )
        if abs(goal.rate) > SLACK * limits.speed:
            raise InvalidInput("goal is too fast", got=goal.rate, allowed=f"up to {limits.speed:.4g} rad/s")
        if abs(goal.torque) > SLACK * limits.torque:
            raise InvalidInput("goal's torque is too large", got=goal.torque, allowed=f"up to {limits.torque:.4g} N m")
        if self._goal is None:
            state = self._state
            if state is None or state.stale or now - state.received > SILENCE:
                raise InvalidInput("first goal without a fresh reading", allowed=f"a reading of the last {SILENCE:g} s")
            if abs(goal.angle - state.angle) > FIRST_STEP:
                fix = f"The shaft is at {state.angle:.4f} rad: bring the arm there slowly first"
                raise InvalidInput(
                    "first goal is far from the shaft", got=goal.angle, allowed=f"within {FIRST_STEP} rad", fix=fix
                )
            return
        then, last = self._goal
        dt = now - then
        farthest = SLACK * limits.speed * dt + 1e-3
        if abs(goal.angle - last.angle) > farthest:
            raise InvalidInput(
                "goal jumps", got=goal.angle, allowed=f"within {farthest:.3g} rad of the one {1e3 * dt:.1f} ms before"
            )
        change = SLACK * limits.acceleration * dt + 1e-3 * limits.speed
        if abs(goal.rate - last.rate) > change:
            raise InvalidInput(
                "goal accelerates too fast",
                got=goal.rate,
                allowed=f"within {change:.3g} rad/s of the one {1e3 * dt:.1f} ms before",
            )

    def _exchange(self, request: Callable[[], Reading]) -> DriveState:
        """Make a request; return its reply or, stale, the last one. Latch what the reply shows."""
        try:
            reading = self._guarded(request)
        except NoReply:
            last = self._state
            if last is None:
                raise
            self._state = replace(last, stale=True, lost=last.lost + 1)
            if self._clock() - last.received > SILENCE:
                self._latch(f"no valid reply for {1e3 * (self._clock() - last.received):.0f} ms")
            return self._state
        state = self._placed(reading)
        before, self._state = self._state, state
        self._check_state(state, before)
        return state

    def _check_state(self, state: DriveState, before: DriveState | None) -> None:
        if not self._enabled:
            return
        limits, far = self.limits, ""
        least, greatest = limits.angles
        if state.fault:
            far = f"the device reports {state.fault}"
        elif not state.enabled:
            far = "the device switched its torque off (its watchdog or a limit of its own)"
        elif state.temperature > self.max_temperature:
            far = f"temperature {state.temperature:.0f} C is above {self.max_temperature:g} C"
        elif abs(state.torque) > 1.2 * limits.torque:  # measured torque is rough: a fifth is not yet a fault
            far = f"torque {state.torque:.3g} N m is above the limit of {limits.torque:.3g} N m"
        elif not least - FIRST_STEP <= state.angle <= greatest + FIRST_STEP:
            far = f"the shaft is at {state.angle:.3f} rad, outside {least:.3f} to {greatest:.3f} rad"
        elif before is not None and self._jumped(state, before):
            far = f"the shaft's angle jumped from {before.angle:.3f} to {state.angle:.3f} rad"
        if far:
            self._latch(far)

    def _jumped(self, state: DriveState, before: DriveState) -> bool:
        return abs(state.angle - before.angle) > 2.0 * self.limits.speed * (state.received - before.sent) + FIRST_STEP

    def _check_turn(self, state: DriveState) -> None:
        """Refuse a shaft outside the limits: its counter has wrapped by turns, or the zero is wrong."""
        least, greatest = self.limits.angles
        if least - FIRST_STEP <= state.angle <= greatest + FIRST_STEP:
            return
        turns = round((state.angle - 0.5 * (least + greatest)) / math.tau)
        what = f"{self.link.name}: the shaft is at {state.angle:.3f} rad, outside {least:.3f} to {greatest:.3f} rad"
        if turns:
            what += f", {abs(turns)} turn{'s' * (abs(turns) > 1)} away: its counter may have wrapped"
        raise DriveError(f"{what}. Let the arm hang and set the zero again.")

    def _latch(self, why: str) -> None:
        """Latch a fault, switch the torque off, and raise."""
        self._fault = why
        unsure = ""
        try:
            self.off()
        except DriveError as error:
            unsure = f" {error}"
        raise DriveError(f"{self.link.name}: {why}. Torque is off; acknowledge the fault to go on.{unsure}")

    def _guarded(self, request: Callable[[], Any]) -> Any:
        """Make a request; a link that broke (unplugged, closed) is a lost link."""
        try:
            return request()
        except NoReply:
            raise
        except (DriveError, OSError) as error:
            self._latch(f"the link broke ({error})")

    def _first_reading(self) -> DriveState:
        """Return a reading that answers now; a single lost reply is asked for again."""
        self._require_connection()
        until = self._clock() + CONFIRM
        while True:
            try:
                self._state = self._placed(self.link.read())
                return self._state
            except NoReply as error:
                if self._clock() > until:
                    raise DriveError(f"{self.link.name} does not answer: {error}") from None

    def _placed(self, reading: Reading) -> DriveState:
        """Return a reading in the arm's angle."""
        values = {**vars(reading), "angle": self.direction * (reading.angle - self.zero)}
        return DriveState(**values | {"rate": self.direction * reading.rate, "torque": self.direction * reading.torque})

    def _require_connection(self) -> None:
        if not self._connected:
            raise DriveError(f"{self.link.name} is not connected. Use `with Drive(...) as drive:`.")

    def _catch_signals(self) -> None:
        """End the program on SIGTERM and SIGHUP by SystemExit, so that exits switch the torque off."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                self._signals[number] = signal.signal(number, _end)


def _end(number: int, _: FrameType | None) -> None:
    raise SystemExit(128 + number)
