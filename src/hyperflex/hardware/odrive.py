"""ODrive controllers by CANSimple through python-can. Tried with an emulator only.

Sources: the CAN protocol and the DBC file of firmware 0.6.10 and 0.6.11, python-can 4.6.
"""

import math
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from enum import IntEnum, IntFlag
from functools import partial
from typing import Any

from hyperflex import checks, extras
from hyperflex.errors import DriveError
from hyperflex.hardware.drive import CONFIRM, SILENCE, SLACK, Goal, NoReply, Reading, hottest, persist
from hyperflex.hardware.serial_port import open_problem
from hyperflex.model import MotorLimits

# s after its request at which a frame counts as lost: adapters and busy hosts delay frames by some ms, and two that are
# lost in a row must not stop the drive
LATEST = 0.36 * SILENCE
FIRST_HEARTBEAT = 1.0  # s for the first one after the bus was opened


class Message(IntEnum):
    """Numbers of messages."""

    VERSION = 0x00
    HEARTBEAT = 0x01
    AXIS_STATE = 0x07
    ENCODER = 0x09
    MODE = 0x0B
    INPUT_POS = 0x0C
    LIMITS = 0x0F
    TEMPERATURE = 0x15
    VOLTAGE = 0x17
    CLEAR = 0x18
    TORQUES = 0x1C


class AxisState(IntEnum):
    """States of an axis that matter here."""

    IDLE = 1
    CLOSED_LOOP = 8


class Error(IntFlag):
    """Errors of an axis."""

    INITIALIZING = 1 << 0
    SYSTEM_LEVEL = 1 << 1
    TIMING_ERROR = 1 << 2
    MISSING_ESTIMATE = 1 << 3
    BAD_CONFIG = 1 << 4
    GATE_DRIVER_FAULT = 1 << 5
    MISSING_INPUT = 1 << 6
    DC_BUS_OVER_VOLTAGE = 1 << 8
    DC_BUS_UNDER_VOLTAGE = 1 << 9
    DC_BUS_OVER_CURRENT = 1 << 10
    DC_BUS_OVER_REGEN_CURRENT = 1 << 11
    CURRENT_LIMIT_VIOLATION = 1 << 12
    MOTOR_OVER_TEMPERATURE = 1 << 13
    INVERTER_OVER_TEMPERATURE = 1 << 14
    VELOCITY_LIMIT_VIOLATION = 1 << 15
    POSITION_LIMIT_VIOLATION = 1 << 16
    WATCHDOG_EXPIRED = 1 << 24
    EMERGENCY_STOP_REQUESTED = 1 << 25
    SPINOUT_DETECTED = 1 << 26
    BRAKE_RESISTOR_DISARMED = 1 << 27
    THERMISTOR_DISCONNECTED = 1 << 28
    CALIBRATION_ERROR = 1 << 30


class ODriveLink:
    """An axis of an ODrive (firmware 0.6) on a CAN bus; see :class:`hyperflex.hardware.Link`.

    Parameters
    ----------
    channel : str
        CAN interface ("can0"), or the serial port of an adapter that speaks slcan ("/dev/ttyACM0").
    number : int
        Node ID of the axis, 0 to 63.
    interface : str
        Interface of python-can; empty for "slcan" on a path and "socketcan" otherwise.
    bitrate : int
        Of the bus, bit/s. A socketcan interface has its rate from ``ip link``.
    watchdog : float
        What `watchdog_timeout` of the axis is set to, s.
    trial : bool
        Whether the first :meth:`enable` tries the watchdog.
    torque_constant : float
        Of the motor, N m/A (8.27 / KV); 0 if it is not known. With it, a limit of torque is set in the device, and
        twice the limit of speed, for it must catch up; without it a limit of torque is refused.
    patience : float
        Time that a request may take, s.
    clock : callable
        Monotonic time, s, of the stamps.

    Notes
    -----
    CANSimple sets neither the watchdog nor the rates of messages, so set them with odrivetool once::

        odrv0.axis0.config.watchdog_timeout = 0.1
        odrv0.axis0.config.enable_watchdog = True
        odrv0.axis0.config.can.heartbeat_msg_rate_ms = 10
        odrv0.axis0.config.can.encoder_msg_rate_ms = 0
        odrv0.axis0.config.can.torques_msg_rate_ms = 10
        odrv0.axis0.config.can.bus_voltage_msg_rate_ms = 100
        odrv0.axis0.config.can.temperature_msg_rate_ms = 100
        odrv0.save_configuration()

    Angle and rate answer a request in each cycle. State and errors come with the heartbeat, so they are up to 10 ms
    old; torque, voltage and temperature are those of the last message, NaN if it is older than 50 ms, or 0.5 s for
    voltage and temperature. An axis that keeps a limit of torque must tell it: else a reply does not count.

    No message tells whether the watchdog is armed. Therefore the first :meth:`enable` tries it: with the torque on and
    the arm at rest, it sends nothing for a little longer than the watchdog's time. An axis that is not disarmed by then
    is refused.

    Frames bear no number. After one that is missing, nothing is asked for until it has come, or 18 ms have passed and a
    message has come that was asked for later, while goals are still sent. So a late frame never passes for a newer one,
    as long as frames of the axis keep their order.

    Values are those of the motor's shaft: a gear between it and the arm is not known here. The axis must be calibrated.
    """

    takes = frozenset({"rate", "torque"})

    def __init__(
        self,
        channel: str,
        number: int = 0,
        *,
        interface: str = "",
        bitrate: int = 250_000,
        watchdog: float = 0.1,
        trial: bool = True,
        torque_constant: float = 0.0,
        patience: float = 4e-3,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.channel = checks.text("channel", channel)
        self.number = checks.count("odrive id", number, least=0, most=63)
        self.interface = interface or ("slcan" if channel.startswith("/") else "socketcan")
        self.bitrate = checks.count("bitrate", bitrate)
        self.watchdog = checks.positive("watchdog", watchdog, "s")
        self.torque_constant = checks.number("torque_constant", torque_constant, sign="nonnegative", unit="N m/A")
        self.patience = checks.positive("patience", patience, "s")
        self.clock, self.name = clock, f"odrive {number} on {channel}"
        self._trial = bool(trial)
        self._bus: Any = None
        self._messages: dict[int, bytes] = {}  # the newest of each kind
        self._came = dict.fromkeys(range(32), -math.inf)  # when it came, s
        self._limited = False  # whether there is a limit of torque
        self._asked = -math.inf  # when the encoder was asked for last, s
        self._missing = 0  # replies of the encoder that have not come

    # ------------------------------------------------------------------ connection

    def open(self) -> None:
        """Open the bus and find the axis; its torque stays as it is."""
        extras.require(("can",), "odrive", "ODrive controllers")
        self._bus = self._open_bus()
        self._messages, self._came, self._missing = {}, dict.fromkeys(self._came, -math.inf), 0
        self._identify()

    def close(self) -> None:
        """Close the bus."""
        if self._bus is not None:
            with suppress(Exception):  # a broken port may fail at anything
                self._bus.shutdown()

    def _open_bus(self) -> Any:
        import can

        options: dict[str, Any] = {"bitrate": self.bitrate}
        if self.interface == "slcan":
            # s; python-can waits 2 s after opening, for adapters that reset then, and 1 ms whenever nothing is there
            options |= {"sleep_after_open": 0.1, "timeout": 1e-4}
        try:
            return can.Bus(channel=self.channel, interface=self.interface, **options)
        except (OSError, ValueError, can.CanError) as error:
            if self.interface != "socketcan":
                raise open_problem(self.channel, error) from None
            fix = f"Set it up: sudo ip link set {self.channel} up type can bitrate {self.bitrate}"
            raise DriveError(f"{self.channel}: no CAN interface of that name is ready ({error}). {fix}.") from None

    def _identify(self) -> None:
        """Wait for the axis and check what it sends, or say who else is on the bus."""
        others: set[int] = set()

        def found(node: int, _: int) -> bool:
            others.add(node)
            return node == self.number and self._beat > -math.inf

        if not self._listen(FIRST_HEARTBEAT, found):
            if others:
                nodes = ", ".join(map(str, sorted(others)))
                raise DriveError(f"{self.name} sends no heartbeat. Nodes on this bus: {nodes}.")
            fix = f"Check power, wiring, termination, and that the bus runs at {self.bitrate} bit/s"
            raise DriveError(f"{self.name}: nothing is heard on the bus. {fix}.")
        first = self._beat
        if not self._listen(SILENCE, lambda *_: self._beat > first):
            fix = "Set axis0.config.can.heartbeat_msg_rate_ms = 10 with odrivetool"
            raise DriveError(f"{self.name} sends its heartbeat less than once in {1e3 * SILENCE:.0f} ms. {fix}.")
        if Message.ENCODER in self._messages:
            fix = "Set axis0.config.can.encoder_msg_rate_ms = 0 with odrivetool"
            raise DriveError(f"{self.name} sends its encoder's estimates unasked. {fix}.")
        for _ in range(3):
            self._send(Message.VERSION)
            if self._listen(SILENCE, lambda *_: Message.VERSION in self._messages):
                break
        else:
            raise DriveError(f"{self.name} does not report its version: it is not an ODrive with firmware 0.6.")
        firmware = tuple(self._messages[Message.VERSION][4:7])
        if firmware < (0, 6):
            had = ".".join(map(str, firmware))
            raise DriveError(f"{self.name}: firmware {had} speaks another CANSimple. Update it to 0.6.")

    # ------------------------------------------------------------------ link

    def read(self) -> Reading:
        """Return the state."""
        return self._exchange()

    def enable(self, limits: MotorLimits) -> None:
        """Set the limits, switch the torque on where the shaft is, and try the watchdog if that was not done before."""
        self._limited = math.isfinite(limits.torque)
        if self._limited:
            if not self.torque_constant:
                fix = "Give its torque constant, N m/A (8.27 / KV): odrive:can0?torque_constant=0.05"
                raise DriveError(f"{self.name} keeps no limit of torque without the constant of its motor. {fix}")
            told = self._listen(SILENCE, lambda *_: math.isfinite(self._pair(Message.TORQUES)[1]))
            if not told:
                fix = "Set axis0.config.can.torques_msg_rate_ms = 10 with odrivetool"
                raise DriveError(f"{self.name} does not report its torque, which has a limit. {fix}.")
        self._arm(limits)
        if self._trial:
            self._try_watchdog()
            self._arm(limits)
            self._trial = False

    def send(self, goal: Goal) -> Reading:
        """Send a raw goal and return the state after it."""
        return self._exchange(_input(goal))

    def disable(self) -> None:
        """Make the axis idle; the state tells whether it is, as soon as the next heartbeat has come."""
        self._send(Message.AXIS_STATE, struct.pack("<I", AxisState.IDLE))
        self._expect(AxisState.CLOSED_LOOP)

    def clear(self) -> None:
        """Clear all errors, and wait until they are."""
        self._send(Message.CLEAR, b"\x00")
        self._listen(2.0 * SILENCE, lambda node, command: command == Message.HEARTBEAT and not self._errors)

    def _arm(self, limits: MotorLimits) -> None:
        """Go into closed-loop control with the present angle as goal, feeding the watchdog meanwhile."""
        self._expect(AxisState.IDLE)
        until = self.clock() + CONFIRM
        while True:
            here = _input(Goal(persist(self._exchange, self.clock).angle))  # anew each time: the arm may swing
            if self._limited:
                speed, current = limits.speed / math.tau, limits.torque / self.torque_constant
                self._send(Message.LIMITS, struct.pack("<ff", 2.0 * speed, SLACK * current))
            self._send(Message.MODE, struct.pack("<II", 3, 1))  # position control, inputs passed through
            self._send(Message.INPUT_POS, here)
            self._send(Message.AXIS_STATE, struct.pack("<I", AxisState.CLOSED_LOOP))
            beat = self._beat
            while self._beat <= beat:
                state = persist(partial(self._exchange, here), self.clock)
            if self._axis == AxisState.CLOSED_LOOP and not state.fault:
                return
            if state.fault or self.clock() > until:
                self.disable()
                why = state.fault or "it stays idle: calibrate it with odrivetool"
                raise DriveError(f"{self.name} does not switch its torque on ({why}).")

    def _try_watchdog(self) -> None:
        """Send nothing for a little longer than the watchdog's time, and refuse an axis that is still armed then."""
        self._listen(1.2 * self.watchdog, lambda *_: False)
        stopped = self._listen(2.0 * SILENCE, lambda *_: bool(self._errors & Error.WATCHDOG_EXPIRED))
        if not stopped:
            self.disable()
            fix = f"Set axis0.config.watchdog_timeout = {self.watchdog:g} and enable_watchdog = True with odrivetool"
            raise DriveError(f"{self.name}: its watchdog did not stop it within {self.watchdog:g} s. {fix}.")
        self.clear()

    # ------------------------------------------------------------------ frames

    @property
    def _beat(self) -> float:
        """When the last heartbeat came, s."""
        return self._came[Message.HEARTBEAT]

    @property
    def _errors(self) -> int:
        return int.from_bytes(self._messages[Message.HEARTBEAT][:4], "little")

    @property
    def _axis(self) -> int:
        """State of the axis."""
        return self._messages[Message.HEARTBEAT][4]

    def _expect(self, state: AxisState) -> None:
        """Take the axis to be in a state until a heartbeat says what it is in."""
        beat = self._messages[Message.HEARTBEAT]
        self._messages[Message.HEARTBEAT] = beat[:4] + bytes([state]) + beat[5:]

    def _exchange(self, goal: bytes = b"") -> Reading:
        """Send a goal, if there is one, ask for the encoder's estimates, and return the state."""
        until = time.monotonic() + self.patience
        self._listen(0.0, lambda *_: False)  # what came meanwhile
        if goal:
            self._send(Message.INPUT_POS, goal)
        if not self._settled():
            if self._came[Message.VERSION] < self._asked:
                self._send(Message.VERSION)
            if not self._listen(until - time.monotonic(), lambda *_: self._settled()):
                raise NoReply(f"{self.name}: a reply to an earlier request is still missing")
        sent = self.clock()
        self._send(Message.ENCODER)
        self._asked, self._missing = sent, 1
        if not self._listen(until - time.monotonic(), lambda *_: not self._missing):
            raise NoReply(f"{self.name}: no valid reply")
        received = self.clock()
        if received - self._beat > SILENCE + self.patience:
            raise NoReply(f"{self.name}: no heartbeat for {1e3 * (received - self._beat):.0f} ms")
        angle, rate = self._pair(Message.ENCODER)
        torque, enabled = self._pair(Message.TORQUES)[1], self._axis != AxisState.IDLE
        if self._limited and enabled and math.isnan(torque):
            raise NoReply(f"{self.name}: it no longer reports its torque, which has a limit")
        return Reading(
            angle=angle * math.tau,
            rate=rate * math.tau,
            torque=torque,
            voltage=self._pair(Message.VOLTAGE, 10.0)[0],
            temperature=hottest(self._pair(Message.TEMPERATURE, 10.0)),  # of inverter and motor, if that has one
            enabled=enabled,  # whatever its errors: it may turn in a calibration
            fault=_fault(self._errors),
            sent=sent,
            received=received,
        )

    def _settled(self) -> bool:
        """Return whether the encoder's reply has come, or is lost: a message that was asked for later has come."""
        later = self._came[Message.VERSION] > self._asked
        return not self._missing or (later and self.clock() - self._asked >= LATEST)

    def _pair(self, message: Message, rarer: float = 1.0) -> tuple[float, float]:
        """Return the numbers of the newest message of a kind; NaN if it is older than SILENCE, `rarer` times that."""
        if self.clock() - self._came[message] > rarer * SILENCE + self.patience:
            return math.nan, math.nan
        return struct.unpack("<ff", self._messages[message])

    def _send(self, message: Message, data: bytes = b"") -> None:
        """Send a message; without data it is a request for it."""
        import can

        identifier = self.number << 5 | message
        frame = can.Message(
            arbitration_id=identifier, data=data or None, is_remote_frame=not data, is_extended_id=False
        )
        self._bus.send(frame, timeout=SILENCE)

    def _listen(self, seconds: float, done: Callable[[int, int], bool]) -> bool:
        """Take frames until `done`, called with node and message number after each, or for a time; return whether."""
        until = time.monotonic() + seconds
        while True:
            rest = until - time.monotonic()
            frame = self._receive(max(0.0, rest))
            if frame and done(*frame):
                return True
            if rest <= 0.0 and not frame:
                return False

    def _receive(self, timeout: float) -> tuple[int, int] | None:
        """Take the next frame of 8 bytes, if one comes, and note it; return its node and message number."""
        import can

        try:
            frame = self._bus.recv(timeout)
        except (ValueError, IndexError):
            return None  # a garbled line of an slcan adapter
        except can.CanOperationError as error:
            if not isinstance(error.__cause__, UnicodeDecodeError):
                raise
            self._bus.flush()  # another one: python-can would try to read it again and again
            return None
        if frame is None or frame.is_remote_frame or frame.is_error_frame or len(frame.data) != 8:
            return None
        node, message = frame.arbitration_id >> 5, frame.arbitration_id & 31
        if node == self.number:
            self._messages[message], self._came[message] = bytes(frame.data), self.clock()
            if message == Message.ENCODER:
                self._missing = max(0, self._missing - 1)
        return node, message


def _input(goal: Goal) -> bytes:
    """Return a goal as Set_Input_Pos takes it: turns, and thousandths of turns/s and of N m."""
    feeds = (1e3 * goal.rate / math.tau, 1e3 * goal.torque)
    return struct.pack("<fhh", goal.angle / math.tau, *(max(-32768, min(32767, round(value))) for value in feeds))


def _fault(errors: int) -> str:
    """Return errors in words, empty for none."""
    names = [str(error.name).lower().replace("_", " ") for error in Error if errors & error]
    return f"{' and '.join(names) or 'unknown'} (error {errors:#x})" if errors else ""
