"""The process that estimates a rope's state from a camera, and what it shares with its parent."""

import math
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import HyperflexError
from hyperflex.estimate.changes import Change, ChangeTests
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.live.frames import Arrival, open_frames
from hyperflex.estimate.live.shared_value import SharedValue
from hyperflex.estimate.live.watch import LiveEstimate, Watch
from hyperflex.estimate.markers import MarkerMeasurement
from hyperflex.estimate.parameters import EstimatedParameter, ParameterStates
from hyperflex.estimate.tracker import RopeTracker
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, hold_arm
from hyperflex.vision import Camera, Frame, MarkerColour, MarkerDetector

READY = "ready"
TICK = 0.05  # s, longest time between two packets: the parent sees that the process runs
MOST_CHANGES = 16  # that a packet carries
MOTION_BYTES = 131072  # of a pickled motion: some 600 pieces
_CLOCK_DRIFT = 1e-4  # s per s, by which the clocks of camera and machine may drift apart
_PRACTICE = 3  # frames after which all kernels have been called


@dataclass(frozen=True)
class TrackingTask:
    """What is tracked, and how.

    Attributes
    ----------
    rope, arc_lengths, camera, arm, parameters, tests
        As of :class:`RopeFilter`; an arm is at rest until :meth:`Process.set_motion`.
    colour : MarkerColour
    """

    rope: Rope
    arc_lengths: Array
    camera: Camera
    colour: MarkerColour
    arm: Arm | None = None
    parameters: Sequence[EstimatedParameter] = ()
    tests: ChangeTests | None = None

    @property
    def motion(self) -> Motion | None:
        """The arm's motion until another one is set."""
        return None if self.arm is None else hold_arm(0.0)

    @property
    def states(self) -> ParameterStates:
        """The parameters that are estimated, and those that are tested for changes."""
        tested = () if self.tests is None else self.tests.parameters_for(self.rope)
        return ParameterStates(self.parameters, self.rope, tested, self.arm is not None)

    @property
    def packet_bytes(self) -> int:
        """Largest size of a pickled :class:`Packet`."""
        size = 2 * self.rope.n_links + len(self.states)
        return 8 * size * (size + 1) + 16384  # state and covariance; 16 changes and all else take some kilobytes

    def tracker(self) -> RopeTracker:
        """Return a new tracker of the rope."""
        estimator = RopeFilter(
            self.rope,
            self.arc_lengths,
            motion=self.motion,
            arm=self.arm,
            camera=self.camera,
            parameters=self.parameters,
            tests=self.tests,
        )
        return RopeTracker(estimator, MarkerMeasurement(MarkerDetector(self.colour)))

    def rehearse(self) -> None:
        """Track drawn frames of the hanging rope, so that the first real frame compiles nothing."""
        import cv2

        tracker = self.tracker()
        radius = round(16.0 * (max(2.0, MarkerDetector(self.colour).radius) - 0.5))  # OpenCV adds half a pixel; 1/16 px
        width, height = self.camera.image_size
        image = np.full((height, width, 3), 128, np.uint8)
        drop = np.asarray(self.arc_lengths)[:, None] * self.rope.gravity / np.hypot(*self.rope.gravity)
        for place in np.round(16.0 * self.camera.project(drop + tracker.estimator.process.base(0.0)[0])).astype(int):
            cv2.circle(image, place.tolist(), radius, self.colour.bgr.tolist(), -1, cv2.LINE_AA, 4)
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


def work(source: int | str, task: TrackingTask, packets: str, motions: str, messages: Connection) -> None:
    """Estimate until the parent ends; errors are sent as text.

    Parameters
    ----------
    source : int or str
        Camera, stream or file.
    task : TrackingTask
    packets, motions : str
        Names of the shared values: of a Packet, and of a motion with the time of its t = 0, s.
    messages : Connection
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent
    out, given = SharedValue(task.packet_bytes, packets), SharedValue(MOTION_BYTES, motions)
    try:
        _follow(source, task, out, given, messages)
    except HyperflexError as error:
        messages.send_bytes(str(error).encode())
    finally:
        out.close()
        given.close()


def _follow(source: int | str, task: TrackingTask, out: SharedValue, given: SharedValue, messages: Connection) -> None:
    from threadpoolctl import threadpool_limits

    tracker, parent, number = task.tracker(), multiprocessing.parent_process(), 0
    estimator = tracker.estimator
    task.rehearse()

    def take_motion() -> None:
        nonlocal number
        newest = given.read()
        if newest is not None and newest[0] != number:
            number, (motion, zero) = newest
            estimator.process.set_motion(motion.shifted(zero))

    with open_frames(source, paced=True) as frames, threadpool_limits(1):
        watch = Watch(frames, tracker, interval=TICK, retime=StampClock(), before=take_motion)
        messages.send_bytes(READY.encode())
        count, changes = 0, deque[Change](maxlen=MOST_CHANGES)
        for estimate in watch:
            count += estimate.frame is not None
            changes.extend(() if estimate.tracked is None else estimate.tracked.changes)
            out.write(_packet(estimate, estimator, count, tuple(changes)))
            if parent is None or not parent.is_alive():
                return
        messages.send_bytes(f"no more frames come: {frames.ended}".encode())


def _packet(estimate: LiveEstimate, estimator: RopeFilter, frames: int, changes: tuple[Change, ...]) -> Packet:
    t, x, rows, seen_at = estimate.t, estimator.x, estimator.factor, -math.inf
    found = estimate.found and estimator.t is not None
    if found and estimator.t is not None:
        t, seen_at = estimator.t, estimator.t - estimator.age
    return Packet(time.monotonic(), t, seen_at, found, frames, estimator.process_noise.value, x, rows, changes)
