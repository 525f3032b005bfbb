"""The period of a rope's small swing."""

import math

import numpy as np

from hyperflex.errors import InvalidInput
from hyperflex.model import Rope


def swing_period(rope: Rope) -> float:
    """Return the period of a small swing of a rope as a rigid rod, s; that of the rope itself is 2 % longer.

    Raises InvalidInput if the rope has no weight.
    """
    base = np.concatenate([[0.0], np.cumsum(rope.length)[:-1]])
    centre = base + rope.com
    moment = float((rope.inertia + rope.mass * centre**2).sum() + rope.tip_mass * rope.total_length**2)
    first = float((rope.mass * centre).sum() + rope.tip_mass * rope.total_length)
    weight = first * math.hypot(*rope.gravity)
    if weight == 0.0:
        raise InvalidInput("rope has no weight, so it does not swing", got=rope.gravity, allowed="gravity")
    return 2.0 * math.pi * math.sqrt(moment / weight)
