"""Frames of a camera, stream or file, read in a separate thread, so that a source that stalls blocks nobody."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

from hyperflex import checks
from hyperflex.errors import HyperflexError
from hyperflex.vision import Frame, LiveCamera, VideoReader

_CLOSEST = 1e-3  # s between the last frame of a source and the first one after it was opened again


class Source(Protocol):
    """Source of frames: a camera, a stream, or a file."""

    image_size: tuple[int, int]
    notes: list[str]

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames as they come."""

    def close(self) -> None:
        """Release the source."""


class Arrival(NamedTuple):
    """A frame that has come.

    Attributes
    ----------
    frame : Frame
    at : float
        When, by this machine's monotonic clock, s; for a file that is not paced: when it was taken.
    missed : int
        Frames since the one before that were skipped because nobody took them in time.
    opening : int
        How often the source had been opened again by then. The time stamps of the frame go on from those before: the
        time in between is taken from this machine's clock, uncertain by the delay of the frames.
    """

    frame: Frame
    at: float
    missed: int
    opening: int = 0


class FrameThread:
    """Reads frames and keeps them until they are taken: of a camera or stream the newest, of a file the next one.

    Parameters
    ----------
    open_source : callable
        Opens the source; its errors are raised at once.
    live : bool
        Give the newest frame, and open the source again if it breaks off; else give all frames, and end.
    paced : bool
        Give the frames at the intervals of their time stamps, from when the first one is taken.
    since : float
        Time of the first frame that is given, s.
    reconnect_timeout : float
        How long a source that broke off is tried again, s.

    Attributes
    ----------
    image_size : (int, int)
        Of the frames at the start, px.
    ended : str or None
        Why no more frames come; None while they may.
    """

    PAUSE = 0.5  # s between two attempts to open a source again
    AHEAD = 2  # frames of a file that are read ahead
    KEPT = 2**28  # bytes of a camera's frames that wait to be taken, at most; then the newest replaces the last one

    def __init__(
        self,
        open_source: Callable[[], Source],
        *,
        live: bool,
        paced: bool = False,
        since: float = -math.inf,
        reconnect_timeout: float = 10.0,
    ) -> None:
        self._open, self.live, self._paced, self._since = open_source, live, paced, since
        self.reconnect_timeout = checks.number("reconnect_timeout", reconnect_timeout, sign="nonnegative", unit="s")
        source = open_source()
        self.image_size = source.image_size
        self.ended: str | None = None
        self._notes: list[str] = []
        self._condition, self._waiting = threading.Condition(), deque[Arrival]()
        self._closed = self._played = False
        self._behind = self._left = 0  # frames that are given one by one, and how many of these are left
        self._last: Arrival | None = None  # of the opening before
        self._opening = 0
        self._thread = threading.Thread(target=self._run, args=(source,), name="frames", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def peek(self, timeout: float) -> Frame | None:
        """Return the next frame without taking it; None as :meth:`take`."""
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self.ended is not None, timeout)
            return self._waiting[-self.live].frame if self._waiting else None

    def take(self, timeout: float) -> Arrival | None:
        """Return the next frame, of a camera the newest; None if none comes within `timeout`, s, or it has ended."""
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self.ended is not None, timeout)
            if not self._waiting:
                return None
            if not self._left:  # then those that came meanwhile, if they are half as many or less
                self._behind = self._left = len(self._waiting) if 2 * len(self._waiting) <= self._behind else 0
            skipped = 0 if self._left or not self.live else len(self._waiting) - 1
            passed = [self._waiting.popleft() for _ in range(skipped + 1)]
            found = passed[-1]._replace(missed=skipped + sum(each.missed for each in passed))
            self._left -= self._left > 0
            self._condition.notify_all()
            played, self._played = self.live or (self._paced and self._played), True
            return found if played else found._replace(at=time.monotonic())

    def catch_up(self) -> int:
        """Give the frames of a camera that wait one by one, and return how many these are; 0 while it does so already.

        So too those that come meanwhile, if they are half as many or less: else nobody takes them fast enough.
        """
        with self._condition:
            if self._behind:
                return 0
            self._behind = self._left = len(self._waiting) * self.live
            return self._behind

    def messages(self) -> tuple[str, ...]:
        """Return what happened to the source since the last call: stalls, ends, frames that cannot be used."""
        with self._condition:
            new, self._notes = tuple(self._notes), []
            return new

    def close(self) -> None:
        """Stop reading; a driver that hangs is not waited for."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join(1.0)

    def _run(self, source: Source) -> None:
        """Read until the end, and store its reason."""
        try:
            reason = self._read(source)
        except HyperflexError as error:
            reason = str(error)
        except Exception as error:  # noqa: BLE001 a driver may raise anything, and the reader must learn of it
            reason = f"the source failed: {type(error).__name__}: {error}"
        with self._condition:
            self.ended = reason
            self._condition.notify_all()

    def _read(self, source: Source) -> str:
        """Deliver the frames, opening a live source again if it breaks off; return why no more come."""
        while True:
            try:
                self._deliver(source)
            finally:
                source.close()
            if self._closed or not self.live:
                return "the source ended"
            self._add_notes(["no more frames come; the source is opened again"])
            reopened = self._reopen()
            if reopened is None:
                return f"the source broke off, and could not be opened again within {self.reconnect_timeout:g} s"
            source = reopened
            self._opening += 1

    def _reopen(self) -> Source | None:
        """Open the source again; None if that fails for too long."""
        until = time.monotonic() + self.reconnect_timeout
        while not self._closed:
            try:
                return self._open()
            except HyperflexError:
                if time.monotonic() >= until:
                    return None
                time.sleep(self.PAUSE)
        return None

    def _deliver(self, source: Source) -> None:
        """Deliver the frames of a source until it breaks off."""
        begin: float | None = None
        count, shift, last = 0, 0.0, self._last
        for index, each in enumerate(source):
            if each.time < self._since:
                continue
            if last is not None and not index:
                shift = last.frame.time - each.time + max(time.monotonic() - last.at, _CLOSEST)
            frame = Frame(each.time + shift, each.image, each.index)
            with self._condition:
                if self._paced and begin is not None:
                    moment = begin + frame.time
                    self._condition.wait_for(lambda: self._closed, max(0.0, moment - time.monotonic()))
                full = self.live and bool(self._waiting) and (len(self._waiting) + 1) * frame.image.nbytes > self.KEPT
                missed = 1 + self._waiting.pop().missed if full else 0
                self._condition.wait_for(lambda: self.live or len(self._waiting) < self.AHEAD or self._closed)
                self._last = Arrival(frame, time.monotonic(), missed, self._opening)
                self._waiting.append(self._last)
                self._condition.notify_all()
                if self._paced and begin is None:  # time runs from when the first frame is taken
                    self._condition.wait_for(lambda: not self._waiting or self._closed)
                    begin = time.monotonic() - frame.time
            self._add_notes(source.notes[count:])
            count = len(source.notes)
            if self._closed:
                return
        self._add_notes(source.notes[count:])

    def _add_notes(self, notes: list[str]) -> None:
        with self._condition:
            self._notes += notes


def open_frames(
    source: int | str | Source, *, paced: bool = False, since: float = -math.inf, reconnect_timeout: float = 10.0
) -> FrameThread:
    """Open a camera by its number, a stream by its address (``rtsp://...``), or a file in place of one.

    Parameters
    ----------
    source : int, str or Source
        A number in digits is a camera's. A source that is open already counts as a camera.
    paced : bool
        Play a file at its own speed; else as fast as its frames are taken.
    since : float
        Time of the first frame of a file that is given, s.
    reconnect_timeout : float
        How long a camera or stream that broke off is tried again, s.

    Raises
    ------
    FileProblem
        If the source cannot be opened, or gives no frame.
    """
    if not isinstance(source, int | str):
        return FrameThread(lambda: source, live=True, reconnect_timeout=reconnect_timeout)
    words = str(source)
    if words.isdecimal() or "://" in words:
        address = int(words) if words.isdecimal() else words
        return FrameThread(lambda: LiveCamera(address), live=True, reconnect_timeout=reconnect_timeout)
    how: dict[str, Any] = {"paced": paced, "since": since, "reconnect_timeout": reconnect_timeout}
    return FrameThread(lambda: VideoReader(Path(words)), live=False, **how)
