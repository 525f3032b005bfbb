"""Plan a whip: strokes after which the rope's tip passes a point fast, in a wanted direction."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.casting import tables, whip_tables
from hyperflex.casting.blow import RADIUS, Impact, impact
from hyperflex.casting.lash import Mark
from hyperflex.casting.limits import MotorLimits
from hyperflex.casting.strokes import Strokes
from hyperflex.casting.thrower import Thrower
from hyperflex.casting.whip_aim import Aim, aimed
from hyperflex.casting.whip_reach import WhipReach, reach_whip
from hyperflex.casting.whip_search import WhipMap, WhipSearch, whip_map
from hyperflex.casting.whip_strike import Lash, lash
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput
from hyperflex.files import PathLike
from hyperflex.model import Arm, Rope, divided
from hyperflex.motion import Motion
from hyperflex.simulation.rollouts import progress_bar

PATIENCE, PERIODS = 30.0, 3.0  # s; swing periods within which the tip strikes by default
TRIED = 8  # peaks of the map that are aimed as they are
READY, GENERATIONS = 0.06, 16  # m, cost from which on a swing is aimed; of a search before it
PLANS = 3  # whips that meet the target, of which the least uncertain one is taken
MEETS = 1e-3  # m
FINER = 2  # pieces of each link in the second verification


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
        Standard deviation of the place of the peak, m, for a rope known as :mod:`hyperflex.casting.whip_aim` says.
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
        """The tip passes within MEETS of the target, as fast and as directed as asked."""
        return not self.reason

    @property
    def motion(self) -> Motion | None:
        """What the arm does, from rest at t = 0; None where there is no plan."""
        return None if self.strokes is None else self.strokes.motion(self.thrower.limits)

    def impact(self, *, radius: float = RADIUS, mu: float = 0.3) -> Impact:
        """Simulate the blow on a small fixed peg whose surface is at the target; see :class:`Impact`.

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

        Parameters
        ----------
        path : path-like
            Where to write, whole or not at all.
        rate : float
            Rows a second, Hz.
        """
        tables.write_motion(path, whip_tables.motion_of(self), rate)

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
        Within which the tip must be there, s; by default three periods of the rope's swing.
    patience : float
        Time to search, s, beside that of the map.
    regardless : bool
        Search even for a target that is called out of reach.
    known : WhipMap, optional
        Made for the same rope, arm and limits by :func:`whip_map`; by default it is made, which takes some seconds.
    seed : int
        Of the search.
    threads : int, optional
        By default one a processor.
    progress : bool
        Show a progress bar.

    Returns
    -------
    WhipPlan
        Ctrl-C ends the search; the plan is the best until then.

    Raises
    ------
    InvalidInput
        If an argument is not what it should be.
    """
    begin = time.monotonic()
    mark = Mark.at(point, direction, least_speed, within) if direction is not None else Mark.anyway(point, least_speed)
    patience = checks.number("patience", patience, sign="positive", unit="s")
    seed = checks.count("seed", seed, least=0)
    if known is None:
        usual = PERIODS * swing_period(rope)
        time_limit = usual if time_limit is None else checks.number("time_limit", time_limit, sign="positive", unit="s")
        known = whip_map(Thrower(rope, arm, limits or MotorLimits(), time_limit), threads=threads)
    elif known.thrower.rope is not rope or known.thrower.arm != arm or limits not in (None, known.thrower.limits):
        raise InvalidInput(
            "map was made for another rope, arm or motor", fix="Make one: whip_map(Thrower(rope, arm, limits))"
        )
    thrower = known.thrower
    told = reach_whip(known, mark)
    if not math.isfinite(told.cost) or not (told.within or regardless):
        return WhipPlan(thrower, mark, told, None, None, None, math.nan, told.reason, 0, time.monotonic() - begin)
    work = _Work(known, mark, patience, seed, threads)
    interrupted = False
    with progress_bar(0.0, patience, progress, "planning") as report:
        try:
            work.go(report)
        except KeyboardInterrupt:
            interrupted = True
    return work.plan(told, begin, interrupted)


class _Work:
    """The course of a search: from one swing of the map after the other, until enough of them meet the target."""

    def __init__(self, known: WhipMap, mark: Mark, patience: float, seed: int, threads: int | None) -> None:
        self.known, self.mark, self.patience, self.seed, self.threads = known, mark, patience, seed, threads
        self.begin, self.runs = time.monotonic(), 0
        self.aims: list[Aim] = []

    @property
    def spent(self) -> float:
        return time.monotonic() - self.begin

    def go(self, report: Callable[[float], None] | None) -> None:
        nearest = self.known.nearest(self.mark)
        for found in nearest[:TRIED]:
            if self.add(aimed(self.known.thrower, self.mark, found), report):
                return
        for number, found in enumerate(nearest):
            search = WhipSearch(self.known.thrower, self.mark, found, self.seed + number, self.threads)
            for _ in range(GENERATIONS):
                if search.found.cost < READY or self.spent > self.patience:
                    break
                search.step()
            self.runs += search.runs
            if self.add(aimed(self.known.thrower, self.mark, search.found), report):
                return

    def add(self, aim: Aim | None, report: Callable[[float], None] | None) -> bool:
        """Keep a whip; tells whether there are enough, or no time is left."""
        if aim is not None:
            self.aims.append(aim)
            self.aims.sort(key=self.rank)
        if report is not None:
            report(min(self.spent, self.patience))
        return self.spent > self.patience or sum(self.rank(one)[0] == 0.0 for one in self.aims) >= PLANS

    def rank(self, aim: Aim) -> tuple[float, float]:
        """The less, the better: by how much a whip fails, then how uncertain it is."""
        miss = float(np.hypot(*(aim.place - self.mark.point)))
        beyond = max(0.0, abs(float(self.mark.off(aim.velocity))) - self.mark.within)
        slow = max(0.0, 1.0 - aim.speed / self.mark.speed)
        return max(0.0, miss - MEETS) + beyond + slow, aim.doubt

    def plan(self, told: WhipReach, begin: float, interrupted: bool) -> WhipPlan:
        """Verify the best whip."""
        thrower, mark = self.known.thrower, self.mark
        if not self.aims:
            why = "interrupted before any whip was found" if interrupted else "no peak of the tip's speed comes near it"
            return WhipPlan(
                thrower, mark, told, None, None, None, math.nan, why, self.runs, time.monotonic() - begin, interrupted
            )
        best = self.aims[0]
        motion = best.strokes.motion(thrower.limits)
        seen = lash(thrower, mark, motion, best.t)
        finer = lash(replace(thrower, rope=divided(thrower.rope, FINER)), mark, motion, best.t)
        return WhipPlan(
            thrower,
            mark,
            told,
            best.strokes,
            seen,
            finer,
            best.doubt,
            why_not(seen),
            self.runs,
            time.monotonic() - begin,
            interrupted,
        )


def why_not(seen: Lash | None) -> str:
    """Say why a whip fails, "" if it does not."""
    if seen is None:
        return "in the verified run the tip's speed has no peak there"
    if seen.reason:
        return seen.reason
    return f"the tip misses the target by {1e3 * seen.miss:.1f} mm" if seen.miss > MEETS else ""
