"""Arm motions: piecewise polynomials of time with their switching times."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.motion.piecewise import Motion, lagged
    from hyperflex.motion.profiles import (
        MOVES,
        TINY,
        Profile,
        arm_moves,
        arm_strokes,
        arm_swings,
        from_spec,
        hold_arm,
        motion_derivatives,
        motion_keys,
        motion_parameters,
        move_arm,
        moving_pivot,
        read_motion,
        sampled_motion,
        to_spec,
        torque_profile,
        vibrate_arm,
        vibrating_pivot,
    )

__getattr__, __dir__, __all__ = attach(__name__, __file__)
