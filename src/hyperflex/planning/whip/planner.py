"""Plan a whip: swings of a map are aimed at the target one after the other, and the best ones are verified."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput
from hyperflex.interruption import caught, interruptible
from hyperflex.model import Arm, Rope, divided
from hyperflex.planning.cast_setup import CastSetup, MotorLimits
from hyperflex.planning.time_budget import Clock, OutOfTime
from hyperflex.planning.whip.aim import AimedPeak, aim_peak
from hyperflex.planning.whip.outcome import TipStrike, verify_whip
from hyperflex.planning.whip.search import (
    WhipFeasibility,
    WhipMap,
    WhipSearch,
    build_whip_map,
    check_whip_feasibility,
    pivot_distance,
)
from hyperflex.planning.whip.tip_target import TipTarget
from hyperflex.planning.whip.whip_plan import WhipPlan
from hyperflex.progress import progress_bar
from hyperflex.simulation import Deadline

MAPPING, SEARCHING = 0.4, 0.8  # fractions of the time for the map, and after which whips are only verified
TIME_BUDGET, PERIODS = 30.0, 3.0  # s; swing periods within which the tip strikes by default
DIRECT = 8  # peaks of the map that are aimed as they are
READY, GENERATIONS = 0.06, 16  # m, cost below which a swing is aimed; generations of a search before
PLANS = 3  # whips that meet the target, of which the least uncertain one that succeeds is taken
MAX_MISS = 1e-3  # m
# m. A rope with finer links is another model of the same rope, and no plan can meet both within MAX_MISS. Its miss
# counts if it is more than a few times that, and more than the standard deviation of the place.
MAX_FINER_MISS = 3.0 * MAX_MISS
FINER = 2  # pieces of each link in the second verification


class Verified(NamedTuple):
    """A whip with its outcomes, with the links as planned and half as long; the message tells why it fails."""

    aim: AimedPeak
    outcome: TipStrike | None
    finer_outcome: TipStrike | None
    message: str


class WhipPlanner:
    """Aims swings of a map until enough of them meet the target or the `time_budget`, s without compiling, is over."""

    def __init__(
        self, whip_map: WhipMap, target: TipTarget, time_budget: float, seed: int, threads: int | None
    ) -> None:
        self.whip_map, self.target, self.time_budget = whip_map, target, time_budget
        self.seed, self.threads = seed, threads
        self.cast_setup = whip_map.cast_setup
        self.finer = replace(self.cast_setup, rope=divided(self.cast_setup.rope, FINER))
        self.clock, self.runs = Clock(), 0
        self.end = Deadline(math.inf, lambda: self.time_budget - self.clock.spent)
        self.aims: list[AimedPeak] = []
        self._best: Verified | None = None
        self._unverified = "interrupted before it was verified"

    def left(self) -> float:
        """Return the time that is left for the search, s."""
        return SEARCHING * self.time_budget - self.clock.spent

    def run(self, report: Callable[[], None] | None) -> None:
        """Aim until there are enough whips, or no time is left; `report` is called after each."""
        candidates = self.whip_map.candidates(self.target)
        for found in candidates[:DIRECT]:
            if self.add(aim_peak(self.cast_setup, self.target, found, self.left), report):
                return
        for number, found in enumerate(candidates):
            search = WhipSearch(self.cast_setup, self.target, found, self.seed + number, self.threads)
            for _ in range(GENERATIONS):
                if search.best.cost < READY or self.left() < 0.0:
                    break
                search.step()
            self.runs += search.runs
            if self.add(aim_peak(self.cast_setup, self.target, search.best, self.left), report):
                return

    def add(self, aim: AimedPeak | None, report: Callable[[], None] | None) -> bool:
        """Keep a whip; return whether there are enough, or no time is left."""
        if aim is not None:
            self.aims.append(aim)
            self.aims.sort(key=self.rank)
        if report is not None:
            report()
        return self.left() < 0.0 or sum(self.rank(one)[0] == 0.0 for one in self.aims) >= PLANS

    def rank(self, aim: AimedPeak) -> tuple[float, float]:
        """By how much a whip fails, then how uncertain it is; less is better."""
        miss = float(np.hypot(*(aim.place - self.target.point)))
        beyond = max(0.0, abs(float(self.target.angle_error(aim.velocity))) - self.target.angle_tolerance)
        slow = max(0.0, 1.0 - aim.speed / self.target.least_speed)
        return max(0.0, miss - MAX_MISS) + beyond + slow, aim.position_std

    def verify(self) -> None:
        """Verify the best whip, and while none succeeds those after it that meet the target by the search.

        The best is then the first that succeeds, else the first.
        """
        for number, aim in enumerate(self.aims[:PLANS]):
            if number and self.rank(aim)[0] > 0.0:
                break
            try:
                seen = verify_both(self.cast_setup, self.finer, self.target, aim, self.end)
            except OutOfTime:
                self._unverified = "the time budget ended before it was verified"
                break
            if number == 0 or not seen.message:
                self._best = seen
            if not seen.message:
                break

    @property
    def best(self) -> Verified | None:
        """The best whip, verified or not yet; None if no whip was found."""
        if self._best is None and self.aims:
            return Verified(self.aims[0], None, None, self._unverified)
        return self._best


def verify_both(
    cast_setup: CastSetup, finer: CastSetup, target: TipTarget, aim: AimedPeak, end: Deadline | None = None
) -> Verified:
    """Simulate a whip at a tight tolerance, with the links as planned and with those of a finer set-up.

    Raises OutOfTime at the `end`.
    """
    motion = aim.strokes.motion(cast_setup.limits)
    outcome, again = (verify_whip(each, target, motion, aim.t, time_budget=end) for each in (cast_setup, finer))
    return Verified(aim, outcome, again, failure(cast_setup, outcome, again, aim.position_std))


def failure(cast_setup: CastSetup, outcome: TipStrike | None, finer: TipStrike | None, position_std: float) -> str:
    """Return why a whip fails, empty if it succeeds; `position_std` is the standard deviation of its place, m."""
    if outcome is None:
        return "in the verified run the tip's speed has no peak there"
    if outcome.message:
        return outcome.message
    if outcome.miss > MAX_MISS:
        return f"the tip misses the target by {1e3 * outcome.miss:.1f} mm"
    if asked := _too_much(cast_setup, outcome):
        return asked
    if finer is None:
        return "with links of half the length the tip's speed has no peak there"
    if refused := finer.refused or _too_much(cast_setup, finer):
        return f"with links of half the length {refused}"
    allowed = max(MAX_FINER_MISS, position_std)
    if finer.miss > allowed:
        return f"with links of half the length it misses by {1e3 * finer.miss:.1f} mm, {1e3 * allowed:.1f} allowed"
    return ""


def _too_much(cast_setup: CastSetup, outcome: TipStrike) -> str:
    """Return that a whip asks more of the motor than it gives; empty if it does not."""
    if outcome.torque <= cast_setup.limits.torque:
        return ""
    return f"it asks {outcome.torque:.3g} N m of a motor that gives {cast_setup.limits.torque:.3g}"


@interruptible(WhipPlan)
def plan_whip(
    rope: Rope,
    arm: Arm,
    point: npt.ArrayLike,
    direction: npt.ArrayLike | None = None,
    limits: MotorLimits | None = None,
    *,
    least_speed: float = 5.0,
    angle_tolerance: float = math.radians(20.0),
    clearance: float = 0.0,
    time_limit: float | None = None,
    time_budget: float = TIME_BUDGET,
    skip_feasibility: bool = False,
    whip_map: WhipMap | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
) -> WhipPlan:
    """Plan how an arm whips its rope so that the tip passes a point at a peak of its speed.

    Parameters
    ----------
    rope, arm, limits, clearance, skip_feasibility, seed, threads, progress
        As of :func:`hyperflex.plan_cast`.
    point : (2,) array_like
        Place of the tip at the peak, m.
    direction : (2,) array_like, optional
        Direction of the tip's velocity there: a vector of any length but 0. By default any direction.
    least_speed : float
        Of the tip, m/s.
    angle_tolerance : float
        Greatest angle between the tip's velocity and the direction, rad; not used without a direction.
    time_limit : float, optional
        Time within which the tip must be there, s; by default that of the map if one is given, else three periods of
        the rope's swing.
    time_budget : float
        Time by the clock for map, search and verifications, s, without compiling.
    whip_map : WhipMap, optional
        Of the same rope, arm, limits and time, from :func:`build_whip_map`; by default it is built, which takes some
        seconds.

    Returns
    -------
    WhipPlan

    Raises
    ------
    Interrupted
        By Ctrl-C. Its ``partial`` is the best plan until then; what was not verified before is not verified any more.
    InvalidInput
        If an argument is out of range or of another class, or a link's centre of mass is not in its middle: the second
        verification cuts it in two.
    """
    clock = Clock()
    target = TipTarget.at(point, direction, least_speed, angle_tolerance)
    time_budget = checks.number("time_budget", time_budget, sign="positive", unit="s")
    seed = checks.count("seed", seed, least=0)
    if time_limit is not None:
        time_limit = checks.number("time_limit", time_limit, sign="positive", unit="s")
    cast_setup = replace(_cast_setup(rope, arm, limits, time_limit, whip_map), clearance=clearance)

    distance = pivot_distance(cast_setup, target)
    known = WhipFeasibility(distance, math.inf, "interrupted before the map of swings was made")
    planner = None
    with caught() as stop, progress_bar(0.0, time_budget, progress, "planning") as report:
        if whip_map is None:
            whip_map = build_whip_map(cast_setup, threads=threads, left=lambda: MAPPING * time_budget - clock.spent)
        known = check_whip_feasibility(whip_map, target)
        if math.isfinite(known.cost) and (known.feasible or skip_feasibility):
            left = max(0.0, time_budget - clock.spent)
            planner = WhipPlanner(replace(whip_map, cast_setup=cast_setup), target, left, seed, threads)
            planner.run(None if report is None else lambda: report(min(clock.spent, time_budget)))
            planner.verify()
    found: dict[str, Any] = {"seconds": clock.elapsed, "interrupted": stop.met}
    if planner is None:
        return stop.deliver(WhipPlan(cast_setup, target, known, message=known.message, **found))
    message = "interrupted before any whip was found" if stop.met else "no peak of the tip's speed comes near it"
    if (best := planner.best) is not None:
        aim, outcome, finer, message = best
        found |= {"strokes": aim.strokes, "position_std": aim.position_std, "outcome": outcome, "finer_outcome": finer}
    return stop.deliver(WhipPlan(cast_setup, target, known, message=message, runs=planner.runs, **found))


def _cast_setup(
    rope: Rope, arm: Arm, limits: MotorLimits | None, time_limit: float | None, whip_map: WhipMap | None
) -> CastSetup:
    """Return the set-up of the map, if there is one, which must be the one that is asked for."""
    checks.instance("rope", rope, Rope)
    if whip_map is None:
        usual = PERIODS * swing_period(rope)
        return CastSetup(rope, arm, limits or MotorLimits(), usual if time_limit is None else time_limit)
    if limits is not None:
        checks.instance("limits", limits, MotorLimits)
    made = checks.instance("whip_map", whip_map, WhipMap).cast_setup
    if made.rope != rope or made.arm != arm or limits not in (None, made.limits) or time_limit not in (None, made.time):
        raise InvalidInput(
            "map was made for another rope, arm, motor or time",
            fix="Make one: build_whip_map(CastSetup(rope, arm, limits, time_limit))",
        )
    return made
