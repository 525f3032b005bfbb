"""Interfaces between control, planning and estimation: rope state, state source, motor."""

from dataclasses import dataclass
from typing import Protocol

from hyperflex.checks import Array
from hyperflex.motion import Motion


@dataclass(frozen=True, eq=False)
class RopeState:
    """Estimated state of the rope.

    Attributes
    ----------
    t : float
        Time of the state, s.
    q, qd : (n,) float64
        Absolute link angles, rad, and rates, rad/s.
    covariance : (2 n, 2 n) float64, or None
        Covariance of (q, qd), in rad and rad/s; None if unknown.
    """

    t: float
    q: Array
    qd: Array
    covariance: Array | None = None


class StateSource(Protocol):
    """Source of a rope's state while it moves: a simulation, or a camera with an estimator."""

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the state at a time, estimated from all observations until then.

        Parameters
        ----------
        t : float
            Time, s; not before that of the previous call.
        motion : Motion
            Motion of the arm since t = 0, including the planned future; it covers `t`.
        """


class Motor(Protocol):
    """Motor that turns an arm: a simulated servo, or a real one."""

    def set_motion(self, motion: Motion, at: float) -> bool:
        """Command a motion from a given time; return whether it was accepted: False if it came too late.

        Parameters
        ----------
        motion : Motion
            Arm angle over the time since the start of the cast, s; its values before `at` are ignored.
        at : float
            Time of the command, s; not before any time of an earlier command or reading.
        """

    def angle(self, t: float) -> float:
        """Return the encoder's angle at a time `t` (s, not before an earlier reading), rad."""
