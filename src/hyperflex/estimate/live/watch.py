"""The estimate of a rope at each frame of a live source and between frames that do not come, and its log."""

import math
import operator
import statistics
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np

from hyperflex import __version__
from hyperflex.checks import Array
from hyperflex.errors import FileProblem, SimulationError
from hyperflex.estimate.live.frames import Arrival, FrameThread
from hyperflex.estimate.tracker import RopeTracker, TrackedFrame
from hyperflex.files import NetCDF, PathLike, Variable, as_path, rescued, write_netcdf
from hyperflex.interfaces import RopeState
from hyperflex.vision import Frame


@dataclass(frozen=True, eq=False)
class LiveEstimate:
    """The estimate of the rope at one instant.

    Attributes
    ----------
    t : float
        Its instant, on the clock of the frames' time stamps, s.
    state : RopeState
        With its covariance. If the rope has not been found: hanging, with any angle possible.
    found : bool
        Whether the rope has been found.
    tip : (2,) float64
        Position of the tip, m.
    tip_std : float
        Standard deviation of the tip along the worse direction, m; inf if the rope has not been found.
    age : float
        Time since a marker was last seen, s; inf before the first.
    seen, markers : int
        Markers seen in this frame, and all.
    latency : float
        From the frame's arrival to this estimate, s; NaN if no frame came.
    rate : float
        Recent frames per second.
    frame : Frame or None
        None: no frame came, and the estimate is a prediction.
    tracked : TrackedFrame or None
        Result of the frame; None if it could not be used.
    messages : tuple of str
        What happened since the estimate before.
    """

    t: float
    state: RopeState
    found: bool
    tip: Array
    tip_std: float
    age: float
    seen: int
    markers: int
    latency: float
    rate: float
    frame: Frame | None
    tracked: TrackedFrame | None
    messages: tuple[str, ...]


class Watch:
    """Tracks a rope in frames as they come; iterating gives a :class:`LiveEstimate` for each, and while none come.

    Parameters
    ----------
    frames : FrameThread
    tracker : RopeTracker
    interval : float
        Time without a frame after which an estimate is given all the same, s.
    retime : callable, optional
        Returns the frame of an :class:`Arrival` with another time stamp; by default its own.
    before : callable, optional
        Called when a frame has come; returns whether the rope is looked for in it.

    Attributes
    ----------
    skipped : int
        Frames since the first one that came while others were processed, and were left out.

    Notes
    -----
    Frames of another size than the camera's are skipped. Gaps of up to 2 s are bridged by the rope's equations; after
    longer ones, and when the source was opened again, the rope is searched anew. A search takes as long as many frames:
    once it has found the rope, those that came meanwhile are worked off, because a single picture shows no velocity, by
    which a moving rope could be followed to the newest one.
    """

    STALLED = 0.5  # s without a frame after which that is reported
    LONGEST = 2.0  # s, gap that is bridged by prediction; after a longer one the state is forgotten
    MISSING = 1.75  # times the usual time between frames: a longer gap means missing frames
    RECENT = 30  # frames that the usual time between frames and the rate are taken from

    def __init__(
        self,
        frames: FrameThread,
        tracker: RopeTracker,
        *,
        interval: float = 0.1,
        retime: Callable[[Arrival], Frame] = operator.attrgetter("frame"),
        before: Callable[[], bool] = lambda: True,
    ) -> None:
        self.frames, self.tracker, self.interval = frames, tracker, interval
        self._retime, self._before = retime, before
        self._last: Arrival | None = None  # its frame with the new time stamp
        self._gaps, self._arrivals = deque[float](maxlen=self.RECENT), deque[float](maxlen=2 * self.RECENT)
        self._seen_at = -math.inf
        self._stalled = self._wrong_size = False
        self._messages: list[str] = []
        self.skipped = 0

    def __iter__(self) -> Iterator[LiveEstimate]:
        while True:
            arrival = self.frames.take(self.interval)
            self._messages += self.frames.messages()
            if arrival is not None:
                yield self._process(arrival._replace(frame=self._retime(arrival)))
            elif self.frames.ended is None:
                yield self._wait()
            else:
                if self._messages:  # about the end: they are given with a last estimate
                    yield self._wait()
                return

    def _process(self, arrival: Arrival) -> LiveEstimate:
        """Track the rope in a frame."""
        frame, estimator, tracked = arrival.frame, self.tracker.estimator, None
        self._note_gap(arrival)
        known = estimator.t is not None
        if self._before() and self._fits(frame):
            try:
                tracked = self.tracker.look(frame)
            except (SimulationError, np.linalg.LinAlgError) as error:
                self._messages.append(f"the estimate was lost and starts anew: {error}")
                estimator.restart()
        if tracked is not None:
            self._messages += [str(change) for change in tracked.changes]
            if tracked.state is not None:
                self._seen_at = max(self._seen_at, tracked.t - estimator.age)
            searched = getattr(self.tracker.measurement, "searched", not known)
            if searched and tracked.seen.any() and (behind := self.frames.catch_up()):
                self._messages.append(f"{behind} frames came during the search, and are worked off")
        return self._estimate(frame.time, frame, tracked, time.monotonic() - arrival.at)

    def _wait(self) -> LiveEstimate:
        """Return the prediction while no frame comes."""
        if self._last is None:
            return self._estimate(self.tracker.camera.delay, None, None, math.nan)
        since = time.monotonic() - self._last.at
        if since > self.STALLED and not self._stalled:
            self._messages.append(f"no frame for {since:.1f} s")
            self._stalled = True
        return self._estimate(self._last.frame.time + since, None, None, math.nan)

    def _estimate(
        self, stamp: float, frame: Frame | None, tracked: TrackedFrame | None, latency: float
    ) -> LiveEstimate:
        state, found = self._state(self.tracker.camera.middle_of(stamp), tracked)
        tip, wide = self.tracker.estimator.tip(state)
        messages, self._messages = tuple(self._messages), []
        span = self._arrivals[-1] - self._arrivals[0] if self._arrivals else 0.0
        return LiveEstimate(
            state.t,
            state,
            found,
            tip,
            math.sqrt(float(np.linalg.eigvalsh(wide)[-1])) if found else math.inf,
            max(state.t - self._seen_at, 0.0),
            0 if tracked is None else int(tracked.seen.sum()),
            len(self.tracker.estimator.model.arc_lengths),
            latency,
            (len(self._arrivals) - 1) / span if span > 0.0 else 0.0,
            frame,
            tracked,
            messages,
        )

    def _state(self, t: float, tracked: TrackedFrame | None) -> tuple[RopeState, bool]:
        """Return the state at time t, s, and whether the rope has been found."""
        estimator = self.tracker.estimator
        if tracked is not None and tracked.state is not None:
            return tracked.state, True
        if estimator.t is not None and t - estimator.t <= self.LONGEST:
            try:
                return estimator.state_at(max(t, estimator.t)), True
            except SimulationError:
                estimator.restart()
        rope = estimator.process.rope
        n, rate = rope.n_links, 2.0 * rope.g / rope.total_length
        anywhere = np.repeat([1.0, rate], n) * math.pi**2 / 3.0  # variance of an angle between -pi and pi
        return RopeState(t, np.full(n, rope.hanging_angle), np.zeros(n), np.diag(anywhere)), False

    def _note_gap(self, arrival: Arrival) -> None:
        """Report what is missing before a frame, and start anew after a long gap."""
        last, stamp = self._last, arrival.frame.time
        self._last = arrival
        self._arrivals.append(arrival.at)
        if last is not None:
            self.skipped += arrival.missed
            gap, opened = stamp - last.frame.time, arrival.opening != last.opening
            usual = statistics.median(self._gaps) if len(self._gaps) > 2 else math.inf
            if opened or gap > self.LONGEST:
                why = "the source was opened again" if opened else f"a gap of {gap:.1f} s"
                self._messages.append(f"{why}: the rope is searched anew")
                self.tracker.estimator.restart()
                self._gaps.clear()
            elif arrival.missed:
                self._messages.append(f"{arrival.missed} frames skipped: they came while others were processed")
            elif gap > self.MISSING * usual:
                self._messages.append(f"{round(gap / usual) - 1} frames missing before {stamp:.3f} s")
            else:
                self._gaps.append(gap)
        if self._stalled:
            self._messages.append("frames come again")
            self._stalled = False

    def _fits(self, frame: Frame) -> bool:
        """Whether a frame has the camera's size; reports where that changes."""
        (width, height), expected = frame.image.shape[1::-1], self.tracker.camera.image_size
        fits = (width, height) == expected
        if not fits and not self._wrong_size:
            wanted = "x".join(map(str, expected))
            self._messages.append(f"frames of {width}x{height} px are skipped: the camera's file is of {wanted} px")
        if fits and self._wrong_size:
            self._messages.append(f"frames have {width}x{height} px again")
        self._wrong_size = not fits
        return fits


# name: dimensions besides time, unit, meaning
_VARIABLES = {
    "t": ((), "s", "instant of the estimate, on the clock of the frames' time stamps"),
    "q": (("link",), "rad", "angle of each link"),
    "qd": (("link",), "rad/s", "rate of each link"),
    "q_std": (("link",), "rad", "standard deviation of each angle; NaN if the rope is not found"),
    "qd_std": (("link",), "rad/s", "standard deviation of each rate; NaN if the rope is not found"),
    "tip": (("axis",), "m", "position of the tip"),
    "tip_std": ((), "m", "standard deviation of the tip along the worse direction; inf if the rope is not found"),
    "age": ((), "s", "time since a marker was last seen"),
    "latency": ((), "s", "from the frame's arrival to the estimate; NaN if no frame came"),
    "pixels": (("marker", "axis"), "px", "where each marker was seen; NaN: not seen"),
    "places": (("marker", "axis"), "m", "where each marker was seen, in the swing plane; NaN: not seen"),
    "predicted": (("marker", "axis"), "px", "where each marker was expected"),
    "frame": ((), "1", "1 if a frame came, 0 if the estimate is a prediction"),
    "found": ((), "1", "1 if the rope had been found"),
}


def _row(estimate: LiveEstimate) -> tuple[Any, ...]:
    """Return the values of an estimate in the order of the variables."""
    state, tracked, nothing = estimate.state, estimate.tracked, np.full((estimate.markers, 2), np.nan)
    wide = np.full(2 * state.q.size, np.nan)
    if estimate.found and state.covariance is not None:
        wide = np.sqrt(np.diagonal(state.covariance))
    seen = [nothing] * 3 if tracked is None else [tracked.pixels, tracked.places, tracked.predicted]
    tip = estimate.tip, estimate.tip_std, estimate.age, estimate.latency
    return estimate.t, state.q, state.qd, *np.split(wide, 2), *tip, *seen, estimate.frame is not None, estimate.found


class WatchLog:
    """Collects estimates, and writes them to a NetCDF file when the block ends.

    Parameters
    ----------
    path : path-like
        Ends in .nc. The file appears when the block ends, complete.
    links, markers : int
    source : str
        Where the frames come from.

    Attributes
    ----------
    ending : str
        Why the run ended, for the file.
    interrupted : bool
        Whether it was cut short.

    Notes
    -----
    Estimates are kept in an unnamed file next to `path`, not in memory, so that a run may last for hours. If the block
    ends in an error or Ctrl-C, all estimates until then are written, and the attributes ``interrupted`` and ``ending``
    say so; only a process that is killed leaves nothing.
    """

    def __init__(self, path: PathLike, links: int, markers: int, source: str) -> None:
        self.path, self.source = as_path(path, "log"), source
        self.ending, self.interrupted = "interrupted", False
        sizes = {"link": links, "marker": markers, "axis": 2}
        fields = [(name, np.float64, tuple(sizes[dim] for dim in dims)) for name, (dims, *_) in _VARIABLES.items()]
        self._row = np.zeros(1, dtype=np.dtype(fields))
        self._messages: list[str] = []
        self._count = 0

    def __enter__(self) -> Self:
        try:
            self._file = tempfile.TemporaryFile(dir=self.path.parent)
        except OSError as error:
            raise FileProblem(
                f"No log can be written in {self.path.parent}: {error.strerror}. Give another -o."
            ) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.interrupted = True
            self.ending = "interrupted" if issubclass(kind, KeyboardInterrupt) else f"failed: {error}"
        with self._file:
            if self._count:
                self._write()

    def note(self, estimate: LiveEstimate) -> None:
        """Add an estimate."""
        self._row[0] = _row(estimate)
        try:
            self._file.write(self._row.tobytes())
        except OSError as error:
            raise FileProblem(f"The log {self.path} cannot be continued: {error.strerror}. Free some space.") from error
        self._count += 1
        self._messages += [f"{estimate.t:.3f} s: {message}" for message in estimate.messages]

    def _write(self) -> None:
        self._file.flush()
        rows = np.memmap(self._file, dtype=self._row.dtype, mode="r", shape=(self._count,))
        variables = {
            name: Variable(("time", *dims), rows[name], {"units": unit, "long_name": about})
            for name, (dims, unit, about) in _VARIABLES.items()
        }
        attributes = {
            "title": "live estimate of a rope",
            "source": self.source,
            "ending": self.ending,
            "interrupted": int(self.interrupted),
            "messages": "\n".join(self._messages),
            "hyperflex": __version__,
        }
        content = NetCDF(variables, attributes)
        rescued(lambda path: write_netcdf(path, content), self.path)
