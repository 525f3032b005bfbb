"""A free swing of a finer rope, filmed: 8 markers, 5 mm a pixel, 30 frames a second."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.vision import Camera, Renderer, RopeMotion, Scene, Truth
from tests.estimate.runs import free_swing

ARCS = np.linspace(0.25, 2.0, 8)  # m
COUNT = 30  # frames


def facing(size: tuple[int, int] = (640, 480), scale: float = 200.0, **other: object) -> Camera:
    """What films it, looking at the swing plane straight on; the origin is in the middle, at the top."""
    origin = (0.5 * size[0], 20.0)
    return Camera.facing(size, pixels_per_metre=scale, origin=origin, **{"exposure": 0.004, **other})


def film_swing(
    path: Path,
    camera: Camera | None = None,
    seed: int = 0,
    count: int = COUNT,
    late: Array | float = 0.0,
    **scene: npt.ArrayLike,
) -> Truth:
    """Write the video, its frames as much later as given, s; return the truth."""
    motion = RopeMotion.from_trajectory(free_swing(seed, 4.0))
    renderer = Renderer(camera or facing(), motion, Scene(ARCS, marker_diameter=0.035, **scene))
    return renderer.write(path, 0.05 + np.arange(count) / 30.0 + late)
