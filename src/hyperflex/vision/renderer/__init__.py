"""A synthetic camera: pictures of a simulated rope, with the truth beside them, for tests and examples."""

from __future__ import annotations

from hyperflex.vision.renderer.motion import RopeMotion, sway
from hyperflex.vision.renderer.renderer import Renderer, frame_times
from hyperflex.vision.renderer.scene import Bar, Occluder, Scene, random_occlusion
from hyperflex.vision.renderer.truth import Truth

__all__ = ["Bar", "Occluder", "Renderer", "RopeMotion", "Scene", "Truth", "frame_times", "random_occlusion", "sway"]
