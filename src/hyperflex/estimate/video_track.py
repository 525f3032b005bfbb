"""Tracks a rope through a whole video: from a file to a Recording of its markers."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from hyperflex.errors import Interrupted, InvalidInput
from hyperflex.estimate.changes import Change
from hyperflex.estimate.tracker import RopeTracker, TrackedFrame, draw_frame
from hyperflex.files import PathLike
from hyperflex.recording import Recording
from hyperflex.vision import Camera, VideoReader, VideoWriter


@dataclass(frozen=True, eq=False)
class VideoTrack:
    """What was tracked in a video.

    Attributes
    ----------
    recording : Recording
        Places of the markers, m, NaN where they were not seen, from the frame on in which the rope was found.
    frames : int
        Frames of the video.
    found_at : float
        Time of that frame, s.
    seen : float
        Which part of all markers in all frames since was seen.
    parameters : dict of str to (float, float)
        What was estimated beside the state, and its standard deviation.
    notes : tuple of str
        What was wrong with the video.
    changes : tuple of Change
        What was noticed to have changed, where the filter tests for that.
    """

    recording: Recording
    frames: int
    found_at: float
    seen: float
    parameters: dict[str, tuple[float, float]]
    notes: tuple[str, ...]
    changes: tuple[Change, ...] = ()


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
        If the rope is found in no frame, or the frames have another size than the camera's.
    Interrupted
        By Ctrl-C; its ``result`` is the VideoTrack until then, where the rope had been found. No preview is kept.
    """
    from threadpoolctl import threadpool_limits

    found: list[TrackedFrame] = []
    count = 0

    def result() -> VideoTrack:
        """Return what has been tracked until now."""
        return VideoTrack(
            _recording(found, tracker.camera, str(video)),
            count,
            found[0].t,
            float(np.mean([each.seen.mean() for each in found])),
            tracker.estimator.values,
            (*reader.notes, *([tracker.doubt] if tracker.doubt else [])),
            tuple(change for each in found for change in each.changes),
        )

    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1))  # matrices are small: threads would wait for each other
        reader = stack.enter_context(VideoReader(video))
        writer = None if preview is None else stack.enter_context(VideoWriter(preview, reader.image_size))
        try:
            for frame in reader:
                tracked = tracker.look(frame)
                count += 1
                if tracked.state is not None:
                    found.append(tracked)
                if writer is not None:
                    writer.write(draw_frame(frame.image, tracker, tracked), frame.time)
                if progress is not None:
                    progress(count)
        except KeyboardInterrupt:
            if len(found) < 2:
                raise
            raise Interrupted(result()) from None
        if len(found) < 2:
            raise InvalidInput(
                "the rope was not found in the video",
                got=f"{count} frames",
                allowed="two frames or more in which markers are seen in an order that the rope allows",
                fix="Check the markers' colour, their arc lengths, and the camera's swing plane",
            )
    return result()


def _recording(found: list[TrackedFrame], camera: Camera, source: str) -> Recording:
    """Return the markers of frames as measured data."""
    t, places = np.array([each.t for each in found]), np.array([each.places for each in found])
    slopes = np.linalg.inv(camera.linearize(np.nan_to_num(places.reshape(-1, 2))).by_point)
    pixels = np.array([each.covariances for each in found]).reshape(-1, 2, 2)
    wide = slopes @ np.nan_to_num(pixels, nan=1.0) @ slopes.transpose(0, 2, 1)
    noise = np.sqrt(np.diagonal(wide, axis1=1, axis2=2)).reshape(len(found), -1)
    used = ~np.isnan(places).all(axis=(1, 2))
    data = places.reshape(len(found), -1)
    return Recording(t[used], data[used], kind="markers", noise=noise[used], source=source)
