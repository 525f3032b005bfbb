"""Measurement of a pendulum whose links are coloured bars: two points of each."""

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.estimate.observations import MarkerModel
from hyperflex.estimate.tracker import LEAST_STD, Measured, View
from hyperflex.vision import FLOOR, BarDetector, Image, link_angles


def bar_arc_lengths(spans: npt.ArrayLike) -> Array:
    """Return arc lengths (2 J,), m, of two points of each bar that are equivalent to its centre and its axis.

    They are a radius of gyration, length / sqrt(12), to both sides of the centre: the errors of centre and axis of a
    bar with straight edges are then independent errors of the two points.

    Parameters
    ----------
    spans : (J, 2) array_like
        Begin and end of the part of each bar that is usually seen, along the chain, m from the first joint. A bar may
        reach beyond its joints, or begin under the bar before it.
    """
    ends = checks.array("spans", spans, (-1, 2), unit="m")
    if (ends[:, 1] <= ends[:, 0]).any():
        raise InvalidInput("a bar ends before it begins", got=ends, allowed="begin < end")
    middle, reach = ends.mean(axis=1), np.diff(ends, axis=1)[:, 0] / np.sqrt(12.0)
    return np.stack([middle - reach, middle + reach], axis=1).ravel()


class BarMeasurement:
    """Measures a bar of its own colour on each link of a pendulum (a :class:`Measurement`).

    Parameters
    ----------
    detector : BarDetector
        Of the links, from the first joint on. The estimator's arc lengths are those of :func:`bar_arc_lengths`.

    Notes
    -----
    Bars of different colours need no assignment and no gates. If more or less of a bar is seen than its span, half of
    the difference counts as a standard deviation along it: another bar may cover one of its ends.
    """

    radius = 0.0

    def __init__(self, detector: BarDetector) -> None:
        self.detector = detector

    def check(self, model: MarkerModel) -> None:
        """Raise InvalidInput unless the model has two points of each bar."""
        points, bars = len(model.arc_lengths), len(self.detector.colours)
        if points != 2 * bars:
            allowed = f"two of each of {bars} bars"
            raise InvalidInput("the filter has other points than the bars", got=points, allowed=allowed)

    def measure(self, image: Image, view: View) -> Measured:
        """Return two points of each bar seen in a frame."""
        seen, sides = self.detector.find(image), np.full((len(self.detector.colours), 2), np.nan)
        if view.prediction is not None:
            sides = view.prediction.pixels[1::2] - view.prediction.pixels[::2]
        angles = link_angles(seen, view.camera.project(view.base[None])[0], np.arctan2(sides[:, 0], sides[:, 1]))
        along = np.stack([np.sin(angles), np.cos(angles)], axis=1)
        across = np.stack([along[:, 1], -along[:, 0]], axis=1)
        reach = 0.5 * np.diff(view.arc_lengths.reshape(-1, 2), axis=1)[:, 0] * view.camera.pixels_per_metre
        pixels = np.repeat(seen.centres, 2, axis=0) + np.kron(reach[:, None] * along, [[-1.0], [1.0]])
        pixels[np.isnan(pixels).any(axis=1)] = np.nan
        missing = reach * np.sqrt(12.0) - seen.lengths
        lengthwise = 2.0 * (FLOOR**2 + (0.5 * missing) ** 2)  # a point has half of the bar's information
        sidewise = 2.0 * np.einsum("kc,kcd,kd->k", across, seen.covariances[:, :2, :2], across)
        wide = np.einsum("k,kc,kd->kcd", lengthwise, along, along) + np.einsum("k,kc,kd->kcd", sidewise, across, across)
        return Measured(pixels, np.repeat(wide + LEAST_STD**2 * np.eye(2), 2, axis=0))
