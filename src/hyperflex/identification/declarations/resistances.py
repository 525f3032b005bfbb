"""Resistances that were left out, and those that are fitted as alike along the rope and differ."""

from collections.abc import Sequence

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.held import HeldQuantity, free_names, many_links
from hyperflex.identification.findings import Kind
from hyperflex.identification.model import Parameters, Plant
from hyperflex.model import DAMPING, RESISTANCES

INNER = "stiffness:inner"  # springs in all joints but the first, as in an elastic rope that hangs on a hinge
LARGEST = 3.0  # logarithm of a factor, as far as it counts: 20 times; to first order it may be any number


def _left_out(plant: Plant, angles: bool) -> list[str]:
    names, many = free_names(plant), many_links(plant)
    words = [each.name + (":shared" if many else "") for each in RESISTANCES if each.name not in names]
    return words + [INNER] * (many and "stiffness" not in names and not plant.parameters.guess.stiffness.any())


def _along(plant: Plant, angles: bool) -> list[str]:
    """Return by what a resistance may differ along the rope that is one value, or one factor, of all links.

    The first joint often is a bearing, the others are none. Two joints differ by that alone.
    """
    labels, n = set(plant.parameters.labels), plant.parameters.guess.n_links
    words = []
    for name in DAMPING:
        if n > 1 and labels & {f"{name}:shared", f"{name}:factor"}:
            words += [f"{name}:pivot"] * (name != "drag")
            words += [f"{name}:taper"] * (n > 2 or name == "drag")
    return [word for word in words if word not in labels]


def _uneven_values(name: str, values: Array) -> dict[str, object]:
    property_, _, law = name.partition(":")
    own = {"name": property_.replace("_", " ")}
    if law == "pivot":
        words = [f"'{property_}[0]'", f"'{property_}:inner'"]
        return own | {"factor": float(values[0]), "where": "first joint as at the others", "words": words}
    words = [f"'{property_}:factor'", f"'{property_}:taper'"]
    return own | {"factor": float(np.exp(values[0])), "where": "tip as at the first joint", "words": words}


RESISTANCE = HeldQuantity(
    Kind.RESISTANCE, _left_out, lambda name, values: {"name": f"'{name}'", "values": [float(each) for each in values]}
)
UNEVEN = HeldQuantity(Kind.UNEVEN_RESISTANCE, _along, _uneven_values)


def is_uneven(name: str) -> bool:
    """Whether a test is of the growth of a resistance along the rope, or of the first joint's own."""
    base, _, law = name.partition(":")
    return law in ("taper", "pivot") and base in DAMPING


def uneven_shift(name: str, values: Array, shift: Array, parameters: Parameters, x: Array) -> Array:
    """Return the `shift` of a test at x (P,); of what is one value of all links as far as the farthest link's is off.

    A resistance that differs along the rope changes what is alike in the fit, and each link's own in addition.
    """
    if not is_uneven(name) or not shift.size:
        return shift
    base, _, law = name.partition(":")
    size = np.log(max(float(values[0]), 1e-9)) if law == "pivot" else float(values[0])
    steps = np.clip(size, -LARGEST, LARGEST) * parameters.shape(law)
    shift = shift.copy()
    for k, each in enumerate(parameters.all):
        if each.name == base and each.law in ("own", "factor") and len(each.links) == steps.size:
            moved = x[k] + shift[k]
            off = moved + steps - x[k] if each.form == "log" else moved * np.exp(steps) - x[k]
            shift[k] = off[np.argmax(np.abs(off))]
    return shift


def as_free(names: Sequence[str]) -> list[str]:
    """Return names of tests as entries of ``free``, where "pivot" is the first joint's own."""
    return [f"'{name.replace(':pivot', '[0]')}'" for name in names]
