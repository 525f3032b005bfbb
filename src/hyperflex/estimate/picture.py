"""Pictures of a tracked rope: its estimate, where its markers were expected and seen, and how certain that is."""

import numpy as np

from hyperflex.checks import Array
from hyperflex.estimate.measurements import CurveMeasurement
from hyperflex.estimate.tracker import RopeTracker, TrackedFrame
from hyperflex.vision import Image

Colour = tuple[int, int, int]

LIKELY = 2.1460  # standard deviations of a place in the plane that contain 90 % (chi square, 2 degrees of freedom)
WHITE, GREEN, YELLOW, BLUE, DARK = (255, 255, 255), (60, 200, 60), (0, 230, 255), (255, 130, 20), (30, 30, 30)
_BITS = 4  # of a pixel's fraction that OpenCV draws with
_SMALLEST, _LARGEST = 1.5, 0.5  # px, and part of the picture's height: half widths of regions that are drawn


def draw_frame(image: Image, tracker: RopeTracker, result: TrackedFrame, caption: list[str] | None = None) -> Image:
    """Return a frame with the estimated rope (blue), expected (green) and seen markers (yellow), and 90 % regions.

    Of a rope without markers, the places where it was seen are yellow dots.

    Parameters
    ----------
    image : (height, width, 3) uint8
    tracker : RopeTracker
    result : TrackedFrame
        The tracker's result of the frame.
    caption : list of str, optional
        By default the time and how many markers were seen.
    """
    import cv2

    shown = image.copy()
    curve = isinstance(tracker.measurement, CurveMeasurement)
    what = "pieces of the rope" if curve else "markers"
    lines = caption or [f"{result.t:.2f} s   {int(result.seen.sum())} of {result.seen.size} {what}"]
    if result.state is None:
        lines = [*lines, "searching for the rope"]
    else:
        _draw_rope(shown, *tracker.shape(result.state))
        for place, wide in zip(result.predicted, result.gates, strict=True) if not curve else ():
            _draw_region(shown, place, wide, GREEN, 2.0 * tracker.measurement.radius + 2.0)
        for k in np.flatnonzero(result.seen).tolist():
            u, v = np.round(result.pixels[k]).astype(int).tolist()
            if curve:
                cv2.circle(shown, (u, v), 2, YELLOW, -1, cv2.LINE_AA)
                continue
            cv2.drawMarker(shown, (u, v), YELLOW, cv2.MARKER_CROSS, 8, 1, cv2.LINE_AA)
            _write(shown, str(k + 1), (u + 14, v + 4), 0.42, YELLOW)
    for row, line in enumerate(reversed(lines)):
        _write(shown, line, (12, shown.shape[0] - 14 - 24 * row), 0.55, WHITE)
    return shown


def _draw_rope(image: Image, line: Array, covariances: Array) -> None:
    """Draw a line (m, 2), px, and the region that contains each of its places with 90 %."""
    import cv2

    good = np.isfinite(line).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    line, wide = line[good], covariances[good]
    if len(line) < 2:
        return
    along = np.gradient(line, axis=0)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    half = LIKELY * np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", across, wide, across), 0.0))
    side, tinted = np.minimum(half, _LARGEST * image.shape[0])[:, None] * across, image.copy()
    cv2.fillPoly(tinted, [_fixed(np.concatenate([line + side, (line - side)[::-1]]))], BLUE, cv2.LINE_AA, _BITS)
    cv2.addWeighted(tinted, 0.35, image, 0.65, 0.0, dst=image)
    cv2.polylines(image, [_fixed(line)], False, BLUE, 1, cv2.LINE_AA, _BITS)
    _draw_region(image, line[-1], wide[-1], BLUE)


def _draw_region(image: Image, place: Array, wide: Array, colour: Colour, radius: float = 0.0) -> None:
    """Draw the ellipse that contains a place with 90 %, `radius` (px) larger."""
    import cv2

    if not np.isfinite(place).all() or not np.isfinite(wide).all():
        return
    values, vectors = np.linalg.eigh(wide)
    axes = LIKELY * np.sqrt(np.maximum(values, 0.0)) + radius
    if _SMALLEST <= axes[1] <= _LARGEST * image.shape[0]:
        angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        centre, size = _fixed(place).tolist(), _fixed(axes[::-1]).tolist()
        cv2.ellipse(image, centre, size, angle, 0.0, 360.0, colour, 1, cv2.LINE_AA, _BITS)


def _write(image: Image, text: str, at: tuple[int, int], size: float, colour: Colour) -> None:
    """Write text with a dark shadow, so that it is legible on any picture."""
    import cv2

    for shade, shift in ((DARK, 1), (colour, 0)):
        place = (at[0] + shift, at[1] + shift)
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, shade, 1, cv2.LINE_AA)


def _fixed(places: Array) -> np.typing.NDArray[np.int32]:
    """Return pixels as OpenCV's fixed-point numbers; far ones are clipped."""
    return np.asarray(np.round(np.clip(places, -2e4, 2e4) * 2**_BITS), np.int32)
