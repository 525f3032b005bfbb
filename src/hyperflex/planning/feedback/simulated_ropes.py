"""Simulated worlds in which a plan is followed: where the true state of a rope comes from."""

from __future__ import annotations

from hyperflex.control import TrueState
from hyperflex.hardware import SimulatedMotor
from hyperflex.hardware.motor import SAMPLE_TIME
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.planning.robust.uncertainty import Draw


class DrawnWorld:
    """A drawn world as a StateSource: the true state of its rope under what its motor makes of the asked motion.

    Parameters
    ----------
    draw : Draw
    arm : Arm
    """

    def __init__(self, draw: Draw, arm: Arm) -> None:
        self.draw, self._true = draw, TrueState(draw.rope, arm)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the simulated state at `t`, s, when `motion`, made of moves, is asked for."""
        return self._true.state(t, self.draw.executed(motion))


class DrivenWorld:
    """A rope on a simulated motor as a StateSource: its true state under what the motor has really done.

    Parameters
    ----------
    rope : Rope
    arm : Arm
    motor : SimulatedMotor
        The same that is asked for motions; it stands where the arm is at t = 0.
    """

    def __init__(self, rope: Rope, arm: Arm, motor: SimulatedMotor) -> None:
        self.motor, self._true = motor, TrueState(rope, arm)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the simulated state at `t`, s; what the motor was asked for counts, and not `motion`."""
        self.motor.true_angle(t)
        return self._true.state(t, motion if t < 2.0 * SAMPLE_TIME else self.motor.motion())
