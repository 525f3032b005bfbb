"""Held properties of the rope: masses, lengths, bend at rest, and the places of markers."""

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.held import HeldQuantity, free_names, many_links
from hyperflex.identification.findings import Kind
from hyperflex.identification.model import Plant
from hyperflex.sensors import Markers

TAPER, CURL, ARCS = "mass:taper", "rest_angle:shared", "arc"


def _masses(plant: Plant, angles: bool) -> list[str]:
    words = ["tip_mass"] if many_links(plant) else ["mass", "com", "inertia"]
    return [word for word in words if word not in free_names(plant)]


def _lengths(plant: Plant, angles: bool) -> list[str]:
    some = plant.parameters.guess.n_links > 1 and not many_links(plant)
    return ["length"] if some and free_names(plant).isdisjoint({"length", "com", "inertia"}) else []


def _taper(plant: Plant, angles: bool) -> list[str]:
    return [TAPER] if many_links(plant) and "mass" not in free_names(plant) else []


def _bend(plant: Plant, angles: bool) -> list[str]:
    names, rope = free_names(plant), plant.parameters.guess
    springy = "stiffness" in names or bool(rope.stiffness.any())
    return [CURL] if many_links(plant) and springy and "rest_angle" not in names else []


def _markers(plant: Plant, angles: bool) -> list[str]:
    return [ARCS] if isinstance(plant.sensor, Markers) and free_names(plant).isdisjoint({ARCS, "length"}) else []


def _named(name: str, values: Array) -> dict[str, object]:
    return {"name": f"'{name}'", "values": [float(each) for each in values]}


HELD = HeldQuantity(Kind.HELD, _masses, _named)
LENGTH = HeldQuantity(Kind.HELD, _lengths, _named, apart=True)
MASS_TAPER = HeldQuantity(Kind.MASS_TAPER, _taper, lambda name, values: {"factor": float(np.exp(values[0]))}, TAPER)
REST_BEND = HeldQuantity(Kind.REST_BEND, _bend, lambda name, values: {"angle": float(values[0])}, CURL, reported=True)
MARKER_PLACES = HeldQuantity(
    Kind.MARKER_PLACES,
    _markers,
    lambda name, values: {"places": [1e3 * float(each) for each in values]},
    ARCS,
    reported=True,
)
