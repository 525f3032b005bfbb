"""The demo's video: a simulated rope with finer links than the fitted one, filmed by a synthetic camera."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hyperflex import files
from hyperflex.checks import Array
from hyperflex.estimate import MarkerMeasurement, RopeFilter, RopeTracker, VideoTrack, track_video
from hyperflex.identification import FitOptions, Identification, identify
from hyperflex.model import Rope, divided
from hyperflex.recording import Recording
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory
from hyperflex.vision import (
    Camera,
    MarkerColour,
    MarkerDetector,
    Renderer,
    RopeMotion,
    Scene,
    Truth,
    VideoReader,
    frame_times,
    random_occlusion,
)

LENGTH, FINE, COARSE = 2.0, 40, 10  # m; links of the rope that made the data, and of the one that is fitted
ARC_LENGTHS = LENGTH * np.arange(1, COARSE + 1) / COARSE  # m, of the markers: at the joints of the coarse chain
RATE, SECONDS = 30.0, 10.0  # Hz, s: frames and length of the video
FREE = ("friction:shared", "inertia:shared")
BUNDLED = Path(__file__).parent / "data" / "demo_swing.mp4"
MAPPED = Path(__file__).parent / "data" / "demo_mapped.toml"


def coarse_rope() -> Rope:
    """Return the rope divided into 10 links, with the mass and the radius of the paper's cable.

    Friction times link length, 1e-4 N m^2 s, lies between the paper's cable and its other rope.
    """
    friction = 1e-4 * COARSE / LENGTH
    return Rope.uniform(LENGTH, 0.125, COARSE, 0.0025, friction=friction, name=f"demo rope, {COARSE} links")


def fine_rope() -> Rope:
    """Return the rope that generates the data: the coarse one with links of a quarter of the length."""
    return divided(coarse_rope(), FINE // COARSE)


def guess() -> Rope:
    """Return the first guess of the demo: right length and mass, three times the friction."""
    rope = coarse_rope()
    return rope.replace(friction=3.0 * rope.friction, name="demo guess")


def camera() -> Camera:
    """Return the synthetic camera: level, at a right angle to the swing plane, with the first joint at the origin."""
    return Camera.facing((960, 560), pixels_per_metre=220.0, origin=(480.0, 60.0), exposure=0.004)


def swing(t: Array) -> Trajectory:
    """Simulate the fine rope's free swing, with outputs at times t (T,), s."""
    along = (np.arange(FINE) + 0.5) / FINE
    return simulate(fine_rope(), duration=t[-1], t_eval=t, q0=0.9 + 0.5 * along, tol=1e-9)


def film(path: Path, seconds: float = SECONDS) -> Truth:
    """Render the swing as a video: markers in front of a wall with clutter, light that drifts, noise.

    3 % of the markers are covered, for 0.3 s at a time.
    """
    run = swing(np.arange(0.0, seconds + 0.1, 2e-3))
    scene = Scene(
        ARC_LENGTHS,
        marker_diameter=0.03,
        clutter=3,
        light_drift=0.1,
        noise=1.5,
        hidden=random_occlusion(COARSE, 0.03, 0.3, until=seconds, seed=2007),
        seed=2007,
    )
    motion = RopeMotion(run.t, run.q, run.qd, fine_rope().length)
    return Renderer(camera(), motion, scene).write(path, frame_times(0.0, seconds, RATE), quality=24)


def track(
    video: Path = BUNDLED, preview: Path | None = None, progress: Callable[[int], None] | None = None
) -> VideoTrack:
    """Track the markers of the video with the rope of the first guess."""
    with VideoReader(video) as reader:
        first = next(iter(reader)).image
    estimator = RopeFilter(guess(), ARC_LENGTHS, camera=camera())
    tracker = RopeTracker(estimator, MarkerMeasurement(MarkerDetector(MarkerColour.from_frame(first))))
    return track_video(video, tracker, preview=preview, progress=progress)


def recording(found: VideoTrack) -> Recording:
    """Return the tracked markers at all joints of the coarse chain; the first joint is the camera's origin."""
    seen = found.recording
    noise = np.asarray(seen.noise)
    return Recording(
        seen.t,
        np.column_stack([np.zeros((seen.t.size, 2)), seen.data]),
        kind="markers",
        noise=np.column_stack([np.full((seen.t.size, 2), np.median(noise)), noise]),
        name="demo swing (simulated)",
        source=f"simulated: {FINE} links, filmed by a synthetic camera with {RATE:g} frames/s and tracked",
    )


def exact() -> Recording:
    """Return the joints of the coarse chain in the same swing, without a camera."""
    run = swing(np.arange(round(SECONDS * RATE) + 1) / RATE)
    return Recording(run.t, run.joints[:, :: FINE // COARSE].reshape(run.t.size, -1), kind="markers")


def fit(recording: Recording, progress: bool | Callable[[dict[str, float]], None] = False) -> Identification:
    """Identify friction and inertia of the 10-link chain from the first 7 s of a recording, as in the demo."""
    return identify(recording, guess(), FREE, options=FitOptions(train=7.0, window=3.5), progress=progress)


def mapped_truth() -> dict[str, float]:
    """Read the result of the fit without noise: one friction and one inertia for all links, SI."""
    return {name: float(value) for name, value in files.read_toml(MAPPED)["mapped"].items()}
