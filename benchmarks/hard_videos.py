"""Difficult rendered videos of a finer rope in a pumped cast, and the results of a tracker with 50 links."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.estimate import MarkerMeasurement, RopeFilter, RopeTracker
from hyperflex.vision import (
    Camera,
    Frame,
    MarkerColour,
    MarkerDetector,
    Occluder,
    Renderer,
    RopeMotion,
    Scene,
    Truth,
    random_occlusion,
)
from tests.estimate.runs import ARM, FINE, LENGTH, RATE, SWINGS, rope, tip_of

MARKERS, DIAMETER = 10, 0.04  # m
RED = (40.0, 30.0, 210.0)  # blue, green, red
FRAME, EXPOSURE, BLACK = 1.0 / 30.0, 0.01, 0.5  # s
LATE, SINCE = 0.1, 1.0  # s after the blackout, and after the first frame
NINETY = float(stats.chi2.ppf(0.9, 2))


@dataclass(frozen=True, eq=False)
class HardVideo:
    """A cast as the renderer sees it.

    The rope hangs nearly at rest, is pumped up by the paper's swings to 15 m/s and more at the tip, and seen at 1280 x
    720, 30 frames/s and 1/100 s of exposure. Markers are covered at random, 0.2 s at a stretch; there are twelve discs
    as large and as red as they are, eight other things on the wall, a drifting light, and a blackout.
    """

    seed: int = 0
    start: float = 0.05  # s
    end: float = 12.0  # s
    occluded: float = 0.3
    on_tip: bool = True
    blackout: float | None = None  # s, when it begins; None: never

    @property
    def camera(self) -> Camera:
        """3.4 mm a pixel."""
        return Camera.facing((1280, 720), pixels_per_metre=290.0, origin=(640.0, 60.0), exposure=EXPOSURE)

    @property
    def arc_lengths(self) -> Array:
        """Positions of the markers, m; without a marker on the tip the last one is 0.1 m above it."""
        spacing = LENGTH / MARKERS
        return np.linspace(spacing, LENGTH, MARKERS) - (0.0 if self.on_tip else 0.5 * spacing)

    @property
    def stamps(self) -> Array:
        """Of the frames, s."""
        return np.arange(self.start, self.end - EXPOSURE, FRAME)

    def motion(self) -> RopeMotion:
        """The rope's motion: 100 links, bent by chance at the start by some degrees."""
        rng, s = np.random.default_rng((self.seed, 1)), np.linspace(0.0, 1.0, FINE)
        size = rng.normal(size=3) * (0.05, 0.05, 0.025)
        q0 = size @ np.stack([np.ones(FINE), np.sin(np.pi * s), np.sin(2.0 * np.pi * s)])
        t = np.arange(0.0, self.end, 1.0 / RATE)
        return RopeMotion.from_trajectory(hf.simulate(rope(FINE), SWINGS, arm=ARM, duration=self.end, q0=q0, t_eval=t))

    def renderer(self, motion: RopeMotion) -> Renderer:
        """What takes the pictures."""
        rng = np.random.default_rng((self.seed, 2))
        places = [(float(x), float(y)) for x, y in rng.uniform([-2.0, -2.1], [2.0, 0.1], (12, 2))]
        scene = Scene(
            self.arc_lengths,
            marker_diameter=DIAMETER,
            marker_colours=RED,
            clutter=8,
            light_drift=0.1,
            occluders=tuple(Occluder(place, place, DIAMETER, RED) for place in places),
            hidden=random_occlusion(MARKERS, self.occluded, 0.2, until=self.end, seed=self.seed),
            blackouts=() if self.blackout is None else ((self.blackout, self.blackout + BLACK),),
            seed=self.seed,
        )
        return Renderer(self.camera, motion, scene)


@dataclass(frozen=True, eq=False)
class Followed:
    """A tracker's run: errors of the tip, in m and over what was stated, and which markers were taken for which."""

    video: HardVideo
    t: Array  # (T,) s, from the frame in which the rope was found
    tip: Array  # (T,) m
    nees: Array  # (T,) squared Mahalanobis distance of the tip, 2 degrees of freedom
    nearest: npt.NDArray[np.int64]  # (T, K) which true marker is nearest to the one that was seen; -1: not seen
    visible: npt.NDArray[np.bool_]  # (T, K)
    found_after: int  # frames

    @property
    def black(self) -> npt.NDArray[np.bool_]:
        """Which frames show nothing (T,)."""
        start = np.inf if self.video.blackout is None else self.video.blackout
        return (self.t >= start) & (self.t < start + BLACK)

    def rms(self, used: npt.NDArray[np.bool_]) -> float:
        """Root mean square of the tip's error, m."""
        return float(np.sqrt(np.mean(self.tip[used] ** 2)))

    def summary(self) -> dict[str, float | bool]:
        """Figures of the run."""
        settled = self.t >= self.t[0] + SINCE
        wrong = (self.nearest >= 0) & (self.nearest != np.arange(self.nearest.shape[1]))
        shown = self.visible & (settled & ~self.black)[:, None]
        row: dict[str, float | bool] = {
            "found after": self.found_after,
            "tip": self.rms(settled & ~self.black),
            "tip, worst": float(self.tip[settled & ~self.black].max()),
            "captured": float((self.nearest >= 0)[shown].mean()),
            "wrong": float(wrong[shown].mean()),
            "right at the end": not bool(wrong[-15:].any()),
            "within 90 %": float((self.nees[settled & ~self.black] < NINETY).mean()),
        }
        if self.black.any():
            last = int(np.flatnonzero(self.black)[-1])
            later = int(np.flatnonzero(self.t >= self.t[last] + LATE)[0])
            row |= {
                "end of blackout": float(self.tip[last]),
                "inside 90 %": bool(self.nees[last] < NINETY),
                "0.1 s later": float(self.tip[later]),
            }
        return row


def rendered(video: HardVideo, renderer: Renderer) -> Iterator[Frame]:
    """Frames as they are rendered, without compression."""
    for k, stamp in enumerate(video.stamps.tolist()):
        yield Frame(stamp, renderer.image(stamp), k)


def follow(video: HardVideo, motion: RopeMotion, truth: Truth, frames: Iterable[Frame]) -> Followed:
    """Track the frames with 50 links."""
    camera = video.camera
    estimator = RopeFilter(rope(50), video.arc_lengths, motion=SWINGS, arm=ARM, camera=camera)
    tracker: RopeTracker | None = None
    rows = []
    for k, frame in enumerate(frames):
        if tracker is None:
            tracker = RopeTracker(estimator, MarkerMeasurement(MarkerDetector(clicked(frame, truth))))
        result = tracker.look(frame)
        if result.state is None:
            continue
        error, nees = tip_error(estimator, motion.places([result.t], [LENGTH])[0, 0, :2])
        apart = np.linalg.norm(truth.pixels[k][None] - result.pixels[:, None], axis=2)
        nearest = np.where(result.seen, np.nan_to_num(apart).argmin(axis=1), -1)
        rows.append((result.t, error, nees, nearest, truth.visible[k]))
    t, tip, far, nearest, visible = (np.array(column) for column in zip(*rows, strict=True))
    return Followed(video, t, tip, far, nearest, visible, len(truth.stamps) - len(rows))


def clicked(frame: Frame, truth: Truth) -> MarkerColour:
    """The colour from a click on a marker that touches nothing of its colour: that of middle size of all in sight."""
    colours = [MarkerColour.from_click(frame.image, place) for place in truth.pixels[0, truth.visible[0]]]
    return sorted(colours, key=lambda colour: colour.area or 0.0)[len(colours) // 2]


def tip_error(estimator: RopeFilter, place: Array) -> tuple[float, float]:
    """Distance of the tip from its true place, m, and its squared Mahalanobis distance."""
    tip, _, spread = tip_of(estimator)
    off = tip - place
    return float(np.linalg.norm(off)), float(off @ np.linalg.solve(spread, off))
