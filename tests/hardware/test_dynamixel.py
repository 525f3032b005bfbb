"""Dynamixel: the emulated servo speaks protocol 2.0 as the vendor's SDK does, and the link keeps its promises."""

import errno
import math
import struct
import time
from dataclasses import replace

import pytest

from hyperflex.errors import DriveError
from hyperflex.hardware import DynamixelLink, Goal, dynamixel, serial_port
from hyperflex.hardware.emulate import DynamixelDevice
from hyperflex.model import MotorLimits
from tests.hardware.wire import Wire, be_patient, light_arm, opened, try_open
from tests.refusals import fails

LIMITS = MotorLimits(torque=1.5)
COUNT = math.tau / 4096


def servo(**options) -> DynamixelDevice:
    return DynamixelDevice(light_arm(voltage=12.0), **options)


def link_to(wire: Wire, **options):
    return opened(DynamixelLink(wire.port, **{"watchdog": 2.0, "patience": 0.3} | options))


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    be_patient(monkeypatch, dynamixel, silence=0.3)


# ---------------------------------------------------------------------- the device


def test_ping_and_its_answer_are_those_of_the_manual():
    # The example of the e-Manual: XM430-W210 with ID 1 and firmware 38.
    answer = servo(firmware=38).handle(bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E"))
    assert answer == bytes.fromhex("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")


def test_a_value_that_looks_like_a_header_is_stuffed_on_the_way_there_and_back():
    with Wire(servo()) as wire, link_to(wire) as link:
        header = struct.pack("<I", 0x00FDFFFF)
        link._set(116, header)
        assert link._get(116, 4) == header


# ---------------------------------------------------------------------- the link


def test_torque_that_another_program_left_on_is_switched_off():
    device = servo()
    device._switch(True)
    with Wire(device) as wire, link_to(wire) as link:
        assert not link.read().enabled
    assert not device.plant.enabled


def test_the_torque_limit_is_held_by_the_servo_where_it_measures_its_current():
    for model, limits, mode in (
        (1030, LIMITS, 5),
        (1030, MotorLimits(), 4),
        (1060, MotorLimits(), 4),
        (1060, LIMITS, 4),
        (1070, replace(LIMITS, torque=1.6), 4),
    ):
        device = servo(model=model)
        with Wire(device) as wire, link_to(wire) as link:
            link.enable(limits)
            assert device._table[11] == mode
            if mode == 5:
                most = int.from_bytes(device._table[102:104], "little") * 2.69e-3 * 3.0 / 2.3
                assert most == pytest.approx(1.5, abs=4e-3)  # a count
            assert math.isnan(link.read().torque) == (model != 1030)
            if model == 1060:
                with pytest.raises(DriveError, match=r"keeps no limit.*stall torque, 1.5 N m at 12 V, or more"):
                    link.enable(replace(LIMITS, torque=1.4))


def test_silence_stops_the_servo_and_locks_its_goals_until_the_fault_is_cleared():
    device = servo()
    with Wire(device) as wire, link_to(wire, watchdog=0.1) as link:
        link.enable(LIMITS)
        until = time.monotonic() + 5.0
        while device._table[98] != 255 and time.monotonic() < until:
            time.sleep(0.01)
        state = link.send(Goal(1.0))
        assert state.fault == "bus watchdog expired (register 98 is 255)"
        assert state.enabled  # it holds: the honest difference to other makes
        assert abs(link.read().angle) < 0.05
        link.disable()
        link.clear()
        state = link.read()
        assert (state.fault, state.enabled) == ("", False)


def test_a_hardware_error_switches_the_torque_off_and_needs_a_reboot():
    device = servo()
    with Wire(device) as wire, link_to(wire) as link:
        link.enable(LIMITS)
        device.plant.impose(temperature=95.0)
        until = time.monotonic() + 5.0
        while not (state := link.read()).fault and time.monotonic() < until:
            pass
        assert state.fault == "overheating (hardware error 4)"
        assert not state.enabled
        link.clear()
        assert link.read().fault.startswith("overheating")  # it is still hot
        device.plant.impose(temperature=30.0)
        link.clear()
        assert link.read().fault == ""
        link.enable(LIMITS)


# ---------------------------------------------------------------------- what can be wrong


@pytest.fixture
def quick(monkeypatch):
    for name in ("SILENCE", "CONFIRM", "START"):
        monkeypatch.setattr(dynamixel, name, 0.1)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("device", "bus", "said"),
    [
        ({}, {"baud": 57600}, "answers at 57600 baud, not at 1000000. Give that rate"),
        ({"number": 7}, {}, "does not answer. Servos on this bus: 7"),
        ({"firmware": 37}, {}, "firmware 37 has no bus watchdog. Update it"),
    ],
    ids=["baud", "id", "firmware"],
)
def test_a_wrong_setting_is_named(device, bus, said):
    with Wire(servo(**device), **bus) as wire, pytest.raises(DriveError, match=said):
        try_open(DynamixelLink(wire.port))


@pytest.mark.usefixtures("quick")
def test_other_devices_and_silence_are_named():
    device = servo()
    with Wire(device) as wire:
        device._store(0, 2, 350)
        fails(DriveError, r"model number 350 is no servo of the X series", try_open, DynamixelLink(wire.port))
        wire.mute = True
        with pytest.raises(DriveError, match=r"does not answer at 1000000 baud, nor at 57600, .*Check its power"):
            try_open(DynamixelLink(wire.port))


def test_ports_that_cannot_be_opened():
    with Wire(servo()) as wire, link_to(wire) as link:
        assert not link.read().enabled
        fails(DriveError, r"another program uses the port", try_open, DynamixelLink(wire.port))
    text = str(serial_port.open_problem("/dev/ttyUSB0", PermissionError(errno.EACCES, "Permission denied")))
    assert text.startswith("/dev/ttyUSB0: no permission. Join the group")
    assert "it cannot be opened (odd)" in str(serial_port.open_problem("/dev/ttyUSB0", ValueError("odd")))


def test_an_adapter_that_holds_replies_back_is_named(tmp_path, monkeypatch):
    (tmp_path / "latency").write_text("16\n", "utf-8")
    monkeypatch.setattr(dynamixel, "LATENCY_FILE", str(tmp_path / "latency"))
    with Wire(servo()) as wire:
        link = DynamixelLink(wire.port)
        with pytest.warns(UserWarning, match=r"holds replies back for 16 ms, so at most 48 goals a second"):
            link.open()
        link.close()
