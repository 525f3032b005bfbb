"""Arm motions: piecewise polynomials of time with their switching times."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
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
    from hyperflex.motion.sequence import BANG_BANG, arm_moves, arm_strokes
    from hyperflex.motion.tables import MOVES, from_spec, motion_keys, read_motion, to_spec
    from hyperflex.motion.variation import motion_derivatives, motion_parameters

__getattr__, __dir__, __all__ = attach(__name__, __file__)
