"""Learning from casts: measurements of rope, motor and motion, replanning, and the end of learning."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.errors import EstimatorLost, Interrupted, InvalidInput, SimulationError
from hyperflex.estimate import EstimatedParameter
from hyperflex.execution import Attempt, CastLog, LearningOptions, LearningResult, learn_cast, learning
from hyperflex.interfaces import RopeState
from hyperflex.model import divided
from hyperflex.motion import Motion, lagged
from hyperflex.planning import CastPlan, Moves, Problem, check_feasibility, scaled_rope
from hyperflex.recording import Recording
from hyperflex.sensors import Markers
from hyperflex.status import Status
from tests.refusals import refuses

ROPE = hf.Rope.uniform(length=0.8, mass=0.05, n_links=8, radius=0.003, friction=2e-4, drag=4e-3)
PROBLEM = Problem(ROPE, hf.Arm(length=0.1), hf.MotorLimits())
PEG = hf.Peg(-0.55, -0.5, 0.03, 0.3)
MOVES = Moves(-1, np.array([1.4, -1.2]), np.array([0.2, 0.35]))  # strike the peg at 2.14 s
PLAN = CastPlan(PROBLEM, PEG, check_feasibility(PROBLEM, PEG), MOVES)
PARTS = np.array([0.25, 0.5, 0.75, 1.0])  # of the rope, where its markers are
ARCS = PARTS * ROPE.total_length
OPTIONS = LearningOptions(wins=1, threads=1)
Seen = Sequence[tuple[Moves, RopeState]]


class Twin:
    """A rope of twice the links on its arm, filmed at 100 Hz with markers of 1 mm; from some cast on it winds."""

    def __init__(
        self, rope: hf.Rope = ROPE, arm: hf.Arm = PROBLEM.arm, lag: float = 0.0, winds: float = np.inf
    ) -> None:
        self.rope, self.arm, self.lag, self.winds = divided(rope, 2), arm, lag, winds
        self.casts: list[Motion] = []
        self.ropes: list[hf.Rope] = []  # of the plans

    def __call__(self, cast: CastPlan) -> CastLog:
        """Make a cast."""
        motion = cast.required(cast.motion, "motion")
        self.casts.append(motion)
        self.ropes.append(cast.problem.rope)
        made, t = lagged(motion, self.lag), np.arange(0.0, 2.6, 0.01)
        seen = places(self.rope, self.arm, made, t, PARTS * self.rope.total_length)
        random = np.random.default_rng(len(self.casts))
        recording = Recording(t, seen + 1e-3 * random.standard_normal(seen.shape), "markers", noise=1e-3)
        return CastLog(recording, ARCS, made.angle(t), len(self.casts) >= self.winds)


def places(rope: hf.Rope, arm: hf.Arm, motion: Motion, t: np.ndarray, arcs: np.ndarray) -> np.ndarray:
    """Places at distances along a rope, at times t, x0, y0, ..., m."""
    run = hf.simulate(rope, motion, arm=arm, duration=float(t[-1]), t_eval=t)
    return Markers(arcs).predict(rope, run.q, arm.tip(motion.angle(t)))


@pytest.fixture(autouse=True)
def replanned(monkeypatch: pytest.MonkeyPatch) -> list[Seen]:
    """What a search would go on from: its result is a last move that is made a little later."""
    found: list[Seen] = []

    def replan(plan: CastPlan, start: Sequence[Moves], seen: Seen, **_: object) -> CastPlan:
        found.append(seen)
        return replace(plan, moves=MOVES.varied(np.array([0.0, 0.0, 0.0, 0.01 * len(found)])))

    monkeypatch.setattr(learning, "replan_cast", replan)
    return found


def test_parameters_of_rope_and_motor_are_learned_from_one_cast():
    twin = Twin(scaled_rope(ROPE, 1.03, 1.0, 1.5).replace(drag=8e-3), lag=0.015)
    done = learn_cast(PLAN, twin, attempts=1, options=OPTIONS)
    (one,) = done.attempts
    assert one.factors["length"] == pytest.approx(1.03, abs=0.005)  # 1 mm noise, and other links
    assert 1.1 < one.factors["friction"] < 1.7  # two strokes tell little of it, and the prior says 1
    assert one.factors["drag"] == pytest.approx(2.0, abs=0.4)
    assert one.lag == pytest.approx(0.015, abs=1e-3)
    assert done.rope.total_length == pytest.approx(one.factors["length"] * ROPE.total_length)


def test_each_cast_gets_the_plan_with_the_next_moves_and_the_rope_as_it_is_known():
    twin = Twin(scaled_rope(ROPE, 1.03, 1.0, 1.0))
    done = learn_cast(PLAN, twin, attempts=2, options=OPTIONS)
    assert [rope.total_length / ROPE.total_length for rope in twin.ropes] == pytest.approx(
        [1.0, done.attempts[0].factors["length"]]
    )
    assert twin.casts[0] == PLAN.motion != twin.casts[1]


@pytest.mark.parametrize("parameters", [True, False])
def test_the_next_cast_continues_from_the_states_that_were_measured_at_rests(replanned, parameters):
    """An arm that is longer by a tenth than the model's, which nothing that is learned of the rope explains."""
    twin, prior = Twin(arm=hf.Arm(length=0.11)), [EstimatedParameter("friction", 0.2)]
    done = learn_cast(PLAN, twin, attempts=1, options=replace(OPTIONS, parameters=parameters, prior=prior))
    (((moves, state),),) = replanned
    assert moves.begins_with(MOVES.first(1))
    stop = MOVES.first(1).stops(PROBLEM.limits)
    assert state.t == pytest.approx(stop)
    motion, now = MOVES.motion(PROBLEM.limits), np.array([0.0, stop])
    true = places(twin.rope, twin.arm, motion, now, ARCS)[1]
    seen = Markers(ARCS).predict(ROPE, state.q[None], PROBLEM.arm.tip(motion.angle(now[1:])))[0]
    model = places(ROPE, PROBLEM.arm, motion, now, ARCS)[1]
    assert np.abs(seen - true).max() < 0.012 < np.abs(model - true).max()  # the arm's tip itself is 10 mm off
    assert (done.rope == ROPE) == (not parameters)


def test_parameters_alone_plan_from_the_start(replanned):
    learn_cast(PLAN, Twin(), attempts=1, options=replace(OPTIONS, motion=False))
    assert replanned == [[]]


def test_three_casts_that_wind_running_end_it_and_leave_the_motion_as_it_is(replanned):
    lines = list[str]()
    twin = Twin(winds=2)
    done = learn_cast(PLAN, twin, options=replace(OPTIONS, wins=3), report=lambda each: lines.append(str(each)))
    assert (done.status, done.message, len(done.attempts)) == (Status.SUCCESS, "", 4)
    assert twin.casts[1:] == [done.motion] * 3
    assert twin.casts[0] != done.motion
    assert len(replanned) == 1
    assert [line.partition(",")[0] for line in lines] == ["cast 1: missed", *(f"cast {k}: wound" for k in (2, 3, 4))]


def test_a_search_that_finds_nothing_leaves_the_motion_as_it_is(monkeypatch):
    monkeypatch.setattr(learning, "replan_cast", lambda plan, *_, **__: replace(plan, moves=None))
    done = learn_cast(PLAN, Twin(), attempts=1, options=OPTIONS)
    assert done.moves is MOVES


def failing(twin: Twin, after: int, error: BaseException) -> Callable[[CastPlan], CastLog]:
    """A cast that raises an error after some."""

    def carry_out(cast: CastPlan) -> CastLog:
        if len(twin.casts) == after:
            raise error
        return twin(cast)

    return carry_out


def test_an_interrupted_cast_keeps_what_was_learned():
    with pytest.raises(Interrupted) as stop:
        learn_cast(PLAN, failing(Twin(), 1, KeyboardInterrupt()), options=OPTIONS)
    check_kept(stop.value.partial, Status.INTERRUPTED)


def test_a_camera_that_fails_ends_it_and_keeps_what_was_learned():
    done = learn_cast(PLAN, failing(Twin(), 1, EstimatorLost("The camera is dark.")), options=OPTIONS)
    check_kept(done, Status.FAILED)
    assert done.message == "The camera is dark; 0 of 1 casts wound, 1 in a row required"


def check_kept(done: LearningResult, status: Status) -> None:
    assert isinstance(done, LearningResult)
    assert (done.status, len(done.attempts)) == (status, 1)
    assert done.rope != ROPE
    assert not np.array_equal(done.moves.parameters, MOVES.parameters)


def test_a_log_with_too_little_data_reports_it_and_changes_nothing():
    def carry_out(cast: CastPlan) -> CastLog:
        log = Twin()(cast)
        data = log.recording.data.copy()
        data[log.recording.t > 1.5] = np.nan  # the strike was not seen
        return CastLog(replace(log.recording, data=data), log.arc_lengths, log.arm_angle, False)

    done = learn_cast(PLAN, carry_out, attempts=2, options=OPTIONS)
    assert done.message == "0 of 2 casts wound, 1 in a row required"
    assert np.array_equal(done.moves.parameters, MOVES.parameters)
    assert (done.rope, done.lag) == (ROPE, 0.0)
    expected = "cast 1: missed; nothing learned: no marker was seen in the 0.12 s before the strike"
    assert str(done.attempts[0]) == expected


def test_a_filter_that_fails_changes_nothing_and_reports_it(monkeypatch):
    def fail(*_: object) -> None:
        raise SimulationError("The state is not finite.", status=Status.NOT_FINITE, time=0.1)

    monkeypatch.setattr(learning, "_states", fail)
    done = learn_cast(PLAN, Twin(), attempts=2, options=OPTIONS)
    assert [each.problem for each in done.attempts] == ["The state is not finite."] * 2
    assert (done.rope, done.moves) == (ROPE, MOVES)


def test_bad_input_is_refused():
    log = Twin()(PLAN)
    with pytest.raises(InvalidInput, match="plan"):
        learn_cast("cast.toml", Twin())  # type: ignore[arg-type]
    refuses("do not strike", learn_cast, replace(PLAN, moves=Moves(-1, np.array([-1.0]), np.array([0.1]))), Twin())
    with pytest.raises(InvalidInput, match="carry_out"):
        learn_cast(PLAN, lambda plan: None)  # type: ignore[arg-type, return-value]
    refuses("arc_lengths", CastLog, log.recording, [0.1])
    with pytest.raises(InvalidInput, match="prior"):
        LearningOptions(prior=0.2)  # type: ignore[arg-type]
    refuses("kind of the recording", CastLog, Recording([0.0, 0.1, 0.2], np.zeros((3, 2))), [0.1])


def test_the_figure_shows_each_way():
    from hyperflex.report import learning_figure

    attempts = [Attempt(1, MOVES, False, position=0.1), Attempt(2, MOVES, True, position=0.01)]
    figure = learning_figure({"parameters": attempts, "motion": attempts})
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["parameters", "motion", "wound", "missed"]
