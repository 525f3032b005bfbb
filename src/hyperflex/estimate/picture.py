"""Pictures of what is known of a rope: the rope, where its markers were looked for and seen, and how sure that is."""

from itertools import pairwise

import numpy as np

from hyperflex.checks import Array
from hyperflex.vision import Image

LIKELY = 2.1460  # standard deviations of a place in the plane that hold 90 % (chi square, 2 degrees of freedom)
WHITE, GREEN, YELLOW, BLUE, DARK = (255, 255, 255), (60, 200, 60), (0, 230, 255), (255, 130, 20), (30, 30, 30)
_FINE = 4  # bits of a pixel's fraction that OpenCV draws with
_LEAST = 1.5  # px, half width of a region below which the line itself hides it
_WIDEST = 0.5  # of the picture's height, half width of a region beyond which it says nothing


def draw_rope(image: Image, line: Array, covariances: Array) -> None:
    """Draw a rope, and the region that holds each of its places with 90 %, where that is wider than the line (blue).

    Parameters
    ----------
    image : (height, width, 3) uint8
        Drawn on.
    line : (m, 2) float64
        Places along the rope, px; NaN where they are behind the camera.
    covariances : (m, 2, 2) float64
        Of these, px^2.
    """
    import cv2

    good = np.isfinite(line).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    line, wide = line[good], covariances[good]
    if len(line) < 2:
        return
    along = np.gradient(line, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    half = LIKELY * np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", across, wide, across), 0.0))
    half = np.minimum(half, _WIDEST * image.shape[0])[:, None]
    if half.max() > _LEAST:
        tinted = image.copy()
        sides = np.stack([line + half * across, line - half * across], axis=1)
        for one, two in pairwise(sides):
            cv2.fillConvexPoly(tinted, cv2.convexHull(_fine(np.concatenate([one, two]))), BLUE, cv2.LINE_AA, _FINE)
        cv2.addWeighted(tinted, 0.35, image, 0.65, 0.0, dst=image)
    cv2.polylines(image, [_fine(line)], False, BLUE, 1, cv2.LINE_AA, _FINE)
    _draw_region(image, line[-1], wide[-1], BLUE)


def draw_markers(image: Image, expected: Array, covariances: Array, seen: Array, radius: float) -> None:
    """Draw where markers were looked for (green, 90 %, and around it `radius`, px) and seen (yellow, with numbers).

    Parameters
    ----------
    image : (height, width, 3) uint8
        Drawn on.
    expected : (K, 2) float64
        px; NaN: nothing was expected.
    covariances : (K, 2, 2) float64
        Of these, px^2.
    seen : (K, 2) float64
        px; NaN: not seen.
    radius : float
        px.
    """
    import cv2

    for place, wide in zip(expected, covariances, strict=True):
        _draw_region(image, place, wide, GREEN, radius)
    for k, place in enumerate(seen):
        if not np.isfinite(place).all():
            continue
        at = np.round(place).astype(int)
        cv2.drawMarker(image, at.tolist(), YELLOW, cv2.MARKER_CROSS, 8, 1, cv2.LINE_AA)
        _write(image, str(k + 1), [int(at[0]) + 14, int(at[1]) + 4], 0.42, YELLOW)


def draw_caption(image: Image, lines: list[str]) -> None:
    """Write lines at the bottom left of a picture."""
    for k, words in enumerate(reversed(lines)):
        _write(image, words, (12, image.shape[0] - 14 - 24 * k), 0.55, WHITE)


def _draw_region(image: Image, place: Array, wide: Array, colour: tuple[int, int, int], radius: float = 0.0) -> None:
    """Draw the ellipse that holds a place with 90 %, `radius` (px) wider."""
    import cv2

    if not np.isfinite(place).all() or not np.isfinite(wide).all():
        return
    values, vectors = np.linalg.eigh(wide)
    axes = LIKELY * np.sqrt(np.maximum(values, 0.0)) + radius
    if axes[1] < _LEAST or axes[1] > _WIDEST * image.shape[0]:
        return
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    centre, size = _fine(place), _fine(axes[::-1])
    cv2.ellipse(image, centre.tolist(), size.tolist(), angle, 0.0, 360.0, colour, 1, cv2.LINE_AA, _FINE)


def _write(
    image: Image, words: str, at: list[int] | tuple[int, int], size: float, colour: tuple[int, int, int]
) -> None:
    """Write words with a dark shadow, so that they are read on any picture."""
    import cv2

    for shade, shift in ((DARK, 1), (colour, 0)):
        place = (at[0] + shift, at[1] + shift)
        cv2.putText(image, words, place, cv2.FONT_HERSHEY_SIMPLEX, size, shade, 1, cv2.LINE_AA)


def _fine(places: Array) -> np.typing.NDArray[np.int32]:
    """Return pixels as OpenCV takes them with a fraction; far ones are cut."""
    return np.asarray(np.round(np.clip(places, -2e4, 2e4) * 2**_FINE), np.int32)
