"""Arm motions: piecewise polynomials of time with their switching times."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.motion.piecewise import Motion, lagged
    from hyperflex.motion.profiles import (
        BANG_BANG,
        PATHS,
        PROFILES,
        Profile,
        arm_moves,
        arm_strokes,
        arm_swings,
        hold_arm,
        motion_derivatives,
        motion_parameters,
        move_arm,
        moving_pivot,
        sampled_motion,
        torque_profile,
    )
    from hyperflex.motion.tables import MOVES, from_spec, motion_keys, read_motion, to_spec

__getattr__, __dir__, __all__ = attach(__name__, __file__)
