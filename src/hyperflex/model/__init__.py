"""The model: rope, arm, obstacles and set-up, validated and in TOML."""

from typing import TYPE_CHECKING

from hyperflex.lazy import attach

if TYPE_CHECKING:
    from hyperflex.model.arm import Arm
    from hyperflex.model.obstacles import Ground, Obstacle, Peg, Wall, round_places
    from hyperflex.model.refine import cuts, divided, refine_rope
    from hyperflex.model.rope import FRICTION_MODELS, GRAVITY, Rope
    from hyperflex.model.setup import DEFAULT_CONTACT_STEP, DEFAULT_TOL, METHODS, PLAN, Setup

__getattr__, __dir__, __all__ = attach(__name__, __file__)
