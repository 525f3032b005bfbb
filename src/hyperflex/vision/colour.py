"""The colour of markers: from one click or one frame, and the share of each pixel that a marker covers."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, Flags
from hyperflex.core.image import blobs
from hyperflex.core.image.discriminant import discriminant
from hyperflex.errors import InvalidInput
from hyperflex.vision.video import Image

LEAST_CHROMA = 35.0  # levels: a colour with less counts as grey
_LEAST_CONTRAST = 30.0  # levels between marker and surroundings
NOISE = 1.5  # levels, least noise of a channel
_LEAST_MARKERS = 3  # of one colour and size in a frame
_TOLERANCE = 28.0  # levels by which pixels of a clicked marker may differ from the clicked one
_SIGMAS, _LEAST_SHARE = 4.5, 0.06  # threshold of a pixel's share: times its noise, and at least
# two directions across grey: shade, shadow and grey ropes do not change them
_CHROMA = np.array([[-1.0, -1.0, 2.0], [1.0, -1.0, 0.0]]) / np.array([[6.0**0.5], [2.0**0.5]])
_GREY = np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]) / 3.0**0.5


@dataclass(frozen=True, eq=False)
class MarkerColour:
    """The colour of markers, and how large they are.

    Parameters
    ----------
    bgr : (3,) array_like
        Blue, green, red, 0 to 255.
    bright : bool
        Detect them by brightness (reflecting or glowing markers, or dark ones on a bright wall) instead of chroma.
    area : float or None
        Of a marker at rest, px^2; a blurred one covers as much in total. None: not known.

    Notes
    -----
    A pixel that a marker covers in part is a mixture, linear in the share covered. With chroma, grey is projected out
    first, so that shade, shadow, and a black, grey or white rope do not count. The share is Fisher's linear
    discriminant between the marker's colour and the pixels around it, scaled to 0 for these and 1 for the marker.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.full((60, 80, 3), 180, np.uint8)
    >>> image[25:35, 30:40] = (40, 30, 210)
    >>> found = MarkerColour.from_click(image, (34, 30))
    >>> found.bgr.round().tolist(), found.bright
    ([40.0, 30.0, 210.0], False)
    """

    bgr: Array
    bright: bool = False
    area: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "bgr", checks.array("bgr", self.bgr, (3,), sign="nonnegative"))
        if self.area is not None:
            object.__setattr__(self, "area", checks.number("area", self.area, sign="positive", unit="px^2"))
        if not self.bright and np.linalg.norm(_CHROMA @ self.bgr) < LEAST_CHROMA:
            raise InvalidInput(
                "the colour is too grey to be detected by its chroma",
                got=np.round(self.bgr).tolist(),
                allowed=f"a chroma of at least {LEAST_CHROMA:g} levels",
                fix="Take a stronger colour, or bright=True for markers detected by their brightness",
            )

    @classmethod
    def from_click(cls, image: Image, place: ArrayLike) -> "MarkerColour":
        """Return the colour of the marker at a place in a frame, and its area, edges by the shares that it covers.

        A marker that is nearly grey is detected by its brightness.

        Parameters
        ----------
        image : (height, width, 3) uint8
        place : (2,) array_like
            A pixel of the marker, u, v.

        Raises
        ------
        InvalidInput
            If the point is not in the picture, or its surface does not differ from its surroundings.
        """
        colour, inside, around = surface(image, place)
        if inside.mean() > 0.05 or not around.any():
            raise InvalidInput(
                "the click shows a large surface, not a marker",
                got=f"{int(inside.sum())} px of one colour",
                allowed="at most 5 % of the picture",
                fix="Click the middle of a marker",
            )
        wall = np.median(image[around], axis=0)
        grey = bool(np.linalg.norm(_CHROMA @ (colour - wall)) < LEAST_CHROMA)
        contrast = float(np.linalg.norm((_GREY if grey else _CHROMA) @ (colour - wall)))
        if contrast < _LEAST_CONTRAST:
            raise InvalidInput(
                "the marker does not stand out against its surroundings: contrast in levels",
                got=round(contrast, 1),
                allowed=f"at least {_LEAST_CONTRAST:g}",
                fix="Take markers of a stronger colour, or more light",
            )
        found = cls(colour, grey, float(inside.sum()))
        return replace(found, area=found._area_about(image, inside) or found.area)

    @classmethod
    def from_frame(cls, image: Image) -> "MarkerColour":
        """Return the colour that most small things of one size in a frame (height, width, 3), uint8, share.

        Raises
        ------
        InvalidInput
            If no colour has so many; then use :meth:`from_click`.
        """
        import cv2

        chroma = cv2.transform(cv2.GaussianBlur(image, (3, 3), 0).astype(np.float32), _CHROMA.astype(np.float32))
        strong = np.hypot(chroma[..., 0], chroma[..., 1])
        hue = np.arctan2(chroma[..., 1], chroma[..., 0])
        best: tuple[float, MarkerColour | None, list[Flags]] = (0.0, None, [])
        for centre in np.linspace(-np.pi, np.pi, 24, endpoint=False):
            near = np.abs((hue - centre + np.pi) % (2.0 * np.pi) - np.pi) < np.pi / 12
            mask = (near & (strong > LEAST_CHROMA)).astype(np.uint8)
            _, label, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
            compact = [k for k in range(1, len(stats)) if _is_compact(stats[k])]
            if len(compact) < _LEAST_MARKERS:
                continue
            group = _alike(stats[compact, cv2.CC_STAT_AREA].astype(float))
            members = np.isin(label, np.array(compact)[group])
            score = float(group.sum()) * (1.0 + 0.002 * float(np.median(strong[members])))
            if group.sum() >= _LEAST_MARKERS and score > best[0]:
                pixels = image[members & (strong > 0.8 * np.percentile(strong[members], 90))]
                best = score, cls(np.median(pixels, axis=0)), [label == k for k in compact]
        _, found, things = best
        if found is None:
            raise InvalidInput(
                "no colour of markers was found in the frame",
                allowed=f"at least {_LEAST_MARKERS} small things of one strong colour and size",
                fix="Show a marker: MarkerColour.from_click(image, (u, v))",
            )
        areas = np.array([area for area in (found._area_about(image, thing) for thing in things) if area])
        return replace(found, area=float(np.median(areas[_alike(areas)])) if areas.size else None)

    def adapted(self, bgr: Array, rate: float) -> "MarkerColour":
        """Return this colour moved by a share `rate` towards one seen (3,), unless that would be too grey."""
        moved = self.bgr + rate * (np.clip(bgr, 0.0, 255.0) - self.bgr)
        if not self.bright and np.linalg.norm(_CHROMA @ moved) < LEAST_CHROMA:
            return self
        return replace(self, bgr=moved)

    def _area_about(self, image: Image, inside: Flags) -> float | None:
        """Return the area of the blob whose core is `inside` (height, width), px^2; None if no blob is found."""
        v, u = np.nonzero(inside)
        first, last = np.array([u.min(), v.min()]), np.array([u.max(), v.max()])
        around = last - first + 6  # px on each side: most of the region is wall
        left, top = np.maximum(first - around, 0)
        right, bottom = last + around + 1
        found = self.blobs(np.ascontiguousarray(image[top:bottom, left:right]))
        off = found[:, [blobs.MEAN_U, blobs.MEAN_V]] + [left, top] - [u.mean(), v.mean()]
        return float(found[np.linalg.norm(off, axis=1).argmin(), blobs.AREA]) if len(found) else None

    @property
    def axes(self) -> Array:
        """Directions (2, 3) in blue, green, red that detection uses; by brightness the second one is zero."""
        return np.asarray(_GREY if self.bright else _CHROMA)

    def blobs(self, region: Image) -> Array:
        """Return the blobs of this colour in a part of the picture.

        Parameters
        ----------
        region : (h, w, 3) uint8
            A small part of the picture, contiguous in memory; most of it is not covered by markers.

        Returns
        -------
        (M, COLUMNS + 1) float64
            Moments of each blob, as of ``blob_moments``, px from the region's first pixel; and the standard deviation
            of the share of a pixel where no marker is.
        """
        share, table = np.empty(4), np.empty((blobs.LARGEST, blobs.COLUMNS + 1))
        contrast = np.array([0.5 * _LEAST_CONTRAST, NOISE])
        noise = float(discriminant(region, self.axes, self.axes @ self.bgr, contrast, share))
        if noise == 0.0:  # nothing can be detected here
            return table[:0]
        weights = np.empty(region.shape[:2])
        blobs.weigh(region, share, weights)
        table = table[: blobs.blob_moments(region, weights, max(_SIGMAS * noise, _LEAST_SHARE), table)]
        table[:, -1] = noise
        return table


def surface(image: Image, place: ArrayLike) -> tuple[Array, Flags, Flags]:
    """Return the colour (3,) of the surface at a place (2,), px, and masks of it and of its surroundings.

    Raises
    ------
    InvalidInput
        If the place is not in the picture.
    """
    import cv2

    u, v = np.rint(checks.array("place", place, (2,), unit="px")).astype(int).tolist()
    height, width = image.shape[:2]
    if not (0 <= u < width and 0 <= v < height):
        raise InvalidInput("the click is not in the picture", got=[u, v], allowed=f"within {width} x {height} px")
    smooth = cv2.medianBlur(image, 3)
    mask = np.zeros((height + 2, width + 2), np.uint8)
    flags = 8 | cv2.FLOODFILL_MASK_ONLY | cv2.FLOODFILL_FIXED_RANGE
    cv2.floodFill(smooth, mask, (u, v), 0, (_TOLERANCE,) * 3, (_TOLERANCE,) * 3, flags)
    inside = (mask[1:-1, 1:-1] > 0).astype(np.uint8)
    core = cv2.erode(inside, np.ones((3, 3), np.uint8)) > 0
    far, near = (cv2.dilate(inside, np.ones((size, size), np.uint8)) > 0 for size in (9, 5))
    return np.median(image[core if core.any() else inside > 0], axis=0), inside > 0, far & ~near


def _alike(sizes: Array) -> Flags:
    """Return which of some sizes (M,) are in the largest group of those that differ by less than a factor of 1.6."""
    alike = np.abs(np.log(sizes / sizes[:, None])) < np.log(1.6)
    return np.asarray(alike[int(np.argmax(alike.sum(axis=1)))])


def _is_compact(stats: npt.NDArray[np.int32]) -> bool:
    """Whether a component (OpenCV's left, top, width, height, area) may be a marker at rest."""
    _, _, width, height, area = (float(value) for value in stats)
    return area >= 8.0 and max(width, height) <= 2.0 * min(width, height) and area >= 0.5 * width * height
