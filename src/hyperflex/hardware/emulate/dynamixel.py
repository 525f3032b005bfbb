"""The device's side of a Dynamixel servo of the X series: packets of protocol 2.0, control table, bus watchdog."""

import math
import struct
from enum import IntEnum

from hyperflex.hardware.drive import Goal
from hyperflex.hardware.dynamixel import COUNTS, RATE_UNIT, SERVOS, Register
from hyperflex.hardware.emulate.plant import Plant

HEADER = b"\xff\xff\xfd\x00"
LONGEST = 600  # bytes of a packet; more is noise
PAUSE = 5e-3  # s without a byte after which the rest of a packet is no longer waited for
TABLE = 512  # registers with an address below; the second block of indirect ones is left out
FACTORY = {  # registers that are not 0, by address: (bytes, value)
    7: (1, 1),
    8: (1, 3),  # rate: 1 Mbit/s
    9: (1, 250),
    11: (1, 3),
    31: (1, 80),
    36: (2, 885),
    38: (2, 1193),
    48: (4, COUNTS - 1),
    63: (1, 52),  # what switches the torque off: overload, shock, overheating
    68: (1, 2),
    84: (2, 800),
}


class Instruction(IntEnum):
    """What a packet asks for, or that it is a status."""

    PING = 1
    READ = 2
    WRITE = 3
    REBOOT = 8
    STATUS = 0x55


class Refusal(IntEnum):
    """Errors of a status packet."""

    FAILED = 1
    NO_INSTRUCTION = 2
    BAD_CRC = 3
    OUT_OF_RANGE = 4
    NO_ACCESS = 7


class DynamixelDevice:
    """A servo on a bus: bytes in, bytes out.

    Parameters
    ----------
    plant : Plant
        Motor, arm and rope.
    number : int
        ID of the servo.
    model : int
        Model number, a key of :data:`hyperflex.hardware.dynamixel.SERVOS`.
    firmware : int
        Its version; models other than X330 have a bus watchdog from 38 on.

    Notes
    -----
    As servos do from the factory, it holds with torque once its bus watchdog has expired (the host sets that).
    Instructions: ping, read, write, reboot. The position loop's gains are those of the plant, not of the registers,
    and the current limit is not applied.
    """

    options = ""  # of its address

    def __init__(self, plant: Plant, number: int = 1, model: int = 1030, firmware: int = 48) -> None:
        self.plant, self.number, self.servo = plant, number, SERVOS[model]
        self.t = 0.0  # s
        self._heard = 0.0  # when the last instruction came, s
        self._arrived = 0.0  # when the last byte came, s
        self._buffer = b""
        self._table = bytearray(TABLE)
        for address, (size, value) in FACTORY.items():
            self._store(address, size, value)
        self._store(32, 2, round(13.0 * plant.voltage))  # voltage limits, 0.1 V: a third above, a quarter below
        self._store(34, 2, round(7.5 * plant.voltage))
        self._store(0, 2, model)
        self._store(6, 1, firmware)
        self._store(7, 1, number)
        self._store(Register.GOAL, 4, round(plant.angle * COUNTS / math.tau))

    def tick(self, t: float) -> bytes:
        """Advance to time t, s; return nothing, because a servo speaks only when it is asked."""
        self.plant.advance(t)
        self.t = t
        self._guard()
        if t - self._arrived > PAUSE:
            self._buffer = b""
        return b""

    def handle(self, data: bytes) -> bytes:
        """Take bytes from the bus, and return the status packets that answer them."""
        self._buffer += data
        self._arrived = self.t if data else self._arrived
        replies = b""
        while (start := self._buffer.find(HEADER)) >= 0:
            packet = self._buffer[start:]
            if len(packet) < 7 or len(packet) < (end := 7 + int.from_bytes(packet[5:7], "little")) <= LONGEST:
                self._buffer = packet
                return replies
            if 10 <= end <= LONGEST:
                replies += self._answer(packet[:end])
                self._buffer = packet[end:]
            else:
                self._buffer = packet[len(HEADER) :]
        self._buffer = self._buffer[-3:]  # a header may have begun
        return replies

    @property
    def expired(self) -> bool:
        """Whether the bus watchdog has fired: the servo holds where it stopped, and its goals are locked."""
        return self._table[Register.WATCHDOG] == 255

    def fail(self, error: int) -> None:
        """Fail with a hardware error, as in register 70."""
        self._table[Register.HARDWARE_ERROR] |= error

    # ------------------------------------------------------------------ instructions

    def _answer(self, packet: bytes) -> bytes:
        if packet[4] not in (self.number, 0xFE):
            return b""
        if checksum(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
            return self._status(Refusal.BAD_CRC) if self._table[Register.RETURN_LEVEL] == 2 else b""
        self._heard = self.t
        instruction, parameters = packet[7], packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        level = 0 if instruction == Instruction.PING else 1 if instruction == Instruction.READ else 2
        if instruction == Instruction.PING:
            status = self._status(0, bytes(self._table[0:2]) + bytes(self._table[6:7]))
        elif instruction == Instruction.READ and len(parameters) == 4:
            status = self._read(*struct.unpack("<HH", parameters))
        elif instruction == Instruction.WRITE and len(parameters) > 2:
            status = self._status(self._write(int.from_bytes(parameters[:2], "little"), parameters[2:]))
        elif instruction == Instruction.REBOOT:
            status = self._status(0)
            self._reboot()
        else:
            status = self._status(Refusal.NO_INSTRUCTION)
        return status if level <= self._table[Register.RETURN_LEVEL] else b""

    def _status(self, error: int, parameters: bytes = b"") -> bytes:
        alert = 0x80 if self._table[Register.HARDWARE_ERROR] else 0
        body = bytes([Instruction.STATUS, error | alert]) + parameters
        body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = HEADER + struct.pack("<BH", self.number, len(body) + 2) + body
        return packet + struct.pack("<H", checksum(packet))

    def _read(self, address: int, length: int) -> bytes:
        if address + length > TABLE:
            return self._status(Refusal.OUT_OF_RANGE)
        self._measure()
        return self._status(0, bytes(self._table[self._direct(a)] for a in range(address, address + length)))

    def _write(self, address: int, value: bytes) -> int:
        """Write registers; return the error of the status packet."""
        places = [self._direct(a) for a in range(address, address + len(value)) if a < TABLE]
        on = self._table[Register.TORQUE_ENABLE]
        # not to be written while the torque is on: what lasts without power, and the indirect addresses
        kept = () if on else {*range(9, 64), *range(Register.INDIRECT, TABLE)}
        goals = set(range(64, 120)) - {69, Register.HARDWARE_ERROR}
        if len(places) < len(value) or not all(a in kept or a in goals for a in places):
            return Refusal.NO_ACCESS
        if self.expired and any(100 <= a < 120 for a in places):
            return Refusal.OUT_OF_RANGE  # goals are locked
        if self._table[Register.HARDWARE_ERROR] and Register.TORQUE_ENABLE in places:
            return Refusal.FAILED
        for place, byte in zip(places, value, strict=True):
            self._table[place] = byte
        if Register.TORQUE_ENABLE in places and self._table[Register.TORQUE_ENABLE] != on:
            self._switch(bool(self._table[Register.TORQUE_ENABLE]))
        if Register.GOAL in places and self._table[Register.TORQUE_ENABLE]:
            self._follow()
        return 0

    def _follow(self) -> None:
        """Go to the goal in the table, however old it is."""
        self.plant.set_goal(Goal(self._load(Register.GOAL, 4, signed=True) * math.tau / COUNTS))

    def _direct(self, address: int) -> int:
        """Return the address behind one of the indirect data registers; of others the address itself."""
        entry = Register.INDIRECT + 2 * (address - self.servo.indirect)
        return self._load(entry, 2) % TABLE if Register.INDIRECT <= entry < self.servo.indirect else address

    def _reboot(self) -> None:
        self._switch(False)
        self._table[64:] = bytes(TABLE - 64)
        for address, (size, value) in FACTORY.items():
            if address >= 64:
                self._store(address, size, value)
        self._store(Register.GOAL, 4, round(self.plant.angle * COUNTS / math.tau))

    # ------------------------------------------------------------------ state

    def _measure(self) -> None:
        """Bring the registers of measured values up to date."""
        plant, unit = self.plant, self.servo.torque
        if unit:
            self._store(Register.CURRENT, 2, max(-32768, min(32767, round(plant.torque / unit))))
        self._store(Register.RATE, 4, round(plant.rate / RATE_UNIT))
        self._store(Register.POSITION, 4, round(plant.angle * COUNTS / math.tau))
        self._store(Register.VOLTAGE, 2, round(10.0 * plant.voltage))
        self._store(Register.TEMPERATURE, 1, min(255, round(plant.temperature)))

    def _guard(self) -> None:
        """Watch the bus, the temperature and the voltage, as the servo's firmware does."""
        units = self._table[Register.WATCHDOG]
        if self._table[Register.TORQUE_ENABLE] and 1 <= units <= 127 and self.t - self._heard > 0.02 * units:
            self._table[Register.WATCHDOG] = 255
            self.plant.set_goal(Goal(self.plant.angle))  # it stops, and holds
        hot = self.plant.temperature > self._table[31]
        poor = not self._load(34, 2) <= 10.0 * self.plant.voltage <= self._load(32, 2)
        self._table[Register.HARDWARE_ERROR] |= 4 * hot | poor
        if self._table[Register.HARDWARE_ERROR] & self._table[63] and self._table[Register.TORQUE_ENABLE]:
            self._switch(False)

    def _switch(self, on: bool) -> None:
        self._table[Register.TORQUE_ENABLE] = on
        self._heard = self.t
        self.plant.set_enabled(on)
        if on:
            self._follow()

    def _load(self, address: int, size: int, *, signed: bool = False) -> int:
        return int.from_bytes(self._table[address : address + size], "little", signed=signed)

    def _store(self, address: int, size: int, value: int) -> None:
        self._table[address : address + size] = value.to_bytes(size, "little", signed=value < 0)


def checksum(data: bytes) -> int:
    """Return the CRC-16 of protocol 2.0: polynomial 0x8005, begun at 0, most significant bit first."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc
