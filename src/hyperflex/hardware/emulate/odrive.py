"""The device's side of an ODrive: CANSimple frames, and the slcan adapter through which a host sends them."""

import math
import struct

from hyperflex.hardware.drive import Goal
from hyperflex.hardware.emulate.plant import Plant
from hyperflex.hardware.odrive import AxisState, Error, Message

Frame = tuple[int, bytes]  # identifier and data
TAKES: dict[int, int] = {  # messages to the axis, with their least number of bytes
    Message.AXIS_STATE: 4,
    Message.MODE: 8,
    Message.INPUT_POS: 8,
    Message.LIMITS: 8,
    Message.CLEAR: 0,
}


class ODriveDevice:
    """An axis of an ODrive on a CAN bus: frames in, frames out; or bytes, behind an slcan adapter.

    Parameters
    ----------
    plant : Plant
        Motor, arm and rope.
    number : int
        Node ID.
    watchdog : float
        Its timeout, s; 0 if it is not armed.
    heartbeat : float
        Period, s, of the heartbeat, of torques, voltage and temperature.
    firmware : (int, int, int)
        Its version.

    Notes
    -----
    As with enable_watchdog = True, which is not the factory's: the axis is idle, without torque, once its watchdog has
    expired. Only messages to the device feed it, requests do not. It runs while the axis is armed. Gains and the
    current limit are those of the plant.
    """

    hottest = 100.0  # degrees Celsius, of the motor, at which it disarms

    def __init__(
        self,
        plant: Plant,
        number: int = 0,
        *,
        watchdog: float = 0.1,
        heartbeat: float = 0.01,
        firmware: tuple[int, int, int] = (0, 6, 11),
    ) -> None:
        self.plant, self.number, self.watchdog, self.heartbeat = plant, number, watchdog, heartbeat
        self.firmware = firmware
        self._rated = plant.voltage  # V
        self.options = f"torque_constant={plant.model.torque_constant:.6f}"
        self.t = 0.0  # s
        self._fed = 0.0  # when the watchdog was fed last, s
        self._beat = 0.0  # when the last heartbeat went out, s
        self._state, self._reason = AxisState.IDLE, 0  # of the axis; why it was disarmed
        self._mode = 0, 0
        self._speed = math.inf  # limit, rad/s
        self._goal = Goal(0.0)
        self._buffer = b""
        self._listening = False  # whether the host has opened the adapter's channel

    @property
    def expired(self) -> bool:
        """Whether the watchdog has disarmed the axis."""
        return bool(self._reason & Error.WATCHDOG_EXPIRED)

    def fail(self, error: int) -> None:
        """Disarm with an error."""
        self._disarm(error)

    # ------------------------------------------------------------------ the bus

    def advance(self, t: float) -> list[Frame]:
        """Advance to time t, s; return the frames that are sent unasked."""
        self.plant.advance(t)
        self.t = t
        active = self._active()
        if self._state == AxisState.CLOSED_LOOP:
            if self.watchdog and t - self._fed > self.watchdog:
                active |= Error.WATCHDOG_EXPIRED
            if abs(self.plant.rate) > 1.2 * self._speed:
                active |= Error.VELOCITY_LIMIT_VIOLATION
            if active:
                self._disarm(active)
        if t - self._beat < self.heartbeat:
            return []
        self._beat = t
        beat = struct.pack("<IBBBB", self._active() | self._reason, self._state, 0, 0, 0)
        kinds = (Message.TORQUES, Message.VOLTAGE, Message.TEMPERATURE)
        return [self._frame(Message.HEARTBEAT, beat), *(self._frame(kind, self._measured(kind)) for kind in kinds)]

    def answer(self, identifier: int, data: bytes, remote: bool) -> list[Frame]:
        """Take a frame from the bus; return those that answer it."""
        node, command = identifier >> 5, identifier & 31
        if node != self.number:
            return []
        if remote:
            reply = self._measured(command)
            return [self._frame(command, reply)] if reply else []
        if len(data) >= TAKES.get(command, 9):
            self._fed = self.t
            self._take(command, data)
        return []

    def _frame(self, command: int, data: bytes) -> Frame:
        return self.number << 5 | command, data

    def _measured(self, command: int) -> bytes:
        plant = self.plant
        if command == Message.VERSION:
            return bytes([2, 4, 4, 58, *self.firmware, 0])
        values: dict[int, tuple[float, float]] = {
            Message.ENCODER: (plant.angle / math.tau, plant.rate / math.tau),
            Message.TORQUES: (self._goal.torque, plant.torque),
            Message.VOLTAGE: (plant.voltage, 0.0),
            Message.TEMPERATURE: (plant.temperature, plant.temperature),
        }
        return struct.pack("<ff", *values[command]) if command in values else b""

    def _take(self, command: int, data: bytes) -> None:
        if command == Message.INPUT_POS:
            turns, rate, torque = struct.unpack("<fhh", data)
            self._goal = Goal(turns * math.tau, 1e-3 * rate * math.tau, 1e-3 * torque)
            if self._state == AxisState.CLOSED_LOOP:
                self.plant.set_goal(self._goal)
        elif command == Message.AXIS_STATE:
            self._request(struct.unpack("<I", data[:4])[0])
        elif command == Message.MODE:
            self._mode = struct.unpack("<II", data)
        elif command == Message.LIMITS:
            self._speed = struct.unpack("<ff", data)[0] * math.tau
        elif command == Message.CLEAR:
            self._reason = 0

    def _request(self, state: int) -> None:
        if state == AxisState.CLOSED_LOOP and self._mode == (3, 1) and not self._active():
            self._state, self._reason = AxisState.CLOSED_LOOP, 0
            self._goal = Goal(self.plant.angle)  # as the firmware does
            self.plant.set_enabled(True)
        elif state == AxisState.IDLE:
            self._disarm(0)

    def _disarm(self, reason: int) -> None:
        self._state, self._reason = AxisState.IDLE, self._reason | reason
        self.plant.set_enabled(False)

    def _active(self) -> int:
        """Return the errors that last."""
        plant = self.plant
        low = Error.DC_BUS_UNDER_VOLTAGE * (plant.voltage < 0.75 * self._rated)
        return low | Error.MOTOR_OVER_TEMPERATURE * (plant.temperature > self.hottest)

    # ------------------------------------------------------------------ the slcan adapter

    def tick(self, t: float) -> bytes:
        """Advance to time t, s; return what the adapter sends to the host unasked."""
        frames = self.advance(t)
        return b"".join(map(_line, frames)) if self._listening else b""

    def handle(self, data: bytes) -> bytes:
        """Take bytes from the host, and return the adapter's answers and those of the axis."""
        *lines, self._buffer = (self._buffer + data).split(b"\r")
        return b"".join(map(self._obey, lines))

    def _obey(self, line: bytes) -> bytes:
        letter, rest = line[:1], line[1:]
        if letter in (b"O", b"C"):
            self._listening = letter == b"O"
            return b"\r"
        if letter not in (b"t", b"r"):
            return b"\r"  # rates and what else adapters know
        try:
            identifier, length, content = int(rest[:3], 16), int(rest[3:4]), bytes.fromhex(rest[4:].decode("ascii"))
        except ValueError:
            return b"\a"
        if letter == b"t" and len(content) != length:
            return b"\a"
        return b"z\r" + b"".join(map(_line, self.answer(identifier, content, letter == b"r")))


def _line(frame: Frame) -> bytes:
    return f"t{frame[0]:03X}{len(frame[1])}{frame[1].hex().upper()}\r".encode("ascii")
