"""What is known of a rope at each frame that comes, and between frames that do not come."""

import math
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.estimate.live.frames import Arrival, FrameThread, JoinedStamps
from hyperflex.estimate.tracker import RopeTracker, TrackedFrame
from hyperflex.interfaces import RopeState
from hyperflex.vision import Frame

STALLED = 0.5  # s without a frame from which that is said
LONGEST = 2.0  # s, gap that the rope's equations bridge; beyond, its place is forgotten
MISSING = 1.75  # times the usual time between frames: from there one is missing
ANYHOW = math.pi / math.sqrt(3.0)  # rad, standard deviation of an angle of which nothing is known
_USUAL, _MEMORY = 30, 2.0  # frames, for the usual time between them; s, for the rate


@dataclass(frozen=True, eq=False)
class LiveEstimate:
    """What is known of the rope.

    Attributes
    ----------
    t : float
        Instant that it holds for, on the clock of the frames' time stamps, s.
    state : RopeState
        With its covariance. Where the rope has not been found: hanging, with one that says that it may be anywhere.
    found : bool
        Whether the rope has been found.
    tip : (2,) float64
        m.
    tip_std : float
        Standard deviation of the tip along the worse direction, m; inf where the rope has not been found.
    age : float
        Time since a marker was last seen, s; inf before the first.
    seen, markers : int
        Markers seen in this frame, of how many.
    latency : float
        From the frame's arrival to this estimate, s; NaN where no frame came.
    rate : float
        Frames a second lately.
    frame : Frame or None
        None: none came, and this is what the rope's equations say.
    tracked : TrackedFrame or None
        What was made of the frame; None where it could not be used.
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
    """Follows a rope in frames as they come; iterating gives a :class:`LiveEstimate` for each, and while none come.

    Parameters
    ----------
    frames : FrameThread
    tracker : RopeTracker
    interval : float
        Without a frame for that long, s, an estimate is handed out all the same.
    retime : callable, optional
        Of an :class:`Arrival`, to the frame with another time stamp; by default its own, joined to those before where
        the source was opened again.
    before : callable, optional
        Is called when a frame has come, before it is looked at.

    Notes
    -----
    Frames of another size than the camera's cannot be used: they are left out until the size is right again. Gaps of up
    to 2 s are bridged by the rope's equations; after longer ones, and where the source was opened again, it is looked
    for anew.
    """

    def __init__(
        self,
        frames: FrameThread,
        tracker: RopeTracker,
        *,
        interval: float = 0.1,
        retime: Callable[[Arrival], Frame] | None = None,
        before: Callable[[], None] = lambda: None,
    ) -> None:
        self.frames, self.tracker, self.interval = frames, tracker, interval
        self._retime, self._before = JoinedStamps() if retime is None else retime, before
        self._last: tuple[float, float] | None = None  # time stamp of the last frame, and when it came
        self._gaps, self._arrivals = deque[float](maxlen=_USUAL), deque[float]()
        self._seen_at = -math.inf
        self._opening = 0
        self._told = self._sized = False
        self._messages: list[str] = []

    def __iter__(self) -> Iterator[LiveEstimate]:
        while True:
            arrival = self.frames.take(self.interval)
            self._messages += self.frames.messages()
            if arrival is not None:
                yield self._look(arrival)
            elif self.frames.ended is not None:
                if self._messages:  # of the end itself: it goes with a last estimate
                    yield self._wait()
                return
            else:
                yield self._wait()

    def _look(self, arrival: Arrival) -> LiveEstimate:
        """Take a frame."""
        frame, estimator = self._retime(arrival), self.tracker.estimator
        self._note_gap(frame.time, arrival)
        self._before()
        tracked = None
        if self._fits(frame):
            try:
                tracked = self.tracker.look(frame)
            except (SimulationError, np.linalg.LinAlgError) as error:
                self._messages.append(f"the estimate was lost and begins anew: {error}")
                estimator.restart()
        t = frame.time - self.tracker.camera.delay + 0.5 * self.tracker.camera.readout
        if tracked is not None:
            self._messages += [str(change) for change in tracked.changes]
        if tracked is not None and tracked.state is not None:
            self._seen_at = max(self._seen_at, tracked.t - estimator.age)
        return self._estimate(t, frame, tracked, time.monotonic() - arrival.at)

    def _wait(self) -> LiveEstimate:
        """Say what the rope does while no frame comes."""
        if self._last is None:
            return self._estimate(0.0, None, None, math.nan)
        stamp, at = self._last
        since = time.monotonic() - at
        if since > STALLED and not self._told:
            self._messages.append(f"no frame for {since:.1f} s")
            self._told = True
        camera = self.tracker.camera
        return self._estimate(stamp + since - camera.delay + 0.5 * camera.readout, None, None, math.nan)

    def _estimate(self, t: float, frame: Frame | None, tracked: TrackedFrame | None, latency: float) -> LiveEstimate:
        state, found = self._state(t, tracked)
        place, wide = self.tracker.estimator.tip(state)
        messages, self._messages = tuple(self._messages), []
        return LiveEstimate(
            state.t,
            state,
            found,
            place,
            math.sqrt(float(np.linalg.eigvalsh(wide)[-1])) if found else math.inf,
            max(state.t - self._seen_at, 0.0),
            0 if tracked is None else int(tracked.seen.sum()),
            len(self.tracker.estimator.model.arc_lengths),
            latency,
            self._rate(),
            frame,
            tracked,
            messages,
        )

    def _state(self, t: float, tracked: TrackedFrame | None) -> tuple[RopeState, bool]:
        """Return the state at time t, s, and whether the rope has been found."""
        estimator = self.tracker.estimator
        if tracked is not None and tracked.state is not None:
            return tracked.state, True
        if estimator.t is not None and t - estimator.t <= LONGEST:
            try:
                return estimator.state_at(max(t, estimator.t)), True
            except SimulationError:
                estimator.restart()
        rope = estimator.process.rope
        n = rope.n_links
        wide = np.zeros((2 * n, 2 * n))
        wide[:n, :n] = ANYHOW**2
        wide[range(n, 2 * n), range(n, 2 * n)] = (2.0 * np.hypot(*rope.gravity) / rope.total_length) * ANYHOW**2
        return RopeState(t, np.full(n, rope.hanging_angle), np.zeros(n), wide), False

    def _note_gap(self, stamp: float, arrival: Arrival) -> None:
        """Take the times of a frame, and note what is missing before it."""
        if self._last is not None:
            gap, opened = stamp - self._last[0], arrival.opening != self._opening
            if opened or gap > LONGEST:
                why = "the source was opened again" if opened else f"a gap of {gap:.1f} s"
                self._messages.append(f"{why}: the rope is looked for anew")
                self.tracker.estimator.restart()
                self._gaps.clear()
            elif arrival.missed:
                self._messages.append(f"{arrival.missed} frames left out: they came while others were looked at")
            elif len(self._gaps) > 2 and gap > MISSING * statistics.median(self._gaps):
                count = round(gap / statistics.median(self._gaps)) - 1
                self._messages.append(f"{count} frames missing before {stamp:.3f} s")
            else:
                self._gaps.append(gap)
        if self._told:
            self._messages.append("frames come again")
            self._told = False
        self._last, self._opening = (stamp, arrival.at), arrival.opening
        self._arrivals.append(arrival.at)

    def _fits(self, frame: Frame) -> bool:
        """Whether a frame has the camera's size; says so where that changes."""
        size, expected = frame.image.shape[1::-1], tuple(self.tracker.camera.image_size)
        fits = size == expected
        if not fits and not self._sized:
            self._messages.append(
                f"frames of {size[0]}x{size[1]} px are left out: the camera's file is of {expected[0]}x{expected[1]} px"
            )
        if fits and self._sized:
            self._messages.append(f"frames have {size[0]}x{size[1]} px again")
        self._sized = not fits
        return fits

    def _rate(self) -> float:
        """Return how many frames a second came lately."""
        while self._arrivals and self._arrivals[-1] - self._arrivals[0] > _MEMORY:
            self._arrivals.popleft()
        span = self._arrivals[-1] - self._arrivals[0] if self._arrivals else 0.0
        return (len(self._arrivals) - 1) / span if span > 0.0 else 0.0
