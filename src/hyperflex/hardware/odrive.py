"""ODrive controllers by CANSimple through python-can. Tried with an emulator only.

Sources: the CAN protocol and the DBC file of firmware 0.6.10 and 0.6.11, python-can 4.6.
"""

import math
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from hyperflex import extras
from hyperflex.errors import DriveError
from hyperflex.hardware.drive import CONFIRM, SILENCE, SLACK, Goal, NoReply, Reading
from hyperflex.hardware.serial_port import open_problem
from hyperflex.model import MotorLimits

PATIENCE = 4e-3  # s for all replies of a cycle; at 1 Mbit/s they take 1 ms, at 250 kbit/s 3 ms
FIRST_HEARTBEAT = 1.0  # s for the first one after the bus was opened; the default is one each 0.1 s
OLDEST_HEARTBEAT = 0.25  # s; without a newer one nobody knows whether the axis is armed

VERSION, HEARTBEAT, ERROR, AXIS_STATE, ENCODER = 0x00, 0x01, 0x03, 0x07, 0x09
MODE, INPUT_POS, LIMITS, CURRENTS, TEMPERATURE, VOLTAGE = 0x0B, 0x0C, 0x0F, 0x14, 0x15, 0x17
CLEAR, TORQUES, POWERS = 0x18, 0x1C, 0x1D
IDLE, CLOSED_LOOP = 1, 8  # states of an axis
MARKERS = (VOLTAGE, TEMPERATURE, VERSION, CURRENTS, POWERS)  # one a cycle: what comes before another one is late
WATCHDOG_EXPIRED = 1 << 24

ERRORS = {
    1 << 0: "initializing",
    1 << 1: "system level",
    1 << 2: "timing error",
    1 << 3: "missing estimate",
    1 << 4: "bad config",
    1 << 5: "gate driver fault",
    1 << 6: "missing input",
    1 << 8: "DC bus over voltage",
    1 << 9: "DC bus under voltage",
    1 << 10: "DC bus over current",
    1 << 11: "DC bus over regen current",
    1 << 12: "current limit violation",
    1 << 13: "motor over temperature",
    1 << 14: "inverter over temperature",
    1 << 15: "velocity limit violation",
    1 << 16: "position limit violation",
    WATCHDOG_EXPIRED: "watchdog expired",
    1 << 25: "emergency stop requested",
    1 << 26: "spinout detected",
    1 << 27: "brake resistor disarmed",
    1 << 28: "thermistor disconnected",
    1 << 30: "calibration error",
}


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
    torque_constant : float
        Of the motor, N m/A (8.27 / KV); 0 if it is not known. With it, the limits are set in the device.

    Notes
    -----
    CANSimple cannot set the watchdog, so it must have been set with odrivetool before::

        odrv0.axis0.config.watchdog_timeout = 0.1
        odrv0.axis0.config.enable_watchdog = True
        odrv0.axis0.config.can.heartbeat_msg_rate_ms = 10
        odrv0.axis0.config.can.encoder_msg_rate_ms = 0
        odrv0.save_configuration()

    Nor does any message tell whether it is armed. Therefore the first :meth:`enable` tries it: with the torque on and
    the arm at rest, it sends nothing for a little longer than the watchdog's time. An axis that is not disarmed by then
    is refused. Other cyclic messages than the heartbeat must be off.

    Frames of CANSimple bear no number. One message in each cycle, of five that take turns, tells to which cycle the
    others belong. A single frame that an adapter delays for some cycles can still pass for a newer one of its kind, if
    that one is lost.

    State and torque are those of the motor's shaft: a gear between it and the arm is not known here. The axis must be
    calibrated.
    """

    takes: frozenset[str] = frozenset({"rate", "torque"})

    def __init__(
        self,
        channel: str,
        number: int = 0,
        *,
        interface: str = "",
        bitrate: int = 250_000,
        watchdog: float = 0.1,
        torque_constant: float = 0.0,
    ) -> None:
        self.channel, self.number, self.bitrate = channel, number, bitrate
        self.interface = interface or ("slcan" if channel.startswith("/") else "socketcan")
        self.watchdog, self.torque_constant = watchdog, torque_constant
        self.name = f"odrive {number} on {channel}"
        self.clock = time.monotonic
        self._bus: Any = None
        self._heartbeat = 0.0, 0  # when, and the state of the axis
        self._tried = False  # the watchdog
        self._cycle = 0
        self._slow: dict[int, bytes] = {}  # last replies to the markers

    # ------------------------------------------------------------------ connection

    def open(self) -> None:
        """Open the bus and find the axis; its torque stays as it is."""
        extras.require(("can",), "odrive", "ODrive controllers")
        self._tried = False
        self._bus = self._open_bus()
        try:
            with _as_os_error():
                self._await_heartbeat()
                firmware = self._firmware()
                if firmware < (0, 6):
                    had = ".".join(map(str, firmware))
                    raise DriveError(f"{self.name}: firmware {had} speaks another CANSimple. Update it to 0.6.")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the bus."""
        import can

        if self._bus is not None:
            with suppress(OSError, can.CanError):
                self._bus.shutdown()

    def _open_bus(self) -> Any:
        import can

        options: dict[str, Any] = {"bitrate": self.bitrate}
        if self.interface == "slcan":
            options["sleep_after_open"] = 0.1  # s; adapters that do not reset when they are opened need none
        try:
            return can.Bus(channel=self.channel, interface=self.interface, **options)
        except (OSError, ValueError, can.CanError) as error:
            if self.interface != "socketcan":
                raise open_problem(self.channel, error) from None
            fix = f"Set it up: sudo ip link set {self.channel} up type can bitrate {self.bitrate}"
            raise DriveError(f"{self.channel}: no CAN interface of that name is ready ({error}). {fix}.") from None

    def _await_heartbeat(self) -> None:
        """Wait for the axis, or say who else is on the bus."""
        until, others = time.monotonic() + FIRST_HEARTBEAT, set()
        while (rest := until - time.monotonic()) > 0.0:
            if frame := self._receive(rest):
                node, command, _ = frame
                if (node, command) == (self.number, HEARTBEAT):
                    return
                if (node, command) == (self.number, ENCODER):
                    fix = "Set axis0.config.can.encoder_msg_rate_ms = 0 with odrivetool"
                    raise DriveError(f"{self.name} sends its encoder's estimates unasked. {fix}.")
                others.add(node)
        if others:
            raise DriveError(
                f"{self.name} sends no heartbeat. Nodes on this bus: {', '.join(map(str, sorted(others)))}."
            )
        fix = f"Check power, wiring, termination, and that the bus runs at {self.bitrate} bit/s"
        raise DriveError(f"{self.name}: nothing is heard on the bus. {fix}.")

    def _firmware(self) -> tuple[int, ...]:
        for _ in range(3):
            self._send(VERSION)
            until = time.monotonic() + 10.0 * PATIENCE
            while (rest := until - time.monotonic()) > 0.0:
                frame = self._receive(rest)
                if frame and frame[:2] == (self.number, VERSION):
                    return tuple(frame[2][4:7])
        raise DriveError(f"{self.name} does not tell its version: it is no ODrive with firmware 0.6.")

    # ------------------------------------------------------------------ link

    def read(self) -> Reading:
        """Return the state."""
        return self._exchange()

    def enable(self, limits: MotorLimits) -> None:
        """Set the limits, switch the torque on where the shaft is, and try the watchdog if that was not done before."""
        if self.torque_constant > 0.0 and math.isfinite(limits.torque):
            speed = SLACK * limits.speed / math.tau
            self._put(LIMITS, struct.pack("<ff", speed, SLACK * limits.torque / self.torque_constant))
        self._put(MODE, struct.pack("<II", 3, 1))  # position control, inputs passed through
        self._arm()
        if not self._tried:
            self._try_watchdog()
            self._arm()
            self._tried = True

    def send(self, goal: Goal) -> Reading:
        """Send a raw goal and return the state after it."""
        return self._exchange(_input(goal))

    def disable(self) -> None:
        """Make the axis idle; the state tells whether it is."""
        self._put(AXIS_STATE, struct.pack("<I", IDLE))

    def clear(self) -> None:
        """Clear all errors."""
        self._put(CLEAR, b"\x00")

    def _arm(self) -> None:
        """Go into closed-loop control with the present angle as goal, feeding the watchdog meanwhile."""
        here = _input(Goal(self._persist().angle))
        self._put(INPUT_POS, here)
        self._put(AXIS_STATE, struct.pack("<I", CLOSED_LOOP))
        until = time.monotonic() + 2.0 * OLDEST_HEARTBEAT
        state = self._persist(here)
        while not state.enabled and not state.fault and time.monotonic() < until:
            state = self._persist(here)
        if not state.enabled:
            self.disable()
            why = state.fault or "it stays idle: calibrate it with odrivetool"
            raise DriveError(f"{self.name} does not switch its torque on ({why}).")

    def _try_watchdog(self) -> None:
        """Send nothing for a little longer than the watchdog's time, and refuse an axis that is still armed."""
        until = time.monotonic() + 1.2 * self.watchdog
        with _as_os_error():
            while (rest := until - time.monotonic()) > 0.0:
                self._receive(rest)
        if ERRORS[WATCHDOG_EXPIRED] not in self._persist().fault:
            self.disable()
            fix = f"Set axis0.config.watchdog_timeout = {self.watchdog:g} and enable_watchdog = True with odrivetool"
            raise DriveError(f"{self.name}: its watchdog did not stop it within {self.watchdog:g} s. {fix}.")
        self.clear()

    # ------------------------------------------------------------------ frames

    def _persist(self, goal: bytes = b"") -> Reading:
        """Return the state as :meth:`_exchange` does, but try again if a reply is lost."""
        until = time.monotonic() + CONFIRM
        while True:
            try:
                return self._exchange(goal)
            except NoReply:
                if time.monotonic() > until:
                    raise

    def _exchange(self, goal: bytes = b"") -> Reading:
        """Send a goal, if there is one, ask for the state, and return it."""
        self._cycle += 1
        marker = MARKERS[self._cycle % len(MARKERS)]
        requests = (ERROR, ENCODER, TORQUES, marker)
        replies: dict[int, bytes] = {}
        with _as_os_error():
            while self._receive(0.0):  # late from before
                pass
            sent = time.monotonic()
            if goal:
                self._send(INPUT_POS, goal)
            for command in requests:
                self._send(command)
            while len(replies) < len(requests):
                rest = sent + PATIENCE - time.monotonic()
                if rest <= 0.0:
                    raise NoReply(f"{self.name}: no valid reply")
                node, command, data = self._receive(rest) or (-1, -1, b"")
                if node == self.number and command in replies:
                    raise NoReply(f"{self.name}: a reply to an earlier request came late")
                if node == self.number and command in requests:
                    replies[command] = data
                elif node == self.number and command in MARKERS:
                    replies.clear()  # all of them answered an earlier request
        received = time.monotonic()
        beat, state = self._heartbeat
        if received - beat > OLDEST_HEARTBEAT:
            raise NoReply(f"{self.name}: no heartbeat for {1e3 * (received - beat):.0f} ms")
        self._slow[marker] = replies[marker]
        active, reason = struct.unpack("<II", replies[ERROR])
        angle, rate = struct.unpack("<ff", replies[ENCODER])
        return Reading(
            angle=angle * math.tau,
            rate=rate * math.tau,
            torque=struct.unpack("<ff", replies[TORQUES])[1],
            voltage=self._slow_value(VOLTAGE),
            temperature=self._slow_value(TEMPERATURE),
            enabled=state == CLOSED_LOOP and not active | reason,
            fault=_fault(active | reason),
            sent=sent,
            received=received,
        )

    def _slow_value(self, marker: int) -> float:
        """Return the first number of the last reply to a marker, NaN before there is one."""
        data = self._slow.get(marker)
        return math.nan if data is None else float(struct.unpack("<ff", data)[0])

    def _put(self, command: int, data: bytes) -> None:
        with _as_os_error():
            self._send(command, data)

    def _send(self, command: int, data: bytes = b"") -> None:
        """Send a frame; without data it is a request for the message of that number."""
        import can

        identifier = self.number << 5 | command
        self._bus.send(
            can.Message(arbitration_id=identifier, data=data or None, is_remote_frame=not data, is_extended_id=False),
            timeout=SILENCE,
        )

    def _receive(self, timeout: float) -> tuple[int, int, bytes] | None:
        """Return node, command and data of the next frame of 8 bytes, or None; note the heartbeat."""
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
        node, command, data = frame.arbitration_id >> 5, frame.arbitration_id & 31, bytes(frame.data)
        if (node, command) == (self.number, HEARTBEAT):
            self._heartbeat = time.monotonic(), data[4]
        return node, command, data


def _input(goal: Goal) -> bytes:
    """Return a goal as Set_Input_Pos takes it: turns, and thousandths of turns/s and of N m."""
    feeds = (1e3 * goal.rate / math.tau, 1e3 * goal.torque)
    return struct.pack("<fhh", goal.angle / math.tau, *(max(-32768, min(32767, round(value))) for value in feeds))


def _fault(errors: int) -> str:
    """Return errors in words, empty for none."""
    names = [name for bit, name in ERRORS.items() if errors & bit]
    return f"{' and '.join(names) or 'unknown'} (error {errors:#x})" if errors else ""


@contextmanager
def _as_os_error() -> Iterator[None]:
    """Make an error of python-can an OSError like all other broken links."""
    import can

    try:
        yield
    except can.CanError as error:
        raise OSError(str(error)) from None
