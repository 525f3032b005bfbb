"""Emulated drives, for tests and for learning: a motor with a rope, and the devices that a host sees of it."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.hardware.emulate.dynamixel import DynamixelDevice
    from hyperflex.hardware.emulate.faults import WireFaults
    from hyperflex.hardware.emulate.moteus import MoteusDevice
    from hyperflex.hardware.emulate.odrive import ODriveDevice
    from hyperflex.hardware.emulate.plant import MotorModel, Plant
    from hyperflex.hardware.emulate.process import Emulator, EmulatorLog

__getattr__, __dir__, __all__ = attach(__name__, __file__)
