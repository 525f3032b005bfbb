"""The test motion of a drive, streamed to it and recorded."""

import time
from collections.abc import Callable

import numpy as np

from hyperflex.errors import DriveError
from hyperflex.execution.stream import POLL, MotionStream
from hyperflex.hardware import Drive, DriveRecord, plan_test_motion
from hyperflex.interruption import interruptible, raise_if_cancelled
from hyperflex.motion import Motion

REST = 0.3  # s before and after the motion, in which the arm comes to rest


@interruptible()
def record_test_motion(
    connect: Callable[[], Drive],
    motion: Motion | None = None,
    *,
    stroke: float | None = None,
    clear_fault: bool = False,
) -> DriveRecord:
    """Make a test motion on a drive; its torque is on during the motion, and off after it.

    The motion waits when the computer is late. Replies that are lost are gaps of the record.

    Parameters
    ----------
    connect : callable
        Returns the drive, as :class:`MotionStream` takes it. Its `max_deviation` must leave room for a shaft that falls
        behind at its own limit of speed.
    motion : Motion, optional
        By default :func:`plan_test_motion` within the drive's limits, from where the arm is.
    stroke : float, optional
        Of that, rad.
    clear_fault : bool
        Clear a fault of the device at the start.

    Raises
    ------
    InvalidInput
        If the motion leaves the limits, before anything moves.
    DriveError
        As of :class:`MotionStream`.
    """
    drive = connect()
    with MotionStream(connect, waits=True, clear_fault=clear_fault) as stream:
        drive.check_turn(stream.state())
        chosen = motion or plan_test_motion(drive.limits, stream.state().angle, stroke=stroke)
        drive.check_motion(chosen)
        stream.enable()
        stream.start_clock(time.monotonic() + REST)
        stream.set_motion(chosen, 0.0)
        while stream.now < chosen.breaks[-1] + REST + stream.log().missed / stream.rate:
            raise_if_cancelled()
            stream.raise_if_ended()
            time.sleep(POLL)
        stream.off()
        log = stream.log()
    if stream.late:
        raise DriveError(
            "The test motion came too late to the drive's process. Try again, with less load on the machine."
        )
    sent, told = log.column("sent"), log.column("lost") == 0
    received = np.where(told, log.column("received"), sent)
    angle, torque = (np.where(told, log.column(name), np.nan) for name in ("angle", "torque"))
    goals = log.column("goal_angle"), log.column("goal_rate")
    return DriveRecord(sent - sent[0], received - sent[0], *goals, angle, torque)
