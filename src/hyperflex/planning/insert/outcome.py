"""The outcome of an insertion in a simulated run beside the walls: how deep the tip comes, whether the rope touches."""

import math
from dataclasses import dataclass

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL
from hyperflex.motion import Motion
from hyperflex.planning.cast_setup import CastSetup
from hyperflex.planning.clearance import rope_clearance, wall_clearance
from hyperflex.planning.insert.slot import Slot, frame, nearest_passage
from hyperflex.planning.search.contact_phase import starts_outside
from hyperflex.planning.time_budget import OutOfTime
from hyperflex.planning.verification import folded_flat, greatest_bend, motor_torques, refusal, verified_setup
from hyperflex.simulation import OUT_OF_TIME, Deadline, simulate
from hyperflex.trajectory import Trajectory

SAMPLE_TIME, WINDOW = 2e-3, 0.15  # s: of the run; from the expected time to the end of the run


@dataclass(frozen=True, eq=False)
class InsertOutcome:
    """How the tip goes through a slot in a simulated run beside its walls.

    Attributes
    ----------
    t_enter, t : float
        When the tip comes between the walls, and when it is as deep as asked, or else deepest, s.
    place, velocity : (2,) float64
        Of the tip at `t`, m, m/s.
    depth : float
        Greatest depth of the tip beyond the walls before it leaves them or the run ends, m.
    time_inside : float
        From `t_enter` until the tip leaves, the rope touches a wall, or the run ends, s.
    wall_clearance : float
        Least distance of the rope from the walls until `t`, m; 0 or less: it touches them.
    max_bend, folded, clearance, torque, torque_peak
        As of :class:`CastOutcome`.
    refused : str
        Why the run is refused whatever its goal: the rope goes through itself, arm or shaft; empty if it does not.
    message : str
        What fails; empty if nothing does.
    n_links : int
        Links of the simulated rope.
    run : Trajectory or None
        The run; None if the outcome was read from a file.
    """

    t_enter: float
    t: float
    place: Array
    velocity: Array
    depth: float
    time_inside: float
    wall_clearance: float
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
        """Speed of the tip at `t`, m/s."""
        return float(np.hypot(*self.velocity))

    def in_short(self) -> str:
        """Return what matters most to whoever carries the strokes out, in figures with units."""
        return (
            f"{1e3 * self.depth:.0f} mm deep, at {self.t:.2f} s with {self.speed:.2f} m/s, "
            f"{1e3 * self.wall_clearance:.1f} mm clear of the walls, {self.torque:.3g} N m"
        )


def verify_insert(
    cast_setup: CastSetup,
    slot: Slot,
    motion: Motion,
    near: float,
    *,
    tol: float = DEFAULT_TOL,
    contact_step: float = DEFAULT_CONTACT_STEP,
    time_budget: Deadline | None = None,
) -> InsertOutcome | None:
    """Simulate a motion from rest beside the walls of a slot; the tip is to be inside about time `near`, s.

    Returns None if the run fails, the rope lies on a wall from the start, or the tip does not go through; raises
    OutOfTime if it does not end within a `time_budget`. `tol`, m, and `contact_step`, s, are as of
    :func:`hyperflex.simulate`.
    """
    t = SAMPLE_TIME * np.arange(np.ceil((near + WINDOW) / SAMPLE_TIME) + 1.0)
    setup = verified_setup(cast_setup, motion, float(t[-1]), slot.walls, tol=tol, contact_step=contact_step)
    if not starts_outside(setup):
        return None
    try:
        run = simulate(setup, t_eval=t, time_budget=time_budget)
    except SimulationError as failed:
        if failed.status == OUT_OF_TIME:
            raise OutOfTime from None
        return None
    depth, _ = frame(slot, run.tip)
    way = nearest_passage(depth, slot.depth, run.t, near)
    return None if way is None else evaluate_insert(cast_setup, slot, run, depth, *way)


def evaluate_insert(
    cast_setup: CastSetup, slot: Slot, run: Trajectory, depth: Array, begin: int, end: int
) -> InsertOutcome:
    """Evaluate a run whose tip comes between the walls at sample `begin` and is deep at sample `end`.

    `depth` (T,), m, is that of the tip.
    """
    t_enter, t = _time_at(run.t, depth, begin, 0.0), _time_at(run.t, depth, end, slot.depth)
    touched = np.flatnonzero(np.abs(np.asarray(run.contact_force)).sum(axis=(1, 2)) > 0.0)
    left = begin + np.flatnonzero(np.append(depth[begin:], -1.0) <= 0.0)[0]
    last = min([int(left), *touched[touched >= begin].tolist(), run.t.size - 1])
    deepest = float(depth[begin : last + 1].max())
    walls = wall_clearance(run, slot.walls, t)
    gap = min(walls.value, 0.0) if (touched <= end).any() else walls.value
    max_bend, clearance = greatest_bend(run), rope_clearance(run)
    torque, torque_peak = motor_torques(run)
    message = refused = refusal(cast_setup, max_bend, clearance)
    if not message and gap <= 0.0:
        message = f"the rope touches a wall at {min(walls.t, run.t[touched[0]] if touched.size else math.inf):.2f} s"
    elif not message and deepest < slot.depth:
        message = f"the tip comes {1e3 * deepest:.1f} mm deep, and {1e3 * slot.depth:g} mm are asked"
    elif not message and torque > cast_setup.limits.torque:
        message = f"it asks {torque:.3g} N m of a motor that gives {cast_setup.limits.torque:.3g}"
    return InsertOutcome(
        t_enter=t_enter,
        t=t,
        place=np.array([np.interp(t, run.t, each) for each in run.tip.T]),
        velocity=np.array([np.interp(t, run.t, each) for each in run.tip_velocity.T]),
        depth=deepest,
        time_inside=float(run.t[last]) - t_enter,
        wall_clearance=gap,
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


def _time_at(t: Array, depth: Array, row: int, level: float) -> float:
    """Return when the tip passes a depth, m, before a sample, s; that of the sample if it does not."""
    low, high = depth[row - 1], depth[row]
    return float(np.interp(level, [low, high], t[row - 1 : row + 1])) if low < high else float(t[row])
