"""The zero and the scale of the angles."""

import numpy as np

from hyperflex.identification.declarations.held import HeldQuantity, free_names
from hyperflex.identification.findings import Kind
from hyperflex.identification.model import ANGLES, Plant


def _heavy(plant: Plant) -> bool:
    return bool(np.any(plant.parameters.guess.gravity))


def _zero(plant: Plant, angles: bool) -> list[str]:
    return ["gravity_angle"] if _heavy(plant) and "gravity_angle" not in free_names(plant) else []


def _scale(plant: Plant, angles: bool) -> list[str]:
    return [ANGLES] if angles and _heavy(plant) else []


ZERO = HeldQuantity(
    Kind.ZERO,
    _zero,
    lambda name, values: {"angle": float(values[0])},
    name="gravity_angle",
    declared=True,
    reported=True,
    enough=0.03,  # rad, of gravity: 1.7 degrees, more than a camera that was levelled by eye is off
)
ANGLE_SCALE = HeldQuantity(
    Kind.ANGLE_SCALE,
    _scale,
    lambda name, values: {"factor": 1.0 / float(values[0])},
    name=ANGLES,
    factor=True,
    declared=True,
    farthest=2.0,  # beyond, something else is wrong
    enough=0.02,  # encoders are better
)
