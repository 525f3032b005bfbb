"""The closed loop: return to the plan with a wrong rope, kept moves, and an aborted throw."""

from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.control import TrueState
from hyperflex.hardware import SimulatedMotor
from hyperflex.planning import MotorStateSource, ScenarioStateSource, check_feasibility, scaled_rope
from hyperflex.planning.feedback import Goal, features
from hyperflex.planning.moves import Moves
from hyperflex.status import Status
from tests.planning.known import PEG, WINDS, problem, simulated_strikes
from tests.planning.known_whip import planned_whip
from tests.planning.test_uncertainty import NONE
from tests.refusals import refuses

CAST_SETUP = problem()
LIMITS = CAST_SETUP.limits
OPTIONS = hf.FollowOptions()
PLAN = hf.CastPlan(CAST_SETUP, PEG, check_feasibility(CAST_SETUP, PEG), WINDS)


def test_a_goal_of_another_rope_is_at_the_same_distances_from_the_arm():
    count = CAST_SETUP.rope.n_links
    arcs = np.cumsum(CAST_SETUP.rope.length)
    goal = Goal(1.0, (arcs[:, None] * np.array([1.0, -2.0, 0.5, 3.0])).ravel())  # of a straight rope that turns
    assert np.array_equal(goal.at(CAST_SETUP.rope, CAST_SETUP.rope).features, goal.features)
    for part in (0.98, 1.03):
        other = CAST_SETUP.rope.replace(length=part * CAST_SETUP.rope.length)
        assert goal.at(CAST_SETUP.rope, other).features == pytest.approx(part * goal.features)
    assert goal.at(CAST_SETUP.rope, CAST_SETUP.rope).features.size == 4 * count


def miss(rope: hf.Rope, throw: Moves) -> float:
    """Distance of a rope from the planned strike's features, by whole flights from rest, at the best time about it."""
    goal = Goal.of(CAST_SETUP, PEG, WINDS).at(CAST_SETUP.rope, rope)
    arm, motion, t = CAST_SETUP.arm, throw.motion(LIMITS), goal.t + np.arange(-0.25, 0.25, 0.002)
    run = hf.simulate(rope, motion, arm=arm, duration=float(t[-1]), t_eval=t, tol=1e-4)
    away = features(rope, arm, motion, t, run.q, run.qd) - goal.features
    return float((away**2).sum(axis=1).min())


def test_a_rope_that_is_known_to_be_longer_is_led_back_as_predicted():
    """The strike predicted by a decision is that of the next one, if the rope is known exactly; most is corrected."""
    longer = scaled_rope(CAST_SETUP.rope, 1.02, 1.0, 1.0)
    expected = []
    for known in (longer, None):
        done = hf.follow_plan(PLAN, TrueState(longer, CAST_SETUP.arm), rope=known, options=OPTIONS)
        steps = zip(done.decisions[:-1], done.decisions[1:], strict=True)
        expected.append(max(abs(one.after - other.before) for one, other in steps))
        assert done.moves.begins_with(WINDS.first(done.decisions[0].move))  # what was done stays done
        assert not known or miss(longer, done.moves) < 0.3 * miss(longer, WINDS)  # 0.09 was seen
    assert expected[0] < 0.05 < expected[1]


def rest_before(moves: Moves, move: int) -> float:
    """When the arm comes to rest before a move, s."""
    return float(moves.starts(LIMITS)[move]) - float(moves.rests[move])


def test_in_the_expected_world_the_plan_is_kept():
    (world,) = NONE.sample(1, CAST_SETUP, PEG)
    done = hf.follow_plan(PLAN, ScenarioStateSource(world, CAST_SETUP.arm))
    assert [look.action for look in done.decisions] == ["kept"] * len(done.decisions)
    assert [look.move for look in done.decisions] == list(range(1, len(done.decisions) + 1))
    assert len(done.decisions) >= 5
    assert (done.success, done.status, done.message) == (True, Status.SUCCESS, "")
    assert done.motion == WINDS.motion(LIMITS)
    for look in done.decisions:
        assert look.t == pytest.approx(rest_before(WINDS, look.move))
        assert look.t + look.left == pytest.approx(float(WINDS.starts(LIMITS)[look.move]))


def test_the_rope_is_not_observed_shortly_before_the_strike():
    strike = float(simulated_strikes(CAST_SETUP, PEG, [WINDS]).t[0])
    (world,) = NONE.sample(1, CAST_SETUP, PEG)
    options = hf.FollowOptions(blind_time=2.5)
    done = hf.follow_plan(PLAN, ScenarioStateSource(world, CAST_SETUP.arm), options=options)
    assert strike - 4.0 < done.decisions[-1].t <= strike - 2.5


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (PLAN, ""),
        (replace(PLAN, message="it slips"), "it slips"),
        (replace(PLAN, moves=replace(WINDS, ends=np.full(7, -1.5))), "the planned moves do not strike"),
    ],
)
def test_without_an_observation_the_plan_counts(plan, message):
    done = hf.follow_plan(plan, Hanging(), options=hf.FollowOptions(blind_time=100.0))
    assert (done.decisions, done.message, done.success) == ((), message, not message)


class Hanging:
    """A source that always reports a rope at rest: no planned move can succeed."""

    def state(self, t: float, motion: object) -> hf.RopeState:
        return hf.RopeState(t, np.zeros(50), np.zeros(50))


def test_a_throw_that_cannot_win_any_more_is_given_up_slowly():
    done = hf.follow_plan(PLAN, Hanging())
    assert (done.completed, done.status) == (False, Status.FAILED)
    assert done.decisions[-1].action == "aborted"
    assert done.decisions[-1].after == np.inf
    assert done.message == f"aborted at {done.decisions[-1].t:.2f} s: the rope will not strike"
    made = done.decisions[-1].move
    assert made >= WINDS.ends.size - 2
    assert done.moves.ends.size == made + 1
    end = float(done.motion.breaks[-1])
    assert float(done.motion.angle(end)) == pytest.approx(0.0, abs=1e-9)
    t = np.linspace(done.decisions[-1].t, end, 500)
    assert float(np.abs(done.motion.rate(t)).max()) <= 0.31 * LIMITS.speed
    assert done.moves.starts(LIMITS)[-1] == pytest.approx(done.decisions[-1].t + OPTIONS.decision_time)


def test_what_is_due_too_soon_to_be_decided_is_made_as_planned():
    """With more time to think than any rest leaves, the next move stays; the one after it may be given up."""
    done = hf.follow_plan(PLAN, Hanging(), options=hf.FollowOptions(decision_time=1.0))
    assert (done.completed, done.status) == (False, Status.FAILED)
    move = done.decisions[-1].move
    assert done.decisions[-1].left < 1.0
    assert done.moves.ends.size == move + 2
    assert done.moves.starts(LIMITS)[-1] == pytest.approx(rest_before(done.moves, move + 1) + 1.0)


class Kept(SimulatedMotor):
    """A simulated motor that records its commands; it refuses `refuses` motions after the first one."""

    def __init__(self, refuses: int = 0, **how: float) -> None:
        super().__init__(-0.5 * np.pi, **how)
        self.asked: list[tuple[float, hf.Motion]] = []
        self.refuses = refuses

    def set_motion(self, motion: hf.Motion, at: float) -> bool:
        self.asked.append((at, motion))
        return not 2 <= len(self.asked) < 2 + self.refuses and super().set_motion(motion, at)


def test_a_motor_gets_the_plan_and_a_rope_on_it_follows_its_motion():
    """A servo with almost no lag: the rope's state at each sample is that of the commanded motion."""
    motor = Kept(lag=1e-3, counts=10**6)
    world = MotorStateSource(CAST_SETUP.rope, CAST_SETUP.arm, motor)
    seen: list[tuple[hf.RopeState, hf.Motion]] = []

    class Watched:
        def state(self, t, motion):
            seen.append((world.state(t, motion), motion))
            return seen[-1][0]

    done = hf.follow_plan(PLAN, Watched(), motor=motor)
    assert motor.asked[0] == (0.0, WINDS.motion(LIMITS))
    changes = [look.t for look in done.decisions if look.action == "changed"]
    assert [at for at, _ in motor.asked[1:]] == changes
    assert all(abs(look.arm_error) < 2e-3 for look in done.decisions)  # at rest the lag has faded; a count is 6e-6 rad
    true = TrueState(CAST_SETUP.rope, CAST_SETUP.arm)
    for state, motion in seen:
        # Late by 1 ms at links that turn with some 10 rad/s, and further apart in the course of the swings.
        np.testing.assert_allclose(true.state(state.t, motion).q, state.q, atol=0.1)


def test_a_motor_that_does_not_come_along_ends_the_throw():
    """A torque too weak for the strokes: at the first look the arm is far from where it should be."""
    motor = Kept(torque=0.005)
    done = hf.follow_plan(PLAN, MotorStateSource(CAST_SETUP.rope, CAST_SETUP.arm, motor), motor=motor)
    assert (done.completed, done.status) == (False, Status.FAILED)
    assert len(done.decisions) == 1
    assert abs(done.decisions[0].arm_error) > OPTIONS.max_arm_error
    assert "rad from its command" in done.message
    assert motor.asked[-1] == (done.decisions[0].t, done.motion)
    assert float(done.motion.angle(float(done.motion.breaks[-1]))) == pytest.approx(0.0, abs=1e-9)
    motor, patient = Kept(torque=0.005), hf.FollowOptions(max_arm_error=10.0)
    done = hf.follow_plan(PLAN, MotorStateSource(CAST_SETUP.rope, CAST_SETUP.arm, motor), motor=motor, options=patient)
    assert done.completed
    assert "expected to miss" in done.message


def test_a_correction_that_the_motor_refuses_is_late_and_the_plan_continues():
    motor = Kept(refuses=100, lag=1e-3, counts=10**6)
    (world,) = hf.Uncertainty(length=0.02).sample(1, CAST_SETUP, PEG, seed=3)
    done = hf.follow_plan(PLAN, ScenarioStateSource(world, CAST_SETUP.arm), motor=motor)
    assert len(motor.asked) > 1
    assert {look.action for look in done.decisions} <= {"kept", "late"}
    assert all(look.after == look.before for look in done.decisions)
    assert done.motion == WINDS.motion(LIMITS)


def test_an_abort_that_the_motor_refuses_begins_at_the_next_rest():
    motor = Kept(torque=0.005, refuses=1)
    done = hf.follow_plan(PLAN, MotorStateSource(CAST_SETUP.rope, CAST_SETUP.arm, motor), motor=motor)
    assert [look.action for look in done.decisions] == ["aborted"]
    assert motor.asked[-1] == (done.decisions[0].t, done.motion)
    assert done.moves.ends.size == done.decisions[0].move + 2


def test_an_abort_that_is_decided_too_late_begins_at_the_next_rest():
    options = hf.FollowOptions(real_time=True, sending=10.0)
    done = hf.follow_plan(PLAN, Hanging(), motor=Kept(refuses=1, lag=1e-3, counts=10**6), options=options)
    last = done.decisions[-1]
    assert (last.action, done.message) == ("aborted", f"aborted at {last.t:.2f} s: the rope will not strike")
    assert done.moves.ends.size == last.move + 2


def test_a_plan_that_is_read_back_is_followed_as_the_plan_is(tmp_path):
    PLAN.to_toml(tmp_path / "cast.toml")
    back = hf.read_plan(tmp_path / "cast.toml")
    (world,) = hf.Uncertainty(length=0.02).sample(1, CAST_SETUP, PEG, seed=3)
    one, two = (hf.follow_plan(each, ScenarioStateSource(world, CAST_SETUP.arm)) for each in (PLAN, back))
    assert one.motion == two.motion
    assert [look.action for look in one.decisions] == [look.action for look in two.decisions]
    refuses("only casts are followed", hf.follow_plan, planned_whip(), ScenarioStateSource(world, CAST_SETUP.arm))


@pytest.mark.nightly
def test_in_real_time_a_late_decision_is_not_carried_out():
    """Without time for decisions a rope that waits gets the changed throw, one that moves on the planned one."""
    (world,) = hf.Uncertainty(length=0.02).sample(1, CAST_SETUP, PEG, seed=3)
    each = [hf.FollowOptions(decision_time=0.0, sending=10.0, real_time=real_time) for real_time in (False, True)]
    sources = [ScenarioStateSource(world, CAST_SETUP.arm) for _ in each]
    waits, moves = (
        hf.follow_plan(PLAN, source, motor=Kept(), options=options)
        for source, options in zip(sources, each, strict=True)
    )
    assert "changed" in {each.action for each in waits.decisions}
    assert {each.action for each in moves.decisions} <= {"kept", "late"}
    assert moves.late == len(moves.decisions)
    assert moves.motion == WINDS.motion(LIMITS) != waits.motion


def test_bad_numbers_are_refused():
    (world,) = hf.Uncertainty().sample(1, CAST_SETUP, PEG)
    for wrong in (-1.0, np.nan):
        refuses("decision_time", hf.FollowOptions, decision_time=wrong)
    n = CAST_SETUP.rope.n_links
    swings = replace(PLAN, problem=replace(CAST_SETUP, q0=(0.1,) * n, qd0=(0.0,) * n, side=-1))
    refuses("swinging rope are not followed", hf.follow_plan, swings, ScenarioStateSource(world, CAST_SETUP.arm))
