"""The device's side of a moteus controller on a UART: text lines that carry register frames."""

import io
import math
import struct
from typing import Any

from hyperflex import extras
from hyperflex.hardware.drive import Goal
from hyperflex.hardware.emulate.plant import Plant


class MoteusDevice:
    """An emulated moteus controller behind the text protocol of an fdcanusb, with checksums as on a UART.

    Parameters
    ----------
    plant : Plant
        Its motor; give it a model that extrapolates, as a controller does.
    number : int
        Its address.

    Attributes
    ----------
    mode, fault : int
        As the registers of these names.
    timeout_mode : int
        What it says of servo.timeout_mode; it behaves as with 0.

    Notes
    -----
    As with its setting servo.timeout_mode at 0, which is not the factory's, the shaft is free in a timeout. Emulated
    are stop, position mode with its watchdog (mode 11 until a stop) and its limit of speed, latched faults
    (mode 1 until a stop) and reads of any register, of which those without a meaning here read 0. Not emulated are the
    limits of acceleration and torque, the factory's damping in a timeout (mode 12), other modes and, of the diagnostic
    stream, all but this setting. A broken checksum is an error; after a line with a checksum, all need one.
    """

    options = ""  # of its address
    voltages, temperature = (10.0, 46.0), 75.0  # least and greatest voltage, V; greatest temperature, degrees Celsius

    def __init__(self, plant: Plant, number: int = 1) -> None:
        self._vendor: Any = extras.load("moteus", "moteus", "emulated moteus controllers")
        self.plant, self.number = plant, number
        self._modes: Any = self._vendor.Mode
        self.mode, self.fault, self.timeout_mode = self._modes.STOPPED, 0, 0
        self._deadline, self._told = math.inf, b""  # of the diagnostic stream
        self._checksums, self._received = False, b""

    def tick(self, t: float) -> bytes:
        """Advance to time t, s; nothing is sent unasked."""
        self.plant.advance(t)
        if self.mode == self._modes.POSITION:
            if self.plant.temperature > self.temperature:
                self.fail(38)  # over temperature
            elif self.plant.voltage > self.voltages[1]:
                self.fail(34)  # over voltage
            elif self.plant.voltage < self.voltages[0]:
                self.fail(40)  # under voltage
            elif self.plant.t > self._deadline:
                self._enter(self._modes.TIMEOUT)
        return b""

    def fail(self, code: int) -> None:
        """Enter a fault, which lasts until a stop."""
        self.fault = code
        self._enter(self._modes.FAULT)

    def _enter(self, mode: int) -> None:
        self.mode = mode
        self.plant.set_enabled(mode == self._modes.POSITION)

    # ------------------------------------------------------------------ lines

    def handle(self, data: bytes) -> bytes:
        """Take bytes from the host; return the lines that answer the complete ones."""
        *lines, self._received = (self._received + data).replace(b"\r", b"\n").split(b"\n")
        answers = (answer for line in lines if line for answer in self._line(line))
        return b"".join(b"%s *%02X\r\n" % (each, _crc(each + b" ")) for each in answers)

    def _line(self, line: bytes) -> list[bytes]:
        content, star, crc = line.rpartition(b"*")
        if star:
            self._checksums = True
        if self._checksums and crc != b"%02X" % _crc(content):
            return [b"ERR checksum"]
        try:
            can, send, identifier, data, *_ = (content if star else line).split()
            if (can, send) != (b"can", b"send"):
                raise ValueError
            address, frame = int(identifier, 16), bytes.fromhex(data.decode("ascii"))
        except ValueError:
            return [b"ERR unknown command"]
        if address & 0x7F not in (self.number, 0x7F):
            return [b"OK"]
        reply = self._frame(frame)
        if not address & 0x8000 or not reply:
            return [b"OK"]
        source = address >> 8 & 0x7F
        return [b"OK", b"rcv %04x %s E B F" % (self.number << 8 | source, reply.hex().upper().encode("ascii"))]

    # ------------------------------------------------------------------ registers

    def _frame(self, data: bytes) -> bytes:
        """Carry out the writes of a frame, then return the registers that it reads."""
        if data[:2] == b"\x40\x01":  # text to the diagnostic stream
            right = data[3 : 3 + data[2]] == b"conf get servo.timeout_mode\n"
            self._told += b"%d\r\n" % self.timeout_mode if right else b"ERR unknown command\r\n"
            return b""
        if data[:2] == b"\x42\x01":  # what has it to tell?
            told, self._told = self._told[: data[2]], self._told[data[2] :]
            return b"\x41\x01%c%b" % (len(told), told)
        try:
            parsed = self._vendor.parse_registers(data)
        except (RuntimeError, struct.error):  # cut off
            return b""
        register = self._vendor.Register
        if register.MODE in parsed.command:
            self._command(parsed.command[register.MODE], parsed.command)
        reply = io.BytesIO()
        writer = self._vendor.protocol.Writer(reply)
        registers = self._registers(writer)
        for index, resolution in parsed.query:
            write, value = registers.get(index, (writer.write_int, 0))
            writer.write_int8(0x21 | resolution << 2)
            writer.write_varuint(index)
            write(value, resolution)
        return reply.getvalue()

    def _registers(self, writer: Any) -> dict[int, tuple[Any, float]]:
        """Return how a register is written, and its value."""
        register, plant = self._vendor.Register, self.plant
        return {
            register.MODE: (writer.write_int, self.mode),
            register.POSITION: (writer.write_position, plant.angle / math.tau),
            register.VELOCITY: (writer.write_velocity, plant.rate / math.tau),
            register.TORQUE: (writer.write_torque, plant.torque),
            register.VOLTAGE: (writer.write_voltage, plant.voltage),
            register.TEMPERATURE: (writer.write_temperature, plant.temperature),
            register.FAULT: (writer.write_int, self.fault),
        }

    def _command(self, mode: int, values: dict[int, float]) -> None:
        register = self._vendor.Register
        if mode == self._modes.STOPPED:
            self.fault = 0
            self._enter(mode)
        elif mode == self._modes.POSITION and self.mode in (self._modes.STOPPED, self._modes.POSITION):
            angle, rate, torque, watchdog, most = (
                values.get(each, default)
                for each, default in (
                    (register.COMMAND_POSITION, 0.0),
                    (register.COMMAND_VELOCITY, 0.0),
                    (register.COMMAND_FEEDFORWARD_TORQUE, 0.0),
                    (register.COMMAND_TIMEOUT, 0.1),
                    (register.COMMAND_VELOCITY_LIMIT, math.inf),
                )
            )
            if self.mode != mode:
                self._enter(mode)
            self._deadline = self.plant.t + watchdog if math.isfinite(watchdog) else math.inf
            angle = math.tau * angle if math.isfinite(angle) else self.plant.angle
            self.plant.set_goal(Goal(angle, math.tau * max(-most, min(most, rate)), torque))


def _crc(data: bytes) -> int:
    """CRC-8 with the polynomial 0x97."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x97) & 0xFF if crc & 0x80 else crc << 1
    return crc
