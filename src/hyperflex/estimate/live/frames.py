"""Frames of a camera, stream or file, read in a thread of its own, so that nobody waits for a source that stalls."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, Self

from hyperflex import checks
from hyperflex.errors import HyperflexError
from hyperflex.vision import Frame, LiveCamera, VideoReader

RECONNECT_TIMEOUT = 10.0  # s, in which a camera or stream that broke off is opened again
_PAUSE = 0.5  # s, between two tries
_CLOSEST = 1e-3  # s, between the last frame of a source and the first one after it was opened again
_AHEAD = 2  # frames of a file that are read ahead


class Source(Protocol):
    """What frames come from: a camera, a stream, or a file."""

    image_size: tuple[int, int]
    notes: list[str]

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames as they come."""

    def close(self) -> None:
        """Give the source back."""


class Arrival(NamedTuple):
    """A frame that has come.

    Attributes
    ----------
    frame : Frame
    at : float
        When, by this machine's monotonic clock, s; of a file that is not paced: when it was taken.
    missed : int
        Frames since the one before that nobody took in time.
    opening : int
        How often the source had been opened again by then. Time stamps begin anew with each time.
    """

    frame: Frame
    at: float
    missed: int
    opening: int = 0


class JoinedStamps:
    """Keeps the frames' own time stamps, and joins those of a source that was opened again to those before.

    Notes
    -----
    What passed in between is taken from this machine's clock: it is uncertain by how late the frames came.
    """

    def __init__(self) -> None:
        self._last: Arrival | None = None
        self._shift = 0.0

    def __call__(self, arrival: Arrival) -> Frame:
        """Return the frame with its time on the clock of the first opening, s."""
        stamp, last = arrival.frame.time, self._last
        if last is not None and arrival.opening != last.opening:
            self._shift += last.frame.time - stamp + max(arrival.at - last.at, _CLOSEST)
        self._last = arrival
        return Frame(stamp + self._shift, arrival.frame.image, arrival.frame.index)


class FrameThread:
    """Reads frames and keeps the newest (of a camera or stream) or the next ones (of a file) until they are taken.

    Parameters
    ----------
    open_source : callable
        Opens the source; its errors are raised at once.
    live : bool
        Keep only the newest frame, and open the source again where it breaks off; else give out all, and end.
    paced : bool
        Give the frames out at the distances of their time stamps, from when the first one is taken.
    reconnect_timeout : float
        How long a source that broke off is tried again, s.

    Attributes
    ----------
    image_size : (int, int)
        Of the frames at the start, px.
    ended : str or None
        Why no more frames come; None while they may.
    """

    def __init__(
        self,
        open_source: Callable[[], Source],
        *,
        live: bool,
        paced: bool = False,
        reconnect_timeout: float = RECONNECT_TIMEOUT,
    ) -> None:
        self._open, self.live, self._paced = open_source, live, paced
        self.reconnect_timeout = checks.number("reconnect_timeout", reconnect_timeout, sign="nonnegative", unit="s")
        source = open_source()
        self.image_size = source.image_size
        self.ended: str | None = None
        self._notes: list[str] = []
        self._condition, self._waiting = threading.Condition(), deque[Arrival]()
        self._closed = self._played = False
        self._opening = 0
        self._thread = threading.Thread(target=self._run, args=(source,), name="frames", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def peek(self, timeout: float) -> Frame | None:
        """Return the next frame and leave it to be taken; None as of :meth:`take`."""
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self.ended is not None, timeout)
            return self._waiting[0].frame if self._waiting else None

    def take(self, timeout: float) -> Arrival | None:
        """Return the next frame; None where none comes within `timeout`, s, or the source has ended."""
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self.ended is not None, timeout)
            if not self._waiting:
                return None
            found = self._waiting.popleft()
            self._condition.notify_all()
            played, self._played = self.live or (self._paced and self._played), True
            return found if played else found._replace(at=time.monotonic())

    def messages(self) -> tuple[str, ...]:
        """Return what happened to the source since this was asked last: stalls, ends, frames that cannot be used."""
        with self._condition:
            said, self._notes = tuple(self._notes), []
            return said

    def close(self) -> None:
        """Stop reading; a driver that hangs is left alone."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join(1.0)

    def _run(self, source: Source) -> None:
        """Read until the end, and say why it is one."""
        try:
            reason = self._read(source)
        except HyperflexError as error:
            reason = str(error)
        except Exception as error:  # noqa: BLE001 whatever a driver does, whoever waits for a frame is to hear of it
            reason = f"the source failed: {type(error).__name__}: {error}"
        with self._condition:
            self.ended = reason
            self._condition.notify_all()

    def _read(self, source: Source) -> str:
        """Hand out the frames, opening a live source again where it breaks off; return why no more come."""
        while True:
            try:
                self._deliver(source)
            finally:
                source.close()
            if self._closed or not self.live:
                return "the source ended"
            self._say("no more frames come; the source is opened again")
            found = self._again()
            if found is None:
                return f"the source broke off, and could not be opened again within {self.reconnect_timeout:g} s"
            source = found
            self._opening += 1

    def _again(self) -> Source | None:
        """Open the source anew; None where that fails for too long."""
        until = time.monotonic() + self.reconnect_timeout
        while not self._closed:
            try:
                return self._open()
            except HyperflexError:
                if time.monotonic() >= until:
                    return None
                time.sleep(_PAUSE)
        return None

    def _deliver(self, source: Source) -> None:
        """Hand out the frames of a source until it breaks off."""
        begin: float | None = None
        told = 0
        for frame in source:
            if self._paced and begin is not None:
                self._wait(begin + frame.time)
            self._hand_out(frame)
            if self._paced and begin is None:
                begin = self._taken_at() - frame.time
            told = self._tell(source.notes, told)
            if self._closed:
                return
        self._tell(source.notes, told)

    def _hand_out(self, frame: Frame) -> None:
        with self._condition:
            missed = 0
            if self.live:
                missed = sum(1 + each.missed for each in self._waiting)
                self._waiting.clear()
            self._condition.wait_for(lambda: len(self._waiting) < _AHEAD or self._closed)
            self._waiting.append(Arrival(frame, time.monotonic(), missed, self._opening))
            self._condition.notify_all()

    def _taken_at(self) -> float:
        """Wait until all frames are taken, and return when that is."""
        with self._condition:
            self._condition.wait_for(lambda: not self._waiting or self._closed)
            return time.monotonic()

    def _tell(self, notes: list[str], told: int) -> int:
        """Pass on what a source has noted since; return how many notes there are."""
        for note in notes[told:]:
            self._say(note)
        return len(notes)

    def _say(self, words: str) -> None:
        with self._condition:
            self._notes.append(words)

    def _wait(self, moment: float) -> None:
        with self._condition:
            self._condition.wait_for(lambda: self._closed, max(0.0, moment - time.monotonic()))


def open_frames(source: int | str, *, paced: bool = False, reconnect_timeout: float = RECONNECT_TIMEOUT) -> FrameThread:
    """Open a camera by its number, a stream by its address (``rtsp://...``), or a file in place of one.

    Parameters
    ----------
    source : int or str
        A number in digits is a camera's.
    paced : bool
        Play a file at its own speed; else as fast as its frames are taken.
    reconnect_timeout : float
        How long a camera or stream that broke off is tried again, s.

    Raises
    ------
    FileProblem
        If nothing comes from there.
    """
    words = str(source)
    if words.isdecimal() or "://" in words:
        address = int(words) if words.isdecimal() else words
        return FrameThread(lambda: LiveCamera(address), live=True, reconnect_timeout=reconnect_timeout)
    return FrameThread(lambda: VideoReader(Path(words)), live=False, paced=paced, reconnect_timeout=reconnect_timeout)
