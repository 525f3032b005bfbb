"""The outcome of a whip in a simulated run: the peak of the tip's speed at the target."""

import math
from dataclasses import dataclass, replace

import numpy as np

from hyperflex.motion import Motion
from hyperflex.planning.clearance import named, obstacle_gaps
from hyperflex.planning.problem import Problem
from hyperflex.planning.search.contact_phase import starts_outside
from hyperflex.planning.tip.outcome import (
    WINDOW,
    TipOutcome,
    run_figures,
    sample_times,
    simulate_in_time,
    touched_samples,
)
from hyperflex.planning.verification import verified_setup
from hyperflex.planning.whip.tip_target import TipTarget, find_peaks
from hyperflex.simulation import Deadline
from hyperflex.trajectory import Trajectory

TOL = 1e-7  # m


@dataclass(frozen=True, eq=False, kw_only=True)
class TipStrike(TipOutcome):
    """The highest peak of the tip's speed about the expected time, in a simulated run.

    Its instant is the peak's, and its message does not tell of the miss; the rest is as of :class:`TipOutcome`.

    Attributes
    ----------
    miss : float
        Distance from the target, m.
    angle_error : float
        Angle between velocity and the asked direction, rad, >= 0.
    earlier_speed : float
        Greatest speed of the tip at a peak before, m/s.
    touches_later : str
        Which obstacle the rope touches after the peak, until the run ends, and when; empty if none. Until the peak
        touches are failures.
    """

    miss: float
    angle_error: float
    earlier_speed: float
    touches_later: str = ""

    def in_short(self) -> str:
        """Return what matters most to whoever carries the strokes out, in figures with units."""
        return f"{self.speed:.1f} m/s at {self.t:.2f} s, {1e3 * self.miss:.2g} mm off, {self.torque:.3g} N m"


def verify_whip(
    problem: Problem,
    target: TipTarget,
    motion: Motion,
    near: float,
    *,
    tol: float = TOL,
    time_budget: Deadline | None = None,
) -> TipStrike | None:
    """Simulate a motion from rest and find the highest peak of the tip's speed about time `near`, s.

    Beside obstacles it is the highest before the rope touches one, unless the peak next to `near` comes later; a free
    run tells the peaks. Returns None if a run fails or begins in an obstacle, or there is no peak; raises OutOfTime if
    it does not end within a `time_budget`.
    """
    t = sample_times(near)
    setup = verified_setup(problem, motion, float(t[-1]), tol=tol)
    if not starts_outside(setup):
        return None
    run = simulate_in_time(replace(setup, pegs=()), t, time_budget)
    if run is None:
        return None
    found, touched = find_peaks(run.t, run.tip[None], run.tip_velocity[None]), math.inf
    about = np.abs(found.t - near) < WINDOW
    if not about.any():
        return None
    if setup.pegs:
        run = simulate_in_time(setup, np.union1d(t, found.t[about]), time_budget)
        if run is None:
            return None
        there = touched_samples(run, problem.obstacles)
        touched = float(run.t[there.argmax()]) if there.any() else math.inf
    before = about & (found.t < touched)
    nearest = int(np.where(about, np.abs(found.t - near), np.inf).argmin())
    k = int(np.where(before, found.speed, 0.0).argmax()) if before[nearest] else nearest
    earlier = found.speed[found.t < found.t[k]]
    error, speed = abs(float(target.angle_error(found.velocity[k]))), float(found.speed[k])
    figures, touch = run_figures(problem, run, float(found.t[k])), ""
    if touched < math.inf:
        touch = _touches(problem, run, touched)
    if touched <= found.t[k]:  # however short, and whatever distance the samples show
        figures |= {"refused": f"the rope touches {touch}", "clearance": min(figures["clearance"], 0.0)}
    message = figures["refused"]
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
        touches_later=touch if found.t[k] < touched else "",
        message=message,
        **figures,
    )


def _touches(problem: Problem, run: Trajectory, t: float) -> str:
    """Return which obstacle the rope touches at time t, s, and when."""
    joints = run.joints[int(np.searchsorted(run.t, t))]
    gaps = obstacle_gaps(problem.obstacles, joints[:-1], joints[1:]).min(axis=-1)
    return f"{named(problem.obstacles[int(gaps.argmin())])} at {t:.2f} s"
