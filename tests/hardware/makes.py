"""The makes on which the conformance suite runs, each with its emulated device."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from hyperflex.hardware import open_link
from hyperflex.hardware.emulate import DynamixelDevice, MoteusDevice, ODriveDevice, WireFaults
from tests.hardware.rig import Rig
from tests.hardware.servo import Servo

FAULTS = WireFaults(lost=0.05, late=0.1, garbled=0.1, truncated=0.1, delay=0.012, seed=3)


@dataclass(frozen=True)
class Make:
    """How to run one make.

    `device` makes the device from its motor; `address` is that of its link on a port; `passive` says whether its
    watchdog has fired; `fail` puts it into a fault; `resolution` is that of an angle on its wire, rad, `fine` that of
    rates and torques; `faults` are those of its wire that somebody can notice. At `pace` its watchdog waits for a
    second of ours.
    """

    name: str
    device: Callable[[Servo], Any]
    address: str
    passive: Callable[[Any], bool]
    fail: Callable[[Any], None]
    resolution: float
    fine: float = 1e-5
    faults: WireFaults = FAULTS
    pace: float = 0.1

    def rig(self, angle=0.0, **options):
        """A device with a motor at an angle, on a wire."""
        return Rig(self.device(Servo(angle)), pace=self.pace, **options)

    def link(self, rig, patience=1.0):
        """A link to it, not open yet. It waits for long, unless a test spoils the wire."""
        return open_link(self.address.format(port=rig.port), patience=patience)


MAKES = [
    Make(
        "moteus",
        MoteusDevice,
        "moteus:{port}",
        passive=lambda device: device.mode == 11 and not device.plant.enabled,
        fail=lambda device: device.fail(33),
        resolution=1e-5,
        pace=0.03,
    ),
    Make(
        "dynamixel",
        DynamixelDevice,
        "dynamixel:{port}",
        passive=lambda device: device.expired,  # it holds where it stopped
        fail=lambda device: device.fail(32),
        resolution=8e-4,  # half a count
    ),
    Make(
        "odrive",
        partial(ODriveDevice, heartbeat=1e-3),
        # At the pace of the rig the watchdog takes longer than a trial waits.
        "odrive:{port}?trial=0&torque_constant=0.1",
        passive=lambda device: device.expired and not device.plant.enabled,
        fail=lambda device: device.fail(1 << 26),
        resolution=1e-5,
        fine=4e-3,  # half a thousandth of a turn/s
        # CAN controllers check frames and drop damaged ones; the text on an adapter's port has no check of its own.
        # A request and its reply, both late, stay with a busy machine's pauses within the 18 ms in which a late frame
        # is known as one.
        faults=WireFaults(lost=0.02, late=0.05, delay=0.006, seed=3),
    ),
]
