"""Random swings to begin with, and CMA-ES over strokes, about a swing that comes near what a task asks."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Obstacle
from hyperflex.planning.problem import Problem
from hyperflex.planning.search.contact_phase import free_sides
from hyperflex.planning.search.evolution import CmaEs
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.tip.strokes import Strokes
from hyperflex.planning.tip.task import AFTER, Left, TipCandidate, TipTask
from hyperflex.simulation import Batch

COARSE_TOL = 1e-3  # m: of swings in a search
SEED = 1
STROKES, STEPS = (0.3, 1.1), (0.35, 0.65)  # half turns; periods from stroke to stroke: means of random swings
SPREAD_ENDS, SPREAD_RESTS = 0.15, 0.06  # half turns, periods: standard deviations in a random swing
MEMBERS, GENERATIONS = 16, 16  # of a generation; of a search before what it found is aimed
NARROW = 0.3  # step size of CMA-ES about a swing, relative to the standard deviations of random swings


def random_swings(problem: Problem, count: int, walls: Sequence[Obstacle] = ()) -> list[Strokes]:
    """Return strokes that pump a swing up more or less well, the same ones each time.

    They begin on sides on which the rope hangs clear of obstacles and `walls`; on either side where it does on none.
    """
    sides = free_sides(problem, (*problem.obstacles, *walls)) or [-1, 1]
    rng, limits, period = np.random.default_rng(SEED), problem.limits, problem.period
    strokes = []
    for number in range(count):
        side = sides[number % len(sides)]
        stroke, step = np.pi * rng.uniform(*STROKES), period * rng.uniform(*STEPS)
        rest = max(0.0, step - float(limits.fastest_moves([stroke])[0][0]))
        size = max(1, int(np.ceil(problem.time / step)))
        ends = 0.5 * side * np.pi - side * stroke * (np.arange(size) % 2 == 0)
        ends = ends + np.pi * SPREAD_ENDS * rng.standard_normal(size)
        rests = np.abs(rest + period * SPREAD_RESTS * rng.standard_normal(size))
        strokes.append(Strokes(side, ends, rests))
    return strokes


def simulate_swings(
    problem: Problem, strokes: list[Strokes], step: float, threads: int | None = None
) -> tuple[Array, Batch, Array, Array]:
    """Simulate free swings (M) from rest; return times (T,), s, every `step`, s, the runs, and arm angles and rates.

    The last two are (M, T), rad and rad/s.
    """
    t = np.asarray(step * np.arange(round(problem.time / step) + 1.0))
    motions = [each.motion(problem.limits) for each in strokes]
    swings = RolloutBatch.from_start(problem, [problem.rope] * len(motions), [], motions)
    batch = swings.run(problem.arm, t, tol=COARSE_TOL, keep=("tip", "q", "qd"), threads=threads)
    angle, rate = (np.stack(each) for each in zip(*((m.angle(t), m.rate(t)) for m in motions), strict=True))
    return t, batch, angle, rate


class StrokeSearch:
    """CMA-ES over strokes, about a swing that nearly does what a task asks; keeps the best."""

    def __init__(self, task: TipTask[Any], begin: TipCandidate, seed: int = 0, threads: int | None = None) -> None:
        self.task, self.threads = task, threads
        self.best, self._until = begin, begin.t + AFTER
        k = begin.strokes.ends.size
        self._scale = np.repeat([np.pi, task.problem.period], k)
        spread = np.repeat([SPREAD_ENDS, SPREAD_RESTS], k)
        random = np.random.default_rng([SEED, seed])
        self._optimizer = CmaEs(begin.strokes.parameters / self._scale, NARROW, spread, MEMBERS, random)

    def run(self, left: Left) -> TipCandidate:
        """Simulate GENERATIONS unless a swing is ready before or no time is left; return the best so far."""
        for _ in range(GENERATIONS):
            if self.best.cost < self.task.ready or left() < 0.0:
                break
            self.step()
        return self.best

    def step(self) -> float:
        """Simulate one generation; return the least cost so far, m."""
        points = self._optimizer.ask()
        strokes = [self._strokes(x) for x in points]
        cost, t = self.task.score(strokes, self.threads, self._until)
        self._optimizer.tell(points, list(cost))
        self.task.runs += len(points)
        k = int(cost.argmin())
        if cost[k] < self.best.cost:
            self.best = TipCandidate(float(cost[k]), float(t[k]), strokes[k])
        return self.best.cost

    def _strokes(self, x: Array) -> Strokes:
        ends, rests = np.split(np.asarray(x, dtype=np.float64) * self._scale, 2)
        return Strokes(self.best.strokes.side, ends, np.abs(rests))
