"""Parameters estimated beside the rope's state: each with a prior, and its effect on the motion or the picture."""

import functools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Rope
from hyperflex.vision import Camera

NEGLIGIBLE = 5e-5  # standard deviation that a covariance omits: rad, sqrt(g / L), and of a parameter's first one


class Kind(NamedTuple):
    """What is known of a parameter by its name: unit, change that does not count as one, and limits of its value."""

    unit: str
    tolerance: float
    least: float = -math.inf
    most: float = math.inf


# The tolerances allow for what rigid links and a table of values do not represent of a rope.
ROPE_KINDS = {
    "length": Kind("", 2e-3, -0.5, 1.0),
    "friction": Kind("", 0.3, -1.0),
    "first_joint_friction": Kind("", 0.3, -1.0),
    "drag": Kind("", 0.3, -1.0),
    "tip_mass": Kind("kg", 4e-3),  # tolerance in units of the rope's mass; at least -tip_mass
}
PLANE_KINDS = {  # of the swing plane in the picture
    "scale": Kind("", 2e-3, -0.5, 1.0),
    "roll": Kind("rad", 2e-3),
    "offset_x": Kind("m", 2e-3),
    "offset_y": Kind("m", 2e-3),
}
BASE_KINDS = {  # place of the first joint, from where it was declared; the rope does not feel how it is moved
    "base_x": Kind("m", 2e-3),
    "base_y": Kind("m", 2e-3),
}
PICTURE_KINDS = {**PLANE_KINDS, "delay": Kind("s", 2e-3), "readout": Kind("s", 3e-3)}
NAMES = (*ROPE_KINDS, *BASE_KINDS, *PICTURE_KINDS, "arc[k]")


def kind(name: str) -> Kind | None:
    """Return what is known of a parameter; None if there is none of that name."""
    arc = Kind("m", 1e-3) if re.fullmatch(r"arc\[\d+\]", name) else None
    return (ROPE_KINDS | BASE_KINDS | PICTURE_KINDS).get(name, arc)


@dataclass(frozen=True)
class EstimatedParameter:
    """A constant that is estimated beside the state.

    Parameters
    ----------
    name : str
        ``"length"``: relative change of all lengths of the rope, markers included; ``"friction"``, ``"drag"``: relative
        change of the rope's; ``"first_joint_friction"``: further change of the first joint's friction; ``"tip_mass"``:
        kg, in addition to the rope's; ``"base_x"``, ``"base_y"``: where the first joint is, m from its declared place
        (with a walk: it moves in an unknown way). Of the picture: ``"scale"``: relative change of the plane's scale;
        ``"roll"``: its rotation about the line of sight, rad; ``"offset_x"``, ``"offset_y"``: m; ``"arc[k]"``: change
        of the k-th marker's arc length, m; ``"delay"``: how much older than their time stamps the pictures are, s;
        ``"readout"``: time from the first row of a picture to the last, s.
    std : float
        Standard deviation of the prior, > 0.
    value : float
        Its mean.
    walk : float
        Random walk, per square root of a second; 0 for a constant.
    """

    name: str
    std: float
    value: float = 0.0
    walk: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        if kind(self.name) is None:
            raise InvalidInput("this cannot be estimated beside the state", got=self.name, allowed=", ".join(NAMES))
        checks.number(f"std of {self.name}", self.std, sign="positive")
        checks.number(f"value of {self.name}", self.value)
        checks.number(f"walk of {self.name}", self.walk, sign="nonnegative")

    @property
    def unit(self) -> str:
        """Of its value."""
        known = kind(self.name)
        return known.unit if known and known.unit else "relative"


def moving_base(rope: Rope) -> list[EstimatedParameter]:
    """Return the place of a first joint that moves in an unknown way, in 0.1 s by some 5 % of the rope's length."""
    length = rope.total_length
    return [EstimatedParameter(name, length, walk=0.15 * length) for name in BASE_KINDS]


def _first(values: Array) -> Array:
    """Return the first of some values (n,), and 0 in place of the others."""
    return np.append(values[:1], np.zeros(len(values) - 1))


class ParameterStates:
    """The parameters of one estimate, in their order.

    Parameters
    ----------
    estimated : sequence of EstimatedParameter
    rope : Rope
        The rope where all parameters are 0.
    tested : sequence of str
        Parameters that are fixed at 0 until a change of them is noticed, if they are not estimated.
    moved : bool
        Whether the first joint moves, so that a delay has an effect.

    Attributes
    ----------
    names : tuple of str
    start, std, walk : (P,) float64
        Mean and standard deviation of the priors, 0 of fixed ones, and the random walks.
    of_rope, dynamic : list of int
        Those of the rope itself, and those on which the motion depends.
    """

    def __init__(
        self, estimated: Sequence[EstimatedParameter], rope: Rope, tested: Sequence[str] = (), moved: bool = False
    ) -> None:
        self.rope = rope
        names = [each.name for each in estimated]
        fixed = [EstimatedParameter(name, 1.0) for name in tested if name not in names]
        self.names = (*names, *(each.name for each in fixed))
        self.start = np.array([each.value for each in (*estimated, *fixed)])
        self.walk = np.array([each.walk for each in (*estimated, *fixed)])
        self.std = np.array([*(each.std for each in estimated), *(0.0 for _ in fixed)])
        if len(set(self.names)) != len(self.names):
            raise InvalidInput("parameters name something twice", got=self.names, allowed="each name once")
        changed = {"friction": rope.friction, "first_joint_friction": rope.friction[:1], "drag": rope.drag}
        for name, own in changed.items():
            if name in self.names and not own.any():
                fix = f"Give the rope some {name.replace('_', ' ')} to begin with"
                raise InvalidInput(f"{name} is a relative change, and the rope has none", got=0.0, fix=fix)
        self.of_rope = [k for k, name in enumerate(self.names) if name in ROPE_KINDS]
        self.dynamic = [k for k, name in enumerate(self.names) if k in self.of_rope or (name == "delay" and moved)]
        kinds = [kind(name) or Kind("", 0.0) for name in self.names]
        self._least, self._most = np.array([each.least for each in kinds]), np.array([each.most for each in kinds])
        if "tip_mass" in self.names:
            self._least[self.names.index("tip_mass")] = -rope.tip_mass
        self._camera: tuple[tuple[float, ...], Camera] | None = None

    def __len__(self) -> int:
        """Number of parameters."""
        return len(self.names)

    def value(self, name: str, values: Array) -> float:
        """Return one parameter's value; 0 if it is not estimated."""
        return float(values[self.names.index(name)]) if name in self.names else 0.0

    def least(self, values: Array) -> Array:
        """Return the standard deviations (P,) that a covariance omits, > 0, for values (P,)."""
        first = np.where(self.std > 0.0, self.std, np.abs(values))  # for a noticed change: its size
        return NEGLIGIBLE * np.where(first > 0.0, first, 1.0)

    def estimates(self, x: Array, rows: Array) -> dict[str, tuple[float, float]]:
        """Return value and standard deviation of each parameter that is not fixed.

        Parameters
        ----------
        x : (N,) float64
            State, with the parameters at its end.
        rows : (r, N) float64
            Rows whose squares are its covariance.
        """
        values, std = np.split(x, [x.size - len(self)])[1], np.linalg.norm(rows[:, x.size - len(self) :], axis=0)
        free = (self.std > 0.0) | (values != 0.0) | (std > 0.0)
        stated = np.hypot(std, self.least(values))
        return {self.names[k]: (float(values[k]), float(stated[k])) for k in np.flatnonzero(free)}

    def directions(self) -> list[str | dict[str, dict[str, Array]]]:
        """Return what one unit of each dynamic parameter changes, as ``sensitivities`` takes it."""
        rope = self.rope
        changes = {
            "length": {"length": rope.length, "com": rope.com, "inertia": 2.0 * rope.inertia},
            "friction": {"friction": rope.friction},
            "first_joint_friction": {"friction": _first(rope.friction)},
            "drag": {"drag": rope.drag},
            "tip_mass": {"tip_mass": np.ones(1)},
        }
        names = [self.names[k] for k in self.dynamic]
        return ["motion.delay" if name == "delay" else {name: changes[name]} for name in names]

    def rope_at(self, values: Array) -> Rope:
        """Return the rope that the values (P,) describe."""
        rope, at = self.rope, functools.partial(self.value, values=values)
        longer, first = 1.0 + at("length"), at("first_joint_friction") * _first(rope.friction)
        return rope.replace(
            length=rope.length * longer,
            com=rope.com * longer,
            inertia=rope.inertia * longer**2,
            friction=np.maximum(rope.friction * (1.0 + at("friction")) + first, 0.0),
            drag=rope.drag * (1.0 + at("drag")),
            tip_mass=rope.tip_mass + at("tip_mass"),
        )

    def camera_at(self, camera: Camera, values: Array) -> Camera:
        """Return the camera with the swing plane as values (P,) describe it."""
        scale, roll, x, y = found = tuple(self.value(name, values) for name in PLANE_KINDS)
        if not any(found):
            return camera
        if self._camera is None or self._camera[0] != found:
            self._camera = found, camera.adjusted(1.0 + scale, roll, (x, y))
        return self._camera[1]

    def base_offset(self, values: Array) -> Array:
        """Return where the first joint is (2,), m, from its declared place, at values (P,)."""
        return np.array([self.value(name, values) for name in BASE_KINDS])

    def arc_lengths(self, arc_lengths: Array, values: Array) -> Array:
        """Return the arc lengths of the markers (K,), m, at values (P,); `arc_lengths` are those at 0."""
        moved = [self.value(f"arc[{k}]", values) for k in range(len(arc_lengths))]
        return arc_lengths * (1.0 + self.value("length", values)) + moved

    def possible(self, values: Array) -> Array:
        """Return the values (P,), limited to what a rope can have."""
        return np.clip(values, self._least, self._most)
