"""Clutter of the markers' colour: its density, and the places where it stands still."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.vision.markers import Blobs, Gate

NEAR = 2.0  # px: a blob that near to a known one is the same, at rest
MEMORY = 30.0  # frames over which the number of blobs that are no markers is averaged
STILL = 3  # frames at the same place, from which a blob counts as one at rest and is not forgotten
FORGOTTEN = 2  # frames after which a blob seen less often is forgotten
WITHIN = 3.0  # standard deviations of a gate that were certainly searched


class ClutterMap:
    """Learns from blobs that were no markers how likely another such blob is at a place.

    Parameters
    ----------
    image_size : (int, int)
        Width and height, px.

    Notes
    -----
    Clutter is a uniform density, at least one blob a picture, plus the places at which something was seen that was no
    marker: where that was seen n times and missed m times, it is there again with probability n / (n + m + 1).
    """

    def __init__(self, image_size: tuple[int, int]) -> None:
        self._area = float(image_size[0] * image_size[1])
        self._mean = 0.0
        self._frame = 0
        self._places = np.empty((0, 2))
        self._sightings, self._missing, self._last = np.empty((3, 0))  # number, number, frame

    def density(self, seen: Blobs) -> Array:
        """Return the density of clutter where each of M blobs was seen (M,), 1/px^2."""
        result = np.full(len(seen.places), (1.0 + self._mean) / self._area)
        nearest, known = self._known(seen.places)
        n, m = self._sightings[nearest[known]], self._missing[nearest[known]]
        variance = np.sqrt(np.linalg.det(seen.covariances[known]))
        result[known] += n / (n + m + 1.0) / (2.0 * np.pi * variance)
        return result

    def still(self, seen: Blobs) -> npt.NDArray[np.bool_]:
        """Return which of M blobs lie where something was seen in `STILL` frames or more (M,)."""
        nearest, known = self._known(seen.places)
        known[known] = self._sightings[nearest[known]] >= STILL
        return known

    def learn(self, seen: Blobs, markers: npt.NDArray[np.bool_], gates: Sequence[Gate] | None = None) -> None:
        """Learn from a frame's blobs, of which some were `markers` (M,); searched in `gates`, or as a whole (None)."""
        self._frame += 1
        nearest, known = self._known(seen.places)
        searched = self._searched(gates)
        searched[nearest[known]] = False
        self._missing[searched] += 1.0
        again = known & ~markers
        self._places[nearest[again]] = seen.places[again]
        self._sightings[nearest[again]] += 1.0
        self._last[nearest[again]] = self._frame
        new = ~known & ~markers
        count = int(new.sum())
        self._mean += (count - self._mean) / min(MEMORY, self._frame)
        kept = (self._sightings >= STILL) | (self._frame - self._last < FORGOTTEN)
        self._places = np.concatenate([self._places[kept], seen.places[new]])
        values = np.stack([self._sightings, self._missing, self._last])[:, kept]
        added = np.tile([[1.0], [0.0], [float(self._frame)]], count)
        self._sightings, self._missing, self._last = np.concatenate([values, added], axis=1)

    def _searched(self, gates: Sequence[Gate] | None) -> npt.NDArray[np.bool_]:
        """Return which known places were certainly searched."""
        if gates is None:
            return np.ones(len(self._places), bool)
        off = np.abs(self._places[:, None] - np.array([gate.centre for gate in gates]).reshape(-1, 2))
        wide = np.array([gate.covariance for gate in gates]).reshape(-1, 2, 2)
        return np.asarray((off < WITHIN * np.sqrt(np.diagonal(wide, axis1=1, axis2=2))).all(axis=2).any(axis=1))

    def _known(self, places: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
        """Return the nearest known place of each blob (M,), and whether the blob is there (M,)."""
        if not len(self._places) or not len(places):
            return np.zeros(len(places), np.intp), np.zeros(len(places), bool)
        apart = np.linalg.norm(places[:, None] - self._places[None], axis=2)
        return apart.argmin(axis=1), apart.min(axis=1) < NEAR
