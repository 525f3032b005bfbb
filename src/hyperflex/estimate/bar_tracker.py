"""Tracks a pendulum whose links are coloured bars: predict, unmix, correct."""

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.observations import Observations
from hyperflex.estimate.tracker import LEAST_STD, CameraTracker, TrackedFrame
from hyperflex.vision import FLOOR, BarDetector, BarObservations, Frame, Image, link_angles


def bar_arc_lengths(spans: npt.ArrayLike) -> Array:
    """Return arc lengths (2 J,), m, of two points of each bar that say as much as its centre and its axis.

    They lie a radius of gyration, length / sqrt(12), to both sides of the centre: what is known of the centre and of
    the axis of a bar with straight edges is then known of both points, independently of each other.

    Parameters
    ----------
    spans : (J, 2) array_like
        Where what is usually seen of each bar begins and ends along the chain, m from the first joint. A bar may reach
        beyond its joints, or begin under the bar before it.
    """
    ends = checks.array("spans", spans, (-1, 2), unit="m")
    if (ends[:, 1] <= ends[:, 0]).any():
        raise InvalidInput("a bar ends before it begins", got=ends, allowed="begin < end")
    middle, reach = ends.mean(axis=1), np.diff(ends, axis=1)[:, 0] / np.sqrt(12.0)
    return np.stack([middle - reach, middle + reach], axis=1).ravel()


class BarTracker(CameraTracker):
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
        super().__init__(estimator)
        points, bars = len(estimator.model.arc_lengths), len(detector.colours)
        if points != 2 * bars:
            raise InvalidInput(
                "the filter has other points than the bars", got=points, allowed=f"two of each of {bars} bars"
            )
        self.detector = detector

    def look(self, frame: Frame) -> TrackedFrame:
        """Take a frame, in the order of their times, and return what was made of it."""
        t = self._time(frame)
        count = len(self.estimator.model.arc_lengths)
        predicted, gates = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
        if self._predict_to(t):
            predicted, gates = self.estimator.markers()
        _, pixels, covariances = self.points(frame.image, predicted)
        rows = self._rows(pixels)
        self.estimator.update(Observations(t, pixels, rows=rows, covariances=covariances))
        return self._result(t, pixels, covariances, predicted, gates, rows)

    def points(self, image: Image, expected: Array) -> tuple[BarObservations, Array, Array]:
        """Return the bars in a frame, two points (2 J, 2) of each, px, NaN: not seen, and covariances (2 J, 2, 2).

        Where more or less of a bar is seen than its span, half of the difference counts as a standard deviation along
        it: another bar may lie over one of its ends.

        Parameters
        ----------
        image : (height, width, 3) uint8
        expected : (2 J, 2) float64
            Where the points should be, px: which way a bar points where its joint is hidden. NaN: not known.
        """
        seen = self.detector.find(image)
        base = self.estimator.process.base(self.estimator.t or 0.0)[0]
        sides = expected[1::2] - expected[::2]
        angles = link_angles(
            seen, self.camera.project(base[None], self.adjustment)[0], np.arctan2(sides[:, 0], sides[:, 1])
        )
        along = np.stack([np.sin(angles), np.cos(angles)], axis=1)
        across = np.stack([along[:, 1], -along[:, 0]], axis=1)
        arcs = self.estimator.model.arc_lengths.reshape(-1, 2)
        reach = 0.5 * np.diff(arcs, axis=1)[:, 0] * self.camera.pixels_per_metre
        pixels = seen.centres[:, None] + np.array([-1.0, 1.0])[:, None] * (reach[:, None] * along)[:, None]
        pixels = pixels.reshape(-1, 2)
        pixels[np.isnan(pixels).any(axis=1)] = np.nan
        missing = reach * np.sqrt(12.0) - seen.lengths
        lengthwise = 2.0 * (FLOOR**2 + (0.5 * missing) ** 2)  # a point has half of what the bar says
        sidewise = 2.0 * np.einsum("kc,kcd,kd->k", across, seen.covariances[:, :2, :2], across)
        wide = LEAST_STD**2 * np.eye(2) + sum(
            variance[:, None, None] * side[:, :, None] * side[:, None, :]
            for variance, side in ((lengthwise, along), (sidewise, across))
        )
        return seen, pixels, np.repeat(wide, 2, axis=0)
