"""Arm motions: piecewise polynomials of time, each with the instants at which its acceleration jumps."""

from hyperflex.motion.half_turns import strokes
from hyperflex.motion.lag import lagged
from hyperflex.motion.piecewise import Motion
from hyperflex.motion.profiles import (
    PATHS,
    PROFILES,
    Profile,
    hold,
    move,
    moving_point,
    sampled,
    swings,
    torque_profile,
)
from hyperflex.motion.sequence import moves
from hyperflex.motion.tables import from_spec, read_motion, to_spec

__all__ = [
    "PATHS",
    "PROFILES",
    "Motion",
    "Profile",
    "from_spec",
    "hold",
    "lagged",
    "move",
    "moves",
    "moving_point",
    "read_motion",
    "sampled",
    "strokes",
    "swings",
    "to_spec",
    "torque_profile",
]
