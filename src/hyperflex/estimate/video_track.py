"""Tracks a rope through a whole video: from a file to a Recording of its markers."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.estimate.changes import Change
from hyperflex.estimate.parameters import OPTICAL
from hyperflex.estimate.tracker import RopeTracker, TrackedFrame, draw_frame
from hyperflex.files import PathLike
from hyperflex.interruption import catch_interrupt, interruptible
from hyperflex.recording import Recording
from hyperflex.vision import Camera, VideoReader, VideoWriter

SAME = 1.05  # factor by which a time may be longer than that from frame to frame and still be meant to be no longer
UNTOLD = 0.9  # of the deviation declared, from which a video has told nothing of what was to be estimated


@dataclass(frozen=True, eq=False)
class VideoTrack:
    """What was tracked in a video.

    Attributes
    ----------
    recording : Recording
        Places of the markers, m, NaN where they were not seen, from the frame on in which the rope was found. In all
        frames they are by what was found in the end of the plane's scale, turn and offset, and the times by the delay.
        A marker that was never seen is not in it.
    arc_lengths : (K,) float64
        Where on the rope its markers sit, m, by what was found of lengths and arc lengths.
    frames : int
        Frames of the video.
    found_at : float
        Time of that frame, s.
    seen : float
        Which part of all markers in all frames since was seen.
    parameters : dict of str to (float, float)
        What was estimated beside the state, and its standard deviation.
    notes : tuple of str
        What was wrong with the video, and what was made of the parameters.
    changes : tuple of Change
        What was noticed to have changed, where the filter tests for that.
    interrupted : bool
        Whether Ctrl-C ended it before the video did.
    """

    recording: Recording
    arc_lengths: Array
    frames: int
    found_at: float
    seen: float
    parameters: dict[str, tuple[float, float]]
    notes: tuple[str, ...]
    changes: tuple[Change, ...] = ()
    interrupted: bool = False

    def to_netcdf(self, path: PathLike, attributes: Mapping[str, Any] | None = None) -> None:
        """Write the recording to NetCDF-4, with what was estimated and the arc lengths of its markers as attributes.

        Beside these stand further `attributes`, as of :meth:`hyperflex.Recording.to_netcdf`.
        """
        found: dict[str, Any] = {f"estimated_{name}": np.array(each) for name, each in self.parameters.items()}
        found |= {"interrupted": 1} if self.interrupted else {}
        self.recording.to_netcdf(path, {"arc_lengths": self.arc_lengths, **found, **(attributes or {})})


class _Sighting(NamedTuple):
    """What is kept of a frame."""

    t: float  # s, no delay taken into account but the camera's own
    seen: Array  # (K, 2) px, where each marker was seen
    still: Array  # (K, 2) px, where it would have been seen in the middle of the readout
    covariances: Array  # (K, 2, 2) px^2
    values: Array  # (P,) parameters by then
    changes: tuple[Change, ...]


@interruptible(VideoTrack)
def track_video(
    video: PathLike,
    tracker: RopeTracker,
    *,
    preview: PathLike | None = None,
    progress: Callable[[int], None] | None = None,
) -> VideoTrack:
    """Track a rope through a whole video.

    Parameters
    ----------
    video : path-like
        Any file that FFmpeg reads.
    tracker : RopeTracker
        That has seen nothing yet.
    preview : path-like, optional
        MP4 file that shows what was seen and expected.
    progress : callable, optional
        Hears the number of frames done.

    Returns
    -------
    VideoTrack

    Raises
    ------
    FileProblem
        If the video cannot be read, or the preview not be written.
    InvalidInput
        If the rope is found in no frame, the frames have another size than the camera's, or follow each other faster
        than the camera exposes or reads them.
    Interrupted
        By Ctrl-C; its ``partial`` is the VideoTrack until then, where the rope had been found. No preview is kept.
    """
    from threadpoolctl import threadpool_limits

    found: list[_Sighting] = []
    count = 0

    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1))  # matrices are small: threads would wait for each other
        reader = stack.enter_context(VideoReader(video))
        _check_timing(tracker.camera, reader)
        writer = None if preview is None else stack.enter_context(VideoWriter(preview, reader.image_size))
        with catch_interrupt() as stop:
            for frame in reader:
                tracked = tracker.look(frame)
                count += 1
                if tracked.state is not None:
                    found.append(_sighting(tracker, tracked))
                if writer is not None:
                    writer.write(draw_frame(frame.image, tracker, tracked), frame.time)
                if progress is not None:
                    progress(count)
        seen = sum(_any_seen(each) for each in found)
        if stop.received:
            if seen < 2:
                raise Interrupted
            part = _result(tracker, found, count, str(video), reader.notes)
            raise Interrupted(replace(part, interrupted=True))
        if seen < 2:
            raise InvalidInput(
                "the rope was not found in the video",
                got=f"{count} frames",
                allowed="two frames or more in which markers are seen in an order that the rope allows",
                fix="Check the markers' colour, their arc lengths, and the camera's swing plane",
            )
        return _result(tracker, found, count, str(video), reader.notes)


def _check_timing(camera: Camera, reader: VideoReader) -> None:
    """Refuse times that do not fit the video's frame rate; note rows that do not follow each other as it was turned."""
    for name, value in (("exposure", camera.exposure), ("readout", camera.readout)):
        if reader.frame_interval is not None and value > SAME * reader.frame_interval:
            raise InvalidInput(
                f"the camera's {name} is longer than the time from frame to frame",
                got=value,
                allowed=f"at most {reader.frame_interval:.4g} s in {reader.path}",
                fix=f"Give the {name} in seconds; in videos that were slowed down, by the clock of the video",
            )
    if camera.readout and reader.rotation and camera.readout_direction != reader.readout_direction:
        reader.notes.append(
            f"the file is turned by {reader.rotation} degrees, so that the rows of most cameras follow each other "
            f"{reader.readout_direction}; the camera's readout_direction says {camera.readout_direction}"
        )


def _any_seen(each: _Sighting) -> bool:
    return bool(np.isfinite(each.still).any())


def _sighting(tracker: RopeTracker, tracked: TrackedFrame) -> _Sighting:
    """Return what is kept of a frame that the tracker has just looked at."""
    still = tracker.camera.project(tracked.places, tracker.adjustment)
    kept = tracked.pixels.copy(), still, tracked.covariances, tracker.values.copy()
    return _Sighting(tracked.t + tracker.delay, *kept, tracked.changes)


def _result(tracker: RopeTracker, found: list[_Sighting], count: int, source: str, said: list[str]) -> VideoTrack:
    """Return what was tracked in `count` frames."""
    seen = np.array([np.isfinite(each.still[:, 0]) for each in found])
    parameters, kept = tracker.estimator.parameters, np.asarray(seen.any(axis=0))
    arcs, declared = tracker.estimator.model.arc_lengths, parameters.std > 0.0
    now = parameters.arc_lengths(arcs, np.where(declared, tracker.values, 0.0))[kept]
    told = tracker.estimator.values
    asked = {name: told[name] for name, each in zip(parameters.names, declared, strict=True) if each and name in told}
    applied = _applied(told, asked)
    where = ", ".join(f"{arc:.5g}" for arc in now)
    convention = f"positions in m, x right, y up from the camera's origin, of markers at {where} m along the rope"
    recording = _recording(tracker, found, seen, "; ".join([convention, *applied]), source)
    notes = [*said, *([tracker.warning] if tracker.warning else []), *applied, *_missing(arcs, kept)]
    notes += _of_the_rope(asked, now) + _untold(tracker)
    return VideoTrack(
        recording,
        now,
        count,
        found[0].t - tracker.delay,
        float(seen.mean()),
        told,
        tuple(notes),
        tuple(change for each in found for change in each.changes),
    )


def _applied(values: dict[str, tuple[float, float]], asked: dict[str, tuple[float, float]]) -> list[str]:
    """Say what of the estimated parameters is in the places and times."""
    result = []
    for name in OPTICAL:
        if name in values:
            what = "times" if name == "delay" else "places"
            when = "of all frames" if name in asked else "since it changed"
            result.append(f"applied to the {what} {when}: {name} {_with_std(values[name])}")
    return result


def _with_std(value: tuple[float, float]) -> str:
    return f"{value[0]:.5g} ± {value[1]:.2g}"


def _missing(arcs: Array, kept: npt.NDArray[np.bool_]) -> list[str]:
    """Say which markers were never seen."""
    return [
        f"the marker at {arc:g} m was never seen: check its arc length, or leave it out of arc_lengths; "
        f"it is not in what is written, whose markers are those at {','.join(f'{each:g}' for each in arcs[kept])} m"
        for arc in arcs[~kept]
    ]


def _of_the_rope(values: dict[str, tuple[float, float]], arcs: Array) -> list[str]:
    """Say what of the estimated parameters belongs to the rope, and so is not in the places."""
    given = [f"{name} {_with_std(each)}" for name, each in values.items() if name.startswith(("length", "arc["))]
    if not given:
        return []
    stretch = f"lengths in the rope's file times {1.0 + values['length'][0]:.5g}, " if "length" in values else ""
    now = ",".join(f"{arc:.5g}" for arc in arcs)
    return [f"{', '.join(given)}: of the rope, not of the places. To identify it: {stretch}arc_lengths {now}"]


def _untold(tracker: RopeTracker) -> list[str]:
    """Say which parameters the video has told nothing of."""
    before = dict(zip(tracker.estimator.parameters.names, tracker.estimator.parameters.std.tolist(), strict=True))
    names = [name for name, (_, std) in tracker.estimator.values.items() if std > UNTOLD * before[name] > 0.0]
    return [f"the video tells nothing of {', '.join(names)}: as unsure as before"] if names else []


def _final_values(tracker: RopeTracker, found: list[_Sighting]) -> Array:
    """Return the parameters (T, P) of each frame: those of the end, before a change those until it was noticed."""
    names = tracker.estimator.parameters.names
    times, values = np.array([each.t for each in found]), np.tile(tracker.values, (len(found), 1))
    for row in range(len(found) - 1, 0, -1):
        for change in found[row].changes:
            if change.name in names:
                k = names.index(change.name)
                values[times < change.time, k] = found[row - 1].values[k]
    return values


def _recording(
    tracker: RopeTracker, found: list[_Sighting], seen: npt.NDArray[np.bool_], convention: str, source: str
) -> Recording:
    """Return the markers of frames as measured data, by what was found in the end of the picture's parameters."""
    parameters, camera = tracker.estimator.parameters, tracker.camera
    values, readout = _final_values(tracker, found), tracker.estimator.model.readout
    places, noise = np.empty((2, *seen.shape, 2))
    for k, (frame, now) in enumerate(zip(found, values, strict=True)):
        then, final = (readout + parameters.value("readout", each) for each in (frame.values, now))
        shift = (frame.seen - frame.still) * (final / then if then else 1.0)
        adjustment = parameters.plane_adjustment(now)
        places[k] = camera.locate(frame.seen - shift, adjustment)
        slopes = np.linalg.inv(camera.linearize(np.nan_to_num(places[k]), adjustment).by_point)
        wide = slopes @ np.nan_to_num(frame.covariances, nan=1.0) @ slopes.transpose(0, 2, 1)
        noise[k] = np.sqrt(np.diagonal(wide, axis1=1, axis2=2))
    t = np.array([each.t for each in found]) - parameters.value("delay", tracker.values)
    rows, columns = seen.any(axis=1), seen.any(axis=0)
    data, std = (each[rows][:, columns].reshape(int(rows.sum()), -1) for each in (places, noise))
    return Recording(t[rows], data, kind="markers", noise=std, convention=convention, source=source)
