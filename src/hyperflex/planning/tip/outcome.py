"""The outcome of strokes in a simulated run: what whips and insertions are told of alike."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.errors import SimulationError
from hyperflex.model import Obstacle, Setup
from hyperflex.planning.clearance import obstacle_gaps
from hyperflex.planning.problem import Problem
from hyperflex.planning.time_budget import OutOfTime
from hyperflex.planning.verification import clearances, folded_flat, greatest_bend, motor_torques, refusal
from hyperflex.simulation import OUT_OF_TIME, Deadline, simulate
from hyperflex.trajectory import Trajectory
from hyperflex.winding import TOUCH

SAMPLE_TIME, WINDOW = 2e-3, 0.15  # s: of the run; from the expected time to the end of the run


@dataclass(frozen=True, eq=False, kw_only=True)
class TipOutcome:
    """What becomes of strokes in a simulated run.

    Attributes
    ----------
    t : float
        The instant that counts, s.
    place, velocity : (2,) float64
        Of the tip then, m, m/s.
    max_bend, folded, clearance, torque, torque_peak
        As of :class:`CastOutcome`, until the run ends; of a whip, obstacles count for `clearance` until `t`.
    refused : str
        Why the run is refused whatever its goal: the rope goes through itself, arm or shaft, or touches an obstacle, or
        comes nearer than asked; empty if it does not.
    message : str
        What fails; empty if nothing does.
    n_links : int
        Links of the simulated rope.
    run : Trajectory or None
        The run; None if the outcome was read from a file.
    """

    t: float
    place: Array
    velocity: Array
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


def sample_times(near: float) -> Array:
    """Return the times of a run's samples (T,), s, until WINDOW after the expected time `near`, s."""
    return SAMPLE_TIME * np.arange(np.ceil((near + WINDOW) / SAMPLE_TIME) + 1.0)


def simulate_in_time(setup: Setup, t: Array, time_budget: Deadline | None) -> Trajectory | None:
    """Simulate a set-up; None if the run fails, and OutOfTime if it does not end within a `time_budget`."""
    try:
        return simulate(setup, t_eval=t, time_budget=time_budget)
    except SimulationError as failed:
        if failed.status == OUT_OF_TIME:
            raise OutOfTime from None
        return None


def run_figures(problem: Problem, run: Trajectory, until: float = np.inf) -> dict[str, Any]:
    """Return what a :class:`TipOutcome` tells of its whole run; of obstacles `until` a time, s, alone."""
    max_bend, near, (torque, torque_peak) = greatest_bend(run), clearances(problem, run, until), motor_torques(run)
    return {
        "max_bend": max_bend,
        "folded": folded_flat(run),
        "clearance": min(each.value for each in near),
        "torque": torque,
        "torque_peak": torque_peak,
        "refused": refusal(problem, max_bend, near),
        "n_links": run.q.shape[1],
        "run": run,
    }


def touched_samples(run: Trajectory, obstacles: Sequence[Obstacle]) -> npt.NDArray[np.bool_]:
    """Whether the rope touched the obstacles of a run, which are all that it may touch: (T,), since the sample before.

    That tells its force, or a loss where an obstacle is as near as a link moves in that time. A loss alone may be that
    of a joint that comes to its limit.
    """
    near = obstacle_gaps(obstacles, run.joints[:, :-1], run.joints[:, 1:]).min(axis=(1, 2)) - run.setup.rope.radius
    ends = run.base_velocity[:, None] + np.cumsum(
        (run.setup.rope.length * run.qd)[..., None] * np.stack([np.cos(run.q), np.sin(run.q)], axis=-1), axis=1
    )
    fastest = np.hypot(ends[..., 0], ends[..., 1]).max(axis=1)
    lost = np.diff(np.asarray(run.contact_loss), prepend=0.0) > 0.0
    reach = TOUCH + np.diff(run.t, prepend=run.t[0]) * fastest
    return np.asarray((lost & (near < reach)) | (np.abs(np.asarray(run.contact_force)).sum(axis=(1, 2)) > 0.0))


def excess_torque(problem: Problem, torque: float) -> str:
    """Return that a run asks more `torque`, N m, of the motor than it gives; empty if it does not."""
    given = problem.limits.torque
    return "" if torque <= given else f"it asks {torque:.3g} N m of a motor that gives {given:.3g}"
