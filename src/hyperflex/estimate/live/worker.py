"""The process that estimates a rope's state from a camera, and what it shares with the one that asks for it."""

import math
import multiprocessing
import signal
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.estimate.changes import MISFIT, Change, ChangeTests
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.live.frames import Arrival, open_frames
from hyperflex.estimate.live.shared_array import SharedArray
from hyperflex.estimate.live.watch import LiveEstimate, Watch
from hyperflex.estimate.parameters import EstimatedParameter, ParameterStates
from hyperflex.estimate.tracker import RopeTracker
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, hold_arm
from hyperflex.vision import Camera, Frame, MarkerColour, MarkerDetector

READY = "ready"
TICK = 0.05  # s, longest time between two signs of life
MOST_PIECES = 512  # of a motion
MOST_CHANGES = 16  # that are remembered
_CHANGE_SIZE = 10
_DRIFT = 1e-4  # s per s, by which the clocks of camera and machine may drift apart
_PRACTICE = 3  # frames


@dataclass(frozen=True)
class TrackingTask:
    """What the process is to do.

    Attributes
    ----------
    source : int or str
        Camera, stream or file.
    rope, arc_lengths, camera, arm, parameters, tests
        As of :class:`RopeFilter`; an arm is at rest until :meth:`Process.set_motion`.
    colour : MarkerColour
    """

    source: int | str
    rope: Rope
    arc_lengths: Array
    camera: Camera
    colour: MarkerColour
    arm: Arm | None = None
    parameters: Sequence[EstimatedParameter] = field(default_factory=tuple)
    tests: ChangeTests | None = None

    @property
    def states(self) -> ParameterStates:
        """The parameters that are estimated, and those that are tested for changes."""
        tested = () if self.tests is None else self.tests.parameters_for(self.rope)
        return ParameterStates(self.parameters, self.rope, tested, self.arm is not None)

    @property
    def changing(self) -> tuple[str, ...]:
        """Names of what may be noticed to have changed."""
        return () if self.tests is None else (*self.tests.names_for(self.rope), MISFIT)

    @property
    def packet_size(self) -> int:
        """The most numbers that a :class:`Packet` has."""
        size = 2 * self.rope.n_links + len(self.states)
        return 11 + size * (1 + size) + MOST_CHANGES * _CHANGE_SIZE

    def tracker(self) -> RopeTracker:
        """Return what is to follow the rope."""
        estimator = RopeFilter(
            self.rope,
            self.arc_lengths,
            motion=None if self.arm is None else hold_arm(0.0),
            arm=self.arm,
            camera=self.camera,
            parameters=self.parameters,
            tests=self.tests,
        )
        return RopeTracker(estimator, MarkerDetector(self.colour))

    def rehearse(self) -> None:
        """Look at drawn frames of the hanging rope with another tracker, so that all kernels are there at the first."""
        import cv2

        tracker = self.tracker()
        radius = round(16.0 * (max(2.0, tracker.detector.radius) - 0.5))  # half a pixel more is drawn; in 16ths
        width, height = self.camera.image_size
        image = np.full((height, width, 3), 128, np.uint8)
        drop = self.arc_lengths[:, None] * self.rope.gravity / np.hypot(*self.rope.gravity)
        for place in np.round(16.0 * self.camera.project(drop + tracker.estimator.process.base(0.0)[0])).astype(int):
            cv2.circle(image, place.tolist(), radius, self.colour.bgr.tolist(), -1, cv2.LINE_AA, 4)
        for k in range(_PRACTICE):
            tracker.look(Frame(k / 30.0, image, k))


class Packet(NamedTuple):
    """What the process has found by now; times are this machine's monotonic clock, s.

    Attributes
    ----------
    written : float
        When it was written.
    t : float
        Of the last picture; an estimated delay lies between it and the instant of the state.
    seen_at : float
        When a marker was last seen.
    found : float
        1 if the rope has been found, else 0.
    frames : float
        Looked at until now.
    seen : float
        Markers seen in the last one.
    noise : (2,) float64
        Densities of the links' disturbances, as of :meth:`Process.noise`.
    x : (N,) float64
    rows : (r, N) float64
        Their squares are the covariance of x.
    changes : (c, 10) float64
        The last that were noticed, as of :func:`packed_change`.
    """

    written: float
    t: float
    seen_at: float
    found: float
    frames: float
    seen: float
    noise: Array
    x: Array
    rows: Array
    changes: Array

    def packed(self) -> Array:
        """Return it as plain numbers."""
        sizes = [self.x.size, len(self.rows), len(self.changes)]
        return np.concatenate([self[:6], self.noise, sizes, self.x, self.rows.ravel(), self.changes.ravel()])

    @classmethod
    def unpacked(cls, values: Array) -> "Packet":
        """Return what :meth:`packed` has made plain numbers."""
        size, count, changes = values[8:11].astype(int).tolist()
        x, rows, noticed = np.split(
            values[11 : 11 + size * (1 + count) + changes * _CHANGE_SIZE], [size, size * (1 + count)]
        )
        written, t, seen_at, found, frames, seen = values[:6].tolist()
        given = rows.reshape(count, size), noticed.reshape(changes, _CHANGE_SIZE)
        return cls(written, t, seen_at, found, frames, seen, values[6:8], x, *given)


def packed_change(change: Change, names: Sequence[str]) -> Array:
    """Return a change as plain numbers (10,), its name as its place among `names`; NaN is what it does not have."""
    place = math.nan if change.arc_length is None else change.arc_length
    impulse = (math.nan, math.nan) if change.impulse is None else change.impulse
    known = change.noticed, change.time, change.size, change.std, change.probability, change.log_false_alarm
    return np.array([names.index(change.name), *known, place, *impulse])


def unpacked_change(values: Array, names: Sequence[str], zero: float) -> Change:
    """Return the change, its times since `zero`, s."""
    noticed, time, size, std, probability, log_false_alarm, place, x, y = values[1:].tolist()
    return Change(
        names[int(values[0])],
        noticed - zero,
        time - zero,
        size,
        std,
        probability,
        log_false_alarm,
        None if math.isnan(place) else place,
        None if math.isnan(x) else (x, y),
    )


def packed_motion(motion: Motion, zero: float) -> Array:
    """Return a motion, and when its t = 0 is by the machine's clock, s, as plain numbers; refuses too many pieces."""
    if len(motion.coef) > MOST_PIECES:
        allowed = f"at most {MOST_PIECES} pieces"
        raise InvalidInput("the motion is too long to be handed over", got=len(motion.coef), allowed=allowed)
    return np.concatenate(
        [[zero, motion.loop, len(motion.coef)], motion.breaks, motion.switch.astype(float), motion.coef.ravel()]
    )


def unpacked_motion(values: Array) -> Motion:
    """Return the motion, by the machine's clock."""
    zero, loop, count = float(values[0]), int(values[1]), int(values[2])
    breaks, switch = values[3 : 4 + count], values[4 + count : 5 + 2 * count]
    coef = values[5 + 2 * count : 5 + 26 * count].reshape(count, 4, 6)
    return Motion(breaks + zero, coef, switch.astype(np.bool_), loop)


MOTION_SIZE = 5 + 26 * MOST_PIECES


class StampClock:
    """Puts frames on the machine's monotonic clock: by the least delay with which any has come.

    Notes
    -----
    A frame is never later on that clock than it arrived, and the one that came quickest not earlier. What all frames
    have in common is not seen: give it as the camera's ``delay``. A source that was opened again has begun its stamps
    anew: the least delay is found anew, too.
    """

    def __init__(self) -> None:
        self._offset, self._at, self._last = math.inf, 0.0, -math.inf
        self._opening = 0

    def __call__(self, arrival: Arrival) -> Frame:
        """Return the frame with its time by the machine's clock, s."""
        stamp = arrival.frame.time
        if arrival.opening != self._opening:
            self._offset, self._opening = math.inf, arrival.opening
        self._offset = min(self._offset + _DRIFT * (arrival.at - self._at), arrival.at - stamp)
        self._at = arrival.at
        self._last = max(stamp + self._offset, self._last + 1e-6)
        return Frame(self._last, arrival.frame.image, arrival.frame.index)


def work(task: TrackingTask, states: str, motions: str, said: Connection) -> None:
    """Estimate until the parent ends or asks for it; what goes wrong is said through the pipe, as text."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to deal with
    out, given = SharedArray(task.packet_size, states), SharedArray(MOTION_SIZE, motions)
    try:
        _follow(task, out, given, said)
    except HyperflexError as error:
        said.send_bytes(str(error).encode())
    finally:
        out.close()
        given.close()


def _follow(task: TrackingTask, out: SharedArray, given: SharedArray, said: Connection) -> None:
    from threadpoolctl import threadpool_limits

    tracker, parent, number = task.tracker(), multiprocessing.parent_process(), 0
    estimator = tracker.estimator
    task.rehearse()

    def take_motion() -> None:
        nonlocal number
        found = given.read()
        if task.arm is not None and found is not None and found[0] != number:
            number = found[0]
            estimator.process.set_motion(unpacked_motion(found[1]))

    with open_frames(task.source, paced=True) as frames, threadpool_limits(1):
        watch = Watch(frames, tracker, interval=TICK, retime=StampClock(), before=take_motion)
        said.send_bytes(READY.encode())
        count, names = 0, task.changing
        changes = deque[Array](maxlen=MOST_CHANGES)
        for estimate in watch:
            count += estimate.frame is not None
            if estimate.tracked is not None:
                changes.extend(packed_change(change, names) for change in estimate.tracked.changes)
            out.write(_packet(estimate, estimator, count, list(changes)).packed())
            if parent is None or not parent.is_alive():
                return
        said.send_bytes(f"no more frames come: {frames.ended}".encode())


def _packet(estimate: LiveEstimate, estimator: RopeFilter, frames: int, changes: list[Array]) -> Packet:
    found = estimate.found and estimator.t is not None
    t = estimator.t if found and estimator.t is not None else estimate.t
    return Packet(
        time.monotonic(),
        t,
        t - estimator.age if found else -math.inf,
        float(found),
        float(frames),
        float(estimate.seen),
        estimator.process_noise.value,
        estimator.x
        if found
        else np.concatenate([estimate.state.q, estimate.state.qd, np.zeros(len(estimator.parameters))]),
        estimator.factor if found else np.zeros((0, estimator.x.size)),
        np.reshape(changes, (-1, _CHANGE_SIZE)),
    )
