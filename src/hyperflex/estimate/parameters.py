"""Parameters estimated beside the rope's state: each with a prior, and how it enters the motion or the picture."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope
from hyperflex.vision import AS_CALIBRATED, PlaneAdjustment

# of the rope: what one unit of the parameter changes, as directions of a derivative
DYNAMIC: dict[str, Callable[[Rope], dict[str, Array]]] = {
    "length": lambda rope: {"length": rope.length, "com": rope.com, "inertia": 2.0 * rope.inertia},
    "friction": lambda rope: {"friction": rope.friction},
    "drag": lambda rope: {"drag": rope.drag},
    "tip_mass": lambda rope: {"tip_mass": np.ones(1)},
}
# of the picture, with what they are
OPTICAL = ("scale", "roll", "offset_x", "offset_y", "delay", "readout")
LEFT_OUT = 5e-5  # of standard deviations: rad of an angle, of rates over sqrt(g / L), of a parameter over its first one


@dataclass(frozen=True)
class EstimatedParameter:
    """A constant that is estimated beside the state.

    Parameters
    ----------
    name : str
        ``"length"``: relative change of all lengths of the rope, markers included; ``"friction"``, ``"drag"``: relative
        change of the rope's own; ``"tip_mass"``: kg, beside the rope's own. Of the picture: ``"scale"``: relative
        change of the plane's scale; ``"roll"``: its turn about the line of sight, rad; ``"offset_x"``,
        ``"offset_y"``: m; ``"arc[k]"``: change of the k-th marker's arc length, m; ``"delay"``: by how much the
        pictures are older than their stamps, s; ``"readout"``: time from the first row of a picture to the last, s.
    std : float
        Standard deviation of the prior, > 0.
    value : float
        Its mean.
    walk : float
        Random walk, per square root of a second; 0 of a true constant.
    """

    name: str
    std: float
    value: float = 0.0
    walk: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        if self.name not in (*DYNAMIC, *OPTICAL) and not re.fullmatch(r"arc\[\d+\]", self.name):
            allowed = ", ".join((*DYNAMIC, *OPTICAL, "arc[k]"))
            raise InvalidInput("this cannot be estimated beside the state", got=self.name, allowed=allowed)
        checks.number(f"std of {self.name}", self.std, sign="positive")
        checks.number(f"value of {self.name}", self.value)
        checks.number(f"walk of {self.name}", self.walk, sign="nonnegative")


class ParameterStates:
    """The parameters of one estimate, in their order.

    Parameters
    ----------
    estimated : sequence of EstimatedParameter
    rope : Rope
        As it is taken to be where all are 0.
    watched : sequence of str
        What is held at 0 until a change of it is noticed, where it is not estimated anyway.
    moved : bool
        Whether the first joint moves, so that a delay counts.

    Attributes
    ----------
    names : tuple of str
    value_at_start, std, walk : (P,) float64
        Mean and standard deviation of the priors, 0 of what is held, and the random walks.
    """

    def __init__(
        self, estimated: Sequence[EstimatedParameter], rope: Rope, watched: Sequence[str] = (), moved: bool = False
    ) -> None:
        self.rope = rope
        names = [each.name for each in estimated]
        held = [EstimatedParameter(name, 1.0) for name in watched if name not in names]
        self.names = (*names, *(each.name for each in held))
        self.value_at_start = np.array([each.value for each in (*estimated, *held)])
        self.walk = np.array([each.walk for each in (*estimated, *held)])
        self.std = np.array([*(each.std for each in estimated), *(0.0 for _ in held)])
        if len(set(self.names)) != len(self.names):
            raise InvalidInput("parameters name something twice", got=self.names, allowed="each name once")
        for name in ("friction", "drag"):
            if name in self.names and not getattr(rope, name).any():
                fix = f"Give the rope a {name} to begin with"
                raise InvalidInput(f"{name} is a relative change, and the rope has none", got=0.0, fix=fix)
        self.dynamic = [k for k, name in enumerate(self.names) if name in DYNAMIC or (name == "delay" and moved)]
        self._of_rope = [k for k, name in enumerate(self.names) if name in DYNAMIC]

    def __len__(self) -> int:
        """Number of parameters."""
        return len(self.names)

    def value(self, name: str, values: Array) -> float:
        """Return one parameter's value; 0 where it is not estimated."""
        return float(values[self.names.index(name)]) if name in self.names else 0.0

    def least(self, values: Array) -> Array:
        """Return the standard deviations (P,) that a covariance leaves out, > 0, for values (P,)."""
        first = np.where(self.std > 0.0, self.std, np.abs(values))  # of what was noticed to have changed: its size
        return LEFT_OUT * np.where(first > 0.0, first, 1.0)

    def estimates(self, x: Array, rows: Array) -> dict[str, tuple[float, float]]:
        """Return value and standard deviation of each parameter that is not held.

        Parameters
        ----------
        x : (N,) float64
            State, with the parameters at its end.
        rows : (r, N) float64
            Their squares are its covariance.
        """
        if not self.names:
            return {}
        first = x.size - len(self)
        std, known = np.linalg.norm(rows[:, first:], axis=0), (self.std > 0.0) | (x[first:] != 0.0)
        least = np.hypot(std, self.least(x[first:]))
        return {
            name: (float(value), float(each))
            for name, value, each, free in zip(self.names, x[first:], least, known | (std > 0.0), strict=True)
            if free
        }

    def directions(self) -> list[str | dict[str, dict[str, Array]]]:
        """Return the directions of what the motion depends on, as ``sensitivities`` takes them."""
        names = [self.names[k] for k in self.dynamic]
        return ["motion.delay" if name == "delay" else {name: DYNAMIC[name](self.rope)} for name in names]

    def same_rope(self, values: Array, others: Array) -> bool:
        """Return whether two sets of values (P,) describe the same rope."""
        return np.array_equal(values[self._of_rope], others[self._of_rope])

    def plane_adjustment(self, values: Array) -> PlaneAdjustment:
        """Return how the plane deviates from the calibrated one at values (P,)."""
        scale, roll, *offset = (self.value(name, values) for name in ("scale", "roll", "offset_x", "offset_y"))
        found = PlaneAdjustment(1.0 + scale, roll, tuple(offset))
        return AS_CALIBRATED if found == AS_CALIBRATED else found

    def arc_lengths(self, arc_lengths: Array, values: Array) -> Array:
        """Return where on the rope markers sit (K,), m, at values (P,); `arc_lengths` where all values are 0."""
        if not any(name == "length" or name.startswith("arc[") for name in self.names):
            return arc_lengths
        moved = [self.value(f"arc[{k}]", values) for k in range(len(arc_lengths))]
        return np.asarray(arc_lengths * (1.0 + self.value("length", values)) + moved)

    def possible(self, values: Array) -> Array:
        """Return the values (P,), moved to what a rope can have."""
        result = values.copy()
        for k, name in enumerate(self.names):
            if name in ("friction", "drag"):
                result[k] = max(result[k], -1.0)
            elif name == "tip_mass":
                result[k] = max(result[k], -self.rope.tip_mass)
            elif name in ("length", "scale"):
                result[k] = min(max(result[k], -0.5), 1.0)
        return result

    def rope_at(self, values: Array) -> Rope:
        """Return the rope that the values (P,) describe."""
        changes: dict[str, Any] = {}
        for k in self._of_rope:
            name, value = self.names[k], float(values[k])
            if name == "length":
                changes |= {"length": self.rope.length * (1.0 + value), "com": self.rope.com * (1.0 + value)}
                changes["inertia"] = self.rope.inertia * (1.0 + value) ** 2
            elif name == "tip_mass":
                changes["tip_mass"] = self.rope.tip_mass + value
            else:
                changes[name] = getattr(self.rope, name) * (1.0 + value)
        return self.rope.replace(**changes) if changes else self.rope
