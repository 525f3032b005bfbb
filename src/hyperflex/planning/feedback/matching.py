"""Corrections of the rest of a throw, by Gauss-Newton, so that the rope strikes in the planned state."""

from dataclasses import dataclass, replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.interfaces import RopeState
from hyperflex.model import Peg, Rope
from hyperflex.planning.problem import Problem
from hyperflex.planning.robust.scenario_rollouts import first_strikes, free_flight
from hyperflex.planning.robust.uncertainty import Scenario
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.search.strikes import arm_tip
from hyperflex.planning.throw import MIN_STROKE, Throw

POSITION_SCALE, SPEED_SCALE = 0.05, 0.5  # m, m/s: errors of a joint's position and velocity that count one
REST_STEP, STROKE_STEP = 0.01, 0.03  # s, rad, of the finite differences
REST_SCALE, STROKE_SCALE, TIME_SCALE = 0.15, 0.6, 0.3  # s, rad, s: changes that cost one
ROUNDS = 2  # Gauss-Newton steps
FRACTIONS = (1.0, 0.5, 0.2)  # of each step that are tried
WINDOW = 0.3  # s about the planned strike within which a flight is compared
MAX_THROWS = 3  # returned


@dataclass(frozen=True, eq=False)
class Goal:
    """The planned state at the strike: its time `t`, s, and `features` (4 n,) of the joints, see :func:`features`."""

    t: float
    features: Array

    @classmethod
    def of(cls, problem: Problem, peg: Peg, throw: Throw) -> "Goal | None":
        """Return the goal of a throw; None without a strike."""
        motion = throw.motion(problem.limits)
        one = RolloutBatch.from_start(problem, [problem.rope], [peg], [motion])
        t, q, qd, _ = first_strikes(one, problem)
        if not np.isfinite(t[0]):
            return None
        return cls(float(t[0]), features(problem.rope, q, qd, *arm_tip(problem.arm, motion, t))[0])


def features(rope: Rope, q: Array, qd: Array, base: Array, base_velocity: Array) -> Array:
    """Positions and velocities of the joints (T, 4 n), scaled by POSITION_SCALE, SPEED_SCALE and 1 / sqrt(n).

    `q`, rad, and `qd`, rad/s, are (T, n); `base`, m, and `base_velocity`, m/s, of the first joint (T, 2).
    """
    along, across = np.stack([np.sin(q), -np.cos(q)], axis=-1), np.stack([np.cos(q), np.sin(q)], axis=-1)
    places = base[:, None] + np.cumsum(rope.length[:, None] * along, axis=1)
    speeds = base_velocity[:, None] + np.cumsum(rope.length[:, None] * across * qd[..., None], axis=1)
    both = np.concatenate([places / POSITION_SCALE, speeds / SPEED_SCALE], axis=2)
    return np.asarray(both.reshape(len(q), -1) / np.sqrt(rope.n_links))


def match(
    problem: Problem,
    scenario: Scenario,
    goal: Goal,
    throw: Throw,
    move: int,
    state: RopeState,
    pause: float,
    *,
    threads: int | None = None,
) -> list[Throw]:
    """Change the strokes and rests of a throw from `move` on, so that the rope comes near the goal.

    The rope is simulated in one `scenario` from the observed `state`; `pause` is the least rest before that move, s.
    Returns changed throws, the nearest to the goal first, all nearer than `throw`.

    Notes
    -----
    Gauss-Newton with finite differences, each a free flight. Changes have a quadratic cost; a delay of the whole costs
    as well.
    """
    work = _Match(problem, scenario, goal, move, state, pause, threads)
    x = work.parameters(throw)
    misses, rows, drift = work.simulate(throw, [x])
    tried = [(misses[0], throw)]
    for _ in range(ROUNDS):
        step = np.repeat([REST_STEP, -STROKE_STEP], x.size // 2)  # longer strokes may leave the motor's range
        _, moved, _ = work.simulate(throw, [x + row for row in np.diag(step)])
        jacobian = np.column_stack([((moved - rows[0]) / step[:, None]).T, drift[0]])
        change = np.linalg.lstsq(
            np.vstack([jacobian, np.diag(1.0 / work.scales)]),
            np.concatenate([goal.features - rows[0], np.zeros(work.scales.size)]),
            rcond=None,
        )[0][:-1]
        points = [np.maximum(x + part * change, work.least) for part in FRACTIONS]
        misses, rows_new, drifts = work.simulate(throw, points)
        tried += [(miss, work.throw(throw, point)) for miss, point in zip(misses, points, strict=True)]
        best = int(np.argmin(misses))
        if misses[best] >= tried[0][0]:
            break
        x, rows, drift = points[best], rows_new[best : best + 1], drifts[best : best + 1]
    better = sorted((one for one in tried[1:] if one[0] < tried[0][0]), key=lambda one: one[0])
    return [changed for _, changed in better[:MAX_THROWS]]


def squared_distance(rows: Array, goal: Array) -> Array:
    """Least squared distance (M,) of polylines through rows (M, T, f) from a goal (f,)."""
    way = np.diff(rows, axis=1)
    behind = goal - rows[:, :-1]
    part = np.clip((behind * way).sum(axis=2) / np.maximum((way**2).sum(axis=2), 1e-300), 0.0, 1.0)
    return np.asarray(((behind - part[..., None] * way) ** 2).sum(axis=2).min(axis=1))


@dataclass
class _Match:
    """The problem of one match: its parameters x (2 k,) are the rests, s, and strokes, rad, from `move` on."""

    problem: Problem
    scenario: Scenario
    goal: Goal
    move: int
    state: RopeState
    pause: float
    threads: int | None

    def parameters(self, throw: Throw) -> Array:
        """Return the parameters of a throw; sets their scales and least values."""
        left = slice(self.move, throw.count)
        x = np.concatenate([np.abs(throw.rests[left]), throw.strokes[left]])
        k = x.size // 2
        self.scales = np.append(np.repeat([REST_SCALE, STROKE_SCALE], k), TIME_SCALE)
        self.least = np.repeat([0.0, MIN_STROKE], k)
        self.least[0] = min(self.pause, x[0])  # time for the decision
        return x

    def throw(self, throw: Throw, x: Array) -> Throw:
        """Return the throw with parameters x."""
        rests, strokes = throw.rests.copy(), throw.strokes.copy()
        k = x.size // 2
        rests[self.move : throw.count], strokes[self.move : throw.count] = x[:k], x[k:]
        return replace(throw, rests=rests, strokes=strokes)

    def simulate(self, throw: Throw, points: list[Array]) -> tuple[Array, Array, Array]:
        """Simulate points (M); return squared distances from the goal (M,), features at its time, and their rates."""
        problem, rope, since = self.problem, self.scenario.rope, self.state.t
        motions = [self.scenario.motion(self.throw(throw, x), problem) for x in points]
        batch = RolloutBatch.from_state([rope] * len(points), [], motions, self.state)
        t, q, qd = free_flight(batch, problem.arm, self.goal.t - since + WINDOW, threads=self.threads)
        near = np.flatnonzero(np.abs(t + since - self.goal.t) <= WINDOW)
        at = int(np.abs(t[near] + since - self.goal.t).argmin())
        rows = np.stack(
            [
                features(rope, q[m, near], qd[m, near], *arm_tip(problem.arm, motion, t[near]))
                for m, motion in enumerate(batch.motions)
            ]
        )
        rows = np.nan_to_num(rows, nan=1e3)
        miss = squared_distance(rows, self.goal.features)
        after = min(at + 1, near.size - 1)
        drift = (rows[:, after] - rows[:, after - 1]) / (t[1] - t[0])
        return miss, rows[:, at], drift
