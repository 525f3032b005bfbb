"""The model: rope, arm, obstacles and set-up, validated and in TOML."""

from hyperflex.model.arm import Arm
from hyperflex.model.obstacles import Obstacle, round_places
from hyperflex.model.peg import Peg
from hyperflex.model.refine import cuts, divided, refine_rope
from hyperflex.model.rope import FRICTION_MODELS, GRAVITY, Rope
from hyperflex.model.setup import DEFAULT_CONTACT_STEP, DEFAULT_TOL, METHODS, PLAN, Setup
from hyperflex.model.wall import Ground, Wall

__all__ = [
    "DEFAULT_CONTACT_STEP",
    "DEFAULT_TOL",
    "FRICTION_MODELS",
    "GRAVITY",
    "METHODS",
    "PLAN",
    "Arm",
    "Ground",
    "Obstacle",
    "Peg",
    "Rope",
    "Setup",
    "Wall",
    "cuts",
    "divided",
    "refine_rope",
    "round_places",
]
