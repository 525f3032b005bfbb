"""What a filter tests for changes, how seldom that may give a false alarm, and a change that was noticed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.estimate.parameters import DYNAMIC, OPTICAL
from hyperflex.model import Rope

TOUCH, MISFIT = "touch", "misfit"
UNITS = {"tip_mass": "kg", "roll": "rad", "offset_x": "m", "offset_y": "m", "delay": "s", "readout": "s", TOUCH: "N s"}
# sizes that do not count as a change: a rope of rigid links and its table of values are never quite true
TOLERANCES = {
    "length": 2e-3,
    "scale": 2e-3,
    "friction": 0.3,
    "drag": 0.3,
    "roll": 2e-3,
    "offset_x": 2e-3,
    "offset_y": 2e-3,
    "delay": 2e-3,
    "readout": 3e-3,
}
PART_OF_MASS = 4e-3  # of the rope's mass: the same for a mass at the tip
PART_OF_WEIGHT = 1e-3  # of the rope's weight: the same for the force of a touch


@dataclass(frozen=True)
class ChangeTests:
    """What is tested for changes, and how seldom that may give a false alarm.

    Parameters
    ----------
    names : tuple of str, optional
        Parameters as in :class:`EstimatedParameter`, estimated or not, and ``"touch"``: an external force for a moment.
        By default ``"length"``, ``"tip_mass"``, ``"friction"`` and ``"drag"`` of a rope that has any, and ``"touch"``.
    false_alarm_interval : float
        Least mean time between two false alarms of all tests together, s, where the filter's model is right.
    tolerances : mapping of str to float
        Sizes that are no change, in each parameter's unit; of a touch its force, N. What is not given has a value of
        its own: 0.2 % of lengths, 30 % of friction and drag, 0.4 % of the rope's mass at the tip, 0.1 % of its weight.
    """

    names: tuple[str, ...] | None = None
    false_alarm_interval: float = 600.0
    tolerances: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the values."""
        allowed = ", ".join((*DYNAMIC, *OPTICAL, "arc[k]", TOUCH))
        for name in (*(self.names or ()), *self.tolerances):
            if name not in (*DYNAMIC, *OPTICAL, TOUCH) and not name.startswith("arc["):
                raise InvalidInput("there is no test for a change of this", got=name, allowed=allowed)
        for name, value in self.tolerances.items():
            checks.number(f"tolerance of {name}", value, sign="nonnegative")
        checks.number("false_alarm_interval", self.false_alarm_interval, sign="positive", unit="s")

    def names_for(self, rope: Rope) -> tuple[str, ...]:
        """Return what is tested of a rope."""
        if self.names is not None:
            return tuple(dict.fromkeys(self.names))
        always = ("length", "tip_mass", TOUCH)
        return tuple(name for name in (*DYNAMIC, TOUCH) if name in always or getattr(rope, name).any())

    def parameters_for(self, rope: Rope) -> tuple[str, ...]:
        """Return which parameters of a rope are tested: all but touches."""
        return tuple(name for name in self.names_for(rope) if name != TOUCH)

    def tolerance(self, name: str, rope: Rope) -> float:
        """Return the largest size of a parameter's change, or of a touch's force, that does not count."""
        if name in self.tolerances:
            return self.tolerances[name]
        if name == "tip_mass":
            return PART_OF_MASS * rope.total_mass
        if name == TOUCH:
            return PART_OF_WEIGHT * rope.total_mass * math.hypot(*rope.gravity)
        return TOLERANCES.get(name, 1e-3)


@dataclass(frozen=True)
class Change:
    """A change that was noticed.

    Attributes
    ----------
    name : str
        Of the parameter, or ``"touch"``; or ``"misfit"``: the markers are off by more than was declared, and no other
        change explains it. The rope swings out of its plane, say, or the camera is not where it is taken to be.
    noticed, time : float
        When it was noticed, and when it is most likely to have happened (begun), s.
    size, std : float
        By how much the parameter has changed, and the standard deviation of that, in its unit; of a touch its impulse
        until it was noticed, N s; of a misfit the markers' noise over what was declared.
    probability : float
        That it is this and none of the other changes that are tested for, all names equally likely before.
    log_false_alarm : float
        Logarithm of the probability of so clear a sign, in this test at one time, where nothing has changed.
    arc_length : float or None
        Of a touch: about where along the rope, m from the first joint.
    impulse : (float, float) or None
        Of a touch: its x and y, N s.
    """

    name: str
    noticed: float
    time: float
    size: float
    std: float
    probability: float
    log_false_alarm: float
    arc_length: float | None = None
    impulse: tuple[float, float] | None = None

    def __str__(self) -> str:
        """Return a sentence."""
        if self.name == MISFIT:
            return (
                f"misfit: markers are off by {self.size:.2g} times what was declared, noticed at {self.noticed:.2f} s"
            )
        unit = UNITS.get(self.name, "" if self.name[:4] != "arc[" else "m")
        at = "" if self.arc_length is None else f" at {self.arc_length:.2f} m"
        size = f"{self.size:+.3g}" if self.arc_length is None else f"{self.size:.3g}"
        return (
            f"{self.name}{at}: {size} ± {self.std:.2g} {unit}".rstrip()
            + f", since {self.time:.2f} s, noticed at {self.noticed:.2f} s, {100.0 * self.probability:.0f} % sure"
        )
