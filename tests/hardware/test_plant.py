"""The physics behind an emulated drive: motor, arm and rope."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.hardware import Goal
from hyperflex.hardware.emulate import MotorModel, Plant
from hyperflex.model import unit_along
from hyperflex.motion import Motion
from tests.planning.known import CABLE, PEG, WINDS, problem
from tests.refusals import refuses

ARM = hf.Arm(length=0.105, mass=0.05, com=0.05, inertia=1e-4)


def rope(friction: float = 3e-4) -> hf.Rope:
    return hf.Rope.uniform(length=0.6, mass=0.03, n_links=10, radius=0.0025, friction=friction)


def driven(model: MotorModel, *goal: float, on: hf.Rope | None = None, **imposed: object) -> Plant:
    """A plant whose torque is on, with a goal and what is imposed on it."""
    plant = Plant(model, on, ARM)
    plant.impose(**imposed)
    plant.set_enabled(True)
    plant.set_goal(Goal(*goal))
    return plant


def test_a_goal_is_reached_and_held_against_the_weight_of_arm_and_rope() -> None:
    model = MotorModel()
    plant = driven(model, 1.0, on=rope(friction=5e-3))  # soon at rest
    plant.advance(10.0)
    weight = 9.81 * (0.05 * 0.05 + 0.03 * 0.105) * math.sin(plant.angle)
    assert abs(plant.rate) < 1e-3
    assert math.isclose(plant.torque, weight, rel_tol=1e-2)
    assert math.isclose(1.0 - plant.angle, weight / model.kp, rel_tol=1e-2)


def test_without_torque_the_arm_falls_and_hangs() -> None:
    plant = Plant(MotorModel(friction=5e-3), None, ARM, angle=1.0)
    plant.advance(10.0)
    assert abs(plant.angle) < 1e-3
    assert plant.torque == 0.0


def test_a_rope_that_is_hung_by_hand_is_held_until_the_torque_comes_on() -> None:
    plant = Plant(MotorModel(), rope(), ARM, angle=1.0)
    plant.advance(0.5)
    plant.hang(-1.2)
    plant.advance(1.5)
    assert plant.arm_angle == pytest.approx(-1.2)
    assert not plant.rope_state()[0].any()
    plant.set_enabled(True)
    plant.advance(1.6)
    assert plant.arm_angle == pytest.approx(-1.2, abs=0.01)
    plant.set_enabled(False)
    plant.advance(2.0)
    assert plant.arm_angle > -1.1  # it falls


def test_dry_friction_holds_an_arm_that_it_can_hold_and_no_other() -> None:
    weight = 9.81 * 0.05 * 0.05 * math.sin(1.0)
    held, falling = (Plant(MotorModel(dry_friction=part * weight), None, ARM, angle=1.0) for part in (1.01, 0.99))
    held.advance(1.0)
    falling.advance(1.0)
    assert held.arm_angle == pytest.approx(1.0, abs=1e-9)
    assert falling.arm_angle < 0.99


def test_readings_are_as_noisy_as_requested_and_the_motion_is_not() -> None:
    quiet, noisy = (driven(MotorModel(angle_noise=a, rate_noise=10.0 * a, torque_noise=a), 0.5) for a in (0.0, 1e-3))
    read = []
    for k in range(1000):
        for plant in (quiet, noisy):
            plant.advance(1e-3 * (k + 1))
        read.append([noisy.angle - quiet.angle, noisy.rate - quiet.rate, noisy.torque - quiet.torque])
    assert noisy.arm_angle == pytest.approx(quiet.arm_angle, abs=1e-2)
    # five standard errors of a thousand samples
    np.testing.assert_allclose(np.std(read, axis=0), [1e-3, 1e-2, 1e-3], rtol=5.0 / math.sqrt(2000.0))


def test_torque_and_speed_keep_to_controller_and_supply() -> None:
    model = MotorModel(max_torque=0.5, max_speed=10.0, friction=0.0)
    plant = Plant(model, None, hf.Arm(inertia=1e-3))
    plant.set_enabled(True)
    seen = []
    for k in range(400):
        plant.set_goal(Goal(100.0))
        plant.advance(1e-3 * (k + 1))
        seen.append((plant.rate, plant.torque))
    rates, torques = np.array(seen).T
    assert torques.max() == 0.5
    assert rates[-1] == pytest.approx(10.0, rel=1e-3)
    plant.impose(voltage=12.0)
    plant.advance(2.0)
    assert plant.rate == pytest.approx(5.0, rel=1e-3)


def test_goals_act_after_the_latency_and_advance_with_their_rate_only_where_the_drive_does_so() -> None:
    ends = []
    for extrapolates in (False, True):
        plant = driven(MotorModel(latency=0.02, extrapolates=extrapolates), 0.0, 1.0)
        plant.advance(0.02)
        assert plant.angle == 0.0
        plant.advance(0.52)
        ends.append(plant.angle)
    assert ends[0] < 0.05
    assert ends[1] == pytest.approx(0.5, abs=0.01)


def test_backlash_leaves_the_arm_free_between_the_teeth() -> None:
    plant = Plant(MotorModel(backlash=0.05), rope(friction=5e-3), ARM)
    plant.set_enabled(True)
    for aim in (0.5, -0.5):
        plant.set_goal(Goal(aim))
        plant.advance(plant.t + 8.0)
        # the weight pulls the arm down to the tooth that holds it; teeth give way a little
        assert plant.arm_angle == pytest.approx(plant.angle - math.copysign(0.025, aim), abs=5e-3)


def test_a_hard_stop_holds_the_arm_and_the_motor_pushes_at_its_limit() -> None:
    plant = driven(MotorModel(max_torque=0.5), 1.5, on=rope(), stops=(-3.0, 0.8))
    plant.advance(1.0)
    assert plant.arm_angle == pytest.approx(0.8, abs=0.02)
    assert plant.torque == 0.5


def test_a_jump_of_the_encoder_turns_the_motor_back_by_as_much() -> None:
    plant = driven(MotorModel(), 0.0)
    plant.impose(encoder_turns=1.0)
    assert plant.angle == pytest.approx(2.0 * math.pi)
    plant.advance(2.0)
    assert plant.arm_angle == pytest.approx(-2.0 * math.pi, abs=0.01)


def test_the_motor_warms_with_the_square_of_its_torque_and_cools() -> None:
    plant = driven(MotorModel(heating=10.0, cooling_time=1.0, max_torque=0.5), 1.0, stops=(-1.0, 0.0))
    plant.advance(8.0)
    assert plant.temperature == pytest.approx(25.0 + 10.0 * 0.5**2, abs=0.01)
    plant.set_enabled(False)
    plant.advance(16.0)
    assert plant.temperature == pytest.approx(25.0, abs=0.01)


def test_a_loop_that_its_sampling_makes_unstable_is_refused() -> None:
    refuses("position loop is unstable", Plant, MotorModel(kd=5.0), None, ARM)


@pytest.mark.parametrize("step", [pytest.param(1e-3, marks=pytest.mark.nightly), 2e-3])
def test_a_cast_agrees_with_simulate_to_a_millimetre_whatever_the_step(step: float) -> None:
    """Until 1.5 s after the strike: `simulate` is given the arm angle that the plant recorded."""
    cast = problem()
    planned, duration = WINDS.motion(cast.limits), round(WINDS.stops(cast.limits) + 1.5, 2)
    plant = Plant(MotorModel(kp=40.0), CABLE, cast.arm, [PEG], float(planned.angle(0.0)), step=step)
    plant.set_enabled(True)
    t = np.linspace(0.0, duration, round(duration / step) + 1)
    angles, rates, links = [plant.arm_angle], [0.0], [plant.rope_state()[0]]
    for now, goal, rate in zip(t[1:], planned.angle(t), planned.rate(t), strict=False):
        plant.set_goal(Goal(goal, rate))
        plant.advance(now)
        angles.append(plant.arm_angle)
        rates.append(plant.arm_rate)
        links.append(plant.rope_state()[0])
    seen = slice(None, None, round(0.01 / step))
    arm, q = np.array(angles), np.array(links)
    steps = CABLE.length[:, None] * unit_along(q[seen])
    joints = cast.arm.tip(arm[seen])[:, None] + np.cumsum(np.concatenate([0.0 * steps[:, :1], steps], axis=1), axis=1)
    run = hf.simulate(
        CABLE,
        through(t, arm, np.array(rates)),
        arm=cast.arm,
        pegs=[PEG],
        duration=duration,
        t_eval=t[seen],
        refine=False,
    )
    gap = np.linalg.norm(joints - [PEG.x, PEG.y], axis=2).min(axis=1) - PEG.radius - CABLE.radius
    strike = t[seen][np.argmax(gap < 1e-3)]
    assert 7.0 < strike < duration - 1.5
    assert np.abs(joints - run.joints).max() < 1e-3


def through(t: np.ndarray, angle: np.ndarray, rate: np.ndarray) -> Motion:
    """Return the motion of cubics with given angles and rates at their ends."""
    h, coef = np.diff(t), np.zeros((t.size - 1, 4, 6))
    mean = np.diff(angle) / h
    coef[:, 0, 0], coef[:, 0, 1] = angle[:-1], rate[:-1]
    coef[:, 0, 2] = (3.0 * mean - 2.0 * rate[:-1] - rate[1:]) / h
    coef[:, 0, 3] = (rate[:-1] + rate[1:] - 2.0 * mean) / h**2
    return Motion(t, coef, np.ones(t.size, dtype=np.bool_))
