"""moteus: frames of the emulated controller against printed ones, and a host's errors for a wrong port."""

import asyncio
import errno
import os
import sys
from unittest.mock import Mock

import pytest

from hyperflex.errors import DriveError
from hyperflex.hardware import Drive, Goal, MoteusLink
from hyperflex.hardware.emulate import MoteusDevice
from hyperflex.model import MotorLimits
from tests.hardware.rig import Rig
from tests.hardware.servo import Servo
from tests.refusals import fails

# Of the page on the CAN protocol: position mode, 0.0096 turns, 0.072 turns/s, -1.76 N m; reads of 4 + 3 registers
COMMAND = b"can send 8001 01000a07206000200150ff140400130d\n"


@pytest.fixture
def device():
    return MoteusDevice(Servo())


@pytest.fixture
def rig(device):
    with Rig(device) as made:
        yield made


def opened(rig, **options):
    link = MoteusLink(rig.port, patience=1.0, **options)
    link.open()
    return link


# ---------------------------------------------------------------------- the device


def test_the_printed_frame_is_understood_and_answered(device):
    device.plant.voltage, device.plant.temperature, device.plant.angle = 12.0, 20.0, 0.008 * 2.0 * 3.141592653589793
    ok, reply, end = device.handle(COMMAND).split(b"\r\n")
    ((_, goal),) = device.plant.goals
    assert (goal.angle, goal.rate) == pytest.approx((0.0096 * 6.2831853, 0.072 * 6.2831853))
    assert goal.torque == pytest.approx(-1.76)
    assert (ok, end) == (b"OK *%02X" % crc(b"OK "), b"")
    # The same registers with the same values as printed there (2404000a005000.. and 230d181400), one subframe each
    values = [(0x25, 0, b"\x0a\x00"), (0x25, 1, b"\x50\x00"), (0x25, 2, b"\x00\x00"), (0x25, 3, b"\x00\x00")]
    values += [(0x21, 13, b"\x18"), (0x21, 14, b"\x14"), (0x21, 15, b"\x00")]
    data = b"".join(bytes([kind, register]) + value for kind, register, value in values)
    content = b"rcv 0100 %s E B F " % data.hex().upper().encode()
    assert reply == content + b"*%02X" % crc(content)


def crc(data):
    """CRC-8 by polynomial division, bit by bit of the whole message."""
    remainder = int.from_bytes(data + b"\x00", "big")
    for shift in range(remainder.bit_length() - 9, -1, -1):
        if remainder >> (shift + 8) & 1:
            remainder ^= 0x197 << shift
    return remainder


def test_a_command_may_come_in_pieces(device):
    assert device.handle(COMMAND[:20]) == b""
    assert device.handle(COMMAND[20:]).startswith(b"OK")
    assert len(device.plant.goals) == 1


def test_after_a_checksum_all_lines_need_one(device):
    good = COMMAND[:-1] + b" *%02X\n" % crc(COMMAND[:-1] + b" ")
    assert device.handle(good).startswith(b"OK")
    for bad in (COMMAND, good.replace(b"6000", b"6001")):
        assert device.handle(bad).startswith(b"ERR checksum")
    assert len(device.plant.goals) == 1


@pytest.mark.parametrize("line", [b"conf get id.id", b"can send 8001 0g", b"can send", b"can send zz 01", b"\xff\xfe"])
def test_other_lines_are_errors(device, line):
    assert device.handle(line + b"\n").startswith(b"ERR")
    assert device.plant.goals == []


def test_frames_for_others_and_frames_that_are_cut_off_change_nothing(device):
    device.handle(COMMAND.replace(b"8001", b"8002"))
    device.handle(COMMAND.replace(b"0150ff140400130d", b"01"))
    assert device.plant.goals == []
    assert device.handle(COMMAND.replace(b"8001", b"0001")).count(b"rcv") == 0  # no reply is wanted


@pytest.mark.parametrize(
    ("state", "code"), [({"voltage": 9.0}, 40), ({"voltage": 47.0}, 34), ({"temperature": 76.0}, 38)]
)
def test_it_protects_itself(device, state, code):
    device.handle(COMMAND)
    device.plant.impose(**state)
    device.tick(0.01)
    assert (device.mode, device.fault, device.plant.enabled) == (1, code, False)


# ---------------------------------------------------------------------- the link


def test_the_limits_go_with_every_goal(rig, device):
    link = opened(rig)
    seen = []
    device._command = lambda mode, values: seen.append(values)
    link.enable(MotorLimits(speed=3.0, acceleration=12.0, torque=0.7))
    link.send(Goal(0.5, 0.1, 0.2))
    link.close()
    register = link._vendor.Register
    turn = 6.283185307
    for values in seen:
        assert values[register.COMMAND_POSITION_MAX_TORQUE] == pytest.approx(0.7)
        assert values[register.COMMAND_TIMEOUT] == pytest.approx(0.03)
        assert values[register.COMMAND_VELOCITY_LIMIT] == pytest.approx(6.0 / turn)
        assert values[register.COMMAND_ACCEL_LIMIT] == pytest.approx(24.0 / turn)
    assert seen[-1][register.COMMAND_POSITION] == pytest.approx(0.5 / turn)
    link = opened(rig)
    link.enable(MotorLimits())
    link.close()
    assert register.COMMAND_POSITION_MAX_TORQUE not in seen[-1]  # the controller's own holds


def test_a_controller_in_timeout_may_hold_with_torque_and_is_stopped_first(rig, device):
    device._enter(11)
    link = opened(rig)
    state = link.read()
    link.close()
    assert (state.enabled, state.fault) == (True, "watchdog expired (mode 11)")
    with pytest.raises(DriveError, match=r"watchdog expired \(mode 11\).*clear_fault=True"):
        Drive(MoteusLink(rig.port, patience=1.0), MotorLimits()).connect()
    assert device.mode == 0
    device._enter(11)
    drive = Drive(MoteusLink(rig.port, patience=1.0, watchdog=0.1), MotorLimits())
    drive.connect(clear_fault=True)
    with drive:
        drive.set_zero(0.0)
        device._enter(11)
        fails(DriveError, "torque off", drive.set_zero, 0.0)
        device._enter(0)
        assert drive.enable().enabled
        drive.command(Goal(0.0))
    assert device.mode == 0


def test_a_controller_that_would_damp_or_hold_after_its_watchdog_is_refused(rig, device):
    device.timeout_mode = 12
    link = opened(rig)
    fails(DriveError, r"is 12, not 0\. Set it .*\?timeout_mode=12\.$", link.enable, MotorLimits())
    link.close()
    assert device.mode == 0
    link = opened(rig, timeout_mode=12)
    link.enable(MotorLimits())
    link.close()
    assert device.mode == 10


@pytest.mark.parametrize("board", [25.0, float("nan")])
def test_the_hotter_of_board_and_motor_counts(rig, device, board):
    shown, known = {10: 80.0, 14: board}, device._registers
    device._registers = lambda writer: (
        known(writer) | {index: (writer.write_temperature, value) for index, value in shown.items()}
    )
    link = opened(rig)
    assert link.read().temperature == 80.0
    link.close()


def test_after_an_error_in_a_callback_the_stop_still_arrives(rig, device):
    link = MoteusLink(rig.port, patience=1.0, watchdog=1.0)
    with Drive(link, MotorLimits()) as drive:
        drive.enable()
        link._loop.call_soon(lambda: 1 / 0)
        fails(DriveError, r"the port failed: division by zero.*Torque is off", drive.command, Goal(0.0))
        assert device.mode == 0


def test_a_device_that_stops_reading_holds_nobody_up(rig, monkeypatch):
    """The buffer of the port is full: a request still comes back, with an error."""
    link = opened(rig)

    def full(file, data):
        raise BlockingIOError(errno.EAGAIN, "full")

    monkeypatch.setattr("serial.serialposix.os.write", full)
    with pytest.raises(OSError, match="timeout"):
        link.read()
    monkeypatch.undo()
    link.close()


def test_nothing_is_loaded_before_it_is_needed():
    code = "import sys, hyperflex.hardware.moteus, hyperflex.hardware.links; sys.exit('moteus' in sys.modules)"
    assert os.spawnv(os.P_WAIT, sys.executable, [sys.executable, "-c", code]) == 0


# ---------------------------------------------------------------------- what is wrong with a port


def refused(port, words, **options):
    with pytest.raises(DriveError, match=words) as error:
        Drive(MoteusLink(str(port), **options), MotorLimits()).connect()
    assert "\n" not in str(error.value)


def test_a_port_that_cannot_be_opened(tmp_path, monkeypatch):
    (tmp_path / "port").write_text("")  # no serial port
    refused(tmp_path / "port", "cannot be opened")
    monkeypatch.setattr("serial.serialposix.os.open", Mock(side_effect=PermissionError(errno.EACCES, "")))
    refused("/dev/ttyACM0", "no permission.*dialout")


def test_two_drives_cannot_share_a_port(rig):
    link = opened(rig)
    refused(rig.port, "another program uses the port")
    link.read()
    link.close()


def test_a_wrong_id_and_nobody_there(rig):
    refused(rig.port, r"moteus 5 on .* does not answer. Controllers on this port: 1\.", number=5)
    with Rig(MoteusDevice(Servo()), baud=921_600) as deaf:
        refused(deaf.port, r"does not answer. Check its power.*115200 baud", baud=115_200)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (b"$GPGGA,092750.000,5321.6802,N\r\n", "something else does .*GPGGA.*Another device"),
        (b"\x80\xfe\r\xc0\x00\n", "something else does"),
        (b"OK\r\n", "only its adapter does"),
    ],
)
def test_somebody_else_there(answer, words):
    class Other:
        plant = Servo()

        def tick(self, t):
            return b""

        def handle(self, data):
            return answer

    with Rig(Other()) as rig:
        refused(rig.port, words)


def test_within_a_running_event_loop(rig):
    async def notebook():
        refused(rig.port, "event loop is running here")

    asyncio.run(notebook())
