"""Video files: frames with the times that the container gives them, and writing of MP4."""

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.files import PathLike, as_path, atomic_path, regular_file

Image = npt.NDArray[np.uint8]

_TICK = Fraction(1, 90_000)  # s, time base of files that are written
_LARGEST = 100_000_000  # pixels of a frame: more is a damaged header, not a camera
# by how much a picture is turned counterclockwise -> in which direction the rows of the sensor then follow each other
_READOUT = {0: "down", 90: "right", 180: "up", -180: "up", -90: "left"}


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One frame of a video.

    Parameters
    ----------
    time : float
        Its time stamp, s.
    image : (height, width, 3) uint8
        Blue, green, red (OpenCV's order), as it is to be looked at (rotated where the file says so).
    index : int
        How many frames came before it. It is no clock: times come from `time` alone.
    """

    time: float
    image: Image
    index: int


class VideoReader:
    """The frames of a video file, read one after the other.

    Parameters
    ----------
    path : path-like
        A file that FFmpeg reads: MP4, MOV, MKV, AVI, WebM, ...

    Attributes
    ----------
    image_size : (int, int)
        Width and height of the frames as given out, px.
    rotation : int
        By which they are turned counterclockwise against the stored ones, degrees: 0, 90, 180 or -90.
    readout_direction : str
        In which rows of a sensor that was read from top to bottom follow each other now, for :class:`Camera`.
    frame_interval : float or None
        Mean time from frame to frame, s, where the file says so.
    frame_count : int
        Frames given out so far.
    notes : list of str
        What was wrong with what has been read so far (a file cut off, frames that cannot be decoded or have no time).

    Raises
    ------
    FileProblem
        On opening: there is no such file, it is empty, cut off or no video, or not one frame of it can be read. At the
        end, if not one frame has a time stamp.

    Notes
    -----
    Times are the container's (presentation time stamp times time base), never index over frame rate: phones vary their
    rate and list frames that are not there. A frame that comes no later than the one before it is left out, and said so
    in `notes`. The file is read once, in one direction; only one frame is held.

    Examples
    --------
    >>> import tempfile, pathlib, numpy as np
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "dark.mp4"
    >>> with VideoWriter(path, (64, 48)) as video:
    ...     for time in (0.0, 0.1, 0.35):
    ...         video.write(np.zeros((48, 64, 3), np.uint8), time)
    >>> with VideoReader(path) as video:
    ...     [round(frame.time, 3) for frame in video]
    [0.0, 0.1, 0.35]
    """

    def __init__(self, path: PathLike) -> None:
        self.path = as_path(path, "video")
        self.notes: list[str] = []
        self.frame_count = 0
        self.rotation = 0
        self._stack = ExitStack()
        self._broken = self._untimed = self._backwards = 0
        self._last: float | None = None
        try:
            self._stream = self._open()
            self._decoded = self._decode()
            self._first: Any = next(self._decoded, None)
            if self._first is None:
                said = f" ({'; '.join(self.notes)})" if self.notes else ""
                raise FileProblem(f"Not one frame of {self.path} can be read{said}. Get the file again.")
            self._rotate(self._first)
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._stack.close()
        self._decoded, self._first = iter(()), None

    def __iter__(self) -> Iterator[Frame]:
        while (frame := self._next()) is not None:
            if frame.pts is None or frame.time_base is None:
                self._untimed += 1
                continue
            time = float(frame.pts * frame.time_base)
            if self._last is not None and time <= self._last:
                self._backwards += 1
                continue
            image = _turned(frame.to_ndarray(format="bgr24"), self.rotation)
            if image.shape[1::-1] != self.image_size:
                self.notes.append(
                    f"the picture changes its size at {time:g} s from {self.image_size} to {image.shape[1::-1]} px; "
                    "the video is read up to there"
                )
                break
            self._last = time
            self.frame_count += 1
            yield Frame(time, image, self.frame_count - 1)
        self._finish()

    def _open(self) -> Any:
        """Open the file and return its video stream."""
        import av

        regular_file(self.path, "video", math.inf)
        try:
            container = self._stack.enter_context(av.open(str(self.path)))
        except (av.FFmpegError, OSError, ValueError) as error:
            raise FileProblem(
                f"{self.path} cannot be read as a video ({_reason(error)}). It is no video, or was cut off before its "
                "index was written; get it again, or convert it with ffmpeg."
            ) from None
        kinds = sorted({stream.type for stream in container.streams})
        if "video" not in kinds:
            raise FileProblem(
                f"{self.path} holds no video, {_held(self.path, kinds)}. Get it again, or give another file."
            )
        stream = container.streams.video[0]
        context: Any = stream.codec_context
        if context is None:
            raise FileProblem(f"{self.path}: the video's coding is not known here. Convert it to H.264 with ffmpeg.")
        if context.width * context.height > _LARGEST:
            raise FileProblem(
                f"{self.path}: frames of {context.width} x {context.height} px are too large (at most {_LARGEST:.0e} "
                "pixels). The file is damaged, or is to be made smaller with ffmpeg."
            )
        self._container = container
        return stream

    def _decode(self) -> Iterator[Any]:
        """Yield the decoded frames; packets that cannot be decoded are counted."""
        import av

        try:
            for packet in self._container.demux(self._stream):
                try:
                    frames = packet.decode()
                except (av.FFmpegError, OSError, ValueError):
                    self._broken += 1
                    continue
                yield from frames
        except (av.FFmpegError, OSError, ValueError) as error:
            self.notes.append(f"the file breaks off: {_reason(error)}")

    def _next(self) -> Any:
        frame, self._first = self._first, None
        return next(self._decoded, None) if frame is None else frame

    def _rotate(self, frame: Any) -> None:
        """Note how frames are to be turned, and how large they are then."""
        turn = round(float(frame.rotation) / 90.0) * 90
        if abs(frame.rotation - turn) > 1.0:
            self.notes.append(f"the file asks for a rotation by {frame.rotation} degrees; only quarter turns are done")
        self.rotation = 180 if turn == -180 else turn
        self.readout_direction = _READOUT[turn]
        size = (frame.width, frame.height)
        self.image_size = size if turn % 180 == 0 else size[::-1]
        rate = self._stream.average_rate
        self.frame_interval = 1.0 / float(rate) if rate else None

    def _finish(self) -> None:
        """Note what was wrong with the whole file."""
        counts = {
            "parts that cannot be decoded were left out": self._broken,
            "frames without a time stamp were left out": self._untimed,
            "frames no later than the one before were left out": self._backwards,
        }
        self.notes += [f"{count} {what}" for what, count in counts.items() if count]
        listed = int(self._stream.frames)
        if listed > self.frame_count:
            self.notes.append(f"the file lists {listed} frames, {self.frame_count} could be read")
        untimed, self._broken, self._untimed, self._backwards = self._untimed, 0, 0, 0
        if untimed and not self.frame_count:
            raise FileProblem(
                f"The frames of {self.path} have no time stamps: it is a raw stream without a container. Say how many "
                f"a second there are, as in: ffmpeg -framerate 30 -i {self.path.name} -c copy {self.path.stem}.mp4"
            )


class VideoWriter:
    """An MP4 file (H.264) that is written whole or not at all.

    Parameters
    ----------
    path : path-like
        Where it shall stand; ends in .mp4.
    image_size : (int, int)
        Width and height of the frames, px. An odd one is made even by repeating the last row or column.
    quality : int
        x264's constant rate factor, 0 (lossless) to 51; 18 is hard to tell from the original.

    Raises
    ------
    InvalidInput
        For another suffix, a frame of another size, or a time no later than the one before.
    FileProblem
        If the file cannot be written. What stood there before still stands, also where the block ends in an error.
    """

    def __init__(self, path: PathLike, image_size: tuple[int, int], quality: int = 18) -> None:
        self.path = as_path(path, "video")
        if self.path.suffix.lower() != ".mp4":
            raise InvalidInput("the video has the wrong suffix", got=str(path), allowed="a name ending in .mp4")
        self.image_size = checks.count("image width", image_size[0]), checks.count("image height", image_size[1])
        self._quality = checks.count("quality", quality, least=0, most=51)
        self._stack = ExitStack()
        self._ticks: int | None = None

    def __enter__(self) -> Self:
        import av

        with ExitStack() as stack:
            part = stack.enter_context(atomic_path(self.path))
            container = stack.enter_context(av.open(str(part), "w", options={"movflags": "+faststart"}))
            options = {"crf": str(self._quality), "preset": "veryfast", "bf": "0"}
            stream: Any = container.add_stream("libx264", rate=30, options=options)
            stream.width, stream.height = (size + size % 2 for size in self.image_size)
            stream.pix_fmt = "yuv420p"
            stream.time_base = stream.codec_context.time_base = _TICK
            self._container, self._stream = container, stream
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        import av

        with self._stack:
            try:
                if kind is not None:
                    raise error if error is not None else kind()
                if self._ticks is None:
                    raise InvalidInput("the video has no frame", got=str(self.path), fix="Write one before closing it")
                self._container.mux(self._stream.encode(None))
            except av.FFmpegError as problem:
                raise OSError(getattr(problem, "errno", None), _reason(problem)) from problem

    def write(self, image: Image, time: float) -> None:
        """Add a frame.

        Parameters
        ----------
        image : (height, width, 3) uint8
            Blue, green, red.
        time : float
            Its time stamp, s, at least 1/90000 s after the one before and not negative; it is kept to that.
        """
        import av

        width, height = self.image_size
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            got = f"{image.shape} {image.dtype}"
            raise InvalidInput("the frame does not fit the video", got=got, allowed=f"({height}, {width}, 3) uint8")
        ticks = round(checks.number("frame time", time, sign="nonnegative", unit="s") / _TICK)
        if self._ticks is not None and ticks <= self._ticks:
            last = float(self._ticks * _TICK)
            raise InvalidInput("the frame is no later than the one before", got=time, allowed=f"after {last:g} s")
        self._ticks = ticks
        if width % 2 or height % 2:
            image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
        frame.pts, frame.time_base = ticks, _TICK
        self._container.mux(self._stream.encode(frame))


def _held(path: Path, kinds: Sequence[str]) -> str:
    """Return what a file without a picture holds; FFmpeg takes it as streams of these `kinds`."""
    if path.suffix.lower() in (".toml", ".csv", ".txt"):
        return f"but text ({path.suffix.lower()})"
    return f"only {' and '.join(kinds)}" if kinds else "nothing at all: it was cut off"


def _turned(image: Image, rotation: int) -> Image:
    """Return the picture turned counterclockwise by quarter turns, degrees."""
    return image if rotation == 0 else np.ascontiguousarray(np.rot90(image, rotation // 90))


def _reason(error: BaseException) -> str:
    """Return what FFmpeg said, without its numbers and the file's name."""
    return str(getattr(error, "strerror", None) or error).splitlines()[0]
