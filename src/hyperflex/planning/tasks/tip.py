"""Motions after which the tip does something at one instant: what whips and insertions have in common.

Random swings are simulated coarsely. The most promising ones are aimed: Levenberg and Marquardt on the arm's angles and
rests, with differences of free flights, until the tip does what the task requires and the rope touches no obstacle.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.budget import Budget, OutOfTime
from hyperflex.checks import Array
from hyperflex.control import swing_period
from hyperflex.errors import InvalidInput, SimulationError
from hyperflex.interruption import Stop
from hyperflex.model import DAMPING, Arm, Obstacle, Rope, Setup, Wall
from hyperflex.planning.clearance import gap_of, obstacle_gaps
from hyperflex.planning.evolution import CmaEs
from hyperflex.planning.moves import Moves
from hyperflex.planning.options import Conditions, MotorLimits
from hyperflex.planning.plan import Plan
from hyperflex.planning.planner import Planner
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import RolloutBatch, check_start, free_sides
from hyperflex.planning.tasks.task import Candidate, Task, Verified
from hyperflex.planning.verification import (
    clearances,
    folded_flat,
    greatest_bend,
    motor_torques,
    refusal,
    verified_setup,
)
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
    rounds : int
        Steps of an aim.
    damping : (float, float, float)
        First, least and greatest damping of a step, relative to the greatest singular value of the Jacobian.
    longest : float
        Longest change of an angle or rest in a step, in standard deviations of random swings.
    difference : float
        Change for the derivatives, in the same unit.
    friction_std, length_std, timing_std : float
        Standard deviations of the rope's friction and length, relative, and of each rest, s, from which that of the
        tip's place follows.
    spare : float
        Distance, m, that the rope shall keep from obstacles beyond the required clearance, where target and start
        allow it.
    members, generations, narrow : (int, int, float)
        Of a search by CMA-ES about a swing, whose first step is `narrow` standard deviations of random swings.
    """

    swings: int = 512
    batch: int = 64
    stroke: tuple[float, float] = (0.3, 1.1)
    step: tuple[float, float] = (0.35, 0.65)
    end_spread: float = 0.15
    rest_spread: float = 0.06
    sample_time: float = 0.01
    tol: float = 1e-3
    max_cost: float = 0.12
    fine_time: float = 2e-3
    fine_tol: float = 1e-6
    window: float = 0.12
    closely: float = 0.4
    rounds: int = 16
    damping: tuple[float, float, float] = (2e-3, 1e-4, 3.0)
    longest: float = 0.6
    difference: float = 1e-3
    friction_std: float = 0.05
    length_std: float = 0.002
    timing_std: float = 2e-3
    spare: float = 0.01
    members: int = 16
    generations: int = 16
    narrow: float = 0.3


OPTIONS = TipOptions()
T = TypeVar("T")


class Flights:
    """Free flights (M) after moves of the arm, at times `t` (T,), s; from row `first` on the times are evenly spaced.

    Places of the `joints` and the tip (M, T, n + 1, 2), m, and `velocity` of the tip (M, T, 2), m/s; NaN where a flight
    failed.
    """

    def __init__(
        self,
        problem: Problem,
        moves: Sequence[Moves],
        t: Array,
        *,
        tol: float = OPTIONS.tol,
        first: int = 0,
        ropes: Sequence[Rope] = (),
        budget: Budget | None = None,
    ) -> None:
        self.moves, self.t, self.first, self.ropes = moves, t, first, ropes or [problem.rope] * len(moves)
        motions = [each.motion(problem.limits) for each in moves]
        batch = RolloutBatch.from_start(problem, self.ropes, [], motions)
        threads = None if budget is None else budget.threads
        run = batch.run(problem.arm, t, tol=tol, keep=("q", "qd"), threads=threads)
        self.q, qd = run.q, run.qd
        angle, rate = (np.stack(each) for each in zip(*((m.angle(t), m.rate(t)) for m in motions), strict=True))
        length, sin, cos = np.stack([rope.length for rope in self.ropes])[:, None], np.sin(self.q), np.cos(self.q)
        self.joints = np.empty((*self.q.shape[:2], problem.rope.n_links + 1, 2))
        self.joints[:, :, 0] = problem.arm.tip(angle)
        for axis, part in enumerate((length * sin, -length * cos)):
            np.cumsum(part, axis=2, out=self.joints[:, :, 1:, axis])
            self.joints[:, :, 1:, axis] += self.joints[:, :, :1, axis]
        arm = problem.arm.length * rate
        along = [(length * qd * part).sum(axis=2) for part in (cos, sin)]
        self.velocity = np.stack([along[0] + arm * np.cos(angle), along[1] + arm * np.sin(angle)], axis=-1)

    def spare_gaps(self, problem: Problem) -> Array:
        """Return gaps (M, T, w), m, of the ropes from w obstacles beyond the required clearance; see `signed_gaps`."""
        if not problem.obstacles:
            return np.zeros((*self.q.shape[:2], 0))
        gaps = [signed_gaps(problem.obstacles, each[:, :-1], each[:, 1:]).min(axis=-1) for each in self.joints]
        return np.nan_to_num(np.array(gaps) - problem.rope.radius - max(problem.clearance, 0.0))

    def blocked(self, problem: Problem) -> Array:
        """Return how far, m, the ropes have come too near obstacles until each sample, or through them: (M, T)."""
        depth = -self.spare_gaps(problem).min(axis=2, initial=0.0)
        return np.maximum.accumulate(depth, axis=1)


def random_swings(problem: Problem, count: int, walls: Sequence[Obstacle] = (), seed: int = 1) -> list[Moves]:
    """Return moves that pump a swing up more or less well, the same ones for a seed.

    They begin on sides on which the rope hangs clear of obstacles and `walls`; on either side if there is none.
    """
    sides = free_sides(problem, (*problem.obstacles, *walls)) or [-1, 1]
    rng, period, found = np.random.default_rng(seed), problem.period, list[Moves]()
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


def signed_gaps(obstacles: Sequence[Obstacle], begin: Array, end: Array) -> Array:
    """Distances (..., w, n), m, of the links of a rope from `begin` to `end` (..., n, 2) from w obstacles, < 0 inside.

    For a link through a wall the depth is the distance along the wall from the crossing to the nearer end of the wall,
    or the length of the rope's end beyond it if that is less. It tells a search how far it is from a swing that does
    not touch the wall.
    """
    gaps = obstacle_gaps(obstacles, begin, end)
    for k, wall in enumerate(obstacles):
        rows = np.nonzero(gaps[..., k, :] == 0.0)
        if isinstance(wall, Wall) and rows[0].size:
            size = np.hypot(*np.moveaxis(end - begin, -1, 0))
            beyond = np.cumsum(size[..., ::-1], axis=-1)[..., ::-1]  # of the rope, from the beginning of each link
            corner, way = np.array([wall.x, wall.y]), np.array([wall.x2 - wall.x, wall.y2 - wall.y])
            normal, length = np.array([-way[1], way[0]]), float(np.hypot(*way))
            low, high = (begin[rows] - corner) @ normal, (end[rows] - corner) @ normal
            part = np.clip(low / np.where(low == high, 1.0, low - high), 0.0, 1.0)
            crossing = begin[rows] + part[:, None] * (end - begin)[rows]
            along = np.clip((crossing - corner) @ way / length, 0.0, length)
            depth = np.minimum(np.minimum(along, length - along), beyond[rows] - part * size[rows])
            gaps[(*rows[:-1], np.full(rows[0].size, k), rows[-1])] = -depth
    return gaps


@dataclass(frozen=True, eq=False)
class Aim:
    """Moves, and what the tip does after them in a free flight.

    Attributes
    ----------
    moves : Moves
    t : float
        The instant that counts, s.
    residuals : (m,) float64
        What an aim reduces to 0, m.
    place : (p,) float64
        Coordinates whose standard deviation counts, m.
    shortfall : float
        By how much the moves fail, m; 0 if they do not.
    std : float
        Standard deviation of the place, m: :attr:`TipOptions.friction_std` and the following, by the delta method.
    """

    moves: Moves
    t: float
    residuals: Array
    place: Array
    shortfall: float
    std: float = np.nan

    @property
    def distance(self) -> float:
        """Norm of the residuals, m."""
        return float(np.linalg.norm(self.residuals))


@dataclass(frozen=True, eq=False, kw_only=True)
class AimedCandidate(Candidate):
    """A candidate whose moves were aimed."""

    aim: Aim


class TipTask(Task):
    """A task of the tip.

    Attributes
    ----------
    close, ready : float
        Distance, m, at which an aim ends; cost, m, below which a swing is aimed at once.
    swings : list of Candidate
        Random swings with their scores, the negative costs, m.
    """

    close: float
    ready: float

    def __init__(self, problem: Problem, places: Array, seed: int = 0) -> None:
        self.problem, self.seed, self.swings = problem, seed, list[Candidate]()
        needed = problem.rope.radius + max(problem.clearance, 0.0)
        left = [min(gap_of(each, *place) for place in places) - needed for each in problem.obstacles]
        self._spare = np.clip(0.5 * np.array(left), 0.0, OPTIONS.spare)  # half of what the target leaves, at most
        self._searches, self._given, self._begun = 0, False, list[tuple[Candidate, int]]()

    @abstractmethod
    def score(self, flights: Flights) -> list[tuple[float, float]]:
        """Return the cost, m, of coarse flights, and the time, s, at which the tip nearly does the task; inf: never."""

    @abstractmethod
    def aims(self, flights: Flights, near: Sequence[float]) -> list[Aim | None]:
        """Return what the tip does next to times `near`, s, in fine flights."""

    def swing(self, moves: Sequence[Moves], budget: Budget) -> None:
        """Score random swings in batches until the budget expires, one batch at least; keep them, the best first."""
        options, found = OPTIONS, list[Candidate]()
        t = np.arange(0.0, self.problem.time + 0.5 * options.sample_time, options.sample_time)
        for low in range(0, len(moves), options.batch):
            if low and budget.expired:
                break
            some = moves[low : low + options.batch]
            costs = self.score(Flights(self.problem, some, t, budget=budget))
            found += [Candidate(each, -cost, at) for each, (cost, at) in zip(some, costs, strict=True)]
        self.swings = sorted((each for each in found if np.isfinite(each.score)), key=lambda one: -one.score)

    def alike(self, one: Candidate, other: Candidate) -> bool:
        """Whether two motions have as many moves from the same side, and reach their goal at about the same time."""
        same = one.moves.side == other.moves.side and one.moves.ends.size == other.moves.ends.size
        return same and abs(one.t - other.t) < OPTIONS.window

    def uncertainty(self, aim: Aim) -> float:
        """Return how uncertain moves are that do not fail; of several the least uncertain ones are verified first."""
        return aim.std

    def start(self, number: int) -> Candidate | None:
        """Return the swing about which search number `number` is made; None without one."""
        return self.swings[number] if number < len(self.swings) else None

    def freed(self, found: Candidate, rounds: int) -> Candidate:
        """Return the swing with which a search begins that continues one of so many `rounds`."""
        return found

    def sample(self, found: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Return the random swings; then results of searches by CMA-ES about one after the other.

        After each of them the best one that gained a tenth of its cost is continued.
        """
        if not self._given:
            self._given = True
            return self.swings
        begin = self.start(self._searches)
        self._searches += 1
        self._begun.sort(key=lambda each: -each[0].score)
        best, self._begun = self._begun[:1], self._begun[1:]
        results = list[Candidate]()
        for each, rounds in [*([] if begin is None else [(begin, 0)]), *best]:
            free = self.freed(each, rounds)
            result = self._evolved(free, budget)
            results.append(result)
            if -self.ready > result.score > 0.9 * free.score:
                self._begun.append((result, rounds + 1))
        return results

    def _evolved(self, begin: Candidate, budget: Budget) -> Candidate:
        """Return the best swing of a search by CMA-ES about a swing."""
        options, best, k = OPTIONS, begin, begin.moves.ends.size
        scale = np.repeat([np.pi, self.problem.period], k)
        spread = np.repeat([options.end_spread, options.rest_spread], k)
        random = np.random.default_rng([1, self.seed, self.runs])
        optimizer = CmaEs(begin.moves.parameters / scale, options.narrow, spread, options.members, random)
        t = np.arange(0.0, min(self.problem.time, begin.t + 0.3), options.sample_time)
        for _ in range(options.generations):
            if best.score > -self.ready:
                break
            budget.check()
            points = optimizer.ask()
            moves = [
                replace(begin.moves, ends=x[:k] * np.pi, rests=np.abs(x[k:]) * self.problem.period) for x in points
            ]
            scored = self.score(Flights(self.problem, moves, t, budget=budget))
            self.runs += len(moves)
            optimizer.tell(points, [min(cost, 10.0) for cost, _ in scored])
            cost, at, number = min((*pair, number) for number, pair in enumerate(scored))
            if -cost > best.score:
                best = Candidate(moves[number], -cost, at)
        return best

    def rollout(self, some: Sequence[Candidate], budget: Budget) -> list[Candidate]:
        """Aim swings."""
        found = [aim for each in some if (aim := self.aimed(each, budget)) is not None]
        return [
            AimedCandidate(
                aim.moves,
                1.0 / (1.0 + self.uncertainty(aim)) if aim.shortfall == 0.0 else -aim.shortfall,
                aim.t,
                good=aim.shortfall == 0.0,
                aim=aim,
            )
            for aim in found
        ]

    def aimed(self, found: Candidate, budget: Budget) -> Aim | None:
        """Change moves so that the tip does the task; None if it does nothing of the kind after these."""
        options, begin = OPTIONS, found.moves.cut(found.t + OPTIONS.window, self.problem.limits)
        (best,) = self._fly([begin], [found.t], budget)
        if best is None:
            return None
        damping, least, most = options.damping
        best, jacobian, later = self._derivatives(best, budget)
        scale = self._scale(best.moves)
        for _ in range(options.rounds):
            if best.distance < self.close or damping > most:
                break
            budget.check()
            left, size, right = np.linalg.svd(jacobian * scale, full_matrices=False)
            tried, near = list[Moves](), list[float]()
            dampings = [damping / 4.0, damping, 5.0 * damping]
            for each in dampings:
                kept = size / np.maximum(size**2 + (each * size[0]) ** 2, 1e-300)
                step = -right.T @ (kept * (left.T @ best.residuals))
                step = scale * step / max(1.0, float(np.abs(step).max()) / options.longest)
                tried.append(best.moves.varied(step))
                near.append(best.t + float(np.clip(later @ step, -options.window, options.window)))
            aims = self._fly(tried, near, budget)
            k = int(np.argmin([np.inf if aim is None else aim.distance for aim in aims]))
            if (better := aims[k]) is None or better.distance >= best.distance:
                damping *= 25.0
                continue
            damping = max(dampings[k], least)
            best, jacobian, later = self._derivatives(better, budget)
        return best

    def verify_best(self, planner: Planner, budget: Budget) -> None:
        """Verify the best aim if no candidate of a planner was worth it: its runs show why it fails."""
        if planner.best is None and planner.rolled and not budget.expired:
            planner.best = self.verify(planner.rolled[0], budget)

    def _scale(self, moves: Moves) -> Array:
        """Return standard deviations (2 k,) of a random swing's parameters, rad and s."""
        both = [np.pi * OPTIONS.end_spread, self.problem.period * OPTIONS.rest_spread]
        return np.repeat(both, moves.ends.size)

    def _fly(
        self, moves: Sequence[Moves], near: Sequence[float], budget: Budget, ropes: Sequence[Rope] = ()
    ) -> list[Aim | None]:
        """Simulate fine flights, and return what the tip does next to times `near`, s."""
        fine, close = OPTIONS.fine_time, max(OPTIONS.fine_time, min(near) - OPTIONS.closely)
        coarse = np.arange(OPTIONS.sample_time, close - fine, OPTIONS.sample_time)
        t = np.append(coarse, np.arange(close, max(near) + OPTIONS.window, fine))
        self.runs += len(moves)
        flights = Flights(self.problem, moves, t, tol=OPTIONS.fine_tol, first=coarse.size, ropes=ropes, budget=budget)
        return self.aims(flights, near)

    def _derivatives(self, aim: Aim, budget: Budget) -> tuple[Aim, Array, Array]:
        """Return an aim with its `std`, and the derivatives of residuals (m, P) and of `t` (P,) by its parameters."""
        rope, options, k = self.problem.rope, OPTIONS, aim.moves.ends.size
        steps = options.difference * self._scale(aim.moves)
        longer = 1.0 + options.difference
        ropes = [rope] * steps.size + [
            rope.replace(length=longer * rope.length, com=longer * rope.com, inertia=longer**2 * rope.inertia),
            rope.replace(**{name: longer * getattr(rope, name) for name in DAMPING}),
        ]
        moves = [aim.moves.varied(row) for row in np.diag(steps)] + 2 * [aim.moves]
        found = [each or aim for each in self._fly(moves, [aim.t] * len(moves), budget, ropes)]
        steps = np.append(steps, np.full(2, options.difference))
        place = np.array([each.place - aim.place for each in found]) / steps[:, None]
        std = np.concatenate([np.zeros(k), np.full(k, options.timing_std), [options.length_std, options.friction_std]])
        aim = replace(aim, std=float(np.sqrt(((place * std[:, None]) ** 2).sum())))
        changes = np.array([np.append(each.residuals - aim.residuals, each.t - aim.t) for each in found[:-2]])
        changes = changes.T / steps[:-2]
        return aim, changes[:-1], changes[-1]

    def lacking_gaps(self, flights: Flights, gaps: Array, spare: Array, number: int, row: int) -> Array:
        """Return by how much gaps (T, w), m, lack a `spare` distance (w,), m, until a row: for each move and each gap.

        Less is required where the rope begins nearer.
        """
        starts = flights.moves[number].starts(self.problem.limits)
        begin = np.minimum(np.searchsorted(flights.t, np.append(0.0, starts)), row)
        least = np.minimum.reduceat(gaps[: row + 1], begin, axis=0)
        required = np.minimum(spare, np.maximum(gaps[0], 0.0))
        return np.asarray(np.minimum(least - required, 0.0)).ravel()


@dataclass(frozen=True)
class TipFeasibility:
    """Result of the feasibility check of a task of the tip.

    `distance` is that of the tip's place from the arm's pivot, m. `cost`, m, is that of the cheapest random swing, at
    most :attr:`TipOptions.max_cost`. `message` is the reason why the task is not feasible.
    """

    distance: float
    cost: float
    message: str

    @property
    def feasible(self) -> bool:
        """Whether the task is feasible."""
        return not self.message


@dataclass(frozen=True, eq=False, kw_only=True)
class TipOutcome:
    """What the tip does in a simulated run.

    Attributes
    ----------
    t : float
        The instant that counts, s.
    place, velocity : (2,) float64
        Of the tip then, m, m/s.
    max_bend, folded, clearance, torque, torque_peak
        As of :class:`CastOutcome`, until the run ends; for a whip, obstacles count for `clearance` until `t`.
    refused : str
        Why the run is refused whatever its goal: the rope goes through itself, arm or shaft, or touches an obstacle, or
        comes nearer than allowed; empty if it does not.
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


class TipPlan(Plan):
    """A planned motion of the tip; `moves` are the best found, or None."""

    walls: tuple[Wall, ...] = ()

    @property
    def refuted(self) -> bool:
        """Whether a simulated run shows that the plan fails."""
        return self.outcome is not None and not self.success

    def setup(self) -> Setup:
        """Return the set-up of a run until after the instant that counts, with the walls.

        Until the arm stops if nothing was verified.
        """
        motion = self.required(self.motion, "motion")
        end = float(motion.breaks[-1]) if self.outcome is None else float(sample_times(self.outcome.t)[-1])
        return verified_setup(self.problem, motion, end, self.walls)

    def summary(self) -> dict[str, Any]:
        """Return the plan in figures, for JSON: its fields, and each move's start, s, and the arm's angles, rad."""
        if self.moves is None:
            return super().summary()
        limits = self.problem.limits
        return super().summary() | {"starts": self.moves.starts(limits), "angles": self.moves.angles(limits)}


def sample_times(near: float, after: float = 0.15, step: float = 2e-3) -> Array:
    """Return the times of a verified run's samples (T,), s, until `after` the expected time `near`, s."""
    return np.asarray(step * np.arange(np.ceil((near + after) / step) + 1.0))


def simulate_in_time(setup: Setup, t: Array, budget: Budget | None) -> Trajectory | None:
    """Simulate a set-up; None if the run fails. Raises OutOfTime if it does not end within the budget."""
    try:
        return simulate(setup, t_eval=t, time_budget=budget)
    except SimulationError as failed:
        if failed.status == Status.OUT_OF_TIME:
            raise OutOfTime from None
        return None


def run_figures(problem: Problem, run: Trajectory, until: float = np.inf) -> dict[str, Any]:
    """Return the figures of a whole run for a :class:`TipOutcome`; obstacles count `until` a time, s."""
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

    A force shows a touch, or a loss of energy while an obstacle is as near as a link moves in that time. A loss alone
    may be that of a joint that comes to its limit.
    """
    near = obstacle_gaps(obstacles, run.joints[:, :-1], run.joints[:, 1:]).min(axis=(1, 2)) - run.setup.rope.radius
    across = np.stack([np.cos(run.q), np.sin(run.q)], axis=-1)
    ends = run.base_velocity[:, None] + np.cumsum((run.setup.rope.length * run.qd)[..., None] * across, axis=1)
    reach = TOUCH + np.diff(run.t, prepend=run.t[0]) * np.hypot(ends[..., 0], ends[..., 1]).max(axis=1)
    lost = np.diff(np.asarray(run.contact_loss), prepend=0.0) > 0.0
    return np.asarray((lost & (near < reach)) | (np.abs(np.asarray(run.contact_force)).sum(axis=(1, 2)) > 0.0))


def excess_torque(problem: Problem, torque: float) -> str:
    """Return that a run needs more `torque`, N m, than the motor gives; empty if it does not."""
    given = problem.limits.torque
    return "" if torque <= given else f"it needs {torque:.3g} N m of a motor that gives {given:.3g}"


def given_or_default(name: str, given: T | None, kind: type[T]) -> T:
    """Return an argument of a `kind`, by default an instance with default values; InvalidInput if it is another."""
    return kind() if given is None else checks.instance(name, given, kind)


def tip_problem(rope: Rope, arm: Arm, limits: MotorLimits | None, conditions: Conditions, periods: float) -> Problem:
    """Return the problem of a task of the tip; its time limit is by default a number of `periods` of the rope's swing.

    Raises InvalidInput if the rope swings at first, or begins in an obstacle on both sides.
    """
    if conditions.state0 is not None:
        fix = "Leave out state0"
        raise InvalidInput("whips and insertions begin with a rope that hangs", got="state0", fix=fix)
    checks.instance("rope", rope, Rope)
    time = conditions.time_limit or periods * swing_period(rope)
    clearance, obstacles = conditions.clearance, conditions.obstacles
    limits = given_or_default("limits", limits, MotorLimits)
    problem = Problem(rope, arm, limits, time, clearance, side=conditions.side, obstacles=obstacles)
    check_start(problem)
    return problem


def plan_fields(planner: Planner | None, message: str, nothing: str, stop: Stop, budget: Budget) -> dict[str, Any]:
    """Return the fields of a plan: of the best moves, verified or not.

    Its message is `message` without a search, and `nothing` where a search found none.
    """
    fields: dict[str, Any] = {"message": message, "interrupted": stop.received, "seconds": budget.elapsed}
    if planner is None:
        return fields
    best = planner.best or next((Verified(one, None, None, "") for one in planner.rolled), None)
    if best is None:
        nothing = "interrupted before any motion was found" if stop.received else nothing
        return fields | {"message": nothing, "runs": planner.task.runs}
    ended = "interrupted" if stop.received else "the time budget ended"
    message = best.message if planner.best is not None else f"{ended} before it was verified"
    aim = best.candidate.aim if isinstance(best.candidate, AimedCandidate) else None
    return fields | {
        "message": message,
        "runs": planner.task.runs,
        "moves": best.candidate.moves,
        "position_std": np.nan if aim is None else aim.std,
        "outcome": best.outcome,
        "finer_outcome": best.finer_outcome,
    }
