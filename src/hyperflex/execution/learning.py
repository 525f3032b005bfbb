"""Learning from each cast: parameters of rope and motor, and the motion, until the rope winds.

After each cast two things are updated. The *parameters*: factors on the rope's length, friction and air drag, and the
motor's lag, fitted to the free flights of all casts so far, from their known start at rest, with what was known before
as the prior. The *motion*: iterative learning at the critical instant. The state at the strike is compared with one
that is known to wind, and strokes and rests are corrected, by Gauss-Newton steps on the model, so that the model's
state plus the repeated part of its error meets that state. These moves and variations of them then strike in the
simulation, from the model's state plus that error; the least change that surely winds is made next.
"""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.budget import Budget
from hyperflex.checks import Array
from hyperflex.errors import HyperflexError, InvalidInput
from hyperflex.identification import perturbed
from hyperflex.interruption import interruptible, stoppable
from hyperflex.model import Arm, Peg, Rope, parse_label, unit_across, unit_along
from hyperflex.motion import Motion, lagged
from hyperflex.options import check as check_options
from hyperflex.options import option
from hyperflex.planning import (
    MIN_REST,
    CastPlan,
    FollowOptions,
    Moves,
    Problem,
    RolloutBatch,
    SearchOptions,
    find_strikes,
    fly_to_strikes,
    obstacle_gaps,
    plan_cast,
    refuse_behind,
    robust_values,
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
    """

    recording: Recording
    arc_lengths: npt.ArrayLike | None = None
    arm_angle: npt.ArrayLike | None = None
    wound: bool | None = None

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
    newest : float
        Weight of the newest cast in the repeated error of the model: 1 forgets all others.
    model_error : float
        Error of the model's positions, m, that no parameter explains. It is correlated over a cast, so that each
        coordinate of a marker counts as one measurement of this standard deviation and the noise. A rope that comes
        nearer to the target than this counts as striking it.
    strike_window : float
        Time before the strike, s, from which the state at the strike is measured.
    min_samples : int
        Samples in this window that a marker needs.
    caution : tuple of float
        Weights of changes of the motion, in its scales, against the distance from the state that winds: moves corrected
        with each of them are tried.
    tried, checked : int
        Variations of the moves that are tried in the model after a miss; how many of the best are also tried with
        shorter links, and with the target aside by `model_error` times the misses so far.
    spread : (least, greatest)
        Standard deviations of these variations, in scales. Nearer than the greatest to a cast that missed although it
        winds by the model, the model is not believed.
    change : float
        What a change by one scale costs, as a part of the trials that must wind.
    sure : float
        Part of these trials in which the rope must wind; below, a new plan is tried if parameters are learned.
    replanning_time : float
        Time for a new plan, s; 0 for none.
    correction : FollowOptions
        Scales of errors and changes, step of the differences, and the window about the strike.
    threads : int, optional
    """

    parameters: bool = option(True, "learn the parameters of rope and motor")
    motion: bool = option(True, "correct the motion")
    wins: int = option(3, "casts in a row that must wind", sign="positive")
    prior: Mapping[str, float] = field(
        default_factory=lambda: {"length:factor": 0.02, "friction:factor": 0.2, "drag:factor": 0.5}
    )
    newest: float = option(0.7, "weight of the newest cast in the repeated error of the model", sign="positive")
    model_error: float = option(
        0.02, "error of the model's positions that no parameter explains", unit="m", sign="positive"
    )
    strike_window: float = option(0.12, "time before the strike in which it is measured", unit="s", sign="positive")
    min_samples: int = option(5, "samples in this time that a marker needs", sign="positive")
    caution: tuple[float, ...] = option((0.3, 1.0), "weights of changes of the motion", sign="nonnegative")
    tried: int = option(48, "variations of the moves tried after a miss", sign="positive")
    checked: int = option(8, "of these, tried with the target aside", sign="positive")
    spread: tuple[float, float] = option((0.02, 0.3), "standard deviations of the variations", sign="positive")
    change: float = option(0.1, "cost of a change by one scale", sign="nonnegative")
    sure: float = option(0.6, "part of these trials in which the rope must wind", sign="nonnegative")
    replanning_time: float = option(60.0, "time for a new plan where no correction winds", unit="s", sign="nonnegative")
    correction: FollowOptions = field(default_factory=FollowOptions)
    threads: int | None = None

    def __post_init__(self) -> None:
        check_options(self, "")
        for word, std in checks.mapping("prior", self.prior).items():
            checks.number(f"prior of {word}", std, sign="positive")
            if (label := parse_label(word)) is None or label.law != "factor":
                raise InvalidInput("prior has an unknown word", got=word, allowed="factors, as 'friction:factor'")
        if self.newest > 1.0:
            raise InvalidInput("newest is a weight", got=self.newest, allowed="more than 0, up to 1")


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
    replanned : bool
        Whether a new plan was needed after this cast.
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
    replanned: bool = False
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
        return f"{head}, {strike}; {', '.join(known)}; {left}{'; planned again' if self.replanned else ''}"


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
    The repeated error of the model is its mean over the casts, of which the newest has the weight `newest`; a cast that
    winds leaves the motion as it is. Contact is not learned. Tested in simulation only.
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
    missed: bool = True


@dataclass(frozen=True)
class _Error:
    """Error of the model's flights (T, K, 2), m, that repeats in casts, of which later ones count more."""

    casts: Sequence[_Flown]
    flights: Sequence[Array]
    options: "LearningOptions"

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return the error (T, K, 2), m, and its slope, m/s, at times t (T,), s.

        That of a marker that was not seen is the one of the next marker towards the arm, or 0.
        """
        first, *others = (_lines(*each, t, self.options) for each in zip(self.casts, self.flights, strict=True))
        both, near = functools.reduce(self._mean, others, first), np.zeros((2, t.size, 2))
        for k in self._along():
            both[:, :, k] = near = np.where(np.isnan(both[:, :, k]), near, both[:, :, k])
        return both[0], both[1]

    def _along(self) -> list[int]:
        """Return the numbers of the markers from the arm to the tip."""
        return [int(k) for k in np.argsort(self.casts[-1].parts)]

    def _mean(self, before: Array, now: Array) -> Array:
        """Return the mean of errors with one more; what one does not know is the other's."""
        mean = (1.0 - self.options.newest) * before + self.options.newest * now
        return np.where(np.isnan(before), now, np.where(np.isnan(now), before, mean))

    def turned(self, rope: Rope, t: Array, q: Array, qd: Array) -> tuple[Array, Array]:
        """Return what the error at times t (T,), s, adds to angles q, rad, and rates qd, rad/s, (M, T, n)."""
        joints, order, parts = np.append(0.0, rope.link_ends) / rope.total_length, self._along(), self.casts[-1].parts
        order = [k for k in order if parts[k] > 0.0]
        known = np.append(0.0, parts[order])
        share = np.stack([np.interp(joints, known, one) for one in np.eye(known.size)[1:]], axis=1)  # (n + 1, K)
        value, slope = (np.diff(share @ each[:, order], axis=1) / rope.length[:, None] for each in self.at(t))
        along, across = unit_along(q), unit_across(q)
        turn = (value * across).sum(axis=-1)
        return turn, (slope * across).sum(axis=-1) - qd * (value * along).sum(axis=-1)


class _Goal(NamedTuple):
    """A state that winds: moves and their motion that reach it with a rope; its time, s, angles and rates (1, n).

    Other ropes are compared with it at the same distances from the arm: a longer one begins to wind in the same way.
    """

    moves: Moves
    motion: Motion
    rope: Rope
    t: float
    q: Array
    qd: Array

    def state(self, arm: Arm, arcs: Array) -> tuple[Array, Array]:
        """Return places, m, and speeds, m/s, (1, K, 2) at distances along the rope (K,), m, also beyond its tip."""
        return _states(self.rope, arm, self.motion, np.array([self.t]), self.q, self.qd, arcs)


class _Shot(NamedTuple):
    """Where moves pass a goal: time, s, and residuals (4 K,)."""

    t: float
    residuals: Array


class _Learner:
    """The moves to be made next, the model, and the casts so far."""

    def __init__(self, plan: CastPlan, moves: Moves, options: LearningOptions) -> None:
        self.plan, self.moves, self.options = plan, moves, options
        self.budget = Budget(threads=options.threads)
        self.model = _Model(plan.problem, plan.target)
        self.attempts: list[Attempt] = []
        self._casts: list[_Flown] = []
        self._since = 0  # casts before the present plan
        words = [(word, std, parse_label(word)) for word, std in options.prior.items()]
        self._prior = {
            word: std for word, std, label in words if label and np.any(getattr(plan.problem.rope, label.name))
        }
        self._logs = np.zeros(len(self._prior))  # logarithms of the factors
        goal = self._strike(moves)
        if goal is None:
            raise InvalidInput("the planned moves do not strike", fix="Plan again")
        self._goal = goal  # that winds in the model it was planned with
        self._random = np.random.default_rng(0)

    @property
    def done(self) -> bool:
        """Whether the last casts all wound."""
        last = self.attempts[-self.options.wins :]
        return len(last) == self.options.wins and all(each.wound for each in last)

    def learn(self, log: CastLog) -> None:
        """Learn from a cast with the present moves."""
        made, number, parts = self.moves, len(self.attempts) + 1, self._parts(log)
        try:
            cast = self._flight(log, parts, self._goal.t)
        except InvalidInput as error:
            known = self._known()
            self.attempts.append(
                Attempt(number, made, log.wound, problem=error.what, factors=known, lag=self.model.lag)
            )
            return
        self._casts.append(cast)
        if self.options.parameters:
            self._learn_parameters(log)
        flights = self._predictions()
        distance, position, speed = self._distance(made, _Error([cast], flights[-1:], self.options))
        replanned = False if log.wound else self._improve(flights)
        left = np.nan_to_num(cast.places - flights[-1])
        self.attempts.append(
            Attempt(
                number,
                made,
                log.wound,
                distance,
                position,
                speed,
                factors=self._known(),
                lag=self.model.lag,
                residual=float(np.sqrt((left**2).sum(axis=2).mean())),
                replanned=replanned,
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
        return _Flown(self.moves, t[flown], places[flown], noise[flown], parts, strike, not log.wound)

    # ------------------------------------------------------------------ parameters

    def _known(self) -> dict[str, float]:
        """Return the learned factors."""
        return dict(zip(self._prior, np.exp(self._logs).tolist(), strict=True))

    def _rope(self, logs: Array) -> Rope:
        """Return the planned rope with the logarithms of its factors."""
        words = dict(zip(self._prior, np.eye(logs.size), strict=True))
        return perturbed(self.plan.problem.rope, words, logs)

    def _learn_parameters(self, log: CastLog) -> None:
        """Fit the lag to this cast, and the factors to all casts, with the prior."""
        from scipy.optimize import least_squares

        if log.arm_angle is not None:
            motion = self.moves.motion(self.model.problem.limits)
            self.model = replace(self.model, lag=_fitted_lag(motion, log.recording.t, np.asarray(log.arm_angle)))
        if not self._logs.size:
            return
        spreads, now = np.array(list(self._prior.values())), self.model

        def left(every: Array) -> Array:
            models = [now.with_rope(self._rope(logs)) for logs in every]
            parts = [self._residuals(cast, models) for cast in self._casts]
            return np.concatenate([*parts, every / spreads], axis=1)

        def slopes(logs: Array) -> Array:
            steps = self.options.correction.difference * np.diag(spreads)
            begin, *ends = left(np.vstack([logs, logs + steps]))
            return np.asarray((np.array(ends) - begin).T / np.diag(steps))

        found = least_squares(lambda logs: left(logs[None])[0], self._logs, slopes, x_scale=spreads, xtol=1e-3)
        self._logs = found.x
        self.model = now.with_rope(self._rope(found.x))

    def _residuals(self, cast: _Flown, models: Sequence[_Model]) -> Array:
        """Return the errors of models in a cast, over their standard deviations (M, m)."""
        places, _ = _fly(models, [cast.moves] * len(models), cast.t, cast.parts, self.budget)
        over = np.hypot(self.options.model_error, cast.noise)
        left = (places - cast.places) / over
        known = np.isfinite(cast.places)
        left = np.where(known, np.nan_to_num(left, nan=1e3), 0.0) / np.sqrt(np.maximum(known.sum(axis=0), 1))
        return np.asarray(left.reshape(len(models), -1))

    # ------------------------------------------------------------------ aim

    def _strike(self, moves: Moves) -> _Goal | None:
        """Return the strike of moves in the model; None without one."""
        model, problem, motion = self.model, self.model.problem, self.model.motion(moves)
        one = RolloutBatch.from_start(problem, [problem.rope], [model.peg], [motion])
        found = fly_to_strikes(problem, model.peg, one, self.budget, max(problem.time, float(motion.breaks[-1]) + 0.5))
        if not np.isfinite(found.t[0]):
            return None
        return _Goal(moves, motion, problem.rope, float(found.t[0]), found.q, found.qd)

    def _improve(self, flights: Sequence[Array]) -> bool:
        """Choose the next moves, by the model and its repeated error; return whether they were planned again.

        Moves corrected for the planned strike, and variations of them and of those so far, are tried in the model. If
        none of them is `sure` to wind, a new plan is tried as well, if parameters are learned, and otherwise those
        corrected are next.
        """
        options, since = self.options, self._since
        error = _Error(self._casts[since:], flights[since:], options) if options.motion else None
        goal = self._goal._replace(moves=self.moves)
        corrected = [self._corrected(goal, error, weight) for weight in options.caution]
        tried = [*corrected, *self._variations([self.moves, *corrected])]
        moves, value = self._best(self.moves, tried, error)
        self.moves = moves if value >= options.sure else corrected[0]
        return value < options.sure and options.parameters and options.replanning_time > 0.0 and self._replan(value)

    def _replan(self, least: float) -> bool:
        """Plan again in the model as it is now; return whether that winds more surely than the `least` value."""
        options, problem = self.options, self.model.problem
        search = SearchOptions(seed=len(self._casts), threads=options.threads, skip_feasibility=True)  # one was found
        given: dict[str, Any] = {"time_budget": options.replanning_time, "options": search}
        plan = plan_cast(problem.rope, problem.arm, self.model.peg, **given)
        goal = None if plan.moves is None else self._strike(plan.moves)
        if goal is None:
            return False
        moves, value = self._best(goal.moves, [goal.moves, *self._variations([goal.moves])], None)
        if value <= least:
            return False
        self.moves, self._goal, self._since = moves, goal, len(self._casts)
        return True

    def _best(self, now: Moves, tried: Sequence[Moves], error: "_Error | None") -> tuple[Moves, float]:
        """Return which of some moves winds most surely with the least change of those now, and its value.

        All are flown in the model with its repeated error, and strike in contact; the best also with shorter links, and
        with the target aside, by more after each miss. Near casts that missed the model is not believed, as far as it
        says that they wind.
        """
        options, peg = self.options, self.model.peg
        missed = [each.moves for each in self._casts[self._since :] if each.missed and now is self.moves]
        wound = self._values(missed, [peg] * len(missed), error, SearchOptions.pieces) if missed else np.zeros(0)
        near = np.exp([[-self._apart(a, b) / options.spread[1] for b in missed] for a in tried])
        costs = options.change * np.array([self._apart(now, each) for each in tried])
        costs += (near * wound).max(axis=1, initial=0.0)
        coarse = self._values(tried, [peg] * len(tried), error) - costs
        best = np.argsort(-coarse, kind="stable")[: options.checked].tolist()
        aside = options.model_error * max(1, len(missed))
        pegs = [replace(peg, x=peg.x + a * aside, y=peg.y + b * aside) for a, b in ASIDE]
        some = [tried[k] for k in best]
        around = self._values([each for each in some for _ in pegs], pegs * len(some), error).reshape(len(some), -1)
        fine = self._values(some, [peg] * len(some), error, SearchOptions.pieces)
        values = np.minimum(fine, around.mean(axis=1)) - costs[best]
        return some[values.argmax()], float(values.max())

    def _apart(self, one: Moves, other: Moves) -> float:
        """Return how far parameters of moves are apart, in scales."""
        return float(np.linalg.norm((one.parameters - other.parameters) / self._scale(one)))

    def _scale(self, moves: Moves) -> Array:
        """Return the scales of parameters (2 k,) of moves: strokes, rad, and rests, s."""
        options = self.options.correction
        return np.repeat([options.stroke_scale, options.rest_scale], moves.ends.size)

    def _variations(self, some: Sequence[Moves]) -> list[Moves]:
        """Return moves whose strokes and rests differ at random from some moves, by little and by more."""
        count, found = self.options.tried // len(some), list[Moves]()
        for moves in some:
            spreads: Array = np.geomspace(*self.options.spread, count)
            scale = self._scale(moves)
            changes = self._random.standard_normal((count, scale.size)) * spreads[:, None] * scale
            found += [moves.varied(each) for each in changes]
        return found

    def _values(self, casts: Sequence[Moves], pegs: Sequence[Peg], error: "_Error | None", pieces: int = 1) -> Array:
        """Return how surely casts (M,) wind, each round its peg, in the model with an error of its flights.

        In contact each link is cut into so many pieces.
        """
        model, problem, budget = self.model, self.model.problem, self.budget
        motions = [model.motion(moves) for moves in casts]
        batch = RolloutBatch.from_start(problem, [problem.rope] * len(casts), pegs, motions)
        span = max(problem.time, max(float(each.breaks[-1]) for each in motions) + 0.5)
        t, q, qd = batch.fly(problem.arm, span, budget)
        if error is not None:
            change, rate = error.turned(problem.rope, t, q, qd)
            q, qd = q + change, qd + rate
        found = find_strikes(problem, model.peg, batch, t, q, qd)
        cut = problem.cut(pieces)
        found = replace(found, q=np.repeat(found.q, pieces, axis=1), qd=np.repeat(found.qd, pieces, axis=1))
        return robust_values(wound_after(cut, replace(batch, ropes=[cut.rope] * len(casts)), found, budget), cut)

    # ------------------------------------------------------------------ motion

    def _predictions(self) -> list[Array]:
        """Return the model's places (T, K, 2), m, for all casts so far."""
        return [_fly([self.model], [each.moves], each.t, each.parts, self.budget)[0][0] for each in self._casts]

    def _features(self, places: Array, speeds: Array) -> Array:
        """Return places, m, and speeds, m/s, (..., K, 2) over their scales and sqrt(K) (..., 4 K)."""
        options, count = self.options.correction, places.shape[-2]
        both = np.concatenate([places / options.position_scale, speeds / options.speed_scale], axis=-1)
        return np.asarray(both.reshape(*places.shape[:-2], -1) / math.sqrt(count))

    def _shots(self, casts: Sequence[Moves], goal: _Goal, error: _Error | None) -> list[_Shot]:
        """Simulate casts, and compare them with the goal where they pass it nearest: residuals (4 K,) there."""
        window, model, parts = self.options.correction.window, self.model, self._casts[-1].parts
        t: Array = np.linspace(goal.t - window, goal.t + window, 2 * math.ceil(window / 0.01) + 1)
        goal_rows = self._features(*goal.state(model.problem.arm, parts * model.problem.rope.total_length))[0]
        places, speeds = _fly([model] * len(casts), casts, t, parts, self.budget)
        if error is not None:
            value, slope = error.at(t)
            places, speeds = places + value, speeds + slope
        found = []
        for rows in np.nan_to_num(self._features(places, speeds), nan=1e3):
            way, behind = np.diff(rows, axis=0), goal_rows - rows[:-1]
            part = np.clip((behind * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300), 0.0, 1.0)
            away = behind - part[:, None] * way
            k = int((away**2).sum(axis=1).argmin())
            found.append(_Shot(float(t[k] + part[k] * (t[1] - t[0])), away[k]))
        return found

    def _distance(self, moves: Moves, error: _Error) -> tuple[float, float, float]:
        """Return how far a cast passed the goal, over scales, in m, and in m/s."""
        (shot,) = self._shots([moves], self._goal, error)
        options, parts = self.options.correction, shot.residuals.reshape(-1, 4)
        position, speed = (float(np.linalg.norm(each)) for each in (parts[:, :2], parts[:, 2:]))
        return math.hypot(position, speed), options.position_scale * position, options.speed_scale * speed

    def _corrected(self, goal: _Goal, error: _Error | None, caution: float) -> Moves:
        """Return the goal's moves, corrected so that the model with an error meets the goal.

        Strokes and rests that begin before the strike are free; the first move after it keeps its time from it.
        """
        from scipy.optimize import least_squares

        options, problem, moves = self.options.correction, self.model.problem, goal.moves
        count, starts = moves.ends.size, moves.starts(problem.limits)
        begun = int((starts < goal.t).sum())
        free = np.concatenate([np.arange(begun), count + np.arange(begun)])
        scale = np.repeat([options.stroke_scale, options.rest_scale], begun)
        least, most = np.repeat(
            [[problem.limits.angles[0], MIN_REST], [problem.limits.angles[1], np.inf]], begun, axis=1
        )
        begin = np.clip(moves.parameters[free], least, most)

        def changed(x: Array) -> Moves:
            whole = np.zeros(2 * count)
            whole[free] = x - moves.parameters[free]
            return moves.varied(whole)

        def left(every: Array) -> Array:
            passed = self._shots([changed(x) for x in every], goal, error)
            costs = caution * (every - begin) / scale
            return np.concatenate([np.stack([each.residuals for each in passed]), costs], axis=1)

        def slopes(x: Array) -> Array:
            steps = options.difference * scale * np.where(x + options.difference * scale > most, -1.0, 1.0)
            here, *ends = left(np.vstack([x, x + np.diag(steps)]))
            return np.asarray((np.array(ends) - here).T / steps)

        found = least_squares(
            lambda x: left(x[None])[0], begin, slopes, bounds=(least, most), x_scale=scale, ftol=1e-3, max_nfev=10
        )
        best = changed(found.x)
        if begun == count:
            return best
        rests, now, (shot,) = best.rests.copy(), best.starts(problem.limits), self._shots([best], goal, error)
        rests[begun] += (starts[begun] - goal.t) - (now[begun] - shot.t)
        return replace(best, rests=rests)


def _fly(
    models: Sequence[_Model], casts: Sequence[Moves], t: Array, parts: Array, budget: Budget
) -> tuple[Array, Array]:
    """Simulate free flights from rest; return places, m, and speeds, m/s, (M, T, K, 2) at times t (T,), s."""
    motions = [model.motion(moves) for model, moves in zip(models, casts, strict=True)]
    ropes, problem = [each.problem.rope for each in models], models[0].problem
    later = t[t > 0.0]
    batch = RolloutBatch.from_start(problem, ropes, [], motions)
    run = batch.run(problem.arm, later, tol=1e-4, keep=("q", "qd"), time_budget=budget, threads=budget.threads)
    still = np.repeat(batch.q[:, None], t.size - later.size, axis=1)
    q, qd = np.concatenate([still, run.q], axis=1), np.concatenate([0.0 * still, run.qd], axis=1)
    every = [
        _states(rope, problem.arm, motion, t, angles, rates, parts * rope.total_length)
        for rope, motion, angles, rates in zip(ropes, motions, q, qd, strict=True)
    ]
    places, speeds = (np.stack(each) for each in zip(*every, strict=True))
    return places, speeds


def _states(rope: Rope, arm: Arm, motion: Motion, t: Array, q: Array, qd: Array, arcs: Array) -> tuple[Array, Array]:
    """Return places, m, and speeds, m/s, (T, K, 2) of points at distances along the rope (K,), m."""
    base, velocity = arm.tip_motion(motion, t)
    arms = lever_arms(rope, arcs)[1]
    return base[:, None] + arms @ unit_along(q), velocity[:, None] + arms @ (qd[..., None] * unit_across(q))


def _lines(cast: _Flown, places: Array, t: Array, options: LearningOptions) -> Array:
    """Return the error of predicted places (T', K, 2), m, and its slope, m/s, (2, T, K, 2) at times t (T,), s.

    By lines through a window about each time, the last one of which ends at the strike; some time after that the error
    stays as it is. NaN where too little was seen.
    """
    half, last = 0.5 * options.strike_window, cast.strike + options.correction.window
    centre = np.clip(t, half, cast.strike - half)
    since = cast.t - centre[:, None]
    near, left = np.abs(since) <= half, cast.places - places
    known = np.isfinite(left)
    left = np.where(known, left, 0.0)
    count, first, second = (np.tensordot(near * since**k, known, 1) for k in range(3))
    whole, moment = (np.tensordot(near * since**k, left, 1) for k in range(2))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (count * moment - first * whole) / (count * second - first**2)
        value = (whole - slope * first) / count + slope * (np.minimum(t, last) - centre)[:, None, None]
    slope = np.where((t > last)[:, None, None], 0.0, slope)
    return np.where(count >= options.min_samples, np.stack([value, slope]), np.nan)


def _fitted_lag(motion: Motion, t: Array, angle: Array) -> float:
    """Return the lag, s, with which a motor made a motion, from measured angles (T,), rad, at times t (T,), s."""
    from scipy.optimize import minimize_scalar

    known = np.isfinite(angle)

    def cost(lag: float) -> float:
        return float(((lagged(motion, lag).angle(t[known]) - angle[known]) ** 2).sum())

    longest = 0.5 * float(np.diff(motion.breaks).max())
    return float(minimize_scalar(cost, bounds=(0.0, longest), method="bounded", options={"xatol": 1e-4}).x)
