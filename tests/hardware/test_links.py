"""Addresses of drives: their meaning, and errors of invalid ones."""

import pickle
import sys

import pytest

from hyperflex.errors import DriveError, MissingPackage
from hyperflex.hardware import DriveZero, DynamixelLink, MoteusLink, ODriveLink, open_link
from hyperflex.hardware.emulate import DynamixelDevice, MoteusDevice, MotorModel, ODriveDevice, Plant
from hyperflex.hardware.links import MAKES, emulated_device
from hyperflex.model import Arm
from tests.hardware.wire import try_open
from tests.refusals import fails, refuses


def test_an_address_names_make_port_and_options():
    link = open_link("moteus:/dev/ttyACM0?id=2&baud=115200", watchdog=0.05)
    assert isinstance(link, MoteusLink)
    assert (link.port, link.number, link.baud, link.watchdog) == ("/dev/ttyACM0", 2, 115_200, 0.05)
    assert open_link("moteus:/dev/ttyACM0?watchdog=0.05").watchdog == 0.05
    assert open_link("odrive:can0?torque_constant=0.083").torque_constant == 0.083
    link = open_link("dynamixel:/dev/ttyUSB0?baud=57600")
    assert isinstance(link, DynamixelLink)
    assert (link.number, link.baud) == (1, 57_600)
    link = open_link("odrive:can0?id=3&bitrate=500000")
    assert isinstance(link, ODriveLink)
    assert (link.channel, link.number, link.bitrate) == ("can0", 3, 500_000)
    for address in ("moteus:/dev/ttyACM0", "dynamixel:/dev/ttyUSB0", "odrive:can0"):  # to the process that opens it
        assert pickle.loads(pickle.dumps(open_link(address))).name == open_link(address).name


def test_an_emulated_drive_is_a_device_and_no_port():
    assert emulated_device("emulator:moteus") == ("moteus", MoteusDevice)
    assert emulated_device("emulator:dynamixel") == ("dynamixel", DynamixelDevice)
    assert emulated_device("emulator:odrive") == ("odrive", ODriveDevice)
    assert emulated_device("moteus:/dev/ttyACM0") is None
    refuses("only while it runs.*Start a", open_link, "emulator:moteus")
    refuses("does not know this key", emulated_device, "emulator:moteus?speed=3")


def test_the_options_of_an_emulated_drive_are_the_devices_and_its_links():
    made = {}
    for make in MAKES:
        _, device = pickle.loads(pickle.dumps(emulated_device(f"emulator:{make}?id=3&watchdog=0.25")))
        made[make] = device(Plant(MotorModel(), None, Arm()))
        link = open_link(f"{make}:/dev/pts/1?{made[make].options}")
        assert (link.number, link.watchdog, made[make].number) == (3, pytest.approx(0.25, abs=0.02), 3)
    assert made["odrive"].watchdog == 0.25


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("", "not known.*moteus:/dev/ttyACM0"),
        ("/dev/ttyACM0", "not known.*make:port"),
        ("servo:/dev/ttyACM0", "not known"),
        ("moteus", "no port"),
        ("moteus:?id=1", "no port"),
        ("emulator:servo", "not known.*emulator:moteus"),
        ("moteus:/dev/ttyACM0?number=1", "does not know this key"),
        ("odrive:can0?baud=1000", "does not know this key.*bitrate"),
        ("moteus:/dev/ttyACM0?id=one", "id .* is not a number"),
        ("moteus:/dev/ttyACM0?id=1.5", "moteus id"),
        ("odrive:can0?torque_constant=-1", "torque_constant .* is not a number"),
        ("moteus:/dev/ttyACM0?id=127", "moteus id"),
        (3, "not text"),
    ],
)
def test_a_bad_address_is_refused(address, words):
    refuses(words, open_link, address)


def test_a_zero_is_that_of_its_motor():
    zero = DriveZero(0.3, motor="odrive:can0?id=2")
    zero.check("odrive:can0?torque_constant=0.05&id=2")
    DriveZero(0.3).check("odrive:can0")
    for other in ("odrive:can0", "odrive:can1?id=2", "moteus:/dev/ttyACM0"):
        refuses("zero belongs to another motor.*odrive:can0.id=2", zero.check, other)


@pytest.mark.parametrize("make", MAKES)
def test_a_port_that_is_not_there_and_a_package_that_lacks_are_named(make, monkeypatch):
    words = "/dev/ttyNONE: there is no such port. Ports of this machine"
    fails(DriveError, words, try_open, open_link(f"{make}:/dev/ttyNONE"))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    package = {"moteus": "moteus", "dynamixel": "dynamixel_sdk", "odrive": "can"}[make]
    monkeypatch.setitem(sys.modules, package, None)
    words = rf"pip install 'hyperflex\[{make}\]'"
    fails(MissingPackage, words, try_open, open_link(f"{make}:/dev/ttyACM0"))
