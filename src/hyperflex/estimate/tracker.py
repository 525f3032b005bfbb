"""Tracks a rope through the frames of a video: predict, look where markers must be, assign, correct."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.estimate.changes import Change
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.observations import Observations
from hyperflex.files import PathLike
from hyperflex.interfaces import RopeState
from hyperflex.recording import Recording
from hyperflex.vision import (
    Camera,
    ClutterMap,
    Frame,
    Gate,
    Image,
    MarkerDetector,
    VideoReader,
    VideoWriter,
    assign_markers,
    order_markers,
)
from hyperflex.vision import Observations as Blobs

LOST = 8  # frames in a row without a marker, after which the whole picture is searched anew
WIDEST = 0.25  # of the picture's height, standard deviation of a place beyond which there is no gate to search
DOUBT = 2.0  # px, of a prediction beyond what the filter says of itself: where to look, and which blob is which
LEAST_STD = 0.2  # px, of a place: what compression and a marker that sits askew add to a detector's own noise
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
        predicted, spread = self._expected()
        gates = self._gates(predicted, spread) if self._dark < LOST else None
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
        self._dark = 0 if (found.indices >= 0).any() else self._dark + 1
        return self._result(t, found.places, found.covariances, predicted, rows)

    def _first(self, image: Image, t: float) -> TrackedFrame:
        """Look for the whole rope."""
        model, blobs = self.estimator.model, self._detected(image)
        count = len(model.arc_lengths)
        nothing, wide = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        if not len(blobs.places):
            return TrackedFrame(t, nothing, wide, nothing, nothing, None)
        pixels, covariances = self._ordered(blobs, t)
        if pixels is None or covariances is None:
            return TrackedFrame(t, nothing, wide, nothing, nothing, None)
        rows = self._rows(pixels)
        self.estimator.update(Observations(t, pixels, rows=rows, covariances=covariances))
        return self._result(t, pixels, covariances, nothing, rows)

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

    def _expected(self) -> tuple[Array, Array]:
        """Return where the markers should be (K, 2), px, each in its own row, and their covariance (2 K, 2 K)."""
        places, spread = self.estimator.expected()
        if self.camera.readout or "readout" in self.estimator.parameters.names:
            places, spread = self.estimator.expected(self._rows(places))
        return places, spread + DOUBT**2 * np.eye(len(spread))

    def _reach(self, predicted: Array) -> Array | None:
        """Return how far apart markers that follow each other can be seen (K - 1,), px."""
        if not np.isfinite(predicted).all():
            return None
        scale = np.linalg.norm(self.camera.linearize(self.camera.locate(predicted)).by_point, ord=2, axis=(1, 2))
        apart = np.abs(np.diff(self.estimator.model.arc_lengths)) * np.maximum(scale[1:], scale[:-1])
        return np.asarray(np.maximum(apart, 1.0))

    def _gates(self, predicted: Array, spread: Array) -> list[Gate] | None:
        """Return where to look; None where that is nearly everywhere."""
        if not np.isfinite(predicted).all() or np.sqrt(np.abs(spread).max()) > WIDEST * self.camera.image_size[1]:
            return None
        streaks, each = np.zeros(len(predicted)), np.arange(len(predicted))
        if self.camera.exposure:
            streaks = self.estimator.speeds() * self.camera.exposure
        own = spread.reshape(len(predicted), 2, len(predicted), 2)[each, :, each]
        return [Gate(*gate) for gate in zip(predicted, own, streaks.tolist(), strict=True)]

    def _rows(self, pixels: Array) -> Array:
        """Return when pixels are read, -0.5 in the first row and 0.5 in the last; 0 of what is not seen."""
        return np.nan_to_num(self.camera.readout_share(pixels) - 0.5)

    def _result(self, t: float, pixels: Array, covariances: Array, predicted: Array, rows: Array) -> TrackedFrame:
        shift, unsure = self.estimator.readout_shift(rows)
        places = self.camera.locate(pixels - shift)
        now = self.estimator.state, self.estimator.changes
        return TrackedFrame(t, pixels, covariances + unsure, places, predicted, *now)


@dataclass(frozen=True, eq=False)
class VideoTrack:
    """What was tracked in a video.

    Attributes
    ----------
    recording : Recording
        Places of the markers, m, NaN where they were not seen, from the frame on in which the rope was found.
    frames : int
        Frames of the video.
    found_at : float
        Time of that frame, s.
    seen : float
        Which part of all markers in all frames since was seen.
    parameters : dict of str to (float, float)
        What was estimated beside the state, and its standard deviation.
    notes : tuple of str
        What was wrong with the video.
    changes : tuple of Change
        What was noticed to have changed, where the filter tests for that.
    """

    recording: Recording
    frames: int
    found_at: float
    seen: float
    parameters: dict[str, tuple[float, float]]
    notes: tuple[str, ...]
    changes: tuple[Change, ...] = ()


def track_video(
    video: PathLike,
    tracker: RopeTracker,
    *,
    preview: PathLike | None = None,
    progress: Callable[[int], None] | None = None,
) -> VideoTrack:
    """Track a rope through a whole video.

    Parameters
    ----------
    video : path-like
        Any file that FFmpeg reads.
    tracker : RopeTracker
        That has seen nothing yet.
    preview : path-like, optional
        MP4 file that shows what was seen and expected.
    progress : callable, optional
        Hears the number of frames done.

    Returns
    -------
    VideoTrack

    Raises
    ------
    FileProblem
        If the video cannot be read, or the preview not be written.
    InvalidInput
        If the rope is found in no frame, or the frames have another size than the camera's.
    """
    found: list[TrackedFrame] = []
    count = 0
    with ExitStack() as stack:
        reader = stack.enter_context(VideoReader(video))
        writer = None if preview is None else stack.enter_context(VideoWriter(preview, reader.image_size))
        for frame in reader:
            result = tracker.look(frame)
            count += 1
            if result.state is not None:
                found.append(result)
            if writer is not None:
                writer.write(draw(frame.image, tracker, result), frame.time)
            if progress is not None:
                progress(count)
        if len(found) < 2:
            raise InvalidInput(
                "the rope was not found in the video",
                got=f"{count} frames",
                allowed="two frames or more in which markers are seen in an order that the rope allows",
                fix="Check the markers' colour, their arc lengths, and the camera's swing plane",
            )
    notes = tuple(reader.notes)
    return VideoTrack(
        _recording(found, tracker.camera, str(video)),
        count,
        found[0].t,
        float(np.mean([each.seen.mean() for each in found])),
        tracker.estimator.values,
        notes,
        tuple(change for each in found for change in each.changes),
    )


def _recording(found: list[TrackedFrame], camera: Camera, source: str) -> Recording:
    """Return the markers of frames as measured data."""
    t, places = np.array([each.t for each in found]), np.array([each.places for each in found])
    slopes = np.linalg.inv(camera.linearize(np.nan_to_num(places.reshape(-1, 2))).by_point)
    pixels = np.array([each.covariances for each in found]).reshape(-1, 2, 2)
    wide = slopes @ np.nan_to_num(pixels, nan=1.0) @ slopes.transpose(0, 2, 1)
    noise = np.sqrt(np.diagonal(wide, axis1=1, axis2=2)).reshape(len(found), -1)
    used = ~np.isnan(places).all(axis=(1, 2))
    data = places.reshape(len(found), -1)
    return Recording(t[used], data[used], kind="markers", noise=noise[used], source=source)


def draw(image: Image, tracker: RopeTracker, result: TrackedFrame) -> Image:
    """Return a frame with the rope as it is estimated (white), gates (grey), and the markers as they were seen."""
    import cv2

    shown = image.copy()
    if result.state is None:
        cv2.putText(shown, "looking for the rope", (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255, 255, 255), 2)
        return shown
    estimator, camera = tracker.estimator, tracker.camera
    base = estimator.process.base(result.state.t)[0]
    line = camera.project(estimator.process.rope.joints(result.state.q, base))
    cv2.polylines(shown, [np.round(line * 16).astype(np.int32)], False, (255, 255, 255), 1, cv2.LINE_AA, 4)
    for expected in result.predicted[~np.isnan(result.predicted[:, 0])]:
        cv2.circle(shown, np.round(expected).astype(int).tolist(), 9, (150, 150, 150), 1, cv2.LINE_AA)
    for k, place in enumerate(result.pixels):
        if not np.isnan(place[0]):
            at = np.round(place).astype(int).tolist()
            cv2.drawMarker(shown, at, (0, 255, 255), cv2.MARKER_CROSS, 12, 1, cv2.LINE_AA)
            cv2.putText(shown, str(k), (at[0] + 9, at[1] - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 255, 255), 1)
    said = f"{result.t:.2f} s  {int(result.seen.sum())} of {result.seen.size} markers"
    cv2.putText(shown, said, (12, shown.shape[0] - 14), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (255, 255, 255), 1, cv2.LINE_AA)
    return shown
