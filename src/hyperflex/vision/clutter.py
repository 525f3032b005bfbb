"""Clutter of the markers' colour: how dense it is, and where it stands still."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.vision.markers import Gate, Observations

NEAR = 2.0  # px, within which something seen again has not moved
MEMORY = 30.0  # frames, of the mean number of blobs that are no markers
STILL = 3  # frames in which something lay at the same place
FORGOTTEN = 2  # frames after which something that was seen there less often than that is forgotten
WITHIN = 3.0  # standard deviations of a gate in which it was surely looked for


class ClutterMap:
    """Learns from blobs that were no marker how likely there is another such blob at a place.

    Parameters
    ----------
    image_size : (int, int)
        Width and height, px.

    Notes
    -----
    Clutter is a uniform density, one blob a picture at least, and beside it the places at which something was seen
    before that was no marker. A camera that stands still sees that again at the same pixels: n sightings and m looks
    that found nothing give it the probability n / (n + m + 1) of being there, with the blob's own covariance. A marker
    is still recognised before it, if the prediction is sharper than that.
    """

    def __init__(self, image_size: tuple[int, int]) -> None:
        self._area = float(image_size[0] * image_size[1])
        self._mean = 0.0  # number of blobs in a frame that are no markers, and were not there before
        self._frame = 0
        self._places = np.empty((0, 2))
        self._sightings = np.empty(0)
        self._missing = np.empty(0)
        self._last = np.empty(0)

    def density(self, seen: Observations) -> Array:
        """Return how dense clutter is where each of M blobs was seen (M,), 1/px^2."""
        result = np.full(len(seen.places), (1.0 + self._mean) / self._area)
        if not len(self._places) or not len(seen.places):
            return result
        nearest, known = self._known(seen.places)
        n, m = self._sightings[nearest[known]], self._missing[nearest[known]]
        variance = np.sqrt(np.linalg.det(seen.covariances[known]))
        result[known] += n / (n + m + 1.0) / (2.0 * np.pi * variance)
        return result

    def still(self, seen: Observations) -> npt.NDArray[np.bool_]:
        """Return which of M blobs lie where something was seen in `STILL` frames or more (M,)."""
        nearest, known = self._known(seen.places)
        known[known] = self._sightings[nearest[known]] >= STILL
        return known

    def learn(self, seen: Observations, markers: npt.NDArray[np.bool_], gates: Sequence[Gate] | None = None) -> None:
        """Take a frame's blobs, of which some were `markers` (M,). It was searched in `gates`; None: as a whole."""
        self._frame += 1
        nearest, known = self._known(seen.places)
        looked = self._inside(gates)
        looked[nearest[known]] = False
        self._missing[looked] += 1.0
        again = known & ~markers
        self._places[nearest[again]] = seen.places[again]
        self._sightings[nearest[again]] += 1.0
        self._last[nearest[again]] = self._frame
        new = ~known & ~markers
        count = int(new.sum())
        self._mean += (count - self._mean) / min(MEMORY, self._frame)
        kept = (self._sightings >= STILL) | (self._frame - self._last < FORGOTTEN)
        self._places = np.concatenate([self._places[kept], seen.places[new]])
        self._sightings = np.concatenate([self._sightings[kept], np.ones(count)])
        self._missing = np.concatenate([self._missing[kept], np.zeros(count)])
        self._last = np.concatenate([self._last[kept], np.full(count, float(self._frame))])

    def _inside(self, gates: Sequence[Gate] | None) -> npt.NDArray[np.bool_]:
        """Return which places were surely searched."""
        if gates is None:
            return np.ones(len(self._places), bool)
        off = np.abs(self._places[:, None] - np.array([gate.centre for gate in gates]).reshape(-1, 2))
        wide = np.array([gate.covariance for gate in gates]).reshape(-1, 2, 2)
        return np.asarray((off < WITHIN * np.sqrt(np.diagonal(wide, axis1=1, axis2=2))).all(axis=2).any(axis=1))

    def _known(self, places: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.bool_]]:
        """Return the nearest place of each blob (M,), and whether it is that place (M,)."""
        if not len(self._places) or not len(places):
            return np.zeros(len(places), np.intp), np.zeros(len(places), bool)
        apart = np.linalg.norm(places[:, None] - self._places[None], axis=2)
        return apart.argmin(axis=1), apart.min(axis=1) < NEAR
