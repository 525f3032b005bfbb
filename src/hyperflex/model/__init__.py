"""What is simulated: rope, arm and set-up; frozen, validated, in and out of TOML."""

from hyperflex.model.arm import Arm
from hyperflex.model.rope import FRICTION_MODELS, GRAVITY, Rope
from hyperflex.model.setup import DEFAULT_TOL, METHODS, Setup

__all__ = ["DEFAULT_TOL", "FRICTION_MODELS", "GRAVITY", "METHODS", "Arm", "Rope", "Setup"]
