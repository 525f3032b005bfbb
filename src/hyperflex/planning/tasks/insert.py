"""Insertions: the tip goes through a slot between two walls, to a depth, and the rope touches neither."""

import math
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import DEFAULT_CONTACT_STEP, DEFAULT_TOL, Arm, MotorLimits, Peg, Placed, Rope, Wall, with_links
from hyperflex.motion import Motion
from hyperflex.options import check as check_options
from hyperflex.options import option
from hyperflex.planning.clearance import obstacle_clearance, sampled_obstacle_gaps
from hyperflex.planning.ensemble import STREAM, SuccessProbability, count_successes
from hyperflex.planning.moves import Moves
from hyperflex.planning.options import Conditions, SearchOptions
from hyperflex.planning.outcome import excess_torque, run_figures
from hyperflex.planning.planner import Candidate
from hyperflex.planning.problem import Problem
from hyperflex.planning.tasks.tip import (
    OPTIONS,
    Aim,
    Flights,
    TipEvent,
    TipFeasibility,
    TipOutcome,
    TipPlan,
    TipTask,
    plan_tip,
    random_swings,
    sample_times,
    tip_problem,
    touches,
    verified_run,
)
from hyperflex.planning.uncertainty import Uncertainty
from hyperflex.planning.verification import Accuracy, at_limits, limit_bend
from hyperflex.trajectory import Trajectory


@dataclass(frozen=True)
class Slot(Placed):
    """A gap between two thin walls in one line, through which the tip must move.

    Parameters
    ----------
    x, y : float
        Middle of the gap, m.
    direction : float
        The way in, across the walls: rad, counterclockwise from the x axis.
    width : float
        Of the gap, m, > 0.
    depth : float
        Depth beyond the walls that the tip must reach, m, > 0.
    wall : float
        Length of each wall, m, > 0.
    tube : float
        Length of walls that continue inwards from both edges of the gap, m, >= 0: the tip enters a tube. 0: none.
    max_speed : float
        Greatest speed of the tip at that depth, m/s, > 0; infinite for any.
    touching : bool
        Whether the rope may touch the walls.

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign.

    Examples
    --------
    >>> from hyperflex.planning import Slot
    >>> [round(wall.x, 3) for wall in Slot(0.2, -2.0, direction=-1.5708, width=0.02, wall=0.1).walls]
    [0.21, 0.19]
    """

    x: float = option(MISSING, "middle of the gap", "m")
    y: float = option(MISSING, "middle of the gap", "m")
    direction: float = option(MISSING, "the way in, across the walls: 0 is +x, pi/2 is up", "rad")
    width: float = option(0.02, "width of the gap: three diameters of the rope or more", "m", sign="positive")
    depth: float = option(0.05, "how far beyond the walls the tip must come", "m", sign="positive")
    wall: float = option(0.1, "length of each wall", "m", sign="positive")
    tube: float = option(
        0.0, "length of the tube: walls that run inwards from the gap's edges", "m", sign="nonnegative"
    )
    max_speed: float = option(
        math.inf, "greatest speed of the tip at that depth", "m/s", sign="positive", infinite=True, shown="any"
    )
    touching: bool = option(False, "the rope may touch the walls")

    def __post_init__(self) -> None:
        check_options(self, "slot")

    @property
    def axes(self) -> Array:
        """Unit vectors (2, 2): the way in, and across it to its left."""
        c, s = np.cos(self.direction), np.sin(self.direction)
        return np.array([[c, s], [-s, c]])

    @property
    def walls(self) -> tuple[Wall, ...]:
        """The walls: that to the left of the way in, that to the right, and those of the tube, if there is one."""
        inwards, left = self.axes
        edges = [self.point + side * 0.5 * self.width * left for side in (1.0, -1.0)]
        pairs = [(edge, side * self.wall * left) for edge, side in zip(edges, (1.0, -1.0), strict=True)]
        pairs += [(edge, self.tube * inwards) for edge in edges if self.tube > 0.0]
        return tuple(Wall(*edge.tolist(), *(edge + way).tolist()) for edge, way in pairs)

    def check_width(self, rope: Rope) -> None:
        """Raise InvalidInput if the gap is narrower than three diameters of a rope."""
        if self.width < (narrowest := 6.0 * rope.radius) * (1.0 - 1e-9):
            raise InvalidInput(
                "slot width is too narrow for the rope",
                got=self.width,
                allowed=f"{narrowest:g} m, 3 diameters of the rope, or more",
                fix="Give a wider slot, in m, or a thinner rope",
            )

    def frame(self, points: Array) -> tuple[Array, Array]:
        """Return depth beyond the walls (...) and offset to the left of the way in (...) of points (..., 2), m."""
        out = (points - self.point) @ self.axes.T
        return out[..., 0], out[..., 1]


class Entry(NamedTuple):
    """A way of the tip beyond the line of a slot's walls, and back, in a run.

    Row `begin` is the first beyond, at row `end` the tip is as deep as required, or else deepest, and at `last` it is
    back, or the run has ended. `t_enter` and `t`, s, are the times of the first two; `depth`, m, is the greatest,
    `speed`, m/s, that of the tip at `t`. `offsets` (3,), m, are those of the rope on the line of the walls with the tip
    at none, half and all of the required depth; with a tube followed by the tip's own (5,). `gaps` (T,), m, are least
    distances of all the rope but what follows the tip through from the walls whose line it crosses, infinite where it
    does not.
    """

    begin: int
    end: int
    last: int
    t_enter: float
    t: float
    offsets: Array
    depth: float
    speed: float
    gaps: Array


def find_entries(slot: Slot, radius: float, t: Array, joints: Array) -> list[Entry]:
    """Find how the tip goes through a slot in a run by its joints (T, n + 1, 2), m, at times t (T,), s.

    `radius` is the rope's, m. A tip that begins beyond the walls, or comes back to a rope that hangs there, does not
    enter.
    """
    depth, offset = slot.frame(joints)
    tip, beyond = depth[:, -1], depth > 0.0
    edges = np.diff(beyond[:, -1].astype(int), prepend=beyond[0, -1], append=0)
    begins = np.flatnonzero(edges > 0).tolist()
    if not begins or not np.isfinite(joints).all():  # a flight that failed
        return []
    row, link = np.nonzero(beyond[:, 1:] != beyond[:, :-1])  # where links cross the line of the walls
    (d0, d1), (u0, u1) = ((each[row, link], each[row, link + 1]) for each in (depth, offset))
    at = u0 + d0 / (d0 - d1) * (u1 - u0)
    past = np.abs(at) - 0.5 * slot.width  # the gap's edge
    gap = np.abs(d1 - d0) / np.hypot(d1 - d0, u1 - u0) * np.maximum(-past, past - slot.wall) - radius
    follows = np.append(row[1:] != row[:-1], True)[: row.size] & beyond[row, -1]  # next to a tip that is beyond
    mouth = np.full(t.size, np.nan)
    mouth[row[follows]] = at[follows]
    found, levels = list[Entry](), slot.depth * np.array([0.0, 0.5, 1.0])
    for begin in begins:
        last = begin + int(np.argmin(np.append(beyond[begin:, -1], False)))
        way = np.minimum(tip[begin:last], slot.depth)
        end = begin + int(way.argmax())
        rows, through = slice(begin, end + 1), slice(begin - 1, end + 1)
        reached = np.maximum.accumulate(tip[through])
        t_enter, enters = (float(np.interp(0.0, tip[through][:2], each[through][:2])) for each in (t, offset[:, -1]))
        reached[0] = 0.0
        crossing = np.append(enters, mouth[rows])
        if not np.isfinite(crossing).all():
            continue
        offsets = np.interp(levels, reached, crossing)
        if slot.tube > 0.0:
            offsets = np.append(offsets, np.interp(levels[1:], reached, np.append(enters, offset[rows, -1])))
        others, gaps = ~(follows & (row >= begin)), np.full(t.size, np.inf)
        np.minimum.at(gaps, row[others], gap[others])
        when = float(np.interp(slot.depth, reached, np.append(t_enter, t[rows])))
        speed = math.dist(joints[end, -1], joints[end - 1, -1]) / float(t[end] - t[end - 1])
        found.append(Entry(begin, end, last, t_enter, when, offsets, float(tip[begin:last].max()), speed, gaps))
    return found


def next_entry(slot: Slot, radius: float, t: Array, joints: Array, near: float) -> Entry | None:
    """Return how the tip goes through the gap next to time `near`, s, in a run; None if it does not."""
    found = find_entries(slot, radius, t, joints)
    through = [each for each in found if abs(each.offsets[0]) < 0.5 * slot.width]
    return min(through, key=lambda each: abs(each.t - near), default=None)


@dataclass(frozen=True, eq=False, kw_only=True)
class InsertOutcome(TipOutcome):
    """How the tip goes through a slot in a simulated run with its walls; the rest as of :class:`TipOutcome`.

    Attributes
    ----------
    t_enter, t : float
        When the tip comes between the walls, and when it is as deep as required, or else deepest, s.
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
        """Return what matters most to whoever carries the moves out, in figures with units."""
        return (
            f"{1e3 * self.depth:.0f} mm deep, at {self.t:.2f} s with {self.speed:.2f} m/s, "
            f"{1e3 * self.wall_clearance:.1f} mm clear of the walls, {self.torque:.3g} N m"
        )


@dataclass(frozen=True, eq=False, repr=False)
class InsertPlan(TipPlan):
    """A planned insertion, or why there is none.

    Attributes
    ----------
    outcome : InsertOutcome or None
        In a run with the walls.
    finer_outcome : InsertOutcome or None
        With more, shorter links and a tighter tolerance.
    position_std : float
        Standard deviation of the point where the rope crosses the gap, m.
    decided
        As of :class:`hyperflex.planning.tasks.tip.TipPlan`.
    problem, target, feasibility, moves, message, runs, seconds, interrupted, success_probability
        As of :class:`hyperflex.planning.plan.Plan`.
    """

    kind: ClassVar[str] = "insert"
    target: Slot
    feasibility: TipFeasibility
    outcome: InsertOutcome | None = None
    finer_outcome: InsertOutcome | None = None


MARGIN = 0.35  # part of the gap on each side of the rope that remains free, unless it may touch the walls
CLOSER = 2e-4  # m, by which verified runs state distances as smaller than they are
NARROW = 5e-4  # m from the walls, below which both verified runs must agree: closer, a third run may touch


@dataclass(frozen=True)
class InsertCosts:
    """Costs, m, of an entry besides the offset of the rope from the middle of the gap.

    Per m of what moves less easily than all of an entry to one side (change of the offset, missing depth, depth of
    other parts of the rope in walls), per second, and per fraction by which the tip is too fast.
    """

    hard: float = 2.5
    time: float = 0.004  # of equal entries the sooner one is less uncertain
    speed: float = 0.03  # swings at half the speed come first
    blocked: float = 3.0  # per m that the rope lies in an obstacle


class InsertTask(TipTask):
    """Bring the tip through a slot.

    Parameters
    ----------
    problem : Problem
    slot : Slot
    uncertainty : Uncertainty, optional
    samples : int
        Scenarios of the success probability.
    seed : int
    """

    close, ready, improve = 2e-3, -0.02, 4.0

    def __init__(
        self, problem: Problem, slot: Slot, uncertainty: Uncertainty | None = None, samples: int = 100, seed: int = 0
    ) -> None:
        places = slot.point + np.array([[0.0], [slot.depth]]) * slot.axes[0]
        super().__init__(problem, slot, places, finer_rope(problem.rope), seed)
        self.slot, self.given, self.samples = slot, uncertainty or usual_uncertainty(), samples
        self.room = 0.5 * slot.width - problem.rope.radius
        self.allowed = self.room * (1.0 if slot.touching else 1.0 - MARGIN)

    def swing(self, budget: Budget) -> tuple[list[Candidate], float, str]:
        """Return the swings after which the tip goes through near to the slot."""
        swings = self.scored(random_swings(self.problem, OPTIONS.swings, self.slot.walls), budget)
        far = "out of reach: in no swing does the tip go through near to it, in that direction"
        return swings, -swings[0].score if swings else math.inf, far

    def score(self, flights: Flights) -> list[tuple[float, float]]:
        """Return cost, m, and time, s, of the cheapest entry of each flight: see :class:`InsertCosts`."""
        costs, slot, found = InsertCosts(), self.slot, list[tuple[float, float]]()
        for joints, blocked in zip(flights.joints, flights.blocked(self.problem), strict=True):
            best = (math.inf, math.nan)
            for each in find_entries(slot, self.problem.rope.radius, flights.t, joints):
                low, high = float(each.offsets.min()), float(each.offsets.max())
                struck = max(0.0, -float(each.gaps[: each.end + 1].min()))
                hard = high - low + max(0.0, slot.depth - each.depth) + struck
                cost = 0.5 * abs(low + high) + costs.hard * hard + costs.time * each.t
                cost += costs.speed * max(0.0, each.speed / slot.max_speed - 1.0)
                best = min(best, (cost + costs.blocked * float(blocked[each.end]), each.t))
            found.append(best)
        return found

    def event(self, flights: Flights, m: int, near: float) -> TipEvent | None:
        """Return the way through the slot in flight m that ends next to time `near`, s."""
        slot, found = self.slot, find_entries(self.slot, self.problem.rope.radius, flights.t, flights.joints[m])
        if not found:
            return None
        each = min(found, key=lambda one: abs(one.t - near))
        lacks = [np.abs(each.offsets).max() - self.allowed, slot.depth - each.depth]
        lacks.append(1.02 * each.speed / slot.max_speed - 1.0)
        residuals, place = [*each.offsets, min(0.0, each.depth - 1.1 * slot.depth)], each.offsets
        return TipEvent(each.t, each.end, residuals, lacks, place / np.sqrt(place.size), [np.minimum(each.gaps, 1.0)])

    def uncertainty(self, aim: Aim) -> float:
        """Return the standard deviation of the rope's way through the gap over the room that it leaves on one side."""
        room = self.room - float(np.abs(aim.place).max()) * math.sqrt(aim.place.size)
        return math.hypot(aim.std, self.given.place) / max(room, 1e-9)

    def simulate(self, problem: Problem, one: Candidate, budget: Budget) -> InsertOutcome | None:
        """Return how the tip goes through the slot in a run with the walls; see :func:`verify_insert`."""
        tighter = 5.0 if problem is self.finer else 1.0
        motion = one.moves.motion(problem.limits)
        return verify_insert(problem, self.slot, motion, one.t, tighter=tighter, budget=budget)

    def failure(self, one: Candidate, outcome: InsertOutcome | None, first: InsertOutcome | None) -> str:
        """Return why an insertion fails: also if two runs disagree on whether a real rope touches the walls."""
        if outcome is None:
            return "the tip does not go through the slot"
        if outcome.message or first is None or self.slot.touching:
            return outcome.message
        given, now = first.wall_clearance, outcome.wall_clearance
        if min(given, now) >= min(NARROW, abs(given - now)):
            return ""
        return f"it passes {1e3 * now:.1f} mm, not {1e3 * given:.1f} mm, from the walls: it may touch them"

    def estimate(self, one: Candidate, budget: Budget) -> SuccessProbability:
        """Return the success probability; see :func:`estimate_insert_probability`."""
        given, options = (self.problem, self.slot, one.moves, one.t, self.given), SearchOptions(self.seed)
        return estimate_insert_probability(*given, samples=self.samples, time_budget=budget, options=options)


def finer_rope(rope: Rope, times: float = 2.5) -> Rope:
    """Return a rope cut into `times` as many links."""
    return with_links(rope, round(times * rope.n_links))


def verify_insert(
    problem: Problem,
    slot: Slot,
    motion: Motion,
    near: float,
    *,
    tighter: float = 1.0,
    budget: Budget | None = None,
) -> InsertOutcome | None:
    """Simulate a motion from rest with the walls of a slot; the tip is to be inside about time `near`, s.

    `tighter` divides the tolerance; above 1 the step in contact is halved. Returns None if the run fails, the rope lies
    on a wall from the start, or the tip does not go through; raises OutOfTime if it does not end within the budget.
    """
    step = DEFAULT_CONTACT_STEP * (0.5 if tighter > 1.0 else 1.0)
    accuracy = Accuracy(DEFAULT_TOL / tighter, step)
    run = verified_run(problem, motion, sample_times(near), budget, slot.walls, accuracy=accuracy)
    return None if run is None else evaluate_insert(problem, slot, run, near)


def evaluate_insert(problem: Problem, slot: Slot, run: Trajectory, near: float) -> InsertOutcome | None:
    """Evaluate how the tip goes through the slot next to time `near`, s, in a run; None if it does not."""
    entry = next_entry(slot, problem.rope.radius, run.t, run.joints, near)
    if entry is None:
        return None
    t, rows = entry.t, touches(run, (*slot.walls, *problem.obstacles))
    touched = rows[0][rows[1] < len(slot.walls)]
    last = min([entry.last, *([] if slot.touching else touched[touched >= entry.begin].tolist()), run.t.size - 1])
    deepest = float(slot.frame(run.tip[entry.begin : last + 1])[0].max())
    walls = obstacle_clearance(run, slot.walls, t)
    gap = min(walls.value, 0.0) if (touched <= entry.end).any() else walls.value
    place, velocity = (np.array([np.interp(t, run.t, each) for each in of.T]) for of in (run.tip, run.tip_velocity))
    speed, figures = float(np.hypot(*velocity)), run_figures(problem, run)
    message = figures["refused"]
    if not message and gap <= 0.0 and not slot.touching:
        message = f"the rope touches a wall at {min([walls.t, *run.t[touched[:1]]]):.2f} s"
    elif not message and deepest < slot.depth:
        message = f"the tip comes {1e3 * deepest:.1f} mm deep, {1e3 * slot.depth:g} mm required"
    elif not message and speed > slot.max_speed:
        message = f"the tip has {speed:.2f} m/s there, {slot.max_speed:g} allowed"
    return InsertOutcome(
        t_enter=entry.t_enter,
        t=t,
        place=place,
        velocity=velocity,
        depth=deepest,
        time_inside=float(run.t[last]) - entry.t_enter,
        wall_clearance=gap,
        message=message or excess_torque(problem, figures["torque"]),
        **figures,
    )


def usual_uncertainty() -> Uncertainty:
    """Return the uncertainty of a known rope on a motor that is nearly in time, with a slot nearly in its place."""
    return Uncertainty(length=0.0, mass=0.0, friction=0.0, mu=0.0, lag=0.0, timing=2e-3, place=2e-3)


def insert_scenarios(
    problem: Problem, slot: Slot, moves: Moves, uncertainty: Uncertainty, samples: int, seed: int | Sequence[int]
) -> list[tuple[Rope, Slot, Motion]]:
    """Return rope, with finer links, slot and motion of the arm in sampled scenarios.

    A peg in its gap represents the slot in the sampling.
    """
    peg, motion = Peg(slot.x, slot.y, 0.5 * slot.width), moves.motion(problem.limits)
    return [
        (finer_rope(each.rope), replace(slot, x=each.peg.x, y=each.peg.y), each.executed_motion(motion))
        for each in uncertainty.sample(samples, problem, peg, seed=seed)
    ]


@interruptible()
def estimate_insert_probability(
    problem: Problem,
    slot: Slot,
    moves: Moves,
    near: float,
    uncertainty: Uncertainty | None = None,
    *,
    samples: int = 100,
    time_budget: float | Budget | None = None,
    options: SearchOptions | None = None,
) -> SuccessProbability:
    """Estimate how often moves bring the tip through a slot to its depth without a touch, in sampled scenarios.

    Parameters
    ----------
    near : float
        When the tip is inside as planned, s.
    uncertainty : Uncertainty, optional
        By default the slot is 2 mm off and each move 2 ms (standard deviations), and the rope as planned.
    samples, time_budget, options
        As of :func:`hyperflex.planning.estimate_success_probability`.

    Returns
    -------
    SuccessProbability

    Notes
    -----
    Scenarios are free flights, sampled every 2 ms. One succeeds if the tip comes to its depth, no faster than the slot
    allows, the rope touches no wall until then, keeps clear of arm, shaft and obstacles, as verified runs require, and
    is not folded flat before: its contact with itself is not simulated. The motor's torque is not checked.
    """
    options = options or SearchOptions()
    known = uncertainty or usual_uncertainty()
    scenarios = insert_scenarios(problem, slot, moves, known, samples, [STREAM, options.seed])
    return count_successes(_Estimate(problem, near), scenarios, time_budget, options)


@dataclass(frozen=True)
class _Estimate:
    """Counts the scenarios in which the tip enters at about time `near`, s; it can be sent to an executor."""

    problem: Problem
    near: float

    def __call__(self, scenarios: Sequence[tuple[Rope, Slot, Motion]], budget: Budget | None = None) -> int:
        t, (ropes, slots, motions) = sample_times(self.near), zip(*scenarios, strict=True)
        own = budget or Budget(threads=1)
        flights = Flights(self.problem, (), t, own, tol=DEFAULT_TOL, ropes=ropes, motions=motions)
        clear = flights.spare_gaps(self.problem).min(axis=(1, 2)) > CLOSER
        return sum(clear[m] and self._enters(slot, flights, m) for m, slot in enumerate(slots))

    def _enters(self, slot: Slot, flights: Flights, m: int) -> bool:
        """Whether flight m meets the conditions of a verified run at the slot, as far as it shows."""
        rope, joints, q = flights.ropes[m], flights.joints[m], flights.q[m]
        entry = next_entry(slot, rope.radius, flights.t, joints, self.near)
        if entry is None or entry.depth < slot.depth or entry.speed > slot.max_speed:
            return False
        until = slice(entry.end + 1)
        gaps = sampled_obstacle_gaps(rope, slot.walls, q[until], joints[until, 0], CLOSER)
        return bool(gaps.min() > CLOSER and not at_limits(limit_bend(rope), q[until], -1e-3).any())


@checks.arguments(limits=MotorLimits, slot=Slot, conditions=Conditions, uncertainty=Uncertainty, options=SearchOptions)
@interruptible(InsertPlan)
def plan_insert(
    rope: Rope,
    arm: Arm,
    slot: Slot,
    limits: MotorLimits | None = None,
    *,
    conditions: Conditions | None = None,
    uncertainty: Uncertainty | None = None,
    samples: int = 100,
    time_budget: float | Budget | None = 30.0,
    options: SearchOptions | None = None,
) -> InsertPlan:
    """Plan swings of the arm after which the tip moves through a slot to a depth, and the rope touches no wall.

    Parameters
    ----------
    rope, arm, limits
        As of :func:`hyperflex.plan_cast`.
    slot : Slot
        Its gap must be three diameters of the rope wide or more.
    conditions : Conditions, optional
        The time limit is by default two periods of the rope's swing. Obstacles are checked until 0.15 s after the tip
        is inside.
    uncertainty : Uncertainty, optional
        Scenarios of the success probability: by default each coordinate of the slot has a standard deviation of 2 mm,
        and the start of each move one of 2 ms. A rope that touches a wall fails in them, even if the slot allows it;
        the motor's torque is not checked.
    samples : int
        Number of scenarios of the success probability; fewer, or none, if the time runs out.
    time_budget : float or Budget, optional
        Wall-clock time for search, verifications and success probability, s, without compiling.
    options : SearchOptions, optional

    Returns
    -------
    InsertPlan

    Raises
    ------
    Interrupted
        By Ctrl-C. Its ``partial`` is the best plan until then.
    InvalidInput
        If an argument is out of range or of another class, or the gap is too narrow for the rope.
    """
    options = options or SearchOptions()
    slot.check_width(checks.instance("rope", rope, Rope))
    problem = tip_problem(rope, arm, limits, conditions, periods=2.0)
    task = InsertTask(problem, slot, uncertainty, checks.count("samples", samples), options.seed)
    return plan_tip(task, InsertPlan, options, time_budget)
