"""Motors that carry out a motion: what any of them offers, and a simulated one."""

from __future__ import annotations

from hyperflex.hardware.motor import Motor, SimulatedMotor

__all__ = ["Motor", "SimulatedMotor"]
