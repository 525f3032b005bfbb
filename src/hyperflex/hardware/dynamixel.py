"""Dynamixel servos of the X series (protocol 2.0) through the vendor's SDK. Tried with an emulator only.

Sources: the control tables and data sheets of the e-Manual, dynamixel-sdk 4.1.
"""

import math
import select
import struct
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

from hyperflex import checks, extras, files
from hyperflex.errors import DriveError
from hyperflex.hardware.drive import CONFIRM, SILENCE, Goal, NoReply, Reading, persist
from hyperflex.hardware.serial_port import open_problem
from hyperflex.model import MotorLimits

BAUD_RATES = {  # bit/s, by the value of the servo's register; the factory's is 1
    1: 57_600,
    3: 1_000_000,
    4: 2_000_000,
    5: 3_000_000,
    6: 4_000_000,
    2: 115_200,
    0: 9_600,
}
COUNTS = 4096  # of a turn
RATE_UNIT = 0.229 * math.tau / 60.0  # rad/s
START = 1.0  # s that a servo may take to answer after it was switched on or rebooted
LATENCY_FILE = "/sys/class/tty/{}/device/latency_timer"  # of FTDI adapters, ms

HARDWARE_ERRORS = {0: "input voltage", 2: "overheating", 3: "motor encoder", 4: "electrical shock", 5: "overload"}


class Register(IntEnum):
    """Addresses in the control table of the X series."""

    DELAY = 9  # of replies
    DRIVE_MODE = 10
    OPERATING_MODE = 11
    CURRENT_LIMIT = 38
    TORQUE_ENABLE = 64
    RETURN_LEVEL = 68  # what is answered
    HARDWARE_ERROR = 70
    WATCHDOG = 98
    GOAL_CURRENT = 102
    PROFILE = 108  # acceleration and velocity
    GOAL = 116
    CURRENT = 126
    RATE = 128
    POSITION = 132
    VOLTAGE = 144
    TEMPERATURE = 146
    INDIRECT = 168  # the addresses that follow are those behind the indirect data


# What one read brings through the indirect data, byte by byte.
STATE = (
    *(Register.TORQUE_ENABLE, Register.HARDWARE_ERROR, Register.WATCHDOG),
    *range(Register.CURRENT, Register.POSITION + 4),
    *(Register.VOLTAGE, Register.VOLTAGE + 1, Register.TEMPERATURE),
)
STATE_LAYOUT = struct.Struct("<BBBhiiHB")
LENGTHS = 32  # of reads of the state; one whose reply is missing is not used until that can no longer come
LATEST = 0.1  # s after a request at which its reply can no longer come; a busy host or adapter delays some 10 ms


@dataclass(frozen=True)
class Servo:
    """A model: name, current of one count, A (0: not measured), stall torque, N m, and current, A, where data begin."""

    name: str
    current: float = 0.0
    stall_torque: float = 0.0
    stall_current: float = 1.0
    indirect: int = 224

    @property
    def torque(self) -> float:
        """Torque of one count of current, N m: rough, as if torque grew in proportion to the current up to stall."""
        return self.current * self.stall_torque / self.stall_current


SERVOS = {  # by model number
    int(number): Servo(**table) for number, table in files.read_toml(Path(__file__).with_name("servos.toml")).items()
}


class DynamixelLink:
    """A servo of the X series on a serial port; see :class:`hyperflex.hardware.Link`.

    Parameters
    ----------
    port : str
        Serial port of the adapter, for example "/dev/ttyUSB0".
    number : int
        ID of the servo, 0 to 252.
    baud : int
        Rate of the bus, bit/s. Servos leave the factory at 57,600, which allows 50 goals a second.
    watchdog : float
        Time without a request, s, after which the servo stops; it counts in 20 ms.
    patience : float
        Time that a request may take beyond its transmission, s. A servo answers within 0.5 ms.
    clock : callable
        Monotonic time, s, of the stamps.

    Notes
    -----
    It follows positions only: rate and torque of a goal are ignored. With a torque limit it runs in current-based
    position mode, which holds the limit in the servo; else in extended position mode. Torque is current times stall
    torque over stall current: rough, within about 30 %, and worse near zero because of the gear's friction. Models
    without a current sensor (XL430, XC430) report NaN, and refuse a limit of torque below that at stall.

    The bus watchdog does not switch the torque off: the servo stops and **holds with torque** where it is, and refuses
    goals until its torque is off and the fault is cleared. A hardware error is cleared by a reboot, after which it
    counts its turns from zero again.

    Each exchange is a write without reply and a read. Replies bear no number, but reads may differ in length: a length
    whose reply is missing is not used for 0.1 s, so that a late reply cannot pass for the answer to a later request.
    """

    takes: frozenset[str] = frozenset()

    def __init__(
        self,
        port: str,
        number: int = 1,
        *,
        baud: int = 1_000_000,
        watchdog: float = 0.1,
        patience: float = 4e-3,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.port, self.number = checks.text("port", port), checks.count("dynamixel id", number, least=0, most=252)
        self.baud = checks.count("baud", baud)
        units = round(checks.positive("watchdog", watchdog, "s") / 0.02)
        self.watchdog = 0.02 * max(1, min(127, units))
        self.patience = checks.positive("patience", patience, "s")
        self.clock, self.name = clock, f"dynamixel {number} on {port}"
        self.servo = Servo("unknown")
        self._missing: dict[int, float] = {}  # reads without a reply: bytes before the state, and when it was asked for
        self._bus: Any = None

    # ------------------------------------------------------------------ connection

    def open(self) -> None:
        """Open the port, find the servo, and prepare it; a torque that is on may go off."""
        extras.require(("dynamixel_sdk",), "dynamixel", "Dynamixel servos")
        from dynamixel_sdk import PacketHandler

        self._packets: Any = PacketHandler(2.0)
        self._missing = {}
        self._bus = _Bus(self.port, self.baud)
        self._identify()
        self._prepare()

    def close(self) -> None:
        """Close the port."""
        if self._bus is not None:
            with suppress(Exception):  # a broken terminal may fail at anything
                self._bus.serial.close()

    def _identify(self) -> None:
        answer = self._ping(START)
        if not answer:
            raise DriveError(f"{self.name} {self._elsewhere()}")
        model, firmware = struct.unpack("<HB", answer)
        if model not in SERVOS:
            raise DriveError(f"{self.name}: model number {model} is no servo of the X series known here.")
        self.servo = SERVOS[model]
        self.name = f"dynamixel {self.number} ({self.servo.name}) on {self.port}"
        if firmware < 38 and self.servo.indirect == 224:  # the X330 have had one from the beginning
            raise DriveError(
                f"{self.name}: firmware {firmware} has no bus watchdog. Update it with Dynamixel Wizard (38 or later)."
            )

    def _ping(self, seconds: float) -> bytes:
        """Return model number and firmware as the servo sends them, nothing if it does not answer for a time."""
        with suppress(NoReply):
            return persist(lambda: self._request(1, b"", 3), time.monotonic, seconds)
        return b""

    def _elsewhere(self) -> str:
        """Return what is wrong with a servo that does not answer: its rate or its ID, or neither is known."""
        for baud in BAUD_RATES.values():
            with suppress(ValueError, OSError):  # a rate that the adapter does not have
                self._bus.serial.baudrate = baud
            if baud != self.baud and self._ping(CONFIRM):
                return f"answers at {baud} baud, not at {self.baud}. Give that rate, or set it with Dynamixel Wizard."
        self._bus.serial.baudrate = self.baud
        self._bus.is_using = False
        others = sorted(self._packets.broadcastPing(self._bus)[0])
        if others:
            return f"does not answer. Servos on this bus: {', '.join(map(str, others))}."
        rates = ", ".join(str(baud) for baud in BAUD_RATES.values() if baud != self.baud)
        return f"does not answer at {self.baud} baud, nor at {rates}. Check its power, its wiring and the port."

    def _prepare(self) -> None:
        """Make the servo answer reads only, and gather its state in one block. Both last until it loses power."""
        self._put(Register.RETURN_LEVEL, b"\x01")  # unasked: at level 0 it would not say what it is
        self._set(Register.RETURN_LEVEL, b"\x01")
        table = struct.pack(f"<{len(STATE)}H", *STATE)
        if self._get(Register.INDIRECT, len(table)) != table:
            self._set(Register.TORQUE_ENABLE, b"\x00")  # while it is on the table cannot be written
            self._set(Register.INDIRECT, table)

    # ------------------------------------------------------------------ link

    def read(self) -> Reading:
        """Return the state."""
        sent = self.clock()
        more = next((k for k in range(LENGTHS) if sent - self._missing.get(k, -math.inf) > LATEST), None)
        if more is None:
            raise NoReply(f"{self.name}: too many replies are missing")
        self._missing[more] = sent
        length = len(STATE) + more
        data = self._request(2, struct.pack("<HH", self.servo.indirect - more, length), length, self.patience)[more:]
        del self._missing[more]
        on, error, watchdog, current, rate, position, voltage, temperature = STATE_LAYOUT.unpack(data)
        return Reading(
            angle=position * math.tau / COUNTS,
            rate=rate * RATE_UNIT,
            torque=current * self.servo.torque if self.servo.current else math.nan,
            voltage=0.1 * voltage,
            temperature=temperature,
            enabled=bool(on),
            fault=_fault(error, watchdog),
            sent=sent,
            received=self.clock(),
        )

    def enable(self, limits: MotorLimits) -> None:
        """Arm watchdog and torque limit, and switch the torque on where the shaft is."""
        limited, stall = math.isfinite(limits.torque), self.servo.stall_torque
        if limited and not self.servo.current:
            if limits.torque < stall:
                why = f"{self.name} keeps no limit of torque: it does not measure its current"
                raise DriveError(f"{why}. Allowed: its stall torque, {stall:g} N m at 12 V, or more.")
            limited = False
        self._set(Register.DELAY, b"\x00")
        direction = self._get(Register.DRIVE_MODE, 1)[0] & 1
        self._set(Register.DRIVE_MODE, bytes([direction]))  # no profile by time, no torque on by a goal
        self._set(Register.OPERATING_MODE, b"\x05" if limited else b"\x04")
        if limited:
            most = int.from_bytes(self._get(Register.CURRENT_LIMIT, 2), "little")
            current = min(most, int(limits.torque / self.servo.torque))
            self._set(Register.GOAL_CURRENT, current.to_bytes(2, "little"))
        self._set(Register.PROFILE, bytes(8))  # none: goals are streamed
        self._set(Register.WATCHDOG, bytes([round(self.watchdog / 0.02)]))
        self._hold()
        self._set(Register.TORQUE_ENABLE, b"\x01")

    def send(self, goal: Goal) -> Reading:
        """Send a raw goal and return the state after it."""
        self._put(Register.GOAL, struct.pack("<i", round(goal.angle * COUNTS / math.tau)))
        return self.read()

    def disable(self) -> None:
        """Switch the torque off; the state tells whether it is."""
        self._put(Register.TORQUE_ENABLE, b"\x00")

    def clear(self) -> None:
        """Clear the watchdog's fault; after a hardware error reboot the servo."""
        self._set(Register.WATCHDOG, b"\x00")
        if self._get(Register.HARDWARE_ERROR, 1)[0]:
            with suppress(NoReply):
                self._request(8, b"", 0)
            if not self._ping(START):
                raise DriveError(f"{self.name} does not answer after its reboot.")
            self._prepare()

    # ------------------------------------------------------------------ registers

    def _get(self, address: int, length: int) -> bytes:
        """Read registers; a lost reply is asked for again. A state that comes late could pass for it: wait for that."""
        time.sleep(max(0.0, max(self._missing.values(), default=-math.inf) + LATEST - self.clock()))
        return persist(lambda: self._request(2, struct.pack("<HH", address, length), length), time.monotonic)

    def _put(self, address: int, value: bytes) -> None:
        """Write registers; there is no reply."""
        self._bus.is_using = False
        self._packets.writeTxOnly(self._bus, self.number, address, len(value), list(value))

    def _set(self, address: int, value: bytes) -> None:
        """Write registers unless they hold the value, and read them back until they do."""
        for _ in self._tries(f"{list(value)} at address {address}"):
            if self._get(address, len(value)) == value:
                return
            self._put(address, value)

    def _hold(self) -> None:
        """Make the present position the goal, so that the torque comes on without a jerk."""
        for _ in self._tries("its present position as goal"):
            block = self._get(Register.GOAL, 20)
            goal, position = struct.unpack("<i12xi", block)
            if abs(goal - position) <= COUNTS // 256:  # 1.4 degrees: the arm may swing meanwhile
                return
            self._put(Register.GOAL, block[16:])

    def _tries(self, what: str) -> Iterator[None]:
        """Yield for a while; then raise that the servo does not accept something."""
        until = time.monotonic() + CONFIRM
        while time.monotonic() < until:
            yield
        raise DriveError(f"{self.name} does not accept {what}.")

    def _request(self, instruction: int, parameters: bytes, length: int, patience: float = SILENCE) -> bytes:
        """Send an instruction, and return the parameters of the first reply of this servo that has a length."""
        packet = [0, 0, 0, 0, self.number, *struct.pack("<H", len(parameters) + 3), instruction, *parameters, 0, 0]
        self._bus.is_using = False  # an interrupt may have left it set
        self._packets.txPacket(self._bus, packet)
        self._bus.wait_for(length + 11, patience + self._bus.latency)
        while not self._bus.isPacketTimeout():
            status, result = self._packets.rxPacket(self._bus, False)
            if result == 0 and status[4] == self.number and status[5] + 256 * status[6] == length + 4:
                return bytes(status[9 : 9 + length])
        raise NoReply(f"{self.name}: no valid reply")


class _Bus:
    """A serial port as the SDK's packet handler uses one, with a patience of our own.

    The SDK's own port waits at least 34 ms for a reply, by the wall clock, and spins meanwhile.
    """

    def __init__(self, port: str, baud: int) -> None:
        import serial

        try:
            self.serial: Any = serial.Serial(port, baud, timeout=0, write_timeout=SILENCE, exclusive=True)
        except (OSError, ValueError) as error:
            raise open_problem(port, error) from None
        self.is_using = False
        self.latency = self._lower_latency(port)
        self._until = 0.0
        self._sent = 0  # bytes that may still be in transmission

    def _lower_latency(self, port: str) -> float:
        """Ask the adapter to hand replies on at once; return how long it still holds them back, s."""
        with suppress(NotImplementedError, ValueError, OSError):
            self.serial.set_low_latency_mode(True)
            return 1e-3
        file = Path(LATENCY_FILE.format(Path(port).resolve().name))
        try:
            latency = 1e-3 * int(file.read_text("utf-8"))
        except (OSError, ValueError):
            return 0.0  # not an FTDI adapter
        if latency > 2e-3:  # s; a cycle of 5 ms has no time for more
            rate = 1.0 / (latency + 5e-3)
            text = f"{port}: the adapter holds replies back for {1e3 * latency:.0f} ms, so at most {rate:.0f} goals a "
            warnings.warn(f"{text}second are possible. Mend it: echo 1 | sudo tee {file}", UserWarning, stacklevel=5)
        return latency

    def clearPort(self) -> None:
        self.serial.reset_input_buffer()

    def getBaudRate(self) -> int:
        return int(self.serial.baudrate)

    def writePort(self, packet: list[int]) -> int:
        self._sent += len(packet)
        return int(self.serial.write(bytes(packet)))

    def readPort(self, length: int) -> bytes:
        select.select([self.serial], [], [], max(0.0, self._until - time.monotonic()))
        return bytes(self.serial.read(length))

    def wait_for(self, length: int, patience: float) -> None:
        """Wait for a reply of some bytes: for their transmission, that of the request, and a patience, s."""
        transmission = 10.0 * (length + self._sent) / self.serial.baudrate  # ten bits a byte
        self._until, self._sent = time.monotonic() + patience + transmission, 0

    def setPacketTimeoutMillis(self, milliseconds: float) -> None:
        self._until, self._sent = time.monotonic() + 1e-3 * milliseconds, 0

    def isPacketTimeout(self) -> bool:
        return time.monotonic() > self._until


def _fault(error: int, watchdog: int) -> str:
    """Return the servo's fault in words, empty for none; bits of the hardware error, and 255 in the watchdog."""
    names = [name for bit, name in HARDWARE_ERRORS.items() if error >> bit & 1]
    if error and not names:
        names = ["unknown"]
    if names:
        return f"{' and '.join(names)} (hardware error {error})"
    return "bus watchdog expired (register 98 is 255)" if watchdog == 255 else ""
