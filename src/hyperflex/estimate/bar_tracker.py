"""Tracks a pendulum whose links are coloured bars: predict, unmix, correct."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.observations import Observations
from hyperflex.estimate.tracker import LEAST_STD, TrackedFrame
from hyperflex.vision import BarDetector, BarObservations, Frame, link_angles


def bar_arc_lengths(spans: npt.ArrayLike) -> Array:
    """Return arc lengths (2 J,), m, of two points of each bar that say as much as its centre and its axis.

    They lie a radius of gyration, length / sqrt(12), to both sides of the centre: what is known of the centre and of the
    axis of a bar with straight edges is then known of both points, independently of each other.

    Parameters
    ----------
    spans : (J, 2) array_like
        Where each bar begins and ends along the chain, m from the first joint; a bar may reach beyond its joints.
    """
    ends = checks.array("spans", spans, (-1, 2), unit="m")
    if (ends[:, 1] <= ends[:, 0]).any():
        raise InvalidInput("a bar ends before it begins", got=ends, allowed="begin < end")
    middle, reach = ends.mean(axis=1), np.diff(ends, axis=1)[:, 0] / np.sqrt(12.0)
    return np.stack([middle - reach, middle + reach], axis=1).ravel()


class BarTracker:
    """Follows a pendulum with a bar of its own colour on each link, from frame to frame.

    Parameters
    ----------
    estimator : RopeFilter
        With a camera, and with the ``arc_lengths`` of :func:`bar_arc_lengths`: two points a bar.
    detector : BarDetector
        Of the links, from the first joint on.

    Notes
    -----
    Bars of different colours need no assignment and no gates. The filter sees each as two points of it; it carries on a
    bar that is hidden, and whole frames that are left out.
    """

    def __init__(self, estimator: RopeFilter, detector: BarDetector) -> None:
        camera = estimator.model.camera
        if camera is None or camera.rotation is None:
            raise InvalidInput("a tracker needs a camera that knows the swing plane", fix="See Camera.with_plane")
        points, bars = len(estimator.model.arc_lengths), len(detector.colours)
        if points != 2 * bars:
            raise InvalidInput("the filter has other points than the bars", got=points, allowed=f"two of each of {bars}")
        self.estimator, self.detector, self.camera = estimator, detector, camera

    def look(self, frame: Frame) -> TrackedFrame:
        """Take a frame, in the order of their times, and return what was made of it."""
        t = frame.time - self.camera.delay + 0.5 * self.camera.readout
        arcs = self.estimator.model.arc_lengths
        expected, predicted = np.full(len(arcs) // 2, np.nan), np.full((len(arcs), 2), np.nan)
        if self.estimator.t is not None:
            self.estimator.predict_to(t)
            predicted = self.estimator.markers()[0]
            along = predicted[1::2] - predicted[::2]
            expected = np.arctan2(along[:, 0], along[:, 1])
        pivot = self.camera.project(self.estimator.process.base(t)[0][None])[0]
        seen = self.detector.find(frame.image)
        pixels, covariances = self._points(seen, link_angles(seen, pivot, expected))
        rows = np.nan_to_num(self.camera.readout_share(pixels) - 0.5)
        self.estimator.update(Observations(t, pixels, rows=rows, covariances=covariances))
        state = None if self.estimator.t is None else self.estimator.state
        return TrackedFrame(t, pixels, covariances, self.camera.locate(pixels), predicted, state)

    def _points(self, seen: BarObservations, angles: Array) -> tuple[Array, Array]:
        """Return two points of each bar (2 J, 2), px, and their covariances (2 J, 2, 2)."""
        arcs = self.estimator.model.arc_lengths
        reach = 0.5 * np.diff(arcs.reshape(-1, 2), axis=1) * self.camera.pixels_per_metre
        along = reach * np.stack([np.sin(angles), np.cos(angles)], axis=1)
        pixels = np.stack([seen.centres - along, seen.centres + along], axis=1).reshape(-1, 2)
        wide = 2.0 * seen.covariances[:, :2, :2] + LEAST_STD**2 * np.eye(2)  # each point has half of what the bar says
        pixels[np.isnan(pixels).any(axis=1)] = np.nan
        return pixels, np.repeat(wide, 2, axis=0)
