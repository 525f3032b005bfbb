"""Motors that carry out a motion (:class:`hyperflex.interfaces.Motor`): a simulated one."""

from hyperflex.hardware.motor import SAMPLE_TIME, SimulatedMotor

__all__ = ["SAMPLE_TIME", "SimulatedMotor"]
