"""Hardware: drives that turn the arm, with one set of guards for all of them; a simulated motor."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.hardware.drive import STEP, Drive, DriveState, Goal, Link, Reading
    from hyperflex.hardware.drive_fit import DriveFit, DriveRecord, identify_drive
    from hyperflex.hardware.drive_model import DriveModel, plan_test_motion
    from hyperflex.hardware.dynamixel import DynamixelLink
    from hyperflex.hardware.emulate.plant import MotorModel
    from hyperflex.hardware.emulate.process import Emulator, EmulatorLog
    from hyperflex.hardware.links import emulated_device, open_link
    from hyperflex.hardware.moteus import MoteusLink
    from hyperflex.hardware.odrive import ODriveLink
    from hyperflex.hardware.simulated import SAMPLE_TIME, SimulatedMotor
    from hyperflex.hardware.suitability import (
        Demand,
        MotorData,
        Suitability,
        check_motor,
        demand,
        find_motor,
        motor_catalogue,
    )
    from hyperflex.hardware.zero import DriveZero

__getattr__, __dir__, __all__ = attach(__name__, __file__)
