"""Tracks a rope through the frames of a video: predict, look where markers must be, assign, correct."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.estimate.changes import Change
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.observations import Observations
from hyperflex.estimate.picture import draw_caption, draw_markers, draw_rope
from hyperflex.estimate.process import turning_rate
from hyperflex.interfaces import RopeState
from hyperflex.vision import (
    ClutterMap,
    Frame,
    Gate,
    Image,
    MarkerDetector,
    PlaneAdjustment,
    assign_markers,
    check_increasing,
    order_markers,
)
from hyperflex.vision import Observations as Blobs

LOST = 8  # frames in a row without a marker, after which the whole picture is searched anew
WIDEST = 0.25  # of the picture's height, standard deviation of a place beyond which there is no gate to search
DOUBT = 2.0  # px, of a prediction beyond what the filter says of itself: where to look, and which blob is which
LEAST_STD = 0.2  # px, of a place: what compression and a marker that sits askew add to a detector's own noise
DOUBTFUL = 3.0  # level of measurement noise from which the model is doubted
SURE = 2.0  # standard deviations by which lengths may be off until they are known better
DISTURBED = 0.25  # (g / L)^(3/4), density of what disturbs the whole rope from which the model is doubted
KNOWN = 0.3  # standard deviation of that density's logarithm
PATIENT = 30  # frames until a first frame is taken whose order is the best, but not certain


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """What was made of one frame.

    Attributes
    ----------
    t : float
        Middle of the exposure in the middle of the picture, s, an estimated delay taken into account.
    pixels : (K, 2) float64
        Where each marker was seen, px; NaN: not seen.
    covariances : (K, 2, 2) float64
        Of that, and of how far they moved between `t` and their own row, px^2.
    places : (K, 2) float64
        In the swing plane at `t`, m, by what is known by then of its scale, turn and offset.
    predicted : (K, 2) float64
        Where they were expected, px; NaN before anything was known.
    gates : (K, 2, 2) float64
        Covariances of that, px^2.
    state : RopeState or None
        None while the rope has not been found.
    changes : tuple of Change
        What was noticed in this frame to have changed, where the filter tests for that.
    """

    t: float
    pixels: Array
    covariances: Array
    places: Array
    predicted: Array
    gates: Array
    state: RopeState | None
    changes: tuple[Change, ...] = ()

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Which markers were seen (K,)."""
        return ~np.isnan(self.pixels[:, 0])


class CameraTracker:
    """What trackers through a camera have in common: frames and their times, and places by what is estimated.

    Parameters
    ----------
    estimator : RopeFilter
        With a camera that knows the swing plane.
    """

    def __init__(self, estimator: RopeFilter) -> None:
        camera = estimator.model.camera
        if camera is None or camera.rotation is None:
            raise InvalidInput("a tracker needs a camera that knows the swing plane", fix="See Camera.with_plane")
        self.estimator, self.camera = estimator, camera

    @property
    def values(self) -> Array:
        """What is estimated beside the state by now (P,), in the order of the estimator's parameters."""
        return np.asarray(self.estimator.x[2 * self.estimator.n_links :])

    @property
    def adjustment(self) -> PlaneAdjustment:
        """How the swing plane deviates from the calibrated one, as far as that is estimated."""
        return self.estimator.parameters.plane_adjustment(self.values)

    @property
    def delay(self) -> float:
        """By how much pictures are older than their stamps, s, as far as that is estimated."""
        return self.estimator.parameters.value("delay", self.values)

    def _time(self, frame: Frame) -> float:
        """Return the middle of a frame's exposure, s; refuse frames of another size than the camera's."""
        height, width = frame.image.shape[:2]
        if (width, height) != tuple(self.camera.image_size):
            allowed = "x".join(map(str, self.camera.image_size))
            raise InvalidInput("the frame has another size than the camera's", got=f"{width}x{height}", allowed=allowed)
        return frame.time - self.camera.delay + 0.5 * self.camera.readout

    def _predict_to(self, t: float) -> bool:
        """Let the estimator go on to a time, s; return whether it knows of any state there."""
        if self.estimator.t is None:
            return False
        try:
            self.estimator.predict_to(t)
        except SimulationError:  # the state is none that a rope has
            self.estimator.restart()
            return False
        return True

    def _result(
        self, t: float, pixels: Array, covariances: Array, predicted: Array, gates: Array, rows: Array
    ) -> TrackedFrame:
        """Return what was made of a frame at a time of `_time`, s, whose markers were read at `rows` (K,)."""
        if self.estimator.t is None:
            return TrackedFrame(t - self.delay, pixels, covariances, self._places(pixels), predicted, gates, None)
        shift, unsure = self.estimator.readout_shift(rows)
        places, now = self._places(pixels - shift), (self.estimator.state, self.estimator.changes)
        return TrackedFrame(t - self.delay, pixels, covariances + unsure, places, predicted, gates, *now)

    def _places(self, pixels: Array) -> Array:
        return self.camera.locate(pixels, self.adjustment)

    def _rows(self, pixels: Array) -> Array:
        """Return when pixels are read, -0.5 in the first row and 0.5 in the last; 0 of what is not seen."""
        if not self.estimator.model.reads_rows:
            return np.zeros(len(pixels))
        return np.nan_to_num(self.camera.readout_share(pixels) - 0.5)


class RopeTracker(CameraTracker):
    """Follows a rope from frame to frame.

    Parameters
    ----------
    estimator : RopeFilter
        With a camera.
    detector : MarkerDetector
        Of the markers' colour.

    Raises
    ------
    InvalidInput
        If the filter's arc lengths do not increase, or it has no camera that knows the swing plane.

    Notes
    -----
    The first frame is searched as a whole, and its blobs are put in order by the rope between them (``order_markers``);
    where that is not certain, those that move, and then the next frame.
    From then on each marker is looked for where the dynamics say, as far around as they are unsure; all are assigned
    together. Where several frames in a row show nothing, the whole picture is searched again, with what the dynamics
    still say.
    """

    def __init__(self, estimator: RopeFilter, detector: MarkerDetector) -> None:
        super().__init__(estimator)
        check_increasing(estimator.model.arc_lengths)
        self.detector = detector
        self._dark = self._waited = 0
        self._clutter = ClutterMap(self.camera.image_size)

    def look(self, frame: Frame) -> TrackedFrame:
        """Take a frame, in the order of their times, and return what was made of it."""
        t = self._time(frame)
        if not self._predict_to(t):
            return self._first(frame.image, t)
        predicted, spread, speeds = self._expected()
        gates = self._gates(predicted, spread, speeds) if self._dark < LOST else None
        blobs = self._detected(frame.image, gates)
        level = max(1.0, self.estimator.measurement_noise.value)
        found = assign_markers(
            blobs._replace(covariances=level**2 * blobs.covariances),
            predicted,
            spread,
            reach=self._reach(predicted),
            clutter=self._clutter.density(blobs),
        )
        found = found._replace(covariances=found.covariances / level**2)
        self._clutter.learn(blobs, np.isin(np.arange(len(blobs.places)), found.indices), gates)
        rows = self._rows(found.places)
        self.estimator.update(Observations(t, found.places, rows=rows, covariances=found.covariances))
        found.places[~self.estimator.used] = np.nan  # outside of its gate: something else
        self._dark = 0 if (found.indices >= 0).any() else self._dark + 1
        return self._result(t, found.places, found.covariances, predicted, _of_each(spread), rows)

    @property
    def warning(self) -> str:
        """What speaks against all this: nothing, or that what is seen and what the rope can do are far apart."""
        level, disturbance = self.estimator.measurement_noise.value, self.estimator.process_noise
        density, known = float(disturbance.value[0]), float(disturbance.log_std[0]) < KNOWN
        rate = turning_rate(self.estimator.process.rope)
        said = []
        if level >= DOUBTFUL:
            said = [f"markers are {level:.1f} times as far from where the rope can be as their detector states"]
        if known and rate > 0.0 and density >= DISTURBED * rate**1.5:
            said += [f"the rope moves as if something disturbed it all along, by {density:.2g} rad/s^2 per root of Hz"]
        if not said:
            return ""
        return (
            f"{'; '.join(said)}: check the camera's scale, swing plane and origin (--estimate scale=0.01 or "
            "offset_x=0.02,offset_y=0.02), the time stamps (slow motion stored at a usual rate), the arc lengths, and "
            "the rope (more links where it swings briskly)"
        )

    def _first(self, image: Image, t: float) -> TrackedFrame:
        """Look for the whole rope."""
        count = len(self.estimator.model.arc_lengths)
        nothing, wide = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        blobs = self._detected(image)
        pixels, covariances = self._ordered(blobs, t) if len(blobs.places) else (nothing, wide)
        rows = self._rows(pixels)
        if np.isfinite(pixels).any():
            self._waited = 0
            self.estimator.update(Observations(t, pixels, rows=rows, covariances=covariances))
        return self._result(t, pixels, covariances, nothing, wide.copy(), rows)

    def _detected(self, image: Image, gates: list[Gate] | None = None) -> Blobs:
        """Return what looks like a marker."""
        blobs = self.detector.find(image, gates)
        return blobs._replace(covariances=blobs.covariances + LEAST_STD**2 * np.eye(2))

    def _ordered(self, blobs: Blobs, t: float) -> tuple[Array, Array]:
        """Return places and covariances of the markers, NaN where the frame does not tell which is which."""
        places, covariances = blobs.in_plane(self.camera, self.adjustment)
        noise = float(np.sqrt(np.median(np.trace(covariances, axis1=1, axis2=2) / 2.0)))
        along = np.maximum(self._arc_lengths(), 1e-6)
        relative, absolute = self._doubt_of_lengths()
        values = self.estimator.values
        shift = max(values.get(name, (0.0, 0.0))[1] for name in ("offset_x", "offset_y"))
        loose = {"noise": max(noise, 1e-4) + 0.5 * (absolute + SURE * shift), "slack": relative}
        origin, used = self.estimator.process.base(t)[0], np.arange(len(places))
        order = order_markers(places, along, origin, **loose)
        moving = np.flatnonzero(~self._clutter.still(blobs))
        if not order.certain and 2 <= moving.size < len(places):
            order, used = order_markers(places[moving], along, origin, **loose), moving
        self._waited += 1
        found = order.indices >= 0
        pixels, wide = np.full((along.size, 2), np.nan), np.full((along.size, 2, 2), np.nan)
        if (not order.certain and self._waited < PATIENT) or not found.any():
            self._clutter.learn(blobs, np.zeros(len(places), bool))
            return pixels, wide
        taken = used[order.indices[found]]
        pixels[found], wide[found] = blobs.places[taken], blobs.covariances[taken]
        if used.size == len(places):
            self._clutter = ClutterMap(self.camera.image_size)  # what lay still may have been the rope
        self._clutter.learn(blobs, np.isin(np.arange(len(places)), taken))
        return pixels, wide

    def _expected(self) -> tuple[Array, Array, Array]:
        """Return where markers should be (K, 2), px, each in its row, the covariance (2 K, 2 K), and speeds (K,)."""
        places, spread, speeds = self.estimator.expected()
        if self.estimator.model.reads_rows:
            places, spread, speeds = self.estimator.expected(self._rows(places))
        return places, spread + DOUBT**2 * np.eye(len(spread)), speeds

    def _reach(self, predicted: Array) -> Array | None:
        """Return how far apart markers that follow each other can be seen (K - 1,), px."""
        if not np.isfinite(predicted).all():
            return None
        adjustment, (relative, absolute) = self.adjustment, self._doubt_of_lengths()
        slopes = self.camera.place_slopes(self.camera.locate(predicted, adjustment), adjustment)[1]
        (a, b), (c, d) = slopes.transpose(1, 2, 0)
        scale = 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))  # the greater singular value
        rope = (1.0 + relative) * np.abs(np.diff(self._arc_lengths())) + absolute
        apart = rope * np.maximum(scale[1:], scale[:-1])
        return np.asarray(np.maximum(apart, 1.0)) if np.isfinite(apart).all() else None

    def _arc_lengths(self) -> Array:
        """Return where on the rope markers sit (K,), m, as far as that is estimated and can be."""
        declared = self.estimator.model.arc_lengths
        found = self.estimator.parameters.arc_lengths(declared, self.values)
        if found is declared:
            return declared
        return found if (np.diff(found, prepend=0.0)[declared > 0.0] > 0.0).all() else declared

    def _doubt_of_lengths(self) -> tuple[float, float]:
        """Return by how much the rope between markers may look longer than it is taken to be: a part of it, and m."""
        std = {name: each[1] for name, each in self.estimator.values.items()}
        moved = [each for name, each in std.items() if name.startswith("arc[")]
        return SURE * float(np.hypot(std.get("scale", 0.0), std.get("length", 0.0))), SURE * max(moved, default=0.0)

    def _gates(self, predicted: Array, spread: Array, speeds: Array) -> list[Gate] | None:
        """Return where to look; None where that is nearly everywhere."""
        if not np.isfinite(predicted).all() or np.sqrt(np.abs(spread).max()) > WIDEST * self.camera.image_size[1]:
            return None
        streaks = speeds * self.camera.exposure
        return [Gate(*gate) for gate in zip(predicted, _of_each(spread), streaks.tolist(), strict=True)]

    def shape(self, state: RopeState) -> tuple[Array, Array]:
        """Return the rope's joints in a state as they are seen (n + 1, 2), px, and the covariances (n + 1, 2, 2)."""
        estimator, n = self.estimator, state.q.size
        stretch = 1.0 + estimator.parameters.value("length", self.values)
        lengths, base = stretch * estimator.process.rope.length, estimator.process.base(state.t)[0]
        steps = lengths * np.stack([np.cos(state.q), np.sin(state.q)])
        before = np.tril(np.ones((n + 1, n)), -1)
        slopes = before[:, None, :] * steps
        wide = np.zeros((n, n)) if state.covariance is None else state.covariance[:n, :n]
        places = base + before @ np.stack([steps[1], -steps[0]], axis=1)
        pixels, by_place = self.camera.place_slopes(places, self.adjustment)
        seen = by_place @ slopes
        return pixels, seen @ wide @ seen.transpose(0, 2, 1)


def draw_frame(image: Image, tracker: RopeTracker, result: TrackedFrame, caption: list[str] | None = None) -> Image:
    """Return a frame with the rope as it is estimated, where it may be, gates, and the markers as they were seen.

    Parameters
    ----------
    image : (height, width, 3) uint8
    tracker : RopeTracker
    result : TrackedFrame
        What it made of the frame.
    caption : list of str, optional
        By default the time and how many markers were seen.
    """
    shown = image.copy()
    said = (
        [f"{result.t:.2f} s   {int(result.seen.sum())} of {result.seen.size} markers"] if caption is None else caption
    )
    if result.state is None:
        draw_caption(shown, [*said, "looking for the rope"])
        return shown
    draw_rope(shown, *tracker.shape(result.state))
    draw_markers(shown, result.predicted, result.gates, result.pixels, 2.0 * tracker.detector.radius + 2.0)
    draw_caption(shown, said)
    return shown


def _of_each(spread: Array) -> Array:
    """Return the covariance (K, 2, 2) of each of K places from that of all together (2 K, 2 K)."""
    count = len(spread) // 2
    each = np.arange(count)
    return np.asarray(spread.reshape(count, 2, count, 2)[each, :, each])
