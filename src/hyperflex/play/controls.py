"""What can be set in the page: names, units and ranges, and what rope, arm, target and motor they make."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Peg, Rope
from hyperflex.planning import MotorLimits

RADIUS = 0.0025  # m, of the rope: the paper's cable


class Control(NamedTuple):
    """A number that can be set: the group it stands in, its words, unit, range and step; a step of 0 is a tick.

    With `choices` it is the number of one of them, from 0 on.
    """

    group: str
    words: str
    unit: str
    low: float
    high: float
    step: float
    choices: tuple[str, ...] = ()


FIXED, CROSSING, PUMPING = range(3)
RULES = ("after a fixed rest", "as the tip crosses the middle", "when it drives the swing most")

CONTROLS = {
    "length": Control("Rope", "length", "m", 0.2, 5.0, 0.05),
    "mass": Control("Rope", "mass", "kg", 0.01, 1.0, 0.005),
    "links": Control("Rope", "links", "", 2, 200, 1),
    "friction": Control("Rope", "friction of each joint", "N m s/rad", 0.0, 0.005, 0.0001),
    "arm_length": Control("Arm", "length", "m", 0.01, 1.0, 0.005),
    "arm_angle": Control("Arm", "angle to hold", "degrees", -180.0, 180.0, 1.0),
    "t_move": Control("Swing", "time of a half turn", "s", 0.2, 2.0, 0.01),
    "rule": Control("Swing", "the next one begins", "", 0, len(RULES) - 1, 1, RULES),
    "t_rest": Control("Swing", "fixed rest", "s", 0.0, 2.0, 0.01),
    "target_x": Control("Target", "x", "m", -6.0, 6.0, 0.01),
    "target_y": Control("Target", "y", "m", -6.0, 6.0, 0.01),
    "target_radius": Control("Target", "radius", "m", 0.005, 0.3, 0.005),
    "target_friction": Control("Target", "friction", "", 0.0, 1.0, 0.01),
    "target_solid": Control("Target", "a peg that the rope touches", "", 0, 1, 0),
    "motor_speed": Control("Motor", "speed", "rad/s", 1.0, 30.0, 0.01),
    "motor_acceleration": Control("Motor", "acceleration", "rad/s²", 2.0, 200.0, 0.1),
    "time_budget": Control("Motor", "time to plan", "s", 2.0, 120.0, 1.0),
    "speed": Control("View", "speed", "× real time", 0.02, 2.0, 0.01),
}


@dataclass(frozen=True)
class Settings:
    """Values of all CONTROLS, in their units."""

    length: float = 2.0
    mass: float = 0.125
    links: float = 50
    friction: float = 5e-4
    arm_length: float = 0.105
    arm_angle: float = -90.0
    t_move: float = 0.73
    rule: float = FIXED
    t_rest: float = 0.53
    target_x: float = -0.83
    target_y: float = -1.07
    target_radius: float = 0.04
    target_friction: float = 0.3
    target_solid: float = 1
    motor_speed: float = MotorLimits.speed
    motor_acceleration: float = MotorLimits.acceleration
    time_budget: float = 30.0
    speed: float = 1.0

    def changed(self, values: Mapping[str, object]) -> "Settings":
        """Return settings with some values changed; InvalidInput names one that is unknown or out of its range."""
        checks.keys("the settings", values, [each.name for each in fields(self)])
        found = {}
        for name, given in values.items():
            each = CONTROLS[name]
            value = checks.number(f"{each.group.lower()} {each.words}", given, unit=each.unit)
            if not each.low <= value <= each.high:
                allowed = f"{each.low:g} to {each.high:g} {each.unit}".rstrip()
                raise InvalidInput(f"{each.group.lower()} {each.words} is out of range", got=value, allowed=allowed)
            found[name] = float(round(value)) if each.step in (0, 1) and not each.unit else value
        return replace(self, **found)

    @property
    def rope(self) -> Rope:
        """The rope."""
        return Rope.uniform(self.length, self.mass, int(self.links), RADIUS, friction=self.friction)

    @property
    def arm(self) -> Arm:
        """The arm."""
        return Arm(length=self.arm_length)

    @property
    def target(self) -> Peg:
        """The target as a peg, whether or not the rope touches it."""
        return Peg(self.target_x, self.target_y, self.target_radius, self.target_friction)

    @property
    def limits(self) -> MotorLimits:
        """Limits of the motor."""
        return MotorLimits(self.motor_speed, self.motor_acceleration)
