"""A planned throw in closed loop: at each rest of the arm, what is left is planned again from the observed state."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.control import hanging_state
from hyperflex.errors import InvalidInput
from hyperflex.interfaces import Motor, RopeState, StateSource
from hyperflex.interruption import interruptible
from hyperflex.motion import Motion
from hyperflex.planning.feedback.matching import Goal, features, match
from hyperflex.planning.problem import Problem
from hyperflex.planning.robust.refinement import robust_values
from hyperflex.planning.robust.scenario_rollouts import free_flight, winding_scores
from hyperflex.planning.robust.uncertainty import Scenario, Uncertainty
from hyperflex.planning.routing import refuse_behind
from hyperflex.planning.search.rollouts import RolloutBatch
from hyperflex.planning.search.strikes import arm_tip
from hyperflex.planning.throw import MIN_SPEED, Throw
from hyperflex.planning.wind.cast_plan import CastPlan

SAMPLES, LIKELY_SCENARIOS = 48, 4  # scenarios that may be the true one; of these, those in which throws are tried
BLIND_TIME = 0.15  # s before the expected strike within which the rope is no longer observed
DECISION_TIME = 0.1  # s that a decision may take; of a rope that waits meanwhile
MIN_PROBABILITY = 0.2  # of success, below which a throw is aborted before the last stroke or move
MIN_GAIN = 0.05  # value by which a changed throw must be better
MAX_ARM_ERROR = 0.2  # rad between arm and command at a rest; above, a throw is aborted
LATEST = 1  # a throw may be aborted from so many moves before the last one that starts before the strike


@dataclass(frozen=True)
class Decision:
    """Observation and decision at one rest.

    Attributes
    ----------
    move : int
        Number of the next move.
    t : float
        Time of the observation, s.
    left : float
        Time until that move, as planned until then, s.
    before, after : float
        Fraction of the likely scenarios in which the throw succeeds, as planned until then and as decided.
    action : {"kept", "changed", "aborted", "late"}
        Late: what was decided came too late and was not done.
    seconds : float
        Time that the decision took by the clock, s, the state's observation included; it may be more than `left`.
    arm_error : float
        Angle of the motor's encoder less the commanded one, rad; NaN without a motor.
    """

    move: int
    t: float
    left: float
    before: float
    after: float
    action: str
    seconds: float
    arm_error: float = float("nan")


@dataclass(frozen=True, eq=False)
class FollowResult:
    """A plan as it was executed in closed loop.

    Attributes
    ----------
    throw : Throw
        The throw that was commanded in the end.
    motion : Motion
        Its motion.
    decisions : tuple of Decision
    decision_time : float
        Time that was kept for a decision, s.
    """

    throw: Throw
    motion: Motion
    decisions: tuple[Decision, ...]
    decision_time: float = DECISION_TIME

    @property
    def late(self) -> int:
        """Number of decisions that took longer than was kept for them: a rope that does not wait had moved on."""
        return sum(one.seconds > self.decision_time for one in self.decisions)

    @property
    def success(self) -> bool:
        """Whether the throw was made to its end, not aborted."""
        return not (self.decisions and self.decisions[-1].action == "aborted")

    @property
    def status(self) -> int:
        """0: made to its end. 1: aborted; the arm went slowly to hanging."""
        return int(not self.success)

    @property
    def message(self) -> str:
        """Why the throw was aborted; empty if it was not."""
        if self.success:
            return ""
        last = self.decisions[-1]
        if abs(last.arm_error) > MAX_ARM_ERROR:
            return f"aborted at {last.t:.2f} s: the arm is {abs(last.arm_error):.2g} rad from its command"
        return f"aborted at {last.t:.2f} s: it succeeds in {100 * last.after:.0f} % of the likely scenarios"


@interruptible()
def follow_plan(
    plan: CastPlan,
    source: StateSource,
    *,
    motor: Motor | None = None,
    uncertainty: Uncertainty | None = None,
    decision_time: float = DECISION_TIME,
    min_probability: float = MIN_PROBABILITY,
    real_time: bool = False,
    seed: int = 0,
    threads: int | None = None,
) -> FollowResult:
    """Follow a planned throw; at each rest before the strike, plan the rest of it again from the observed state.

    Parameters
    ----------
    plan : CastPlan
        With a throw, as it was planned or read back by :func:`hyperflex.read_plan`.
    source : StateSource
        Source of the rope's state, with as many links as the plan's rope.
    motor : Motor, optional
        Gets the plan at t = 0 and each change at a rest; its angle is read there, and a throw is aborted if the arm is
        more than MAX_ARM_ERROR from its command. Without a motor only `source` gets the commands.
    uncertainty : Uncertainty, optional
        Prior of the scenarios that may be the true one; by default realistic.
    decision_time : float
        Time that a decision may take, s: moves that are due sooner are made as planned.
    real_time : bool
        Whether the rope moves on while a decision is made: one that takes longer than `decision_time` is not done then.
        By default the rope waits, as a simulated one does.
    min_probability : float
        Fraction of the likely scenarios in which a throw must succeed before the last stroke and the last move; else it
        is aborted.
    seed : int
    threads : int, optional

    Raises
    ------
    InvalidInput
        If the plan is no cast or holds no throw, or a number is out of range.

    Notes
    -----
    Sampled scenarios are ranked by how well they predict the observed states. In the best ones the rest of the throw is
    tried as it is, and changed so that the rope strikes in the planned state (see :func:`matching.match`). Contact
    before the last observation is not noticed.

    A decision takes 0.3 to 0.9 s of processor time with 50 links, and so DECISION_TIME holds only for a rope that
    waits: in real time give a `decision_time` of a second, which the rests of a throw must leave.
    """
    if not isinstance(plan, CastPlan):
        raise InvalidInput("only casts are followed", got=type(plan).__name__, allowed="a CastPlan")
    problem, throw = plan.problem, plan.required(plan.throw, "throw")
    if problem.obstacles:
        raise InvalidInput("casts past obstacles are not followed", got=f"{len(problem.obstacles)} obstacles")
    refuse_behind(problem.behind, "a plan that is followed")
    if problem.q0:
        fix = "Follow a plan without state0"
        raise InvalidInput("casts that begin with a swinging rope are not followed", got="q0 and qd0", fix=fix)
    pause = checks.number("decision_time", decision_time, sign="nonnegative", unit="s")
    known = uncertainty or Uncertainty()
    samples = known.sample(SAMPLES, problem, plan.target, seed=[checks.count("seed", seed, least=0), 1])
    goal = Goal.of(problem, plan.target, throw)
    loop = _Loop(problem, throw, ScenarioRanking(problem, samples), threads)
    if motor is not None:
        motor.set_motion(loop.motion(), 0.0)
    decisions: list[Decision] = []
    while goal is not None and loop.move <= loop.throw.count:
        now = loop.rest_start()
        if now > goal.t + loop.delay - BLIND_TIME:
            break
        begin = time.monotonic()
        left = float(loop.throw.starts(problem.limits)[loop.move]) - now
        state = source.state(now, loop.motion())
        arm_error = float("nan") if motor is None else motor.angle(now) - float(loop.motion().angle(now))
        loop.first, planned = loop.move if left >= pause else loop.move + 1, (loop.throw, loop.delay)
        if abs(arm_error) > MAX_ARM_ERROR:
            before, after, action = 0.0, 0.0, loop.abort(pause)
        else:
            before, after, action = loop.decide(goal, state, pause, min_probability)
        seconds = time.monotonic() - begin
        if real_time and seconds > pause and action != "kept" and not abs(arm_error) > MAX_ARM_ERROR:
            (loop.throw, loop.delay), action = planned, "late"
        decisions.append(Decision(loop.move, now, left, before, after, action, seconds, arm_error))
        if motor is not None and action in ("changed", "aborted"):
            motor.set_motion(loop.motion(), now)
        if action == "aborted":
            break
        loop.move += 1
    return FollowResult(loop.throw, loop.motion(), tuple(decisions), pause)


def swing_down(throw: Throw, made: int, rest: float = 0.0) -> Throw:
    """Return a throw that makes `made` moves and, after a rest, s, takes the arm slowly to hanging."""
    return replace(throw, count=made, end=0.0, rest=rest, speed=MIN_SPEED)


class ScenarioRanking:
    """Sampled scenarios, ranked by their errors in predicting the observed states of a rope that begins at rest.

    Each scenario predicts every observed state from the one before. Squared errors of the joints' positions and
    velocities (:func:`matching.features`) add up. Delays of moves are not part of the prediction.
    """

    def __init__(self, problem: Problem, scenarios: Sequence[Scenario]) -> None:
        self.problem, self.scenarios = problem, list(scenarios)
        self.errors = np.zeros(len(self.scenarios))
        self._last = hanging_state(problem.rope)

    def observe(self, state: RopeState, motion: Motion, *, threads: int | None = None) -> None:
        """Add the errors in predicting an observed state, under a commanded motion of moves until then."""
        if state.t <= self._last.t:
            return
        motions = [scenario.without_delays().executed_motion(motion) for scenario in self.scenarios]
        ropes = [scenario.rope for scenario in self.scenarios]
        batch = RolloutBatch.from_state(ropes, [], motions, self._last)
        _, q, qd = free_flight(batch, self.problem.arm, state.t - batch.since, at_end=True, threads=threads)
        for m, (rope, executed) in enumerate(zip(ropes, motions, strict=True)):
            base = arm_tip(self.problem.arm, executed, np.array([state.t]))
            observed = features(rope, state.q[None], state.qd[None], *base)
            predicted = features(rope, q[m, -1:], qd[m, -1:], *base)
            self.errors[m] += float(np.nan_to_num(((predicted - observed) ** 2).sum(), nan=np.inf))
        self._last = state

    def best(self, count: int) -> list[Scenario]:
        """Return the scenarios with the least errors, best first."""
        return [self.scenarios[m] for m in np.argsort(self.errors, kind="stable")[:count]]


class _Loop:
    """The throw as planned so far, the next move, the first move that may still be changed, and the delay so far, s."""

    def __init__(self, problem: Problem, throw: Throw, ranking: ScenarioRanking, threads: int | None) -> None:
        self.problem, self.throw, self.ranking, self.threads = problem, throw, ranking, threads
        self.move, self.first, self.delay = 1, 1, 0.0

    def motion(self) -> Motion:
        """Return the commanded motion."""
        return self.throw.motion(self.problem.limits)

    def rest_start(self) -> float:
        """Time at which the arm comes to rest before the next move, s."""
        rests = np.append(self.throw.rests[: self.throw.count], self.throw.rest)
        return float(self.throw.starts(self.problem.limits)[self.move] - abs(rests[self.move]))

    def decide(self, goal: Goal, state: RopeState, pause: float, min_probability: float) -> tuple[float, float, str]:
        """Plan the rest of the throw; return the success probabilities before and after, and the action."""
        self.ranking.observe(state, self.motion(), threads=self.threads)
        scenarios = self.ranking.best(LIKELY_SCENARIOS)
        throws = [self.throw]
        probability, value = self.probabilities(throws, state, scenarios)
        if self.first < self.throw.count and probability[0] < 1.0:
            best = scenarios[0].without_delays()
            others = match(self.problem, best, goal, self.throw, self.first, state, pause, threads=self.threads)
            if others:
                first = self.probabilities(others, state, scenarios[:1])[1]
                throws.append(others[int(np.argmax(first))])
                more = self.probabilities(throws[1:], state, scenarios)
                probability, value = np.append(probability, more[0]), np.append(value, more[1])
        chosen = int(np.argmax(value))
        chosen = chosen if value[chosen] > value[0] + MIN_GAIN else 0
        begun = int((self.throw.starts(self.problem.limits) < goal.t + self.delay).sum())
        before, after = float(probability[0]), float(probability[chosen])
        if after < min_probability and self.move >= begun - LATEST and self.first <= self.throw.count:
            return before, after, self.abort(pause)
        changed = throws[chosen] is not self.throw
        old = self.throw.starts(self.problem.limits)[-1]
        self.throw = throws[chosen]
        self.delay += float(self.throw.starts(self.problem.limits)[-1] - old)
        return before, after, "changed" if changed else "kept"

    def abort(self, pause: float) -> str:
        """Let the arm go slowly to hanging as soon as it can; return the action."""
        self.throw = swing_down(self.throw, min(self.first, self.throw.count), pause)
        return "aborted"

    def probabilities(
        self, throws: Sequence[Throw], state: RopeState, scenarios: Sequence[Scenario]
    ) -> tuple[Array, Array]:
        """Return the fraction of the scenarios in which each throw succeeds, and its mean value (W,)."""
        pairs = [(throw, scenario) for throw in throws for scenario in scenarios]
        motions = [scenario.motion(throw, self.problem) for throw, scenario in pairs]
        ropes, pegs = [scenario.rope for _, scenario in pairs], [scenario.peg for _, scenario in pairs]
        batch = RolloutBatch.from_state(ropes, pegs, motions, state)
        found = winding_scores(batch, self.problem, threads=self.threads)
        shape = (len(throws), len(scenarios))
        won = (found.turns >= self.problem.turns).reshape(shape)
        return won.mean(axis=1), robust_values(found, self.problem).reshape(shape).mean(axis=1)
