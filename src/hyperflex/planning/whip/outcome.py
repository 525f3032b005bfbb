"""The outcome of a whip in a simulated run: the peak of the tip's speed at the target."""

from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.clearance import rope_clearance
from hyperflex.planning.time_budget import OutOfTime
from hyperflex.planning.verification import folded_flat, greatest_bend, motor_torques, refusal, verified_setup
from hyperflex.planning.whip.tip_target import TipTarget, find_peaks
from hyperflex.simulation import OUT_OF_TIME, Deadline, simulate
from hyperflex.trajectory import Trajectory

TOL = 1e-7  # m
SAMPLE_TIME, WINDOW = 2e-3, 0.15  # s: of the run; greatest distance of the peak from the expected time


@dataclass(frozen=True, eq=False)
class TipStrike:
    """The highest peak of the tip's speed about the expected time, in a simulated run.

    Attributes
    ----------
    t : float
        Time of the peak, s.
    place, velocity : (2,) float64
        Of the tip, m, m/s.
    miss : float
        Distance from the target, m.
    angle_error : float
        Angle between velocity and the asked direction, rad, >= 0.
    earlier_speed : float
        Greatest speed of the tip at a peak before, m/s.
    max_bend, folded, clearance, torque, torque_peak
        As of :class:`CastOutcome`, until after the peak.
    refused : str
        Why the run is refused whatever its goal: the rope goes through itself, arm or shaft; empty if it does not.
    message : str
        What fails besides the miss: that, or speed or direction are not as asked; empty if nothing does.
    n_links : int
        Links of the simulated rope.
    run : Trajectory or None
        The run; None if the outcome was read from a file.
    """

    t: float
    place: Array
    velocity: Array
    miss: float
    angle_error: float
    earlier_speed: float
    max_bend: float
    folded: bool
    clearance: float
    torque: float
    torque_peak: float
    refused: str
    message: str
    n_links: int
    run: Trajectory | None = None

    @property
    def speed(self) -> float:
        """Speed of the tip, m/s."""
        return float(np.hypot(*self.velocity))

    def in_short(self) -> str:
        """Return what matters most to whoever carries the strokes out, in figures with units."""
        return f"{self.speed:.1f} m/s at {self.t:.2f} s, {1e3 * self.miss:.2g} mm off, {self.torque:.3g} N m"


def verify_whip(
    cast_setup: CastSetup,
    target: TipTarget,
    motion: Motion,
    near: float,
    *,
    tol: float = TOL,
    time_budget: Deadline | None = None,
) -> TipStrike | None:
    """Simulate a motion from rest and find the highest peak of the tip's speed about time `near`, s.

    Returns None if the run fails or has no peak there; raises OutOfTime if it does not end within a `time_budget`.
    """
    t = SAMPLE_TIME * np.arange(np.ceil((near + WINDOW) / SAMPLE_TIME) + 1.0)
    try:
        setup = verified_setup(cast_setup, motion, float(t[-1]), tol=tol)
        run = simulate(setup, t_eval=t, time_budget=time_budget)
    except SimulationError as failed:
        if failed.status == OUT_OF_TIME:
            raise OutOfTime from None
        return None
    found = find_peaks(run.t, run.tip[None], run.tip_velocity[None])
    about = np.abs(found.t - near) < WINDOW
    if not about.any():
        return None
    k = int(np.where(about, found.speed, 0.0).argmax())
    earlier = found.speed[found.t < found.t[k]]
    error, speed = abs(float(target.angle_error(found.velocity[k]))), float(found.speed[k])
    max_bend, clearance = greatest_bend(run), rope_clearance(run)
    torque, torque_peak = motor_torques(run)
    message = refused = refusal(cast_setup, max_bend, clearance)
    if not message and speed < target.least_speed:
        message = f"the tip's speed is {speed:.2f} m/s, and {target.least_speed:g} is asked"
    elif not message and error > target.angle_tolerance:
        allowed = np.degrees(target.angle_tolerance)
        message = f"the tip's direction is {np.degrees(error):.0f} degrees off, {allowed:.0f} allowed"
    return TipStrike(
        t=float(found.t[k]),
        place=found.place[k],
        velocity=found.velocity[k],
        miss=float(np.hypot(*(found.place[k] - target.point))),
        angle_error=error,
        earlier_speed=float(earlier.max(initial=0.0)),
        max_bend=max_bend,
        folded=folded_flat(run),
        clearance=clearance.value,
        torque=torque,
        torque_peak=torque_peak,
        refused=refused,
        message=message,
        n_links=run.q.shape[1],
        run=run,
    )
