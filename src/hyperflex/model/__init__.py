"""The model: rope, arm, obstacles and set-up, validated and in TOML."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.model.arm import Arm
    from hyperflex.model.motor_limits import MotorLimits
    from hyperflex.model.obstacles import (
        Ground,
        Obstacle,
        Peg,
        Placed,
        Wall,
        checked_obstacles,
        gap_of,
        named,
        obstacle_gaps,
        obstacle_tables,
        obstacles_of,
        round_places,
    )
    from hyperflex.model.properties import (
        DAMPING,
        FREE_PROPERTIES,
        LINK_PROPERTIES,
        PROPERTIES,
        RATIOS,
        RESISTANCES,
        Form,
        Label,
        Property,
        parse_label,
    )
    from hyperflex.model.refine import FINE, cuts, divided, refine_rope, stretched, with_links
    from hyperflex.model.rope import (
        MOST_LINKS,
        Rope,
        swing_rate,
        unit_across,
        unit_along,
        warn_of_grade,
    )
    from hyperflex.model.setup import (
        DEFAULT_CONTACT_STEP,
        DEFAULT_TOL,
        PLAN,
        PLANNING,
        Control,
        Setup,
        SetupFields,
        check_tables,
    )

__getattr__, __dir__, __all__ = attach(__name__, __file__)
