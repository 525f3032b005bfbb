"""Live cameras and streams through OpenCV, with the driver's time stamps where it gives them."""

import os
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any, Self

from hyperflex import checks
from hyperflex.errors import FileProblem, InvalidInput
from hyperflex.vision.video import Frame

_TIMEOUT = 10.0  # s, of opening a stream and of a frame


class LiveCamera:
    """The frames of a camera or stream as they come.

    Parameters
    ----------
    source : int or str
        The camera's number (0 is the first), or the address of a stream (rtsp://...), or a file in place of one.
    image_size : (int, int), optional
        Width and height to ask the camera for, px; what it gives stands in `image_size`.
    timeout : float
        How long to wait for a stream to open or to go on, s. Cameras wait as long as their driver does.

    Attributes
    ----------
    image_size : (int, int)
        Of the frames, px.
    stamps : {"driver", "arrival"}
        Whose the time stamps are: the driver's or stream's own clock, or this machine's monotonic clock when the frame
        arrived (0.1 to 0.9 s late, by another amount at each start).
    notes : list of str
        What happened: the stream ended or stalled, frames changed their size, times went back.

    Raises
    ------
    FileProblem
        If there is no such camera or stream, or no frame comes from it.

    Notes
    -----
    Tried with files and streams in place of a camera; not validated against a camera's driver.
    """

    def __init__(self, source: int | str, image_size: tuple[int, int] | None = None, timeout: float = _TIMEOUT) -> None:
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
