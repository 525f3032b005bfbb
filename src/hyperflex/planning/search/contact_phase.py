"""The contact phase of throws: coarse runs beside the peg from shortly before the strike, and their score."""

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Obstacle, Peg, Setup
from hyperflex.motion import hold_arm
from hyperflex.planning.clearance import sampled_clearance, sampled_obstacle_gaps
from hyperflex.planning.problem import MIN_TURNS, SETTLING_TIME, Problem
from hyperflex.planning.routing import way_gaps
from hyperflex.planning.search.rollouts import RolloutBatch, usable_threads
from hyperflex.planning.search.strikes import arm_tip
from hyperflex.planning.verification import FOLD, at_limits, limit_bend
from hyperflex.simulation import Deadline, check_outside
from hyperflex.trajectory import interpolated
from hyperflex.winding import TOUCH, slid

COARSE_TOL, COARSE_STEP = 1e-3, 1e-3  # m, s, of runs in a search; coarser ones of wound ropes took longer, not less
SAMPLE_TIME, LOOK_TIME = 0.02, 0.005  # s, of samples; of looks at arm and obstacles, which a tip may pass in 20 ms
# What follows is for a set-up that asks for MIN_TURNS, watched from SETTLING_TIME on; see _Thresholds
END_TIME = 2.5  # s simulated after the arm's stop
CHECK_TIME, MIN_HOPE = 0.9, 0.75  # s after the stop at which a run is looked at; with fewer turns it ends there
# The same after the strike, in units of sqrt(length / g), where no sample until then has more turns: of 2,423 runs of
# searches for 20 targets 141 wound in the end; 12 of these had fewer, and 57 % of all simulated time came later
SWEEP_TIME, MIN_SWEEP = 1.3, 0.65
SLIP, SLIP_COST = 0.02, 1.0  # m of slip from CHECK_TIME on that cost half of so many turns; more costs more
TIME_BUDGET = 6.0  # s of processor time for a run; most take a hundredth of it
SLOW_RUNS, MIN_BUDGET = 10.0, 0.5  # one run in so many takes very long; processor time of each in any case, s
LAST, LAST_CHECK = 0.8, 0.3  # s at the end of a run for which the turns must stay; the same at CHECK_TIME
MAX_TURNS = 3.0  # turns above which more do not count
PASSING = 0.25  # weight of a turn that is undone again
LATE_COST = 0.02  # turns that a second of delay costs
# Turns that a rope costs that comes too near its arm, and up to as many more the longer it is there; half of these in s
ARM_COST, ARM_TIME = 0.5, 0.3
# The same for a rope that does not run behind a peg in the end, and as many more the farther off; half of these in m
WAY_COST, WAY_GAP = 0.5, 0.05
# A rope that is folded flat keeps of its score PLAIN and FOLDED of the rest: others come first. Coarse ropes have no
# joint limits: where throws fold when verified they bent by 2.1 times the limit or more, else by half of it at most
PLAIN, FOLDED = 1.0, 0.1


@dataclass(frozen=True, eq=False)
class WindingScores:
    """Scores of M throws.

    `score` (M,): greater is better; turns that stay, and a little for turns that do not and for an early strike.
    `turns` (M,): turns that stay, the least over the last LAST seconds; 0 if a run failed.
    """

    score: Array
    turns: Array


class _Thresholds(NamedTuple):
    """What turns and scores are compared with: the constants above, moved along with what a set-up asks.

    `turns` are those asked, `most` those above which more do not count, `plain` is the score that folded ropes keep.
    `hope` and `sweep` are the turns with which a run goes on, where more are asked those of MIN_TURNS: to wind further
    takes a rope longer. `end` is that of a run, s after the stop.
    """

    turns: float
    most: float
    plain: float
    hope: float
    sweep: float
    end: float

    @classmethod
    def of(cls, problem: Problem) -> "_Thresholds":
        more, part = problem.more_turns, min(1.0, problem.turns / MIN_TURNS)
        end = END_TIME + (problem.settle - SETTLING_TIME)
        return cls(problem.turns, MAX_TURNS + more, PLAIN + more, MIN_HOPE * part, MIN_SWEEP * part, end)


def simulate_contact(
    batch: RolloutBatch,
    begin: Array,
    problem: Problem,
    *,
    sweeping: bool = False,
    folding: bool = True,
    time_budget: float | Deadline = TIME_BUDGET,
    threads: int | None = None,
) -> WindingScores:
    """Simulate ropes (M,) with pegs from shortly before their strikes, under motions that end; on threads.

    A strike that begins later, at `begin` (M,), s, lowers the score. The set-up gives arm and criterion. A rope
    that comes within its clearance of arm or shaft, or an obstacle, counts as one that comes undone, whose score is
    lower the longer it is there.
    With `sweeping` runs end that make fewer than MIN_SWEEP turns until SWEEP_TIME: for a search, which loses few.
    Without `folding` ropes that are folded flat are not simulated on, and count MIN_HOPE turns at most where they fold
    before the last part.
    `time_budget` is the processor time of each of a run's up to three parts, s, or a deadline; one that takes more has
    failed.
    """

    def one(k: int) -> tuple[float, float]:
        return _simulate_one(batch.select([k]), float(begin[k]), problem, sweeping, folding, time_budget)

    with ThreadPoolExecutor(usable_threads(threads)) as pool:
        found = list(pool.map(one, range(len(batch))))
    return WindingScores(*np.array(found).reshape(-1, 2).T)


def run_budget(left: Callable[[], float] | None, share: float) -> float | Deadline:
    """Time for each of some runs, s: one in SLOW_RUNS may take all that is `left`, s, and none more than TIME_BUDGET.

    `share` is the number of threads over that of the runs.
    """
    if left is None:
        return TIME_BUDGET
    return Deadline(float(np.clip(SLOW_RUNS * max(left(), 0.0) * share, MIN_BUDGET, TIME_BUDGET)), left)


def _simulate_one(
    one: RolloutBatch,
    begin: float,
    problem: Problem,
    sweeping: bool,
    folding: bool,
    time_budget: float | Deadline,
) -> tuple[float, float]:
    """Score and turns of one rope, as of :func:`simulate_contact`.

    A run that must be `sweeping` and is not ends there and counts no turns that stay. One with fewer than MIN_HOPE
    turns CHECK_TIME after the stop ends there and counts MIN_HOPE at most. So does one that came too near the arm until
    then, or comes too near it later, but its score is that of the turns asked at most, less what the arm costs. A rope
    that lies too deep in its peg at the start is not simulated, and makes no turn.
    """
    arm, asked, rope = problem.arm, _Thresholds.of(problem), one.ropes[0]
    limited = limit_bend(rope)
    if not _clear_of_peg(one, arm) or (not folding and at_limits(limited, one.q, -FOLD).any()):
        return -LATE_COST * begin, 0.0  # its run could not begin, or would not count: as one that makes no turn
    stop = max(float(one.motions[0].breaks[-1]), 0.5)
    check = stop + CHECK_TIME
    sweep = SWEEP_TIME * np.sqrt(rope.total_length / max(np.hypot(*rope.gravity), 1e-9)) if sweeping else check
    t, turns, q, qd, now = _run_on(one, 0.0, min(sweep, check), arm, time_budget)
    hopeful = not sweeping or bool(np.abs(turns).max() >= asked.sweep)
    hopeful = hopeful and (folding or not at_limits(limited, q, -FOLD).any())
    if hopeful and t[-1] < check - 1e-9 and _clear_of_peg(now, arm):
        further, *seen, now = _run_on(now, t[-1], check, arm, time_budget)
        t, turns, q, qd = (np.concatenate(each) for each in zip((t, turns, q, qd), (further, *seen), strict=True))
    folded = bool(at_limits(limited, q, -FOLD).any())
    hopeful = hopeful and bool(abs(turns[-1]) >= asked.hope) and _clear_of_peg(now, arm) and (folding or not folded)
    score, stay = score_winding(t, turns, min(check, t[-1]), begin, last=LAST_CHECK, most=asked.most)
    if t[-1] < check - 1e-9:  # nobody saw its turns stay
        score, stay = score - min(stay, asked.most), 0.0
    elif not hopeful:
        score, stay = score - max(min(stay, asked.most) - asked.hope, 0.0), min(stay, asked.hope)
    elif (near := _time_near_arm(one, q, qd, t, arm, problem.clearance)) > 0.0:
        score, stay = _come_undone(score, stay, near, asked)
    else:
        further, whole, settled, rates, _ = _run_on(now, t[-1], stop + asked.end, arm, time_budget)
        ended = np.append(t, further), np.append(turns, whole)
        score, stay = score_winding(*ended, stop + asked.end, begin, most=asked.most)
        if stay >= asked.turns:
            score -= SLIP_COST * _slip(now, settled, further - t[-1], arm)
        if (near := _time_near_arm(now, settled, rates, further - t[-1], arm, problem.clearance)) > 0.0:
            score, stay = _come_undone(score, stay, near, asked)
        if (apart := _way_apart(now, settled, further - t[-1], arm)) > TOUCH:
            score -= max(min(stay, asked.most) - asked.turns, 0.0) + _way_cost(apart)
            stay = min(stay, asked.hope)
    if score > asked.plain and folded:
        score = asked.plain + FOLDED * (score - asked.plain)
    return score, stay


def _come_undone(score: float, stay: float, near: float, asked: _Thresholds) -> tuple[float, float]:
    """Score and turns of a rope that was too near its arm or an obstacle for a time `near`, s, from those without."""
    cost = max(min(stay, asked.most) - asked.turns, 0.0) + ARM_COST * (1.0 + near / (near + ARM_TIME))
    return score - cost, min(stay, asked.hope)


def _clear_of_peg(one: RolloutBatch, arm: Arm) -> bool:
    """Whether a rope keeps clear of its pegs at the start, as a run asks: one that ended may have left it too deep."""
    return starts_outside(Setup(one.ropes[0], one.motions[0], arm, pegs=(one.pegs[0], *one.behind)), 0.0, one.q[0])


def _time_near_arm(one: RolloutBatch, q: Array, qd: Array, t: Array, arm: Arm, clearance: float) -> float:
    """Time, s, that a rope is too near arm or obstacles, by looks LOOK_TIME apart.

    Angles q (T, n), rad, and rates qd (T, n), rad/s, at times t (T,), s, are interpolated.
    """
    looks: Array = np.linspace(t[0], t[-1], round((t[-1] - t[0]) / LOOK_TIME) + 1)
    rope, near, q = one.ropes[0], np.zeros(looks.size, dtype=bool), interpolated(t, q, qd, looks)
    base = arm_tip(arm, one.motions[0], looks)[0]
    if clearance > -np.inf:
        near |= sampled_clearance(rope, arm, q, base) <= clearance
    if one.obstacles:
        near |= sampled_obstacle_gaps(rope, one.obstacles, q, base) <= max(clearance, 0.0)
    return LOOK_TIME * int(near.sum())


def starts_outside(setup: Setup, *start: Any) -> bool:
    """Whether a rope keeps clear of its pegs at the start, as of :func:`check_outside`."""
    try:
        check_outside(setup, *start)
    except InvalidInput:
        return False
    return True


def free_sides(problem: Problem, pegs: Sequence[Obstacle]) -> list[int]:
    """Return the sides on which the arm may stand at first without the rope in one of the `pegs`."""
    may = [side for side in (-1, 1) if problem.side in (side, 0)]
    (q, _), angle = problem.start, problem.limits.start_angle
    starts = [Setup(problem.rope, hold_arm(angle(side)), problem.arm, pegs=tuple(pegs)) for side in may]
    return [side for side, start in zip(may, starts, strict=True) if starts_outside(start, 0.0, q)]


def check_sides(sides: Collection[int], peg: Peg) -> None:
    """Raise InvalidInput if there are no sides on which the arm may stand at first, as of :func:`free_sides`."""
    if not sides:
        fix = "Move the target away from the arm"
        raise InvalidInput("the rope starts inside the target on either side of the arm", got=peg, fix=fix)


def check_start(problem: Problem) -> None:
    """Raise InvalidInput if the rope begins in an obstacle, or a peg that it is to run behind, on all sides."""
    either = (*problem.behind, *problem.obstacles)
    some_pegs, both = "a peg that it is to run behind", "an obstacle or a peg that it is to run behind"
    for what, some in (("an obstacle", problem.obstacles), (some_pegs, problem.behind), (both, either)):
        if not free_sides(problem, some):
            fix = "Move it; the rope hangs from the arm, which points to one side"
            raise InvalidInput(f"the rope begins in {what}, whatever the arm's side", fix=fix)


def _run_on(
    one: RolloutBatch, since: float, until: float, arm: Arm, time_budget: float | Deadline
) -> tuple[Array, Array, Array, Array, RolloutBatch]:
    """Simulate a rope coarsely from a time `since` to a time `until`, s.

    Returns the times of its samples (T,), s, its turns (T,), its angles, rad, and rates, rad/s, (T, n), and the rollout
    that goes on.
    """
    t: Array = SAMPLE_TIME * np.arange(1.0, np.ceil((until - since) / SAMPLE_TIME - 1e-9) + 1.0)
    run = one.run(
        arm,
        t,
        tol=COARSE_TOL,
        contact_step=COARSE_STEP,
        refine=False,
        pegs=[(peg, *one.behind) for peg in one.pegs],
        keep=("turns", "q", "qd"),
        time_budget=time_budget,
        threads=1,
    )
    onward = replace(one, motions=[one.motions[0].shifted(-t[-1])], q=run.q[:, -1], qd=run.qd[:, -1])
    return since + t, run.values["turns"][0, :, 0], run.q[0], run.qd[0], onward


def _slip(one: RolloutBatch, q: Array, t: Array, arm: Arm) -> float:
    """Slip of a rope in samples q (T, n) at times t (T,), s: 1/2 for SLIP metres, and 1 for a rope that comes off."""
    way = float(np.abs(slid(one.ropes[0], one.pegs[0], q, _joints(one, q, t, arm))).max())
    return way / (way + SLIP) if np.isfinite(way) else 1.0


def _way_apart(one: RolloutBatch, q: Array, t: Array, arm: Arm) -> float:
    """Greatest distance, m, of a rope's way to its target from a peg to run behind, in the last LAST seconds.

    Samples q (T, n), rad, at times t (T,), s. 0 without such pegs.
    """
    if not one.behind:
        return 0.0
    some = t >= t[-1] - LAST
    joints = _joints(one, q[some], t[some], arm)
    return float(way_gaps(one.ropes[0], one.pegs[0], one.behind, q[some], joints).max(initial=0.0))


def _way_cost(apart: float) -> float:
    """Turns that a rope costs that does not run behind a peg but `apart` from it, m; inf where it is nowhere."""
    return WAY_COST * (1.0 + (apart / (apart + WAY_GAP) if np.isfinite(apart) else 1.0))


def _joints(one: RolloutBatch, q: Array, t: Array, arm: Arm) -> Array:
    """Joints (T, n + 1, 2), m, of a rope in samples q (T, n), rad, at times t (T,), s."""
    return one.ropes[0].joints(q, arm_tip(arm, one.motions[0], t)[0])


def score_winding(
    t: Array, turns: Array, span: float, begin: float, *, last: float = LAST, most: float = MAX_TURNS
) -> tuple[float, float]:
    """Return the score of a run by its turns (T,) at times t (T,) up to its `span`, and the turns that stay.

    Those are the least over the `last` seconds of the span; more than `most` do not count in the score. The strike was
    at `begin`; all times in s.
    """
    if not np.isfinite(turns).all():
        return -1.0, 0.0
    inside = t <= span + 1e-9
    ending = turns[inside & (t >= span - last)]
    stays = max(float((np.sign(ending.sum()) * ending).min()), 0.0)
    passed = float(np.abs(turns[inside]).max())
    return min(stays, most) + PASSING * min(passed, most) - LATE_COST * begin, stays
