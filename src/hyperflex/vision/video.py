"""Pictures, videos, cameras and streams: frames with the time stamps of their source, and writing of MP4."""

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
import numpy.typing as npt

from hyperflex import checks, files
from hyperflex.errors import FileProblem, Interrupted, InvalidInput
from hyperflex.files import PathLike, as_path, atomic_path, regular_file
from hyperflex.interruption import stoppable

Image = npt.NDArray[np.uint8]
T = TypeVar("T")

_TICK = Fraction(1, 90_000)  # s, time base of files that are written
_LARGEST = 100_000_000  # pixels of a frame: more is a damaged header, not a camera
_UNTIMED = "frames without a time stamp were skipped"
SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"})  # of pictures; others are videos
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
    """Sequential reader of the frames of a video file.

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
        Mean time between frames, s, if the file declares it.
    frame_count : int
        Frames given out so far.
    notes : list of str
        Problems of the part read so far (truncated file, frames that cannot be decoded or have no time).

    Raises
    ------
    FileProblem
        On opening: there is no such file, it is empty, cut off or no video, or not one frame of it can be read. At the
        end, if not one frame has a time stamp.

    Notes
    -----
    Times are those of the container (presentation time stamp times time base), never index over frame rate, because
    phones vary their rate and list missing frames. A frame that is not later than the previous one is omitted and
    reported in `notes`. The file is read once, forwards, with one frame in memory.

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
        self._skipped = Counter[str]()
        try:
            self._stream = self._open()
            decoded = self._decode()
            first = next(decoded, None)
            if first is None:
                why = f" ({'; '.join(self.notes)})" if self.notes else ""
                raise FileProblem(f"No frame of {self.path} can be read{why}. Get the file again.")
            self._decoded = chain([first], decoded)
            self._rotate(first)
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._stack.close()
        self._decoded = chain()

    def __iter__(self) -> Iterator[Frame]:
        last = -math.inf
        for frame in self._decoded:
            if frame.pts is None or frame.time_base is None:
                self._skipped[_UNTIMED] += 1
                continue
            stamp = float(frame.pts * frame.time_base)
            if stamp <= last:
                self._skipped["frames no later than the one before were skipped"] += 1
                continue
            with _enough_memory(f"a frame of {self.path}"):
                stored = frame.to_ndarray(format="bgr24")
            image = np.rot90(stored, self.rotation // 90)
            if image.shape[1::-1] != self.image_size:
                self.notes.append(
                    f"the picture changes its size at {stamp:g} s from {self.image_size} to {image.shape[1::-1]} px; "
                    "the video is read up to there"
                )
                break
            last = stamp
            self.frame_count += 1
            yield Frame(stamp, np.ascontiguousarray(image), self.frame_count - 1)
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
                f"{self.path} contains no video, {_held(self.path, kinds)}. Get it again, or give another file."
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
                    with _enough_memory(f"a frame of {self.path}"):
                        frames = packet.decode()
                except (av.FFmpegError, OSError, ValueError):
                    self._skipped["parts that cannot be decoded were skipped"] += 1
                    continue
                yield from frames
        except (av.FFmpegError, OSError, ValueError) as error:
            self.notes.append(f"the file breaks off: {_reason(error)}")

    def _rotate(self, frame: Any) -> None:
        """Record the rotation of frames and their size after it."""
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
        """Note the problems of the whole file."""
        self.notes += [f"{count} {what}" for what, count in self._skipped.items()]
        listed = int(self._stream.frames)
        if listed > self.frame_count:
            self.notes.append(f"the file lists {listed} frames, {self.frame_count} could be read")
        untimed = self._skipped.pop(_UNTIMED, 0)
        self._skipped.clear()
        if untimed and not self.frame_count:
            raise FileProblem(
                f"The frames of {self.path} have no time stamps: it is a raw stream without a container. Give its "
                f"frame rate, as in: ffmpeg -framerate 30 -i {self.path.name} -c copy {self.path.stem}.mp4"
            )


class VideoWriter:
    """An MP4 file (H.264) that is written whole or not at all.

    Parameters
    ----------
    path : path-like
        Path of the file; ends in .mp4.
    image_size : (int, int)
        Width and height of the frames, px. An odd one is made even by repeating the last row or column.
    quality : int
        x264's constant rate factor, 0 (lossless) to 51; 18 is visually almost lossless.

    Raises
    ------
    InvalidInput
        For another suffix, a frame of another size, or a time no later than the one before.
    FileProblem
        If the file cannot be written. An earlier file is then unchanged, also if the block raises an error.
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
        with _enough_memory(f"a frame of {self.path}"):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
            frame.pts, frame.time_base = ticks, _TICK
            self._container.mux(self._stream.encode(frame))


class LiveCamera:
    """The frames of a camera or stream as they come.

    Parameters
    ----------
    source : int or str
        The camera's number (0 is the first), or the address of a stream (rtsp://...), or a file in place of one.
    image_size : (int, int), optional
        Requested width and height, px; the attribute `image_size` has the actual ones.
    timeout : float
        Longest wait for a stream to open or to continue, s. Cameras wait as long as their driver does.

    Attributes
    ----------
    image_size : (int, int)
        Of the frames, px.
    stamps : {"driver", "arrival"}
        Whose the time stamps are: the driver's or stream's own clock, or this machine's monotonic clock when the frame
        arrived (0.1 to 0.9 s late, by another amount at each start).
    notes : list of str
        Events: the stream ended or stalled, frames changed their size, times went back.

    Raises
    ------
    FileProblem
        If there is no such camera or stream, or no frame comes from it.

    Notes
    -----
    Tested with files and streams instead of a camera; not validated against a camera's driver.
    """

    def __init__(self, source: int | str, image_size: tuple[int, int] | None = None, timeout: float = 10.0) -> None:
        import cv2

        if isinstance(source, bool) or not isinstance(source, (int, str)) or (isinstance(source, int) and source < 0):
            raise InvalidInput("source is no camera", got=source, allowed="a camera's number (0, 1, ..) or an address")
        wait = round(1e3 * checks.number("timeout", timeout, sign="positive", unit="s"))
        self.source = source
        self.notes: list[str] = []
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # quiet, as the next lines make OpenCV itself
        level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what goes wrong is said below
        try:
            if isinstance(source, int):
                self._capture: Any = cv2.VideoCapture(source)
            else:
                limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, wait, cv2.CAP_PROP_READ_TIMEOUT_MSEC, wait]
                self._capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, limits)
        finally:
            cv2.utils.logging.setLogLevel(level)
        if not self._capture.isOpened():
            raise FileProblem(
                f"There is no camera or stream {source!r}, or another program has it. Check its number or address."
            )
        if image_size is not None:
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, checks.count("image width", image_size[0]))
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, checks.count("image height", image_size[1]))
        self._waiting = [found for found in (self._grab(), self._grab()) if found is not None]
        if not self._waiting:
            self.close()
            raise FileProblem(f"No frame comes from {source!r}. Check the camera and its cable, or the address.")
        driver = [found[1] for found in self._waiting]
        self.stamps = "driver" if len(driver) == 2 and 0.0 <= driver[0] < driver[1] else "arrival"
        self.image_size: tuple[int, int] = self._waiting[0][0].shape[1::-1]
        self.frame_count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the camera back."""
        self._capture.release()
        self._waiting = []

    def __iter__(self) -> Iterator[Frame]:
        last = -float("inf")
        while True:
            found = self._waiting.pop(0) if self._waiting else self._grab()
            if found is None:
                self.notes.append(f"the source ended or stalled after {self.frame_count} frames")
                return
            image, driver, arrival = found
            stamp = driver if self.stamps == "driver" else arrival
            if image.shape[1::-1] != self.image_size:
                self.notes.append(f"frames change their size from {self.image_size} to {image.shape[1::-1]} px")
                self.image_size = image.shape[1::-1]
            if stamp <= last:
                self.notes.append(f"a frame at {stamp:g} s, no later than the one before at {last:g} s, was left out")
                continue
            last = stamp
            self.frame_count += 1
            yield Frame(stamp, image, self.frame_count - 1)

    def _grab(self) -> tuple[Any, float, float] | None:
        """Return the next picture with the driver's stamp and the time of its arrival, s; None at the end."""
        import cv2

        if not self._capture.grab():
            return None
        arrival = time.monotonic()
        driver = 1e-3 * self._capture.get(cv2.CAP_PROP_POS_MSEC)
        ok, image = self._capture.retrieve()
        return (image, driver, arrival) if ok else None


def follow_video(
    reader: VideoReader,
    look: Callable[[Frame, bool], Image | None],
    result: Callable[[], T],
    *,
    preview: PathLike | None,
    progress: Callable[[int], None] | None,
) -> T:
    """Process the frames of a video one after the other, and return the result of all.

    Parameters
    ----------
    reader : VideoReader
    look : callable
        Processes a frame; returns its picture for the preview if the second argument is True.
    result : callable
        Returns the result of the frames processed, a dataclass with a field ``interrupted``; raises InvalidInput if
        they are too few.
    preview : path-like or None
        MP4 file of the pictures.
    progress : callable or None
        Called with the number of frames done.

    Raises
    ------
    Interrupted
        By Ctrl-C; its ``partial`` is the result of the frames before, if there is one. No preview is kept.
    """
    with ExitStack() as stack:
        writer = None if preview is None else stack.enter_context(VideoWriter(preview, reader.image_size))
        with stoppable() as stop:
            for count, frame in enumerate(reader, start=1):
                shown = look(frame, writer is not None)
                if writer is not None and shown is not None:
                    writer.write(shown, frame.time)
                if progress is not None:
                    progress(count)
        if not stop.received:
            return result()
        with suppress(InvalidInput):
            raise Interrupted(replace(result(), interrupted=True))  # type: ignore[type-var]
        raise Interrupted


def read_image(path: PathLike) -> Image:
    """Return a picture (height, width, 3), uint8, blue, green, red; turned as its file says.

    Raises
    ------
    FileProblem
        If there is no such file, or it is no picture, empty or cut off.
    """
    import cv2

    content = np.frombuffer(files.read_bytes(path, "picture"), dtype=np.uint8)
    try:
        image = cv2.imdecode(content, cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise FileProblem(f"{path} cannot be read as a picture. It is none, or was cut off; get it again.")
    return np.asarray(image, dtype=np.uint8)


def read_pictures(paths: Iterable[PathLike], interval: float = 0.2) -> Iterator[Image]:
    """Yield the pictures of files one after the other: of a video, those at least `interval` (s) apart.

    Raises
    ------
    FileProblem
        As :func:`read_image` and :class:`VideoReader`.
    """
    for path in paths:
        if as_path(path, "picture").suffix.lower() in SUFFIXES:
            yield read_image(path)
            continue
        last = -np.inf
        with VideoReader(path) as video:
            for frame in video:
                if frame.time - last >= interval - 1e-9:
                    last = frame.time
                    yield frame.image


@contextmanager
def _enough_memory(what: str) -> Iterator[None]:
    """Raise MemoryError where FFmpeg lacks memory for `what`; without it, it starts no threads ("try again")."""
    try:
        yield
    except (MemoryError, BlockingIOError) as error:
        raise MemoryError(f"no room for {what}: close other programs, or make its frames smaller") from error


def _held(path: Path, kinds: Sequence[str]) -> str:
    """Return what a file without a picture holds; FFmpeg takes it as streams of these `kinds`."""
    if path.suffix.lower() in (".toml", ".csv", ".txt"):
        return f"but text ({path.suffix.lower()})"
    return f"only {' and '.join(kinds)}" if kinds else "nothing at all: it was cut off"


def _reason(error: BaseException) -> str:
    """Return what FFmpeg said, without its numbers and the file's name."""
    return str(getattr(error, "strerror", None) or error).splitlines()[0]
