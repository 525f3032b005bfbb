"""Tracks a rope through a whole video: from a file to a Recording of its markers."""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.estimate.changes import Change
from hyperflex.estimate.doubts import Doubt, advice, doubts
from hyperflex.estimate.error_levels import RunErrors, run_errors
from hyperflex.estimate.measurements import CurveMeasurement
from hyperflex.estimate.observations import InputFrame, Observations
from hyperflex.estimate.parameters import BASE_KINDS, PICTURE_KINDS
from hyperflex.estimate.picture import draw_frame
from hyperflex.estimate.tracker import RopeTracker
from hyperflex.files import PathLike
from hyperflex.interruption import interruptible
from hyperflex.model import unit_across, unit_along
from hyperflex.recording import Recording
from hyperflex.sensors import lever_arms
from hyperflex.vision import Camera, CurveDetector, Frame, Image, VideoReader, follow_video

ROUNDING = 1.05  # factor by which a time may exceed the frame interval: both are rounded
SELDOM = 0.5  # part of the frames: a marker that is seen in fewer is reported
UNDETERMINED = 0.9  # of a parameter's prior standard deviation: if more remains, the video does not determine it


@dataclass(frozen=True, eq=False)
class VideoTrack:
    """The markers of a rope in a video.

    Attributes
    ----------
    recording : Recording
        Places of the markers, m, NaN if not seen, from the frame on in which the rope was found, with their standard
        deviations as the whole run shows them. The final estimates of
        the plane's scale, roll and offset apply to all places, that of the delay to all times. Markers that were never
        seen are omitted.
    arc_lengths : (K,) float64
        Of its markers, m, with the final estimates of lengths and arc lengths.
    frames : int
        Frames of the video, from `since` on.
    found_at : float
        Time of the first frame in the recording, s.
    seen : float
        Part of all markers in all frames since that was seen.
    parameters : dict of str to (float, float)
        Estimates beside the state, and their standard deviations.
    errors : RunErrors
        What the whole run tells of its measurements: the noise of the recording is by it.
    doubts : tuple of Doubt
        Why the track is doubted; empty if its places move as those of the rope.
    notes : tuple of str
        Problems of the video, and the use of the parameters.
    changes : tuple of Change
        Those that were noticed, if the filter tests for changes.
    interrupted : bool
        Whether Ctrl-C ended it before the video did.
    """

    recording: Recording
    arc_lengths: Array
    frames: int
    found_at: float
    seen: float
    parameters: dict[str, tuple[float, float]]
    errors: RunErrors
    doubts: tuple[Doubt, ...]
    notes: tuple[str, ...]
    changes: tuple[Change, ...] = ()
    interrupted: bool = False

    @property
    def seen_each(self) -> Array:
        """Part of the frames in the recording in which each marker was seen (K,)."""
        return np.asarray(np.isfinite(self.recording.data[:, ::2]).mean(axis=0))

    def to_netcdf(self, path: PathLike, attributes: Mapping[str, Any] | None = None) -> None:
        """Write the recording to NetCDF-4, with the estimates and the arc lengths of its markers as attributes.

        Further `attributes` are added, as of :meth:`hyperflex.Recording.to_netcdf`.
        """
        found: dict[str, Any] = {f"estimated_{name}": np.array(each) for name, each in self.parameters.items()}
        found |= {"interrupted": 1} if self.interrupted else {}
        self.recording.to_netcdf(path, {"arc_lengths": self.arc_lengths, **found, **(attributes or {})})


class _Sighting(NamedTuple):
    """What is kept of a frame."""

    seen: Observations  # px, at a time without an estimated delay
    still: Array  # (K, 2) px, where each marker would have been seen in the middle of the readout
    movements: Array  # (K, 2, 2) px^2, covariances of the differences
    x: Array  # (N,) the state, with the parameters until then
    begun: bool  # whether the estimate started in this frame
    changes: tuple[Change, ...]


@interruptible(VideoTrack)
def track_video(
    video: PathLike,
    tracker: RopeTracker,
    *,
    since: float = -math.inf,
    preview: PathLike | None = None,
    progress: Callable[[int], None] | None = None,
) -> VideoTrack:
    """Track a rope through a whole video.

    Parameters
    ----------
    video : path-like
        Any file that FFmpeg reads.
    tracker : RopeTracker
        A new one.
    since : float
        Time of the first frame that is used, s.
    preview : path-like, optional
        MP4 file that shows expected and seen markers.
    progress : callable, optional
        Called with the number of frames done.

    Returns
    -------
    VideoTrack

    Raises
    ------
    FileProblem
        If the video cannot be read, or the preview not be written.
    InvalidInput
        If the rope is found in no frame, the frames have another size than the camera's, or the frame interval is
        shorter than the camera's exposure or readout.
    Interrupted
        By Ctrl-C; its ``partial`` is the VideoTrack until then, if the rope had been found. No preview is kept.
    """
    from threadpoolctl import threadpool_limits

    found: list[_Sighting] = []
    count, begun = 0, True

    def look(frame: Frame, draw: bool) -> Image | None:
        nonlocal count, begun
        if frame.time < since:
            return None
        tracked = tracker.look(frame)
        count += 1
        begun = begun or bool(np.isnan(tracked.predicted).all())
        if tracked.state is not None and not getattr(tracker.measurement, "searched", False):
            still = tracker.adjusted_camera.project(tracked.places)
            pixels, covariances = tracked.pixels, tracked.covariances
            seen = Observations(tracked.t + tracker.delay, pixels, rows=tracker.rows(pixels), covariances=covariances)
            x = tracker.estimator.x.copy()
            found.append(_Sighting(seen, still, tracked.movements, x, begun, tracked.changes))
            begun = False
        return draw_frame(frame.image, tracker, tracked) if draw else None

    def result() -> VideoTrack:
        if sum(bool(np.isfinite(each.still).any()) for each in found) < 2:
            allowed = "two frames or more in which markers are seen in an order that the rope allows"
            fix = "Check the markers' colour, their arc lengths, and the camera's swing plane"
            if isinstance(tracker.measurement, CurveMeasurement):
                allowed = "two frames or more that show the rope from the point that it hangs from"
                fix = "Check that point's pixel, the rope's length, and that nothing hides the rope"
            raise InvalidInput("the rope was not found in the video", got=f"{count} frames", allowed=allowed, fix=fix)
        return _result(tracker, found, count, reader)

    with threadpool_limits(1), VideoReader(video) as reader:  # matrices are small: threads would wait for each other
        _check_timing(tracker.camera, reader)
        return follow_video(reader, look, result, preview=preview, progress=progress)


def _check_timing(camera: Camera, reader: VideoReader) -> None:
    """Refuse times that exceed the frame interval; note a readout direction that does not fit the video's rotation."""
    for name, value in (("exposure", camera.exposure), ("readout", camera.readout)):
        if reader.frame_interval is not None and value > ROUNDING * reader.frame_interval:
            raise InvalidInput(
                f"the camera's {name} is longer than the time from frame to frame",
                got=value,
                allowed=f"at most {reader.frame_interval:.4g} s in {reader.path}",
                fix=f"Give the {name} in seconds; in slowed-down videos, by the clock of the video",
            )
    if camera.readout and reader.rotation and camera.readout_direction != reader.readout_direction:
        reader.notes.append(
            f"the file is rotated by {reader.rotation} degrees, so that the rows of most cameras follow each other "
            f"{reader.readout_direction}; the camera's readout_direction says {camera.readout_direction}"
        )


def _result(tracker: RopeTracker, found: list[_Sighting], count: int, reader: VideoReader) -> VideoTrack:
    """Return the track of `count` frames."""
    estimator = tracker.estimator
    changes = tuple(change for each in found for change in each.changes)
    begun = [k for k, each in enumerate(found) if each.begun]
    curve = isinstance(tracker.measurement, CurveMeasurement)
    alike, states = CurveDetector.CORRELATED if curve else 1.0, np.array([each.x for each in found])
    errors = run_errors(estimator, [each.seen for each in found], states, begun, changes, alike)
    parameters, estimates = estimator.parameters, errors.estimates
    prior = dict(zip(parameters.names, parameters.std.tolist(), strict=True))
    arcs, places, std = (_curve_places if curve else _marker_places)(tracker, found, errors)
    seen, interval = ~np.isnan(places[:, :, 0]), (found[-1].seen.t - found[0].seen.t) / (len(found) - 1)
    kept = np.asarray(seen.any(axis=0))
    now = parameters.arc_lengths(arcs, np.where(parameters.std > 0.0, errors.values[-1], 0.0))[kept]
    alike = errors.correlated * interval if errors.correlated > 1.0 else 0.0
    base = np.array([parameters.base_offset(each) for each in errors.values])
    end = tracker.measurement.end_seen
    if curve and end < 1.0:  # 1: it was always seen, or a marker covers it
        end = float(np.mean([each.seen.seen[-1] for each in found]))
    moved = np.nanvar(places[:, kept], axis=0).sum(axis=1).mean()
    doubted = doubts(
        estimator.process.rope,
        errors.level,
        errors.density,
        shift=errors.shift,
        alike=alike,
        base=base if BASE_KINDS.keys() & set(parameters.names) else None,
        end=end,
        longer=estimates["length"] if prior.get("length") else (0.0, 0.0),
        swing=tracker.camera.pixels_per_metre * float(np.sqrt(moved)) if curve else math.inf,
    )
    named = defaultdict(list)
    for name in PICTURE_KINDS:
        if name in estimates:
            since = "of all frames" if prior[name] else "since it changed"
            named[f"applied to the {'times' if name == 'delay' else 'places'} {since}"].append(
                f"{name} {estimates[name][0]:.5g}"
            )
    applied = [f"{what}: {', '.join(each)}" for what, each in named.items()]
    where = ", ".join(f"{arc:.5g}" for arc in now)
    what = "places of the rope" if curve else "markers"
    convention = f"positions in m, x right, y up from the camera's origin, of {what} at {where} m along the rope"
    t = np.array([each.seen.t for each in found]) - parameters.value("delay", errors.values[-1])
    rows = seen.any(axis=1)
    data, noise = (each[rows][:, kept].reshape(int(rows.sum()), -1) for each in (places, std))
    said = "; ".join([convention, *applied])
    recording = Recording(t[rows], data, kind="markers", noise=noise, convention=said, source=str(reader.path))
    notes = [*reader.notes, *([advice(doubted, plain=curve)] if doubted else []), *applied]
    notes += [
        f"the marker at {arc:g} m was never seen: check its arc length and colour, or omit it from arc_lengths; "
        f"it is not in the file, whose markers are those at {','.join(f'{each:g}' for each in arcs[kept])} m"
        for arc in arcs[~kept & (not curve)]
    ]
    notes += [
        f"the marker at {arc:g} m was seen in only {100.0 * part:.2g} % of the frames: check its arc length and colour"
        for arc, part in zip(arcs, seen.mean(axis=0), strict=True)
        if 0.0 < part < SELDOM and not curve
    ]
    if curve and (rare := arcs[seen.mean(axis=0) < SELDOM]).size:
        where = ",".join(f"{each:.3g}" for each in rare)
        notes.append(f"the rope at {where} m was seen in less than {SELDOM:.0%} of the frames: check what hides it")
    of_rope = "length" if curve else ("length", "arc[")  # the arc length at which a free end is seen is a part of it
    rope = {name: each for name, each in estimates.items() if name.startswith(of_rope) and prior[name]}
    if rope:
        stretch = f"lengths in the rope's file times {1.0 + rope['length'][0]:.5g}, " if "length" in rope else ""
        changed = ", ".join(f"{name} {value:.5g} (std {std:.2g})" for name, (value, std) in rope.items())
        new = ",".join(f"{arc:.5g}" for arc in now)
        use = "" if curve else f". To identify it: {stretch}arc_lengths {new}"
        notes.append(f"{changed}: of the rope, not of the places{use}")
    unknown = [name for name, (_, std) in estimates.items() if std > UNDETERMINED * prior[name] > 0.0]
    unknown = [name for name in unknown if not (curve and name.startswith("arc["))]
    if unknown:
        notes.append(f"the video does not determine {', '.join(unknown)}: as uncertain as before")
    return VideoTrack(
        recording,
        now,
        count,
        float(t[0]),
        float(seen.mean()),
        estimates,
        errors,
        tuple(doubted),
        tuple(notes),
        changes,
    )


def _marker_places(tracker: RopeTracker, found: list[_Sighting], errors: RunErrors) -> tuple[Array, Array, Array]:
    """Return the arc lengths (K,) of the markers, their places in all frames and the errors of these (T, K, 2), m."""
    parameters, readout = tracker.estimator.parameters, tracker.estimator.model.readout
    arcs = tracker.estimator.model.arc_lengths
    places, noise = np.empty((2, len(found), len(arcs), 2))
    first = 2 * tracker.estimator.n_links
    for k, (frame, final, wide) in enumerate(zip(found, errors.values, errors.covariances, strict=True)):
        before, now = (readout + parameters.value("readout", values) for values in (frame.x[first:], final))
        shift = (frame.seen.places - frame.still) * (now / before if before else 1.0)
        camera = parameters.camera_at(tracker.camera, final)
        places[k], wide = camera.locate_with_covariance(frame.seen.places - shift, wide + frame.movements)
        noise[k] = np.sqrt(np.diagonal(wide, axis1=1, axis2=2))
    return arcs, places, noise


def _curve_places(tracker: RopeTracker, found: list[_Sighting], errors: RunErrors) -> tuple[Array, Array, Array]:
    """Return the same of a rope without markers: where each frame alone shows it, NaN where it is not seen.

    Notes
    -----
    A rope does not stretch, so that its curve from the first joint tells the places at all arc lengths. The angles of
    the links that fit the points of a frame best are found by least squares, near the estimated ones. Unlike smoothed
    states, these places have errors that are independent from frame to frame and hold nothing of the assumed friction,
    so that `identify` takes them as it takes markers. What the curve does not show (bends between two points) is the
    estimate's.
    """
    estimator = tracker.estimator
    model, n, parameters, rope = estimator.model, estimator.n_links, estimator.parameters, estimator.process.rope
    arcs = rope.total_length * np.linspace(0.0, 1.0, 25)[1::2]  # more hold no more of the waves that a curve shows
    turn = (np.eye(n, k=1) - np.eye(n))[:-1] * np.sqrt(n) / 0.5  # rad, from the estimated shape: weak beside a curve
    _, arms = lever_arms(rope, arcs)
    nearest = np.abs(np.subtract.outer(arcs, model.arc_lengths)).argmin(axis=1)
    places, std = np.full((2, len(found), arcs.size, 2), np.nan)
    for k, (frame, final, wide) in enumerate(zip(found, errors.values, errors.covariances, strict=True)):
        seen = Observations(frame.seen.t, frame.seen.places, rows=frame.seen.rows, covariances=wide)
        x, given = np.append(frame.x[: 2 * n], final), InputFrame(seen, seen.seen, 1.0)
        estimated, base = x[:n].copy(), estimator.process.base(seen.t, x)
        length = 1.0 + parameters.value("length", final)
        for _ in range(3):  # Gauss-Newton steps: the third moves by a millionth of a pixel
            off, slope = given.residuals(*model.predict(x, base, seen.rows))
            rows = np.concatenate([slope[:, :n], turn])
            right = np.concatenate([off, turn @ (estimated - x[:n])])
            x[:n] += np.linalg.lstsq(rows, right, rcond=None)[0]
        wide = np.linalg.pinv(rows.T @ rows)
        moves = length * arms[:, None, :] * unit_across(x[:n], 0)
        place = base[0] + parameters.base_offset(final) + length * arms @ unit_along(x[:n], 0).T
        shown = seen.seen[nearest]
        places[k, shown] = place[shown]
        std[k] = np.sqrt(np.einsum("mcn,nl,mcl->mc", moves, wide, moves))
    return arcs, places, std
