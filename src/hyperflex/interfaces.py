"""Interfaces between control, planning and estimation: rope state, state source, motor."""

from dataclasses import dataclass
from typing import Protocol

from hyperflex.checks import Array
from hyperflex.motion import Motion


@dataclass(frozen=True, eq=False)
class RopeState:
    """State of the rope as a controller knows it.

    Attributes
    ----------
    t : float
        Instant that it holds for, s.
    q, qd : (n,) float64
        Absolute link angles, rad, and rates, rad/s.
    covariance : (2 n, 2 n) float64, or None
        Of (q, qd), as far as it is known, in rad and rad/s.
    """

    t: float
    q: Array
    qd: Array
    covariance: Array | None = None


class StateSource(Protocol):
    """Source of a rope's state while it moves: a simulation, or a camera with an estimator."""

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the state at an instant, from whatever has been seen until then.

        Parameters
        ----------
        t : float
            The instant, s; never earlier than in the call before.
        motion : Motion
            What the arm has done since t = 0 and, as far as it is decided, will do; it covers `t`.
        """


class Motor(Protocol):
    """Motor that turns an arm: a simulated servo, or a real one."""

    def set_motion(self, motion: Motion, at: float) -> None:
        """Ask for a motion from a time on.

        Parameters
        ----------
        motion : Motion
            Arm angle over the time since the start of the cast, s; what it says of earlier times does not matter.
        at : float
            When it is asked for, s; never earlier than any time that was asked for or read before.
        """

    def angle(self, t: float) -> float:
        """Return what the encoder shows at a time `t` (s, never earlier than one read before), rad."""
