"""Plan a whip: strokes after which the rope's tip passes a point fast, in a wanted direction."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.model import Arm, Rope
from hyperflex.motion import Motion
from hyperflex.planning import files as tables
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.motor_limits import MotorLimits
from hyperflex.planning.time_budget import Clock
from hyperflex.planning.whip import files as whip_tables
from hyperflex.planning.whip.impact import RADIUS, Impact, impact
from hyperflex.planning.whip.outcome import Lash
from hyperflex.planning.whip.planner import WhipCourse
from hyperflex.planning.whip.reachability import WhipReach, distance, reach_whip
from hyperflex.planning.whip.search import WhipMap, whip_map
from hyperflex.planning.whip.strokes import Strokes
from hyperflex.planning.whip.tip_target import Mark
from hyperflex.simulation.rollouts import progress_bar

PATIENCE, PERIODS = 30.0, 3.0  # s; swing periods within which the tip strikes by default


@dataclass(frozen=True, eq=False)
class WhipPlan:
    """A planned whip, or why there is none.

    Attributes
    ----------
    thrower : Thrower
        Rope, arm, limits and time.
    mark : Mark
        The target.
    reach : WhipReach
    strokes : Strokes or None
        The best found.
    lash : Lash or None
        What the tip does in a verified, simulated run.
    finer : Lash or None
        The same with links of half the length.
    doubt : float
        Standard deviation of the place of the peak, m, for a rope known as :mod:`hyperflex.planning.whip.aim` says.
    reason : str
        Why the plan fails; empty if it does not.
    runs : int
        Simulated runs of the search.
    seconds : float
        Time that it took, s.
    interrupted : bool
        Ctrl-C came; the plan is the best until then.
    """

    thrower: Thrower
    mark: Mark
    reach: WhipReach
    strokes: Strokes | None
    lash: Lash | None
    finer: Lash | None
    doubt: float
    reason: str
    runs: int
    seconds: float
    interrupted: bool = False

    @property
    def success(self) -> bool:
        """The tip passes the target as near, fast and directed as asked, and with finer links near it too."""
        return not self.reason

    @property
    def motion(self) -> Motion | None:
        """What the arm does, from rest at t = 0; None where there is no plan."""
        return None if self.strokes is None else self.strokes.motion(self.thrower.limits)

    def impact(self, *, radius: float = RADIUS, mu: float = 0.3) -> Impact:
        """Simulate the blow on a small fixed peg whose surface is at the target; see :class:`Impact`.

        Parameters
        ----------
        radius : float
            Of the peg, m.
        mu : float
            Its friction.

        Raises
        ------
        InvalidInput
            If there is no plan.
        """
        motion = self.motion
        if motion is None or self.lash is None:
            raise InvalidInput("a plan without strokes strikes nothing", got=self.reason, allowed="a plan with strokes")
        mark = self.mark
        if mark.anyhow:
            mark = replace(mark, direction=float(np.arctan2(*self.lash.velocity[::-1])))
        return impact(self.thrower, mark, motion, self.lash.t, radius=radius, mu=mu)

    def to_csv(self, path: PathLike, *, rate: float = tables.RATE) -> None:
        """Write what the arm does at a motor's rate to a CSV file that :func:`hyperflex.read_motion` reads.

        A whip that does not stand is marked in the file's head, ``# not verified: ...`` or ``# fails: ...``.

        Parameters
        ----------
        path : path-like
            Where to write, whole or not at all.
        rate : float
            Rows a second, Hz.
        """
        tables.write_motion(path, whip_tables.motion_of(self), rate, notes=whip_tables.note(self))

    def to_netcdf(self, path: str | Path) -> None:
        """Write the verified run to NetCDF.

        Parameters
        ----------
        path : path-like
            Where to write, whole or not at all.
        """
        whip_tables.lash_of(self).run.to_netcdf(path)

    def to_toml(self, path: PathLike) -> None:
        """Write set-up, limits and outcome to TOML: ``hyperflex simulate`` runs it, ``casting.read_whip`` reads it.

        Parameters
        ----------
        path : path-like
            Where to write, whole or not at all.
        """
        whip_tables.write_whip(path, self)


def plan_whip(
    rope: Rope,
    arm: Arm,
    point: npt.ArrayLike,
    direction: npt.ArrayLike | None = None,
    limits: MotorLimits | None = None,
    *,
    least_speed: float = 5.0,
    within: float = math.radians(20.0),
    time_limit: float | None = None,
    patience: float = PATIENCE,
    regardless: bool = False,
    known: WhipMap | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
) -> WhipPlan:
    """Plan how an arm whips its rope so that the tip passes a point at a peak of its speed.

    Parameters
    ----------
    rope, arm : Rope, Arm
        The rope hangs at rest from the arm, which points to one side.
    point : (2,) array_like
        Where the tip shall be at the peak, m.
    direction : (2,) array_like, optional
        In which it shall move there: a vector of any length but 0. By default any direction will do.
    limits : MotorLimits, optional
        Of the motor; by default the paper's.
    least_speed : float
        Of the tip, m/s.
    within : float
        Greatest angle between the tip's velocity and the direction, rad; does not matter where none is given.
    time_limit : float, optional
        Within which the tip must be there, s; by default that of the map if one is given, else three periods of the
        rope's swing.
    patience : float
        Time to search, s, beside that of the map, of verifying and of compiling.
    regardless : bool
        Search even for a target that is called out of reach.
    known : WhipMap, optional
        Made for the same rope, arm, limits and time by :func:`whip_map`; by default it is made, which takes some
        seconds.
    seed : int
        Of the search.
    threads : int, optional
        By default one a processor.
    progress : bool
        Show a progress bar.

    Returns
    -------
    WhipPlan
        Ctrl-C ends map, search and verification; the plan is the best until then.

    Raises
    ------
    InvalidInput
        If an argument is not what it should be, or a link's centre of mass is not in its middle: the second
        verification cuts it in two.
    """
    clock = Clock()
    mark = Mark.at(point, direction, least_speed, within) if direction is not None else Mark.anyway(point, least_speed)
    patience = checks.number("patience", patience, sign="positive", unit="s")
    seed = checks.count("seed", seed, least=0)
    if time_limit is not None:
        time_limit = checks.number("time_limit", time_limit, sign="positive", unit="s")
    thrower = _thrower(rope, arm, limits, time_limit, known)
    if known is None:
        try:
            known = whip_map(thrower, threads=threads)
        except KeyboardInterrupt:
            told = WhipReach(distance(thrower, mark), math.inf, "interrupted before that was known")
            why = "interrupted before the map of swings was made"
            return WhipPlan(thrower, mark, told, None, None, None, math.nan, why, 0, clock.passed, interrupted=True)
    told = reach_whip(known, mark)
    if not math.isfinite(told.cost) or not (told.within or regardless):
        return WhipPlan(thrower, mark, told, None, None, None, math.nan, told.reason, 0, clock.passed)
    course = WhipCourse(known, mark, patience, seed, threads)
    interrupted = False
    with progress_bar(0.0, patience, progress, "planning") as report:
        try:
            course.go(report)
        except KeyboardInterrupt:
            interrupted = True
    best, again = course.verified()
    interrupted = interrupted or again
    if best is None:
        why = "interrupted before any whip was found" if interrupted else "no peak of the tip's speed comes near it"
        return WhipPlan(thrower, mark, told, None, None, None, math.nan, why, course.runs, clock.passed, interrupted)
    aim, seen, finer, why = best
    return WhipPlan(
        thrower, mark, told, aim.strokes, seen, finer, aim.doubt, why, course.runs, clock.passed, interrupted
    )


def _thrower(
    rope: Rope, arm: Arm, limits: MotorLimits | None, time_limit: float | None, known: WhipMap | None
) -> Thrower:
    """Return who whips: the map's thrower if there is a map, which must be the one that is asked for."""
    if known is None:
        usual = PERIODS * swing_period(rope)
        return Thrower(rope, arm, limits or MotorLimits(), usual if time_limit is None else time_limit)
    made = known.thrower
    if made.rope != rope or made.arm != arm or limits not in (None, made.limits) or time_limit not in (None, made.time):
        raise InvalidInput(
            "map was made for another rope, arm, motor or time",
            fix="Make one: whip_map(Thrower(rope, arm, limits, time_limit))",
        )
    return made
