"""A simulated servo with the faults of a real one."""

import math

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.motion import Motion, hold_arm, sampled_motion

__all__ = ["SAMPLE_TIME", "SimulatedMotor"]
SAMPLE_TIME = 2e-3  # s, between samples of what it has done


class SimulatedMotor:
    """A simulated servo with latency, lag and a torque limit; its encoder is quantised.

    Parameters
    ----------
    angle : float
        Initial angle, at rest, rad.
    lag : float
        Lag at constant speed, s; the servo is a critically damped second-order system.
    latency : float
        From :meth:`set_motion` to the first effect, s.
    counts : int
        Encoder steps per turn.
    torque : float
        Largest torque, N m; inf for no limit.
    inertia : float
        Inertia of arm and rotor about the shaft, kg m^2, for the torque limit. The pull of the rope is neglected.

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign, or times go back.

    Notes
    -----
    Not validated against a real servo. With w = 2 / lag, angle y and command u after the latency, inertia y'' is the
    torque inertia (w^2 (u - y) - 2 w y'), limited to `torque`.

    Examples
    --------
    >>> from hyperflex.motion import move_arm
    >>> motor = SimulatedMotor(angle=0.0, lag=0.02, counts=4096)
    >>> taken = motor.set_motion(move_arm(0.0, 1.0, duration=0.5), at=0.0)
    >>> round(motor.angle(0.25), 2), round(motor.angle(1.0), 2)
    (0.42, 1.0)
    """

    def __init__(
        self,
        angle: float = 0.0,
        *,
        lag: float = 0.01,
        latency: float = 0.0,
        counts: int = 4096,
        torque: float = math.inf,
        inertia: float = 1e-3,
    ) -> None:
        self.lag = checks.positive("lag", lag, "s")
        self.latency = checks.number("latency", latency, sign="nonnegative", unit="s")
        self.counts = checks.count("counts", counts)
        self.torque = checks.positive("torque", torque, "N m", infinite=True)
        self.inertia = checks.positive("inertia", inertia, "kg m^2")
        start = checks.number("angle", angle, unit="rad")
        self._asked: list[tuple[float, Motion]] = [(-math.inf, hold_arm(start))]
        self._now = 0.0  # until when others know of it
        self._t, self._y, self._v = 0.0, start, 0.0  # how far it has been simulated
        self._seen: list[tuple[float, float]] = [(0.0, start)]

    def set_motion(self, motion: Motion, at: float) -> bool:
        """Ask for a motion from a time `at` (s) on, after the latency; see :class:`hyperflex.interfaces.Motor`."""
        when = self._later("at", at)
        self._asked.append((when + self.latency, checks.instance("motion", motion, Motion)))
        self._now = when
        return True

    def angle(self, t: float) -> float:
        """Return the encoder's angle at a time `t` (s), rad, rounded down to whole steps."""
        step = 2.0 * math.pi / self.counts
        return step * math.floor(self.true_angle(t) / step)

    def true_angle(self, t: float) -> float:
        """Return where the simulated arm really is at a time `t` (s, never earlier than one read before), rad."""
        self._now = self._later("t", t)
        self._run(self._now)
        return self._y + self._v * (self._now - self._t)

    def motion(self) -> Motion:
        """Return the actual motion of the simulated arm until now, for the simulation of a rope."""
        times, angles = np.array(self._seen).T
        if times.size < 2:
            raise InvalidInput("motor has not moved in time yet", got=self._now, allowed="a later time read first")
        return sampled_motion(times, angles)

    def _later(self, name: str, value: float) -> float:
        time = checks.number(name, value, sign="nonnegative", unit="s")
        if time < self._now:
            raise InvalidInput("time goes back", got=time, allowed=f"at least {self._now:g} s")
        return time

    def _run(self, until: float) -> None:
        """Take the servo's steps that end by `until`, s; semi-implicit Euler."""
        step = min(2.5e-4, self.lag / 16.0)  # s; at least 16 steps in a lag
        count = math.floor((until - self._t) / step + 1e-9)
        if count < 1:
            return
        times: Array = self._t + step * np.arange(1.0, count + 1.0)
        # of each step's beginning: so it is late by the lag, and no step more
        commanded = self._commanded(times - step)
        w, most = 2.0 / self.lag, self.torque / self.inertia
        y, v = self._y, self._v
        for t, u in zip(times.tolist(), commanded.tolist(), strict=True):
            v += step * min(most, max(-most, w**2 * (u - y) - 2.0 * w * v))
            y += step * v
            if t >= self._seen[-1][0] + SAMPLE_TIME:
                self._seen.append((t, y))
        self._t, self._y, self._v = float(times[-1]), y, v

    def _commanded(self, t: Array) -> Array:
        """Angle (T,) asked for at times t (T,), rad: by the last motion that has come through by then."""
        commanded = np.empty(t.size)
        for since, motion in self._asked:
            commanded[t >= since] = motion.angle(t[t >= since])
        return commanded
