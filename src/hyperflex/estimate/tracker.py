"""Tracks a rope through the frames of a video: predict, measure, correct. What is measured is pluggable."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from hyperflex.checks import Array, Flags
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.estimate.changes import Change
from hyperflex.estimate.doubts import doubts, explained
from hyperflex.estimate.filter import RopeFilter, each_covariance, spread
from hyperflex.estimate.observations import Observations
from hyperflex.interfaces import RopeState
from hyperflex.vision import Camera, CurveDetector, Frame, Image

LEAST_STD = 0.2  # px, of a place: effect of compression and of tilted markers, in addition to a detector's noise


class Prediction(NamedTuple):
    """Where the points of the rope are expected in a frame.

    Attributes
    ----------
    pixels : (K, 2) float64
        px, each in its row.
    covariance : (2 K, 2 K) float64
        Of all of them together, px^2.
    speeds : (K,) float64
        px/s.
    """

    pixels: Array
    covariance: Array
    speeds: Array

    def of(self, own: Flags) -> "Prediction":
        """Return the prediction of those points alone (K,) that are in a part."""
        both = np.repeat(own, 2)
        return Prediction(self.pixels[own], self.covariance[np.ix_(both, both)], self.speeds[own])


class Measurement(Protocol):
    """What is measured in frames: markers, a curve, or anything else that gives places of points of the rope."""

    @property
    def radius(self) -> float:
        """Radius of what is seen of a point, px."""

    @property
    def count(self) -> int | None:
        """How many points are measured; None: as many as the estimator has."""

    @property
    def end_seen(self) -> float:
        """Part of the recent frames in which the free end of a rope without markers was seen; else 1."""

    def measure(
        self, image: Image, tracker: "RopeTracker", base: Array, expected: Prediction | None, arcs: Array
    ) -> tuple[Array, Array]:
        """Return the points seen in a frame: pixels (K, 2), NaN if not seen, and covariances (K, 2, 2), px^2.

        Parameters
        ----------
        image : (height, width, 3) uint8
        tracker : RopeTracker
            What is known of camera and rope.
        base : (2,) float64
            Place of the first joint, m.
        expected : Prediction or None
            None if the rope has not been found.
        arcs : (K,) float64
            Arc lengths of the points, m, with the estimates until now.
        """


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """The result of one frame.

    Attributes
    ----------
    t : float
        Middle of the exposure in the middle of the picture, less an estimated delay, s.
    pixels : (K, 2) float64
        Where each marker was seen, px; NaN: not seen.
    covariances : (K, 2, 2) float64
        Of these, px^2.
    movements : (K, 2, 2) float64
        Covariances of their movement between `t` and their own row, px^2.
    places : (K, 2) float64
        In the swing plane at `t`, m, by the estimates of its scale, roll and offset until then.
    predicted : (K, 2) float64
        Where they were expected, px; NaN before the rope was found.
    gates : (K, 2, 2) float64
        Covariances of the expected places, px^2.
    state : RopeState or None
        None while the rope has not been found.
    changes : tuple of Change
        Those that were noticed in this frame, if the filter tests for changes.
    """

    t: float
    pixels: Array
    covariances: Array
    movements: Array
    places: Array
    predicted: Array
    gates: Array
    state: RopeState | None
    changes: tuple[Change, ...] = ()

    @property
    def seen(self) -> Flags:
        """Which markers were seen (K,)."""
        return ~np.isnan(self.pixels[:, 0])


class RopeTracker:
    """Tracks a rope from frame to frame.

    Parameters
    ----------
    estimator : RopeFilter
        With a camera that knows the swing plane.
    measurement : Measurement
        Such as :class:`MarkerMeasurement`.

    Raises
    ------
    InvalidInput
        If the filter has no camera that knows the swing plane, or other points than are measured.
    """

    KNOWN = 0.3  # largest standard deviation of the logarithm of a density that is known

    def __init__(self, estimator: RopeFilter, measurement: Measurement) -> None:
        camera = estimator.model.camera
        if camera is None or camera.rotation is None:
            raise InvalidInput("a tracker needs a camera that knows the swing plane", fix="See Camera.with_plane")
        points, count = len(estimator.model.arc_lengths), measurement.count
        if points != (count or points):
            raise InvalidInput("the filter has other points than are measured", got=points, allowed=str(count))
        self.estimator, self.measurement, self.camera = estimator, measurement, camera

    @property
    def values(self) -> Array:
        """Estimates beside the state (P,), in the order of the estimator's parameters."""
        return np.asarray(self.estimator.x[2 * self.estimator.n_links :])

    @property
    def adjusted_camera(self) -> Camera:
        """The camera with the swing plane as it is estimated."""
        return self.estimator.parameters.camera_at(self.camera, self.values)

    @property
    def arc_lengths(self) -> Array:
        """Of the points measured (K,), m, as they are estimated; as declared if that is impossible."""
        declared = self.estimator.model.arc_lengths
        arcs = self.estimator.parameters.arc_lengths(declared, self.values)
        return declared if (np.diff(arcs, prepend=0.0)[declared > 0.0] <= 0.0).any() else arcs

    @property
    def delay(self) -> float:
        """Estimated age of the pictures at their time stamps, s."""
        return self.estimator.parameters.value("delay", self.values)

    def look(self, frame: Frame) -> TrackedFrame:
        """Process a frame, in the order of their times, and return its result."""
        self.camera.check_size(frame.image.shape[1::-1])
        t, estimator = self.camera.middle_of(frame.time), self.estimator
        expected = self.expect(t)
        base = estimator.process.base(t)[0] + estimator.parameters.base_offset(self.values)
        pixels, covariances = self.measurement.measure(frame.image, self, base, expected, self.arc_lengths)
        rows = self.rows(pixels)
        estimator.update(Observations(t, pixels, rows=rows, covariances=covariances))
        predicted, gates = np.full_like(pixels, np.nan), np.full_like(covariances, np.nan)
        if expected is not None:
            predicted, gates = expected.pixels, each_covariance(expected.covariance)
            pixels[~estimator.used] = np.nan  # outside of its gate
        shift, movements, state = np.zeros_like(pixels), np.zeros_like(covariances), None
        if estimator.t is not None:
            (shift, movements), state = estimator.readout_shift(rows), estimator.state
        places, t = self.adjusted_camera.locate(pixels - shift), t - self.delay
        return TrackedFrame(t, pixels, covariances, movements, places, predicted, gates, state, estimator.changes)

    def expect(self, t: float) -> Prediction | None:
        """Predict to time t, s, and return where the points are expected, each in its row; None if that is unknown."""
        estimator = self.estimator
        if estimator.t is None:
            return None
        try:
            estimator.predict_to(t)
        except SimulationError:  # an impossible state
            estimator.restart()
            return None
        found = estimator.expected()
        if estimator.model.reads_rows:
            found = estimator.expected(self.rows(found[0]))
        return Prediction(*found)

    @property
    def warning(self) -> str:
        """Why the set-up may be wrong: measurements and possible motions of the rope disagree; empty if they agree."""
        disturbance = self.estimator.process_noise
        known = float(disturbance.log_std[0]) < self.KNOWN
        density = disturbance.value if known else np.zeros(2)
        found = doubts(self.estimator.process.rope, self.level, density, end=self.measurement.end_seen)
        return explained(found, plain=self._plain)

    @property
    def level(self) -> float:
        """Errors of the places over those of detection."""
        stated = np.sqrt(CurveDetector.CORRELATED) if self._plain else 1.0
        return float(stated * self.estimator.measurement_noise.value)

    @property
    def _plain(self) -> bool:
        return getattr(self.measurement, "look", None) is not None

    def shape(self, state: RopeState) -> tuple[Array, Array]:
        """Return the rope's joints in a state in the picture (n + 1, 2), px, and their covariances (n + 1, 2, 2)."""
        places, slopes = self.estimator.joints(state)
        pixels, by_place = self.adjusted_camera.linearize(places)
        return pixels, spread(by_place @ slopes, state.covariance)

    def rows(self, pixels: Array) -> Array:
        """Return when pixels are read, -0.5 in the first row and 0.5 in the last; 0 if not seen."""
        if not self.estimator.model.reads_rows:
            return np.zeros(len(pixels))
        return np.nan_to_num(self.camera.readout_share(pixels) - 0.5)
