"""A drive: a motor with its own controller, behind guards that are the same for every make.

A make's protocol is a :class:`Link`. :class:`Drive` owns everything that keeps gears, ropes and people safe: what may
be sent, when torque is on, and that it is off at every exit. Angles are those of the arm: 0 hangs down, pi/2 points
along +x.
"""

import atexit
import math
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import FrameType
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from hyperflex import checks
from hyperflex.core.chain.drive import TORQUE, X, Y
from hyperflex.errors import DriveError, HyperflexError, InvalidInput
from hyperflex.model import MotorLimits
from hyperflex.motion import Motion

T = TypeVar("T")
STEP = 0.05  # rad; a goal that jumps by more, or a first one farther from the shaft, would be a jerk (a stripped gear)
SILENCE = 0.05  # s without a valid reply after which the link counts as lost, or half of a watchdog beyond 100 ms
SLACK = 1.02  # of a limit: goals are sampled from polynomials that reach the limit exactly, and rounded on the wire
CONFIRM = 0.2  # s for which a request that must be answered (torque off, first reading) is repeated


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


def hottest(temperatures: Iterable[float]) -> float:
    """Return the greatest of the temperatures that are known; NaN if none is."""
    return max((each for each in temperatures if not math.isnan(each)), default=math.nan)


class NoReply(DriveError):
    """A single request got no valid reply in time: lost, late, garbled or truncated. Links raise it."""


def persist(request: Callable[[], T], clock: Callable[[], float], seconds: float = CONFIRM) -> T:
    """Return what a request returns; while there is no reply, repeat it for a time, s, of a clock."""
    until = clock() + seconds
    while True:
        try:
            return request()
        except NoReply:
            if clock() > until:
                raise


class Link(Protocol):
    """A make's protocol. Angles are raw: radians of the shaft from the device's own zero, many turns if it counts them.

    Every call but `open` returns within some milliseconds, with a reply or with NoReply. A reply that comes later never
    counts as the answer to a later request. Nothing moves before `enable`.

    Attributes
    ----------
    name : str
        Make, number and port, as messages name it ("moteus 1 on /dev/ttyACM0").
    watchdog : float
        Time, s, after which the device itself stops without a request. What that means differs: an ODrive is without
        torque then, a moteus damps the arm unless its setting servo.timeout_mode is 0, a Dynamixel holds it.
    takes : frozenset of {"rate", "torque"}
        What it takes with an angle.
    clock : callable
        Monotonic time, s, of the readings' stamps and of the guards; :func:`time.monotonic` but in tests.
    """

    name: str
    watchdog: float
    takes: frozenset[str]
    clock: Callable[[], float]

    def open(self) -> None:
        """Open the port and identify the device; DriveError says what is wrong (port, permission, rate, device).

        After an error the caller closes the link.
        """

    def read(self) -> Reading:
        """Return the state; NoReply without a valid reply."""

    def enable(self, limits: MotorLimits) -> None:
        """Arm the device's watchdog and limits, and switch the torque on with the present angle as goal.

        NoReply without a valid reply; it may be repeated then.
        """

    def send(self, goal: Goal) -> Reading:
        """Send a raw goal and return the state that answers it; NoReply without a valid reply."""

    def disable(self) -> None:
        """Switch the torque off; NoReply without a reply."""

    def clear(self) -> None:
        """Clear the device's fault; the torque stays off. NoReply without a reply."""

    def close(self) -> None:
        """Close the port. Never raises."""


class _Pace:
    """How fast a value may change: by `limit` per second, and at most `spare` ahead of that (jitter of the host)."""

    def __init__(self, limit: float, spare: float) -> None:
        self.limit, self.spare, self.left = SLACK * limit, spare, spare

    def allowed(self, dt: float) -> float:
        """Return the greatest change after a time `dt`, s."""
        return self.left + self.limit * dt

    def spend(self, change: float, dt: float) -> None:
        """Count a change that was made."""
        self.left = min(self.spare, self.allowed(dt) - change)


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
    max_deviation : float
        Angle, rad, between the last goal and the shaft at which the torque is switched off: a stop was hit, or the
        motor is too weak. It must exceed the drive's lag times the speed.

    Raises
    ------
    InvalidInput
        For a goal beyond a limit of angle, speed or acceleration, or a first goal more than 0.05 rad from the shaft;
        nothing is sent, and the arm holds the last goal until the watchdog expires.
    DriveError
        If the device is in fault, cannot be reached, or does not answer. The torque is off and the fault stays latched
        until :meth:`acknowledge`.

    Notes
    -----
    Guards, in the order in which they act: the device must be free of faults on connection; when its torque is switched
    on, its angle must lie within the limits (a counter that wrapped is named, if the limits span less than a turn); a
    goal must lie within the limits, leave room to brake before those of the angle, and lie near the shaft if it is the
    first, and its feed-forward torque is clipped; each reply is checked for faults, temperature, torque, an angle
    outside the limits, deviation and jumps (temperature, torque and deviation act once seen in three readings in a row,
    or for 15 ms); the device's own watchdog stops it when the host falls silent.

    While it is connected, SIGTERM and SIGHUP end a program that does not handle them through the same exit as an
    exception. No signal, so no Ctrl-C, interrupts an exchange with the device or the switching off of its torque: it is
    handled right after. Another thread may call :meth:`off` at any time.
    """

    def __init__(
        self,
        link: Link,
        limits: MotorLimits,
        *,
        zero: float = 0.0,
        direction: int = 1,
        max_temperature: float = 70.0,
        max_deviation: float = 0.5,
    ) -> None:
        self.link, self.limits = link, checks.instance("limits", limits, MotorLimits)
        self.zero = checks.number("zero", zero, unit="rad")
        if direction not in (1, -1):
            raise InvalidInput("direction of a drive", got=direction, allowed="1 or -1")
        self.direction = direction
        self.max_temperature = checks.positive("max_temperature", max_temperature, "C")
        self.silence = max(SILENCE, 0.5 * link.watchdog)  # s without a valid reply after which the link counts as lost
        self.max_deviation = checks.positive("max_deviation", max_deviation, "rad")
        self._state: DriveState | None = None
        self._fault = ""  # latched
        self._connected = self._enabled = False  # enabled: the torque may be on
        self._silent: float | None = None  # since when requests have not been answered
        self._goal = Goal(0.0)  # the last one, or the angle at which the torque came on
        self._sent: float | None = None  # its time, s; None before the first one
        self._beyond: list[float] = []  # when readings in a row were received that were beyond a limit, s
        self._lock = threading.RLock()
        self._signals: dict[int, Any] = {}  # handlers of before
        self._whole_blocks = self._pending = 0

    # ------------------------------------------------------------------ connection

    def connect(self, *, clear_fault: bool = False) -> DriveState:
        """Open the link and read the state. Nothing moves; torque that was left on is switched off.

        A device that is in fault is refused, and nothing is sent to it, unless `clear_fault` acknowledges its fault.
        """
        if self._connected:
            raise DriveError(f"{self.link.name} is connected already.")
        self._catch_signals()
        atexit.register(self.close)
        self._connected = True
        try:
            with self._whole():
                try:
                    self.link.open()
                except HyperflexError:
                    raise
                except Exception as error:
                    raise DriveError(f"{self.link.name}: the link broke ({error}).") from error
                state = self._first_reading()
                self._enabled = state.enabled
                if self._enabled:
                    self.off()
                if clear_fault:
                    self.acknowledge()
                elif state.fault:
                    fix = "Remove the cause, then give clear_fault=True"
                    raise DriveError(f"{self.link.name}: the device reports {state.fault}. {fix}.")
                return self._first_reading()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Switch the torque off and close the link; does nothing a second time."""
        with self._whole():
            if not self._connected:
                return
            try:
                if self._enabled:
                    self.off()
            finally:
                self._connected = False
                self.link.close()
                atexit.unregister(self.close)
                self._release_signals()

    def __enter__(self) -> Self:
        if not self._connected:
            self.connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        try:
            self.close()
        except DriveError:  # not confirmed off; an error of the drive that is on its way says so already
            if not isinstance(error, DriveError):
                raise

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
        with self._whole():
            self._require_connection()
            return self._exchange(self.link.read)

    def set_zero(self, angle: float) -> float:
        """Declare the arm's present angle, rad, with the torque off; return the raw angle of the zero to be kept.

        It is the mean of half a second. InvalidInput if the angle changes by more than 0.02 rad meanwhile.
        """
        angle, seen = checks.number("angle", angle, unit="rad"), list[float]()
        with self._whole():
            self._require_connection()
            until = self.link.clock() + 0.5
            while not seen or self.link.clock() < until:
                if self._enabled or (now := self._first_reading()).enabled:
                    raise DriveError("The zero of a drive is set with its torque off.")
                seen.append(now.angle)
            if not (spread := float(np.ptp(seen))) <= 0.02:
                raise InvalidInput(
                    "the arm still swings", got=spread, allowed="0.02 rad in half a second", fix="Let it come to rest"
                )
            moved = float(np.mean(seen)) - angle
            self.zero += self.direction * moved
            self._state = replace(now, angle=now.angle - moved)
            return self.zero

    def acknowledge(self) -> None:
        """Clear a latched fault, in the device as well; the torque is off."""
        with self._whole():
            self._require_connection()
            if self._enabled:
                self.off()
            self._insist(self.link.clear)
            state = self._first_reading()
            self._fault = ""
            if state.fault:
                self._latch(f"the device still reports {state.fault}")

    # ------------------------------------------------------------------ motion

    def enable(self) -> DriveState:
        """Switch the torque on; the arm holds where it is."""
        with self._whole():
            self._require_connection()
            if self._fault:
                raise DriveError(f"{self.link.name}: {self._fault}. Remove the cause, then acknowledge the fault.")
            before = self._first_reading()
            if before.fault:
                self._latch(f"the device reports {before.fault}")
            self.check_turn(before)
            self._goal, self._sent, self._beyond = Goal(before.angle), None, []
            limits = self.limits
            self._angle_pace = _Pace(limits.speed, STEP)
            self._rate_pace = _Pace(limits.acceleration, STEP * limits.acceleration / limits.speed)
            self._enabled = True  # before it is: whatever happens now must switch it off
            try:
                self._insist(lambda: self.link.enable(limits))
                state = self._first_reading()
                self._check_state(state, before)
            except BaseException:
                if self._enabled:
                    self.off()
                raise
            return state

    def command(self, goal: Goal, at: float | None = None) -> DriveState:
        """Check a goal against all limits, send it, and return the state that answers it.

        `at` is the time, s, on the link's monotonic clock for which the goal was evaluated; now without it. It must not
        be older than 50 ms, or half of a watchdog of more than 100 ms, nor more than 1 ms ahead. A goal that the host
        sends late is then judged by its own time.

        The first goal after :meth:`enable` must lie within 0.05 rad of the shaft. Later ones may differ from the one
        before by what the limits of speed and acceleration allow in the time between them (of which 50 ms count at
        most); together they may be ahead of that by 0.05 rad. A feed-forward torque beyond its limit is clipped to it:
        to refuse it would let the arm fall in the middle of a motion.
        """
        with self._whole():
            self._require_connection()
            if not self._enabled or self._fault:
                why = self._fault or "its torque is off. Enable it first"
                raise DriveError(f"{self.link.name}: {why}.")
            now = self.link.clock()
            at = now if at is None else checks.number("at", at, unit="s")
            if not now - self.silence <= at <= now + 1e-3:
                raise InvalidInput(
                    "goal's time is not now",
                    got=f"{1e3 * (at - now):.1f} ms from now",
                    allowed=f"{-1e3 * self.silence:g} to 1 ms",
                )
            self._check_goal(goal, now, at)
            torque = max(-self.limits.torque, min(self.limits.torque, goal.torque))
            sign = self.direction
            raw = Goal(self.zero + sign * goal.angle, sign * goal.rate, sign * torque)
            self._goal, self._sent = goal, at
            return self._exchange(lambda: self.link.send(raw))

    def off(self) -> None:
        """Switch the torque off, and ask again until the device confirms.

        Raises
        ------
        DriveError
            If it does not confirm within 0.2 s: then only its own watchdog stops it.
        """
        with self._whole():
            if not self._connected:
                return
            until = self.link.clock() + CONFIRM
            while True:
                try:
                    self.link.disable()
                    state = self._placed(self.link.read())
                except Exception:  # noqa: BLE001 whatever it is, what counts is to ask again
                    pass
                else:
                    self._enabled = state.enabled
                    if not state.enabled:
                        return
                if self.link.clock() > until:
                    break
        watch = f"its watchdog stops it {self.link.watchdog:g} s after the last goal"
        raise DriveError(f"{self.link.name} did not confirm that its torque is off; {watch}. Cut its power to be sure.")

    # ------------------------------------------------------------------ guards

    def check_motion(self, motion: Motion) -> None:
        """Check a whole motion against the limits of angle, speed and acceleration, before it is run.

        The extrema of its polynomials are exact. Feed-forward torques are clipped when they are sent.

        Raises
        ------
        InvalidInput
            For a motion beyond a limit, with the time and the value; for one whose angle or rate jumps, that moves the
            pivot, or that prescribes torques.
        """
        checks.instance("motion", motion, Motion)
        if motion.coef[:, [X, Y], 1:].any() or motion.coef[:, TORQUE:].any():
            raise InvalidInput(
                "a drive cannot carry out this motion",
                got=motion,
                allowed="a motion of the arm's angle, without a moving pivot and without torques",
            )
        limits = self.limits
        bounds = {
            "angle": (limits.angles, "rad"),
            "rate": ((-SLACK * limits.speed, SLACK * limits.speed), "rad/s"),
            "acceleration": ((-SLACK * limits.acceleration, SLACK * limits.acceleration), "rad/s^2"),
        }
        for derivative, (name, ((least, greatest), unit)) in enumerate(bounds.items()):
            times, values = motion.extrema(derivative)
            excess = np.maximum(values - greatest, least - values)
            worst = int(excess.argmax())
            if excess[worst] > 1e-9:  # rad: rounding of the polynomials
                raise InvalidInput(
                    f"the motion's {name} at t = {times[worst]:.3f} s is beyond the limits of the motor",
                    got=round(float(values[worst]), 4),
                    allowed=f"{least:.4g} to {greatest:.4g} {unit}",
                )
        for derivative, name in enumerate(("angle", "rate")):
            times, jumps = motion.jumps(derivative)
            worst = int(np.abs(jumps).argmax())
            if abs(jumps[worst]) > 1e-6:  # rad, rad/s: rounding of a file's digits
                raise InvalidInput(
                    f"the motion's {name} jumps at t = {times[worst]:.3f} s",
                    got=round(float(jumps[worst]), 6),
                    allowed="a motion that starts and ends at rest, without jumps",
                )

    def check_turn(self, state: DriveState) -> None:
        """Refuse a shaft outside the limits: its counter has wrapped by turns, or the zero is wrong."""
        if not (outside := self._outside(state)):
            return
        away = (state.angle - 0.5 * sum(self.limits.angles)) / math.tau
        turns = round(away) if math.isfinite(away) else 0
        if turns:
            outside += f", {abs(turns)} turn{'s' * (abs(turns) > 1)} away: its counter may have wrapped"
        raise DriveError(f"{self.link.name}: {outside}. Let the arm hang and set the zero again.")

    def _outside(self, state: DriveState) -> str:
        """Return where the shaft is if it is outside its limits; else nothing."""
        least, greatest = self.limits.angles
        if least - STEP <= state.angle <= greatest + STEP:
            return ""
        return f"the shaft is at {state.angle:.3f} rad, outside {least:.3f} to {greatest:.3f} rad"

    def _check_goal(self, goal: Goal, now: float, at: float) -> None:
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
        stop = goal.angle + 0.5 * goal.rate * abs(goal.rate) / (SLACK * limits.acceleration)
        if not least - STEP <= stop <= greatest + STEP:
            allowed = f"a rate that can be braked within {least:.4g} to {greatest:.4g} rad"
            raise InvalidInput(f"goal at {goal.angle:.4g} rad leaves no room to brake", got=goal.rate, allowed=allowed)
        dt, since = 0.0, "in a first goal"
        if self._sent is None:
            self._check_first(goal, now)
        else:
            dt = min(at - self._sent, SILENCE)
            since = f"from a goal {1e3 * (at - self._sent):.1f} ms before"
        way, change = abs(goal.angle - self._goal.angle), abs(goal.rate - self._goal.rate)
        for name, moved, pace, unit in (
            ("jumps", way, self._angle_pace, "rad"),
            ("changes its rate too fast", change, self._rate_pace, "rad/s"),
        ):
            if moved > pace.allowed(dt):
                allowed = f"by up to {pace.allowed(dt):.3g} {unit}"
                raise InvalidInput(f"goal {name} {since}", got=round(moved, 4), allowed=allowed)
        self._angle_pace.spend(way, dt)
        self._rate_pace.spend(change, dt)

    def _check_first(self, goal: Goal, now: float) -> None:
        """Refuse a first goal that is not where the shaft is now; what follows is counted from the shaft."""
        state = self._state
        if state is None or state.stale or now - state.received > self.silence:
            raise InvalidInput(
                "first goal without a fresh reading", allowed=f"a reading of the last {self.silence:g} s"
            )
        if not abs(goal.angle - state.angle) <= STEP:
            raise InvalidInput(
                "first goal is far from the shaft",
                got=goal.angle,
                allowed=f"within {STEP} rad",
                fix=f"The shaft is at {state.angle:.4f} rad: bring the arm there slowly first",
            )
        self._goal = Goal(state.angle)

    def _exchange(self, request: Callable[[], Reading]) -> DriveState:
        """Make a request; return its reply or, stale, the last one. Latch what the reply shows."""
        begun, before = self.link.clock(), self._state
        try:
            state = self._placed(self._guarded(request))
        except NoReply:
            if before is None:
                raise
            self._silent = begun if self._silent is None else self._silent
            self._state = replace(before, stale=True, lost=before.lost + 1)
            silence = self.link.clock() - self._silent
            if silence > self.silence:
                self._latch(f"no valid reply for {1e3 * silence:.0f} ms")
            return self._state
        self._check_state(state, before)
        return state

    def _check_state(self, state: DriveState, before: DriveState | None) -> None:
        if not self._enabled:
            return
        wrong, beyond = "", self._beyond_limits(state)
        self._beyond = [*self._beyond, state.received] if beyond else []
        if state.fault:
            wrong = f"the device reports {state.fault}"
        elif not state.enabled:
            wrong = "the device switched its torque off (its watchdog or a limit of its own)"
        elif outside := self._outside(state):
            wrong = outside
        elif before is not None and self._jumped(state, before):
            wrong = f"the shaft's angle jumped from {before.angle:.3f} to {state.angle:.3f} rad"
        elif len(self._beyond) >= 3 or (beyond and state.received - self._beyond[0] >= 0.015):
            wrong = beyond
        if wrong:
            self._latch(wrong)

    def _beyond_limits(self, state: DriveState) -> str:
        """Return which limit a reading is beyond that one reading alone may be beyond by a disturbance, or nothing."""
        if state.temperature > self.max_temperature:
            return f"temperature {state.temperature:.0f} C is above {self.max_temperature:g} C"
        if abs(state.torque) > 1.2 * self.limits.torque:  # measured torque is rough: a fifth is not yet a fault
            return f"torque {state.torque:.3g} N m is above the limit of {self.limits.torque:.3g} N m"
        if abs(state.angle - self._goal.angle) > self.max_deviation:
            return f"the shaft is at {state.angle:.3f} rad, the goal at {self._goal.angle:.3f} rad: it does not follow"
        return ""

    def _jumped(self, state: DriveState, before: DriveState) -> bool:
        return abs(state.angle - before.angle) > 2.0 * self.limits.speed * (state.received - before.sent) + STEP

    def _latch(self, why: str) -> None:
        """Latch a fault, switch the torque off, and raise."""
        self._fault = self._fault or why
        unsure = ""
        if self._enabled:
            try:
                self.off()
            except DriveError as error:
                unsure = f" {error}"
        off = "" if unsure else " Torque is off; acknowledge the fault to continue."
        raise DriveError(f"{self.link.name}: {why}.{off}{unsure}")

    def _guarded(self, request: Callable[[], Any]) -> Any:
        """Make a request; what the link refuses is a fault, and any other error (unplugged, a bug) is a lost link."""
        try:
            return request()
        except NoReply:
            raise
        except DriveError as error:
            self._latch(str(error).removeprefix(self.link.name).lstrip(": ").rstrip("."))
        except Exception as error:  # noqa: BLE001 whatever it is, the torque must be off first
            self._latch(f"the link broke ({error})")

    def _insist(self, request: Callable[[], Any]) -> Any:
        """Make a request that must be answered, and repeat it for a while."""
        try:
            return persist(lambda: self._guarded(request), self.link.clock)
        except NoReply as error:
            raise DriveError(f"{self.link.name} does not answer: {error}") from None

    def _first_reading(self) -> DriveState:
        """Return a reading that answers now."""
        return self._placed(self._insist(self.link.read))

    def _placed(self, reading: Reading) -> DriveState:
        """Return a reading in the arm's angle, which is the state from now on."""
        sign = self.direction
        values = {**vars(reading), "angle": sign * (reading.angle - self.zero)}
        self._state = DriveState(**values | {"rate": sign * reading.rate, "torque": sign * reading.torque})
        self._silent = None
        return self._state

    def _require_connection(self) -> None:
        if not self._connected:
            raise DriveError(f"{self.link.name} is not connected. Use `with Drive(...) as drive:`.")

    # ------------------------------------------------------------------ signals

    def _catch_signals(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            return
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            before = signal.getsignal(number)
            if before not in (None, signal.SIG_IGN, self._on_signal):
                self._signals[number] = before
                signal.signal(number, self._on_signal)

    def _release_signals(self) -> None:
        if threading.current_thread() is threading.main_thread():
            for number, before in self._signals.items():
                if signal.getsignal(number) == self._on_signal:
                    signal.signal(number, before)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._whole_blocks:
            self._pending = self._pending or number
        elif callable(self._signals[number]):
            self._signals[number](number, frame)
        else:
            raise SystemExit(128 + number)

    @contextmanager
    def _whole(self) -> Iterator[None]:
        """Run a block whole: other threads wait, and signals are handled at its end."""
        main = threading.current_thread() is threading.main_thread()
        self._whole_blocks += main
        try:
            with self._lock:
                yield
        finally:
            self._whole_blocks -= main
            if main and self._pending and not self._whole_blocks:
                number, self._pending = self._pending, 0
                self._on_signal(number, None)
