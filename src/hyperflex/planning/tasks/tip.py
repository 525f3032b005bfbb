"""Motions after which the tip does something at one instant: what whips and insertions have in common.

Random swings are simulated coarsely. The most promising ones are aimed: Levenberg and Marquardt on the arm's angles and
rests, with differences of free flights, until the tip does what the task requires and the rope touches no obstacle.
"""

import math
from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget, OutOfTime
from hyperflex.checks import Array, Integers
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.interruption import stoppable
from hyperflex.model import Arm, MotorLimits, Obstacle, Rope, Setup, Wall, gap_of, named, obstacle_gaps
from hyperflex.motion import Motion
from hyperflex.planning.clearance import sampled_clearance
from hyperflex.planning.ensemble import SuccessProbability
from hyperflex.planning.moves import Moves
from hyperflex.planning.options import Conditions, SearchOptions
from hyperflex.planning.outcome import RunOutcome
from hyperflex.planning.plan import Plan
from hyperflex.planning.planner import Candidate, Planner, Task, Verified
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import RolloutBatch, check_start, free_sides, starts_outside
from hyperflex.planning.shooting import shoot
from hyperflex.planning.uncertainty import scaled_rope
from hyperflex.planning.verification import Accuracy, verified_setup
from hyperflex.simulation import simulate
from hyperflex.status import Status
from hyperflex.trajectory import Trajectory
from hyperflex.winding import TOUCH


@dataclass(frozen=True)
class TipOptions:
    """How motions for the tip are searched for.

    Parameters
    ----------
    swings, batch : int
        Random swings, and those that are simulated at once.
    stroke, step : (float, float)
        Ranges of their mean stroke, half turns, and of the mean time from stroke to stroke, swing periods.
    end_spread, rest_spread : float
        Standard deviations within a random swing: of the angle after each move, half turns, and of each rest, swing
        periods. Steps of the search are measured in them.
    sample_time, tol : float
        Step of the samples, s, and tolerance, m, of swings that are only scored.
    max_cost : float
        Cost, m, of the cheapest random swing up to which a target is feasible.
    fine_time, fine_tol : float
        The same of flights that are aimed.
    window : float
        Time about the instant that counts, s, within which it may move in a step.
    closely : float
        Time before the instant that counts, s, which is sampled at `fine_time`.
    after : float
        Time after the instant that counts, s, until which a verified run goes on.
    rounds : int
        Steps of an aim.
    difference : float
        Change for the derivatives, in standard deviations of random swings.
    friction_std, length_std, timing_std : float
        Standard deviations of the rope's friction and length, relative, and of each rest, s, from which that of the
        tip's place follows.
    spare : float
        Distance, m, that the rope shall keep from obstacles beyond the required clearance, where target and start
        allow it.
    members, generations, narrow, shorter : (int, int, float, float)
        Of an evolution of a swing, whose first step is `narrow` standard deviations of random swings; factor of a step
        after one without gain.
    """

    swings: int = 512
    batch: int = 64
    stroke: tuple[float, float] = (0.3, 1.1)
    step: tuple[float, float] = (0.35, 0.65)
    end_spread: float = 0.15
    rest_spread: float = 0.06
    sample_time: float = 0.01
    tol: float = 1e-3
    max_cost: float = 0.15
    fine_time: float = 2e-3
    fine_tol: float = 1e-6
    window: float = 0.12
    closely: float = 0.4
    after: float = 0.15
    rounds: int = 16
    difference: float = 1e-2
    friction_std: float = 0.05
    length_std: float = 0.002
    timing_std: float = 2e-3
    spare: float = 0.01
    members: int = 16
    generations: int = 16
    narrow: float = 0.3
    shorter: float = 0.7


OPTIONS = TipOptions()
LEAST_CHANCE = 0.1  # success probability below which moves are no plan, whatever their two verified runs show
TipPlanT = TypeVar("TipPlanT", bound="TipPlan")


class Flights:
    """Free flights (M) after moves of the arm, at times `t` (T,), s.

    Places of the `joints` and the tip (M, T, n + 1, 2), m, and `velocity` of the tip (M, T, 2), m/s; NaN where a flight
    failed. `ropes` and `motions` of the arm are those of the problem and the moves unless others are given.
    """

    def __init__(
        self,
        problem: Problem,
        moves: Sequence[Moves],
        t: Array,
        budget: Budget,
        *,
        tol: float = OPTIONS.tol,
        ropes: Sequence[Rope] = (),
        motions: Sequence[Motion] = (),
    ) -> None:
        self.moves, self.t, motions = moves, t, motions or [each.motion(problem.limits) for each in moves]
        self.ropes = ropes = ropes or [problem.rope] * len(motions)
        batch = RolloutBatch.from_start(replace(problem, rope=ropes[0]), ropes, [], motions)
        run = batch.run(problem.arm, t, tol=tol, keep=("q", "qd"), threads=budget.threads)
        self.q, joints, velocities = run.q, [], []
        for rope, motion, q, qd in zip(ropes, motions, run.q, run.qd, strict=True):
            base, velocity = problem.arm.tip_motion(motion, t)
            joints.append(rope.joints(q, base))
            velocities.append(rope.joint_velocities(q, qd, velocity)[:, -1])
        self.joints, self.velocity = np.stack(joints), np.stack(velocities)

    def spare_gaps(self, problem: Problem) -> Array:
        """Return gaps (M, T, w + 1), m, of the ropes from w obstacles and their arm beyond the required clearance.

        See :func:`hyperflex.model.obstacle_gaps`.
        """
        arm, clearance, found = problem.arm, problem.clearance, list[Array]()
        for rope, q, joints in zip(self.ropes, self.q, self.joints, strict=True):
            gaps = obstacle_gaps(problem.obstacles, joints[:, :-1], joints[:, 1:]).min(axis=-1)
            own = sampled_clearance(rope, arm, q, joints[:, 0]) - clearance
            found.append(np.column_stack([gaps - rope.radius - max(clearance, 0.0), own]))
        return np.nan_to_num(np.stack(found))

    def blocked(self, problem: Problem) -> Array:
        """Return how far, m, ropes have come too near obstacles or arm, or through them, until each sample (M, T)."""
        depth = -self.spare_gaps(problem).min(axis=2, initial=0.0)
        return np.maximum.accumulate(depth, axis=1)


def coarse_flights(
    problem: Problem, moves: Sequence[Moves], budget: Budget, until: float = math.inf
) -> Iterator[Flights]:
    """Simulate swings that are only scored, in batches until the budget expires, one batch at least.

    Until a time, s, at most that of the problem.
    """
    t = np.arange(0.0, min(until, problem.time) + 0.5 * OPTIONS.sample_time, OPTIONS.sample_time)
    for low in range(0, len(moves), OPTIONS.batch):
        if low and budget.expired:
            return
        yield Flights(problem, moves[low : low + OPTIONS.batch], t, budget)


def random_swings(problem: Problem, count: int, walls: Sequence[Obstacle] = ()) -> list[Moves]:
    """Return moves that pump a swing up more or less well, always the same.

    They begin on sides on which the rope hangs clear of obstacles and `walls`; on either side if there is none.
    """
    sides = free_sides(problem, (*problem.obstacles, *walls)) or [-1, 1]
    rng, period, found = np.random.default_rng(1), problem.period, list[Moves]()
    for number in range(count):
        side = sides[number % len(sides)]
        stroke, step = np.pi * rng.uniform(*OPTIONS.stroke), period * rng.uniform(*OPTIONS.step)
        rest = max(0.0, step - float(problem.limits.fastest_moves([stroke])[0][0]))
        size = max(1, int(np.ceil(problem.time / step)))
        ends = 0.5 * side * np.pi - side * stroke * (np.arange(size) % 2 == 0)
        ends = ends + np.pi * OPTIONS.end_spread * rng.standard_normal(size)
        rests = np.abs(rest + period * OPTIONS.rest_spread * rng.standard_normal(size))
        found.append(Moves(side, ends, rests))
    return found


@dataclass(frozen=True, eq=False, kw_only=True)
class Aim(Candidate):
    """Moves with what the tip does after them in a free flight.

    Attributes
    ----------
    residuals : (m,) float64
        What an aim reduces to 0, m.
    place : (p,) float64
        Coordinates whose standard deviation counts, m.
    std : float
        Standard deviation of the place, m: :attr:`TipOptions.friction_std` and the following, by the delta method.
    """

    residuals: Array
    place: Array
    std: float = math.nan


class TipEvent(NamedTuple):
    """What the tip does in a fine flight at the instant that counts: time `t`, s, and row `end` until which gaps count.

    `residuals`, m, are reduced to 0 by an aim; `lacks` are > 0 where the moves fail, by how much, m. `place` (p,) are
    coordinates whose standard deviation counts, m; `gaps` (T,) each, m, are distances from what is no obstacle.
    """

    t: float
    end: int
    residuals: Sequence[float]
    lacks: Sequence[float]
    place: Array
    gaps: Sequence[Array] = ()


@dataclass(frozen=True)
class TipFeasibility:
    """Result of the feasibility check of a task of the tip.

    `distance` is that of the tip's place from the arm's pivot, m. `cost`, m, is that of the cheapest random swing, at
    most :attr:`TipOptions.max_cost`. `message` is the reason why the task is not feasible; `cut_short`: the time was
    over before all random swings were simulated, so that it may be feasible all the same.
    """

    distance: float
    cost: float
    message: str
    cut_short: bool = False

    @property
    def feasible(self) -> bool:
        """Whether the task is feasible."""
        return not self.message


@dataclass(frozen=True, eq=False, kw_only=True)
class TipOutcome(RunOutcome):
    """What the tip does in a simulated run.

    Attributes
    ----------
    t : float
        The instant that counts, s.
    place, velocity : (2,) float64
        Of the tip then, m, m/s.
    others
        As of :class:`RunOutcome`; for a whip, obstacles count for `clearance` until `t`.
    """

    t: float
    place: Array
    velocity: Array

    @property
    def speed(self) -> float:
        """Speed of the tip at `t`, m/s."""
        return float(np.hypot(*self.velocity))


@dataclass(frozen=True, eq=False, repr=False)
class TipPlan(Plan):
    """A planned motion of the tip.

    Attributes
    ----------
    position_std : float
        Standard deviation of the tip's place, m, for a rope known as :class:`TipOptions` assumes; NaN without moves.
    decided : bool
        Whether the moves were verified, which may leave no outcome, or there was nothing more to try. Otherwise the
        search ended before it was known what is possible.
    """

    position_std: float = math.nan
    decided: bool = False

    @property
    def status(self) -> Status:
        """Why the planner ended; see :class:`hyperflex.planning.plan.Plan`."""
        late = super().status == Status.INFEASIBLE and self.feasibility.cut_short
        return Status.OUT_OF_TIME if late else super().status

    @property
    def refuted(self) -> bool:
        """Whether a simulated run shows that the plan fails, or there was nothing more to try."""
        return self.decided and not self.success

    def setup(self) -> Setup:
        """Return the set-up of a run until after the instant that counts, with the walls.

        Until the arm stops if nothing was verified.
        """
        motion = self.required(self.motion, "motion")
        end = motion.end if self.outcome is None else float(sample_times(self.outcome.t)[-1])
        return verified_setup(self.problem, motion, end, self.target.walls)


@dataclass(frozen=True, eq=False)
class TipVerified(Verified):
    """Verified moves with their success probability; None if they fail, or it was not required."""

    probability: SuccessProbability | None = None


class TipTask(Task):
    """A task of the tip.

    Parameters
    ----------
    problem : Problem
    target
        With `walls`, which the problem's obstacles do not include.
    places : (P, 2) float64
        Where the tip must come, m, the farthest last.
    finer : Rope
        The rope with shorter links, for a second verification.
    seed : int

    Attributes
    ----------
    close, ready : float
        Distance, m, at which an aim ends; score at which an evolution ends.
    improve : float
        A plan that succeeds is improved for this many times as long as it took to find, a less uncertain one for less.
    swings : list of Candidate
        Random swings with their scores, the negative costs, m; the best first.
    """

    close: ClassVar[float]
    improve: ClassVar[float]
    enough = 1.0
    whole: Budget | None = None  # of search and success probability

    def __init__(self, problem: Problem, target: Any, places: Array, finer: Rope, seed: int = 0) -> None:
        self.problem, self.target, self.seed = problem, target, seed
        self.finer, self.swings = replace(problem, rope=finer), list[Candidate]()
        self.distance = math.dist(places[-1], problem.arm.pivot)
        self._needed = problem.rope.radius + max(problem.clearance, 0.0)
        self._gaps = np.array([min(gap_of(each, place) for place in places) for each in problem.obstacles])
        # Half of what the target leaves, at most; of the arm nothing
        self._spare = np.append(np.clip(0.5 * (self._gaps - self._needed), 0.0, OPTIONS.spare), 0.0)
        self._starts, self._begun = list[Candidate](), list[Candidate]()
        self._sampled, self._least = False, 0.0

    @abstractmethod
    def swing(self, budget: Budget) -> tuple[list[Candidate], float, str]:
        """Simulate random swings until the budget expires; return the possible ones, the best first.

        And the cost, m, by which the target is feasible, and why it is out of reach if that is too much.
        """

    @abstractmethod
    def score(self, flights: Flights) -> list[tuple[float, float]]:
        """Return the cost, m, of coarse flights, and the time, s, at which the tip nearly does the task; inf: never."""

    @abstractmethod
    def event(self, flights: Flights, m: int, near: float) -> TipEvent | None:
        """Return what the tip does next to time `near`, s, in fine flight m."""

    @abstractmethod
    def simulate(self, problem: Problem, one: Candidate, budget: Budget) -> Any:
        """Return the outcome of a candidate in a simulated run, with the finer rope or not; None if there is none."""

    @abstractmethod
    def failure(self, one: Candidate, outcome: Any, first: Any) -> str:
        """Return why an outcome fails, empty if it succeeds; `first` is that of the first run if this is the second."""

    @abstractmethod
    def uncertainty(self, aim: Aim) -> float:
        """Return how uncertain moves are that do not fail, over what usually succeeds: certain ones come first."""

    def estimate(self, one: Candidate, budget: Budget) -> SuccessProbability | None:
        """Return the success probability of a candidate that succeeds; None if it was not required."""
        return None

    def geometry(self) -> str:
        """Return why geometry rules the target out; empty if it does not."""
        short = self.distance - self.problem.rope.total_length - self.problem.arm.length
        if short > 0.0:
            return f"out of reach: the rope ends {short:.2f} m short of the target"
        for each, gap in zip(self.problem.obstacles, self._gaps, strict=True):
            if gap <= 0.0:
                return f"the target lies in {named(each)}"
            if gap <= self._needed:
                near = f"the target is {1e3 * gap:.1f} mm from {named(each)}"
                return f"{near}: with its radius and clearance the rope needs {1e3 * self._needed:g} mm"
        return ""

    def prepare(self, budget: Budget) -> TipFeasibility:
        """Simulate random swings, none if geometry rules the target out, and check the feasibility by them."""
        if message := self.geometry():
            return TipFeasibility(self.distance, math.inf, message)
        self.whole, swinging = budget, budget.share(0.5)
        self.swings, cost, far = self.swing(swinging)
        if cost <= OPTIONS.max_cost:
            return TipFeasibility(self.distance, cost, "")
        late = swinging.expired
        message = "the time budget ended before a swing was simulated that comes near it" if late else far
        return TipFeasibility(self.distance, cost, message, late)

    def scored(self, moves: Sequence[Moves], budget: Budget, until: float = math.inf) -> list[Candidate]:
        """Score swings until the budget expires, each until a time, s; return the possible ones, best first."""
        flown, scores = list[Moves](), list[tuple[float, float]]()
        for flights in coarse_flights(self.problem, moves, budget, until):
            flown += flights.moves
            scores += self.score(flights)
        return ranked(flown, scores)

    def sample(self, found: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Return the random swings; then what evolutions of one by one gain.

        They begin with the best swings; of the same side and number of moves the second counts as twice as bad, and so
        on. After each of them the best one that gained a tenth of its cost is continued.
        """
        if not self._sampled:
            self._sampled, seen, rank = True, Counter[tuple[int, int]](), dict[int, int]()
            for one in self.swings:
                kind = one.moves.side, one.moves.cut(one.t + OPTIONS.window, self.problem.limits).ends.size
                rank[id(one)], seen[kind] = seen[kind], seen[kind] + 1
            self._starts = sorted(self.swings, key=lambda one: -one.score * (1 + rank[id(one)]))
            return self.swings
        results = list[Candidate]()
        while not results and (self._starts or self._begun):
            self._begun.sort(key=lambda one: -one.score)
            for one in [pool.pop(0) for pool in (self._starts, self._begun) if pool]:
                best = self._evolved(one, budget)
                results += [best] if best is not one else []
                self._begun += [best] if self.ready > best.score > 0.9 * one.score else []
        return results

    def _evolved(self, best: Candidate, budget: Budget) -> Candidate:
        """Return the best swing of an evolution strategy that begins with a swing.

        Of each generation the mean of the better quarter is varied; steps get shorter when it brings no gain.
        """
        options, size = OPTIONS, OPTIONS.narrow
        centre, until = best.moves, best.t + options.closely
        random = np.random.default_rng([1, self.seed, self.runs])
        for _ in range(options.generations):
            if best.score > self.ready:
                break
            budget.check()
            steps = size * random.standard_normal((options.members, centre.parameters.size))
            varied = [centre.varied(each) for each in steps * self._scale(centre)]
            found = self.scored([replace(each, rests=np.abs(each.rests)) for each in varied], budget, until)
            self.runs += options.members
            if not found or found[0].score <= best.score:
                size *= options.shorter
            if found:
                best = max(best, found[0], key=lambda one: one.score)
                some = [one.moves.parameters for one in found[: options.members // 4]]
                centre = centre.varied(np.mean(some, axis=0) - centre.parameters)
        return best

    def alike(self, one: Candidate, other: Candidate) -> bool:
        """Whether two motions have as many moves from the same side, and reach their goal at about the same time."""
        same = one.moves.side == other.moves.side and one.moves.ends.size == other.moves.ends.size
        return same and abs(one.t - other.t) < OPTIONS.window

    def rollout(self, some: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Aim swings; the least uncertain ones score best, and those count that are less so than any that succeeded."""
        found = list[Candidate]()
        for aim in [self.aimed(each, budget) for each in some]:
            if aim is not None:
                score = 1.0 / (1.0 + self.uncertainty(aim)) if aim.good else aim.score
                found.append(replace(aim, score=score, good=aim.good and score > self._least))
        return found

    def verify(self, one: Candidate, budget: Budget) -> Verified:
        """Simulate moves with the links as planned, with shorter ones, and in scenarios; ends at the first failure."""
        first, finer, probability = self.simulate(self.problem, one, budget), None, None
        message = self.failure(one, first, None)
        if not message:
            finer = self.simulate(self.finer, one, budget)
            message = self.failure(one, finer, first)
            message = message and f"with shorter links {message}"
        if not message:
            probability = self.estimate(one, self.whole or budget)
            message = unlikely(probability)
        if message:
            return Verified(one, first, finer, message)
        self._least = max(self._least, one.score)
        return TipVerified(one, first, finer, "", one.score, probability)

    def aimed(self, found: Candidate, budget: Budget) -> Aim | None:
        """Change moves so that the tip does the task; None if it does nothing of the kind after these."""
        options, begin = OPTIONS, found.moves.cut(found.t + OPTIONS.window, self.problem.limits)

        def fly(aim: Aim, changes: Sequence[Array], later: Sequence[float]) -> list[Aim | None]:
            near = aim.t + np.clip(later, -options.window, options.window)
            return self.aims([aim.moves.varied(each) for each in changes], near, budget)

        (first,) = self.aims([begin], [found.t], budget)
        if first is None:
            return None
        how = options.rounds, options.difference, budget, self.close
        best, varied = shoot(first, self._scale(begin), fly, *how)
        return replace(best, std=self._std(best, varied, budget))

    def _scale(self, moves: Moves) -> Array:
        """Return standard deviations (2 k,) of a random swing's parameters, rad and s."""
        both = [np.pi * OPTIONS.end_spread, self.problem.period * OPTIONS.rest_spread]
        return np.repeat(both, moves.ends.size)

    def _std(self, aim: Aim, varied: Sequence[Aim], budget: Budget) -> float:
        """Return the standard deviation of an aim's place, m, by those with `varied` parameters."""
        rope, options, k, longer = self.problem.rope, OPTIONS, aim.moves.ends.size, 1.0 + OPTIONS.difference
        ropes = [scaled_rope(rope, longer, 1.0, 1.0), scaled_rope(rope, 1.0, 1.0, longer)]
        others = [each or aim for each in self.aims(2 * [aim.moves], 2 * [aim.t], budget, ropes)]
        steps = options.difference * np.append(self._scale(aim.moves), [1.0, 1.0])
        place = np.array([each.place - aim.place for each in (*varied, *others)]) / steps[:, None]
        std = np.array([0.0] * k + [options.timing_std] * k + [options.length_std, options.friction_std])
        return float(np.linalg.norm(place * std[:, None]))

    def aims(
        self, moves: Sequence[Moves], near: Sequence[float] | Array, budget: Budget, ropes: Sequence[Rope] = ()
    ) -> list[Aim | None]:
        """Simulate fine flights; return what the tip does next to times `near`, s. Scores are negative errors, m.

        In each move the rope must keep a distance from obstacles until then, and less where it begins nearer.
        """
        options, fine = OPTIONS, OPTIONS.fine_time
        close = max(fine, min(near) - options.closely)
        coarse = np.arange(options.sample_time, close - fine, options.sample_time)
        t = np.append(coarse, np.arange(close, max(near) + options.window, fine))
        self.runs += len(moves)
        flights = Flights(self.problem, moves, t, budget, tol=options.fine_tol, ropes=ropes)
        obstacles, found = flights.spare_gaps(self.problem), list[Aim | None]()
        for m, one in enumerate(moves):
            if (each := self.event(flights, m, near[m])) is None:
                found.append(None)
                continue
            gaps = np.column_stack([*each.gaps, obstacles[m]])[: each.end + 1]
            spare = np.append(np.full(len(each.gaps), options.spare), self._spare)
            begins = np.searchsorted(t, np.append(0.0, one.starts(self.problem.limits)))
            least = np.minimum.reduceat(gaps, np.minimum(begins, each.end), axis=0)
            required = np.minimum(spare + self.close, np.maximum(gaps[0], 0.0))
            residuals = np.array([*each.residuals, *np.minimum(least - required, 0.0).ravel()])
            error = sum(max(0.0, float(lack)) for lack in (*each.lacks, -gaps.min(initial=0.0)))
            found.append(Aim(one, -error, each.t, error == 0.0, residuals=residuals, place=each.place))
        return found


def unlikely(probability: SuccessProbability | None) -> str:
    """Return why moves with such a success probability are no plan; empty if they may be one, or little is known."""
    if probability is None or probability.samples * LEAST_CHANCE < 1.0 or probability.estimate >= LEAST_CHANCE:
        return ""
    return f"it succeeds in {probability.successes} of {probability.samples} sampled scenarios only"


def ranked(moves: Sequence[Moves], scores: Sequence[tuple[float, float]]) -> list[Candidate]:
    """Return the moves of finite cost, m, with the time, s, at which they do their task: the cheapest first."""
    found = [Candidate(each, -cost, t) for each, (cost, t) in zip(moves, scores, strict=True) if cost < math.inf]
    return sorted(found, key=lambda one: -one.score)


def sample_times(near: float) -> Array:
    """Return the times of a verified run's samples (T,), s, the goal of which is expected at time `near`, s."""
    return OPTIONS.fine_time * np.arange(np.ceil((near + OPTIONS.after) / OPTIONS.fine_time) + 1.0)


def verified_run(
    problem: Problem,
    motion: Motion,
    t: Array,
    budget: Budget | None,
    walls: tuple[Wall, ...] = (),
    *,
    accuracy: Accuracy,
) -> Trajectory | None:
    """Simulate a motion from rest with obstacles and `walls`, with samples at times t (T,), s.

    Returns None if the run fails or begins in an obstacle; raises OutOfTime if it does not end within the budget.
    """
    setup = verified_setup(problem, motion, float(t[-1]), walls, accuracy)
    try:
        return simulate(setup, t_eval=t, time_budget=budget) if starts_outside(setup) else None
    except SimulationError as failed:
        if failed.status == Status.OUT_OF_TIME:
            raise OutOfTime from None
        return None


def touches(run: Trajectory, obstacles: Sequence[Obstacle]) -> tuple[Integers, Integers]:
    """Return the samples since whose predecessor the rope touched an obstacle, (k,), and which one is nearest, (k,).

    The obstacles are all that the rope may touch in the run. A force shows a touch, or a loss of energy while an
    obstacle is as near as a link moves in that time. A loss alone may be that of a joint that comes to its limit.
    """
    gaps = obstacle_gaps(obstacles, run.joints[:, :-1], run.joints[:, 1:]).min(axis=2) - run.rope.radius
    moves = run.rope.joint_velocities(run.q, run.qd, run.base_velocity)[:, 1:]
    reach = TOUCH + np.diff(run.t, prepend=run.t[0]) * np.hypot(moves[..., 0], moves[..., 1]).max(axis=1)
    lost = np.diff(np.asarray(run.contact_loss), prepend=0.0) > 0.0
    pushed = np.abs(np.asarray(run.contact_force)).sum(axis=(1, 2)) > 0.0
    rows = np.flatnonzero((lost & (gaps.min(axis=1) < reach)) | pushed)
    return rows, gaps[rows].argmin(axis=1)


def tip_problem(
    rope: Rope, arm: Arm, limits: MotorLimits | None, conditions: Conditions | None, periods: float
) -> Problem:
    """Return the problem of a task of the tip; its time limit is by default a number of `periods` of the rope's swing.

    Raises InvalidInput if the rope swings at first, or begins in an obstacle on both sides.
    """
    given = conditions or Conditions()
    if given.state0 is not None:
        fix = "Omit state0"
        raise InvalidInput("whips and insertions begin with a rope that hangs", got="state0", fix=fix)
    time = given.time_limit or periods * swing_period(checks.instance("rope", rope, Rope))
    limits = limits or MotorLimits()
    problem = Problem(rope, arm, limits, time, given.clearance, side=given.side, obstacles=given.obstacles)
    check_start(problem)
    return problem


def plan_tip(
    task: TipTask, kind: type[TipPlanT], options: SearchOptions, time_budget: float | Budget | None
) -> TipPlanT:
    """Plan a task of the tip: check the target, search, verify, and estimate the success probability."""
    given = Budget.of(time_budget, threads=options.threads)
    budget, planner, exhausted = given.limit(given.remaining), None, False
    known = TipFeasibility(task.distance, math.inf, "interrupted before the random swings were simulated")
    with stoppable() as stop, budget.progress(options.progress, "planning"):
        begin = budget.elapsed
        known = task.prepare(budget)
        if task.swings and (known.feasible or options.skip_feasibility):
            planner = Planner(task, budget.share(0.8), task.improve, sampling=budget.elapsed - begin)
            planner.run()
            exhausted = not (planner.rolled or planner.budget.expired)
            planner.explain(budget)
    one, best, message = None, None, known.message
    if planner is not None:
        one, best = planner.rolled[0] if planner.rolled else None, planner.best
        ended = "interrupted" if stop.received else "the time budget ended"
        message = f"{ended} before {'any motion was found' if one is None else 'it was verified'}"
    if exhausted:
        message = "no motion was found that brings the tip there"
    elif best is not None:
        one, message = best.candidate, best.message
    plan = kind(
        task.problem,
        task.target,
        known,
        None if one is None else one.moves,
        best and best.outcome,
        best and best.finer_outcome,
        message,
        task.runs,
        budget.elapsed,
        stop.received,
        best.probability if isinstance(best, TipVerified) else None,
        one.std if isinstance(one, Aim) else math.nan,
        exhausted or best is not None,
    )
    return stop.deliver(plan)
