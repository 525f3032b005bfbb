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
    assign_markers,
    order_markers,
)
from hyperflex.vision import Observations as Blobs

LOST = 8  # frames in a row without a marker, after which the whole picture is searched anew
WIDEST = 0.25  # of the picture's height, standard deviation of a place beyond which there is no gate to search
DOUBT = 2.0  # px, of a prediction beyond what the filter says of itself: where to look, and which blob is which
LEAST_STD = 0.2  # px, of a place: what compression and a marker that sits askew add to a detector's own noise
DOUBTFUL = 3.0  # level of measurement noise from which the model is doubted
DISTURBED = 0.25  # (g / L)^(3/4), density of what disturbs the whole rope from which the model is doubted
KNOWN = 0.3  # standard deviation of that density's logarithm
PATIENT = 30  # frames until a first frame is taken whose order is the best, but not certain


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """What was made of one frame.

    Attributes
    ----------
    t : float
        Middle of the exposure in the middle of the picture, s.
    pixels : (K, 2) float64
        Where each marker was seen, px; NaN: not seen.
    covariances : (K, 2, 2) float64
        Of that, and of how far they moved between `t` and their own row, px^2.
    places : (K, 2) float64
        In the swing plane at `t`, m.
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


class RopeTracker:
    """Follows a rope from frame to frame.

    Parameters
    ----------
    estimator : RopeFilter
        With a camera.
    detector : MarkerDetector
        Of the markers' colour.

    Notes
    -----
    The first frame is searched as a whole, and its blobs are put in order by the rope between them (``order_markers``);
    where that is not certain, those that move, and then the next frame.
    From then on each marker is looked for where the dynamics say, as far around as they are unsure; all are assigned
    together. Where several frames in a row show nothing, the whole picture is searched again, with what the dynamics
    still say.
    """

    def __init__(self, estimator: RopeFilter, detector: MarkerDetector) -> None:
        camera = estimator.model.camera
        if camera is None or camera.rotation is None:
            raise InvalidInput("a tracker needs a camera that knows the swing plane", fix="See Camera.with_plane")
        self.estimator, self.detector, self.camera = estimator, detector, camera
        self._dark = self._waited = 0
        self._clutter = ClutterMap(self.camera.image_size)

    def look(self, frame: Frame) -> TrackedFrame:
        """Take a frame, in the order of their times, and return what was made of it."""
        height, width = frame.image.shape[:2]
        if (width, height) != tuple(self.camera.image_size):
            allowed = "x".join(map(str, self.camera.image_size))
            raise InvalidInput("the frame has another size than the camera's", got=f"{width}x{height}", allowed=allowed)
        t = frame.time - self.camera.delay + 0.5 * self.camera.readout
        if self.estimator.t is None:
            return self._first(frame.image, t)
        try:
            self.estimator.predict_to(t)
        except SimulationError:  # the state is none that a rope has
            self.estimator.restart()
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
    def doubt(self) -> str:
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
        model, blobs = self.estimator.model, self._detected(image)
        count = len(model.arc_lengths)
        nothing, wide = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        if not len(blobs.places):
            return TrackedFrame(t, nothing, wide, nothing, nothing, wide, None)
        pixels, covariances = self._ordered(blobs, t)
        if pixels is None or covariances is None:
            return TrackedFrame(t, nothing, wide, nothing, nothing, wide, None)
        rows = self._rows(pixels)
        self.estimator.update(Observations(t, pixels, rows=rows, covariances=covariances))
        return self._result(t, pixels, covariances, nothing, np.full((count, 2, 2), np.nan), rows)

    def _detected(self, image: Image, gates: list[Gate] | None = None) -> Blobs:
        """Return what looks like a marker."""
        blobs = self.detector.find(image, gates)
        return blobs._replace(covariances=blobs.covariances + LEAST_STD**2 * np.eye(2))

    def _ordered(self, blobs: Blobs, t: float) -> tuple[Array | None, Array | None]:
        """Return places and covariances of the markers, or None where the frame does not tell which is which."""
        places, covariances = blobs.in_plane(self.camera)
        noise = float(np.sqrt(np.median(np.trace(covariances, axis1=1, axis2=2) / 2.0)))
        arcs = self.estimator.model.arc_lengths
        origin, along = self.estimator.process.base(t)[0], np.maximum(arcs, 1e-6)
        used = np.arange(len(places))
        order = order_markers(places, along, origin, noise=max(noise, 1e-4))
        moving = np.flatnonzero(~self._clutter.still(blobs))
        if not order.certain and 2 <= moving.size < len(places):
            order, used = order_markers(places[moving], along, origin, noise=max(noise, 1e-4)), moving
        self._waited += 1
        found = order.indices >= 0
        if (not order.certain and self._waited < PATIENT) or not found.any():
            self._clutter.learn(blobs, np.zeros(len(places), bool))
            return None, None
        taken = used[order.indices[found]]
        pixels, wide = np.full((arcs.size, 2), np.nan), np.full((arcs.size, 2, 2), np.nan)
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
        estimator = self.estimator
        places = estimator.model.places(estimator.x, estimator.base)
        (a, b), (c, d) = self.camera.place_slopes(places)[1].transpose(1, 2, 0)
        scale = 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))  # the greater singular value
        apart = np.abs(np.diff(estimator.model.arc_lengths)) * np.maximum(scale[1:], scale[:-1])
        return np.asarray(np.maximum(apart, 1.0))

    def _gates(self, predicted: Array, spread: Array, speeds: Array) -> list[Gate] | None:
        """Return where to look; None where that is nearly everywhere."""
        if not np.isfinite(predicted).all() or np.sqrt(np.abs(spread).max()) > WIDEST * self.camera.image_size[1]:
            return None
        streaks = speeds * self.camera.exposure
        return [Gate(*gate) for gate in zip(predicted, _of_each(spread), streaks.tolist(), strict=True)]

    def _rows(self, pixels: Array) -> Array:
        """Return when pixels are read, -0.5 in the first row and 0.5 in the last; 0 of what is not seen."""
        if not self.estimator.model.reads_rows:
            return np.zeros(len(pixels))
        return np.nan_to_num(self.camera.readout_share(pixels) - 0.5)

    def shape(self, state: RopeState) -> tuple[Array, Array]:
        """Return the rope's joints in a state as they are seen (n + 1, 2), px, and the covariances (n + 1, 2, 2)."""
        estimator, n = self.estimator, state.q.size
        lengths, base = estimator.process.rope.length, estimator.process.base(state.t)[0]
        steps = lengths * np.stack([np.cos(state.q), np.sin(state.q)])
        before = np.tril(np.ones((n + 1, n)), -1)
        slopes = before[:, None, :] * steps
        wide = np.zeros((n, n)) if state.covariance is None else state.covariance[:n, :n]
        places = base + before @ np.stack([steps[1], -steps[0]], axis=1)
        pixels, by_place = self.camera.place_slopes(places)
        seen = by_place @ slopes
        return pixels, seen @ wide @ seen.transpose(0, 2, 1)

    def _result(
        self, t: float, pixels: Array, covariances: Array, predicted: Array, gates: Array, rows: Array
    ) -> TrackedFrame:
        shift, unsure = self.estimator.readout_shift(rows)
        places = self.camera.locate(pixels - shift)
        now = self.estimator.state, self.estimator.changes
        return TrackedFrame(t, pixels, covariances + unsure, places, predicted, gates, *now)


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
