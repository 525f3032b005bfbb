"""Measurements of a rope in frames: identical markers, the bare rope, or both."""

from collections import defaultdict

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, Flags, Integers
from hyperflex.errors import InvalidInput
from hyperflex.estimate.filter import each_covariance
from hyperflex.estimate.observations import UNMEASURED, MarkerModel
from hyperflex.estimate.parameters import BASE_KINDS
from hyperflex.estimate.process import DISTURBANCES
from hyperflex.estimate.tracker import LEAST_STD, Prediction, RopeTracker
from hyperflex.model import Rope
from hyperflex.vision import (
    Blobs,
    Camera,
    ClutterMap,
    CurveDetector,
    CurveView,
    Gate,
    Image,
    MarkerDetector,
    RopeLook,
    assign_markers,
    find_rope,
    order_markers,
    view_curve,
)


def _stds(tracker: RopeTracker) -> defaultdict[str, float]:
    """Return the standard deviations of the estimator's parameters; 0 of others."""
    return defaultdict(float, {name: std for name, (_, std) in tracker.estimator.values.items()})


class BaseElsewhere(InvalidInput):
    """Markers are seen in an order that the rope allows, but not from its first joint on: an arm moves it, say."""


class MarkerMeasurement:
    """Measures identical markers along the rope (a :class:`Measurement`).

    Parameters
    ----------
    *detectors : MarkerDetector
        One for each colour of the markers.
    marked : (N,) bool, optional
        Which of the estimator's arc lengths are the markers'; by default all.

    Notes
    -----
    The first frame is searched as a whole, and its blobs are ordered by the rope between them (``order_markers``); if
    the order is ambiguous, those that move are ordered, and then those of the next frame. From then on each marker is
    searched where the prediction says, as far around as it is uncertain, and all are assigned together. If several
    frames in a row show nothing, the whole picture is searched, with the prediction that remains.
    """

    PATIENCE = 30  # frames: then an ambiguous first order is accepted, and a rope that begins elsewhere is an error
    LOST = 8  # frames in a row without a marker, after which the whole picture is searched
    WIDEST = 0.25  # of the picture's height: a larger standard deviation of a place needs no gate
    DOUBT = 2.0  # px, standard deviation of a prediction in addition to what the filter states
    SURE = 2.0  # standard deviations by which lengths may differ from what is known

    count, end_seen = None, 1.0

    def __init__(self, *detectors: MarkerDetector, marked: Flags | None = None) -> None:
        self.detectors, self.marked = detectors, marked
        self._dark = self._waited = self._elsewhere = 0
        self._begun = False
        self._colours = np.zeros(0, np.int64)  # of each marker, by the detectors; -1: not known
        self._clutter: ClutterMap | None = None

    @property
    def radius(self) -> float:
        """Of a marker at rest, px."""
        return max(each.radius for each in self.detectors)

    def measure(
        self, image: Image, tracker: RopeTracker, base: Array, expected: Prediction | None, arcs: Array
    ) -> tuple[Array, Array]:
        """Return the markers seen in a frame."""
        if self._clutter is None:
            self._clutter = ClutterMap(tracker.camera.image_size)
            self._colours = np.full(len(arcs), -1)
        if expected is None:
            return self._first(image, tracker, base, arcs, self._clutter)
        spread, clutter = expected.covariance + self.DOUBT**2 * np.eye(len(expected.covariance)), self._clutter
        gates = self._gates(tracker.camera, expected, spread) if self._dark < self.LOST else None
        (blobs, colours), level = self._detect(image, gates), max(1.0, tracker.estimator.measurement_noise.value)
        found = assign_markers(
            blobs._replace(covariances=level**2 * blobs.covariances),
            expected.pixels,
            spread,
            clutter=clutter.density(blobs),
        )
        clutter.learn(blobs, np.isin(np.arange(len(blobs.places)), found.indices), gates)
        new = (self._colours < 0) & (found.indices >= 0)
        self._colours[new] = colours[found.indices[new]]
        self._dark = 0 if (found.indices >= 0).any() else self._dark + 1
        return found.places, found.covariances / level**2

    def _first(
        self, image: Image, tracker: RopeTracker, base: Array, arcs: Array, clutter: ClutterMap
    ) -> tuple[Array, Array]:
        """Find the whole rope: NaN if the frame does not tell which marker is which."""
        pixels, wide = np.full((len(arcs), 2), np.nan), np.full((len(arcs), 2, 2), np.nan)
        blobs, colours = self._detect(image)
        if not len(blobs.places):
            return pixels, wide
        places, covariances = tracker.adjusted_camera.locate_with_covariance(blobs.places, blobs.covariances)
        noise = float(np.sqrt(np.median(np.trace(covariances, axis1=1, axis2=2) / 2.0)))
        stds = _stds(tracker)
        relative = self.SURE * float(np.hypot(stds["scale"], stds["length"]))
        own = np.arange(len(arcs)) if self.marked is None else np.flatnonzero(self.marked)
        absolute = max(stds[f"arc[{k}]"] for k in own)
        noise = max(noise, 1e-4) + 0.5 * self.SURE * (absolute + max(stds["offset_x"], stds["offset_y"]))
        arcs, everything = np.maximum(arcs, 1e-6), np.arange(len(places))
        used, order = everything, order_markers(places, arcs, base, noise=noise, slack=relative)
        moving = np.flatnonzero(~clutter.still(blobs))
        if not order.certain and 2 <= moving.size < len(places):
            used, order = moving, order_markers(places[moving], arcs, base, noise=noise, slack=relative)
        self._waited += 1
        found, accepted = order.indices >= 0, order.certain or self._waited >= self.PATIENCE
        if accepted and not order.anchored and not BASE_KINDS.keys() <= set(tracker.estimator.parameters.names):
            self._elsewhere += 1
            first = int(np.argmax(found))
            if self._elsewhere >= self.PATIENCE and not self._begun:
                away = float(np.linalg.norm(places[used[order.indices[first]]] - base))
                raise BaseElsewhere(
                    "the rope does not begin at its first joint: a marker is farther from there than the rope reaches",
                    got=f"{away:.3g} m, at {arcs[first]:.3g} m along the rope",
                    fix="Give the arm's motion (RopeFilter(motion=, arm=)), calibrate with the hook's pixel, or "
                    "estimate a joint that moves in an unknown way: parameters=moving_base(rope)",
                )
            accepted = False
        if not accepted or not found.any():
            clutter.learn(blobs, np.zeros(len(places), bool))
            return pixels, wide
        self._waited, self._elsewhere, self._begun = 0, 0, True
        taken = used[order.indices[found]]
        pixels[found], wide[found] = blobs.places[taken], blobs.covariances[taken]
        self._colours = np.full(len(arcs), -1)
        self._colours[found] = colours[taken]
        for k, detector in enumerate(self.detectors):
            if (own := taken[colours[taken] == k]).size:
                detector.resize(float(np.median(blobs.areas[own])))
        if used is everything:
            self._clutter = clutter = ClutterMap(tracker.camera.image_size)  # what lay still may have been the rope
        clutter.learn(blobs, np.isin(everything, taken))
        return pixels, wide

    def spots(self, image: Image) -> Array:
        """Return pixels (M, 2) of all that looks like a marker, in the whole picture."""
        return self._detect(image)[0].places

    def _detect(self, image: Image, gates: list[Gate] | None = None) -> tuple[Blobs, Integers]:
        """Return the blobs of all colours (M,), and of which each is. A gate is searched for its marker's colour."""
        found = [
            each.find(image, gates and [gate for gate, own in zip(gates, self._colours, strict=True) if own in (k, -1)])
            for k, each in enumerate(self.detectors)
        ]
        blobs = Blobs(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
        wide = blobs.covariances + LEAST_STD**2 * np.eye(2)
        return blobs._replace(covariances=wide), np.repeat(np.arange(len(found)), [len(each.places) for each in found])

    def _gates(self, camera: Camera, expected: Prediction, spread: Array) -> list[Gate] | None:
        """Return where to search; None if that is nearly everywhere."""
        widest = self.WIDEST * camera.image_size[1]
        if not np.isfinite(expected.pixels).all() or np.sqrt(np.abs(spread).max()) > widest:
            return None
        streaks = (expected.speeds * camera.exposure).tolist()
        return [Gate(*gate) for gate in zip(expected.pixels, each_covariance(spread), streaks, strict=True)]


def curve_arc_lengths(rope: Rope, pieces: int = 40) -> Array:
    """Return arc lengths (pieces + 1,), m, at which a bare rope is measured: middles of pieces, and the free end."""
    checks.count("pieces", pieces, least=4)
    return np.append((np.arange(pieces) + 0.5) / pieces, 1.0) * rope.total_length


class CurveMeasurement:
    """Measures a rope without markers (a :class:`Measurement`).

    Parameters
    ----------
    look : RopeLook
        How it looks. The estimator's arc lengths are those of :func:`curve_arc_lengths`.

    Attributes
    ----------
    end_seen : float
        Part of the recent frames in which the free end was seen.
    searched : bool
        Whether the whole of the last picture was searched: errors of places are then alike along the rope.

    Notes
    -----
    A picture does not show how far the rope is along itself (the aperture problem): each piece of it is measured across
    the rope, and the free end along it. If it is expected too uncertainly, it is searched in the whole picture.

    The free end is seen up to half of the rope's thickness too far, alike in all frames: where scale, roll or readout
    are estimated, estimate its arc length, too (``"arc[k]"``), or they make up for it.
    """

    LINES = 7  # across a piece
    LOST = 20.0  # px, median standard deviation of places, from which the whole picture is searched for a rope of which
    HIDDEN = 0.3  # part is not seen where it is expected
    LENGTH = 0.1  # relative difference from the rope's length at which all of it is found
    MEMORY = 60  # frames, of the part in which the end was seen
    PATIENCE = 16  # frames between searches in vain, at most: one takes as long as many frames
    FOUND_STD = 3.0  # px, of places on a rope that was found in the whole picture

    count: int | None = None

    def __init__(self, look: RopeLook) -> None:
        self.look, self.detector = look, CurveDetector()
        self._dense: MarkerModel | None = None
        self._wait, self._waited = 1, 0
        self.searched, self.end_seen = False, 1.0

    @property
    def radius(self) -> float:
        """Of the rope, px."""
        return 0.5 * self.look.width

    def measure(
        self, image: Image, tracker: RopeTracker, base: Array, expected: Prediction | None, arcs: Array
    ) -> tuple[Array, Array]:
        """Return the rope seen in a frame: each piece across itself, and the free end along itself."""
        self.look, self.searched = self.look.in_light_of(image), True
        if expected is None:
            return self._found(image, tracker, base, arcs)
        view = self._view(tracker, expected)
        seen = self.detector.find(image, self.look, view)
        if np.median(np.sqrt(np.diag(expected.covariance))) > self.LOST and np.isnan(seen.offsets).mean() > self.HIDDEN:
            return self._found(image, tracker, base, arcs)
        self.searched = False
        self.end_seen += (float(np.isfinite(seen.end)) - self.end_seen) / self.MEMORY
        points, normals = view.middles
        ways = np.concatenate([normals, view.end_tangent[None]])
        places = np.concatenate([points, view.end[None]]) + np.append(seen.offsets, seen.end)[:, None] * ways
        variances = np.append(seen.variances, seen.end_variance)
        along = np.stack([-ways[:, 1], ways[:, 0]], axis=1)
        unmeasured = (2.0 * UNMEASURED) ** 2 * np.einsum("kc,kd->kcd", along, along)
        return places, variances[:, None, None] * (np.einsum("kc,kd->kcd", ways, ways) + unmeasured)

    def _view(self, tracker: RopeTracker, expected: Prediction) -> CurveView:
        """Return where the rope is expected at the begin, in the middle and at the end of the exposure."""
        estimator, camera = tracker.estimator, tracker.camera
        pieces = len(expected.pixels) - 1
        if self._dense is None:
            arcs = curve_arc_lengths(estimator.process.rope, pieces * self.LINES)
            self._dense = MarkerModel(
                estimator.process.rope, arcs, estimator.parameters, camera, readout=1.0, named=False
            )
        readout = camera.readout + estimator.parameters.value("readout", tracker.values)
        now = estimator.pixels_of(self._dense, np.zeros(len(self._dense.arc_lengths)))
        late = readout * tracker.rows(now)
        half = 0.5 * camera.exposure
        moving = np.array([estimator.pixels_of(self._dense, late + each) for each in (-half, 0.0, half)])
        corners = camera.readout_share([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        row_slope = readout * (corners[1:] - corners[0]) / max(camera.exposure, 1e-9)
        spacing = DISTURBANCES.correlation * pieces
        view = view_curve(moving, pieces, expected.covariance, spacing, estimator.n_links, row_slope)
        return view._replace(end=expected.pixels[-1])  # with its own arc length, as it is estimated

    def _found(self, image: Image, tracker: RopeTracker, base: Array, arcs: Array) -> tuple[Array, Array]:
        """Search the whole picture; all NaN if the rope is not found."""
        camera = tracker.adjusted_camera
        pixels, wide = np.full((len(arcs), 2), np.nan), np.full((len(arcs), 2, 2), np.nan)
        self._waited += 1
        if self._waited < self._wait:
            return pixels, wide
        self._waited = 0
        try:
            curve = find_rope(image, camera.project(base[None])[0], look=self.look).curve
        except InvalidInput:
            self._wait = min(2 * self._wait, self.PATIENCE)
            return pixels, wide
        self._wait = 1
        places = camera.locate(curve)
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
        stds = _stds(tracker)
        short = np.hypot(stds["scale"], stds["length"]) + self.FOUND_STD / (arcs[-1] * camera.pixels_per_metre)
        if -short < along[-1] / arcs[-1] - 1.0 < self.LENGTH:  # a shorter one has its end hidden
            along *= arcs[-1] / along[-1]
        there = arcs <= along[-1]
        pixels[there] = np.stack([np.interp(arcs[there], along, each) for each in curve.T], axis=1)
        wide[there] = self.FOUND_STD**2 * np.eye(2)
        return pixels, wide


def marked_arc_lengths(rope: Rope, markers: ArrayLike) -> tuple[Array, Flags]:
    """Return arc lengths, m, at which a rope with some markers is measured, and which of them are the markers'.

    `markers` are theirs, m; the others are of :func:`curve_arc_lengths`.
    """
    curve = (1.0 - 1e-6) * curve_arc_lengths(rope)  # never that of a marker
    arcs = np.append(curve, checks.array("arc_lengths", markers, (-1,), unit="m"))
    order = np.argsort(arcs)
    return arcs[order], order >= curve.size


class MarkedCurveMeasurement(CurveMeasurement):
    """Measures a rope with some markers (a :class:`Measurement`): them, and its curve between them.

    Parameters
    ----------
    look : RopeLook
        How the rope looks.
    marked : (K,) bool
        Which of the estimator's arc lengths are the markers', as of :func:`marked_arc_lengths`.
    *detectors : MarkerDetector
        One for each colour of the markers.

    Notes
    -----
    Markers show how far the rope is along itself, and the curve what it is like between them. If a marker covers the
    free end, this is measured as the marker alone.
    """

    def __init__(self, look: RopeLook, marked: Flags, *detectors: MarkerDetector) -> None:
        super().__init__(look)
        self.markers, self.marked, self.count = MarkerMeasurement(*detectors, marked=marked), marked, len(marked)

    def measure(
        self, image: Image, tracker: RopeTracker, base: Array, expected: Prediction | None, arcs: Array
    ) -> tuple[Array, Array]:
        """Return the markers, and the rope between them, seen in a frame."""
        pixels, wide = np.empty((len(arcs), 2)), np.empty((len(arcs), 2, 2))
        for own, measure in ((self.marked, self.markers.measure), (~self.marked, super().measure)):
            pixels[own], wide[own] = measure(image, tracker, base, expected and expected.of(own), arcs[own])
        bare = (arcs[-1] - arcs[self.marked][-1]) * tracker.camera.pixels_per_metre
        if bare < 2.0 * self.markers.radius:
            pixels[np.flatnonzero(~self.marked)[-1]], self.end_seen = np.nan, 1.0
        return pixels, wide
