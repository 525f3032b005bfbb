"""A planned cast in closed loop: at each rest of the arm, the remaining moves lead back to the planned strike."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.control import TrueState, hanging_state
from hyperflex.errors import InvalidInput
from hyperflex.hardware import SAMPLE_TIME, SimulatedMotor
from hyperflex.interfaces import Motor, RopeState, StateSource
from hyperflex.interruption import interruptible
from hyperflex.model import Arm, Peg, Rope
from hyperflex.motion import Motion
from hyperflex.options import check, option
from hyperflex.planning.moves import Moves
from hyperflex.planning.options import refuse_behind
from hyperflex.planning.plan import CastPlan
from hyperflex.planning.problem import Problem
from hyperflex.planning.rollouts import RolloutBatch, fly_to_strikes, winding_scores
from hyperflex.planning.shooting import shoot
from hyperflex.planning.uncertainty import Scenario
from hyperflex.status import Status

SLOWLY = 0.3  # fraction of the motor's speed at which an aborted cast takes the arm down
# m, m/s: units in the distance from the planned strike, in which such errors of a joint count alike
PLACE, SPEED = 0.05, 0.5
LEAST_GAIN = 0.1  # reduction of that distance below which the moves stay as they are
# s, rad: scales of the changes of a rest and of a stroke; in these, the step of the finite differences
REST, STROKE, DIFFERENCE = 0.15, 0.6, 0.06
ROUNDS = 1  # Gauss-Newton steps of a correction: the next one is made at the next rest
WINDOW = 0.3  # s about the planned strike within which flights are compared


@dataclass(frozen=True)
class FollowOptions:
    """Options of :func:`follow_plan`.

    Parameters
    ----------
    decision_time : float
        Time allowed for a decision, s: moves that are due sooner are made as planned.
    real_time : bool
        Whether the rope moves on during a decision: a decision that is not ready before the move that it changes is
        discarded. By default the rope waits, as a simulated one does.
    sending : float
        Time to send a decision to the motor, s.
    max_arm_error : float
        Angle, rad, between arm and command at a rest, above which a cast is aborted.
    blind_time : float
        Time before the expected strike, s, within which the rope is no longer observed.
    """

    decision_time: float = option(0.3, "Time for a correction.", "s", sign="nonnegative")
    real_time: bool = option(False, "Discard corrections that are not ready in time.")
    sending: float = option(0.05, "Time to send a correction to the motor.", "s", sign="nonnegative")
    max_arm_error: float = option(
        0.2, "Angle between arm and command at a rest that aborts a cast.", "rad", sign="nonnegative"
    )
    blind_time: float = option(
        0.15, "Time before the strike within which the rope is not observed.", "s", sign="nonnegative"
    )

    def __post_init__(self) -> None:
        check(self, "")


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
        Distance of the predicted strike from the planned one before and after the decision: root mean square of the
        errors of the joints' positions and velocities, in units of 0.05 m and 0.5 m/s; inf if the rope is predicted
        not to strike.
    action : {"kept", "changed", "aborted", "late"}
        Late: the decision came too late and was not carried out. What is aborted too late ends after the move that had
        begun.
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
        The commanded moves, with all changes.
    motion : Motion
        Their motion.
    decisions : tuple of Decision
    options : FollowOptions
    planned : str
        Why the unchanged plan fails; empty if it succeeds.
    turns : float
        Turns that the rope makes and keeps in a simulation from the last observed state; NaN without one.
    required : float
        Turns that are required.
    """

    moves: Moves
    motion: Motion
    decisions: tuple[Decision, ...]
    options: FollowOptions
    planned: str = ""
    turns: float = math.nan
    required: float = 0.0

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
        if not self.completed:
            far = abs(last.arm_error) > self.options.max_arm_error
            why = f"the arm is {abs(last.arm_error):.2g} rad from its command" if far else "the rope will not strike"
            return f"aborted at {last.t:.2f} s: {why}"
        if self.turns >= self.required:
            return ""
        return f"expected to miss: from {last.t:.2f} s on the model makes {self.turns:.2f} of {self.required:g} turns"

    @property
    def status(self) -> Status:
        """SUCCESS: the cast was completed, and the rope winds in a simulation from the last observed state.

        Without an observation: the plan succeeds.
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
    rope: Rope | None = None,
    options: FollowOptions | None = None,
    threads: int | None = None,
) -> FollowResult:
    """Execute a planned cast in closed loop: at each rest, correct the remaining moves from the observed state.

    Parameters
    ----------
    plan : CastPlan
        With moves, as it was planned or read by :func:`hyperflex.read_plan`.
    source : StateSource
        Source of the rope's state, with as many links as the plan's rope.
    motor : Motor, optional
        It gets the plan at t = 0 and each change at a rest; its angle is read there. Without a motor only `source` gets
        the commands.
    rope : Rope, optional
        The rope as now known, for example longer, with the same number of links; by default the plan's. It is led to
        the planned strike at the same distances from the arm.
    options : FollowOptions, optional
    threads : int, optional

    Raises
    ------
    InvalidInput
        If the plan is no cast or has no moves, its rope touches the target in a swing before the strike, or a number is
        out of range.

    Notes
    -----
    From each observed state the flight is simulated and compared, at its nearest approach, with the planned strike in
    positions and velocities of all joints. Gauss-Newton steps on the remaining strokes and rests
    (:mod:`hyperflex.planning.shooting`) reduce this distance; they are carried out if they reduce it by 0.1.
    Contact before the last observation is not detected.

    A decision takes 0.05 to 0.3 s of processor time with 50 links.
    """
    if not isinstance(plan, CastPlan):
        raise InvalidInput("only casts are followed", got=type(plan).__name__, allowed="a CastPlan")
    problem, moves = plan.problem, plan.required(plan.moves, "motion")
    if problem.obstacles:
        raise InvalidInput("casts past obstacles are not followed", got=f"{len(problem.obstacles)} obstacles")
    refuse_behind(problem.criteria.behind, "a plan that is followed")
    plan.refuse_earlier_touch("a plan that is followed")
    if problem.q0:
        fix = "Follow a plan without state0"
        raise InvalidInput("casts that begin with a swinging rope are not followed", got="q0 and qd0", fix=fix)
    chosen = options or FollowOptions()
    if motor is not None:
        motor.set_motion(moves.motion(problem.limits), 0.0)
    goal = Goal.of(problem, plan.target, moves)
    if goal is None:
        return FollowResult(moves, moves.motion(problem.limits), (), chosen, "the planned moves do not strike")
    rope = rope or problem.rope
    loop = _Loop(replace(problem, rope=rope), plan.target, moves, goal.at(problem.rope, rope), chosen, threads)
    decisions: list[Decision] = []
    while (decision := loop.decide(source, motor)) is not None:
        if motor is not None and decision.action in ("changed", "aborted") and not loop.command(motor, decision):
            decision = replace(decision, after=decision.before, action="late")
        decisions.append(decision)
        if decision.action == "aborted":
            break
    turns = loop.predicted_turns() if decisions and decisions[-1].action != "aborted" else math.nan
    return FollowResult(
        loop.moves, loop.motion(), tuple(decisions), chosen, plan.message, turns, problem.criteria.turns
    )


@dataclass(frozen=True, eq=False)
class Goal:
    """The planned state at the strike: its time `t`, s, and `features` (4 n,) of the joints, see :func:`features`."""

    t: float
    features: Array

    @classmethod
    def of(cls, problem: Problem, peg: Peg, moves: Moves) -> "Goal | None":
        """Return the goal of moves; None without a strike."""
        motion = moves.motion(problem.limits)
        one = RolloutBatch.from_start(problem, [problem.rope], [peg], [motion])
        found = fly_to_strikes(problem, peg, one, Budget())
        if not np.isfinite(found.t[0]):
            return None
        now = features(problem.rope, problem.arm, motion, found.t, found.q, found.qd)
        return cls(float(found.t[0]), now[0])

    def at(self, planned: Rope, rope: Rope) -> "Goal":
        """Return the same state of another rope: its joints are where the planned one is as far from the arm.

        A longer rope goes on in the last link's direction.
        """
        from scipy.interpolate import make_interp_spline

        joints = make_interp_spline(planned.link_ends, self.features.reshape(planned.n_links, -1), k=1)
        return Goal(self.t, joints(rope.link_ends).reshape(-1))

    def passed(self, t: Array, rows: Array) -> tuple[float, Array]:
        """Return when features (T, 4 n) at times t (T,), s, pass the goal nearest, and the residuals (4 n,) there."""
        rows = np.nan_to_num(rows, nan=1e3)
        way, behind = np.diff(rows, axis=0), self.features - rows[:-1]
        part = np.clip((behind * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300), 0.0, 1.0)
        away = behind - part[:, None] * way
        k = int((away**2).sum(axis=1).argmin())
        return float(t[k] + part[k] * (t[1] - t[0])), away[k]


def features(rope: Rope, arm: Arm, motion: Motion, t: Array, q: Array, qd: Array) -> Array:
    """Positions and velocities of the joints (T, 4 n) at times t (T,), s, over PLACE, SPEED and sqrt(n).

    `q`, rad, and `qd`, rad/s, are (T, n); the motion is the arm's.
    """
    base, base_velocity = arm.tip_motion(motion, t)
    places, speeds = rope.joints(q, base)[:, 1:], rope.joint_velocities(q, qd, base_velocity)[:, 1:]
    scaled = np.concatenate([places / PLACE, speeds / SPEED], axis=2)
    return np.asarray(scaled.reshape(len(q), -1) / np.sqrt(rope.n_links))


class _Flight(NamedTuple):
    """Moves, and how far their flight passes the goal, over scales, (4 n,), at time `t`, s."""

    moves: Moves
    t: float
    residuals: Array


class _Loop:
    """The cast as decided so far, the next move, and the delay of the strike so far, s."""

    def __init__(
        self, problem: Problem, target: Peg, moves: Moves, goal: Goal, options: FollowOptions, threads: int | None
    ) -> None:
        self.problem, self.target, self.moves, self.goal, self.options = problem, target, moves, goal, options
        self.budget, self.move, self.last, self.delay = Budget(threads=threads), 1, moves.ends.size - 1, 0.0
        self.seen = hanging_state(problem.rope)
        self._planned = moves, 0.0  # moves and delay before the last decision

    def motion(self) -> Motion:
        """Return the commanded motion."""
        return self.moves.motion(self.problem.limits)

    def starts(self) -> Array:
        """Return the starts of the moves, s."""
        return self.moves.starts(self.problem.limits)

    def decide(self, source: StateSource, motor: Motor | None) -> Decision | None:
        """Observe the rope at the rest before the next move, and decide; None after the last observation."""
        options, move = self.options, self.move
        if move > self.last:
            return None
        left = float(self.moves.timing(self.problem.limits)[0][move])
        now = float(self.starts()[move]) - left
        if now > self.goal.t + self.delay - options.blind_time:
            return None
        self._planned, self.seen = (self.moves, self.delay), source.state(now, self.motion())
        begin = time.monotonic()
        arm_error = math.nan if motor is None else motor.angle(now) - float(self.motion().angle(now))
        first = move if left >= options.decision_time else move + 1  # that may still be changed
        before, after, action = math.inf, math.inf, "aborted"
        if abs(arm_error) > options.max_arm_error:
            self.abort(first)
        else:
            before, after, action = self.choose(first)
        seconds = time.monotonic() - begin
        due = float(self.starts()[min(first, self.last)]) - now - options.sending  # of the first move that may change
        if options.real_time and seconds > due and action == "changed":  # an abort may still begin at a later rest
            (self.moves, self.delay), after, action = self._planned, before, "late"
        self.move += 1
        return Decision(move, now, left, before, after, action, seconds, arm_error)

    def command(self, motor: Motor, decision: Decision) -> bool:
        """Command what was decided; return whether the motor took it. If it did not, the moves of before remain.

        A motor that has begun the next moves meanwhile makes them to their end before it aborts.
        """
        taken = motor.set_motion(self.motion(), decision.t)
        made = decision.move
        while not taken and decision.action == "aborted" and made <= self.last:
            made += 1
            self.moves = self._aborted(self._planned[0], made)
            taken = motor.set_motion(self.motion(), decision.t)
        if not taken:
            self.moves, self.delay = self._planned
        return taken

    def choose(self, first: int) -> tuple[float, float, str]:
        """Correct the cast from move `first` on; return its distances from the goal before and after, and the action.

        It may be aborted from one move before the last one that starts before the strike.
        """
        starts, kept = self.starts(), self.flights([self.moves])[0]
        best = self.corrected(kept, first) if first < self.last else kept
        before, after = (float(np.linalg.norm(each.residuals)) for each in (kept, best))
        changed = after < before - LEAST_GAIN
        chosen = best if changed else kept
        begun = int((starts < self.goal.t + self.delay).sum())
        if self.move >= begun - 1 and first <= self.last:
            strikes = fly_to_strikes(self.problem, self.target, self._rollouts([chosen.moves]), self.budget)
            if not np.isfinite(strikes.t[0]):
                self.abort(first)
                return before, math.inf, "aborted"
        self.moves = chosen.moves
        self.delay += float(self.starts()[-1] - starts[-1])
        return before, after if changed else before, "changed" if changed else "kept"

    def predicted_turns(self) -> float:
        """Return the turns that the model's rope makes and keeps, from the last observed state on."""
        batch = self._rollouts([self.moves])
        return float(winding_scores(self.problem, batch, self.budget, self.moves.dwell).turns[0])

    def abort(self, first: int) -> None:
        """Take the arm slowly to hanging, from move `first` on."""
        self.moves = self._aborted(self.moves, min(first, self.last))

    def _aborted(self, moves: Moves, made: int) -> Moves:
        return moves.first(made).then(0.0, self.options.decision_time, SLOWLY)

    def corrected(self, kept: _Flight, first: int) -> _Flight:
        """Return the flight with strokes and rests from move `first` on so that it comes nearer the goal.

        The last move stays, and a rest that is due now leaves time for the decision.
        """
        count = self.moves.ends.size
        free = np.concatenate([np.arange(first, self.last), np.arange(count + first, count + self.last)])
        scale = np.repeat([-STROKE, REST], self.last - first)  # a longer stroke may not fit
        least, due = min(self.options.decision_time, float(self.moves.rests[first])), count + first

        def fly(flight: _Flight, changes: Sequence[Array], later: Sequence[float]) -> list[_Flight | None]:
            change = np.zeros((len(changes), 2 * count))
            change[:, free] = changes
            change[:, due] = np.maximum(change[:, due], least - flight.moves.rests[first])
            return [*self.flights([flight.moves.varied(each) for each in change])]

        return shoot(kept, scale, fly, ROUNDS, DIFFERENCE, self.budget)[0]

    def flights(self, casts: Sequence[Moves]) -> list[_Flight]:
        """Simulate casts (M) from the observed state, and compare them with the goal where they pass it nearest."""
        goal, since, batch = self.goal, self.seen.t, self._rollouts(casts)
        t, q, qd = batch.fly(self.problem.arm, goal.t - since + WINDOW, self.budget)
        near, found = np.flatnonzero(np.abs(t + since - goal.t) <= WINDOW), list[_Flight]()
        for m, (cast, motion) in enumerate(zip(casts, batch.motions, strict=True)):
            passing = t[near], q[m, near], qd[m, near]
            rows = features(self.problem.rope, self.problem.arm, motion, *passing)
            found.append(_Flight(cast, *goal.passed(t[near], rows)))
        return found

    def _rollouts(self, casts: Sequence[Moves]) -> RolloutBatch:
        """Return rollouts of casts (M) from the observed state."""
        motions = [cast.motion(self.problem.limits) for cast in casts]
        count = len(casts)
        return RolloutBatch.from_state([self.problem.rope] * count, [self.target] * count, motions, self.seen)


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
