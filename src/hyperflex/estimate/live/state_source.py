"""A rope's state from a camera for the closed loop: estimated in another process, predicted to now by the reader."""

import multiprocessing
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Self

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.errors import EstimatorLost, InvalidInput
from hyperflex.estimate.changes import Change, ChangeTests
from hyperflex.estimate.live.shared_array import SharedArray
from hyperflex.estimate.live.worker import (
    MOTION_SIZE,
    READY,
    Packet,
    TrackingTask,
    packed_motion,
    unpacked_change,
    work,
)
from hyperflex.estimate.parameters import EstimatedParameter
from hyperflex.estimate.process import Process
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion, hold_arm
from hyperflex.vision import Camera, MarkerColour

_POLL = 0.005  # s, between two looks while something is waited for


class CameraStateSource:
    """Tells a controller the state of a rope that a camera sees (a :class:`hyperflex.interfaces.StateSource`).

    The estimator runs in a process of its own. It writes what it knows into shared memory at every frame, and between
    frames that do not come; whoever asks reads the newest and predicts it to now by the rope's equations. Neither waits
    for the other. Use it as a context manager, in a program with ``if __name__ == "__main__":``, for the process begins
    as a new interpreter.

    Parameters
    ----------
    source : int or str
        The camera's number, a stream's address, or a video file, which is played at its own speed.
    rope : Rope
    arc_lengths : (K,) array_like
        How far along the rope each marker sits, m.
    camera : Camera
        With the swing plane. Its ``delay`` is what all frames are late by at least.
    colour : MarkerColour
    arm : Arm, optional
        On which the rope hangs; by default from a fixed point, whatever the motion says.
    parameters : sequence of EstimatedParameter
    tests : ChangeTests, optional
        What is tested for changes, for :attr:`changes`; by default nothing.
    longest : float
        A state is handed out for that long after a marker was last seen, s.
    stalled : float
        Without a sign of life from the process for that long, s, it counts as stalled.
    start_timeout : float
        How long the process may take to begin, s; where kernels are to be compiled, a minute or more.

    Notes
    -----
    t = 0 is when the block is entered, or when :meth:`start_clock` is called. The process ends with the block, and by
    itself where its parent has ended; the shared memory is removed with the block, or by Python's own resource tracker
    where the parent was killed. A process that has died or stalled is replaced by :meth:`restart`.
    """

    def __init__(
        self,
        source: int | str,
        rope: Rope,
        arc_lengths: npt.ArrayLike,
        *,
        camera: Camera,
        colour: MarkerColour,
        arm: Arm | None = None,
        parameters: Sequence[EstimatedParameter] = (),
        tests: ChangeTests | None = None,
        longest: float = 1.0,
        stalled: float = 1.0,
        start_timeout: float = 180.0,
    ) -> None:
        arcs = np.array(arc_lengths, float)
        self._task = TrackingTask(source, rope, arcs, camera, colour, arm, tuple(parameters), tests)
        self._task.tracker()  # refuses here what cannot be used
        self.longest = checks.number("longest", longest, sign="positive", unit="s")
        self.stalled = checks.number("stalled", stalled, sign="positive", unit="s")
        self.start_timeout = checks.number("start_timeout", start_timeout, sign="positive", unit="s")
        self._arm = arm
        self._model = Process(rope, self._task.states, None if arm is None else hold_arm(0.0), arm)
        self._motion: Motion | None = None
        self._zero = 0.0
        self._worker: multiprocessing.process.BaseProcess | None = None

    def __enter__(self) -> Self:
        self._states, self._motions = SharedArray(self._task.packet_size), SharedArray(MOTION_SIZE)
        try:
            self._start()
        except BaseException:
            self._close()
            raise
        self.start_clock()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def start_clock(self) -> None:
        """Make now t = 0."""
        self._zero = time.monotonic()
        self._motion = None

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
                frames = "no frame came" if packet is None else f"in {packet.frames:.0f} frames"
                raise EstimatorLost(
                    f"The rope was not found within {timeout:g} s ({frames}). "
                    "Check the markers' colour, their arc lengths and the camera."
                )
            time.sleep(_POLL)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the state at time t, s, with its covariance, from what has been seen until now.

        Parameters
        ----------
        t : float
            Since t = 0, s. A state newer than that is handed out as it is, with its own time.
        motion : Motion
            What the arm has done and will do; the process is told.

        Raises
        ------
        EstimatorLost
            If the process has ended or stalled, or no marker has been seen for `longest`.
        SimulationError
            If the rope's equations cannot be followed from the state to `t`.
        """
        moment = checks.number("t", t, unit="s")
        self._tell(motion)
        packet = self._newest()
        if packet is None or not packet.found:
            raise EstimatorLost("The rope is not found, or no longer. Call wait_until_found.")
        age = moment + self._zero - packet.seen_at
        if age > self.longest:
            raise EstimatorLost(
                f"No marker has been seen for {age:.2f} s (allowed: {self.longest:g} s). Check camera, light and view."
            )
        begin, n = packet.t - self._zero, self._task.rope.n_links
        until = moment + self._model.parameters.value("delay", packet.x[2 * n :])
        return self._model.state_at(packet.x, packet.rows, begin, max(until, begin), packet.noise)

    @property
    def changes(self) -> tuple[Change, ...]:
        """The last 16 changes that `tests` have noticed, the newest last; their times are since t = 0."""
        packet = self._newest()
        noticed = () if packet is None else packet.changes
        return tuple(unpacked_change(each, self._task.changing, self._zero) for each in noticed)

    @property
    def values(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation of each parameter that is estimated, or has been noticed to have changed."""
        packet = self._newest()
        return {} if packet is None or not packet.found else self._model.parameters.estimates(packet.x, packet.rows)

    def restart(self) -> None:
        """End the process, if it still runs, and begin another; the shared memory and t = 0 stay.

        Raises
        ------
        EstimatorLost
            If that one does not begin.
        """
        self._end()
        self._states.clear()
        self._start()
        if self._motion is not None:
            self._motions.write(packed_motion(self._motion, self._zero))

    @property
    def pid(self) -> int | None:
        """Number of the process; None where there is none."""
        return None if self._worker is None else self._worker.pid

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._heard, said = context.Pipe(duplex=False)
        self._said = ""
        arguments = (self._task, self._states.name, self._motions.name, said)
        self._worker = context.Process(target=work, args=arguments, name="rope estimator", daemon=True)
        self._worker.start()
        said.close()
        if not self._heard.poll(self.start_timeout):
            self._end()
            raise EstimatorLost(
                f"The estimator did not begin within {self.start_timeout:g} s. Allow more start_timeout."
            )
        words = self._words()
        if words != READY:
            self._end()
            raise EstimatorLost(f"The estimator did not begin: {words or 'its process ended'}")

    def _words(self) -> str:
        """Return what the process has said last; nothing where it ended without a word."""
        words = ""
        try:
            while self._heard.poll():
                words = self._heard.recv_bytes(4096).decode("utf-8", "replace")
        except (EOFError, OSError):
            pass
        return words

    def _newest(self) -> Packet | None:
        """Return the newest packet, None before the first; refuses one of a process that has ended or stalled."""
        worker = self._worker
        if worker is None:
            raise InvalidInput("the state source is closed", fix="Use it within its with block")
        found = self._states.read()
        packet = None if found is None else Packet.unpacked(found[1])
        alive = worker.is_alive()
        self._said = self._words() or self._said
        if self._said or not alive:
            code = worker.exitcode
            how = f"its process ended by signal {-code}" if code and code < 0 else f"its process ended with code {code}"
            raise EstimatorLost(f"The estimator has ended: {(self._said or how).rstrip('.')}. Call restart().")
        quiet = 0.0 if packet is None else time.monotonic() - packet.written
        if quiet > self.stalled:
            raise EstimatorLost(
                f"The estimator's process has given no sign of life for {quiet:.2f} s (allowed: {self.stalled:g} s). "
                "Call restart()."
            )
        return packet

    def _tell(self, motion: Motion) -> None:
        """Hand the motion over, where it has changed."""
        if self._arm is None or motion is self._motion or motion == self._motion:
            return
        self._motions.write(packed_motion(motion, self._zero))
        self._model.set_motion(motion)
        self._motion = motion

    def _end(self) -> None:
        """End the process and wait for it, so that nothing of it is left."""
        worker, self._worker = self._worker, None
        if worker is None:
            return
        worker.terminate()
        worker.join(1.0)
        if worker.is_alive():
            worker.kill()
            worker.join()
        worker.close()
        self._heard.close()

    def _close(self) -> None:
        self._end()
        self._states.close()
        self._motions.close()
