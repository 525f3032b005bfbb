"""Coloured bars in a frame, such as the links of a pendulum without markers: centre, angle and ends of each."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.files import PathLike
from hyperflex.interruption import catch_interrupt, interruptible
from hyperflex.recording import Recording
from hyperflex.vision.colour import surface
from hyperflex.vision.video import Image, VideoReader, VideoWriter

FLOOR = 0.3  # px, standard deviation of a place along or across a bar at least: its ends are no straight edges
MOST = 3  # bars: a pixel has three channels
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
        if not 1 <= count <= MOST:
            raise InvalidInput("number of bars does not fit", got=count, allowed="1 to 3: a pixel has three channels")
        self.areas = None if areas is None else checks.array("areas", areas, (count,), sign="positive", unit="px^2")

    @classmethod
    def from_clicks(cls, image: Image, places: npt.ArrayLike) -> "BarDetector":
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


@dataclass(frozen=True, eq=False)
class BarTrack:
    """What was seen of a pendulum's links in a video.

    Attributes
    ----------
    recording : Recording
        Angles of the links, rad, NaN where a bar was not seen.
    frames : int
        Frames of the video.
    seen : (J,) float64
        In which part of the frames each bar was seen.
    notes : tuple of str
        What was wrong with the video.
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
    pivot: npt.ArrayLike,
    *,
    preview: PathLike | None = None,
    progress: Callable[[int], None] | None = None,
) -> BarTrack:
    """Follow the links of a pendulum, each a bar of its own colour, through a video.

    Parameters
    ----------
    video : path-like
        Any file that FFmpeg reads. The camera is level and looks at a right angle at the plane of the motion.
    detector : BarDetector
        Of the links, from the pivot on.
    pivot : (2,) array_like
        First joint, px.
    preview : path-like, optional
        MP4 file that shows what was seen.
    progress : callable, optional
        Hears the number of frames done.

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
        By Ctrl-C; its ``partial`` is the BarTrack until then, where each link had been seen twice. No preview is kept.

    Notes
    -----
    An angle comes from a bar's axis, and so needs no scale. Which of its ends is the nearer one to the joint before it
    says which way it points; where that joint is hidden, its last angle and rate do, and these also count the turns.
    """
    start = checks.array("pivot", pivot, (2,), unit="px")
    times: list[float] = []
    angles: list[Array] = []
    stds: list[Array] = []
    with ExitStack() as stack:
        reader = stack.enter_context(VideoReader(video))
        writer = None if preview is None else stack.enter_context(VideoWriter(preview, reader.image_size))
        with catch_interrupt() as stop:
            for frame in reader:
                seen = detector.find(frame.image)
                angles.append(link_angles(seen, start, expected_angles(times, angles, frame.time)))
                stds.append(np.sqrt(seen.covariances[:, 2, 2]))
                times.append(frame.time)
                if writer is not None:
                    writer.write(_drawn(frame.image, seen, angles[-1], frame.time), frame.time)
                if progress is not None:
                    progress(len(times))
        if not stop.received:
            return _bar_track(times, angles, stds, reader)
        with suppress(InvalidInput):
            raise Interrupted(replace(_bar_track(times, angles, stds, reader), interrupted=True))
        raise Interrupted


def _bar_track(times: list[float], angles: list[Array], stds: list[Array], reader: VideoReader) -> BarTrack:
    """Return what was seen in frames: angles and their standard deviations (J,) at each time, s."""
    count = len(times)
    data, noise = np.array(angles[:count]), np.array(stds[:count])
    whole = ~np.isnan(data)
    if (whole.sum(axis=0) < 2).any():
        missing = np.flatnonzero(whole.sum(axis=0) < 2).tolist()
        raise InvalidInput("bars are seen in no two frames", got=missing, fix="Check colours and areas of the detector")
    noise = np.where(whole, noise, np.nanmedian(noise, axis=0))
    recording = Recording(np.array(times), data, kind="angles", noise=noise, source=str(reader.path))
    return BarTrack(recording, count, whole.mean(axis=0), tuple(reader.notes))


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
    for k, ends in enumerate(seen.ends):
        if np.isnan(ends).any():
            joint = None
            continue
        if joint is not None:
            near = int(np.argmin(np.linalg.norm(ends - joint, axis=1)))
            along = ends[1 - near] - ends[near]
            period = 2.0 * np.pi
        else:
            along = ends[1] - ends[0]
            period = np.pi
            if np.isnan(expected[k]):
                continue
        angle = np.arctan2(along[0], along[1])
        turns = 0.0 if np.isnan(expected[k]) else np.round((expected[k] - angle) / period)
        found[k] = angle + turns * period
        direction = np.array([np.sin(found[k]), np.cos(found[k])])
        joint = seen.centres[k] + 0.5 * seen.lengths[k] * direction
    return found


def expected_angles(times: list[float], angles: list[Array], t: float) -> Array:
    """Return angles (J,) at time t, s, by the last two that were seen of each link; NaN where there is none."""
    if not angles:
        return np.full(MOST, np.nan)
    past, at = np.array(angles), np.array(times)
    result = np.full(past.shape[1], np.nan)
    for k, column in enumerate(past.T):
        seen = np.flatnonzero(~np.isnan(column))[-2:]
        if seen.size:
            result[k] = column[seen[-1]]
        if seen.size == 2:
            rate = (column[seen[1]] - column[seen[0]]) / (at[seen[1]] - at[seen[0]])
            result[k] += rate * (t - at[seen[1]])
    return result


def _drawn(image: Image, seen: BarObservations, angles: Array, t: float) -> Image:
    """Return a frame with the axes of its bars (white) and their angles."""
    import cv2

    shown = image.copy()
    for k in np.flatnonzero(~np.isnan(angles)):
        centre = seen.centres[k]
        half = 0.5 * seen.lengths[k] * np.array([np.sin(angles[k]), np.cos(angles[k])])
        line = np.round(16.0 * np.stack([centre - half, centre + half])).astype(np.int32)
        cv2.polylines(shown, [line], False, (255, 255, 255), 1, cv2.LINE_AA, 4)
        cv2.circle(shown, np.round(centre + half).astype(int).tolist(), 3, (0, 255, 255), -1, cv2.LINE_AA)
    said = f"{t:.2f} s  " + "  ".join("hidden" if np.isnan(a) else f"{np.degrees(a):.0f} deg" for a in angles)
    cv2.putText(shown, said, (8, shown.shape[0] - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (60, 60, 60), 1, cv2.LINE_AA)
    return shown
