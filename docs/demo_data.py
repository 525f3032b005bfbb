"""Write the data files of the demo, the video and the fit without noise: ``python docs/demo_data.py``.

The fit uses the same swing without a camera: the best approximation of a rope of 40 links by 10. It differs from the
rope divided into 10 links, because coarse links need more inertia and friction for the same motion.
"""

from pathlib import Path

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.demo import twin
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory
from hyperflex.vision import Renderer, RopeMotion, Scene, Truth, frame_times, random_occlusion

SECONDS = 10.0  # s, of the video


def swing(t: Array) -> Trajectory:
    """Simulate the fine rope's free swing, with outputs at times t (T,), s."""
    along = (np.arange(twin.FINE) + 0.5) / twin.FINE
    return simulate(twin.fine_rope(), duration=t[-1], t_eval=t, q0=0.9 + 0.5 * along, tol=1e-9)


def film(path: Path, seconds: float = SECONDS) -> Truth:
    """Render the swing as a video: markers in front of a wall with clutter, light that drifts, noise.

    3 % of the markers are covered, for 0.3 s at a time.
    """
    run = swing(np.arange(0.0, seconds + 0.1, 2e-3))
    scene = Scene(
        twin.ARC_LENGTHS,
        marker_diameter=0.03,
        clutter=3,
        light_drift=0.1,
        noise=1.5,
        hidden=random_occlusion(twin.COARSE, 0.03, 0.3, until=seconds, seed=2007),
        seed=2007,
    )
    motion = RopeMotion(run.t, run.q, run.qd, twin.fine_rope().length)
    return Renderer(twin.camera(), motion, scene).write(path, frame_times(0.0, seconds, twin.RATE), quality=24)


def exact() -> Recording:
    """Return the joints of the coarse chain in the same swing, without a camera."""
    run = swing(np.arange(round(SECONDS * twin.RATE) + 1) / twin.RATE)
    return Recording(run.t, run.joints[:, :: twin.FINE // twin.COARSE].reshape(run.t.size, -1), kind="markers")


def main() -> None:
    """Film the swing, and fit it."""
    film(twin.BUNDLED)
    mapped = {name: float(values[0]) for name, values in twin.fit(exact()).values.items()}
    about = "what the demo's fit finds without a camera; made by docs/demo_data.py"
    files.write_toml(twin.MAPPED, {"source": "simulated", "about": about, "mapped": mapped})


if __name__ == "__main__":
    main()
