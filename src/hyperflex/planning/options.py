"""What a user may vary in a plan besides rope, arm and target: limits, criteria, conditions, search.

Each field has its unit, range and reason in its metadata: ``help`` and ``unit`` also make the command line's options.
"""

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState
from hyperflex.model import Obstacle, Peg, checked_obstacles
from hyperflex.options import check, option

LEAST_TURNS = 0.5  # which a rope that only lies over a peg has
MEAN_TIME = 0.1  # s over which forces are averaged: those of single steps jump


def checked_behind(pegs: object) -> tuple[Peg, ...]:
    """Return the pegs of a sequence as a tuple; InvalidInput if they are something else, or rotate."""
    found = list[Peg]()
    for each in checked_obstacles(pegs, "behind"):
        if not isinstance(each, Peg) or each.turns:
            allowed = "fixed pegs: hyperflex.Peg(x, y, radius, mu)"
            raise InvalidInput("a rope is led behind fixed pegs alone", got=each, allowed=allowed)
        found.append(each)
    return tuple(found)


@dataclass(frozen=True)
class WindCriteria:
    """When a rope counts as wound round a target.

    Parameters
    ----------
    turns : float
        Minimum turns about the target, from the arm's tip to the rope's end; at most 20 and more than 0.5, which a rope
        that only lies over a peg has.
    contact : float
        Least angle of the target that the rope covers, rad.
    settle : float
        Time from the motion's end, s, up to 10, after which the rope is watched for `watch`. The end is the arm's stop,
        or that of the rest after it if the plan has one.
    watch : float
        Time for which the rope must stay wound and hold, s, at least MEAN_TIME: forces are averaged over it.
    max_slip : float
        Greatest slip on the target in that time, and in a simulated tug, m.
    holding_force : float
        Pull that the wound rope must withstand, N, by a simulated tug.
    max_sideways : float
        Maximum distance from the plane at the rope's first touch, m, from the touching link to the rope's end, if the
        rope begins out of the plane by `tilt`: half of the required width of the peg. inf: not checked.
    tilt : float
        Angle of the rope out of the plane of the swing at the start, rad, at most 5 degrees.
    behind : sequence of Peg
        Fixed pegs that the rope must run behind on its way from the arm to the target: in the end it touches each of
        them between the arm and its first contact with the target. Not with an uncertainty or a holding force.

    Raises
    ------
    InvalidInput
        If a number is out of range, or `behind` contains anything but fixed pegs.
    """

    turns: float = option(1.25, "Least turns about the target, from the arm's tip to the rope's end.")
    contact: float = option(
        0.0, "Least angle of the target that the rope must cover.", "rad", sign="nonnegative", shown="none"
    )
    settle: float = option(1.0, "Time from the motion's end after which the rope is watched.", "s", sign="nonnegative")
    watch: float = option(2.0, "Time for which the rope must stay wound and hold.", "s", sign="positive")
    max_slip: float = option(5e-3, "Greatest slip on the target in that time.", "m", sign="positive")
    holding_force: float = option(0.0, "Pull that the wound rope must withstand.", "N", sign="nonnegative")
    max_sideways: float = option(
        math.inf,
        "Greatest distance of the rope from the plane at its first touch.",
        "m",
        sign="positive",
        infinite=True,
        shown="any",
    )
    tilt: float = option(
        math.radians(1.0), "Angle of the rope out of the plane at the start.", "rad", sign="nonnegative"
    )
    behind: tuple[Peg, ...] = ()

    def __post_init__(self) -> None:
        check(self, "")
        if not LEAST_TURNS < self.turns <= 20.0:
            allowed = f"more than {LEAST_TURNS:g} turns, up to 20"
            raise InvalidInput("turns are not those of a wound rope", got=self.turns, allowed=allowed)
        if self.settle > 10.0:
            raise InvalidInput("settle is longer than a rope takes to come to rest", got=self.settle, allowed="<= 10 s")
        check_tilt(self.tilt)
        if self.watch < MEAN_TIME:
            allowed = f">= {MEAN_TIME:g} s, over which forces are averaged"
            raise InvalidInput("watch is too short to measure a hold", got=self.watch, allowed=allowed)
        object.__setattr__(self, "behind", checked_behind(self.behind))
        if self.holding_force > 0.0:
            refuse_behind(self.behind, "a holding force")


def check_tilt(tilt: float) -> None:
    """Raise InvalidInput for an angle out of the plane, rad, that is too large for the first order."""
    if tilt > math.radians(5.0):
        allowed = "up to 5 degrees (0.0873 rad): beyond, the first order is more than 17 % off"
        raise InvalidInput("tilt is not small", got=f"{tilt:g} rad", allowed=allowed)


def refuse_behind(pegs: Sequence[Peg], what: str) -> None:
    """Raise InvalidInput if there are pegs that the rope must run behind, because `what` does not support them."""
    if pegs:
        words = f"{what} takes no pegs that the rope is to run behind"
        raise InvalidInput(words, got=f"{len(pegs)} pegs", fix="Omit behind")


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of a plan.

    Parameters
    ----------
    time_limit : float, optional
        Time within which the goal must be reached, s: the strike, the tip's pass or its entry. By default a number of
        periods of the rope's swing: five of a cast and more if the target is high, three of a whip, two of an
        insertion.
    clearance : float
        Minimum distance of the rope from its own arm, the motor's shaft and obstacles in verified runs, m, >= 0; -inf
        allows the rope to pass in front of arm and shaft.
    obstacles : sequence of Peg, Wall, Ground
        Obstacles that the rope must not touch: a wall, the floor, a person.
    side : {-1, 0, 1}
        Side of the arm at the start, left or right; 0 lets the planner choose.
    state0 : RopeState, optional
        State of a rope that swings while the arm is at rest, as a tracker measures it: angles, rad, and rates, rad/s,
        at a time `t` <= 0, s, before the motion begins at 0. It needs a `side`; only casts support it. By default the
        rope hangs at rest.
    """

    time_limit: float | None = option(
        None, "Time within which the goal must be reached.", "s", shown="some periods of the rope's swing"
    )
    clearance: float = option(
        0.0, "Least distance of the rope from its arm, the shaft and obstacles; -inf: no limit for arm and shaft.", "m"
    )
    obstacles: tuple[Obstacle, ...] = ()
    side: int = option(0, "Side of the arm at the start: -1 left, 1 right, 0 either.")
    state0: RopeState | None = None

    def __post_init__(self) -> None:
        if self.time_limit is not None:
            time = checks.number("time_limit", self.time_limit, sign="positive", unit="s")
            object.__setattr__(self, "time_limit", time)
        if self.clearance != -math.inf:
            clearance = checks.number("clearance", self.clearance, sign="nonnegative", unit="m")
            object.__setattr__(self, "clearance", clearance)
        object.__setattr__(self, "obstacles", checked_obstacles(self.obstacles, "obstacles"))
        if self.side not in (-1, 0, 1) or (self.state0 is not None and not self.side):
            allowed, fix = "-1 (left), 1 (right), or 0 for a rope that hangs", "Give the side of the arm"
            raise InvalidInput("side of the arm at the start", got=self.side, allowed=allowed, fix=fix)
        if self.state0 is not None:
            if not isinstance(self.state0, RopeState):
                raise InvalidInput("state0 is no rope state", got=self.state0, allowed="hyperflex.RopeState(t, q, qd)")
            t = checks.number("state0.t", self.state0.t, unit="s")
            if t > 0.0:
                allowed, fix = "t <= 0 s", "Count t from the motion's begin"
                raise InvalidInput("state0 is after the motion's begin", got=t, allowed=allowed, fix=fix)


@dataclass(frozen=True, eq=False)
class SearchOptions:
    """Options of the search for a plan.

    Parameters
    ----------
    seed : int
        Seed of the random numbers. The number of candidates searched in a given time depends on the machine, so the
        same seed may give another plan: save the plan, not the seed.
    threads : int, optional
        Threads of the search, by default one per processor.
    skip_feasibility : bool
        Search even for a target that the feasibility check calls out of reach, unless geometry rules it out.
    fallback : bool
        If a cast fails: plan for the nearest targets until a plan succeeds, at most three, each with the same time
        budget. Otherwise the fallback target is only expected to be feasible.
    progress : bool
        Show a progress bar.
    start_from : sequence of CastPlan
        Plans for targets near by, for the same rope and arm, whose moves are tried first.
    executor : concurrent.futures.Executor, optional
        Where many targets are planned, or scenarios simulated: processes, or other machines
        (``docs/how-to/many-machines.md``). Give ``threads=1`` where workers share a machine.
    chunk_size : int, optional
        Targets, or scenarios, that a worker takes at once.
    improve : float
        A plan that succeeds without a margin is improved for this fraction of the time used so far; a part of the
        margin reduces this time in proportion.
    speeds : tuple of float
        Speeds of strokes, relative to the motor's, that are tried in turn: slow ones make swings more predictable.
    width, siblings : int
        Number of swings from each side that are continued by a stroke, and how many of them may differ only in the last
        stroke.
    rests : int
        Rests that are tried after each stroke.
    longest_rest : float
        The longest of them, in periods of the rope's swing.
    stroke : float
        Full stroke, in half turns; later passes try shorter ones, too.
    watched : float
        Periods after a stroke in which a strike is searched.
    back : int
        Number of strokes before the first strike at which the next pass begins: earlier ones pump the rope up.
    pieces : int
        Pieces of each link in the checks with shorter links; thirds found more errors than halves.
    coarse : float
        Longest link in contact, in radii of the target and the rope: longer ones are divided.
    deviations : (usual, most)
        Deviation of the rope with shorter links after a stroke, root mean square in rope lengths. Swings count as
        predictable up to the usual deviation, or up to twice that of the most predictable swing, if this is at most
        `most`.
    batch : int
        Swings that are tried in contact at once.
    finishes : int
        Last moves that are tried together for a swing that winds the rope, but does not keep it wound with the first
        one.
    nearly : float
        Turns, relative to the required ones, from which moves are varied before others are tried.
    members, parents : int
        Varied moves per generation, and the number of candidates from which they are made; 0 members: none.
    spread : float
        Largest standard deviation of varied strokes, in half turns, and rests, in periods.
    scenarios : int
        Sampled scenarios in which a robust plan is verified.
    """

    seed: int = option(0, "Seed of the search's random numbers.", sign="nonnegative")
    threads: int | None = option(None, "Threads that the search may use. [default: one a processor]")
    skip_feasibility: bool = option(False, "Search even if the feasibility check calls the target out of reach.")
    fallback: bool = option(False, "If the plan fails, plan for the nearest targets until one succeeds.")
    progress: bool = option(False, "Show a progress bar.")
    start_from: Sequence[Any] = ()
    executor: Executor | None = None
    chunk_size: int | None = None
    improve: float = option(0.25, "Time to improve a plan, over the time to find it.", sign="nonnegative")
    speeds: tuple[float, ...] = option((1.0, 0.7, 0.5), "Speeds of strokes, over the motor's.", sign="positive")
    width: int = option(12, "Swings from each side that are continued.", sign="positive")
    siblings: int = option(2, "How many of them may differ in the last stroke alone.", sign="positive")
    rests: int = option(5, "Rests tried after each stroke.", sign="positive")
    longest_rest: float = option(0.6, "The longest rest, in periods of the rope's swing.", sign="nonnegative")
    stroke: float = option(0.95, "Full stroke, in half turns.", sign="positive")
    watched: float = option(0.7, "Periods after a stroke in which a strike is searched.", sign="positive")
    back: int = option(3, "Strokes before the first strike at which the next pass begins.", sign="positive")
    pieces: int = option(3, "Pieces of each link in the checks with shorter links.", sign="positive")
    coarse: float = option(
        2.0, "Longest link in contact, in radii of the target and the rope.", sign="positive", infinite=True
    )
    deviations: tuple[float, float] = option(
        (0.005, 0.02), "Usual and greatest deviation of shorter links.", sign="nonnegative", infinite=True
    )
    batch: int = option(8, "Swings tried in contact at once.", sign="positive")
    finishes: int = option(3, "Last moves tried at once after the first.", sign="positive")
    nearly: float = option(0.8, "Turns over those required from which moves are varied first.", sign="nonnegative")
    members: int = option(16, "Varied moves of a generation.", sign="nonnegative")
    parents: int = option(4, "Candidates that varied moves are made from.", sign="positive")
    spread: float = option(0.15, "Greatest standard deviation of varied moves.", sign="nonnegative")
    scenarios: int = option(32, "Sampled scenarios that verify a robust plan.", sign="positive")

    def __post_init__(self) -> None:
        check(self, "")
        if self.threads is not None:
            object.__setattr__(self, "threads", checks.count("threads", self.threads, most=checks.MOST_THREADS))
        near = tuple(checks.sequence("start_from", self.start_from, "a sequence of CastPlan"))
        for each in near:
            if getattr(each, "kind", None) != "cast":
                raise InvalidInput("start_from contains something else", got=each, allowed="a sequence of CastPlan")
        object.__setattr__(self, "start_from", near)
        if max(self.speeds) > 1.0:
            raise InvalidInput("speeds exceed the motor's", got=self.speeds, allowed="more than 0, up to 1")
