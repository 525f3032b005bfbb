"""Learning from each cast: parameters of rope and motor, and the motion, until the rope winds.

After each cast two things are updated. The *parameters*: factors on the rope's length, friction and air drag, and the
motor's lag, fitted to the cast's free flight with what was known before as the prior. Each stretch of it is flown from
the state that was measured at a rest of the arm: what the model lacks does not add up over the cast.

The *motion*: iterative learning at the critical instant. Five times a second the measured state is compared with the
model's, flown from the one before. The next casts are flown with the same differences added on the way: so the model
makes the last cast exactly as it was measured, and is as wrong for others near it. In this model strokes and rests are
corrected, by damped Gauss-Newton steps, until the strike is the state that is known to wind. These moves and variations
of them then strike in contact, and the least change that winds is made next.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.identification import perturbed
from hyperflex.interfaces import RopeState
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Peg, Rope, parse_label, unit_across, unit_along
from hyperflex.motion import Motion, lagged
from hyperflex.options import check as check_options
from hyperflex.options import option
from hyperflex.planning import (
    MODEL,
    CastPlan,
    FollowOptions,
    Goal,
    Moves,
    Problem,
    RolloutBatch,
    SearchOptions,
    WindingScores,
    features,
    find_strikes,
    obstacle_gaps,
    refuse_behind,
    scaled_rope,
    shoot,
    wound_after,
)
from hyperflex.recording import Recording
from hyperflex.sensors import lever_arms
from hyperflex.status import Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ASIDE = (
    (0.0, 0.0),
    (1.0, 0.0),
    (-1.0, 0.0),
    (0.0, 1.0),
    (0.0, -1.0),
)  # where a target may stand, in errors of the model


@dataclass(frozen=True, eq=False)
class CastLog:
    """What was measured of a cast.

    Parameters
    ----------
    recording : Recording
        Link angles, or positions of markers in the frame of the arm, until the cast's end; times count from the
        motion's begin. Its `noise` is the error of a value.
    arc_lengths : (K,) array_like, optional
        Distance of each marker from the first joint along the rope as planned, m; by default markers are at the joints.
    arm_angle : (T,) array_like, optional
        Measured arm angle at the recording's times, rad; NaN in gaps. Without it the motor's lag is not learned.
    wound : bool, optional
        Whether the rope wound; None if nobody knows, which does not count as a success.
    turns : float, optional
        Most turns that it made about the target at any time: the winding rope's friction is learned from them.
    """

    recording: Recording
    arc_lengths: npt.ArrayLike | None = None
    arm_angle: npt.ArrayLike | None = None
    wound: bool | None = None
    turns: float | None = None

    def __post_init__(self) -> None:
        t = checks.instance("recording", self.recording, Recording).t
        if self.arc_lengths is not None:
            if self.recording.kind != "markers":
                raise InvalidInput("arc_lengths are of markers", got=self.recording.kind, fix="Omit them")
            count = self.recording.n_links + 1
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
        Whether the parameters of rope and motor are learned, and whether the motion is corrected.
    wins : int
        Casts in a row that must wind.
    prior : mapping of str to float
        What is learned of the rope, in the words of :func:`hyperflex.identify` ("friction:factor", "length:factor",
        "drag:factor", ...), each with the standard deviation of its logarithm before the first cast; a rope without
        drag, or friction, has none to learn. The motor's lag is learned wherever the arm's angle is measured.
    span : float
        Time that the model is flown from a measured state to fit the parameters, s.
    model_error : float
        Error of the model's positions, m, that no parameter explains. It is correlated over a flight, so that each
        coordinate of a marker counts as one measurement of this standard deviation and the noise. A rope that comes
        nearer to the target than this counts as striking it, and the target may be aside by so much.
    between : float
        Time between two measured states, s.
    strike_window : float
        Time about such a state, s, from which it is measured.
    min_samples : int
        Samples in this window that a marker needs.
    speeds : tuple of float
        Speeds at the strike at which is aimed, times those of the state that winds.
    caution : float
        Weight of changes of the motion, in its scales, against the distance from the state that winds.
    tried, rounds, checked : int
        Variations of the moves that are tried in contact after a miss; rounds in which the best are varied again; how
        many of the best these are, and are also tried with shorter links, and with the target aside.
    sure : float
        Part of these trials in which the rope must wind, less the costs of the change: no further rounds then.
    spread : (least, greatest)
        Standard deviations of these variations, in scales.
    score : float
        What a score of as many turns as are required counts, in casts that wind.
    change, away : float
        What a change by one scale costs, and one scale of distance from the state that winds, in casts that wind.
    correction : FollowOptions
        Scales of errors and changes, Gauss-Newton steps, their differences, and the window about the strike.
    threads : int, optional
    """

    parameters: bool = option(True, "learn the parameters of rope and motor")
    motion: bool = option(True, "correct the motion")
    wins: int = option(3, "casts in a row that must wind", sign="positive")
    prior: Mapping[str, float] = field(
        default_factory=lambda: {"length:factor": 0.02, "friction:factor": 0.2, "drag:factor": 0.5}
    )
    span: float = option(1.0, "time flown from a measured state to fit the parameters", unit="s", sign="positive")
    model_error: float = option(
        0.02, "error of the model's positions that no parameter explains", unit="m", sign="positive"
    )
    between: float = option(0.2, "time between two measured states", unit="s", sign="positive")
    strike_window: float = option(0.12, "time about a state in which it is measured", unit="s", sign="positive")
    min_samples: int = option(5, "samples in this time that a marker needs", sign="positive")
    speeds: tuple[float, ...] = option((1.0, 1.2), "speeds at the strike, times those that wind", sign="positive")
    caution: float = option(0.3, "weight of changes of the motion", sign="nonnegative")
    tried: int = option(48, "variations of the moves tried after a miss", sign="nonnegative")
    rounds: int = option(5, "rounds in which the best are varied", sign="nonnegative")
    checked: int = option(8, "of these, tried with the target aside", sign="positive")
    sure: float = option(0.8, "part of these trials in which the rope must wind", sign="nonnegative")
    spread: tuple[float, float] = option((0.02, 0.5), "standard deviations of the variations", sign="positive")
    score: float = option(0.5, "what the score of a cast counts", sign="nonnegative")
    change: float = option(0.03, "cost of a change by one scale", sign="nonnegative")
    away: float = option(0.03, "cost of one scale of distance from the state that winds", sign="nonnegative")
    correction: FollowOptions = field(default_factory=lambda: FollowOptions(rounds=8))
    threads: int | None = None

    def __post_init__(self) -> None:
        check_options(self, "")
        for word, std in checks.mapping("prior", self.prior).items():
            checks.number(f"prior of {word}", std, sign="positive")
            if (label := parse_label(word)) is None or label.law != "factor":
                raise InvalidInput("prior has an unknown word", got=word, allowed="factors, as 'friction:factor'")


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
    distance : float
        Of the measured state at the strike from the one that this cast aimed at, root mean square over the markers, in
        scales of position and speed; NaN if it was not measured.
    position, speed : float
        The same in m and in m/s.
    factors : dict of str to float
        Learned factors after this cast, by the words of the prior.
    lag : float
        Learned lag of the motor, s.
    residual : float
        Root mean square of what the model leaves of this cast's flight after learning, m.
    problem : str
        Why nothing could be learned; empty if something was.
    """

    number: int
    moves: Moves
    wound: bool | None
    distance: float = math.nan
    position: float = math.nan
    speed: float = math.nan
    factors: Mapping[str, float] = field(default_factory=dict)
    lag: float = 0.0
    residual: float = math.nan
    problem: str = ""

    def __str__(self) -> str:
        ended = {True: "wound", False: "missed", None: "not known whether it wound"}[self.wound]
        head = f"cast {self.number}: {ended}"
        if self.problem:
            return f"{head}; nothing learned: {self.problem}"
        known = [f"{word.partition(':')[0]} {value - 1.0:+.1%}" for word, value in self.factors.items()]
        known.append(f"lag {1e3 * self.lag:.0f} ms")
        left = f"the model is off by {1e3 * self.residual:.0f} mm in flight"
        strike = f"{1e3 * self.position:.0f} mm and {self.speed:.2g} m/s from the strike aimed at"
        return f"{head}, {strike}; {', '.join(known)}; {left}"


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
        return f"{self.error or self.status}; {found}" if self.ended else found

    def plot(self) -> "Figure":
        """Draw how far each cast was from the strike that winds, and which ones wound: return a Matplotlib figure."""
        from hyperflex.report import learning_figure

        return learning_figure({"casts": self.attempts})


@interruptible(LearningResult)
def learn_cast(
    plan: CastPlan,
    carry_out: Callable[[Motion], CastLog],
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
        Makes a motion of the arm from t = 0, on hardware or in a simulation, with the rope hanging at rest, and returns
        what was measured. A HyperflexError ends the learning; what was learned is kept.
    attempts : int
        Casts at most.
    options : LearningOptions, optional
    report : callable, optional
        Gets each attempt; ``print`` shows a line of what was learned.

    Raises
    ------
    InvalidInput
        If the plan is no cast, has no moves that strike, or begins with a swinging rope.
    Interrupted
        By Ctrl-C; its ``partial`` is what was learned so far.

    Notes
    -----
    A cast that winds leaves the motion as it is. Of contact it is only learned with how much friction the winding rope
    makes as many turns as were seen. Tested in simulation only.
    """
    checks.instance("plan", plan, CastPlan)
    problem, moves = plan.problem, plan.required(plan.moves, "motion")
    refuse_behind(problem.criteria.behind, "a cast that is learned")
    if problem.q0:
        raise InvalidInput("a cast that is learned begins at rest", got="q0 and qd0", fix="Plan without state0")
    count = checks.count("attempts", attempts)
    learner = _Learner(plan, moves, options or LearningOptions())
    error = ""
    with stoppable() as stop:
        while len(learner.attempts) < count and not learner.done:
            try:
                log = carry_out(learner.moves.motion(problem.limits))
            except HyperflexError as refused:
                error = str(refused)
                break
            learner.learn(checks.instance("what carry_out returned", log, CastLog))
            if report is not None:
                report(learner.attempts[-1])
    ended = stop.status or (Status.FAILED if error else None)
    now = learner.model
    done = tuple(learner.attempts)
    return stop.deliver(LearningResult(learner.moves, now.problem, now.lag, done, learner.options.wins, ended, error))


@dataclass(frozen=True, eq=False)
class _Model:
    """The model so far: a problem with the learned rope, its target, and the motor's lag, s."""

    problem: Problem
    peg: Peg
    lag: float = 0.0

    def motion(self, moves: Moves) -> Motion:
        """Return the arm's motion when these moves are commanded."""
        return lagged(moves.motion(self.problem.limits), self.lag)

    def with_rope(self, rope: Rope) -> "_Model":
        """Return the same with another rope."""
        return replace(self, problem=replace(self.problem, rope=rope))


class _Flown(NamedTuple):
    """The free flight of a log: times (T,), s; places (T, K, 2), m, of markers at parts (K,) of the rope's length.

    `noise` (T, K, 2) is in m; `strike` is its end, s.
    """

    moves: Moves
    t: Array
    places: Array
    noise: Array
    parts: Array
    strike: float


class _Node(NamedTuple):
    """A measured state of a cast, and how far, (n,), rad and rad/s, it is from the model's, from the node before."""

    state: RopeState
    turn: Array
    spin: Array


class _Start(NamedTuple):
    """Where moves may begin to differ from those of a cast: after some that are made, from the first of some nodes."""

    made: int
    nodes: Sequence[_Node]

    @property
    def state(self) -> RopeState:
        """The state of the first node."""
        return self.nodes[0].state


class _Cast(NamedTuple):
    """Moves, flown from a start of the last cast."""

    moves: Moves
    start: _Start


class _Shot(NamedTuple):
    """Moves, the time at which they pass the goal nearest, s, and how far they and their change are, over scales."""

    moves: Moves
    t: float
    residuals: Array


class _Learner:
    """The moves to be made next, the model, and the casts so far."""

    def __init__(self, plan: CastPlan, moves: Moves, options: LearningOptions) -> None:
        self.plan, self.moves, self.options = plan, moves, options
        self.budget = Budget(threads=options.threads)
        self.model = _Model(plan.problem, plan.target)
        self.attempts: list[Attempt] = []
        words = [(word, std, parse_label(word)) for word, std in options.prior.items()]
        self._prior = {
            word: std for word, std, label in words if label and np.any(getattr(plan.problem.rope, label.name))
        }
        self._logs = np.zeros(len(self._prior))  # logarithms of the factors
        goal = Goal.of(plan.problem, plan.target, moves, options.correction)
        if goal is None:
            raise InvalidInput("the planned moves do not strike", fix="Plan again")
        self._planned = goal  # that winds in the model it was planned with
        self._damping = 1.0  # of the rope as it winds, times its friction
        self._random = np.random.default_rng(0)

    @property
    def done(self) -> bool:
        """Whether the last casts all wound."""
        last = self.attempts[-self.options.wins :]
        return len(last) == self.options.wins and all(each.wound for each in last)

    @property
    def goal(self) -> Goal:
        """The state that winds, of the rope as it is known now."""
        return self._planned.at(self.plan.problem.rope, self.model.problem.rope)

    def learn(self, log: CastLog) -> None:
        """Learn from a cast with the present moves."""
        made, number, parts, options = self.moves, len(self.attempts) + 1, self._parts(log), self.options
        try:
            cast = self._flight(log, parts, self._planned.t)
        except InvalidInput as error:
            known = self._known()
            self.attempts.append(
                Attempt(number, made, log.wound, problem=error.what, factors=known, lag=self.model.lag)
            )
            return
        if options.parameters:
            self._learn_parameters(log, cast)
        starts = self._starts(cast, self._follow(cast))
        _, away = self._passed([_Cast(made, starts[-1])], self.goal)
        position, speed = (float(np.linalg.norm(each)) for each in np.split(away.reshape(-1, 4), 2, axis=1))
        if not log.wound:
            self._improve(starts if options.motion else [_Start(0, self._rest())], log.turns)
        t = cast.t[cast.t > 0.0]
        left = self._places(cast, self._rest()[0].state, t)[0] - cast.places[-t.size :]
        self.attempts.append(
            Attempt(
                number,
                made,
                log.wound,
                math.hypot(position, speed),
                options.correction.position_scale * position,
                options.correction.speed_scale * speed,
                factors=self._known(),
                lag=self.model.lag,
                residual=math.sqrt(2.0 * float(np.nanmean(left**2))),
            )
        )

    # ------------------------------------------------------------------ what was measured

    def _parts(self, log: CastLog) -> Array:
        """Return where the markers are, as parts (K,) of the rope's length."""
        rope, recording = self.plan.problem.rope, log.recording
        joints = np.append(0.0, rope.link_ends)
        where = joints if log.arc_lengths is None else np.asarray(log.arc_lengths)
        count = recording.n_links + 1
        if log.arc_lengths is None and count != joints.size:
            raise InvalidInput(
                "the log is of a rope with other links", got=count - 1, allowed=f"{rope.n_links}, or arc_lengths"
            )
        return np.asarray(where / rope.total_length)

    def _flight(self, log: CastLog, parts: Array, expected: float) -> _Flown:
        """Return the free flight of a log, its strike about when expected, s; InvalidInput if there is too little."""
        rope, arm, recording, options = self.model.problem.rope, self.model.problem.arm, log.recording, self.options
        t = recording.t
        noise = np.zeros(recording.data.shape) if recording.noise is None else recording.noise
        base = arm.tip(self.model.motion(self.moves).angle(t))
        if recording.kind == "angles":
            places = rope.joints(recording.data, base)
            lever = np.sqrt(np.append(np.zeros((t.size, 1)), np.cumsum((noise * rope.length) ** 2, axis=1), axis=1))
            noise = np.repeat(lever[:, :, None], 2, axis=2)
        else:
            places, noise = (each.reshape(t.size, -1, 2) for each in (recording.data, noise))
        line = np.concatenate([base[:, None], places], axis=1)
        near = obstacle_gaps((self.model.peg,), line[:, :-1], line[:, 1:]).reshape(t.size, -1)
        touched = np.nan_to_num(near, nan=np.inf).min(axis=1) < rope.radius + options.model_error
        touched &= t > 0.5 * expected  # a rope that hangs in front of the target does not strike it
        strike = float(t[touched.argmax()]) if touched.any() else expected + options.correction.window
        strike = min(strike, expected + options.correction.window)
        flown = (t >= 0.0) & (t < strike)
        near_strike = flown & (t >= strike - options.strike_window)
        seen = np.isfinite(places[near_strike]).all(axis=2).sum(axis=0) >= options.min_samples
        if not seen.any():
            raise InvalidInput(
                f"no marker has {options.min_samples} samples in the {options.strike_window:g} s before the strike"
            )
        return _Flown(self.moves, t[flown], places[flown], noise[flown], parts, strike)

    # ------------------------------------------------------------------ parameters

    def _known(self) -> dict[str, float]:
        """Return the learned factors."""
        return dict(zip(self._prior, np.exp(self._logs).tolist(), strict=True))

    def _rope(self, logs: Array) -> Rope:
        """Return the planned rope with the logarithms of its factors."""
        words = dict(zip(self._prior, np.eye(logs.size), strict=True))
        return perturbed(self.plan.problem.rope, words, logs)

    def _learn_parameters(self, log: CastLog, cast: _Flown) -> None:
        """Fit lag and factors to a cast, with the prior; twice, since measured states depend on the rope a little."""
        from scipy.optimize import least_squares

        if log.arm_angle is not None:
            motion = self.moves.motion(self.model.problem.limits)
            self.model = replace(self.model, lag=_fitted_lag(motion, log.recording.t, np.asarray(log.arm_angle)))
        spreads = np.array(list(self._prior.values()))
        for _ in range(2 if spreads.size else 0):
            starts = self._starts(cast, self._follow(cast))

            def left(every: Array, starts: Sequence[_Start] = starts) -> Array:
                ropes = [self._rope(logs) for logs in every]
                parts = [self._residuals(cast, each.state, ropes) for each in starts]
                return np.concatenate([*parts, every / spreads], axis=1)

            def slopes(logs: Array, left: Callable[[Array], Array] = left) -> Array:
                steps = self.options.correction.difference * np.diag(spreads)
                begin, *ends = left(np.vstack([logs, logs + steps]))
                return np.asarray((np.array(ends) - begin).T / np.diag(steps))

            self._logs = least_squares(
                lambda logs, left=left: left(logs[None])[0], self._logs, slopes, x_scale=spreads, xtol=1e-3
            ).x
            self.model = self.model.with_rope(self._rope(self._logs))

    def _residuals(self, cast: _Flown, state: RopeState, ropes: Sequence[Rope]) -> Array:
        """Return the errors of ropes from a state of a cast, over their standard deviations (M, m)."""
        some = (cast.t > state.t) & (cast.t <= state.t + self.options.span)
        places, _, _ = self._places(cast, state, cast.t[some], ropes)
        known = np.isfinite(cast.places[some])
        left = (places - cast.places[some]) / np.hypot(self.options.model_error, cast.noise[some])
        left = np.where(known, np.nan_to_num(left, nan=1e3), 0.0)
        return np.asarray((left / np.sqrt(np.maximum(known.sum(axis=0), 1))).reshape(len(ropes), -1))

    # ------------------------------------------------------------------ the flight

    def _rest(self) -> list[_Node]:
        """Return the rope at rest."""
        q, qd = self.model.problem.start
        return [_Node(RopeState(0.0, q, qd), np.zeros(q.size), np.zeros(q.size))]

    def _run(
        self,
        motions: Sequence[Motion],
        q: Array,
        qd: Array,
        since: float,
        t: Array,
        ropes: Sequence[Rope] | None = None,
    ) -> tuple[Array, Array]:
        """Simulate free flights from states (M, n) at a time, s; return q and qd (M, T, n) at times t (T,), s."""
        problem, threads = self.model.problem, self.budget.threads
        batch = RolloutBatch(
            ropes or [problem.rope] * len(motions), [], [each.shifted(-since) for each in motions], q, qd
        )
        run = batch.run(
            problem.arm, t - since, tol=MODEL.tol, keep=("q", "qd"), time_budget=self.budget, threads=threads
        )
        return run.q, run.qd

    def _places(
        self, cast: _Flown, state: RopeState, t: Array, ropes: Sequence[Rope] | None = None
    ) -> tuple[Array, Array, Array]:
        """Return places of the markers (M, T, K, 2), m, angles and rates (M, T, n) of ropes from a state of a cast."""
        model = self.model
        every, motion = ropes or [model.problem.rope], model.motion(cast.moves)
        q, qd = (np.tile(each, (len(every), 1)) for each in (state.q, state.qd))
        q, qd = self._run([motion] * len(every), q, qd, state.t, t, every)
        base = model.problem.arm.tip(motion.angle(t))[:, None]
        arms = [lever_arms(rope, cast.parts * rope.total_length)[1] for rope in every]
        return np.stack([base + arm @ unit_along(each) for arm, each in zip(arms, q, strict=True)]), q, qd

    def _follow(self, cast: _Flown) -> list[_Node]:
        """Return the states of a cast: the model from each one to the next, corrected by lines through its markers."""
        options, rope, nodes = self.options, self.model.problem.rope, self._rest()
        order = np.argsort(cast.parts)
        order = order[cast.parts[order] > 0.0]
        where, joints = np.append(0.0, cast.parts[order]), np.append(0.0, rope.link_ends) / rope.total_length
        share = np.stack([np.interp(joints, where, one) for one in np.eye(where.size)], axis=1)  # (n + 1, K + 1)
        half = 0.5 * options.strike_window
        while (now := nodes[-1].state.t + options.between) <= cast.t[-1]:
            near = np.abs(cast.t - min(now, cast.t[-1] - half)) <= half + 1e-9
            near &= cast.t > nodes[-1].state.t
            t = np.union1d(cast.t[near], now)
            places, q, qd = (each[0] for each in self._places(cast, nodes[-1].state, t))
            left = cast.places[near] - places[np.isin(t, cast.t[near])]
            error = np.zeros((2, where.size, 2))  # of places, m, and speeds, m/s
            for j, k in enumerate(order, 1):
                seen = np.isfinite(left[:, k]).all(axis=1)
                enough = seen.sum() >= options.min_samples
                line = np.polyfit(cast.t[near][seen] - now, left[seen, k], 1)[::-1] if enough else error[:, j - 1]
                error[:, j] = line  # what was not seen is as wrong as the next marker towards the arm
            k = int(np.searchsorted(t, now))
            turned, spun = _turned(rope, q[k], qd[k], *(share @ error))
            nodes.append(_Node(RopeState(now, turned, spun), turned - q[k], spun - qd[k]))
        return nodes

    def _starts(self, cast: _Flown, nodes: Sequence[_Node]) -> list[_Start]:
        """Return where the moves of a cast may begin to differ: one for each that begins before its strike."""
        limits, moves, t = self.model.problem.limits, cast.moves, np.array([each.state.t for each in nodes])
        begins = moves.starts(limits)
        stops = np.append(0.0, begins + moves.timing(limits)[1])  # of the move before
        count = max(1, int((begins < min(cast.strike, self._planned.t)).sum()))
        first = np.searchsorted(t, stops[:count] + 1e-9, side="right") - 1
        return [_Start(k, nodes[j:]) for k, j in enumerate(first.tolist())]

    def _fly(self, casts: Sequence[Moves], start: _Start, t: Array) -> tuple[Array, Array]:
        """Return flights of casts from a start at times t (T,), s: at each node, the model is as wrong as it was."""
        motions, nodes = [self.model.motion(each) for each in casts], start.nodes
        q, qd = (np.tile(each, (len(casts), 1)) for each in (start.state.q, start.state.qd))
        found = list[tuple[Array, Array]]()
        for node, after in zip(nodes, [*nodes[1:], None], strict=True):
            since, until = node.state.t, float(t[-1]) if after is None else after.state.t
            if min(until, t[-1]) <= since:
                break
            inside = t[(t > since) & (t <= until)]
            grid = np.union1d(inside, until)
            rows, rates = self._run(motions, q, qd, since, grid)
            if after is not None:
                rows[:, -1], rates[:, -1] = rows[:, -1] + after.turn, rates[:, -1] + after.spin
            some = np.isin(grid, inside)
            found.append((rows[:, some], rates[:, some]))
            q, qd = np.nan_to_num(rows[:, -1]), np.nan_to_num(rates[:, -1])
        rows, rates = (np.concatenate(each, axis=1) for each in zip(*found, strict=True))
        return rows, rates

    # ------------------------------------------------------------------ motion

    def _improve(self, starts: Sequence[_Start], turns: float | None) -> None:
        """Choose the next moves: the least change that winds most surely, from one of some starts."""
        options, peg = self.options, self.model.peg
        if options.parameters and turns is not None:
            self._learn_damping(_Cast(self.moves, starts[-1]), turns)
        some = [starts[-(2**k)] for k in range(len(starts).bit_length())]
        goals = [self.goal.faster(each) for each in options.speeds]
        corrected = [self._corrected(start, goal) for start in some for goal in goals]
        casts = corrected + self._variations([*corrected, *(_Cast(self.moves, start) for start in some)])
        best, value = self._best(casts)
        for _ in range(options.rounds):
            if value >= options.sure:
                break
            best, value = self._best([*best, *self._variations(best)])
        pegs = [replace(peg, x=peg.x + a * options.model_error, y=peg.y + b * options.model_error) for a, b in ASIDE]
        around = self._values([each for each in best for _ in pegs], pegs * len(best)).reshape(len(best), -1)
        fine = self._values(best, [peg] * len(best), SearchOptions.pieces)
        self.moves = best[int(np.minimum(fine, around.mean(axis=1)).argmax())].moves

    def _learn_damping(self, cast: _Cast, turns: float) -> None:
        """Choose how much more friction the winding rope has, so that the model makes as many turns as were seen."""
        factors, made = np.geomspace(1.0, 256.0, 17), list[float]()
        for self._damping in factors.tolist():
            made.append(float(self._contacts([cast], [self.model.peg])[0].most[0]))
        self._damping = float(factors[int(np.abs(np.array(made) - turns).argmin())])

    def _best(self, casts: Sequence[_Cast]) -> tuple[list[_Cast], float]:
        """Return the best of some casts in contact, and the value of the first."""
        values = self._values(casts, [self.model.peg] * len(casts))
        order = np.argsort(-values, kind="stable")[: self.options.checked]
        return [casts[k] for k in order], float(values[order[0]])

    def _scale(self, moves: Moves) -> Array:
        """Return the scales of parameters (2 k,) of moves: strokes, rad, and rests, s."""
        options = self.options.correction
        return np.repeat([options.stroke_scale, options.rest_scale], moves.ends.size)

    def _variations(self, some: Sequence[_Cast]) -> list[_Cast]:
        """Return casts whose strokes and rests differ at random from some, by little and by more."""
        count, found = self.options.tried // len(some), list[_Cast]()
        for moves, start in some:
            spreads: Array = np.geomspace(*self.options.spread, count)
            scale = self._scale(moves) * (np.tile(np.arange(moves.ends.size), 2) >= start.made)
            changes = self._random.standard_normal((count, scale.size)) * spreads[:, None] * scale
            found += [_Cast(moves.varied(each), start) for each in changes]
        return found

    def _values(self, casts: Sequence[_Cast], pegs: Sequence[Peg], pieces: int = 1) -> Array:
        """Return how surely casts (M,) wind, each round its peg, less what their change and distance cost."""
        options, scale = self.options, self._scale(self.moves)
        found, away = self._contacts(casts, pegs, pieces)
        change = np.array([np.linalg.norm((each.parameters - self.moves.parameters) / scale) for each, _ in casts])
        required = self.model.problem.criteria.turns
        winds = (found.turns >= required) + options.score * np.clip(found.score / required, -1.0, 1.0)
        return np.asarray(winds - options.change * change - options.away * away)

    def _contacts(self, casts: Sequence[_Cast], pegs: Sequence[Peg], pieces: int = 1) -> tuple[WindingScores, Array]:
        """Return what becomes of casts (M,) in contact, each link in so many pieces, and how far they pass the goal."""
        model, problem = self.model, self.model.problem
        cut = replace(problem, rope=scaled_rope(problem.rope, 1.0, 1.0, self._damping)).cut(pieces)
        scores, away = WindingScores(*np.zeros((4, len(casts)))), np.zeros(len(casts))
        for start in {id(each): each for _, each in casts}.values():
            rows = [k for k, (_, each) in enumerate(casts) if each is start]
            moves = [casts[k].moves for k in rows]
            motions, since = [model.motion(each) for each in moves], start.state.t
            end = max(problem.time, *(float(each.breaks[-1]) + 0.5 for each in motions))
            t: Array = since + MODEL.step * np.arange(1.0, math.ceil((end - since) / MODEL.step))
            q, qd = self._fly(moves, start, t)
            away[rows] = [np.linalg.norm(self._pass(self.goal, *each, t)[1]) for each in zip(moves, q, qd, strict=True)]
            some = [pegs[k] for k in rows]
            batch = RolloutBatch.from_state([problem.rope] * len(rows), some, motions, start.state)
            found = find_strikes(problem, model.peg, batch, t - since, q, qd)
            found = replace(found, q=np.repeat(found.q, pieces, axis=1), qd=np.repeat(found.qd, pieces, axis=1))
            wound = wound_after(cut, replace(batch, ropes=[cut.rope] * len(rows)), found, self.budget)
            for name, each in vars(wound).items():
                getattr(scores, name)[rows] = each
        return scores, away

    def _pass(self, goal: Goal, moves: Moves, q: Array, qd: Array, t: Array) -> tuple[float, Array]:
        """Return when a flight (T, n) passes a goal nearest, s, and how far, (4 n,), over scales."""
        options, problem = self.options.correction, self.model.problem
        near = np.abs(t - goal.t) <= options.window + 1e-9
        motion = self.model.motion(moves)
        return goal.passed(t[near], features(problem.rope, problem.arm, motion, t[near], q[near], qd[near], options))

    def _passed(self, casts: Sequence[_Cast], goal: Goal) -> tuple[Array, Array]:
        """Return when casts (M,) from the same start pass a goal nearest, s, and how far, (M, 4 n), over scales."""
        start, window = casts[0].start, self.options.correction.window
        t: Array = np.linspace(-window, window, 2 * math.ceil(window / MODEL.step) + 1) + goal.t
        t = t[t > start.state.t]
        flights = self._fly([each.moves for each in casts], start, t)
        found = [self._pass(goal, each.moves, q, qd, t) for each, q, qd in zip(casts, *flights, strict=True)]
        times, away = zip(*found, strict=True)
        return np.array(times), np.stack(away)

    def _corrected(self, start: _Start, goal: Goal) -> _Cast:
        """Return the last moves, corrected so that the model meets a goal.

        Strokes and rests that begin before the strike are free; the first move after it keeps its time from it.
        """
        options, limits, moves = self.options, self.model.problem.limits, self.moves
        count, begins = moves.ends.size, moves.starts(limits)
        begun = max(int((begins < goal.t).sum()), start.made + 1)
        free = np.concatenate([each + np.arange(start.made, begun) for each in (0, count)])
        scale = self._scale(moves)[free]

        def shots(some: Sequence[Moves]) -> list[_Shot | None]:
            times, away = self._passed([_Cast(each, start) for each in some], goal)
            costs = [(each.parameters - moves.parameters)[free] * (options.caution / scale) for each in some]
            return [_Shot(*each) for each in zip(some, times, np.hstack([away, costs]), strict=True)]

        def fly(shot: _Shot, changes: Sequence[Array], _: Sequence[float]) -> list[_Shot | None]:
            some = np.zeros((len(changes), 2 * count))
            some[:, free] = changes
            found = [shot.moves.varied(each) for each in some]
            return shots([replace(each, ends=np.clip(each.ends, *limits.angles)) for each in found])

        (first,) = shots([moves])
        assert first is not None  # noqa: S101 all have residuals
        best, _ = shoot(first, scale, fly, options.correction.rounds, options.correction.difference, self.budget)
        if begun == count:
            return _Cast(best.moves, start)
        rests, now = best.moves.rests.copy(), best.moves.starts(limits)
        rests[begun] += (begins[begun] - goal.t) - (now[begun] - best.t)
        return _Cast(replace(best.moves, rests=rests), start)


def _turned(rope: Rope, q: Array, qd: Array, error: Array, speed_error: Array) -> tuple[Array, Array]:
    """Return angles, rad, and rates, rad/s, (n,) whose joints are elsewhere by (n + 1, 2), m, and m/s."""
    error, speed_error = (np.diff(each, axis=0) / rope.length[:, None] for each in (error, speed_error))
    along, across = unit_along(q), unit_across(q)
    to, speed = along + error, qd[:, None] * across + speed_error
    turned = q + np.arctan2((to * across).sum(axis=1), (to * along).sum(axis=1))
    return turned, (speed * unit_across(turned)).sum(axis=1) / np.hypot(*to.T)


def _fitted_lag(motion: Motion, t: Array, angle: Array) -> float:
    """Return the lag, s, with which a motor made a motion, from measured angles (T,), rad, at times t (T,), s."""
    from scipy.optimize import minimize_scalar

    known = np.isfinite(angle)

    def cost(lag: float) -> float:
        return float(((lagged(motion, lag).angle(t[known]) - angle[known]) ** 2).sum())

    longest = 0.5 * float(np.diff(motion.breaks).max())
    return float(minimize_scalar(cost, bounds=(0.0, longest), method="bounded", options={"xatol": 1e-4}).x)
