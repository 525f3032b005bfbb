"""Casting by swinging, open loop (paper section IV): the cable, the arm and the runs behind Figs. 9 to 12."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import numpy as np

from hyperflex.checks import Array
from hyperflex.control import PhasePortrait, Spiral, phase_portrait, spiral
from hyperflex.model import Arm, Rope
from hyperflex.motion import arm_swings
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory

Path = Literal["under", "over"]
Friction = Literal["relative", "printed"]
Profile = Literal["bang-bang", "ramp", "minimum-jerk"]
Outcome = Literal["success", "failure"]

T_MOVE = 0.73  # s, the arm's half turn
T_REST: dict[Outcome, float] = {"success": 0.53, "failure": 0.34}  # s; the failure's is inferred from its c
TIME_CONSTANT: dict[Outcome, float] = {"success": 0.40, "failure": 0.34}  # s, c of (10) and (11)
DURATION = 14.0  # s
RATE = 1000  # samples per second: the tip cracks like a whip, and r peaks within a few milliseconds
TOL = 1e-8


@dataclass(frozen=True)
class Reading:
    """One way to read what the paper leaves open.

    Attributes
    ----------
    path : {"under", "over"}
        The arm turns through the bottom or over the top.
    friction : {"relative", "printed"}
        Friction of relative joints with its reaction, or eq. (4) as it is printed.
    """

    path: Path
    friction: Friction

    @property
    def title(self) -> str:
        """The reading in words."""
        way = {"under": "through the bottom", "over": "over the top"}[self.path]
        return f"{way}, {'physical' if self.friction == 'relative' else 'printed'} friction"

    @property
    def key(self) -> str:
        """A short name for file columns."""
        return f"{self.path}_{self.friction}"


READINGS = tuple(Reading(path, friction) for path in ("under", "over") for friction in ("relative", "printed"))
OUTCOMES: tuple[Outcome, ...] = ("success", "failure")


def cable(friction: Friction = "relative") -> Rope:
    """Return the paper's cable: 2 m, 0.125 kg, radius 2.5 mm, 50 links, 5e-4 N m s/rad in each joint.

    The inertia is that of the cylinder, 3.372e-7 kg m^2 a link; the printed 3.37e-4 is a slip.
    """
    return Rope.uniform(
        length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4, friction_model=friction, name="paper cable"
    )


def casting_arm() -> Arm:
    """Return the paper's arm, 105 mm; its angle is prescribed."""
    return Arm(length=0.105)


def run(
    reading: Reading,
    t_rest: float,
    *,
    duration: float = DURATION,
    profile: Profile = "bang-bang",
    rate: int = RATE,
    tol: float = TOL,
) -> Trajectory:
    """Simulate the paper's cast: the rope at rest, hanging, the arm at -pi/2 and swinging from t = 0 on.

    Parameters
    ----------
    reading : Reading
        The arm's way and the friction.
    t_rest : float
        Rest t_c between the arm's motions, s.
    duration : float
        Simulated time, s.
    profile : {"bang-bang", "ramp", "minimum-jerk"}
        How the arm moves in its 0.73 s.
    rate : int
        Samples per second.
    tol : float
        Tolerance of the integrator (see :func:`hyperflex.simulate`).

    Returns
    -------
    Trajectory
    """
    motion = arm_swings(t_move=T_MOVE, t_rest=t_rest, profile=profile, path=reading.path)
    t_eval = np.linspace(0.0, duration, round(duration * rate) + 1)
    return simulate(cable(reading.friction), motion, arm=casting_arm(), duration=duration, t_eval=t_eval, tol=tol)


@dataclass(frozen=True, eq=False)
class Cast:
    """The tip and the arm in one cast, with what section IV derives from them.

    Attributes
    ----------
    reading : Reading
        What was simulated.
    outcome : {"success", "failure"}
        Sets the rest t_c and the time constant c.
    t : (T,) float64
        Time, s.
    tip, tip_velocity : (T, 2) float64
        Tip, m and m/s.
    arm_angle : (T,) float64
        Arm, rad.
    """

    reading: Reading
    outcome: Outcome
    t: Array
    tip: Array
    tip_velocity: Array
    arm_angle: Array

    @property
    def period(self) -> float:
        """The arm's half cycle t_a + t_c, s."""
        return T_MOVE + T_REST[self.outcome]

    @property
    def intervals(self) -> Array:
        """Start and end of each arm motion (m, 2), s."""
        starts = np.arange(0.0, self.t[-1], self.period)
        return np.stack([starts, starts + T_MOVE], axis=1)

    @cached_property
    def spiral(self) -> Spiral:
        """Spiral coordinates of the tip with the paper's c."""
        return spiral(self.t, self.tip[:, 0], self.tip_velocity[:, 0], TIME_CONSTANT[self.outcome])

    @cached_property
    def portrait(self) -> PhasePortrait:
        """The tip's phase portrait, cut where the arm starts and stops."""
        return phase_portrait(self.spiral, self.intervals)

    def reach(self, start: float, end: float) -> float:
        """Return the greatest ``|x|`` of the tip from `start` to `end`, m."""
        within = (self.t >= start) & (self.t <= end)
        return float(np.abs(self.tip[within, 0]).max())


@cache
def cast(reading: Reading, outcome: Outcome, profile: Profile = "bang-bang") -> Cast:
    """Return one of the paper's casts; the same one is simulated only once in a process."""
    result = run(reading, T_REST[outcome], profile=profile)
    return Cast(reading, outcome, result.t, result.tip, result.tip_velocity, result.arm_angle)
