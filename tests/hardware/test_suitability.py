"""Whether a motor suits a rope, an arm and plans."""

import math

import pytest

import hyperflex as hf
from hyperflex.hardware import MotorData, check_motor, demand, find_motor, motor_catalogue
from hyperflex.motion import move_arm
from tests.refusals import refuses

CABLE = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, friction=5e-4)
RPM = 60.0 / math.tau
STRONG = MotorData("strong", speed=100.0, stall_torque=50.0)


@pytest.mark.parametrize(("time", "speeds"), [(0.5, (120.0, 112.5)), (0.73, (82.2, 77.1))])
def test_speed_that_a_half_turn_asks_for(time, speeds):
    """The closed forms: 2 pi / T (bang-bang) and 1.875 pi / T (minimum jerk)."""
    found = check_motor(STRONG, CABLE, move_time=time)
    assert [each.speed * RPM for each in found.demands] == pytest.approx(speeds, abs=0.05)
    assert found.demands[0].speed == pytest.approx(2.0 * math.pi / time)
    assert found.demands[1].speed == pytest.approx(1.875 * math.pi / time)


def test_weight_of_the_papers_rope_on_its_arm():
    assert check_motor(STRONG, CABLE).holding_torque == pytest.approx(0.129, abs=5e-4)


@pytest.mark.parametrize(
    ("name", "possible"), [("XL430-W250", False), ("XC330-T181", False), ("xl330-m077", True), ("mj5208", True)]
)
def test_usual_servos_are_too_slow_or_too_weak_for_half_a_second_and_a_direct_drive_is_not(name, possible):
    assert check_motor(find_motor(name), CABLE).success is possible


def test_limits_are_those_of_a_half_turn_that_the_motor_can_make():
    arm = hf.Arm(inertia=2e-3)
    motor = find_motor("XC330-T181")
    found = check_motor(motor, CABLE, arm)
    duration = 2.0 * math.pi / found.limits.speed
    assert found.limits.acceleration == pytest.approx(4.0 * math.pi / duration**2)
    again = check_motor(motor, CABLE, arm, duration)
    assert 0.0 < again.demands[0].margin < 0.4
    assert not check_motor(motor, CABLE, arm, 0.6 * duration).demands[0].possible


def test_further_demands_count():
    motor = find_motor("XC330-T181")
    more = [demand(motor, "plan", move_arm(0.0, 1.0, duration=time), CABLE, hf.Arm()) for time in (2.0, 0.1)]
    found = check_motor(motor, CABLE, None, 2.0, *more)
    assert [each.possible for each in found.demands[2:]] == [True, False]
    assert not found.success


def test_speed_and_torque_go_with_the_voltage():
    half = find_motor("XM430-W210").at(6.0)
    assert (half.speed * RPM, half.stall_torque) == (pytest.approx(38.5), pytest.approx(1.5))


def test_every_drive_of_the_catalogue_has_a_source():
    assert len(motor_catalogue()) == 10
    assert all(len(each.source) > 10 and each.counts > 0 for each in motor_catalogue().values())


def test_what_cannot_be():
    refuses("not in the catalogue", find_motor, "XYZ")
    refuses("too weak to hold", check_motor, MotorData("weak", 10.0, 0.1), CABLE)
    refuses("stall_torque", MotorData, "wrong", 10.0, -1.0)
