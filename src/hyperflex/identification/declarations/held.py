"""Quantities that a fit does not free, or that were declared: one object for each that the data may contradict.

To add a quantity, write its object and list it in HELD. Its kind of finding, with the text, goes to findings.py.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.findings import Kind
from hyperflex.identification.model import ANGLES, LED, Plant
from hyperflex.model import DAMPING, PROPERTIES, RESISTANCES
from hyperflex.sensors import Markers

FEW_LINKS = 4  # links, up to which each has its own value in a test: of more, values of neighbours act alike
LAWS = tuple(each.name for each in RESISTANCES)
CLOCK = "gravity_scale"  # what a wrong clock, or wrong lengths, move: times x a and lengths x a^2 act alike
SCALES = "scales"  # factors on the links' lengths, on gravity, which a clock makes, the arm's length and the torque
DRIFT = "clock_drift"
LINKS = "links"
INNER = "stiffness:inner"  # springs in all joints but the first, as in an elastic rope that hangs on a hinge


def _many(plant: Plant) -> bool:
    """Whether the rope has so many links that they are tested together."""
    return plant.parameters.guess.n_links > FEW_LINKS


def _heavy(plant: Plant, word: str) -> bool:
    """Whether gravity acts."""
    return bool(plant.parameters.guess.gravity.any())


def _one(key: str, change: Callable[[Any], Any] = float) -> Callable[[str, Array], dict[str, Any]]:
    return lambda name, values: {key: float(change(values[0]))}


def _named(name: str, values: Array) -> dict[str, Any]:
    return {"name": f"'{name}'", "values": values.tolist(), "unit": PROPERTIES[base(name)].unit}


@dataclass(frozen=True)
class HeldQuantity:
    """A quantity that is fixed in a fit and that the data may contradict.

    Attributes
    ----------
    kind : Kind
        Of its finding.
    words : tuple of str
        What a fit frees to test it, as in ``free``: a test each, with this name.
    applies : callable
        Return whether a word is to be tested, for the model of a fit in which its property is not free.
    values : callable
        Returns the values of its finding from a test's name and values.
    factor : bool
        Whether its value is a factor.
    declared : bool
        Whether it is a declaration of the recording, not a property of the rope.
    farthest : float
        Factor beyond which something else is wrong.
    enough : float
        Size from which it matters whatever the ratios do: of the logarithm of a factor, or of the value itself.
    slight : float
        The same, up to which it does not matter: instruments err by so much.
    reported : bool
        Whether it is reported with its value as soon as it is significant.
    apart : bool
        Whether it is tested in a separate linearisation: it acts much as others do.
    """

    kind: Kind
    words: tuple[str, ...]
    applies: Callable[[Plant, str], bool]
    values: Callable[[str, Array], dict[str, Any]] = _named
    factor: bool = False
    declared: bool = False
    farthest: float = np.inf
    enough: float = np.inf
    slight: float = 0.0
    reported: bool = False
    apart: bool = False

    def tested(self, plant: Plant) -> list[str]:
        """Return the words to test; of what is free only growth along the rope is tested."""
        free = set() if self.kind is Kind.UNEVEN_RESISTANCE else plant.parameters.names
        return [word for word in self.words if base(word) not in free and self.applies(plant, word)]

    @property
    def of_rope(self) -> bool:
        """Whether it is a property of the rope that is not reported as soon as it is significant."""
        return not (self.reported or self.declared or self.kind is Kind.DRIFT)

    def size(self, value: float) -> float:
        """Return how far a value is from what was held: the logarithm of a factor, or the value."""
        return abs(float(np.log(max(value, 1e-9)))) if self.factor else abs(value)


def base(word: str) -> str:
    """Return the property of a word such as ``friction[0]`` or ``friction:shared``."""
    return word.partition("[")[0].partition(":")[0]


def as_free(names: Sequence[str]) -> list[str]:
    """Return names of tests as entries of ``free``, where "pivot" is the first joint's own."""
    return [f"'{name.replace(':pivot', '[0]')}'" for name in names]


def _clock(name: str, values: Array) -> dict[str, Any]:
    scale = max(float(values[0]), 1e-9)
    return {"scale": scale, "clock": float(np.sqrt(scale))}


def _left_out(plant: Plant, word: str) -> bool:
    many = _many(plant)
    return many and not plant.parameters.guess.stiffness.any() if word == INNER else many == word.endswith(":shared")


def _along(plant: Plant, word: str) -> bool:
    """Whether a resistance may differ along the rope that is one value, or one factor, of all links.

    The first joint often is a bearing, the others are none. Two joints differ by that alone.
    """
    labels, n, (name, _, law) = plant.parameters.labels, plant.parameters.guess.n_links, word.partition(":")
    alike = not {f"{name}:shared", f"{name}:factor"}.isdisjoint(labels) and word not in labels
    return alike and n > 1 and (law == "pivot" or n > 2 or name == "drag")


def _uneven(name: str, values: Array) -> dict[str, Any]:
    name, _, law = name.partition(":")
    shown, one = {"name": name.replace("_", " ")}, float(values[0])
    if law == "pivot":
        words = [f"'{name}[0]'", f"'{name}:inner'"]
        return shown | {"factor": one, "where": "first joint as at the others", "words": words}
    words = [f"'{name}:factor'", f"'{name}:taper'"]
    return shown | {"factor": float(np.exp(one)), "where": "tip as at the first joint", "words": words}


MASSES = HeldQuantity(
    Kind.HELD,
    ("tip_mass", "mass", *LED),
    # com and inertia follow a free length: with a value of their own they would not
    lambda plant, word: (
        _many(plant) == (word == "tip_mass") and not (word in LED and "length" in plant.parameters.names)
    ),
)
HELD: tuple[HeldQuantity, ...] = (
    HeldQuantity(
        Kind.ZERO,
        ("gravity_angle",),
        _heavy,
        _one("angle"),
        declared=True,
        reported=True,
        enough=0.03,  # rad, of gravity: 1.7 degrees, more than a camera that was levelled by eye is off
    ),
    HeldQuantity(
        Kind.CLOCK,
        (CLOCK,),
        _heavy,
        _clock,
        factor=True,
        declared=True,
        farthest=6.0,  # a frame rate off by two makes gravity four times as large; beyond, something else is wrong
        slight=0.01,  # relative, of lengths: rulers err by so much; a triple pendulum seems 0.0067 off with drag free
    ),
    HeldQuantity(
        Kind.ANGLE_SCALE,
        (ANGLES,),
        lambda plant, word: plant.angles and _heavy(plant, word),
        _one("factor", lambda factor: 1.0 / factor),
        factor=True,
        declared=True,
        farthest=2.0,  # beyond, something else is wrong
        enough=0.02,  # encoders are better
    ),
    HeldQuantity(
        Kind.DELAY,
        ("delay",),
        lambda plant, word: plant.driven,
        _one("delay"),
        declared=True,
        reported=True,
    ),
    *(
        HeldQuantity(kind, (word,), lambda plant, word: plant.motor is not None, _one("value"), reported=True)
        for kind, word in ((Kind.ARM_INERTIA, "arm_inertia"), (Kind.ARM_FRICTION, "arm_friction"))
    ),
    HeldQuantity(Kind.RESISTANCE, (*LAWS, *(f"{name}:shared" for name in LAWS), INNER), _left_out),
    HeldQuantity(
        Kind.UNEVEN_RESISTANCE,
        tuple(f"{name}:{law}" for name in DAMPING for law in ("pivot", "taper") if (name, law) != ("drag", "pivot")),
        _along,
        _uneven,
    ),
    MASSES,
    HeldQuantity(Kind.MASS_TAPER, ("mass:taper",), lambda plant, word: _many(plant), _one("factor", np.exp)),
    HeldQuantity(
        Kind.REST_BEND,
        ("rest_angle:shared",),
        lambda plant, word: (
            _many(plant) and ("stiffness" in plant.parameters.names or bool(plant.parameters.guess.stiffness.any()))
        ),
        _one("angle"),
        reported=True,
    ),
    HeldQuantity(
        Kind.MARKER_PLACES,
        ("arc",),
        lambda plant, word: isinstance(plant.sensor, Markers) and "length" not in plant.parameters.names,
        lambda name, values: {"places": (1e3 * values).tolist()},
        reported=True,
    ),
    HeldQuantity(
        Kind.HELD,
        ("origin_x", "origin_y"),
        lambda plant, word: isinstance(plant.sensor, Markers),
        declared=True,
        reported=True,
    ),
    HeldQuantity(
        Kind.HELD,
        ("length",),
        lambda plant, word: (
            plant.parameters.guess.n_links > 1 and not _many(plant) and plant.parameters.names.isdisjoint(LED)
        ),
        apart=True,
    ),
    # tested by the scores of the windows
    HeldQuantity(Kind.DRIFT, (DRIFT,), lambda plant, word: False, _one("drift", lambda drift: 0.5 * abs(drift))),
)
QUANTITIES = {word: each for each in HELD for word in each.words}


def words_for_tests(plant: Plant) -> list[list[str]]:
    """Return words for what is held, those that are tested in one linearisation together."""
    together = [word for each in HELD if not each.apart for word in each.tested(plant)]
    return [together, *(words for each in HELD if each.apart and (words := each.tested(plant)))]
