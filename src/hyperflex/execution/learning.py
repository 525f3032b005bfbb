"""Learning from each cast: parameters of rope and motor, and the motion, until the rope winds.

A Kalman filter follows the rope of the cast through its free flight, with the rope's length, friction and air drag as
unknown constants. So the *parameters* are known after it, with what was known before as the prior; and the *state* at
each rest of the arm, where disturbances of the motion absorb what no parameter explains.

A cast that missed is planned again with this rope: it begins with the same moves, which lead to the state that was
measured at a rest of the arm, and goes on from there in another way. So the model need only be right for the last part
of the next cast.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.budget import Budget, one_thread
from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, InvalidInput, SimulationError
from hyperflex.estimate import EstimatedParameter, Observations, RopeFilter
from hyperflex.interfaces import RopeState
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Arm, Rope, obstacle_gaps
from hyperflex.motion import Motion, lagged
from hyperflex.options import check as check_options
from hyperflex.options import option
from hyperflex.planning import (
    CastPlan,
    Moves,
    Problem,
    RolloutBatch,
    SearchOptions,
    fly_to_strikes,
    refuse_behind,
    replan_cast,
)
from hyperflex.recording import Recording
from hyperflex.status import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class CastLog:
    """What was measured of a cast.

    Parameters
    ----------
    recording : Recording
        Positions of markers in the frame of the arm, until the cast's end; times count from the motion's begin. Its
        `noise` is the error of a value.
    arc_lengths : (K,) array_like
        Distance of each marker from the first joint along the rope as planned, m.
    arm_angle : (T,) array_like, optional
        Measured arm angle at the recording's times, rad; NaN in gaps. Without it the motor's lag is not learned.
    wound : bool, optional
        Whether the rope wound; None if nobody knows, which does not count as a success.
    """

    recording: Recording
    arc_lengths: ArrayLike
    arm_angle: ArrayLike | None = None
    wound: bool | None = None

    def __post_init__(self) -> None:
        t = checks.instance("recording", self.recording, Recording).t
        checks.choice("kind of the recording of a cast", self.recording.kind, ("markers",))
        count = self.recording.data.shape[1] // 2
        value = checks.array("arc_lengths", self.arc_lengths, (count,), sign="nonnegative", unit="m")
        object.__setattr__(self, "arc_lengths", value)
        if self.arm_angle is not None:
            value = checks.array("arm_angle", self.arm_angle, t.shape, unit="rad", gaps=True)
            object.__setattr__(self, "arm_angle", value)


@dataclass(frozen=True, eq=False)
class LearningOptions:
    """Options of :func:`learn_cast`.

    Parameters
    ----------
    parameters, motion : bool
        Whether the parameters of rope and motor are learned, and whether the motion is corrected from what was measured
        at the rests of the arm; without it a cast is planned again from the start.
    wins : int
        Casts in a row that must wind.
    prior : sequence of EstimatedParameter
        What is learned of the rope, and how well it is known before the first cast; a rope without drag, or friction,
        has none to learn.
    struck : float
        Distance from the target, m, in which a rope counts as striking it: its free flight has ended.
    span, settled : float
        Time before the strike, s, from which is learned; and time after its begin from which states are known.
    apart : float
        Time between the samples that are used, s: more take longer, and tell little more.
    varied : int
        Variations of the last moves that are tried before others.
    spread : (least, greatest)
        Standard deviations of these variations: strokes, rad, and rests, in periods of the rope's swing.
    planning : float
        Time to plan a cast again, s, at most.
    clock : callable
        That counts it, s; ``time.process_time`` counts processor time, on a machine that others use.
    threads : int, optional
    """

    parameters: bool = option(True, "learn the parameters of rope and motor")
    motion: bool = option(True, "continue from the measured state")
    wins: int = option(3, "casts in a row that must wind", sign="positive")
    prior: Sequence[EstimatedParameter] = (
        EstimatedParameter("length", 0.02),
        EstimatedParameter("friction", 0.2),
        EstimatedParameter("drag", 0.5),
    )
    struck: float = option(0.02, "distance at which the rope strikes", "m", sign="nonnegative")
    span: float = option(4.0, "time before the strike from which is learned", "s", sign="positive")
    settled: float = option(0.5, "time after which states are known", "s", sign="nonnegative")
    apart: float = option(0.04, "time between the samples that are used", "s", sign="positive")
    varied: int = option(32, "variations of the last moves that are tried first", sign="nonnegative")
    spread: tuple[float, float] = option((0.01, 0.3), "standard deviations of these variations", sign="positive")
    planning: float = option(30.0, "time to plan a cast again", "s", sign="positive")
    clock: Callable[[], float] = time.monotonic
    threads: int | None = None

    def __post_init__(self) -> None:
        check_options(self, "")
        checks.sequence("prior", self.prior, "a sequence of EstimatedParameter")


@dataclass(frozen=True, eq=False)
class Attempt:
    """One cast, and what was learned from it.

    Attributes
    ----------
    number : int
        From 1.
    moves : Moves
        As commanded.
    wound : bool or None
    position, speed : float
        Of the measured joints at the strike from those of the strike that this cast aimed at, root mean square, m and
        m/s; NaN if they were not measured.
    factors : dict of str to float
        Learned factors after this cast, by the names of the prior.
    lag : float
        Learned lag of the motor, s.
    problem : str
        Why nothing could be learned; empty if something was.
    """

    number: int
    moves: Moves
    wound: bool | None
    position: float = math.nan
    speed: float = math.nan
    factors: Mapping[str, float] = field(default_factory=dict)
    lag: float = 0.0
    problem: str = ""

    def __str__(self) -> str:
        ended = {True: "wound", False: "missed", None: "not known whether it wound"}[self.wound]
        head = f"cast {self.number}: {ended}"
        if self.problem:
            return f"{head}; nothing learned: {self.problem}"
        known = [f"{name} {value - 1.0:+.1%}" for name, value in self.factors.items()]
        known.append(f"lag {1e3 * self.lag:.0f} ms")
        strike = f"{1e3 * self.position:.0f} mm and {self.speed:.2g} m/s from the strike aimed at"
        return f"{head}, {strike}; {', '.join(known)}"


@dataclass(frozen=True, eq=False)
class LearningResult:
    """What was learned from casts.

    Attributes
    ----------
    moves : Moves
        To be made next: if it succeeded, those that wound the rope.
    problem : Problem
        With the learned rope.
    lag : float
        Learned lag of the motor, s.
    attempts : tuple of Attempt
    required : int
        Casts in a row that must wind.
    ended : Status or None
        INTERRUPTED, or FAILED where a cast could not be carried out; None if all casts were made.
    error : str
        Why a cast could not be carried out; empty if all were.
    """

    moves: Moves
    problem: Problem
    lag: float
    attempts: tuple[Attempt, ...]
    required: int
    ended: Status | None = None
    error: str = ""

    @property
    def motion(self) -> Motion:
        """Motion of the arm to be commanded next."""
        return self.moves.motion(self.problem.limits)

    @property
    def rope(self) -> Rope:
        """The learned rope."""
        return self.problem.rope

    @property
    def success(self) -> bool:
        """Whether the last casts, as many as required, all wound."""
        return self.status is Status.SUCCESS

    @property
    def status(self) -> Status:
        """SUCCESS, INTERRUPTED, or FAILED: the casts were used up, or one could not be carried out."""
        last = self.attempts[-self.required :]
        if len(last) == self.required and all(each.wound for each in last):
            return Status.SUCCESS
        return self.ended or Status.FAILED

    @property
    def message(self) -> str:
        """Why it failed; empty if it did not."""
        if self.success:
            return ""
        wound = sum(bool(each.wound) for each in self.attempts)
        found = f"{wound} of {len(self.attempts)} casts wound, {self.required} in a row required"
        why = (self.error or self.status).rstrip(".")
        return f"{why}; {found}" if self.ended and self.attempts else why if self.ended else found

    def plot(self) -> "Figure":
        """Draw how far each cast was from the strike that winds, and which ones wound: return a Matplotlib figure."""
        from hyperflex.report import learning_figure

        return learning_figure({"casts": self.attempts})


@interruptible(LearningResult)
def learn_cast(
    plan: CastPlan,
    carry_out: Callable[[CastPlan], CastLog],
    *,
    attempts: int = 10,
    options: LearningOptions | None = None,
    report: Callable[[Attempt], object] | None = None,
) -> LearningResult:
    """Carry a planned cast out again and again, and learn from each, until the rope winds several times running.

    Parameters
    ----------
    plan : CastPlan
        With moves that wind in the model, as planned or read by :func:`hyperflex.read_plan`.
    carry_out : callable
        Makes the motion of a plan from t = 0, on hardware or in a simulation, with the rope hanging at rest, and
        returns what was measured. It gets the plan with the next moves, and the rope as it is known; no simulated run
        verifies it. A HyperflexError ends the learning; what was learned is kept.
    attempts : int
        Casts at most.
    options : LearningOptions, optional
    report : callable, optional
        Gets each attempt; ``print`` shows a line of what was learned.

    Raises
    ------
    InvalidInput
        If the plan is no cast, has no moves that strike, begins with a swinging rope, or touches the target in a swing
        before the strike.
    Interrupted
        By Ctrl-C; its ``partial`` is what was learned so far.

    Notes
    -----
    A cast that winds leaves the motion as it is. Of contact nothing is learned. Tested in simulation only.

    Each cast begins with the last cast's parameters and the standard deviations of `prior`, as they were given: earlier
    casts count through their mean alone. Where a model lacks something, as the bending of the arm, its parameters must
    change from one motion to another; averages over many casts, with deviations that shrink, could not follow.
    """
    checks.instance("plan", plan, CastPlan)
    problem, moves = plan.problem, plan.required(plan.moves, "motion")
    refuse_behind(problem.criteria.behind, "a cast that is learned")
    plan.refuse_earlier_touch("a cast that is learned")
    if problem.q0:
        raise InvalidInput("a cast that is learned begins at rest", got="q0 and qd0", fix="Plan without state0")
    count = checks.count("attempts", attempts)
    learner = _Learner(plan, moves, options or LearningOptions())
    error = ""
    with stoppable() as stop:
        while len(learner.attempts) < count and not learner.done:
            try:
                log = carry_out(replace(learner.plan, moves=learner.moves))
            except HyperflexError as refused:
                error = str(refused)
                break
            learner.learn(checks.instance("what carry_out returned", log, CastLog))
            if report is not None:
                report(learner.attempts[-1])
    ended = stop.status or (Status.FAILED if error else None)
    done, known = tuple(learner.attempts), learner.plan.problem
    return stop.deliver(LearningResult(learner.moves, known, learner.lag, done, learner.options.wins, ended, error))


class _Flown(NamedTuple):
    """The free flight of a log: times (T,), s, and places (T, K, 2), m, of markers with their errors (T, K), m."""

    t: Array
    places: Array
    std: Array


class _Learner:
    """The moves to be made next, the plan with the rope as it is known, the motor's lag, s, and the casts so far."""

    def __init__(self, plan: CastPlan, moves: Moves, options: LearningOptions) -> None:
        self.plan, self.moves, self.options, self.lag = plan, moves, options, 0.0
        self.attempts: list[Attempt] = []
        self._rope = plan.problem.rope  # as it was planned
        self._prior = [each for each in options.prior if np.any(getattr(self._rope, each.name))]
        self._prior = self._prior if options.parameters else []
        self._rest = RopeState(0.0, *plan.problem.start)
        goal = self._strike(self._rest)
        if goal is None:
            raise InvalidInput("the planned moves do not strike", fix="Plan again")
        self._goal = goal

    @property
    def done(self) -> bool:
        """Whether the last casts all wound."""
        last = self.attempts[-self.options.wins :]
        return len(last) == self.options.wins and all(each.wound for each in last)

    def learn(self, log: CastLog) -> None:
        """Learn from a cast with the present moves."""
        made, number = self.moves, len(self.attempts) + 1
        position, speed, problem = math.nan, math.nan, ""
        try:
            position, speed = self._learn(log)
        except InvalidInput as error:
            problem = error.what
        except SimulationError as error:
            problem = str(error)
        factors = {each.name: 1.0 + each.value for each in self._prior}
        self.attempts.append(Attempt(number, made, log.wound, position, speed, factors, self.lag, problem))

    def _learn(self, log: CastLog) -> tuple[float, float]:
        """Learn, and plan again after a miss; return how far the strike is from its goal, m and m/s."""
        problem, moves, goal, lag = self.plan.problem, self.moves, self._goal, self.lag
        commanded = moves.motion(problem.limits)
        if self.options.parameters and log.arm_angle is not None:
            lag = _fitted_lag(commanded, log.recording.t, np.asarray(log.arm_angle))
        motion = lagged(commanded, lag)
        cast = self._flight(log, problem.arm.tip(motion.angle(log.recording.t)), goal.t + lag)
        estimator = RopeFilter(self._rope, log.arc_lengths, motion=motion, arm=problem.arm, parameters=self._prior)
        stops = moves.starts(problem.limits)[:-1] + moves.timing(problem.limits)[1][:-1]
        known = (stops + lag > cast.t[0] + self.options.settled) & (stops + lag < cast.t[-1])
        end = min(goal.t + lag, float(cast.t[-1]))
        struck, *rests = _states(estimator, cast, [end, *(stops[known] + lag)])
        rope = estimator.parameters.rope_at(estimator.x[2 * self._rope.n_links :])
        measured, aimed = (
            _joints(*each, problem.arm) for each in ((rope, motion, struck), (problem.rope, commanded, goal))
        )
        self.lag, self.plan = lag, replace(self.plan, problem=replace(problem, rope=rope))
        self._prior = [EstimatedParameter(each.name, each.std, estimator.values[each.name][0]) for each in self._prior]
        if not log.wound:
            counts = (1 + np.flatnonzero(known)).tolist()
            seen = [(moves.first(k), replace(one, t=stops[k - 1])) for k, one in zip(counts, rests, strict=True)]
            self._improve(seen if self.options.motion else [])
        position, speed = (float(np.sqrt((each**2).sum(axis=1).mean())) for each in measured - aimed)
        return position, speed

    def _improve(self, seen: Sequence[tuple[Moves, RopeState]]) -> None:
        """Plan again, with variations of the present moves after one of the last three rests first."""
        options, number, problem = self.options, len(self.attempts), self.plan.problem
        random, count = np.random.default_rng(number), self.moves.ends.size
        start = list[Moves]()
        for k, size in enumerate(np.geomspace(*options.spread, options.varied).tolist()):
            made = seen[max(0, len(seen) - 1 - k % 3)][0].ends.size if seen else 0
            scale = size * np.repeat([1.0, problem.period], count) * np.tile(np.arange(count) >= made, 2)
            start.append(self.moves.varied(random.standard_normal(2 * count) * scale))
        later = max(problem.time, self._goal.t + 2.0 * problem.period)
        found = replan_cast(
            replace(self.plan, problem=replace(problem, time=later)),
            start,
            seen,
            anew=options.parameters,
            time_budget=Budget(options.planning, clock=options.clock),
            options=SearchOptions(seed=number, threads=options.threads),
        )
        if found.moves is None:
            return
        before, self.moves = self.moves, found.moves
        state = [self._rest, *(state for made, state in seen if found.moves.begins_with(made))][-1]
        goal = self._strike(state)
        self.moves, self._goal = (before, self._goal) if goal is None else (found.moves, goal)

    def _strike(self, state: RopeState) -> RopeState | None:
        """Return the state at which the present moves strike in the model, flown from a state; None if they do not."""
        problem, peg = self.plan.problem, self.plan.target
        motion, latest = self.moves.motion(problem.limits), self.moves.stops(problem.limits) + 0.5
        batch = RolloutBatch.from_state([problem.rope], [peg], [motion], state)
        found = fly_to_strikes(problem, peg, batch, Budget(), max(problem.time, latest))
        t = state.t + float(found.t[0])
        return RopeState(t, found.q[0], found.qd[0]) if math.isfinite(t) else None

    # ------------------------------------------------------------------ what was measured

    def _flight(self, log: CastLog, base: Array, expected: float) -> _Flown:
        """Return the free flight of a log, its strike about when expected, s; InvalidInput if there is too little."""
        rope, recording, peg = self.plan.problem.rope, log.recording, self.plan.target
        t = recording.t
        noise = np.zeros(recording.data.shape) if recording.noise is None else recording.noise
        places, std = recording.data.reshape(t.size, -1, 2), noise.reshape(t.size, -1, 2).max(axis=2)
        line = np.concatenate([base[:, None], places], axis=1)
        near = obstacle_gaps((peg,), line[:, :-1], line[:, 1:]).reshape(t.size, -1)
        touched = np.nan_to_num(near, nan=np.inf).min(axis=1) < rope.radius + self.options.struck
        touched &= t > 0.5 * expected  # a rope that hangs in front of the target does not strike it
        strike = min(float(t[touched.argmax()]) if touched.any() else math.inf, expected + 0.3)
        flown = (t >= max(0.0, strike - self.options.span)) & (t < strike)
        if not np.isfinite(places[flown & (t > strike - 0.12)]).any():
            raise InvalidInput("no marker was seen in the 0.12 s before the strike")
        some = np.flatnonzero(flown)
        apart = max(1, round(self.options.apart / float(np.median(np.diff(t[some])))))
        some = some[(some.size - 1) % apart :: apart]
        return _Flown(t[some], places[some], np.maximum(std[some], 1e-3))


def _joints(rope: Rope, motion: Motion, state: RopeState, arm: Arm) -> Array:
    """Return places, m, and velocities, m/s, (2, n + 1, 2) of a rope's joints under a motion of the arm."""
    base, velocity = (each[0] for each in arm.tip_motion(motion, np.array([state.t])))
    return np.stack([rope.joints(state.q, base), rope.joint_velocities(state.q, state.qd, velocity)])


def _states(estimator: RopeFilter, cast: _Flown, times: Sequence[float]) -> list[RopeState]:
    """Let a filter follow a cast; return its states at some times, s, or at the end where that is sooner."""
    found, wanted = dict[float, RopeState](), sorted(times)
    with one_thread():  # matrices are small: threads would wait for each other
        for t, places, std in zip(*cast, strict=True):
            while wanted and wanted[0] <= t and estimator.t is not None:
                at = wanted.pop(0)
                found[at] = estimator.state_at(max(at, estimator.t))
            estimator.update(Observations(t, places, std))
    return [found.get(each, estimator.state) for each in times]


def _fitted_lag(motion: Motion, t: Array, angle: Array) -> float:
    """Return the lag, s, with which a motor made a motion, from measured angles (T,), rad, at times t (T,), s."""
    from scipy.optimize import minimize_scalar

    known = np.isfinite(angle)

    def cost(lag: float) -> float:
        return float(((lagged(motion, lag).angle(t[known]) - angle[known]) ** 2).sum())

    longest = 0.5 * float(np.diff(motion.breaks).max())
    return float(minimize_scalar(cost, bounds=(0.0, longest), method="bounded", options={"xatol": 1e-4}).x)
