"""What a whip does at its target in a verified run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.whip.tip_target import Mark, peaks
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

TOL = 1e-7  # m
SAMPLE_TIME, WINDOW = 2e-3, 0.15  # s: between samples; how far from the time that is expected a peak is looked for


@dataclass(frozen=True, eq=False)
class Lash:
    """The greatest peak of the tip's speed about the expected time, in a simulated run.

    Attributes
    ----------
    t : float
        When, s.
    place, velocity : (2,) float64
        Of the tip, m, m/s.
    miss : float
        Distance from the target, m.
    off : float
        Angle between velocity and the asked direction, rad.
    before : float
        Greatest speed of the tip before, m/s.
    reason : str
        Why it is not what was asked, the miss aside; empty if it is.
    run : Trajectory
    """

    t: float
    place: Array
    velocity: Array
    miss: float
    off: float
    before: float
    reason: str
    run: Trajectory

    @property
    def speed(self) -> float:
        """Speed of the tip, m/s."""
        return float(np.hypot(*self.velocity))

    @property
    def torque(self) -> float:
        """Greatest torque that the arm's motion asks of the motor for the rope, N m."""
        return float(np.abs(self.run.motor_torque).max())


def lash(thrower: Thrower, mark: Mark, motion: Motion, near: float, *, tol: float = TOL) -> Lash | None:
    """Run a motion from rest and find the greatest peak of the tip's speed about time `near`, s.

    None where the run fails or has no peak there.
    """
    t = SAMPLE_TIME * np.arange(np.ceil((near + WINDOW) / SAMPLE_TIME) + 1.0)
    try:
        run = simulate(thrower.rope, motion, arm=thrower.arm, duration=float(t[-1]), t_eval=t, tol=tol)
    except SimulationError:
        return None
    found = peaks(run.t, run.tip[None], run.tip_velocity[None])
    about = np.abs(found.t - near) < WINDOW
    if not about.any():
        return None
    k = int(np.where(about, found.speed, 0.0).argmax())
    earlier = found.speed[found.t < found.t[k]]
    place, velocity = found.place[k], found.velocity[k]
    off, speed = abs(float(mark.off(velocity))), float(found.speed[k])
    reason = ""
    if speed < mark.speed:
        reason = f"the tip's speed is {speed:.2f} m/s, and {mark.speed:g} is asked"
    elif off > mark.within:
        reason = f"the tip's direction is {np.degrees(off):.0f} degrees off, {np.degrees(mark.within):.0f} allowed"
    return Lash(
        float(found.t[k]),
        place,
        velocity,
        float(np.hypot(*(place - mark.point))),
        off,
        float(earlier.max(initial=0.0)),
        reason,
        run,
    )
