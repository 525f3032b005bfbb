"""Measurement of a rope by identical markers: search in gates, joint assignment, clutter, and the first order."""

import numpy as np

from hyperflex.checks import Array
from hyperflex.estimate.filter import each_covariance
from hyperflex.estimate.observations import MarkerModel
from hyperflex.estimate.tracker import LEAST_STD, Measured, Prediction, View
from hyperflex.vision import Blobs, ClutterMap, Gate, Image, MarkerDetector, assign_markers, order_markers


class MarkerMeasurement:
    """Measures identical markers along the rope (a :class:`Measurement`).

    Parameters
    ----------
    detector : MarkerDetector
        Of the markers' colour.

    Notes
    -----
    The first frame is searched as a whole, and its blobs are ordered by the rope between them (``order_markers``); if
    the order is ambiguous, those that move are ordered, and then those of the next frame. From then on each marker is
    searched where the prediction says, as far around as it is uncertain, and all are assigned together. If several
    frames in a row show nothing, the whole picture is searched, with the prediction that remains.
    """

    PATIENCE = 30  # frames after which an ambiguous first order is accepted
    LOST = 8  # frames in a row without a marker, after which the whole picture is searched
    WIDEST = 0.25  # of the picture's height: a larger standard deviation of a place needs no gate
    DOUBT = 2.0  # px, standard deviation of a prediction in addition to what the filter states
    SURE = 2.0  # standard deviations by which lengths may differ from what is known

    def __init__(self, detector: MarkerDetector) -> None:
        self.detector = detector
        self._dark = self._waited = 0
        self._clutter: ClutterMap | None = None

    @property
    def radius(self) -> float:
        """Of a marker at rest, px."""
        return self.detector.radius

    def check(self, model: MarkerModel) -> None:
        """Accept any points."""

    def measure(self, image: Image, view: View) -> Measured:
        """Return the markers seen in a frame."""
        if self._clutter is None:
            self._clutter = ClutterMap(view.camera.image_size)
        if view.prediction is None:
            return self._first(image, view, self._clutter)
        return self._next(image, view, view.prediction, self._clutter)

    def _next(self, image: Image, view: View, expected: Prediction, clutter: ClutterMap) -> Measured:
        spread = expected.covariance + self.DOUBT**2 * np.eye(len(expected.covariance))
        gates = self._gates(view, expected, spread) if self._dark < self.LOST else None
        blobs, level = self._detect(image, gates), max(1.0, view.noise_level)
        found = assign_markers(
            blobs._replace(covariances=level**2 * blobs.covariances),
            expected.pixels,
            spread,
            clutter=clutter.density(blobs),
        )
        clutter.learn(blobs, np.isin(np.arange(len(blobs.places)), found.indices), gates)
        self._dark = 0 if (found.indices >= 0).any() else self._dark + 1
        return Measured(found.places, found.covariances / level**2)

    def _first(self, image: Image, view: View, clutter: ClutterMap) -> Measured:
        """Find the whole rope: NaN if the frame does not tell which marker is which."""
        count = len(view.arc_lengths)
        pixels, wide = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        blobs = self._detect(image)
        if not len(blobs.places):
            return Measured(pixels, wide)
        places, covariances = view.camera.locate_with_covariance(blobs.places, blobs.covariances)
        noise = float(np.sqrt(np.median(np.trace(covariances, axis1=1, axis2=2) / 2.0)))
        relative, absolute = self.SURE * np.array(view.length_stds)
        noise = max(noise, 1e-4) + 0.5 * (absolute + self.SURE * view.origin_std)
        arcs, everything = np.maximum(view.estimated_arcs, 1e-6), np.arange(len(places))
        used, order = everything, order_markers(places, arcs, view.base, noise=noise, slack=relative)
        moving = np.flatnonzero(~clutter.still(blobs))
        if not order.certain and 2 <= moving.size < len(places):
            used, order = moving, order_markers(places[moving], arcs, view.base, noise=noise, slack=relative)
        self._waited += 1
        found = order.indices >= 0
        if (not order.certain and self._waited < self.PATIENCE) or not found.any():
            clutter.learn(blobs, np.zeros(len(places), bool))
            return Measured(pixels, wide)
        self._waited = 0
        taken = used[order.indices[found]]
        pixels[found], wide[found] = blobs.places[taken], blobs.covariances[taken]
        if used is everything:
            self._clutter = clutter = ClutterMap(view.camera.image_size)  # what lay still may have been the rope
        clutter.learn(blobs, np.isin(everything, taken))
        return Measured(pixels, wide)

    def _detect(self, image: Image, gates: list[Gate] | None = None) -> Blobs:
        blobs = self.detector.find(image, gates)
        return blobs._replace(covariances=blobs.covariances + LEAST_STD**2 * np.eye(2))

    def _gates(self, view: View, expected: Prediction, spread: Array) -> list[Gate] | None:
        """Return where to search; None if that is nearly everywhere."""
        widest = self.WIDEST * view.camera.image_size[1]
        if not np.isfinite(expected.pixels).all() or np.sqrt(np.abs(spread).max()) > widest:
            return None
        streaks = (expected.speeds * view.camera.exposure).tolist()
        return [Gate(*gate) for gate in zip(expected.pixels, each_covariance(spread), streaks, strict=True)]
