"""Coloured bars in a frame, such as the links of a pendulum without markers: centre, angle and ends of each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.vision.colour import surface
from hyperflex.vision.video import Image

FLOOR = 0.3  # px, standard deviation of a place along or across a bar at least: its ends are no straight edges
_SHARE = 0.4  # of a pixel, from which it belongs to a bar
_LEAST_ANGLE = 0.15  # rad, between the colours of two bars against the wall
_LEAST_AREA = 0.35  # of a bar's own, below which it counts as hidden


class BarObservations(NamedTuple):
    """J bars in a frame, in the order of the colours; NaN for a bar that is not seen.

    Attributes
    ----------
    centres : (J, 2) float64
        px.
    angles : (J,) float64
        Of the longer axis, rad, 0 along +u, positive towards +v (downwards), from -pi/2 to pi/2: up to half a turn.
    lengths, widths : (J,) float64
        px, of a rectangle with the same moments.
    covariances : (J, 3, 3) float64
        Of centre and angle, px and rad.
    areas : (J,) float64
        Over that of the whole bar, where it is known; else px^2. Less than 1 where another bar covers it.
    """

    centres: Array
    angles: Array
    lengths: Array
    widths: Array
    covariances: Array
    areas: Array

    @property
    def ends(self) -> Array:
        """Both ends (J, 2, 2) of each bar's axis, px, in no order."""
        along = 0.5 * self.lengths[:, None] * np.stack([np.cos(self.angles), np.sin(self.angles)], axis=1)
        return np.stack([self.centres - along, self.centres + along], axis=1)


class BarDetector:
    """Finds one bar of each of up to three colours on a wall of one colour.

    Parameters
    ----------
    colours : (J, 3) array_like
        Blue, green, red of the bars, 0 to 255; J from 1 to 3.
    areas : (J,) array_like or None
        Of the bars, px^2, so that one which is covered is known to be; see :meth:`from_clicks`.

    Raises
    ------
    InvalidInput
        If colours are too much alike, seen against the wall.

    Notes
    -----
    Each pixel is a mixture of wall and bars (linear unmixing by least squares; blur mixes them in just that way), the
    wall the median of the frame. Centre, angle, length and width are moments of a bar's shares.
    """

    def __init__(self, colours: npt.ArrayLike, areas: npt.ArrayLike | None = None) -> None:
        self.colours = checks.array("colours", colours, (-1, 3), sign="nonnegative")
        count = self.colours.shape[0]
        if not 1 <= count <= 3:
            raise InvalidInput("number of bars does not fit", got=count, allowed="1 to 3: a pixel has three channels")
        self.areas = None if areas is None else checks.array("areas", areas, (count,), sign="positive", unit="px^2")

    @classmethod
    def from_clicks(cls, image: Image, places: npt.ArrayLike) -> BarDetector:
        """Return a detector of the bars at places (J, 2), px, in a frame that shows each whole."""
        clicks = checks.array("places", places, (-1, 2), unit="px")
        colours = [surface(image, place)[0] for place in clicks]
        seen = cls(colours).find(image)
        if np.isnan(seen.areas).any():
            missing = [int(k) for k in np.flatnonzero(np.isnan(seen.areas))]
            raise InvalidInput("bars are not seen where they were clicked", got=missing, fix="Click in their middles")
        return cls(colours, seen.areas)

    def find(self, image: Image) -> BarObservations:
        """Return the bars seen in a frame (height, width, 3), uint8."""
        import cv2

        wall = np.median(image[::4, ::4].reshape(-1, 3), axis=0)
        mixing = (self.colours - wall).T
        scaled = mixing / np.maximum(np.linalg.norm(mixing, axis=0), 1e-9)
        if np.linalg.svd(scaled, compute_uv=False)[-1] < _LEAST_ANGLE or np.linalg.norm(mixing, axis=0).min() < 30.0:
            raise InvalidInput(
                "colours of bars are too much alike, or like the wall",
                got=self.colours.round().tolist(),
                fix=f"Take others than {wall.round().tolist()}, the wall's",
            )
        unmixing = np.linalg.pinv(mixing)
        shares = cv2.transform(image.astype(np.float32), np.column_stack([unmixing, -unmixing @ wall]))
        layers = np.atleast_3d(shares).transpose(2, 0, 1)
        most = np.argmax(layers, axis=0)  # a bar in shade is a mixture with a darker one's colour, but less than half
        each = [self._bar(k, np.where(most == k, layer, np.float32(0.0))) for k, layer in enumerate(layers)]
        return BarObservations(*(np.array([bar[field] for bar in each]) for field in range(6)))

    def _bar(self, number: int, shares: npt.NDArray[np.float32]) -> tuple[Array, float, float, float, Array, float]:
        """Return centre, angle, length, width, covariance and area of one bar from its shares (height, width)."""
        import cv2

        nothing = np.full(2, np.nan), np.nan, np.nan, np.nan, np.full((3, 3), np.nan), np.nan
        count, label, stats, _ = cv2.connectedComponentsWithStats((shares > _SHARE).astype(np.uint8), connectivity=8)
        if count < 2:
            return nothing
        largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        mask = cv2.dilate((label == largest).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        v, u = np.nonzero(mask)
        weights = np.clip(shares[mask].astype(np.float64), 0.0, 1.0)
        area = float(weights.sum())
        whole = None if self.areas is None else float(self.areas[number])
        if area < (30.0 if whole is None else _LEAST_AREA * whole):
            return nothing
        pixels = np.column_stack([u, v]).astype(np.float64)
        centre = weights @ pixels / area
        off = pixels - centre
        values, vectors = np.linalg.eigh((weights[:, None] * off).T @ off / area)
        along = vectors[:, 1] * (1.0 if vectors[0, 1] >= 0.0 else -1.0)
        length, width = np.sqrt(12.0 * values[[1, 0]])
        missing = 0.0 if whole is None else max(0.0, 1.0 - area / whole - 0.05)
        sides = np.column_stack([along, [-along[1], along[0]]])
        spread = np.diag([FLOOR**2 + (missing * length) ** 2, FLOOR**2 + (missing * width) ** 2])
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = sides @ spread @ sides.T
        covariance[2, 2] = 12.0 * (FLOOR**2 + (missing * width) ** 2) / max(length, 1.0) ** 2
        angle = float(np.arctan2(along[1], along[0]))
        return centre, angle, float(length), float(width), covariance, area / (whole or 1.0)
