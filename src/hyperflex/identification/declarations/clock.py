"""The clock and the lengths: gravity's scale tells of both, since times x a and lengths x a^2 move alike."""

import numpy as np

from hyperflex.checks import Array
from hyperflex.identification.declarations.held import HeldQuantity, free_names
from hyperflex.identification.findings import Kind
from hyperflex.identification.model import Plant

SCALES = "scales"  # factors on the links' lengths, on gravity, which a clock makes, the arm's length and the torque
DRIFT = "clock_drift"


def _words(plant: Plant, angles: bool) -> list[str]:
    heavy = bool(np.any(plant.parameters.guess.gravity))
    return ["gravity_scale"] if heavy and "gravity_scale" not in free_names(plant) else []


def _values(name: str, values: Array) -> dict[str, float]:
    scale = max(float(values[0]), 1e-9)
    return {"scale": scale, "clock": float(np.sqrt(scale))}


CLOCK = HeldQuantity(
    Kind.CLOCK,
    _words,
    _values,
    name="gravity_scale",
    factor=True,
    declared=True,
    farthest=6.0,  # a frame rate off by two makes gravity four times as large; beyond, something else is wrong
    slight=0.01,  # relative, of lengths: rulers err by so much; a triple pendulum seems 0.0067 off with drag free
)
CLOCK_DRIFT = HeldQuantity(
    Kind.DRIFT, lambda plant, angles: [], lambda name, values: {"drift": 0.5 * abs(float(values[0]))}, name=DRIFT
)
