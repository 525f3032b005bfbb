"""A planned cast in closed loop: at each rest of the arm, the rest of the cast is planned again."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.control import TrueState, hanging_state
from hyperflex.errors import InvalidInput
from hyperflex.hardware import SAMPLE_TIME, SimulatedMotor
from hyperflex.interfaces import Motor, RopeState, StateSource
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.planning.moves import Moves
from hyperflex.planning.options import refuse_behind
from hyperflex.planning.plan import CastPlan
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import RolloutBatch, fly_to_strikes, robust_values, winding_scores
from hyperflex.planning.shooting import shoot
from hyperflex.planning.uncertainty import Scenario, Uncertainty
from hyperflex.status import Status

SLOWLY = 0.3  # fraction of the motor's speed at which an aborted cast takes the arm down


@dataclass(frozen=True)
class FollowOptions:
    """Options of :func:`follow_plan`.

    Parameters
    ----------
    decision_time : float
        Time that a decision may take, s: moves that are due sooner are made as planned.
    real_time : bool
        Whether the rope moves on while a decision is made: one that takes longer than `decision_time` is not carried
        out then. By default the rope waits, as a simulated one does.
    min_probability : float
        Fraction of the likely scenarios in which a cast must succeed before the last stroke and the last move; else it
        is aborted.
    max_arm_error : float
        Angle, rad, between arm and command at a rest, above which a cast is aborted.
    samples, likely : int
        Scenarios that may be the true one, and how many of them, those that predict the observations best, a cast is
        tried in.
    min_gain : float
        Increase of the mean score, about one per success, by which a changed cast must be better.
    blind_time : float
        Time before the expected strike, s, within which the rope is no longer observed.
    position_scale, speed_scale : float
        Errors of a joint's position, m, and velocity, m/s, that count one in the distance from the planned strike.
    rest_scale, stroke_scale : float
        Scales of the changes of a rest, s, and of a stroke, rad.
    rounds : int
        Steps of a correction.
    difference : float
        Step of the finite differences, in scales.
    window : float
        Time about the planned strike within which flights are compared, s.
    """

    decision_time: float = 0.1
    real_time: bool = False
    min_probability: float = 0.2
    max_arm_error: float = 0.2
    samples: int = 48
    likely: int = 4
    min_gain: float = 0.05
    blind_time: float = 0.15
    position_scale: float = 0.05
    speed_scale: float = 0.5
    rest_scale: float = 0.15
    stroke_scale: float = 0.6
    rounds: int = 2
    difference: float = 0.06
    window: float = 0.3

    def __post_init__(self) -> None:
        for name in ("decision_time", "min_probability", "max_arm_error", "blind_time"):
            object.__setattr__(self, name, checks.number(name, getattr(self, name), sign="nonnegative"))


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
        Time until that move, as planned before the decision, s.
    before, after : float
        Fraction of the likely scenarios in which the cast succeeds, before and after the decision.
    action : {"kept", "changed", "aborted", "late"}
        Late: the decision came too late and was not carried out.
    seconds : float
        Time that the decision took by the clock, s, with the observation of the state; it may be more than `left`.
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
    arm_error: float = math.nan


@dataclass(frozen=True, eq=False)
class FollowResult:
    """A plan as it was executed in closed loop.

    Attributes
    ----------
    moves : Moves
        The moves that were commanded in the end.
    motion : Motion
        Their motion.
    decisions : tuple of Decision
    options : FollowOptions
    planned : str
        Why the plan fails as it was planned; empty if it succeeds.
    """

    moves: Moves
    motion: Motion
    decisions: tuple[Decision, ...]
    options: FollowOptions
    planned: str = ""

    @property
    def late(self) -> int:
        """Number of decisions that took longer than ``decision_time``: a rope that does not wait had moved on."""
        return sum(one.seconds > self.options.decision_time for one in self.decisions)

    @property
    def completed(self) -> bool:
        """Whether the cast was made to its end, not aborted."""
        return not (self.decisions and self.decisions[-1].action == "aborted")

    @property
    def message(self) -> str:
        """Why the cast failed; empty if it did not. Without a decision, that of the plan."""
        if not self.decisions:
            return self.planned
        last = self.decisions[-1]
        why = f"it succeeds in {100 * last.after:.0f} % of the likely scenarios"
        if abs(last.arm_error) > self.options.max_arm_error:
            why = f"the arm is {abs(last.arm_error):.2g} rad from its command"
        if not self.completed:
            return f"aborted at {last.t:.2f} s: {why}"
        return "" if last.after >= 0.5 else f"expected to miss: at {last.t:.2f} s {why}"

    @property
    def status(self) -> Status:
        """SUCCESS: made to its end, and at the last observation it succeeds in most of the likely scenarios.

        Where nothing was observed: the plan succeeds.
        """
        return Status.FAILED if self.message else Status.SUCCESS

    @property
    def success(self) -> bool:
        """Whether the status is SUCCESS."""
        return not self.message


@interruptible()
def follow_plan(
    plan: CastPlan,
    source: StateSource,
    *,
    motor: Motor | None = None,
    uncertainty: Uncertainty | None = None,
    options: FollowOptions | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> FollowResult:
    """Follow a planned cast; at each rest before the strike, plan the rest of it again from the observed state.

    Parameters
    ----------
    plan : CastPlan
        With moves, as it was planned or read by :func:`hyperflex.read_plan`.
    source : StateSource
        Source of the rope's state, with as many links as the plan's rope.
    motor : Motor, optional
        Gets the plan at t = 0 and each change at a rest; its angle is read there. Without a motor only `source` gets
        the commands.
    uncertainty : Uncertainty, optional
        Prior of the scenarios that may be the true one; by default realistic.
    options : FollowOptions, optional
    seed : int
    threads : int, optional

    Raises
    ------
    InvalidInput
        If the plan is no cast or has no moves, or a number is out of range.

    Notes
    -----
    Sampled scenarios are ranked by how well they predict the observed states. In the best ones the rest of the cast is
    tried as it is, and corrected so that the rope strikes in the planned state: :mod:`hyperflex.planning.shooting` with
    the remaining strokes and rests. Contact before the last observation is not noticed.

    A decision takes 0.3 to 0.9 s of processor time with 50 links. The default ``decision_time`` therefore suits only a
    rope that waits: in real time give a second, which the rests of a cast must leave.
    """
    if not isinstance(plan, CastPlan):
        raise InvalidInput("only casts are followed", got=type(plan).__name__, allowed="a CastPlan")
    problem, moves = plan.problem, plan.required(plan.moves, "motion")
    if problem.obstacles:
        raise InvalidInput("casts past obstacles are not followed", got=f"{len(problem.obstacles)} obstacles")
    refuse_behind(problem.criteria.behind, "a plan that is followed")
    if problem.q0:
        fix = "Follow a plan without state0"
        raise InvalidInput("casts that begin with a swinging rope are not followed", got="q0 and qd0", fix=fix)
    chosen = options or FollowOptions()
    prior, seeds = uncertainty or Uncertainty(), [checks.count("seed", seed, least=0), 1]
    loop = _Loop(plan, moves, chosen, prior.sample(chosen.samples, problem, plan.target, seed=seeds), threads)
    if motor is not None:
        motor.set_motion(loop.motion(), 0.0)
    decisions: list[Decision] = []
    while (decision := loop.decide(source, motor)) is not None:
        decisions.append(decision)
        if motor is not None and decision.action in ("changed", "aborted"):
            motor.set_motion(loop.motion(), decision.t)
        if decision.action == "aborted":
            break
    planned = plan.message if loop.goal else "the planned moves do not strike"
    return FollowResult(loop.moves, loop.motion(), tuple(decisions), chosen, planned)


@dataclass(frozen=True, eq=False)
class Goal:
    """The planned state at the strike: its time `t`, s, and `features` (4 n,) of the joints, see :func:`features`."""

    t: float
    features: Array

    @classmethod
    def of(cls, problem: Problem, peg: Peg, moves: Moves, options: FollowOptions) -> "Goal | None":
        """Return the goal of moves; None without a strike."""
        motion = moves.motion(problem.limits)
        one = RolloutBatch.from_start(problem, [problem.rope], [peg], [motion])
        found = fly_to_strikes(problem, peg, one, Budget())
        if not np.isfinite(found.t[0]):
            return None
        now = features(problem.rope, problem.arm, motion, found.t, found.q, found.qd, options)
        return cls(float(found.t[0]), now[0])


def features(rope: Rope, arm: Arm, motion: Motion, t: Array, q: Array, qd: Array, options: FollowOptions) -> Array:
    """Positions and velocities of the joints (T, 4 n) at times t (T,), s, over their scales and sqrt(n).

    `q`, rad, and `qd`, rad/s, are (T, n); the motion is the arm's.
    """
    base, base_velocity = arm.tip_motion(motion, t)
    places, speeds = rope.joints(q, base)[:, 1:], rope.joint_velocities(q, qd, base_velocity)[:, 1:]
    scaled = np.concatenate([places / options.position_scale, speeds / options.speed_scale], axis=2)
    return np.asarray(scaled.reshape(len(q), -1) / np.sqrt(rope.n_links))


class _Flight(NamedTuple):
    """Moves, and how far their flight passes the goal, over scales, (4 n,), at time `t`, s."""

    moves: Moves
    t: float
    residuals: Array


class _Loop:
    """The cast as decided so far, the next move, and the delay of the strike so far, s.

    Scenarios are ranked by the sum of squared errors (of :func:`features`) in predicting each observed state from the
    one before. Delays of moves are not part of the prediction.
    """

    def __init__(
        self, plan: CastPlan, moves: Moves, options: FollowOptions, scenarios: Sequence[Scenario], threads: int | None
    ) -> None:
        self.problem, self.moves, self.options, self.budget = plan.problem, moves, options, Budget(threads=threads)
        self.scenarios, self.errors = list(scenarios), np.zeros(len(scenarios))
        self.goal = Goal.of(plan.problem, plan.target, moves, options)
        self.move, self.last, self.delay = 1, moves.ends.size - 1, 0.0
        self._seen = hanging_state(plan.problem.rope)

    def motion(self) -> Motion:
        """Return the commanded motion."""
        return self.moves.motion(self.problem.limits)

    def starts(self) -> Array:
        """Return the starts of the moves, s."""
        return self.moves.starts(self.problem.limits)

    def decide(self, source: StateSource, motor: Motor | None) -> Decision | None:
        """Observe the rope at the rest before the next move, and decide; None after the last observation."""
        if self.goal is None or self.move > self.last:
            return None
        options, move, begin = self.options, self.move, time.monotonic()
        left = float(self.moves.timing(self.problem.limits)[0][move])
        now = float(self.starts()[move]) - left
        if now > self.goal.t + self.delay - options.blind_time:
            return None
        planned, state = (self.moves, self.delay), source.state(now, self.motion())
        arm_error = math.nan if motor is None else motor.angle(now) - float(self.motion().angle(now))
        first = move if left >= options.decision_time else move + 1  # that may still be changed
        if far := abs(arm_error) > options.max_arm_error:
            before, after, action = 0.0, 0.0, self.abort(first)
        else:
            self.observe(state)
            before, after, action = self.choose(self.goal, state, first)
        seconds = time.monotonic() - begin
        if options.real_time and seconds > options.decision_time and action != "kept" and not far:
            (self.moves, self.delay), after, action = planned, before, "late"
        self.move += 1
        return Decision(move, now, left, before, after, action, seconds, arm_error)

    def observe(self, state: RopeState) -> None:
        """Add the scenarios' errors in predicting an observed state."""
        if state.t <= self._seen.t:
            return
        motions = [each.without_delays().executed_motion(self.motion()) for each in self.scenarios]
        ropes, arm, t = [each.rope for each in self.scenarios], self.problem.arm, np.array([state.t])
        batch = RolloutBatch.from_state(ropes, [], motions, self._seen)
        _, q, qd = batch.fly(arm, state.t - batch.since, self.budget, at_end=True)
        for m, (rope, motion) in enumerate(zip(ropes, motions, strict=True)):
            observed = features(rope, arm, motion, t, state.q[None], state.qd[None], self.options)
            predicted = features(rope, arm, motion, t, q[m], qd[m], self.options)
            self.errors[m] += float(np.nan_to_num(((predicted - observed) ** 2).sum(), nan=np.inf))
        self._seen = state

    def likely(self) -> list[Scenario]:
        """Return the scenarios with the least errors, best first."""
        return [self.scenarios[m] for m in np.argsort(self.errors, kind="stable")[: self.options.likely]]

    def choose(self, goal: Goal, state: RopeState, first: int) -> tuple[float, float, str]:
        """Plan the cast again from move `first` on; return its success probabilities before and after, and the action.

        It may be aborted from one move before the last one that starts before the strike.
        """
        scenarios, casts, starts = self.likely(), [self.moves], self.starts()
        probability, value = self.probabilities(casts, state, scenarios)
        if first < self.last and probability[0] < 1.0:
            casts.append(self.corrected(goal, scenarios[0].without_delays(), state, first))
            probability, value = self.probabilities(casts, state, scenarios)
        chosen = int(value[-1] > value[0] + self.options.min_gain)
        before, after = float(probability[0]), float(probability[chosen])
        begun = int((starts < goal.t + self.delay).sum())
        if after < self.options.min_probability and self.move >= begun - 1 and first <= self.last:
            return before, after, self.abort(first)
        self.moves = casts[chosen]
        self.delay += float(self.starts()[-1] - starts[-1])
        return before, after, "changed" if chosen else "kept"

    def abort(self, first: int) -> str:
        """Take the arm slowly to hanging, from move `first` on; return the action."""
        made = min(first, self.last)
        self.moves = self.moves.first(made).then(0.0, self.options.decision_time, SLOWLY)
        return "aborted"

    def probabilities(
        self, casts: Sequence[Moves], state: RopeState, scenarios: Sequence[Scenario]
    ) -> tuple[Array, Array]:
        """Return the fraction of the scenarios in which each cast succeeds, and its mean score (W,)."""
        pairs = [(cast, scenario) for cast in casts for scenario in scenarios]
        motions = [scenario.motion(cast, self.problem) for cast, scenario in pairs]
        ropes, pegs = zip(*((scenario.rope, scenario.peg) for _, scenario in pairs), strict=True)
        found = winding_scores(self.problem, RolloutBatch.from_state(ropes, pegs, motions, state), self.budget)
        values = found.turns >= self.problem.criteria.turns, robust_values(found, self.problem)
        probability, value = (each.reshape(len(casts), -1).mean(axis=1) for each in values)
        return probability, value

    def corrected(self, goal: Goal, scenario: Scenario, state: RopeState, first: int) -> Moves:
        """Return the cast with strokes and rests from move `first` on so that it comes nearer the goal in a scenario.

        The last move stays, and a rest that is due now leaves time for the decision.
        """
        options, count = self.options, self.moves.ends.size
        free = np.concatenate([np.arange(first, self.last), np.arange(count + first, count + self.last)])
        scale = np.repeat([-options.stroke_scale, options.rest_scale], self.last - first)  # a longer stroke may not fit
        least, due = min(options.decision_time, float(self.moves.rests[first])), count + first

        def fly(flight: _Flight, changes: Sequence[Array], later: Sequence[float]) -> list[_Flight | None]:
            change = np.zeros((len(changes), 2 * count))
            change[:, free] = changes
            change[:, due] = np.maximum(change[:, due], least - flight.moves.rests[first])
            return [*self._flights(goal, scenario, state, [flight.moves.varied(each) for each in change])]

        begin, how = self._flights(goal, scenario, state, [self.moves])[0], (options.rounds, options.difference)
        return shoot(begin, scale, fly, *how, self.budget)[0].moves

    def _flights(self, goal: Goal, scenario: Scenario, state: RopeState, casts: Sequence[Moves]) -> list[_Flight]:
        """Simulate casts (M) from a state, and compare them with the goal where they pass it nearest."""
        arm, options = self.problem.arm, self.options
        motions = [scenario.motion(cast, self.problem) for cast in casts]
        batch = RolloutBatch.from_state([scenario.rope] * len(casts), [], motions, state)
        t, q, qd = batch.fly(arm, goal.t - state.t + options.window, self.budget)
        near, found = np.flatnonzero(np.abs(t + state.t - goal.t) <= options.window), list[_Flight]()
        for m, (cast, motion) in enumerate(zip(casts, batch.motions, strict=True)):
            rows = features(scenario.rope, arm, motion, t[near], q[m, near], qd[m, near], options)
            rows = np.nan_to_num(rows, nan=1e3)
            way, behind = np.diff(rows, axis=0), goal.features - rows[:-1]
            part = np.clip((behind * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300), 0.0, 1.0)
            away = behind - part[:, None] * way
            k = int((away**2).sum(axis=1).argmin())
            found.append(_Flight(cast, float(t[near][k] + part[k] * (t[1] - t[0])), away[k]))
        return found


class ScenarioStateSource:
    """True state of the rope of a scenario, under the motion that the scenario's motor makes of the command."""

    def __init__(self, scenario: Scenario, arm: Arm) -> None:
        self.scenario, self._true = scenario, TrueState(scenario.rope, arm)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the simulated state at `t`, s, under the command `motion`, made of moves."""
        return self._true.state(t, self.scenario.executed_motion(motion))


class MotorStateSource:
    """True state of a rope on a simulated motor, under the motion that the motor has made.

    The motor is the one that is commanded; it begins where the arm is at t = 0.
    """

    def __init__(self, rope: Rope, arm: Arm, motor: SimulatedMotor) -> None:
        self.motor, self._true = motor, TrueState(rope, arm)

    def state(self, t: float, motion: Motion) -> RopeState:
        """Return the simulated state at `t`, s, under the motor's motion; `motion` is not used."""
        self.motor.true_angle(t)
        return self._true.state(t, motion if t < 2.0 * SAMPLE_TIME else self.motor.motion())
