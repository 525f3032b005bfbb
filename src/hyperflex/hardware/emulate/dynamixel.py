"""The device's side of a Dynamixel servo of the X series: packets of protocol 2.0, control table, bus watchdog."""

import math
import struct

from hyperflex.hardware.drive import Goal
from hyperflex.hardware.dynamixel import COUNTS, RATE_UNIT, SERVOS
from hyperflex.hardware.emulate.plant import Plant

HEADER = b"\xff\xff\xfd\x00"
PING, READ, WRITE, REBOOT, STATUS = 1, 2, 3, 8, 0x55
FAILED, NO_INSTRUCTION, BAD_CRC, OUT_OF_RANGE, NO_ACCESS = 1, 2, 3, 4, 7  # errors of a status packet
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
    Instructions: ping, read, write, reboot. The position loop's gains are those of the plant, not of the registers,
    and the current limit is not applied.
    """

    def __init__(self, plant: Plant, number: int = 1, model: int = 1030, firmware: int = 48) -> None:
        self.plant, self.number, self.servo = plant, number, SERVOS[model]
        self.t = 0.0  # s
        self._heard = 0.0  # when the last instruction came, s
        self._arrived = 0.0  # when the last byte came, s
        self._buffer = b""
        self._table = bytearray(TABLE)
        for address, (size, value) in FACTORY.items():
            self._store(address, size, value)
        self._store(32, 2, round(13.0 * plant.model.voltage))  # voltage limits, 0.1 V: a third above, a quarter below
        self._store(34, 2, round(7.5 * plant.model.voltage))
        self._store(0, 2, model)
        self._store(6, 1, firmware)
        self._store(7, 1, number)
        self._store(116, 4, round(plant.angle * COUNTS / math.tau))

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

    # ------------------------------------------------------------------ instructions

    def _answer(self, packet: bytes) -> bytes:
        if packet[4] not in (self.number, 0xFE):
            return b""
        if checksum(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
            return self._status(BAD_CRC) if self._table[68] == 2 else b""
        self._heard = self.t
        instruction, parameters = packet[7], packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        level = 0 if instruction == PING else 1 if instruction == READ else 2
        if instruction == PING:
            status = self._status(0, bytes(self._table[0:2]) + bytes(self._table[6:7]))
        elif instruction == READ and len(parameters) == 4:
            status = self._read(*struct.unpack("<HH", parameters))
        elif instruction == WRITE and len(parameters) > 2:
            status = self._status(self._write(int.from_bytes(parameters[:2], "little"), parameters[2:]))
        elif instruction == REBOOT:
            status = self._status(0)
            self._reboot()
        else:
            status = self._status(NO_INSTRUCTION)
        return status if level <= self._table[68] else b""

    def _status(self, error: int, parameters: bytes = b"") -> bytes:
        alert = 0x80 if self._table[70] else 0
        body = bytes([STATUS, error | alert]) + parameters
        body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = HEADER + struct.pack("<BH", self.number, len(body) + 2) + body
        return packet + struct.pack("<H", checksum(packet))

    def _read(self, address: int, length: int) -> bytes:
        if address + length > TABLE:
            return self._status(OUT_OF_RANGE)
        self._measure()
        return self._status(0, bytes(self._table[self._direct(a)] for a in range(address, address + length)))

    def _write(self, address: int, value: bytes) -> int:
        """Write registers; return the error of the status packet."""
        places = [self._direct(a) for a in range(address, address + len(value)) if a < TABLE]
        on, expired = self._table[64], self._table[98] == 255
        allowed = range(9, 64) if not on else ()  # what is kept without power cannot be written while the torque is on
        if len(places) < len(value) or not all(
            a in allowed or (64 <= a < 120 and a not in (69, 70)) or a >= 168 for a in places
        ):
            return NO_ACCESS
        if expired and any(100 <= a < 120 for a in places):
            return OUT_OF_RANGE  # goals are locked
        if self._table[70] and 64 in places:
            return FAILED
        for place, byte in zip(places, value, strict=True):
            self._table[place] = byte
        if 64 in places and self._table[64] != on:
            self._switch(bool(self._table[64]))
        if 116 in places and self._table[64]:
            self._follow()
        return 0

    def _follow(self) -> None:
        """Go to the goal in the table, however old it is."""
        self.plant.set_goal(Goal(self._load(116, 4, signed=True) * math.tau / COUNTS))

    def _direct(self, address: int) -> int:
        """Return the address behind one of the indirect data registers; of others the address itself."""
        entry = 168 + 2 * (address - self.servo.indirect)
        return self._load(entry, 2) % TABLE if 168 <= entry < self.servo.indirect else address

    def _reboot(self) -> None:
        self._switch(False)
        self._table[64:] = bytes(TABLE - 64)
        for address, (size, value) in FACTORY.items():
            if address >= 64:
                self._store(address, size, value)
        self._store(116, 4, round(self.plant.angle * COUNTS / math.tau))

    # ------------------------------------------------------------------ state

    def _measure(self) -> None:
        """Bring the registers of measured values up to date."""
        plant, unit = self.plant, self.servo.torque
        self._store(120, 2, int(1e3 * self.t) % 32768)
        if unit:
            self._store(126, 2, max(-32768, min(32767, round(plant.torque / unit))))
        self._store(128, 4, round(plant.rate / RATE_UNIT))
        self._store(132, 4, round(plant.angle * COUNTS / math.tau))
        self._store(144, 2, round(10.0 * plant.voltage))
        self._store(146, 1, min(255, round(plant.temperature)))

    def _guard(self) -> None:
        """Watch the bus, the temperature and the voltage, as the servo's firmware does."""
        units = self._table[98]
        if self._table[64] and 1 <= units <= 127 and self.t - self._heard > 0.02 * units:
            self._table[98] = 255
            self.plant.set_goal(Goal(self.plant.angle))  # it stops, and holds
        hot = self.plant.temperature > self._table[31]
        poor = not self._load(34, 2) <= 10.0 * self.plant.voltage <= self._load(32, 2)
        self._table[70] |= 4 * hot | poor
        if self._table[70] & self._table[63] and self._table[64]:
            self._switch(False)

    def _switch(self, on: bool) -> None:
        self._table[64] = on
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
