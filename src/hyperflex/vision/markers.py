"""Markers in a frame: sub-pixel places of coloured or bright blobs, with covariances, and the streaks of fast ones."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.core.image import blobs
from hyperflex.vision.camera import Camera
from hyperflex.vision.colour import MarkerColour
from hyperflex.vision.plane import AS_CALIBRATED, PlaneAdjustment
from hyperflex.vision.video import Image

FLOOR = 0.05  # px, standard deviation of a place at least: compression, lens, pixels that are no squares
_REACH = 3.5  # standard deviations of a gate that are searched
_MARGIN = 5.0  # px of wall around what is looked for
_SEARCH_SHARE = 0.25  # in a whole frame, where noise has more chances
_MOST_REGIONS = 150
_MERGED = 1.6  # areas of a marker, from which a blob is two of them
_BEND = 200.0  # px, radius of the arc that a streak may follow
_RATE = 0.1  # of the colour's adaptation a frame


class Gate(NamedTuple):
    """Where a marker is expected.

    Attributes
    ----------
    centre : (2,) array_like
        px.
    covariance : (2, 2) array_like
        Of the prediction, px^2.
    streak : float
        By how much it moves during the exposure, px.
    """

    centre: npt.ArrayLike
    covariance: npt.ArrayLike
    streak: float = 0.0


class Observations(NamedTuple):
    """M markers seen in a frame, in no order.

    Attributes
    ----------
    places : (M, 2) float64
        Centres, px: of a blurred one the mean over the exposure, its place in the middle of it.
    covariances : (M, 2, 2) float64
        px^2; larger where a marker is covered in part or was taken out of two that touch.
    streaks : (M, 2) float64
        Movement during the exposure, px, up to its sign.
    streak_stds : (M,) float64
        Standard deviation of its length, px.
    areas : (M,) float64
        Over that of a whole marker, where that is known; else px^2.
    merged : (M,) bool
        Whether two that touch were taken apart; which of the two is which is not known.
    """

    places: Array
    covariances: Array
    streaks: Array
    streak_stds: Array
    areas: Array
    merged: npt.NDArray[np.bool_]

    def in_plane(self, camera: Camera, adjustment: PlaneAdjustment = AS_CALIBRATED) -> tuple[Array, Array]:
        """Return places (M, 2), m, and covariances (M, 2, 2), m^2, in the swing plane."""
        places = camera.locate(self.places, adjustment)
        slopes = np.linalg.inv(camera.linearize(np.nan_to_num(places), adjustment).by_point)
        return places, slopes @ self.covariances @ slopes.transpose(0, 2, 1)


class MarkerDetector:
    """Finds markers of one colour in frames, and follows their colour as the light drifts.

    Parameters
    ----------
    colour : MarkerColour
        What to look for.
    adapt : bool
        Whether the colour follows what is seen: 10 % of the way a frame, from markers seen whole.

    Attributes
    ----------
    colour : MarkerColour
        As it is by now.

    Notes
    -----
    A place is the mean of the shares that the marker covers of each pixel (see :class:`MarkerColour`), taken over the
    blob and two pixels around it. A disc that moves steadily during the exposure leaves the variance of a disc and a
    twelfth of its streak's square along it: so streak = sqrt(12 (l1 - l2)), l: eigenvalues of the blob's covariance.
    """

    def __init__(self, colour: MarkerColour, *, adapt: bool = True) -> None:
        self.colour, self.adapt = colour, adapt

    def find(self, image: Image, gates: Sequence[Gate] | None = None) -> Observations:
        """Return the markers seen.

        Parameters
        ----------
        image : (height, width, 3) uint8
        gates : sequence of Gate, optional
            Search only there. Left out: search the whole frame, where streaks fainter than a quarter are not found.

        Returns
        -------
        Observations
            All blobs of the colour that may be markers, clutter of that colour among them.
        """
        if gates is None:
            boxes = self._search(image)
        else:
            boxes = _joined(self._boxes(gates, image.shape))
        measured = {box: self._measure(image, box) for box in boxes}
        whole = _joined([self._around(box, found[0], image.shape) for box, found in measured.items()])
        blobs_of = [measured.get(box) or self._measure(image, box) for box in whole]
        rows = [found for found, _ in blobs_of]
        noises = [np.full(len(found), noise) for found, noise in blobs_of]
        table = np.concatenate([np.empty((0, blobs.COLUMNS)), *rows])
        noise_of = np.concatenate([np.empty(0), *noises])
        kept = self._plausible(table, noise_of)
        if self.adapt:
            self._follow(table[kept])
        return self._observations(table[kept], noise_of[kept])

    def _measure(self, image: Image, box: tuple[int, int, int, int]) -> tuple[Array, float]:
        """Return the blobs in a part of the picture (M, columns), and the noise of a pixel's share there."""
        left, top, right, bottom = box
        if right - left < 5 or bottom - top < 5:
            return np.empty((0, blobs.COLUMNS)), 0.0
        found, noise = self.colour.blobs(np.ascontiguousarray(image[top:bottom, left:right]))
        found[:, blobs.MEAN_U] += left
        found[:, blobs.MEAN_V] += top
        return found, noise

    def _around(
        self, box: tuple[int, int, int, int], found: Array, shape: tuple[int, ...]
    ) -> tuple[int, int, int, int]:
        """Return a part of the picture, wider where its edge cuts a blob."""
        if not (found[:, blobs.BORDER] > 0.0).any():
            return box
        more = int(np.ceil(2.0 * self.radius + 2.0 * _MARGIN))
        left, top, right, bottom = box
        return max(left - more, 0), max(top - more, 0), min(right + more, shape[1]), min(bottom + more, shape[0])

    def measure_area(self, image: Image) -> float:
        """Set the markers' area to the median of those seen at rest in a frame, px^2, and return it."""
        self.colour = MarkerColour(self.colour.bgr, self.colour.bright)
        seen = self.find(image)
        still = np.linalg.norm(seen.streaks, axis=1) < 0.5 * np.sqrt(np.maximum(seen.areas, 1e-9))
        area = float(np.median(seen.areas[still])) if still.any() else float("nan")
        if area > 0.0:
            self.colour = MarkerColour(self.colour.bgr, self.colour.bright, area)
        return area

    @property
    def radius(self) -> float:
        """Of a marker at rest, px; about 5 where it is not known."""
        return float(np.sqrt((self.colour.area or 80.0) / np.pi))

    def _boxes(self, gates: Sequence[Gate], shape: tuple[int, ...]) -> list[tuple[int, int, int, int]]:
        """Return the parts of the picture that gates ask for: left, top, right, bottom of each."""
        centres = np.array([gate.centre for gate in gates], dtype=np.float64).reshape(-1, 2)
        wide = np.array([gate.covariance for gate in gates], dtype=np.float64).reshape(-1, 2, 2)
        streaks = np.array([gate.streak for gate in gates], dtype=np.float64)
        spread = np.sqrt(np.diagonal(wide, axis1=1, axis2=2))
        reach = _REACH * spread + (1.2 * self.radius + 0.5 * streaks + _MARGIN)[:, None]
        good = np.isfinite(centres + reach).all(axis=1)
        centres, reach = centres[good], reach[good]
        most = shape[1::-1]
        low, high = np.clip(np.floor(centres - reach), 0, most), np.clip(np.ceil(centres + reach) + 1, 0, most)
        return [(u, v, a, b) for u, v, a, b in np.hstack([low, high]).astype(int).tolist()]

    def _search(self, image: Image) -> list[tuple[int, int, int, int]]:
        """Return the parts of the whole picture where something of the colour is."""
        import cv2

        step = 2 if self.radius > 2.5 else 1  # larger markers are found on a picture of half the size, too
        height, width = image.shape[:2]
        if step > 1:
            image = cv2.resize(image, (width // step, height // step), interpolation=cv2.INTER_AREA)
        axes = self.colour.axes
        target = axes @ self.colour.bgr
        wall = np.median(image[::8, ::8].reshape(-1, 3), axis=0) @ axes.T
        contrast = target - wall
        size = float(contrast @ contrast)
        along = 128.0 * contrast / max(size, 1e-9)
        across = np.array([-along[1], along[0]])  # hues of other things
        offset = [64.0 - along @ wall, 128.0 - across @ wall]
        scores = cv2.transform(image, np.column_stack([np.array([along, across]) @ axes, offset]))
        mask = cv2.inRange(scores, (64.0 + 128.0 * _SEARCH_SHARE, 78.0), (255.0, 178.0))
        _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        least = max(2.0, 0.1 * (self.colour.area or 30.0) / step**2)
        stats = stats[1:][stats[1:, 4] >= least]
        stats = stats[np.argsort(-stats[:, 4])][:_MOST_REGIONS]
        pad = int(_MARGIN + self.radius)
        corners = step * np.column_stack([stats[:, :2] - 1, stats[:, :2] + stats[:, 2:4] + 1]) + [-pad, -pad, pad, pad]
        inside = np.clip(corners, 0, [width, height, width, height])
        return _joined([(u, v, a, b) for u, v, a, b in inside.tolist()])

    def _plausible(self, table: Array, noise: Array) -> npt.NDArray[np.bool_]:
        """Return which blobs are more than noise, and no larger than two markers."""
        area = table[:, blobs.AREA]
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
            seen = np.sort(table[whole, blobs.COLOUR : blobs.COLOUR + 3], axis=0)
            middle = 0.5 * (seen[(len(seen) - 1) // 2] + seen[len(seen) // 2])
            self.colour = self.colour.adapted(middle, _RATE)

    def _observations(self, table: Array, noise: Array) -> Observations:
        """Return blobs as markers, with what is known of each; those of two areas as two."""
        places = table[:, [blobs.MEAN_U, blobs.MEAN_V]]
        moments = table[:, [blobs.COV_UU, blobs.COV_UV, blobs.COV_UV, blobs.COV_VV]].reshape(-1, 2, 2)
        values, vectors = np.linalg.eigh(moments)
        longer = np.maximum(values[:, 1] - values[:, 0], 0.0)
        streaks = np.sqrt(12.0 * longer)[:, None] * vectors[:, :, 1]
        area, spread = table[:, blobs.AREA], table[:, blobs.SPREAD]
        moment_std = noise * spread / np.sqrt(np.maximum(table[:, blobs.PIXELS], 1.0)) / area
        moment_std = np.hypot(moment_std, 0.02 * values[:, 0])
        length = np.linalg.norm(streaks, axis=1)
        streak_stds = 6.0 * moment_std / np.maximum(length, np.sqrt(12.0 * moment_std) + 1e-9)
        variance = FLOOR**2 + (noise / area) ** 2 * 0.5 * spread
        variance += (length**2 / (24.0 * _BEND)) ** 2  # the mean of a bent streak lies off its middle
        covariances = variance[:, None, None] * np.eye(2) + 1e-4 * streaks[:, :, None] * streaks[:, None, :]
        share = area / (self.colour.area or 1.0)
        merged = np.zeros(len(table), bool)
        if self.colour.area is not None:
            merged = share > _MERGED
            covariances += self._covered(share, values, table[:, blobs.BORDER])[:, None, None] * np.eye(2)
        seen = Observations(places, covariances, streaks, streak_stds, share, merged)
        return _taken_apart(seen, self.radius) if merged.any() else seen

    def _covered(self, share: Array, values: Array, border: Array) -> Array:
        """Return the variance, px^2, that markers covered in part get, and those that touch something of their colour.

        The part that is missing, or is too much, pulls the mean away: two discs of radius r that are a distance d apart
        have 1 + 2 d / (pi r) times the area of one, and their mean lies d / 2 off each.
        """
        missing = np.clip(1.0 - share - 0.12, 0.0, 1.0) + 0.3 * border
        merged = 0.25 * np.pi * np.clip(share - 1.12, 0.0, None) * self.radius
        return np.asarray((missing * (self.radius + np.sqrt(3.0 * np.maximum(values[:, 1], 0.0)))) ** 2 + merged**2)


def _taken_apart(seen: Observations, radius: float) -> Observations:
    """Return the observations with each blob of two markers as two, apart along its longer axis.

    Two discs at a distance D have a variance of (D / 2)^2 along their line beyond that of one; a streak of one would
    have half of the area.
    """
    parts = []
    for k in range(len(seen.places)):
        one = [field[k] for field in seen]
        if not seen.merged[k]:
            parts.append([one])
            continue
        half = one[2] / np.sqrt(12.0)
        doubt = (0.15 * np.linalg.norm(half) + 0.15 * radius) ** 2 * np.eye(2)
        parts.append(
            [
                [one[0] + side * half, one[1] + doubt, np.zeros(2), 2.0 * radius, 0.5 * one[4], True]
                for side in (1.0, -1.0)
            ]
        )
    rows = [row for part in parts for row in part]
    return Observations(*(np.array([row[c] for row in rows]) for c in range(6)))


def _joined(boxes: Sequence[tuple[int, int, int, int]]) -> list[tuple[int, int, int, int]]:
    """Return boxes (left, top, right, bottom) with those that overlap joined, so that each blob is found once."""
    left = [box for box in boxes if box[2] > box[0] and box[3] > box[1]]
    joined: list[tuple[int, int, int, int]] = []
    while left:
        box = left.pop()
        touching = True
        while touching:
            hits = [o for o in [*left, *joined] if o[0] < box[2] and box[0] < o[2] and o[1] < box[3] and box[1] < o[3]]
            touching = bool(hits)
            for other in hits:
                (left if other in left else joined).remove(other)
                box = (min(box[0], other[0]), min(box[1], other[1]), max(box[2], other[2]), max(box[3], other[3]))
        joined.append(box)
    return sorted(joined)
