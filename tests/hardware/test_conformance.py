"""What every make of drive promises, tried through its vendor's library against its emulated device.

Nothing here measures time: devices' clocks go slowly, so that a busy machine does not trip their watchdogs.
"""

import signal
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest

from hyperflex.errors import DriveError, InvalidInput
from hyperflex.hardware import Drive, Goal
from hyperflex.hardware.emulate import WireFaults
from hyperflex.hardware.emulate.faults import KINDS
from hyperflex.model import MotorLimits
from tests.hardware.makes import MAKES
from tests.refusals import fails

LIMITS = MotorLimits(speed=8.0, acceleration=30.0, torque=1.0, angles=(-1.5, 1.5))


@pytest.fixture(params=MAKES, ids=lambda make: make.name)
def make(request):
    return request.param


@pytest.fixture
def rig(make):
    with make.rig() as made:
        yield made


@pytest.fixture
def motor(rig):
    """The motor behind the device: what really happens."""
    return rig.device.plant


@pytest.fixture
def link(make, rig):
    return make.link(rig)


def wait(condition, seconds=30.0):
    """Wait until something is so; a machine may be busy."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, "it has not come true"
        time.sleep(1e-3)


# ---------------------------------------------------------------------- state and motion


def test_to_connect_and_to_read_moves_nothing(make, rig, motor, link):
    with Drive(link, LIMITS) as drive:
        motor.angle = 0.7
        before = time.monotonic()
        state = drive.read()
        after = time.monotonic()
    assert motor.goals == []
    assert motor.switched_off is None
    assert state.angle == pytest.approx(0.7, abs=make.resolution)
    assert before <= state.sent < state.received <= after
    assert (state.enabled, state.fault, state.stale) == (False, "", False)
    assert state.voltage == pytest.approx(24.0, abs=0.1)
    assert state.temperature == pytest.approx(25.0, abs=1.0)


def test_torque_comes_on_where_the_shaft_is(make, motor, link):
    motor.angle = 0.7
    with Drive(link, LIMITS) as drive:
        state = drive.enable()
        assert motor.enabled
        assert state.enabled
        assert state.angle == pytest.approx(0.7, abs=make.resolution)
    assert not motor.enabled
    assert {round(goal.angle, 2) for _, goal in motor.goals} <= {0.7}


def test_goals_arrive_as_they_were_sent(make, motor, link):
    goals = [Goal(0.01 * k, 0.05 * k, 0.02 * k) for k in range(5)]
    with Drive(link, LIMITS) as drive:
        drive.enable()
        motor.goals.clear()
        for goal in goals:
            drive.command(goal)
        wait(lambda: abs(motor.angle - 0.04) < 1e-3)
        assert drive.command(Goal(0.04, 0.2)).angle == pytest.approx(0.04, abs=1e-3 + make.resolution)
    for sent, (_, come) in zip(goals, motor.goals, strict=False):
        assert come.angle == pytest.approx(sent.angle, abs=make.resolution)
        assert come.rate == pytest.approx(sent.rate if "rate" in link.takes else 0.0, abs=make.fine)
        assert come.torque == pytest.approx(sent.torque if "torque" in link.takes else 0.0, abs=make.fine)


def test_a_counter_that_wrapped_by_a_turn_is_noticed(motor, link):
    motor.angle = 0.2 + 2.0 * np.pi
    with Drive(link, LIMITS) as drive:
        fails(DriveError, "1 turn away", drive.enable)
        assert motor.goals == []
        drive.set_zero(0.2)
        assert drive.enable().angle == pytest.approx(0.2, abs=2e-3)


# ---------------------------------------------------------------------- watchdog and faults


def test_the_device_goes_passive_when_the_host_falls_silent(make, rig, motor, link):
    with Drive(link, LIMITS) as drive:
        drive.enable()
        drive.command(Goal(0.0))
        last = motor.goals[-1][0]
        wait(lambda: make.passive(rig.device))
        assert link.watchdog <= 0.1
        assert rig.device.plant.t - last >= 0.9 * link.watchdog
        count = len(motor.goals)
        fails(DriveError, "watchdog", wait, lambda: drive.command(Goal(0.01)) is None)
        assert len(motor.goals) == count
        assert not motor.enabled
        fails(DriveError, "watchdog", drive.enable)
        drive.acknowledge()
        drive.enable()
        drive.command(Goal(0.01))
        assert motor.goals[-1][1].angle == pytest.approx(0.01, abs=make.resolution)


def test_a_fault_of_the_device_is_latched_until_it_is_acknowledged(make, rig, motor, link):
    with Drive(link, LIMITS) as drive:
        drive.enable()
        drive.command(Goal(0.0))
        make.fail(rig.device)
        count = len(motor.goals)
        fails(DriveError, "the device reports", wait, lambda: drive.read() is None)
        for refused in (drive.enable, lambda: drive.command(Goal(0.0))):
            fails(DriveError, "the device reports", refused)
        assert not motor.enabled
        assert len(motor.goals) == count
        drive.acknowledge()
        drive.enable()
        drive.command(Goal(0.0))
        assert motor.enabled


def test_a_device_in_fault_is_refused_in_one_line(make, rig, motor, link):
    make.fail(rig.device)
    with pytest.raises(DriveError, match=r"reports .*clear_fault=True") as refused:
        Drive(link, LIMITS).connect()
    assert "\n" not in str(refused.value)
    assert motor.goals == []
    with pytest.raises(DriveError, match="reports"):  # it is still there
        Drive(make.link(rig), LIMITS).connect()
    drive = Drive(make.link(rig), LIMITS)
    assert drive.connect(clear_fault=True).fault == ""
    drive.close()


def test_over_temperature_switches_off(motor, link):
    with Drive(link, LIMITS, max_temperature=60.0) as drive:
        drive.enable()
        motor.impose(temperature=65.0)
        with pytest.raises(DriveError, match="temperature 65 C"):  # some makes send it now and then
            wait(lambda: drive.command(Goal(0.0)) is None)
        assert not motor.enabled


# ---------------------------------------------------------------------- spoiled wires

COUNTS = [150, pytest.param(10_000, marks=pytest.mark.nightly)]  # of spoiled packets


def spoiled(rig) -> int:
    """How many requests and replies came late, changed, in part or not at all."""
    return sum(wire.counts[kind] for wire in (rig.requests, rig.replies) for kind in KINDS)


@pytest.mark.parametrize("count", COUNTS)
def test_no_state_is_stale_without_saying_so(make, rig, motor, count):
    """The shaft is moved by a hundredth before each request is handled: an angle shows when the device read it."""
    looked = []

    def move():
        motor.angle += 0.01
        looked.append(time.monotonic())

    rig.before = move
    good = stale = 0
    with Drive(make.link(rig, patience=0.005), LIMITS) as drive:
        rig.spoil(make.faults)
        while spoiled(rig) < count:
            begun = time.monotonic()
            try:
                state = drive.read()
            except DriveError:  # silent for too long
                with suppress(DriveError):
                    drive.acknowledge()
                continue
            seen = looked[round(state.angle / 0.01) - 1]
            assert state.sent <= seen <= state.received
            good, stale = good + (not state.stale), stale + state.stale
            assert state.stale == (state.received < begun)
        rig.spoil(WireFaults())
    assert good > 0.2 * (good + stale)
    assert stale > 0.03 * (good + stale)
    assert all(rig.replies.counts[kind] > 0 for kind in KINDS if getattr(make.faults, kind))


@pytest.mark.parametrize("count", COUNTS)
def test_no_command_beyond_the_limits_arrives_over_a_bad_wire(make, rig, motor, count):
    """Whatever happens to requests and replies, each goal of the motor was sent so, or is where the shaft is."""
    sent, refused = [], 0
    rng = np.random.default_rng(2)
    with Drive(make.link(rig, patience=0.005), LIMITS, max_deviation=9.0) as drive:
        rig.spoil(make.faults)
        while spoiled(rig) < count:
            with suppress(DriveError):
                if drive.fault or not drive.enabled:
                    drive.acknowledge()
                    last = drive.enable().angle
                goal = Goal(last + rng.normal(0.0, 0.03), rng.normal(0.0, 0.1))
                sent.append(goal.angle)
                try:
                    drive.command(goal)
                    last = goal.angle
                except InvalidInput:  # beyond a limit
                    sent.pop()
                    refused += 1
        rig.spoil(WireFaults())
    assert not motor.enabled
    assert refused > 0
    come = np.array([goal.angle for _, goal in motor.goals])
    assert come.size > 0.2 * len(sent)
    assert np.abs(come).max() <= 1.5 + make.resolution
    known = np.unique(sent)
    k = np.clip(np.searchsorted(known, come), 1, known.size - 1)
    from_sent = np.minimum(np.abs(come - known[k - 1]), np.abs(come - known[k]))
    path = np.array(motor.path)
    for (t, goal), sent_so in zip(motor.goals, from_sent <= make.resolution, strict=True):
        if not sent_so:  # to hold the shaft where it was read: it may coast until the goal arrives
            recent = path[max(0, np.searchsorted(path[:, 0], t - 0.05) - 1) : np.searchsorted(path[:, 0], t, "right")]
            assert np.abs(recent[:, 1] - goal.angle).min() <= make.resolution


# ---------------------------------------------------------------------- exits


@pytest.fixture
def host(make, rig):
    """Start a program that uses the motor, and end it after the test."""
    started = []

    def start(way):
        command = [sys.executable, "-m", "tests.hardware.host", make.address.format(port=rig.port), way]
        pipe = subprocess.PIPE
        process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        started.append(process)
        assert process.stdout.readline() == "on\n", process.stderr.read()
        assert rig.device.plant.enabled
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


EXITS = {
    "close": lambda process: process.stdin.write("\n"),
    "exception": lambda process: process.stdin.write("\n"),
    "atexit": lambda process: process.stdin.write("\n"),
    "SIGINT": lambda process: process.send_signal(signal.SIGINT),
    "SIGTERM": lambda process: process.send_signal(signal.SIGTERM),
    "SIGHUP": lambda process: process.send_signal(signal.SIGHUP),
}


def exits():
    """All ends with one make; with the others one, and the rest nightly: a program ends alike whatever its motor is."""
    for made in MAKES:
        for way in EXITS:
            marks = [pytest.mark.nightly] * (made is not MAKES[0] and way != "close")
            yield pytest.param(made, way, id=f"{made.name}-{way}", marks=marks)


@pytest.mark.parametrize(("make", "way"), [*exits()], indirect=["make"])
def test_every_end_of_a_program_switches_the_torque_off(host, motor, link, way):
    process = host(way)
    EXITS[way](process)
    process.stdin.flush()
    process.wait(30.0)
    assert not motor.enabled
    assert motor.switched_off - motor.goals[-1][0] < 0.9 * link.watchdog  # by the program, not by the watchdog


def test_a_host_that_is_killed_leaves_a_passive_device(make, rig, motor, link, host):
    host("SIGKILL").kill()
    wait(lambda: make.passive(rig.device))
    assert link.watchdog <= 0.1
    drive = Drive(make.link(rig), LIMITS)
    drive.connect(clear_fault=True)
    with drive:  # the next program may use it
        drive.enable()
        drive.command(Goal(0.0))
        assert motor.enabled


def test_a_lost_link_ends_the_program_and_leaves_a_passive_device(make, rig, host):
    process = host("lost link")
    rig.cut()
    process.wait(30.0)
    assert "DriveError" in process.stderr.read()
    wait(lambda: make.passive(rig.device))
