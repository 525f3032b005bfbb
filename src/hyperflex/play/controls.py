"""Settings of the page with units and ranges; the rope and arm that they shape, and their target and motor."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Peg, Rope, with_links
from hyperflex.planning import MotorLimits, scaled_rope


class Control(NamedTuple):
    """Control of a number: group, label, unit, range and step of its slider; a step of 0 makes a tick box.

    With `choices` the number is the index of one of them.
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


def _set(default: float, *control: Any) -> Any:
    """Return a field with its default value and its control."""
    return field(default=default, metadata={"control": Control(*control)})


@dataclass(frozen=True)
class Settings:
    """All settings, in the units of their controls."""

    length: float = _set(2.0, "Rope", "length", "m", 0.2, 5.0, 0.05)
    mass: float = _set(0.125, "Rope", "mass", "kg", 0.01, 1.0, 0.005)
    links: float = _set(50, "Rope", "links", "", 2, 200, 1)
    friction: float = _set(5e-4, "Rope", "friction of each joint", "N m s/rad", 0.0, 0.005, 0.0001)
    arm_length: float = _set(0.105, "Arm", "length", "m", 0.01, 1.0, 0.005)
    arm_angle: float = _set(-90.0, "Arm", "angle to hold", "degrees", -180.0, 180.0, 1.0)
    t_move: float = _set(0.73, "Swing", "time of a half turn", "s", 0.2, 2.0, 0.01)
    rule: float = _set(FIXED, "Swing", "the next one begins", "", 0, len(RULES) - 1, 1, RULES)
    t_rest: float = _set(0.53, "Swing", "fixed rest", "s", 0.0, 2.0, 0.01)
    target_x: float = _set(-0.83, "Target", "x", "m", -6.0, 6.0, 0.01)
    target_y: float = _set(-1.07, "Target", "y", "m", -6.0, 6.0, 0.01)
    target_radius: float = _set(0.04, "Target", "radius", "m", 0.005, 0.3, 0.005)
    target_friction: float = _set(0.3, "Target", "friction", "", 0.0, 1.0, 0.01)
    target_solid: float = _set(1, "Target", "a peg that the rope touches", "", 0, 1, 0)
    motor_speed: float = _set(MotorLimits.speed, "Motor", "speed", "rad/s", 1.0, 30.0, 0.01)
    motor_acceleration: float = _set(MotorLimits.acceleration, "Motor", "acceleration", "rad/s²", 2.0, 200.0, 0.1)
    time_budget: float = _set(30.0, "Motor", "time to plan", "s", 2.0, 120.0, 1.0)
    speed: float = _set(1.0, "View", "speed", "× real time", 0.02, 2.0, 0.01)

    def changed(self, values: Mapping[str, object]) -> "Settings":
        """Return settings with changed values; InvalidInput names one that is unknown or out of its range."""
        checks.keys("the settings", values, CONTROLS)
        found = {}
        for name, given in values.items():
            each = CONTROLS[name]
            value = checks.number(f"{each.group.lower()} {each.words}", given, unit=each.unit)
            if not each.low <= value <= each.high:
                allowed = f"{each.low:g} to {each.high:g} {each.unit}".rstrip()
                raise InvalidInput(f"{each.group.lower()} {each.words} is out of range", got=value, allowed=allowed)
            found[name] = float(round(value)) if each.step in (0, 1) and not each.unit else value
        return replace(self, **found)

    def of(self, rope: Rope, arm: Arm) -> "Settings":
        """Return settings that show a rope and an arm, which may be out of the controls' ranges."""
        shown = {"length": rope.total_length, "mass": rope.total_mass, "links": rope.n_links}
        return replace(self, **shown, friction=_friction(rope), arm_length=arm.length)

    def rope(self, like: Rope) -> Rope:
        """Return another rope scaled in length or mass, or divided again, according to the settings."""
        made = like if self.links == like.n_links else with_links(like, int(self.links))
        long, heavy = self.length / made.total_length, self.mass / made.total_mass if made.total_mass else 1.0
        if long != 1.0 or heavy != 1.0:
            made = scaled_rope(made, long, heavy, 1.0)
        if self.friction != _friction(like) or self.links != like.n_links:  # of each joint, as the control says
            made = made.replace(friction=self.friction)
        return made.replace(name=f"{like.name}, changed") if like.name and made is not like else made

    def arm(self, like: Arm) -> Arm:
        """Return an arm as long as is set, and else as another."""
        return replace(like, length=self.arm_length)

    @property
    def target(self) -> Peg:
        """The target as a peg, also if contact is disabled."""
        return Peg(self.target_x, self.target_y, self.target_radius, self.target_friction)

    @property
    def limits(self) -> MotorLimits:
        """Limits of the motor."""
        return MotorLimits(self.motor_speed, self.motor_acceleration)


def _friction(rope: Rope) -> float:
    """Return the friction of a rope's joints, N m s/rad; the mean where they differ."""
    return float(rope.friction.mean())


CONTROLS: dict[str, Control] = {each.name: each.metadata["control"] for each in fields(Settings)}
