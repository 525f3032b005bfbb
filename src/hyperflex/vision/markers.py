"""Markers in a frame: sub-pixel places of coloured or bright blobs, with covariances, and the streaks of fast ones."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex.checks import Array, Flags
from hyperflex.core.image import blobs
from hyperflex.vision.colour import MarkerColour
from hyperflex.vision.video import Image

Box = tuple[int, int, int, int]  # px: left, top, right, bottom


class Gate(NamedTuple):
    """Expected position of a marker.

    Attributes
    ----------
    centre : (2,) array_like
        px.
    covariance : (2, 2) array_like
        Of the prediction, px^2.
    streak : float
        Its movement during the exposure, px.
    """

    centre: ArrayLike
    covariance: ArrayLike
    streak: float = 0.0


class Blobs(NamedTuple):
    """M blobs of the markers' colour in a frame, in no order; clutter may be among them.

    Attributes
    ----------
    places : (M, 2) float64
        Centres, px: for a blurred one the mean over the exposure, its place in the middle of it.
    covariances : (M, 2, 2) float64
        px^2; larger if a marker is partly covered or was separated from one that it touches.
    streaks : (M, 2) float64
        Movement during the exposure, px, up to its sign.
    areas : (M,) float64
        Relative to that of a whole marker, if that is known; else px^2.
    merged : (M,) bool
        Whether it was separated from one that it touches; which of the two is which is not known.
    """

    places: Array
    covariances: Array
    streaks: Array
    areas: Array
    merged: Flags


class MarkerDetector:
    """Finds markers of one colour in frames, and adapts to the light as it drifts.

    Parameters
    ----------
    colour : MarkerColour
        Colour of the markers.
    adapt : bool
        Whether the colour follows that of markers seen whole: by 10 % of the difference in each frame.

    Attributes
    ----------
    colour : MarkerColour
        The adapted colour.

    Notes
    -----
    A place is the mean of the shares that the marker covers of each pixel (see :class:`MarkerColour`), taken over the
    blob and two pixels around it. A disc that moves steadily during the exposure has the variance of a disc, and along
    its streak a twelfth of the streak's square more: so streak = sqrt(12 (l1 - l2)), l: eigenvalues of the blob's
    covariance.
    """

    FLOOR = 0.05  # px, least standard deviation of a place: compression, lens, pixels that are not square
    REACH = 3.5  # standard deviations of a gate that are searched
    MARGIN = 5.0  # px of wall around what is searched
    MOST_REGIONS = 150  # of a whole frame that are examined, the largest first
    MERGED = 1.6  # areas of a marker: a larger blob is two markers that touch
    BEND = 200.0  # px, radius of the arc that a streak may follow

    def __init__(self, colour: MarkerColour, *, adapt: bool = True) -> None:
        self.colour, self.adapt = colour, adapt

    def find(self, image: Image, gates: Sequence[Gate] | None = None) -> Blobs:
        """Return the blobs that may be markers.

        Parameters
        ----------
        image : (height, width, 3) uint8
        gates : sequence of Gate, optional
            Search only there. By default the whole frame is searched, where streaks fainter than a quarter are missed.
        """
        boxes = _joined(self._search(image) if gates is None else self._boxes(gates, image))
        table = np.concatenate([np.empty((0, blobs.COLUMNS + 1)), *(self._measure(image, box) for box in boxes)])
        table = table[self._plausible(table)]
        if self.adapt:
            self._follow(table)
        return self._blobs(table)

    @property
    def radius(self) -> float:
        """Of a marker at rest, px; about 5 if it is not known."""
        return float(np.sqrt((self.colour.area or 80.0) / np.pi))

    def resize(self, ratio: float) -> None:
        """Change the area of a marker by a ratio, because other objects may have been taken for markers."""
        if self.colour.area is not None:
            self.colour = replace(self.colour, area=self.colour.area * ratio)

    def _measure(self, image: Image, box: Box) -> Array:
        """Return the blobs in a box (M, COLUMNS + 1), as of ``blob_moments``, and the noise of a pixel's share."""
        left, top, right, bottom = box
        if right - left < 5 or bottom - top < 5:
            return np.empty((0, blobs.COLUMNS + 1))
        found = self.colour.blobs(np.ascontiguousarray(image[top:bottom, left:right]))
        found[:, [blobs.MEAN_U, blobs.MEAN_V]] += left, top
        return found

    def _boxes(self, gates: Sequence[Gate], image: Image) -> list[Box]:
        """Return the boxes of gates."""
        centres = np.array([gate.centre for gate in gates], dtype=np.float64).reshape(-1, 2)
        wide = np.array([gate.covariance for gate in gates], dtype=np.float64).reshape(-1, 2, 2)
        streaks = np.array([gate.streak for gate in gates], dtype=np.float64)
        reach = self.REACH * np.sqrt(np.diagonal(wide, axis1=1, axis2=2))
        reach += (1.2 * self.radius + 0.5 * streaks + self.MARGIN)[:, None]
        good = np.isfinite(centres + reach).all(axis=1)
        low, high = np.floor((centres - reach)[good]), np.ceil((centres + reach)[good]) + 1
        return _inside(np.hstack([low, high]), image)

    def _search(self, image: Image) -> list[Box]:
        """Return boxes around everything of the colour in the whole frame."""
        import cv2

        step = 2 if self.radius > 2.5 else 1  # larger markers are found at half the resolution
        height, width = image.shape[:2]
        small = cv2.resize(image, (width // step, height // step), interpolation=cv2.INTER_AREA) if step > 1 else image
        axes = self.colour.axes
        wall = np.median(small[::8, ::8].reshape(-1, 3), axis=0) @ axes.T
        contrast = axes @ self.colour.bgr - wall
        # two scores of a pixel, as levels: how far from wall (64) to marker (192) it is, and its distance in hue (128)
        along = 128.0 * contrast / max(float(contrast @ contrast), 1e-9)
        across = np.array([-along[1], along[0]])
        offset = [64.0 - along @ wall, 128.0 - across @ wall]
        scores = cv2.transform(small, np.column_stack([np.array([along, across]) @ axes, offset]))
        mask = cv2.inRange(scores, (96.0, 78.0), (255.0, 178.0))  # a quarter of the way: noise has more chances here
        _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        stats = stats[1:][stats[1:, 4] >= max(2.0, 0.1 * (self.colour.area or 30.0) / step**2)]
        stats = stats[np.argsort(-stats[:, 4])][: self.MOST_REGIONS]
        pad = int(self.MARGIN + self.radius)
        corners = np.column_stack([stats[:, :2] - 1, stats[:, :2] + stats[:, 2:4] + 1])
        return _inside(step * corners + [-pad, -pad, pad, pad], image)

    def _plausible(self, table: Array) -> Flags:
        """Return which blobs are more than noise, and no larger than two markers."""
        area, noise = table[:, blobs.AREA], table[:, -1]
        kept = area > np.maximum(5.0 * noise * np.sqrt(np.maximum(table[:, blobs.PIXELS], 1.0)), 2.0)
        if self.colour.area is not None:
            kept &= (area > 0.15 * self.colour.area) & (area < 2.6 * self.colour.area)
        return kept

    def _follow(self, table: Array) -> None:
        """Move the colour towards that of markers seen whole."""
        whole = table[:, blobs.FULL] >= 4.0
        if self.colour.area is not None:
            whole &= np.abs(table[:, blobs.AREA] / self.colour.area - 1.0) < 0.3
        if whole.any():
            self.colour = self.colour.adapted(np.median(table[whole, blobs.COLOUR : blobs.COLOUR + 3], axis=0), 0.1)

    def _blobs(self, table: Array) -> Blobs:
        """Return blobs as markers, with the properties of each; those of two areas as two."""
        places, area, noise = table[:, [blobs.MEAN_U, blobs.MEAN_V]], table[:, blobs.AREA], table[:, -1]
        moments = table[:, [blobs.COV_UU, blobs.COV_UV, blobs.COV_UV, blobs.COV_VV]].reshape(-1, 2, 2)
        values, vectors = np.linalg.eigh(moments)
        streaks = np.sqrt(12.0 * np.maximum(values[:, 1] - values[:, 0], 0.0))[:, None] * vectors[:, :, 1]
        variance = self.FLOOR**2 + (noise / area) ** 2 * 0.5 * table[:, blobs.SPREAD]
        variance += ((streaks**2).sum(axis=1) / (24.0 * self.BEND)) ** 2  # the mean of a bent streak is off
        share, merged = area / (self.colour.area or 1.0), np.zeros(len(table), bool)
        if self.colour.area is not None:
            merged = share > self.MERGED
            # A part that is missing, or that another marker adds, pulls the mean away: two discs of radius r at a
            # distance d have 1 + 2 d / (pi r) times the area of one, and their mean is d / 2 off each.
            missing = np.clip(1.0 - share - 0.12, 0.0, 1.0) + 0.3 * table[:, blobs.BORDER]
            added = 0.25 * np.pi * np.clip(share - 1.12, 0.0, None) * self.radius
            variance += (missing * (self.radius + np.sqrt(3.0 * np.maximum(values[:, 1], 0.0)))) ** 2 + added**2
        covariances = variance[:, None, None] * np.eye(2) + 1e-4 * streaks[:, :, None] * streaks[:, None, :]
        seen = Blobs(places, covariances, streaks, share, merged)
        return _separated(seen, self.radius) if merged.any() else seen


def _separated(seen: Blobs, radius: float) -> Blobs:
    """Return the blobs with each merged one as two, apart along its longer axis.

    Two discs at a distance D have a variance of (D / 2)^2 along their line beyond that of one; a streak of one would
    have half of the area.
    """
    each = np.repeat(np.arange(len(seen.areas)), np.where(seen.merged, 2, 1))
    merged, half = seen.merged[each], seen.streaks[each] / np.sqrt(12.0)
    side = np.where(merged, np.where(np.diff(each, prepend=-1) > 0, 1.0, -1.0), 0.0)
    doubt = np.where(merged, 0.15**2 * (np.linalg.norm(half, axis=1) + radius) ** 2, 0.0)
    return Blobs(
        seen.places[each] + side[:, None] * half,
        seen.covariances[each] + doubt[:, None, None] * np.eye(2),
        np.where(merged[:, None], 0.0, seen.streaks[each]),
        np.where(merged, 0.5, 1.0) * seen.areas[each],
        merged,
    )


def _inside(boxes: npt.NDArray[np.generic], image: Image) -> list[Box]:
    """Return the parts of boxes (B, 4) that are in the picture."""
    height, width = image.shape[:2]
    return [(u, v, a, b) for u, v, a, b in np.clip(boxes, 0, [width, height, width, height]).astype(int).tolist()]


def _joined(boxes: list[Box]) -> list[Box]:
    """Return boxes with those that overlap joined, so that each blob is found once; empty ones are dropped."""
    joined: list[Box] = []
    for box in (box for box in boxes if box[2] > box[0] and box[3] > box[1]):
        whole = box
        while hits := [
            o for o in joined if o[0] < whole[2] and whole[0] < o[2] and o[1] < whole[3] and whole[1] < o[3]
        ]:
            joined = [o for o in joined if o not in hits]
            left, top, right, bottom = zip(whole, *hits, strict=True)
            whole = min(left), min(top), max(right), max(bottom)
        joined.append(whole)
    return sorted(joined)
