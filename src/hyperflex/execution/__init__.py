"""Execution: a planned cast carried out on a drive, and learned from."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.execution.camera import CameraRope, EmulatedCamera, measured_length
    from hyperflex.execution.cast_run import CastRun, observed_turns
    from hyperflex.execution.drive_record import record_test_motion
    from hyperflex.execution.emulated import EmulatedRope, emulator_of, motor_model
    from hyperflex.execution.learning import Attempt, CastLog, LearningOptions, LearningResult, learn_cast
    from hyperflex.execution.page import RunPage
    from hyperflex.execution.rope_watch import ClockedSource
    from hyperflex.execution.run import RunOptions, open_drive, run_plan
    from hyperflex.execution.stream import MotionStream, StreamLog

__getattr__, __dir__, __all__ = attach(__name__, __file__)
