"""Arm motions: piecewise polynomials of time with their switching times."""

from hyperflex.motion.lag import lagged
from hyperflex.motion.piecewise import Motion
from hyperflex.motion.profiles import (
    PATHS,
    PROFILES,
    Profile,
    arm_swings,
    hold_arm,
    move_arm,
    moving_pivot,
    sampled_motion,
    torque_profile,
)
from hyperflex.motion.sequence import arm_moves, arm_strokes
from hyperflex.motion.tables import from_spec, read_motion, to_spec

__all__ = [
    "PATHS",
    "PROFILES",
    "Motion",
    "Profile",
    "arm_moves",
    "arm_strokes",
    "arm_swings",
    "from_spec",
    "hold_arm",
    "lagged",
    "move_arm",
    "moving_pivot",
    "read_motion",
    "sampled_motion",
    "to_spec",
    "torque_profile",
]
