"""State sources that simulate the true rope: in a sampled scenario, or on a simulated motor."""

from hyperflex.control import TrueState
from hyperflex.hardware import SAMPLE_TIME, SimulatedMotor
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.planning.robust.uncertainty import Scenario


class ScenarioStateSource:
    """True state of the rope of a scenario, under what the scenario's motor makes of the commanded motion."""

    def __init__(self, scenario: Scenario, arm: Arm) -> None:
        self.scenario, self._true = scenario, TrueState(scenario.rope, arm)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the simulated state at `t`, s, under the command `motion`, made of moves."""
        return self._true.state(t, self.scenario.executed_motion(motion))


class MotorStateSource:
    """True state of a rope on a simulated motor, under the motion that the motor has made.

    The motor is the one that is commanded; it stands where the arm is at t = 0.
    """

    def __init__(self, rope: Rope, arm: Arm, motor: SimulatedMotor) -> None:
        self.motor, self._true = motor, TrueState(rope, arm)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the simulated state at `t`, s, under the motor's motion; `motion` is not used."""
        self.motor.true_angle(t)
        return self._true.state(t, motion if t < 2.0 * SAMPLE_TIME else self.motor.motion())
