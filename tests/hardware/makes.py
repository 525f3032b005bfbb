"""The makes on which the conformance suite runs, each with its emulated device."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hyperflex.hardware import open_link
from hyperflex.hardware.emulate import MoteusDevice
from tests.hardware.rig import Rig
from tests.hardware.servo import Servo


@dataclass(frozen=True)
class Make:
    """How to run one make.

    `device` makes the device from its motor; `address` is that of its link on a port; `passive` says whether its
    watchdog has fired; `fail` puts it into a fault; `resolution` is that of an angle on its wire, rad.
    """

    name: str
    device: Callable[[Servo], Any]
    address: str
    passive: Callable[[Any], bool]
    fail: Callable[[Any], None]
    resolution: float

    def rig(self, angle=0.0, **options):
        """A device with a motor at an angle, on a wire."""
        return Rig(self.device(Servo(angle)), **options)

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
    ),
]
