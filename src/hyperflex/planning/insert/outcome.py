"""The outcome of an insertion in a simulated run beside the walls: how deep the tip comes, whether the rope touches."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL
from hyperflex.motion import Motion
from hyperflex.planning.clearance import obstacle_clearance, obstacle_gaps
from hyperflex.planning.insert.slot import Slot, frame, nearest_passage
from hyperflex.planning.problem import Problem
from hyperflex.planning.search.contact_phase import starts_outside
from hyperflex.planning.tip.outcome import TipOutcome, excess_torque, run_figures, sample_times, simulate_in_time
from hyperflex.planning.verification import verified_setup
from hyperflex.simulation import Deadline
from hyperflex.trajectory import Trajectory


@dataclass(frozen=True, eq=False, kw_only=True)
class InsertOutcome(TipOutcome):
    """How the tip goes through a slot in a simulated run beside its walls; the rest as of :class:`TipOutcome`.

    Attributes
    ----------
    t_enter, t : float
        When the tip comes between the walls, and when it is as deep as asked, or else deepest, s.
    depth : float
        Greatest depth of the tip beyond the walls before it leaves them or the run ends, m.
    time_inside : float
        From `t_enter` until the tip leaves, the rope touches a wall (where it must not), or the run ends, s.
    wall_clearance : float
        Least distance of the rope from the walls until `t`, m; 0 or less: it touches them.
    """

    t_enter: float
    depth: float
    time_inside: float
    wall_clearance: float

    def in_short(self) -> str:
        """Return what matters most to whoever carries the strokes out, in figures with units."""
        return (
            f"{1e3 * self.depth:.0f} mm deep, at {self.t:.2f} s with {self.speed:.2f} m/s, "
            f"{1e3 * self.wall_clearance:.1f} mm clear of the walls, {self.torque:.3g} N m"
        )


def verify_insert(
    problem: Problem,
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
    t = sample_times(near)
    setup = verified_setup(problem, motion, float(t[-1]), slot.walls, tol=tol, contact_step=contact_step)
    run = simulate_in_time(setup, t, time_budget) if starts_outside(setup) else None
    if run is None:
        return None
    depth, _ = frame(slot, run.tip)
    way = nearest_passage(depth, slot.depth, run.t, near)
    return None if way is None else evaluate_insert(problem, slot, run, depth, *way)


def evaluate_insert(problem: Problem, slot: Slot, run: Trajectory, depth: Array, begin: int, end: int) -> InsertOutcome:
    """Evaluate a run whose tip comes between the walls at sample `begin` and is deep at sample `end`.

    `depth` (T,), m, is that of the tip.
    """
    t_enter, t = _time_at(run.t, depth, begin, 0.0), _time_at(run.t, depth, end, slot.depth)
    touched = _wall_touches(problem, slot, run)
    left = begin + np.flatnonzero(np.append(depth[begin:], -1.0) <= 0.0)[0]
    last = min([int(left), *([] if slot.touching else touched[touched >= begin].tolist()), run.t.size - 1])
    deepest = float(depth[begin : last + 1].max())
    walls = obstacle_clearance(run, slot.walls, t)
    gap = min(walls.value, 0.0) if (touched <= end).any() else walls.value
    figures = run_figures(problem, run)
    message = figures["refused"]
    velocity = np.array([np.interp(t, run.t, each) for each in run.tip_velocity.T])
    speed = float(np.hypot(*velocity))
    if not message and gap <= 0.0 and not slot.touching:
        message = f"the rope touches a wall at {min(walls.t, run.t[touched[0]] if touched.size else math.inf):.2f} s"
    elif not message and deepest < slot.depth:
        message = f"the tip comes {1e3 * deepest:.1f} mm deep, and {1e3 * slot.depth:g} mm are asked"
    elif not message and speed > slot.max_speed:
        message = f"the tip is there with {speed:.2f} m/s, and {slot.max_speed:g} at most are asked"
    return InsertOutcome(
        t_enter=t_enter,
        t=t,
        place=np.array([np.interp(t, run.t, each) for each in run.tip.T]),
        velocity=velocity,
        depth=deepest,
        time_inside=float(run.t[last]) - t_enter,
        wall_clearance=gap,
        message=message or excess_torque(problem, figures["torque"]),
        **figures,
    )


def _wall_touches(problem: Problem, slot: Slot, run: Trajectory) -> npt.NDArray[np.int64]:
    """Return the samples at which a link is pushed that is as near to a wall of the slot as to any obstacle."""
    row, link = np.nonzero(np.abs(np.asarray(run.contact_force)).sum(axis=2))
    gaps = obstacle_gaps((*slot.walls, *problem.obstacles), run.joints[row, link], run.joints[row, link + 1])
    walls = len(slot.walls)
    near = gaps[:walls].min(axis=0) <= gaps[walls:].min(axis=0, initial=np.inf)
    return np.unique(row[near])


def _time_at(t: Array, depth: Array, row: int, level: float) -> float:
    """Return when the tip passes a depth, m, before a sample, s; that of the sample if it does not."""
    low, high = depth[row - 1], depth[row]
    return float(np.interp(level, [low, high], t[row - 1 : row + 1])) if low < high else float(t[row])
