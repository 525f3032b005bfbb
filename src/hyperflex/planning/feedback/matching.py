"""How to come back to a plan: change what is left of a throw so that the rope strikes in the planned state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hyperflex.checks import Array
from hyperflex.interfaces import RopeState
from hyperflex.model import Peg, Rope
from hyperflex.planning.cast_setup import Thrower
from hyperflex.planning.robust import scenarios as flights
from hyperflex.planning.robust.uncertainty import Draw
from hyperflex.planning.search import strikes
from hyperflex.planning.search.batch_rollout import Flights
from hyperflex.planning.wind.throw import LEAST_STROKE, Throw

PLACE, SPEED = 0.05, 0.5  # m, m/s: errors of a joint's place and velocity that count one
REST_STEP, STROKE_STEP = 0.01, 0.03  # s, rad, of the differences
REST_SPREAD, STROKE_SPREAD, TIME_SPREAD = 0.15, 0.6, 0.3  # s, rad, s: changes that cost one
ROUNDS = 2  # Gauss-Newton steps
PARTS = (1.0, 0.5, 0.2)  # of each step that are tried
WINDOW = 0.3  # s about the planned strike within which a flight is compared
WAYS = 3  # returned at most


@dataclass(frozen=True, eq=False)
class Goal:
    """The state in which a plan strikes.

    Attributes
    ----------
    t : float
        When, s.
    features : (4 n,) float64
        Places and velocities of the joints, see :func:`features`.
    """

    t: float
    features: Array

    @classmethod
    def of(cls, thrower: Thrower, peg: Peg, throw: Throw) -> Goal | None:
        """Return the goal of a throw, None where it strikes nothing."""
        hang = np.full((1, thrower.rope.n_links), thrower.rope.hanging_angle)
        motion = throw.motion(thrower.limits)
        one = Flights([thrower.rope], [peg], [motion], hang, np.zeros_like(hang))
        t, q, qd, _ = flights.struck(one, thrower.arm, thrower.time)
        if not np.isfinite(t[0]):
            return None
        base = strikes.arm_tip(thrower.arm, motion, t), strikes.arm_tip_velocity(thrower.arm, motion, t)
        return cls(float(t[0]), features(thrower.rope, q, qd, *base)[0])


def features(rope: Rope, q: Array, qd: Array, base: Array, base_velocity: Array) -> Array:
    """Places and velocities of the joints (T, 4 n), scaled so that each mean square error counts alike.

    Parameters
    ----------
    rope : Rope
    q, qd : (T, n) rad, rad/s
    base, base_velocity : (T, 2) m, m/s
    """
    along, across = np.stack([np.sin(q), -np.cos(q)], axis=-1), np.stack([np.cos(q), np.sin(q)], axis=-1)
    places = base[:, None] + np.cumsum(rope.length[:, None] * along, axis=1)
    speeds = base_velocity[:, None] + np.cumsum(rope.length[:, None] * across * qd[..., None], axis=1)
    both = np.concatenate([places / PLACE, speeds / SPEED], axis=2)
    return np.asarray(both.reshape(len(q), -1) / np.sqrt(rope.n_links))


def match(
    thrower: Thrower,
    world: Draw,
    goal: Goal,
    throw: Throw,
    move: int,
    state: RopeState,
    pause: float,
    *,
    threads: int | None = None,
) -> list[Throw]:
    """Change strokes and rests from `move` on, so that the rope of a world comes near the goal from the state seen.

    Gauss-Newton by differences, each difference a free flight, with a cost of changes; the whole may be late.

    Returns
    -------
    list of Throw
        Ways on, the nearest to the goal first; none nearer than that of `throw` is left out.
    """
    work = _Match(thrower, world, goal, move, state, pause, threads)
    x = work.genes(throw)
    misses, rows, drift = work.fly(throw, [x])
    tried = [(misses[0], throw)]
    for _ in range(ROUNDS):
        step = work.steps(x)
        _, moved, _ = work.fly(throw, [x + row for row in np.diag(step)])
        slopes = np.column_stack([((moved - rows[0]) / step[:, None]).T, drift[0]])
        change = np.linalg.lstsq(
            np.vstack([slopes, np.diag(1.0 / work.spreads)]),
            np.concatenate([goal.features - rows[0], np.zeros(work.spreads.size)]),
            rcond=None,
        )[0][:-1]
        points = [work.inside(x + part * change) for part in PARTS]
        misses, rows_new, drifts = work.fly(throw, points)
        tried += [(miss, work.throw(throw, point)) for miss, point in zip(misses, points, strict=True)]
        best = int(np.argmin(misses))
        if misses[best] >= tried[0][0]:
            break
        x, rows, drift = points[best], rows_new[best : best + 1], drifts[best : best + 1]
    ways = sorted((one for one in tried[1:] if one[0] < tried[0][0]), key=lambda one: one[0])
    return [way for _, way in ways[:WAYS]]


def nearest(rows: Array, goal: Array) -> Array:
    """Least squared distance (M,) of paths through rows (M, T, f), straight between them, from a goal (f,)."""
    way = np.diff(rows, axis=1)
    behind = goal - rows[:, :-1]
    part = np.clip((behind * way).sum(axis=2) / np.maximum((way**2).sum(axis=2), 1e-300), 0.0, 1.0)
    return np.asarray(((behind - part[..., None] * way) ** 2).sum(axis=2).min(axis=1))


class _Match:
    """What the flights of one match have in common."""

    def __init__(
        self, thrower: Thrower, world: Draw, goal: Goal, move: int, state: RopeState, pause: float, threads: int | None
    ) -> None:
        self.thrower, self.world, self.goal, self.move, self.state = thrower, world, goal, move, state
        self.pause, self.threads = pause, threads
        self.spreads = np.zeros(0)

    def genes(self, throw: Throw) -> Array:
        """Rests, s, and strokes, rad, that may still be changed (2 k,)."""
        left = slice(self.move, throw.count)
        x = np.concatenate([np.abs(throw.rests[left]), throw.strokes[left]])
        k = x.size // 2
        self.spreads = np.append(np.repeat([REST_SPREAD, STROKE_SPREAD], k), TIME_SPREAD)
        self.least = np.repeat([0.0, LEAST_STROKE], k)
        self.least[0] = min(self.pause, x[0])  # the next move starts no sooner than can be decided
        return x

    def steps(self, x: Array) -> Array:
        """Differences: later, and shorter strokes, since a longer one may be more than the motor's range."""
        return np.repeat([REST_STEP, -STROKE_STEP], x.size // 2)

    def inside(self, x: Array) -> Array:
        return np.asarray(np.maximum(x, self.least))

    def throw(self, throw: Throw, x: Array) -> Throw:
        """Return the throw with what is left of it replaced."""
        rests, strokes = throw.rests.copy(), throw.strokes.copy()
        k = x.size // 2
        rests[self.move : throw.count], strokes[self.move : throw.count] = x[:k], x[k:]
        return replace(throw, rests=rests, strokes=strokes)

    def fly(self, throw: Throw, points: list[Array]) -> tuple[Array, Array, Array]:
        """Fly points; return how far each misses the goal (M,), features at the goal's time and their rates."""
        thrower, rope, since = self.thrower, self.world.rope, self.state.t
        motions = [self.world.motion(self.throw(throw, x), thrower).shifted(-since) for x in points]
        count, n = len(points), self.state.q.size
        start = [np.broadcast_to(part, (count, n)) for part in (self.state.q, self.state.qd)]
        peg: list[Peg] = []
        batch = Flights([rope] * count, peg, motions, start[0], start[1], since)
        t, q, qd = flights.fly(batch, thrower.arm, self.goal.t - since + WINDOW, threads=self.threads)
        near = np.flatnonzero(np.abs(t + since - self.goal.t) <= WINDOW)
        at = int(np.abs(t[near] + since - self.goal.t).argmin())
        rows = np.stack(
            [
                features(
                    rope,
                    q[m, near],
                    qd[m, near],
                    strikes.arm_tip(thrower.arm, motion, t[near]),
                    strikes.arm_tip_velocity(thrower.arm, motion, t[near]),
                )
                for m, motion in enumerate(motions)
            ]
        )
        rows = np.nan_to_num(rows, nan=1e3)
        miss = nearest(rows, self.goal.features)
        after = min(at + 1, near.size - 1)
        drift = (rows[:, after] - rows[:, after - 1]) / (t[1] - t[0])
        return miss, rows[:, at], drift
