"""A rope's state from a camera for the closed loop: estimated in another process, predicted to now by the reader."""

import multiprocessing
import time
from dataclasses import replace
from typing import Self

from hyperflex import checks
from hyperflex.errors import EstimatorLost, InvalidInput
from hyperflex.estimate.changes import Change
from hyperflex.estimate.live.shared_value import SharedValue
from hyperflex.estimate.live.worker import MOTION_BYTES, READY, Packet, TrackingTask, work
from hyperflex.estimate.process import Process
from hyperflex.interfaces import RopeState
from hyperflex.motion import Motion

_POLL = 0.005  # s between two checks while waiting


class CameraStateSource:
    """The state of a rope that a camera sees, for a controller (a :class:`hyperflex.interfaces.StateSource`).

    The estimator runs in a separate process. It writes its estimate into shared memory at every frame, and while no
    frame comes; the reader takes the newest and predicts it to now by the rope's equations. Neither waits for the
    other. Use it as a context manager, in a program with ``if __name__ == "__main__":``, for the process starts as a
    new interpreter.

    Parameters
    ----------
    source : int or str
        The camera's number, a stream's address, or a video file, which is played at its own speed.
    task : TrackingTask
        Rope, markers and camera. The camera's ``delay`` is the delay that all frames have.
    longest : float
        How long after a marker was last seen a state is returned, s.
    stalled : float
        Time without a packet after which the process counts as stalled, s.
    start_timeout : float
        How long the process may take to start, s; compiling kernels takes a minute or more.

    Notes
    -----
    t = 0 is when the block is entered, or when :meth:`start_clock` is called. The process ends with the block, or when
    its parent has ended; the shared memory is removed with the block, or by Python's resource tracker if the parent was
    killed. :meth:`restart` replaces a process that has died or stalled.
    """

    def __init__(
        self,
        source: int | str,
        task: TrackingTask,
        *,
        longest: float = 1.0,
        stalled: float = 1.0,
        start_timeout: float = 180.0,
    ) -> None:
        task.tracker()  # validates the task
        self.source, self.task = source, task
        self.longest = checks.number("longest", longest, sign="positive", unit="s")
        self.stalled = checks.number("stalled", stalled, sign="positive", unit="s")
        self.start_timeout = checks.number("start_timeout", start_timeout, sign="positive", unit="s")
        self._model = Process(task.rope, task.states, task.motion, task.arm)
        self._motion: Motion | None = None
        self._zero = 0.0
        self._worker: multiprocessing.process.BaseProcess | None = None

    def __enter__(self) -> Self:
        self._packets, self._motions = SharedValue(self.task.packet_bytes), SharedValue(MOTION_BYTES)
        try:
            self._start()
        except BaseException:
            self._close()
            raise
        self.start_clock()
        return self

    def __exit__(self, *_: object) -> None:
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
                frames = "no frame came" if packet is None else f"in {packet.frames} frames"
                raise EstimatorLost(
                    f"The rope was not found within {timeout:g} s ({frames}). "
                    "Check the markers' colour, their arc lengths and the camera."
                )
            time.sleep(_POLL)

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
        self._pass_on(motion)
        packet = self._newest()
        if packet is None or not packet.found:
            raise EstimatorLost("The rope is not found, or no longer. Call wait_until_found.")
        age = moment + self._zero - packet.seen_at
        if age > self.longest:
            raise EstimatorLost(
                f"No marker has been seen for {age:.2f} s (allowed: {self.longest:g} s). Check camera, light and view."
            )
        begin, n = packet.t - self._zero, self.task.rope.n_links
        until = moment + self._model.parameters.value("delay", packet.x[2 * n :])
        return self._model.state_at(packet.x, packet.rows, begin, max(until, begin), packet.noise)

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
        return {} if packet is None or not packet.found else self._model.parameters.estimates(packet.x, packet.rows)

    def restart(self) -> None:
        """End the process, if it still runs, and start another one; the shared memory and t = 0 stay.

        Raises
        ------
        EstimatorLost
            If the new process does not start.
        """
        self._end()
        self._packets.clear()
        self._start()
        if self._motion is not None:
            self._motions.write((self._motion, self._zero))

    @property
    def pid(self) -> int | None:
        """Identifier of the process; None if there is none."""
        return None if self._worker is None else self._worker.pid

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._messages, sender = context.Pipe(duplex=False)
        self._message = ""
        arguments = (self.source, self.task, self._packets.name, self._motions.name, sender)
        self._worker = context.Process(target=work, args=arguments, name="rope estimator", daemon=True)
        self._worker.start()
        sender.close()
        if not self._messages.poll(self.start_timeout):
            self._end()
            raise EstimatorLost(
                f"The estimator did not start within {self.start_timeout:g} s. Allow more start_timeout."
            )
        message = self._last_message()
        if message != READY:
            self._end()
            raise EstimatorLost(f"The estimator did not start: {message or 'its process ended'}")

    def _last_message(self) -> str:
        """Return the last new message of the process; empty if there is none."""
        message = ""
        try:
            while self._messages.poll():
                message = self._messages.recv_bytes(4096).decode("utf-8", "replace")
        except (EOFError, OSError):
            pass
        return message

    def _newest(self) -> Packet | None:
        """Return the newest packet, None before the first; raise if the process has ended or stalled."""
        worker = self._worker
        if worker is None:
            raise InvalidInput("the state source is closed", fix="Use it within its with block")
        found = self._packets.read()
        packet: Packet | None = None if found is None else found[1]
        alive = worker.is_alive()
        self._message = self._last_message() or self._message
        if self._message or not alive:
            code = worker.exitcode
            how = f"its process ended by signal {-code}" if code and code < 0 else f"its process ended with code {code}"
            raise EstimatorLost(f"The estimator has ended: {(self._message or how).rstrip('.')}. Call restart().")
        quiet = 0.0 if packet is None else time.monotonic() - packet.written
        if quiet > self.stalled:
            raise EstimatorLost(
                f"The estimator's process has given no sign of life for {quiet:.2f} s (allowed: {self.stalled:g} s). "
                "Call restart()."
            )
        return packet

    def _pass_on(self, motion: Motion) -> None:
        """Pass the motion to the process, if it has changed."""
        if self.task.arm is None or motion is self._motion or motion == self._motion:
            return
        self._motions.write((motion, self._zero))
        self._model.set_motion(motion)
        self._motion = motion

    def _end(self) -> None:
        """End the process and wait for it."""
        worker, self._worker = self._worker, None
        if worker is None:
            return
        worker.terminate()
        worker.join(1.0)
        if worker.is_alive():
            worker.kill()
            worker.join()
        worker.close()
        self._messages.close()

    def _close(self) -> None:
        self._end()
        self._packets.close()
        self._motions.close()
