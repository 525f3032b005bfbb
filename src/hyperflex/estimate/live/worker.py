"""The process that estimates a rope's state from a camera, and what it shares with the one that asks for it."""

import math
import multiprocessing
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.estimate.filter import RopeFilter
from hyperflex.estimate.live.frames import Arrival, open_frames
from hyperflex.estimate.live.shared_array import SharedArray
from hyperflex.estimate.live.watch import LiveEstimate, Watch
from hyperflex.estimate.parameters import EstimatedParameter
from hyperflex.estimate.tracker import RopeTracker
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, hold_arm
from hyperflex.vision import Camera, Frame, MarkerColour, MarkerDetector

READY = "ready"
TICK = 0.05  # s, longest time between two signs of life
MOST_PIECES = 512  # of a motion
_DRIFT = 1e-4  # s per s, by which the clocks of camera and machine may drift apart
_PRACTICE = 3  # frames


@dataclass(frozen=True)
class TrackingTask:
    """What the process is to do.

    Attributes
    ----------
    source : int or str
        Camera, stream or file.
    rope, arc_lengths, camera, arm, parameters
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

    def tracker(self) -> RopeTracker:
        """Return what is to follow the rope."""
        estimator = RopeFilter(
            self.rope,
            self.arc_lengths,
            motion=None if self.arm is None else hold_arm(0.0),
            arm=self.arm,
            camera=self.camera,
            parameters=self.parameters,
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

    def packed(self) -> Array:
        """Return it as plain numbers."""
        return np.concatenate([self[:6], self.noise, [self.x.size, len(self.rows)], self.x, self.rows.ravel()])

    @classmethod
    def unpacked(cls, values: Array) -> "Packet":
        """Return what :meth:`packed` has made plain numbers."""
        size, count = int(values[8]), int(values[9])
        x, rows = values[10 : 10 + size], values[10 + size : 10 + size * (1 + count)]
        written, t, seen_at, found, frames, seen = values[:6].tolist()
        return cls(written, t, seen_at, found, frames, seen, values[6:8], x, rows.reshape(count, size))


def packet_size(n_links: int, parameters: int) -> int:
    """Return the most numbers that a :class:`Packet` has."""
    size = 2 * n_links + parameters
    return 10 + size * (1 + size)


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
    have in common is not seen: give it as the camera's ``delay``.
    """

    def __init__(self) -> None:
        self._offset, self._at, self._last = math.inf, 0.0, -math.inf

    def __call__(self, arrival: Arrival) -> Frame:
        """Return the frame with its time by the machine's clock, s."""
        stamp = arrival.frame.time
        self._offset = min(self._offset + _DRIFT * (arrival.at - self._at), arrival.at - stamp)
        self._at = arrival.at
        self._last = max(stamp + self._offset, self._last + 1e-6)
        return Frame(self._last, arrival.frame.image, arrival.frame.index)


def work(task: TrackingTask, states: str, motions: str, said: Connection) -> None:
    """Estimate until the parent ends or asks for it; what goes wrong is said through the pipe, as text."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to deal with
    size = packet_size(task.rope.n_links, len(task.parameters))
    out, given = SharedArray(size, states), SharedArray(MOTION_SIZE, motions)
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
        count = 0
        for estimate in watch:
            count += estimate.frame is not None
            out.write(_packet(estimate, estimator, count).packed())
            if parent is None or not parent.is_alive():
                return
        said.send_bytes(f"no more frames come: {frames.ended}".encode())


def _packet(estimate: LiveEstimate, estimator: RopeFilter, frames: int) -> Packet:
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
    )
