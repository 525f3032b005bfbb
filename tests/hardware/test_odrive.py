"""ODrive: the emulated axis speaks CANSimple through python-can, and the link keeps its promises."""

import math
import re
import struct
import threading
import time
from contextlib import suppress

import can
import pytest

from hyperflex.errors import DriveError
from hyperflex.hardware import Drive, Goal, ODriveLink, odrive
from hyperflex.hardware.drive import SILENCE, NoReply
from hyperflex.hardware.emulate import ODriveDevice
from hyperflex.model import MotorLimits
from tests.hardware.wire import Wire, be_patient, light_arm, opened, try_open
from tests.refusals import fails

LIMITS = MotorLimits(speed=40.0, torque=1.5)  # a step of half a radian is faster than an arm may be


def axis(**options) -> ODriveDevice:
    return ODriveDevice(light_arm(), **options)


def link_to(wire: Wire, **options):
    return opened(ODriveLink(wire.port, **{"patience": 0.3, "torque_constant": 0.1} | options))


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    be_patient(monkeypatch, odrive, silence=2.0)


def wait_for(condition) -> None:
    until = time.monotonic() + 10.0
    while not condition() and time.monotonic() < until:
        time.sleep(1e-3)
    assert condition()


# ---------------------------------------------------------------------- the device


def test_frames_are_those_of_the_protocol():
    device = axis(number=1)
    # Set_Input_Pos to axis 1 is frame 0x2C: a turn back, 0.5 turns/s, -0.25 N m.
    device.answer(0x2C, bytes.fromhex("000080BF F401 06FF"), False)
    assert device._goal == Goal(-math.tau, 0.5 * math.tau, -0.25)
    assert odrive._input(device._goal) == bytes.fromhex("000080BFF40106FF")
    (identifier, data), *_ = device.answer(1 << 5 | 0x09, b"", True)
    assert (identifier, struct.unpack("<ff", data)) == (0x29, (0.0, 0.0))
    assert device.answer(0x0C, bytes(8), False) == []  # another node
    assert device.answer(0x29, bytes(8), False) == []
    assert device.advance(0.02)[0] == (0x21, bytes([0, 0, 0, 0, 1, 0, 0, 0]))


def test_the_adapter_speaks_slcan():
    device = axis()
    assert device.handle(b"C\rS5\rO") == b"\r\r"
    assert device.handle(b"\rr0000\r") == b"\rz\rt00080204043A00060B00\r"
    assert device.handle(b"t00C7000000\rtXYZ0\r") == b"\a\a"
    assert device.tick(0.02).startswith(b"t00180000000001000000\rt01C8")
    device.handle(b"C\r")
    assert device.tick(0.04) == b""


# ---------------------------------------------------------------------- the link


def test_the_same_over_the_virtual_bus_of_python_can():
    device, end = axis(number=3, watchdog=0.05), threading.Event()
    device.plant.warm()
    bus = can.Bus(channel="arm", interface="virtual")

    def run() -> None:
        began = time.monotonic()
        while not end.is_set():
            message = bus.recv(1e-3)
            frames = device.advance(time.monotonic() - began)
            if message is not None:
                frames += device.answer(message.arbitration_id, bytes(message.data), message.is_remote_frame)
            for identifier, data in frames:
                bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    link = ODriveLink("arm", 3, interface="virtual", torque_constant=0.05, patience=0.3)
    link.open()
    link.enable(LIMITS)
    assert device._speed == pytest.approx(2.0 * LIMITS.speed)
    wait_for(lambda: link.read().fault)  # nobody feeds the watchdog
    assert link.read().fault == "watchdog expired (error 0x1000000)"
    assert not device.plant.enabled
    link.clear()
    assert link.read().fault == ""
    link.close()
    end.set()
    thread.join()
    bus.shutdown()


def test_an_axis_whose_watchdog_is_not_armed_is_refused():
    device = axis(watchdog=0.0)
    with Wire(device) as wire, link_to(wire) as link:
        fails(DriveError, r"its watchdog did not stop it within 0.1 s. Set axis0.config.watchdog_", link.enable, LIMITS)
        wait_for(lambda: not device.plant.enabled)


def test_an_axis_in_fault_does_not_switch_its_torque_on():
    device = axis()
    with Wire(device) as wire, link_to(wire) as link:
        device.plant.impose(voltage=10.0)
        with pytest.raises(DriveError, match=r"does not switch its torque on \(dc bus under voltage \(error 0x200\)\)"):
            link.enable(LIMITS)
        assert not device.plant.enabled


def test_a_limit_of_torque_needs_the_torque_constant_and_a_reported_torque():
    device = axis()
    with Wire(device) as wire, link_to(wire, torque_constant=0.0) as link:
        fails(DriveError, r"keeps no limit of torque .*\?torque_constant=0.05$", link.enable, LIMITS)
        link.torque_constant = 0.1
        wire.spoil = lambda reply: [reply.replace(b"t01C8", b"t01D8")]
        link._messages.clear()
        link._came = dict.fromkeys(link._came, -math.inf)
        wait_for(lambda: link._listen(0.01, lambda *_: link._beat > 0.0) and len(link._messages) > 1)
        fails(DriveError, r"does not report its torque.*torques_msg_rate_ms = 10", link.enable, LIMITS)
    assert not device.plant.enabled


@pytest.mark.parametrize("errors", [0, 1 << 26])
def test_an_axis_that_turns_in_a_calibration_is_switched_off(errors):
    device = axis(watchdog=0.0)
    device._state, device._reason = 4, errors
    with Wire(device) as wire:
        link = ODriveLink(wire.port, patience=0.3)
        drive = Drive(link, MotorLimits())
        with suppress(DriveError):  # of the errors
            drive.connect()
        drive.close()
    assert device._state == 1


def test_each_try_to_switch_the_torque_on_reads_the_angle_again():
    device, seen = axis(), []
    with Wire(device) as wire, link_to(wire, trial=False) as link:
        request = device._request

        def refuse_once(state):
            if state == 8:
                seen.append(device._goal.angle)
            if len(seen) > 1:
                request(state)
            else:
                device.plant.impose(encoder_turns=1.0)

        device._request = refuse_once
        link.enable(LIMITS)
    assert seen == pytest.approx([0.0, math.tau])


def test_a_missing_thermistor_does_not_hide_a_temperature():
    device = axis()
    measured = device._measured
    device._measured = lambda kind: struct.pack("<ff", math.nan, 80.0) if kind == 0x15 else measured(kind)
    with Wire(device) as wire, link_to(wire) as link:
        wait_for(lambda: link.read().temperature == 80.0)


@pytest.mark.parametrize(
    "spoiled",
    [
        lambda reply: [],
        lambda reply: [reply[:-3]],
        lambda reply: [reply.replace(b"t009", b"tXY9")],
        lambda reply: [reply.replace(b"t009", b"t\xff\xfe9")],
        lambda reply: [reply.replace(b"t0098", b"t0094")],
    ],
    ids=["lost", "truncated", "no number", "no text", "wrong length"],
)
def test_a_spoiled_reply_is_no_reply_and_the_next_one_counts(spoiled, monkeypatch):
    with Wire(axis()) as wire, link_to(wire) as link:
        link.patience = 0.05
        wire.spoil = spoiled
        with pytest.raises(NoReply):
            link.read()
        wire.spoil = lambda reply: [reply]
        link.patience = 1.0
        assert link.read().angle == 0.0


def test_after_a_lost_frame_goals_are_sent_and_states_come_again(monkeypatch):
    monkeypatch.setattr(odrive, "LATEST", 0.5)
    device = axis()
    with Wire(device) as wire, link_to(wire) as link:
        wire.spoil = lambda reply: [] if b"t009" in reply else [reply]
        link.patience = 0.01
        fails(NoReply, "no valid reply", link.read)
        wire.spoil = lambda reply: [reply]
        fails(NoReply, "still missing", link.send, Goal(0.2))
        wait_for(lambda: device._goal.angle == pytest.approx(0.2))
        time.sleep(0.5)
        link.patience = 0.3
        assert link.read().angle == 0.0


def test_two_lost_frames_in_a_row_take_less_time_than_a_drive_allows_for_silence():
    skipped = 0.0  # s; beside it the clock is a hundredth as fast, so that a busy host does not count
    with (
        Wire(axis()) as wire,
        link_to(wire, clock=lambda: skipped + 0.01 * time.monotonic(), patience=0.05) as link,
    ):
        begin = link.clock()
        wire.spoil = lambda reply: [] if b"t009" in reply else [reply]
        for _ in range(2):
            fails(NoReply, "no valid reply", link.read)
            skipped += odrive.LATEST
        wire.spoil, link.patience = lambda reply: [reply], 1.0
        assert link.read().received - begin < SILENCE


def test_without_heartbeat_nobody_knows_whether_it_is_armed(monkeypatch):
    device = axis()
    with Wire(device) as wire, link_to(wire) as link:
        device.heartbeat = math.inf
        monkeypatch.setattr(odrive, "SILENCE", 0.05)
        link.read()  # takes what was sent before from the queue
        time.sleep(0.5)
        fails(NoReply, r"no heartbeat for", link.read)


def test_what_an_axis_no_longer_tells_is_not_known(monkeypatch):
    device = axis(watchdog=0.0)
    with Wire(device) as wire, link_to(wire, trial=False) as link:
        link.enable(LIMITS)
        wait_for(lambda: math.isfinite(link.read().temperature))
        monkeypatch.setattr(odrive, "SILENCE", 0.05)
        wire.spoil = lambda reply: [re.sub(rb"t(01C|017|015)8", b"t01E8", reply)]
        refusals = list[str]()

        def refused() -> bool:
            try:
                link.read()
            except NoReply as error:
                refusals.append(str(error))
            return bool(refusals)

        wait_for(refused)
        assert "no longer reports its torque" in refusals[0]
        assert math.isfinite(link._pair(odrive.Message.VOLTAGE, 10.0)[0])
        link.disable()
        wait_for(lambda: device._state == 1)
        monkeypatch.setattr(odrive, "SILENCE", 2.0)
        wait_for(lambda: not link.read().enabled)
        monkeypatch.setattr(odrive, "SILENCE", 0.05)
        wait_for(lambda: math.isnan(link.read().voltage))
        state = link.read()
        assert (math.isnan(state.torque), math.isnan(state.temperature)) == (True, True)


# ---------------------------------------------------------------------- what can be wrong


def test_wrong_node_old_firmware_and_silence_are_named(monkeypatch):
    monkeypatch.setattr(odrive, "FIRST_HEARTBEAT", 0.2)
    with Wire(axis(number=5)) as wire, pytest.raises(DriveError, match=r"no heartbeat. Nodes on this bus: 5"):
        try_open(ODriveLink(wire.port))
    with Wire(axis(firmware=(0, 5, 6))) as wire, pytest.raises(DriveError, match=r"firmware 0.5.6 speaks another"):
        try_open(ODriveLink(wire.port))
    with Wire(axis()) as wire:
        wire.mute = True
        with pytest.raises(DriveError, match=r"nothing is heard on the bus. Check power, .* runs at 250000 bit/s"):
            try_open(ODriveLink(wire.port))


def test_rates_of_messages_that_do_not_serve_are_named(monkeypatch):
    monkeypatch.setattr(odrive, "SILENCE", 0.2)
    with Wire(axis(heartbeat=0.5)) as wire, pytest.raises(DriveError, match=r"Set .*heartbeat_msg_rate_ms = 10"):
        try_open(ODriveLink(wire.port))
    with Wire(axis()) as wire:
        wire.spoil = lambda reply: [b"t00980000000000000000\r" + reply]
        fails(DriveError, r"estimates unasked. Set .*encoder_msg_rate_ms = 0", try_open, ODriveLink(wire.port))


def test_a_can_interface_that_cannot_be_opened():
    with pytest.raises(DriveError, match=r"can77: no CAN interface of that name is ready .* sudo ip link set can77 up"):
        try_open(ODriveLink("can77"))
