"""Motors that carry out a motion (:class:`hyperflex.interfaces.Motor`): a simulated one."""

from __future__ import annotations

from hyperflex.hardware.motor import SimulatedMotor

__all__ = ["SimulatedMotor"]
