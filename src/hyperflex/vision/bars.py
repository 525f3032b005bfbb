"""Coloured bars in a frame, such as the links of a pendulum without markers: centre, angle and length of each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.interruption import interruptible
from hyperflex.recording import Recording
from hyperflex.vision.colour import surface
from hyperflex.vision.video import Frame, Image, VideoReader, follow_video

FLOOR = 0.3  # px, least standard deviation of a place across a bar


class BarObservations(NamedTuple):
    """J bars in a frame, in the order of the colours; NaN for a bar that is not seen.

    Attributes
    ----------
    centres : (J, 2) float64
        px.
    angles : (J,) float64
        Of the longer axis, rad, 0 along +u, positive towards +v (downwards), -pi/2 to pi/2: half turns are ambiguous.
    lengths : (J,) float64
        px, of a rectangle with the same moments.
    stds : (J,) float64
        Standard deviations of the angles, rad.
    areas : (J,) float64
        Relative to that of the whole bar, if it is known; else px^2. Less than 1 if another bar covers it.
    """

    centres: Array
    angles: Array
    lengths: Array
    stds: Array
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
        Of the whole bars, px^2, so that covered ones are recognised; see :meth:`from_clicks`.

    Raises
    ------
    InvalidInput
        If colours are too similar relative to that of the wall.

    Notes
    -----
    Each pixel is a mixture of wall and bars (linear unmixing by least squares; blur mixes them in just that way); the
    wall's colour is the median of the frame. Centre, angle and length are moments of a bar's shares.
    """

    SHARE = 0.4  # of a pixel: with more of its colour it belongs to a bar
    LEAST_ANGLE = 0.15  # rad, between the colours of two bars, seen from the wall's
    LEAST_AREA = 0.35  # of the whole bar's: with less it counts as hidden

    def __init__(self, colours: ArrayLike, areas: ArrayLike | None = None) -> None:
        self.colours = checks.array("colours", colours, (-1, 3), sign="nonnegative")
        count = self.colours.shape[0]
        if not 1 <= count <= 3:
            raise InvalidInput("number of bars does not fit", got=count, allowed="1 to 3: a pixel has three channels")
        self.areas = None if areas is None else checks.array("areas", areas, (count,), sign="positive", unit="px^2")

    @classmethod
    def from_clicks(cls, image: Image, places: ArrayLike) -> "BarDetector":
        """Return a detector of the bars at places (J, 2), px, in a frame that shows each whole."""
        clicks = checks.array("places", places, (-1, 2), unit="px")
        colours = [surface(image, place)[0] for place in clicks]
        areas = cls(colours).find(image).areas
        if np.isnan(areas).any():
            missing = np.flatnonzero(np.isnan(areas)).tolist()
            raise InvalidInput("bars are not seen where they were clicked", got=missing, fix="Click in their middles")
        return cls(colours, areas)

    def find(self, image: Image) -> BarObservations:
        """Return the bars seen in a frame (height, width, 3), uint8."""
        import cv2

        wall = np.median(image[::4, ::4].reshape(-1, 3), axis=0)
        mixing = (self.colours - wall).T
        sizes = np.linalg.norm(mixing, axis=0)
        alike = np.linalg.svd(mixing / np.maximum(sizes, 1e-9), compute_uv=False)[-1] < self.LEAST_ANGLE
        if alike or sizes.min() < 30.0:  # levels
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
        return BarObservations(*(np.array(column) for column in zip(*each, strict=True)))

    def _bar(self, number: int, shares: npt.NDArray[np.float32]) -> tuple[Array, float, float, float, float]:
        """Return centre, angle, length, standard deviation of the angle, and area of one bar from its shares (h, w)."""
        import cv2

        nothing = np.full(2, np.nan), np.nan, np.nan, np.nan, np.nan
        count, label, stats, _ = cv2.connectedComponentsWithStats(
            (shares > self.SHARE).astype(np.uint8), connectivity=8
        )
        if count < 2:
            return nothing
        largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        mask = cv2.dilate((label == largest).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        moments = cv2.moments(np.where(mask, np.clip(shares, 0.0, 1.0), 0.0))
        area = moments["m00"]
        whole = None if self.areas is None else float(self.areas[number])
        if area < (30.0 if whole is None else self.LEAST_AREA * whole):  # px^2
            return nothing
        centre = np.array([moments["m10"], moments["m01"]]) / area
        spread = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) / area
        values, vectors = np.linalg.eigh(spread)
        along = vectors[:, 1] * (1.0 if vectors[0, 1] >= 0.0 else -1.0)
        width, length = np.sqrt(12.0 * values)
        missing = 0.0 if whole is None else max(0.0, 1.0 - area / whole - 0.05)
        std = np.sqrt(12.0 * (FLOOR**2 + (missing * width) ** 2)) / max(length, 1.0)
        return centre, float(np.arctan2(along[1], along[0])), float(length), float(std), area / (whole or 1.0)


@dataclass(frozen=True, eq=False)
class BarTrack:
    """The links of a pendulum in a video.

    Attributes
    ----------
    recording : Recording
        Angles of the links, rad, NaN where a bar was not seen.
    frames : int
        Frames of the video.
    seen : (J,) float64
        Part of the frames in which each bar was seen.
    notes : tuple of str
        Problems of the video.
    interrupted : bool
        Whether Ctrl-C ended it before the video did.
    """

    recording: Recording
    frames: int
    seen: Array
    notes: tuple[str, ...]
    interrupted: bool = False

    def to_netcdf(self, path: PathLike, attributes: Mapping[str, Any] | None = None) -> None:
        """Write the recording to NetCDF-4, with `attributes` as of :meth:`hyperflex.Recording.to_netcdf`."""
        marks = {"interrupted": 1} if self.interrupted else {}
        self.recording.to_netcdf(path, marks | dict(attributes or {}))


@interruptible(BarTrack)
def track_bars(
    video: PathLike,
    detector: BarDetector,
    pivot: ArrayLike,
    *,
    preview: PathLike | None = None,
    progress: Callable[[int], None] | None = None,
) -> BarTrack:
    """Track the links of a pendulum, bars of different colours, through a video.

    Parameters
    ----------
    video : path-like
        Any file that FFmpeg reads. The camera is level and faces the plane of the motion at a right angle.
    detector : BarDetector
        Of the links, from the pivot on.
    pivot : (2,) array_like
        First joint, px.
    preview : path-like, optional
        MP4 file that shows the detections.
    progress : callable, optional
        Called with the number of frames done.

    Returns
    -------
    BarTrack

    Raises
    ------
    FileProblem
        If the video cannot be read, or the preview not be written.
    InvalidInput
        If a link is seen in fewer than two frames.
    Interrupted
        By Ctrl-C; its ``partial`` is the BarTrack until then, if each link had been seen twice. No preview is kept.

    Notes
    -----
    An angle is that of a bar's axis, and so needs no scale. The end that is nearer to the joint before it defines which
    way the bar points; if that joint is hidden, its last angle and rate do. These also count whole turns.
    """
    start = checks.array("pivot", pivot, (2,), unit="px")
    count = len(detector.colours)
    times: list[float] = []
    angles: list[Array] = []
    stds: list[Array] = []
    last, when, rate = np.full(count, np.nan), np.full(count, np.nan), np.zeros(count)  # of each link, when last seen

    def look(frame: Frame, draw: bool) -> Image | None:
        seen, t = detector.find(frame.image), frame.time
        now = link_angles(seen, start, last + rate * (t - when))
        new, again = ~np.isnan(now), ~np.isnan(now + last)
        rate[again] = (now - last)[again] / (t - when[again])
        last[new], when[new] = now[new], t
        angles.append(now)
        stds.append(seen.stds)
        times.append(t)
        return _drawn(frame.image, seen, now, t) if draw else None

    def result() -> BarTrack:
        done = len(times)  # the last to be extended
        data, noise = np.array(angles[:done]), np.array(stds[:done])
        whole = ~np.isnan(data)
        missing = np.flatnonzero(whole.sum(axis=0) < 2).tolist()
        if missing:
            fix = "Check colours and areas of the detector"
            raise InvalidInput("bars are not seen in two frames", got=missing, fix=fix)
        noise = np.where(whole, noise, np.nanmedian(noise, axis=0))
        recording = Recording(np.array(times[:done]), data, kind="angles", noise=noise, source=str(reader.path))
        return BarTrack(recording, done, whole.mean(axis=0), tuple(reader.notes))

    with VideoReader(video) as reader:
        return follow_video(reader, look, result, preview=preview, progress=progress)


def link_angles(seen: BarObservations, pivot: Array, expected: Array) -> Array:
    """Return angles (J,) of links, rad from straight down, positive to the right; NaN: not seen.

    Parameters
    ----------
    seen : BarObservations
        Of the links, from the pivot on.
    pivot : (2,) float64
        First joint, px.
    expected : (J,) float64
        Angles with their whole turns, rad; NaN: nothing is expected.
    """
    found = np.full(len(seen.angles), np.nan)
    joint: Array | None = pivot
    for k, (ends, guess) in enumerate(zip(seen.ends, expected, strict=True)):
        if np.isnan(ends).any() or (joint is None and np.isnan(guess)):
            joint = None
            continue
        near = 0 if joint is None else int(np.argmin(np.linalg.norm(ends - joint, axis=1)))
        along, period = ends[1 - near] - ends[near], np.pi if joint is None else 2.0 * np.pi
        angle = np.arctan2(along[0], along[1])
        found[k] = angle if np.isnan(guess) else angle + period * np.round((guess - angle) / period)
        joint = seen.centres[k] + 0.5 * seen.lengths[k] * np.array([np.sin(found[k]), np.cos(found[k])])
    return found


def _drawn(image: Image, seen: BarObservations, angles: Array, t: float) -> Image:
    """Return a frame with the axes of its bars (white, to their far ends) and their angles."""
    import cv2

    shown = image.copy()
    half = 0.5 * seen.lengths[:, None] * np.stack([np.sin(angles), np.cos(angles)], axis=1)
    for bar in np.stack([seen.centres - half, seen.centres + half], axis=1)[np.isfinite(half).all(axis=1)]:
        start, end = np.round(bar).astype(int).tolist()
        cv2.arrowedLine(shown, start, end, (255, 255, 255), 1, cv2.LINE_AA)
    text = f"{t:.2f} s  " + "  ".join("hidden" if np.isnan(a) else f"{np.degrees(a):.0f} deg" for a in angles)
    cv2.putText(shown, text, (8, shown.shape[0] - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (60, 60, 60), 1, cv2.LINE_AA)
    return shown
