"""Rollouts in batch: free flight to the first strike on a peg, and contact from there, with their scores.

Free flights simulate no contact: a swing costs milliseconds. Runs in contact are coarse, and end as soon as the rope
cannot be wound any more.
"""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from hyperflex import winding
from hyperflex.budget import Budget
from hyperflex.checks import Array, Integers
from hyperflex.core.batch import proximity
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import RopeState
from hyperflex.model import Arm, Obstacle, Peg, Rope, Setup, named
from hyperflex.motion import Motion
from hyperflex.planning.clearance import (
    clear_samples,
    sampled_clearance,
    sampled_obstacle_gaps,
    samples_clear_of_arm,
    way_gaps,
)
from hyperflex.planning.problem import Problem
from hyperflex.planning.verification import FOLD, at_limits, limit_bend
from hyperflex.simulation import Batch, check_outside, simulate, simulate_batch
from hyperflex.trajectory import State, interpolated


@dataclass(frozen=True)
class RolloutModel:
    """How coarse rollouts are, and how they are scored. Lengths in m, times in s.

    Parameters
    ----------
    step, tol : float
        Between samples of a free flight, and its tolerance; with 1e-3 the best swings of a search were often errors.
    stiction : float
        Stiction tolerance (:func:`hyperflex.simulate_batch`) over the mean length of links, rad/(s m), in the free
        flights of searches and of the scenarios that they compare. All other flights have joints that stick. Of 12
        strikes on one target that wound with 0.15, 0.5, 1.5 and 5, 12, 11, 4 and 3 wound with stiction; a longer rope
        flew 55, 76 and 97 rollouts a second with the first three (random ropes 0 and 1 of seed 4302). On a fresh seed,
        4304, 12 of 12 did with 0.5.
    near : float
        Gap between rope and peg below which a free flight strikes.
    contact_tol, contact_step : float
        Tolerance and step of runs in contact; coarser runs of wound ropes took longer.
    swing_step : float
        The step of swings in contact: two searches found the same swings as with half of it, in 0.6 of the time, one
        of them none with twice as much.
    poll, look : float
        Between two checks of the distance from arm and obstacles in contact, and length of the parts in which a run is
        simulated: one whose rope was too near them in a part, and made the turns required, ends with it. The runs of
        six ropes took 0.53 to 1.0 of the time.
    max_ratio, max_tail : float
        Energy ratio of a strike, and turns of its tail, above which more does not count.
    hanging_tail : float
        Turns of the tail that hang from the peg in the end.
    folded : float
        Factor of the score of a swing in which the rope folds flat: what it does then is left to chance.
    sweep, sweep_turns : float
        A run in contact ends that makes fewer turns until so many sqrt(length / g): of 2,423 runs 141 wound in the end,
        12 of these had fewer, and 57 % of all simulated time came later.
    check, check_turns : float
        The same at so many s after the motion's end.
    last : float
        End of a run in which turns must stay.
    max_turns : float
        Turns beyond those required that count in a score.
    passing, late, slip, fault : float
        Weight of turns that are undone again, cost of a second of delay, slip that costs half a turn, and cost of a
        rope that comes too near its arm or an obstacle, folds flat, or does not run behind a peg, turns.
    periods : int
        Periods of its swing that a rope that is wound in the end is given to settle if it loses turns as it swings, or
        slips by more than a tenth of `max_slip`, each if its slip then halves, or falls below `max_slip`; and as many
        more if it does so with shorter links. Of 31 runs of four ropes that slipped by 4 to 170 mm 29 slipped by less
        than 5 mm after one period, 30 after three.
    longest : float
        Processor time of a run in contact, at most.
    """

    step: float = 0.02
    tol: float = 1e-4
    stiction: float = 0.5
    near: float = 0.02
    contact_tol: float = 1e-3
    contact_step: float = 1e-3
    swing_step: float = 2e-3
    poll: float = 0.005
    look: float = 1.0
    max_ratio: float = 2.0
    max_tail: float = 2.0
    hanging_tail: float = 0.7
    folded: float = 0.3
    sweep: float = 1.3
    sweep_turns: float = 0.65
    check: float = 0.9
    check_turns: float = 0.75
    last: float = 0.8
    max_turns: float = 1.75
    passing: float = 0.25
    late: float = 0.02
    slip: float = 0.02
    fault: float = 0.5
    periods: int = 2
    longest: float = 6.0


MODEL = RolloutModel()
NEVER = -1.0  # score of a swing without a strike, less its distance in m


@dataclass(frozen=True, eq=False)
class RolloutBatch:
    """A batch of M rollouts, each with its own rope, peg and motion.

    Motions begin with the rollout, at t = 0; without contact `pegs` may be empty. `q`, rad, and `qd`, rad/s, (M, n) are
    those at the start, `since`, s, is the planned time there. `obstacles`, which must not be touched, are not
    simulated. `stiction`, as that of :class:`RolloutModel`, regularizes dry friction of ropes without joint limits in
    free flight; 0.0: joints stick.
    """

    ropes: Sequence[Rope]
    pegs: Sequence[Peg]
    motions: Sequence[Motion]
    q: Array
    qd: Array
    since: float = 0.0
    stiction: float = 0.0

    @classmethod
    def from_start(
        cls,
        problem: Problem,
        ropes: Sequence[Rope],
        pegs: Sequence[Peg],
        motions: Sequence[Motion],
        stiction: float = 0.0,
    ) -> "RolloutBatch":
        """Return rollouts of ropes (M,) from the start of a problem."""
        q, qd = (np.tile(part, (len(ropes), 1)) for part in problem.start)
        return cls(ropes, pegs, motions, q, qd, stiction=stiction)

    @classmethod
    def from_state(
        cls, ropes: Sequence[Rope], pegs: Sequence[Peg], motions: Sequence[Motion], state: RopeState
    ) -> "RolloutBatch":
        """Return rollouts (M,) from an observed state, under motions whose time is that of the state."""
        q, qd = (np.broadcast_to(part, (len(ropes), part.size)) for part in (state.q, state.qd))
        return cls(ropes, pegs, [motion.shifted(-state.t) for motion in motions], q, qd, state.t)

    def __len__(self) -> int:
        return len(self.ropes)

    def select(self, rows: Sequence[int]) -> "RolloutBatch":
        """Return some of the rollouts."""
        pegs = [self.pegs[m] for m in rows] if self.pegs else []
        ropes, motions = [self.ropes[m] for m in rows], [self.motions[m] for m in rows]
        return replace(self, ropes=ropes, pegs=pegs, motions=motions, q=self.q[list(rows)], qd=self.qd[list(rows)])

    def run(self, arm: Arm, t: Array, **options: Any) -> Batch:
        """Simulate to the last of the times t (T,), s, with samples there; `options` as for ``simulate_batch``."""
        given: dict[str, Any] = {"arm": arm, "duration": float(t[-1]), "q0": self.q, "qd0": self.qd, "t_eval": t}
        return simulate_batch(list(self.ropes), list(self.motions), **given, **options)

    def fly(self, arm: Arm, span: float, budget: Budget) -> tuple[Array, Array, Array]:
        """Simulate free flight for a span, s; return samples t (T,), q and qd (M, T, n)."""
        t: Array = MODEL.step * np.arange(1.0, math.ceil(span / MODEL.step - 1e-9) + 1.0)
        given: dict[str, Any] = {"time_budget": budget, "threads": budget.threads}
        if not any(rope.limited for rope in self.ropes):
            given["stiction_tolerance"] = self.stiction * float(self.ropes[0].length.mean())
        run = self.run(arm, t, tol=MODEL.tol, keep=("q", "qd"), **given)
        return t, run.q, run.qd


def starts_outside(setup: Setup, *start: Any) -> bool:
    """Whether a rope keeps clear of its pegs at the start, as of :func:`check_outside`."""
    try:
        check_outside(setup, *start)
    except InvalidInput:
        return False
    return True


def free_sides(problem: Problem, pegs: Sequence[Obstacle]) -> list[int]:
    """Return the sides on which the arm may stand at first without the rope in one of the `pegs`, or at it."""
    rope, arm, (q, _) = problem.rope, problem.arm, problem.start

    def gap(side: int) -> float:
        return float(sampled_obstacle_gaps(rope, pegs, q, np.asarray(arm.tip(problem.limits.start_angle(side)))))

    return [side for side in (-1, 1) if problem.side in (side, 0) and gap(side) > 0.0]


def check_start(problem: Problem) -> None:
    """Raise InvalidInput if gravity does not point along -y, or if the rope begins in an obstacle on all sides.

    Pegs that it must run behind are obstacles then, too.
    """
    gx, gy = problem.rope.gravity
    if gx != 0.0 or gy > 0.0:
        fix = "Rotate the axes until y points up, and give the rope gravity = [0, -9.81]"
        raise InvalidInput(f"plans need gravity along -y; the rope has ({gx:.4g}, {gy:.4g}) m/s^2", fix=fix)
    pegs, free = (*problem.criteria.behind, *problem.obstacles), free_sides(problem, ())
    if not free_sides(problem, pegs):
        hit = " and ".join(named(each) for each in pegs if free_sides(problem, (each,)) != free)
        fix = "Move it; the rope hangs from the arm, which points to one side"
        raise InvalidInput(f"the rope begins in {hit}, whatever the arm's side", fix=fix)


@dataclass(frozen=True, eq=False)
class Strikes:
    """First strikes of M swings.

    `score` (M,): greater is better; below 0 without a strike. `t` (M,): last sample before the strike, s, NaN without a
    strike; `q`, rad, and `qd`, rad/s, (M, n): state there. `clear` (M,): samples before the rope comes too near an
    obstacle, or its arm before the strike.

    Notes
    -----
    The score is the energy with which the tail turns round the peg as a rigid body, over the energy that lifts its
    centre of mass over the top, times the turns for which the tail is long enough; 0 if it turns away from the peg. Of
    166 strikes of four random ropes 26 turned away, many with the best scores otherwise; none of them wound.
    """

    score: Array
    t: Array
    q: Array
    qd: Array
    clear: Integers

    @classmethod
    def joined(cls, parts: Sequence["Strikes"]) -> "Strikes":
        """Return the strikes of several batches as those of one."""
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))

    def select(self, rows: Integers) -> "Strikes":
        """Return the strikes of some swings, in that order."""
        return Strikes(*(getattr(self, one.name)[rows] for one in fields(self)))


def find_strikes(problem: Problem, peg: Peg, batch: RolloutBatch, t: Array, q: Array, qd: Array) -> Strikes:
    """Find the first strikes in samples q, qd (M, T, n) at times t (T,) of free flights.

    On the peg or on one that the rope must run behind, whichever comes first. A rope that comes too near an obstacle,
    its arm or the shaft before does not strike. `t` may begin with the batch's start.
    """
    arm, rows = problem.arm, np.arange(len(batch))
    tips = {id(each): arm.tip_motion(each, t) for each in batch.motions}
    base, base_velocity = (np.stack(each) for each in zip(*(tips[id(each)] for each in batch.motions), strict=True))
    lengths = np.stack([rope.length for rope in batch.ropes])
    moved = [batch.pegs or [peg] * len(batch), *([each] * len(batch) for each in problem.criteria.behind)]
    seen = [first_contact(q, base, lengths, each, batch.ropes[0].radius) for each in moved]
    which = np.stack([np.where(at > 0, at, t.size) for at, *_ in seen]).argmin(axis=0)
    at, link, least = (np.stack(part)[which, rows] for part in zip(*seen, strict=True))
    before = np.where(at > 0, at, t.size)
    clear = clear_samples(batch.ropes, problem.obstacles, q, base, problem.clearance)
    flat = np.zeros(len(batch), dtype=bool)
    for rope in {id(each): each for each in batch.ropes}.values():
        same = np.array([each is rope for each in batch.ropes])
        near = samples_clear_of_arm(rope, arm, q[same], base[same], problem.clearance, before[same])
        clear[same] = np.minimum(clear[same], near)
        flat[same] = (at_limits(limit_bend(rope), q[same]) & (np.arange(t.size) < before[same, None])).any(axis=1)
    finite: Array = np.asarray(np.all(np.isfinite(q), axis=2))
    failed = np.where(finite.all(axis=1), t.size, finite.argmin(axis=1))
    struck = (at > 0) & (at <= clear) & (failed > at)
    least = least + np.where((at > 0) & ~struck, 1.0 - clear / np.maximum(at, 1), 0.0)
    at = np.where(struck, at, 1)
    score = np.zeros(len(batch))
    for m in np.flatnonzero(struck).tolist():
        k = at[m] - 1  # later the rope may be past the peg
        hit = moved[which[m]][m], q[m, k], qd[m, k], base[m, k], base_velocity[m, k], int(link[m])
        ratio, left = tail_energy(batch.ropes[m], *hit)
        if which[m]:
            axis, beyond = hit[0].radius + batch.ropes[m].radius, math.dist(peg.point, hit[0].point)
            turn = 2.0 * np.pi * (peg.radius + batch.ropes[m].radius)
            left = max(2.0 * np.pi * axis * left - beyond, 0.0) / turn
        tail = np.clip(left - MODEL.hanging_tail, 0.0, MODEL.max_tail + problem.criteria.turns - 1.25)
        score[m] = min(max(ratio, 0.0), MODEL.max_ratio) * tail
    score = np.where(struck, np.where(flat, MODEL.folded, 1.0) * score, NEVER - least)
    return Strikes(score, np.where(struck, t[at - 1], np.nan), q[rows, at - 1], qd[rows, at - 1], clear)


def fly_to_strikes(
    problem: Problem, peg: Peg, batch: RolloutBatch, budget: Budget, until: float | None = None
) -> Strikes:
    """Simulate free flights until a time of the problem, s, by default all of it, and find their first strikes."""
    span = (problem.time if until is None else until) - batch.since
    t, q, qd = batch.fly(problem.arm, max(span, 2.0 * MODEL.step), budget)
    return find_strikes(problem, peg, batch, t, q, qd)


def first_contact(
    q: Array, base: Array, lengths: Array, pegs: Sequence[Peg], rope_radius: float
) -> tuple[Integers, Integers, Array]:
    """Return sample and link of the first strike on a peg, and the smallest gap until then, m, (M,) each.

    Sample 0 means no strike. `q` (M, T, n) are angles, rad, `base` (M, T, 2) positions of the rope's first joint, m,
    `lengths` (M, n) those of the links, m. If a flight fails before its first sample, the gap is the rope's length.
    """
    at, link, least = np.zeros(len(q), np.int64), np.zeros(len(q), np.int64), np.zeros(len(q))
    for peg in dict.fromkeys(pegs):
        same = np.array([each == peg for each in pegs])
        count, place = int(same.sum()), (peg.x, peg.y, peg.radius + rope_radius, MODEL.near)
        here, which, gap = np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros(count)
        some, bases, sizes = (np.ascontiguousarray(each[same]) for each in (q, base, lengths))
        proximity.first_contacts(some, bases, sizes, *place, here, which, gap)
        at[same], link[same], least[same] = here, which, gap
    return at, link, np.where(np.isfinite(least), least, lengths.sum(axis=1))


def tail_energy(
    rope: Rope, peg: Peg, q: Array, qd: Array, base: Array, velocity: Array, link: int
) -> tuple[float, float]:
    """Return energy ratio and turns of the tail of a strike with `link`; see :class:`Strikes`.

    The ratio is below 0 if the tail turns away from the peg: it winds towards the side on which the peg is of `link`.
    Angles q (n,), rad, rates qd (n,), rad/s; position and velocity (2,) of the first joint, m and m/s.
    """
    places, speeds = rope.mass_points(q, qd, base, velocity)
    places = places - peg.point
    mass = np.append(rope.mass, rope.tip_mass) * (np.arange(rope.n_links + 1) >= link)
    momentum = float((mass * (places[:, 0] * speeds[:, 1] - places[:, 1] * speeds[:, 0])).sum())
    inertia, down = float((mass * (places**2).sum(axis=1)).sum()), np.array(rope.gravity)
    centre = (mass[:, None] * places).sum(axis=0)
    lift = float(np.hypot(*down) * np.hypot(*centre) + centre @ down)
    turns = float(rope.length[link:].sum()) / (2.0 * np.pi * (peg.radius + rope.radius))
    x, y = peg.point - rope.joints(q, base)[link]
    sense = math.copysign(1.0, math.sin(q[link]) * y + math.cos(q[link]) * x)  # of rotation, as wound
    return 0.5 * sense * momentum * abs(momentum) / max(inertia * max(lift, 1e-12), 1e-300), turns


@dataclass(frozen=True, eq=False)
class WindingScores:
    """Scores (M,) of runs in contact, greater is better, and turns (M,) that stay, 0 if a run failed.

    And the greatest slip (M,), m, after the rope has settled, infinite if too few turns stay or the run ended early,
    the most turns (M,) at any time, and the time (M,), s, by which the motion must end later for the rope to settle.
    """

    score: Array
    turns: Array
    slip: Array
    most: Array
    dwell: Array


def simulate_contact(
    problem: Problem,
    batch: RolloutBatch,
    begin: Array,
    budget: Budget,
    *,
    sweeping: Sequence[bool] = (),
    periods: int = 0,
) -> WindingScores:
    """Simulate ropes (M,) with pegs from shortly before their strikes at `begin` (M,), s, under motions that end.

    The score is in turns: those that stay, a part of those that do not, less what delay, slip, and a rope that is too
    near arm or obstacles, folds flat or does not run behind a peg cost; with such a fault fewer turns stay. Those
    that are `sweeping` (M,) end early if they make few turns; by default none are. A run whose rope was too near arm or
    obstacles ends once it has made the turns required. A rope that is wound in the end, but slips or loses turns as it
    swings, is given up to so many `periods` of its swing to settle.
    """

    def one(k: int) -> tuple[float, ...]:
        run = _Contact(problem, batch.select([k]), float(begin[k]), bool(sweeping) and sweeping[k], periods, budget)
        return *run.score(), run.most, run.dwell

    with ThreadPoolExecutor(budget.threads) as pool:
        found = list(pool.map(one, range(len(batch))))
    return WindingScores(*np.array(found).reshape(-1, 5).T)


def swing_in_contact(
    problem: Problem, batch: RolloutBatch, spans: Sequence[float], budget: Budget
) -> list[tuple[Array, Array, Array, Array]]:
    """Simulate ropes (M,) with pegs for spans (M,), s; return times, s, turns, angles and rates of the samples of each.

    Those of a run that fails, or begins in a peg, are empty.
    """

    def one(k: int) -> tuple[Array, Array, Array, Array]:
        return _Contact(problem, batch.select([k]), 0.0, False, 0, budget).swing(spans[k])

    with ThreadPoolExecutor(budget.threads) as pool:
        return list(pool.map(one, range(len(batch))))


class _Contact:
    """One run in contact."""

    def __init__(
        self, problem: Problem, batch: RolloutBatch, begin: float, sweeping: bool, periods: int, budget: Budget
    ) -> None:
        self.problem, self.batch, self.begin, self.sweeping, self.budget = problem, batch, begin, sweeping, budget
        self.periods, self.dwell = periods, 0.0
        self.rope, self.motion, self.peg = batch.ropes[0], batch.motions[0], batch.pegs[0]
        self.pegs, self.most = (self.peg, *problem.criteria.behind), 0.0
        self.seconds_near, self._looked = 0.0, 0  # s, too near arm or obstacles, in so many samples
        self.state: State | None = None
        none, angles = np.zeros(0), np.zeros((0, self.rope.n_links))
        # times, s, turns, angles, rad, and rates, rad/s
        self.samples: tuple[Array, Array, Array, Array] = none, none, angles, angles

    def score(self) -> tuple[float, float, float]:
        """Score, turns and slip of the run, in parts: it ends after one that leaves no hope, or without slip."""
        criteria, rope = self.problem.criteria, self.rope
        stop = max(self.motion.end, 0.5)
        end, check = stop + 1.5 + criteria.settle, stop + MODEL.check
        sweep = MODEL.sweep * math.sqrt(rope.total_length / max(rope.g, 1e-9))
        usual = min(1.0, criteria.turns / 1.25)  # the limits below suit 1.25 turns, and those of more
        parts = [(min(sweep, check), usual * MODEL.sweep_turns)] if self.sweeping else []
        hope = usual * MODEL.check_turns
        setup = self._setup()
        if not starts_outside(setup):
            return NEVER, 0.0, math.inf
        for until, least in [*parts, (check, hope), (end, 0.0)]:
            if not self._run(setup, until, criteria.turns):
                return NEVER, 0.0, math.inf
            t, turns, _, _ = self.samples
            if t[-1] < until - 1e-9:  # it ended with a fault
                break
            seen = turns if until < check - 1e-9 else turns[-1:]
            if float(np.abs(seen).max()) < least:
                return self._turns(float(t[-1]))[0], 0.0, math.inf
        t, ended = self.samples[0], self.samples[0][-1] < end - 1e-9
        way = math.inf if ended else self._settled(setup, end, max(check, stop + criteria.settle))
        score, stay = self._turns(float(t[-1]) if ended else end + self.dwell)
        if stay >= criteria.turns and not ended:
            score -= way / (way + MODEL.slip) if math.isfinite(way) else 1.0
        t, _, q, _ = self.samples
        cost = self._cost(t, q)
        if cost > 0.0:
            score, stay = score - max(min(stay, 3.0) - criteria.turns, 0.0) - cost, min(stay, hope)
        if at_limits(limit_bend(rope), q, -FOLD).any():
            score -= MODEL.fault
        return score, stay, way

    def swing(self, span: float) -> tuple[Array, Array, Array, Array]:
        """Simulate for a span, s; return the samples: none if the run fails."""
        setup = self._setup().replace(contact_step=MODEL.swing_step)
        if starts_outside(setup):
            self._run(setup, span)
        return self.samples

    def _setup(self) -> Setup:
        start = {"q0": self.batch.q[0], "qd0": self.batch.qd[0]}
        setup = Setup(self.rope, self.motion, self.problem.arm, pegs=self.pegs, **start)
        return setup.replace(tol=MODEL.contact_tol, contact_step=MODEL.contact_step)

    def _run(self, setup: Setup, until: float, enough: float = math.inf) -> bool:
        """Simulate on until a time, s, or until a rope that made `enough` turns was too near arm or obstacles.

        Returns whether it succeeds. If not, the samples stay as they are.
        """
        limit = self.budget.limit(MODEL.longest)
        while (since := float(self.samples[0][-1]) if self.samples[0].size else 0.0) < until - 1e-9:
            if self.most >= enough and self._look() > 0.0:
                break
            end = min(until, since + MODEL.look) if math.isfinite(enough) else until
            polls: Array = np.arange(since, end + MODEL.step - 1e-9, MODEL.step)[1:]
            part = setup.replace(duration=polls[-1] - since + 1e-9)
            run = simulate(part, t_eval=polls, state=self.state, throw=False, time_budget=limit)
            turns = winding.turns(run, self.peg)
            self.most = max(self.most, float(np.abs(turns).max(initial=0.0)))
            if not run.success:
                return False
            more = run.t, turns, run.q, run.qd
            self.state = run.state
            t, turned, q, qd = (np.concatenate(each) for each in zip(self.samples, more, strict=True))
            self.samples = t, turned, q, qd
        return True

    def _settled(self, setup: Setup, end: float, since: float) -> float:
        """Wait until a wound rope at the `end`, s, neither slips nor loses turns as it swings; return its slip, m.

        It waits as long as it helps. The slip is the greatest since a time, s, and the dwell, or in a wait that does
        not help; inf if too few turns stay.
        """
        criteria = self.problem.criteria
        way = self._slip(since) if self._turns(end)[1] >= criteria.turns else math.inf
        for wait in (self.problem.period * np.arange(1.0, self.periods + 1.0)).tolist():
            before = self.samples
            if way <= 0.1 * criteria.max_slip or abs(self.samples[1][-1]) < criteria.turns:
                break
            if not self._run(setup, end + wait):
                break
            slip = self._slip(since + wait) if self._turns(end + wait)[1] >= criteria.turns else math.inf
            if math.isfinite(slip) and slip >= 0.5 * way and not slip < criteria.max_slip <= way:
                self.samples, way = before, max(way, slip)
                break
            self.dwell, way = wait, slip
        return way

    def _slip(self, since: float) -> float:
        """Return the greatest slip, m, since a time, s; inf if a link has left the peg."""
        t, _, q, _ = self.samples
        some = t >= since
        return float(np.abs(winding.slid(self.rope, self.peg, q[some], self._joints(t, q)[some])).max())

    def _turns(self, span: float) -> tuple[float, float]:
        """Score by the turns up to a span, s, alone, and the least turns in its last part."""
        t, turns, _, _ = self.samples
        most = MODEL.max_turns + self.problem.criteria.turns
        ending = turns[t >= span - MODEL.last]
        stay = max(float((np.sign(ending.sum()) * ending).min()), 0.0)
        score = min(stay, most) + MODEL.passing * min(float(np.abs(turns).max()), most)
        return score - MODEL.late * self.begin, stay

    def _look(self) -> float:
        """Return how long the rope has been too near arm or obstacles, s."""
        if self._looked == self.samples[0].size:
            return self.seconds_near
        problem, rope = self.problem, self.rope
        t, q, qd = (self.samples[k][max(0, self._looked - 1) :] for k in (0, 2, 3))
        self._looked = self.samples[0].size
        polls: Array = np.linspace(t[0], t[-1], round((t[-1] - t[0]) / MODEL.poll) + 1)
        places = interpolated(t, q, qd, polls), problem.arm.tip(self.motion.angle(polls))
        near = np.zeros(polls.size, dtype=bool)
        if problem.clearance > -math.inf:
            near |= sampled_clearance(rope, problem.arm, *places) <= problem.clearance
        if problem.obstacles:
            least = max(problem.clearance, 0.0)
            near |= sampled_obstacle_gaps(rope, problem.obstacles, *places, least) <= least
        self.seconds_near += MODEL.poll * int(near.sum())
        return self.seconds_near

    def _cost(self, t: Array, q: Array) -> float:
        """Return the cost of a rope that was too near arm or obstacles, or does not run behind its pegs in the end."""
        near = self._look()
        cost = MODEL.fault * (1.0 + near / (near + 0.3)) if near else 0.0
        if behind := self.problem.criteria.behind:
            some = t >= t[-1] - MODEL.last
            apart = float(way_gaps(self.rope, self.peg, behind, q[some], self._joints(t, q)[some]).max(initial=0.0))
            if apart > winding.TOUCH:
                cost += MODEL.fault * (1.0 + (apart / (apart + 0.05) if math.isfinite(apart) else 1.0))
        return cost

    def _joints(self, t: Array, q: Array) -> Array:
        return self.rope.joints(q, self.problem.arm.tip(self.motion.angle(t)))


def winding_scores(problem: Problem, batch: RolloutBatch, budget: Budget, dwell: float = 0.0) -> WindingScores:
    """Simulate moves (M,) in free flight until they strike, and in contact from there.

    They must strike within the time of the problem, or until 0.5 s after the arm's stop: `dwell`, s, before the
    motions' end. Turns are 0 without a strike or if a run fails.
    """
    stop = max(motion.end for motion in batch.motions) - dwell
    found = fly_to_strikes(problem, batch.pegs[0], batch, budget, max(problem.time, batch.since + stop + 0.5))
    return wound_after(problem, batch, found, budget)


def wound_after(problem: Problem, batch: RolloutBatch, found: Strikes, budget: Budget) -> WindingScores:
    """Simulate rollouts (M,) in contact from their strikes, as found. Turns are 0 without one or if a run fails."""
    nothing = np.zeros(len(batch))
    whole = WindingScores(found.score.copy(), nothing, np.full(len(batch), math.inf), nothing.copy(), nothing.copy())
    hit = np.flatnonzero(np.isfinite(found.t))
    if hit.size:
        some = batch.select(hit.tolist())
        motions = [motion.shifted(-t) for motion, t in zip(some.motions, found.t[hit], strict=True)]
        struck = replace(some, motions=motions, q=found.q[hit], qd=found.qd[hit])
        wound = simulate_contact(problem, struck, found.t[hit] + batch.since, budget)
        for one in fields(WindingScores):
            getattr(whole, one.name)[hit] = getattr(wound, one.name)
    return whole


def robust_values(found: WindingScores, problem: Problem) -> Array:
    """Return the values (M,) of moves: one for the turns that are required, and 0.2 at most for the score."""
    most = MODEL.max_turns + problem.criteria.turns
    return np.asarray((found.turns >= problem.criteria.turns) + 0.2 * np.clip(found.score / most, -1.0, 1.0))
