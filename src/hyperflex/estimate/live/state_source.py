"""A rope's state from a camera for the closed loop: estimated in another process, predicted to now by the reader."""

import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import NamedTuple, Self

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.child import Child
from hyperflex.errors import EstimatorLost, HyperflexError
from hyperflex.estimate.changes import Change, ChangeTests
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.live.frames import Arrival, Source, open_frames
from hyperflex.estimate.live.watch import Watch
from hyperflex.estimate.measurements import (
    CurveMeasurement,
    MarkedCurveMeasurement,
    MarkerMeasurement,
    marked_arc_lengths,
)
from hyperflex.estimate.parameters import EstimatedParameter
from hyperflex.estimate.tracker import RopeTracker, TrackedFrame
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, hold_arm
from hyperflex.vision import Camera, Frame, Image, MarkerColour, MarkerDetector, RopeLook

TICK = 0.05  # s, longest time between two packets: the parent sees that the process runs
MOST_CHANGES = 16  # that a packet carries
_CLOCK_DRIFT = 1e-4  # s per s, by which the clocks of camera and machine may drift apart
_PRACTICE = 3  # frames after which all kernels have been called


@dataclass(frozen=True)
class TrackingTask:
    """What is tracked, and how.

    Attributes
    ----------
    rope, arc_lengths, camera, arm, parameters, tests
        As of :class:`RopeFilter`; an arm is at rest until :meth:`Process.set_motion`.
    colours : sequence of MarkerColour
        Of the markers: mostly one.
    look : RopeLook, optional
        Of a rope that is measured between its markers, too. Without `colours` it has none, and `arc_lengths` are those
        of :func:`curve_arc_lengths`.
    waits : bool
        Whether the rope is looked for only from the arm's first motion on: before, its place is not known.
    """

    rope: Rope
    arc_lengths: Array
    camera: Camera
    colours: Sequence[MarkerColour]
    arm: Arm | None = None
    parameters: Sequence[EstimatedParameter] = ()
    tests: ChangeTests | None = None
    look: RopeLook | None = None
    waits: bool = False

    def tracker(self) -> RopeTracker:
        """Return a new tracker of the rope."""
        arcs, marked = self.arc_lengths, np.zeros(0, bool)
        if self.look is not None and self.colours:
            arcs, marked = marked_arc_lengths(self.rope, arcs)
        estimator = RopeFilter(
            self.rope,
            arcs,
            motion=None if self.arm is None else hold_arm(0.0),
            arm=self.arm,
            camera=self.camera,
            parameters=self.parameters,
            tests=self.tests,
        )
        detectors = map(MarkerDetector, self.colours)
        if self.look is None:
            return RopeTracker(estimator, MarkerMeasurement(*detectors))
        if marked.size:
            return RopeTracker(estimator, MarkedCurveMeasurement(self.look, marked, *detectors))
        return RopeTracker(estimator, CurveMeasurement(self.look))

    def rehearse(self) -> None:
        """Track drawn frames of the hanging rope, so that the first real frame compiles nothing."""
        import cv2

        tracker = self.tracker()
        width, height = self.camera.image_size
        image = np.full((height, width, 3), 128, np.uint8)
        drop = np.asarray(self.arc_lengths)[:, None] * self.rope.gravity / self.rope.g
        places = np.pad(drop, ((1, 0), (0, 0))) + tracker.estimator.process.base(0.0)[0]
        pixels = np.round(16.0 * self.camera.project(places)).astype(int)  # 1/16 px
        if self.look is not None:
            image[:] = 128 + np.where(self.look.levels < 128.0, 64, -64)
            thick = max(1, round(self.look.width))
            cv2.polylines(image, [pixels.astype(np.int32)], False, self.look.levels.tolist(), thick, cv2.LINE_AA, 4)
        if self.colours:
            radius = round(16.0 * (max(2.0, tracker.measurement.radius) - 0.5))  # OpenCV adds half a pixel
            for place in pixels[1:]:
                cv2.circle(image, place.tolist(), radius, self.colours[0].bgr.tolist(), -1, cv2.LINE_AA, 4)
        for k in range(_PRACTICE):
            tracker.look(Frame(k / 30.0, image, k))


class Packet(NamedTuple):
    """What the process knows; times are this machine's monotonic clock, s.

    Attributes
    ----------
    written : float
        When it was written.
    t : float
        Time of the last picture; the state is older by an estimated delay.
    seen_at : float
        When a marker was last seen.
    found : bool
        Whether the rope has been found.
    frames : int
        Frames processed so far.
    noise : (2,) float64
        Densities of the links' disturbances, as of :meth:`Process.noise`.
    x, rows : (N,), (r, N) float64
        State, and rows whose squares are its covariance.
    changes : tuple of Change
        The last that were noticed.
    motions : int
        Motions received so far.
    spots : (M, 2) float64
        Places in the swing plane of all that looks like a marker in the last picture, m.
    """

    written: float
    t: float
    seen_at: float
    found: bool
    frames: int
    noise: Array
    x: Array
    rows: Array
    changes: tuple[Change, ...]
    motions: int
    spots: Array


class StampClock:
    """Puts frames on the machine's monotonic clock, by the least delay of any frame.

    Notes
    -----
    A frame is never later on that clock than it arrived, and the quickest one not earlier. A delay that all frames have
    in common cannot be seen: it is the camera's ``delay``. The time stamps of a source that was opened again start
    anew, and so does the least delay.
    """

    def __init__(self) -> None:
        self._offset, self._at, self._last = math.inf, 0.0, -math.inf
        self._opening = 0

    def __call__(self, arrival: Arrival) -> Frame:
        """Return the frame with its time by the machine's clock, s."""
        stamp = arrival.frame.time
        if arrival.opening != self._opening:
            self._offset, self._opening = math.inf, arrival.opening
        self._offset = min(self._offset + _CLOCK_DRIFT * (arrival.at - self._at), arrival.at - stamp)
        self._at = arrival.at
        self._last = max(stamp + self._offset, self._last + 1e-6)
        return Frame(self._last, arrival.frame.image, arrival.frame.index)


def work(link: Connection, source: int | str | Source, task: TrackingTask) -> None:
    """Send a :class:`Packet` for each frame, and while none comes, until the parent ends.

    Parameters
    ----------
    link : Connection
        Receives motions, each with the time of its t = 0, s, and whether the rope is to be searched anew.
    source : int, str or Source
        Camera, stream or file.
    task : TrackingTask
    """
    from threadpoolctl import threadpool_limits

    tracker, motions = task.tracker(), 0
    estimator = tracker.estimator
    task.rehearse()

    def take_motion() -> bool:
        nonlocal motions
        while link.poll():
            motion, zero, anew = link.recv()
            estimator.process.set_motion(motion.shifted(zero))
            if anew:
                estimator.restart()
            motions += 1
        return motions > 0 or not task.waits

    with open_frames(source, paced=True) as frames, threadpool_limits(1):
        task.camera.check_size(frames.image_size)
        link.send((0, None))
        count, changes, spots = 0, deque[Change](maxlen=MOST_CHANGES), np.zeros((0, 2))
        for estimate in Watch(frames, tracker, interval=TICK, retime=StampClock(), before=take_motion):
            count += estimate.frame is not None
            if estimate.frame is not None:
                spots = np.zeros((0, 2))
                if estimate.tracked is not None:
                    changes.extend(estimate.tracked.changes)
                    spots = _spots(tracker, estimate.frame.image, estimate.tracked)
            t, seen_at, found = estimate.t, -math.inf, estimate.found and estimator.t is not None
            if found and estimator.t is not None:
                t, seen_at = estimator.t, estimator.t - estimator.age
            state = estimator.process_noise.value, estimator.x, estimator.factor
            packet = Packet(time.monotonic(), t, seen_at, found, count, *state, tuple(changes), motions, spots)
            link.send((0, packet))
        raise EstimatorLost(f"No more frames come: {frames.ended}.")


def _spots(tracker: RopeTracker, image: Image, tracked: TrackedFrame) -> Array:
    """Return places (M, 2), m, of all that looks like a marker: the rope's, or if some are missing, of a search."""
    if tracked.seen.all() or not isinstance(tracker.measurement, MarkerMeasurement):
        return tracked.places[tracked.seen]
    places = tracker.adjusted_camera.locate(tracker.measurement.spots(image))
    return places[np.isfinite(places).all(axis=1)]


class CameraStateSource:
    """The state of a rope that a camera sees, for a controller (a :class:`hyperflex.interfaces.StateSource`).

    The estimator runs in a separate process. It sends its estimate at every frame, and while no frame comes; a thread
    keeps the newest, which is predicted to now by the rope's equations. Neither waits for the other. Use it as a
    context manager, in a program with ``if __name__ == "__main__":``, for the process starts as a
    new interpreter.

    Parameters
    ----------
    source : int, str or Source
        The camera's number, a stream's address, a video file, which is played at its own speed, or frames that another
        process shares.
    task : TrackingTask
        Rope, markers and camera. The camera's ``delay`` is the delay that all frames have.
    longest : float
        How long after a marker was last seen a state is returned, s.
    stalled : float
        Time without a packet after which the process counts as stalled, s. Until the rope is found that may be longer,
        for a search of the whole picture takes seconds.

    Attributes
    ----------
    spots : list of (float, (M, 2) float64)
        For each picture since the clock's start: its time, s, and the places of all that looks like a marker, m.

    Notes
    -----
    t = 0 is when the block is entered, or when :meth:`start_clock` is called. The process ends with the block, or when
    its parent has ended. :meth:`restart` replaces a process that has died or stalled.
    """

    def __init__(
        self,
        source: int | str | Source,
        task: TrackingTask,
        *,
        longest: float = 1.0,
        stalled: float = 1.0,
    ) -> None:
        estimator = task.tracker().estimator
        self.source, self.task, self._model, self._parameters = source, task, estimator.process, estimator.parameters
        self.longest = checks.number("longest", longest, sign="positive", unit="s")
        self.stalled = checks.number("stalled", stalled, sign="positive", unit="s")
        self._motion: Motion | None = None
        self._pending, self._sent, self._zero = False, 0, 0.0
        self._anew, self._since = False, 0  # whether the rope is to be searched anew, and since which motion it is
        self._packet: Packet | None = None
        self.spots: list[tuple[float, Array]] = []
        self._ended: HyperflexError | None = None
        self._receiver = threading.Thread()
        self._child = Child("The estimator", EstimatorLost, work, source, task)

    def __enter__(self) -> Self:
        self._start()
        self.start_clock()
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def start_clock(self, at: float | None = None) -> None:
        """Make a moment of the monotonic clock, s, or now, t = 0."""
        self._zero = time.monotonic() if at is None else checks.number("at", at, unit="s")
        self._motion, self.spots = None, []

    @property
    def now(self) -> float:
        """Time since t = 0, s."""
        return time.monotonic() - self._zero

    def wait_until_found(self, timeout: float) -> None:
        """Wait until the rope has been found.

        Raises
        ------
        EstimatorLost
            If that takes longer than `timeout`, s, or the process ends.
        """
        until = time.monotonic() + checks.number("timeout", timeout, sign="positive", unit="s")
        while True:
            packet = self._newest()
            if packet is not None and packet.found:
                return
            if time.monotonic() > until:
                frames = "no frame came" if packet is None else f"in {packet.frames} frames"
                raise EstimatorLost(
                    f"The rope was not found within {timeout:g} s ({frames}). "
                    "Check the camera, and colour and arc lengths of markers."
                )
            time.sleep(0.005)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the state at time t, s, with its covariance, from the frames until now.

        Parameters
        ----------
        t : float
            Since t = 0, s. If the newest state is later, it is returned with its own time.
        motion : Motion
            The arm's motion, past and planned; it is passed to the process.

        Raises
        ------
        EstimatorLost
            If the process has ended or stalled, or no marker has been seen for `longest`.
        SimulationError
            If the rope's equations cannot be integrated from the state to `t`.
        """
        moment = checks.number("t", t, unit="s")
        packet = self._newest()
        self._pass_on(motion, packet)
        if packet is None or not packet.found or packet.motions < self._since:
            raise EstimatorLost("The rope is not found, or no longer. Call wait_until_found.")
        age = moment + self._zero - packet.seen_at
        if age > self.longest:
            raise EstimatorLost(
                f"No marker has been seen for {age:.2f} s (allowed: {self.longest:g} s). Check camera, light and view."
            )
        begin, n = packet.t - self._zero, self.task.rope.n_links
        until = moment + self._parameters.value("delay", packet.x[2 * n :])
        return self._model.state_at(packet.x, packet.rows, begin, max(until, begin), packet.noise)

    def search(self) -> None:
        """Let the rope be searched anew, with the motion that is given next: it may be anywhere."""
        self._anew, self._motion, self._since = True, None, self._sent + 1

    @property
    def changes(self) -> tuple[Change, ...]:
        """The last 16 changes that the task's `tests` have noticed, the newest last; their times are since t = 0."""
        packet, zero = self._newest(), self._zero
        noticed = () if packet is None else packet.changes
        return tuple(replace(each, noticed=each.noticed - zero, time=each.time - zero) for each in noticed)

    @property
    def values(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of each parameter that is estimated, or has been noticed to have changed."""
        packet = self._newest()
        return {} if packet is None or not packet.found else self._parameters.estimates(packet.x, packet.rows)

    @property
    def rope(self) -> Rope:
        """The rope with those of its values that are estimated; the task's as long as it has not been found."""
        packet, n = self._newest(), self.task.rope.n_links
        return self.task.rope if packet is None or not packet.found else self._parameters.rope_at(packet.x[2 * n :])

    def restart(self) -> None:
        """End the process, if it still runs, and start another one; t = 0 stays.

        Raises
        ------
        EstimatorLost
            If the new process does not start.
        """
        self._end()
        self._start()
        if self._motion is not None:
            self._send()

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._child.pid

    def _start(self) -> None:
        self._packet, self._ended, self._sent, self._since = None, None, 0, 0
        try:
            self._child.start()
        except HyperflexError as error:
            raise EstimatorLost(f"The estimator did not start: {error}") from error
        self._receiver = threading.Thread(target=self._receive, daemon=True)
        self._receiver.start()

    def _receive(self) -> None:
        """Keep what the process sends until it ends."""
        try:
            while True:
                packet = self._child.receive(None)
                if self._packet is not None and packet.frames > self._packet.frames:
                    self.spots.append((packet.t - self._zero, packet.spots))
                self._packet = packet
        except HyperflexError as error:
            self._ended = error

    def _newest(self) -> Packet | None:
        """Return the newest packet, None before the first; raise if the process has ended or stalled."""
        self._child.pid  # noqa: B018 raises if it does not run
        if self._ended is not None:
            raise EstimatorLost(f"{self._ended} Call restart().")
        quiet = 0.0 if self._packet is None else time.monotonic() - self._packet.written
        if quiet > self.stalled and self._packet is not None and self._packet.found:
            raise EstimatorLost(
                f"The estimator's process has given no sign of life for {quiet:.2f} s (allowed: {self.stalled:g} s). "
                "Call restart()."
            )
        return self._packet

    def _pass_on(self, motion: Motion, packet: Packet | None) -> None:
        """Pass a new motion to the process, once it has received the one before: sending never waits."""
        if self.task.arm is None:
            return
        if motion is not self._motion and motion != self._motion:
            self._model.set_motion(motion)
            self._motion, self._pending = motion, True
        if self._pending and packet is not None and packet.motions == self._sent:
            self._send()

    def _send(self) -> None:
        with suppress(OSError):  # the process has ended: the next call reports it
            self._child.link.send((self._motion, self._zero, self._anew))
        self._pending, self._anew, self._sent = False, False, self._sent + 1

    def _end(self) -> None:
        """End the process and wait for it."""
        self._child.end()
        if self._receiver.is_alive():
            self._receiver.join()
