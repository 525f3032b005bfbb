"""Whips: the tip passes a point at a peak of its speed, fast and in the required direction; impacts on a peg there."""

import math
from dataclasses import MISSING, dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array, Integers
from hyperflex.dynamics import mass_matrix
from hyperflex.errors import InvalidInput
from hyperflex.interruption import interruptible
from hyperflex.model import (
    DEFAULT_CONTACT_STEP,
    Arm,
    MotorLimits,
    Peg,
    Placed,
    Rope,
    Setup,
    Wall,
    divided,
    named,
    unit_across,
)
from hyperflex.motion import Motion
from hyperflex.options import check as check_options
from hyperflex.options import option
from hyperflex.planning.moves import Moves
from hyperflex.planning.options import Conditions, SearchOptions, refuse_behind
from hyperflex.planning.outcome import excess_torque, run_figures
from hyperflex.planning.planner import Candidate
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import starts_outside
from hyperflex.planning.tasks.tip import (
    OPTIONS,
    Aim,
    Flights,
    TipEvent,
    TipFeasibility,
    TipOutcome,
    TipPlan,
    TipTask,
    coarse_flights,
    plan_tip,
    random_swings,
    ranked,
    sample_times,
    tip_problem,
    touches,
    verified_run,
)
from hyperflex.planning.verification import Accuracy, limit_bend
from hyperflex.simulation import simulate
from hyperflex.trajectory import Trajectory
from hyperflex.winding import closest_points


@dataclass(frozen=True)
class TipTarget(Placed):
    """A point that the tip must pass at a peak of its speed.

    Parameters
    ----------
    x, y : float
        m.
    direction : float, optional
        Direction of the tip's velocity there, rad, counterclockwise from the x axis; by default any, and then
        `angle_tolerance` is pi.
    least_speed : float
        Of the tip there, m/s, > 0.
    angle_tolerance : float
        Greatest angle between velocity and direction, rad, > 0 and at most pi; pi: any direction.
    tolerance : float
        Maximum distance of the tip from the point, m, > 0, with the links as planned. With finer links, another model
        of the same rope, three times as much is allowed, or the standard deviation of the position if that is larger.

    Raises
    ------
    InvalidInput
        If a value is not finite or has the wrong sign.
    """

    x: float = option(MISSING, "position of the target", "m")
    y: float = option(MISSING, "position of the target", "m")
    direction: float = option(  # None becomes 0 when it is made
        None, "direction of the tip's velocity there: 0 is +x, pi/2 is up", "rad", shown="any"
    )
    least_speed: float = option(5.0, "least speed of the tip there", "m/s", sign="positive")
    angle_tolerance: float = option(
        math.radians(20.0), "greatest angle between velocity and direction, at most pi", "rad", sign="positive"
    )
    tolerance: float = option(1e-3, "greatest distance of the tip from the target", "m", sign="positive")
    walls: ClassVar[tuple[Wall, ...]] = ()

    def __post_init__(self) -> None:
        if self.direction is None:
            if self.angle_tolerance not in (TipTarget.angle_tolerance, np.pi):
                fix = "Give both"
                raise InvalidInput("angle_tolerance has no direction", got=self.angle_tolerance, fix=fix)
            object.__setattr__(self, "direction", 0.0)
            object.__setattr__(self, "angle_tolerance", float(np.pi))
        check_options(self, "target")
        for name in ("x", "y"):
            checks.meant(f"target {name}", getattr(self, name), "m")
        if self.angle_tolerance > np.pi:
            raise InvalidInput("target angle_tolerance is too large", got=self.angle_tolerance, allowed="<= pi, in rad")

    @property
    def any_direction(self) -> bool:
        """Whether any direction is allowed."""
        return self.angle_tolerance == np.pi

    def angle_error(self, velocity: Array) -> Array:
        """Return the signed angle (...) from the direction to a `velocity` (..., 2), m/s, in rad."""
        turn = np.arctan2(velocity[..., 1], velocity[..., 0]) - self.direction
        return (turn + np.pi) % (2.0 * np.pi) - np.pi

    def lacks(self, velocity: Array, part: float, spare: float) -> tuple[Array, Array]:
        """Return by how much a `velocity` (..., 2), m/s, lacks direction, rad, and speed, as a fraction.

        At `part` of the angle tolerance and `spare` times the least speed nothing is lacking.
        """
        allowed = self.angle_tolerance * (1.0 if self.any_direction else part)
        error = self.angle_error(velocity)
        speed = np.hypot(velocity[..., 0], velocity[..., 1])
        slow = np.maximum(1.0 - speed / (spare * self.least_speed), 0.0)
        return np.asarray(error - np.clip(error, -allowed, allowed)), np.asarray(slow)


class Peaks(NamedTuple):
    """Peaks of the tip's speed in several swings (P,), interpolated between samples.

    `row` is the number of the swing, `t` in s; `place`, m, and `velocity`, m/s, (P, 2) are those of the tip. `highest`
    is the speed of the highest peak of the swing until then, m/s, and `blocked` how far, m, the rope came too near an
    obstacle before, or through it.
    """

    row: Integers
    t: Array
    place: Array
    velocity: Array
    highest: Array
    blocked: Array

    @property
    def speed(self) -> Array:
        """Speed of the tip (P,), m/s."""
        return np.asarray(np.hypot(*self.velocity.T))


def find_peaks(t: Array, tip: Array, velocity: Array, blocked: Array | None = None) -> Peaks:
    """Find the peaks of the tip's speed in samples at evenly spaced times t (T,), s.

    `tip`, m, and `velocity`, m/s, are (M, T, 2), NaN if a run failed; `blocked` (M, T), m, as of :class:`Peaks`, by
    default 0.
    """
    step, square = float(t[1] - t[0]), np.nan_to_num((velocity**2).sum(axis=2))
    row, at = np.nonzero((square[:, 1:-1] > square[:, :-2]) & (square[:, 1:-1] >= square[:, 2:]))
    low, mid, high = (square[row, at + k] for k in range(3))
    slow, v, fast = (velocity[row, at + k] for k in range(3))
    part = np.clip(0.5 * (low - high) / (low - 2.0 * mid + high), -0.5, 0.5)
    late = part[:, None]
    place = tip[row, at + 1] + step * late * (v + late * (fast - slow) / 4.0)
    v = v + late * (0.5 * (fast - slow) + 0.5 * late * (fast - 2.0 * v + slow))
    tops = np.zeros_like(square[:, 1:-1])
    tops[row, at] = np.hypot(*v.T)
    highest = np.maximum.accumulate(tops, axis=1)[row, at]
    until = np.zeros(at.size) if blocked is None else blocked[row, at + 1]
    whole = np.isfinite(place).all(axis=1) & np.isfinite(v).all(axis=1)
    return Peaks(*(each[whole] for each in (row, t[at + 1] + step * part, place, v, highest, until)))


@dataclass(frozen=True)
class PeakCosts:
    """Costs, m, of a peak besides its distance from the target.

    Per rad of direction beyond `part` of the tolerance, per fraction of speed that lacks to `spare` times the least,
    per fraction by which it is lower than an earlier peak, per second, and per m that the rope lies in an obstacle.
    """

    angle: float = 0.3
    speed: float = 1.0
    earlier: float = 0.5
    time: float = 0.004  # of equal whips the sooner one is less uncertain
    blocked: float = 3.0  # 1 finds fewer
    part: float = 0.6
    spare: float = 1.05

    def of(self, target: TipTarget, peaks: Peaks) -> Array:
        """Return the costs of peaks (P,), m."""
        beyond, slow = target.lacks(peaks.velocity, self.part, self.spare)
        return np.asarray(
            np.hypot(*(peaks.place - target.point).T)
            + self.angle * np.abs(beyond)
            + self.speed * slow
            + self.earlier * (1.0 - peaks.speed / np.maximum(peaks.highest, 1e-9))
            + self.time * peaks.t
            + self.blocked * peaks.blocked
        )


def cheapest_peaks(cost: Array, peaks: Peaks, count: int) -> list[tuple[float, float]]:
    """Return cost and time, s, of the cheapest peak of each of `count` swings; infinite for a swing without a peak."""
    found = [(math.inf, math.nan)] * count
    for k in np.argsort(-cost):
        found[peaks.row[k]] = (float(cost[k]), float(peaks.t[k]))
    return found


@dataclass(frozen=True, eq=False)
class WhipMap:
    """Peaks of the tip's speed in random swings: roughly what is feasible.

    Attributes
    ----------
    problem : Problem
    moves : tuple of Moves
        Of each swing.
    peaks : Peaks
    """

    problem: Problem
    moves: tuple[Moves, ...]
    peaks: Peaks


def check_whip_feasibility(whip_map: WhipMap, target: TipTarget) -> TipFeasibility:
    """Check whether a target is close enough to a peak of a map; obstacles count only if they are at the target.

    Without obstacles the cost of a peak is its distance from the target, and more if it lacks speed or direction.
    """
    return WhipTask(whip_map.problem, target, whip_map).prepare(Budget())


@interruptible()
def build_whip_map(
    problem: Problem, swings: int = OPTIONS.swings, time_budget: float | Budget | None = None
) -> WhipMap:
    """Simulate random swings, always the same, and find the peaks of the tip's speed.

    Parameters
    ----------
    problem : Problem
    swings : int
    time_budget : float or Budget, optional
        s; if it ends early, the map has only the first swings, at least one batch.

    Raises
    ------
    InvalidInput
        If the time of the problem is too short for a peak.
    """
    refuse_behind(problem.criteria.behind, "a whip")
    if problem.time < (least := 4.0 * OPTIONS.sample_time):
        allowed = f"at least {least:g} s; three periods of the rope's swing are usual"
        raise InvalidInput("time_limit is too short for any whip", got=problem.time, allowed=allowed)
    found, moves = list[Peaks](), list[Moves]()
    for flights in coarse_flights(problem, random_swings(problem, swings), Budget.of(time_budget)):
        some = flight_peaks(problem, flights)
        found.append(some._replace(row=some.row + len(moves)))
        moves += flights.moves
    return WhipMap(problem, tuple(moves), Peaks(*map(np.concatenate, zip(*found, strict=True))))


def flight_peaks(problem: Problem, flights: Flights) -> Peaks:
    """Find the peaks of coarse flights."""
    return find_peaks(flights.t, flights.joints[:, :, -1], flights.velocity, flights.blocked(problem))


@dataclass(frozen=True, eq=False, kw_only=True)
class TipStrike(TipOutcome):
    """The highest peak of the tip's speed about the expected time, in a simulated run.

    Its instant is the peak's, and its message does not include the miss; the rest is as of :class:`TipOutcome`.

    Attributes
    ----------
    miss : float
        Distance from the target, m.
    angle_error : float
        Angle between velocity and the required direction, rad, >= 0.
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
        """Return what matters most to whoever carries the moves out, in figures with units."""
        return f"{self.speed:.1f} m/s at {self.t:.2f} s, {1e3 * self.miss:.2g} mm off, {self.torque:.3g} N m"


MISSES = 3.0  # tolerances by which the tip may miss with shorter links, another model of the same rope
SUDDEN = 0.01  # of the energy of an impact, above which what is lost in a sample is a collision


@dataclass(frozen=True)
class Impact:
    """Impact of a whip's tip on a small fixed peg whose surface is at the target.

    Attributes
    ----------
    t : float
        Time of the first touch, s; NaN if the rope does not touch the peg.
    impulse : float
        Impulse on the peg within the duration, N s.
    impulse_along : float
        Its component in the required direction, N s.
    energy : float
        Energy lost in the impact while the rope is on the peg, J.
    link : int
        First link in contact, counted from the motor, from 0 on; -1 if none is.
    message : str
        Why there is no impact of the tip, and impulse and energy are 0: the rope does not touch the peg, or lies on it
        before, or touches it first elsewhere. Empty if there is one.
    radius, duration : float
        Of the peg, m, and of the impact, s.
    """

    t: float = math.nan
    impulse: float = 0.0
    impulse_along: float = 0.0
    energy: float = 0.0
    link: int = -1
    message: str = ""
    radius: float = 0.01
    duration: float = 0.05

    @property
    def success(self) -> bool:
        """Whether the tip touches the peg first, about the expected time."""
        return not self.message


def simulate_impact(
    problem: Problem,
    point: Array,
    direction: float,
    motion: Motion,
    near: float,
    *,
    radius: float = 0.01,
    mu: float = 0.3,
) -> Impact:
    """Simulate a motion with a small fixed peg at a target and measure the impact, expected at time `near`, s.

    Parameters
    ----------
    problem : Problem
        Its obstacles are not simulated.
    point : (2,) array
        The target, m. The peg lies behind it, so that the tip touches the peg where it passes the target.
    direction : float
        Direction of the tip there, rad.
    motion : Motion
        Of the arm.
    near : float
        Expected time of the impact, s: the peg must be touched within :attr:`TipOptions.after`.
    radius, mu : float
        Of the peg, m, and its friction coefficient.

    Notes
    -----
    The impact is the first touch of all, by the tip: within the last link, or the peg's width from the rope's end.
    Forces are averaged over samples; a collision within a sample adds its impulse (see :func:`collision_impulse`) if
    the sample loses more than SUDDEN of the energy. Raises SimulationError if the run fails.
    """
    radius, step = checks.number("radius", radius, sign="positive", unit="m"), 0.5 * DEFAULT_CONTACT_STEP
    duration = Impact.duration
    way = np.array([np.cos(direction), np.sin(direction)])
    x, y = point + (radius + problem.rope.radius) * way
    t = step * np.arange(np.ceil((near + OPTIONS.after + duration) / step))
    peg = Peg(float(x), float(y), radius, mu)
    setup = Setup(limit_bend(problem.rope), motion, problem.arm, duration=float(t[-1]), pegs=(peg,))
    if not starts_outside(setup):
        return Impact(t=0.0, message="the rope lies on the peg from the start")
    run = simulate(setup, t_eval=t)
    rope, (touched, _) = run.rope, touches(run, (peg,))
    if not touched.size:
        return Impact(message="the rope does not touch the peg")
    along, _, gap = closest_points(rope, peg, run.q, run.joints)
    first, links = int(touched[0]), gap.argmin(axis=1)
    begin, link = float(t[first]), int(links[first])
    beyond = float(rope.length[link:].sum() - along[first, link])
    tip = beyond <= max(rope.length[-1], 2.0 * radius) + 1e-9
    if begin < near - OPTIONS.after or not tip:
        where = f"link {link} touches the peg first, at {begin:.2f} s and {1e2 * beyond:.0f} cm from the tip"
        where = f"the tip touches the peg already at {begin:.2f} s" if tip else where
        return Impact(begin, link=link, message=f"{where}; the tip was expected at {near:.2f} s")
    rows = touched[touched <= first + round(duration / step)]
    lost = np.diff(np.asarray(run.contact_loss), prepend=0.0)[rows]  # elsewhere: joints at their limits
    energy = float(lost.sum())
    total = -step * np.asarray(run.contact_force)[rows].sum(axis=(0, 1))  # on the peg
    for k in rows[lost > SUDDEN * energy].tolist():
        total = total - collision_impulse(run, k, int(links[k]), float(along[k, links[k]]))
    impulse = float(np.hypot(*total)), float(total @ way)
    return Impact(begin, *impulse, energy, link, radius=radius)


def collision_impulse(run: Trajectory, k: int, link: int, along: float) -> Array:
    """Impulse (2,), N s, of a collision at distance `along`, m, on a link between samples k - 1 and k.

    From the jump of the generalised momenta, without finite forces and the arm's acceleration: an impulse P at distance
    s along link c changes that of link i by l_i t_i P before c, by s t_c P at c and not beyond, with t_i across link i.
    """
    rope, q = run.rope, run.q[k]
    lever = np.where(np.arange(q.size) < link, rope.length, 0.0)
    lever[link] = along
    across = lever[:, None] * unit_across(q)
    return np.asarray(np.linalg.lstsq(across, mass_matrix(rope, q) @ (run.qd[k] - run.qd[k - 1]), rcond=None)[0])


@dataclass(frozen=True, eq=False, repr=False)
class WhipPlan(TipPlan):
    """A planned whip, or why there is none.

    Attributes
    ----------
    finer_outcome : TipStrike or None
        With links of half the length.
    problem, target, feasibility, moves, outcome, message, runs, seconds, interrupted, success_probability
        As of :class:`hyperflex.planning.plan.Plan`.
    position_std, decided
        As of :class:`hyperflex.planning.tasks.tip.TipPlan`.
    """

    kind: ClassVar[str] = "whip"
    target: TipTarget
    feasibility: TipFeasibility
    outcome: TipStrike | None = None
    finer_outcome: TipStrike | None = None

    def impact(self, *, radius: float = 0.01, mu: float = 0.3) -> Impact:
        """Simulate the impact on a small fixed peg whose surface is at the target; see :class:`Impact`.

        The peg has a `radius`, m, and a friction coefficient `mu`. Raises InvalidInput if the plan has no outcome.
        """
        outcome, target = self.required(self.outcome, "outcome"), self.target
        direction = float(np.arctan2(*outcome.velocity[::-1])) if target.any_direction else target.direction
        motion = self.required(self.motion, "motion")
        return simulate_impact(self.problem, target.point, direction, motion, outcome.t, radius=radius, mu=mu)


class WhipTask(TipTask):
    """Whip a target, from the swings of a map, by default of a new one."""

    close, ready, improve = 2e-4, -0.06, 1.0

    def __init__(self, problem: Problem, target: TipTarget, whip_map: WhipMap | None = None, seed: int = 0) -> None:
        super().__init__(problem, target, target.point[None], divided(problem.rope, 2), seed)
        self.map = whip_map

    def swing(self, budget: Budget) -> tuple[list[Candidate], float, str]:
        """Return the swings of the map by their cheapest peaks; for the feasibility obstacles do not count."""
        known = self.map or build_whip_map(self.problem, time_budget=budget)
        target, peaks = self.target, known.peaks
        swings = ranked(known.moves, cheapest_peaks(PeakCosts().of(target, peaks), peaks, len(known.moves)))
        free = peaks._replace(blocked=np.zeros_like(peaks.blocked))
        far = "out of reach: the tip's speed has no peak so near to it"
        near = peaks.speed[np.hypot(*(peaks.place - target.point).T) < 0.25]  # m; what is reported
        if near.size:
            how = f"{near.max():.1f} m/s at most, or not in that direction"
            far = f"out of reach: the tip is not that fast so near to it, {how}"
        return swings, float(PeakCosts().of(target, free).min(initial=math.inf)), far

    def score(self, flights: Flights) -> list[tuple[float, float]]:
        """Return cost, m, and time, s, of the cheapest peak of each flight."""
        peaks = flight_peaks(self.problem, flights)
        return cheapest_peaks(PeakCosts().of(self.target, peaks), peaks, len(flights.moves))

    def event(self, flights: Flights, m: int, near: float) -> TipEvent | None:
        """Return the peak in flight m next to time `near`, s."""
        fine, one, target = flights.t > near - OPTIONS.closely, slice(m, m + 1), self.target
        peaks = find_peaks(flights.t[fine], flights.joints[one, fine, -1], flights.velocity[one, fine])
        away = np.abs(peaks.t - near)
        if away.min(initial=np.inf) >= OPTIONS.window:
            return None
        k = int(away.argmin())
        t, place, velocity = float(peaks.t[k]), peaks.place[k], peaks.velocity[k]
        # An error of 1 rad, or the whole speed, counts as the distance from the shaft
        residuals = [*(place - target.point), *(self.distance * np.array(target.lacks(velocity, 0.85, 1.01)))]
        lacks = [np.hypot(*residuals[:2]) - target.tolerance, *np.abs(target.lacks(velocity, 1.0, 1.0))]
        return TipEvent(t, int(np.searchsorted(flights.t, t)) - 1, residuals, lacks, place)

    def uncertainty(self, aim: Aim) -> float:
        """Return the standard deviation of the place over the miss that is allowed with shorter links."""
        return aim.std / float(MISSES * self.target.tolerance)

    def simulate(self, problem: Problem, one: Candidate, budget: Budget) -> TipStrike | None:
        """Return the peak of the tip's speed; see :func:`verify_whip`."""
        return verify_whip(problem, self.target, one.moves.motion(problem.limits), one.t, budget=budget)

    def failure(self, one: Candidate, outcome: TipStrike | None, first: TipStrike | None) -> str:
        """Return why a whip fails; with shorter links speed and direction do not count, and more may be missed."""
        allowed = self.target.tolerance
        if outcome is None:
            return "the tip's speed has no peak there"
        message = outcome.message
        if first is not None:
            message, allowed = outcome.refused, max(MISSES * allowed, one.std if isinstance(one, Aim) else 0.0)
        if not message and outcome.miss > allowed:
            return f"the tip misses the target by {1e3 * outcome.miss:.1f} mm, {1e3 * allowed:.1f} allowed"
        return message or excess_torque(self.problem, outcome.torque)


def verify_whip(
    problem: Problem, target: TipTarget, motion: Motion, near: float, *, tol: float = 1e-7, budget: Budget | None = None
) -> TipStrike | None:
    """Simulate a motion from rest and find the highest peak of the tip's speed about time `near`, s.

    With obstacles it is the highest before the rope touches one, unless the peak next to `near` comes later; a run
    without obstacles shows the peaks. Returns None if a run fails or begins in an obstacle, or there is no peak; raises
    OutOfTime if it does not end within the budget. `tol` is the tolerance, m.
    """
    t = sample_times(near)
    run = verified_run(replace(problem, obstacles=()), motion, t, budget, accuracy=Accuracy(tol))
    if run is None:
        return None
    found, touched, touch = find_peaks(run.t, run.tip[None], run.tip_velocity[None]), math.inf, ""
    away = np.abs(found.t - near)
    about = away < t[-1] - near
    if not about.any():
        return None
    if problem.obstacles:
        run = verified_run(problem, motion, np.union1d(t, found.t[about]), budget, accuracy=Accuracy(tol))
        if run is None:
            return None
        rows, which = touches(run, problem.obstacles)
        if rows.size:
            touched = float(run.t[rows[0]])
            touch = f"{named(problem.obstacles[which[0]])} at {touched:.2f} s"
    k = int(np.where(about, away, np.inf).argmin())
    if found.t[k] < touched:
        k = int(np.where(about & (found.t < touched), found.speed, 0.0).argmax())
    at, place, velocity, speed = float(found.t[k]), found.place[k], found.velocity[k], float(found.speed[k])
    error, figures = abs(float(target.angle_error(velocity))), run_figures(problem, run, at)
    if touched <= at:  # however short, and whatever distance the samples show
        figures |= {"refused": f"the rope touches {touch}", "clearance": min(figures["clearance"], 0.0)}
    message = figures["refused"]
    if not message and speed < target.least_speed:
        message = f"the tip's speed is {speed:.2f} m/s, {target.least_speed:g} required"
    elif not message and error > target.angle_tolerance:
        allowed = np.degrees(target.angle_tolerance)
        message = f"the tip's direction is {np.degrees(error):.0f} degrees off, {allowed:.0f} allowed"
    return TipStrike(
        t=at,
        place=place,
        velocity=velocity,
        miss=math.dist(place, target.point),
        angle_error=error,
        earlier_speed=float(found.speed[found.t < at].max(initial=0.0)),
        touches_later=touch if at < touched else "",
        message=message,
        **figures,
    )


@checks.arguments(limits=MotorLimits, target=TipTarget, conditions=Conditions, options=SearchOptions)
@interruptible(WhipPlan)
def plan_whip(
    rope: Rope,
    arm: Arm,
    target: TipTarget,
    limits: MotorLimits | None = None,
    *,
    conditions: Conditions | None = None,
    whip_map: WhipMap | None = None,
    time_budget: float | Budget | None = 30.0,
    options: SearchOptions | None = None,
) -> WhipPlan:
    """Plan strokes of the arm after which the tip passes a point at a peak of its speed.

    Parameters
    ----------
    rope, arm, limits
        As of :func:`hyperflex.plan_cast`.
    target : TipTarget
        Position, direction and least speed of the tip at the peak.
    conditions : Conditions, optional
        The rope must not touch obstacles until the tip is there. The time limit is by default that of the map if one
        is given, else three periods of the rope's swing.
    whip_map : WhipMap, optional
        Map for the same rope, arm, limits, time and obstacles, from :func:`build_whip_map`; by default it is built in
        some seconds.
    time_budget : float or Budget, optional
        Wall-clock time for map, search and verifications, s, without compiling.
    options : SearchOptions, optional

    Returns
    -------
    WhipPlan

    Raises
    ------
    Interrupted
        By Ctrl-C. Its ``partial`` is the best plan until then.
    InvalidInput
        If an argument is out of range or of another class, or a link's centre of mass is not in its middle (the second
        verification divides each link in two).
    """
    options = options or SearchOptions()
    problem = tip_problem(rope, arm, limits, conditions, periods=3.0)
    if whip_map is not None:
        made = checks.instance("whip_map", whip_map, WhipMap).problem
        time = problem.time if conditions and conditions.time_limit else made.time
        problem = replace(problem, limits=problem.limits if limits else made.limits, time=time)
        if problem != replace(made, clearance=problem.clearance):
            raise InvalidInput(
                "map was made for another rope, arm, motor or time, or other obstacles",
                fix="Make one: build_whip_map(Problem(rope, arm, limits, time_limit, obstacles=...))",
            )
    return plan_tip(WhipTask(problem, target, whip_map, options.seed), WhipPlan, options, time_budget)
