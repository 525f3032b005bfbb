"""Postures by vibration: averaged torques, closed forms, and runs that know nothing of averaging."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.control.vibration import Averaged
from tests.refusals import refuses

G = 9.81
UNEVEN = hf.Rope(
    length=[0.2, 0.1, 0.15],
    mass=[0.02, 0.03, 0.01],
    friction=[1e-3, 5e-4, 2e-4],
    stiffness=[0.01, 0.02, 0.005],
    rest_angle=[0.1, -0.2, 0.05],
    radius=0.003,
)
ROD = hf.Rope(length=[0.3], mass=[0.05], friction=1e-4)


def mean_tip(run: hf.Trajectory) -> np.ndarray:
    """Return the tip relative to the first joint, averaged over whole periods, m."""
    return (run.tip - run.base).mean(axis=0)


def tilt_of(run: hf.Trajectory) -> float:
    x, y = mean_tip(run)
    return math.atan2(x, -y)


@pytest.mark.parametrize("arm", [None, hf.Arm(length=0.1)])
def test_the_hessian_is_the_derivative_of_the_torques(arm):
    model, h = Averaged(UNEVEN, arm, 1.2, 40.0), 1e-6
    q = np.array([0.4, 1.9, -1.1])
    slopes = [(model.at(q + h * one, 2.0)[0] - model.at(q - h * one, 2.0)[0]) / (2.0 * h) for one in np.eye(3)]
    np.testing.assert_allclose(model.at(q, 2.0)[1], -np.array(slopes).T, rtol=0, atol=1e-9)  # rounding over h


def test_without_friction_the_torques_are_the_slope_of_the_averaged_potential():
    free = UNEVEN.replace(friction=np.zeros(3), stiffness=np.zeros(3))
    model, q, v, h = Averaged(free, None, 1.2, 40.0), np.array([0.4, 1.9, -1.1]), 2.0, 1e-6
    outer = np.cumsum(free.mass[::-1])[::-1] - free.mass
    lever = free.mass * free.com + free.length * outer

    def potential(angles):
        g = lever * (np.cos(angles) * math.sin(1.2) - np.sin(angles) * math.cos(1.2))
        return -G * lever @ np.cos(angles) + 0.25 * v**2 * g @ np.linalg.solve(hf.mass_matrix(free, angles), g)

    slopes = [(potential(q + h * one) - potential(q - h * one)) / (2.0 * h) for one in np.eye(3)]
    np.testing.assert_allclose(model.at(q, v)[0], -np.array(slopes), rtol=0, atol=1e-9)


@pytest.mark.parametrize("side", [0.99, 1.01])
def test_the_upright_rod_stands_beyond_its_threshold(side):
    """v^2 = 2 J g / p: of a rod without radius 4/3 g l. Within 1 % on either side."""
    velocity = side * math.sqrt(4.0 / 3.0 * G * 0.3)
    found = hf.vibration_posture(ROD, velocity / (math.tau * 400.0), 400.0, math.pi)
    upright = [each for each in found if abs(math.cos(each.tilt) + 1.0) < 1e-9]
    assert [each.stable for each in upright] == [side > 1.0]


def floquet(amplitude: float, frequency: float) -> float:
    """Return the slow frequency of the upright rod, Hz, from the exact equation; NaN if it falls."""
    from scipy.integrate import solve_ivp

    arm, omega, period = 0.2, math.tau * frequency, 1.0 / frequency  # J / p of a rod is 2/3 of its length

    def rates(t, y):
        return [y[1], (G - amplitude * omega**2 * math.cos(omega * t)) / arm * y[0]]

    ends = [solve_ivp(rates, (0.0, period), start, rtol=1e-9, atol=1e-12).y[k, -1] for k, start in enumerate(np.eye(2))]
    cosine = 0.5 * sum(ends)
    return math.acos(cosine) / math.tau / period if abs(cosine) < 1.0 else math.nan


def upright(strength: float, frequency: float) -> hf.VibrationPosture:
    amplitude = strength * math.sqrt(4.0 / 3.0 * G * 0.3) / (math.tau * frequency)
    return nearest(hf.vibration_posture(ROD.replace(friction=[1e-6]), amplitude, frequency, math.pi), math.pi)


@pytest.mark.parametrize("strength", [1.02, 1.2, 3.0])
def test_what_holds_an_upright_rod_agrees_with_floquet(strength):
    """Near the threshold gravity cancels most of the effect of the vibration, and its error is compared with the
    rest."""
    held = upright(strength, 1.001 * upright(strength, 40.0).least_frequency)
    assert held.holds
    assert held.frequencies[0] == pytest.approx(floquet(held.amplitude, held.frequency), rel=0.05)


def test_a_slow_vibration_near_the_threshold_is_no_hold():
    held = upright(1.02, 1.15)  # five times as fast as the slow motion, which vanishes at the threshold
    assert held.stable
    assert not held.holds
    assert math.isnan(floquet(held.amplitude, held.frequency))


@pytest.mark.parametrize("tilt", [0.001, 3.1, 3.13, 3.14])
def test_a_tilt_near_the_vertical_can_be_held(tilt):
    plan = hf.plan_vibration(ROD, tilt)
    assert plan.success
    assert plan.posture.tilt == pytest.approx(tilt, abs=1e-9)


@pytest.mark.parametrize("line", [1.8, 2.4, 2.9])
def test_the_tilt_of_a_rod_is_that_of_the_closed_form_and_of_a_run(line):
    """p g sin q = v^2 p^2 / (4 J) sin 2 (line - q)."""
    held = hf.vibration_posture(ROD, 0.006, 100.0, line)[0]
    strength = held.velocity**2 * 1.5 / (4.0 * 0.3)  # p / J of a rod is 3 / (2 l)
    assert G * math.sin(held.tilt) == pytest.approx(
        strength * math.sin(2.0 * (line - held.tilt)), rel=1e-6
    )  # friction in the pivot
    assert held.stable
    assert held.holds
    assert tilt_of(held.simulate(0.8)) == pytest.approx(held.tilt, rel=0.01)


def test_acheson_a_chain_stands_between_his_two_limits():
    """A < .450 g / w_max^2 and A w > sqrt(2) g / w_min, of the modes of the hanging chain (1993)."""
    rope = hf.Rope(length=[0.1, 0.1], mass=[0.02, 0.02], friction=1e-6)
    model = Averaged(rope, None, math.pi, 100.0)
    squares = np.linalg.eigvals(np.linalg.solve(model.coupling, np.diag(G * model.lever))).real
    least, most = np.sqrt([squares.min(), squares.max()])
    amplitude = 0.25 * G / most**2  # well below the first limit
    for side in (0.97, 1.03):
        frequency = side * math.sqrt(2.0) * G / least / amplitude / math.tau
        found = hf.vibration_posture(rope, amplitude, frequency, math.pi)
        upright = next(each for each in found if np.abs(np.cos(each.q) + 1.0).max() < 1e-9)
        assert upright.stable == (side > 1.0)
    fast = 1.5 * math.sqrt(2.0) * G / least / math.tau  # m/s over tau
    for part in (0.93, 1.07):  # of the amplitude of the first limit, where averaging does not hold any more
        amplitude = part * 0.450 * G / most**2
        setup = {"q0": [math.pi + 1e-4, math.pi - 1e-4], "duration": 150.0 * amplitude / fast, "tol": 1e-9}
        run = hf.simulate(rope, hf.vibrating_pivot(amplitude, fast / amplitude, math.pi), **setup)
        assert (np.abs(run.q - math.pi).max() < 2e-3) == (part < 1.0)


@pytest.mark.parametrize(
    ("n", "arm"), [(2, None), (3, hf.Arm(length=0.3)), pytest.param(5, None, marks=pytest.mark.nightly)]
)
def test_a_planned_tilt_is_that_of_a_run(n, arm):
    rope = hf.Rope.uniform(length=0.4, mass=0.05, n_links=n, radius=0.003, friction=3e-4)
    plan = hf.plan_vibration(rope, 1.9, arm=arm)
    held = plan.posture
    assert plan.success
    assert held.holds
    assert held.tilt == pytest.approx(1.9, abs=1e-9)
    # The claim of `holds`; measured are .1 % on a line and .8 % with an arm.
    assert tilt_of(held.simulate(1.0)) == pytest.approx(1.9, rel=0.02)


def test_the_arm_drags_the_first_joint_by_its_friction():
    """In a rough hinge the arm turns the rod a little as it moves it, which changes the mean tilt."""
    rough, arm = ROD.replace(friction=[0.3]), hf.Arm(length=0.3)
    held = nearest(hf.vibration_posture(rough, 0.012, 80.0, 2.2, arm=arm), 2.0)
    pivot = nearest(hf.vibration_posture(rough, 0.012, 80.0, 2.2), 2.0)
    assert abs(held.tilt - pivot.tilt) > 0.02
    assert tilt_of(held.simulate(0.5)) == pytest.approx(held.tilt, rel=0.003)


def test_it_reports_where_averaging_does_not_hold():
    """A strong and slow vibration: the averaged part is as large as the remainder."""
    slow = hf.vibration_posture(ROD, 0.2, 4.0, 1.8)[0]
    assert not slow.holds
    assert f"averaging needs {slow.least_frequency:.3g} Hz" in repr(slow)
    assert abs(tilt_of(slow.simulate(3.0)) / slow.tilt - 1.0) > 0.02


def test_friction_counts_in_the_fast_motion():
    """If joints barely turn in a period, the chain acts like a rod, for which a slower vibration is fast enough."""
    rope = hf.Rope(length=[0.06] * 5, mass=[0.01] * 5, radius=0.003, friction=[1e-5, *[0.5] * 4])
    held = nearest(hf.vibration_posture(rope, 0.01, 60.0, 2.4), 2.2)
    free = nearest(hf.vibration_posture(rope.replace(friction=np.full(5, 1e-5)), 0.01, 60.0, 2.4), 2.2)
    assert held.stable
    assert held.holds
    assert not free.holds
    spread, freely = (float(np.ptp(np.abs(each.ripple))) for each in (held, free))
    assert spread < 0.3 * freely  # a rod's is 0
    assert tilt_of(held.simulate(1.0)) == pytest.approx(held.tilt, rel=0.01)


def nearest(found: list[hf.VibrationPosture], tilt: float) -> hf.VibrationPosture:
    return min(found, key=lambda each: abs(each.tilt - tilt))


@pytest.mark.parametrize(
    ("n", "tilt", "stiffness", "push"), [(1, 1.9, 1.0, None), (2, 1.0, 1.0, 0.0), (3, math.pi, 0.8, None)]
)
def test_a_pushed_tip_yields_as_the_plan_says(n, tilt, stiffness, push):
    rope = hf.Rope.uniform(length=0.3, mass=0.05, n_links=n, radius=0.003, friction=3e-4)
    held = hf.plan_vibration(rope, tilt, stiffness=stiffness, push=push).posture
    push = tilt + 0.5 * math.pi if push is None else push
    assert held.stiffness(push) == pytest.approx(stiffness, rel=1e-6)
    along = np.array([math.sin(push), -math.cos(push)])
    # Half of what either push does, so that what grows with its square is out: 2 % of the length are linear.
    moved = [pushed(held, sign * 0.02 * 0.3 * stiffness * along) for sign in (1.0, -1.0)]
    assert 0.5 * (moved[0] - moved[1]) @ along == pytest.approx(0.02 * 0.3, rel=0.05)


def pushed(held: hf.VibrationPosture, force: np.ndarray) -> np.ndarray:
    """Return the mean tip, m, under a force, N, over three of the slowest periods from the posture that it leads to."""
    across = np.stack([np.cos(held.q), np.sin(held.q)], axis=-1)
    moved = np.linalg.solve(held.hessian, held.rope.length * (across @ force))
    far = hf.Peg(50.0, 50.0, 0.1)  # what feels a force at the tip steps as in contact
    how = {"pegs": [far], "refine": False, "contact_step": 1.0 / (120.0 * held.frequency), "tol": 1e-3}
    start = held.q + moved + held.ripple.real
    return held.simulate(3.0 / held.frequencies[0], tip_force=force, q0=start, **how).tip.mean(axis=0)


def test_a_weak_motor_is_refused_with_what_it_lacks():
    refuses("the arm has no length", hf.plan_vibration, ROD, 1.9, hf.MotorLimits(), arm=hf.Arm(length=0.0))
    plan = hf.plan_vibration(ROD, 1.9, hf.MotorLimits(), arm=hf.Arm(length=0.1))
    assert not plan.success
    assert plan.missing["speed"] == (plan.motor.speed, hf.MotorLimits().speed)
    assert "the motor lacks" in plan.message
    assert "speed of" in plan.message
    assert "rad/s, has 8.61" in plan.message
    narrow = hf.MotorLimits(speed=1e3, acceleration=1e6, angles=(-1.0, plan.motor.angles[0] + 0.01))
    assert hf.plan_vibration(ROD, 1.9, narrow, arm=hf.Arm(length=0.1)).missing == {
        "angles": (plan.motor.angles[1], narrow.angles[1])
    }
    strong = replace(plan, missing={})
    assert strong.success
    assert strong.message == ""


def test_a_posture_that_nothing_holds_or_averaging_does_not_know_is_no_plan():
    plan = hf.plan_vibration(ROD, 1.9, direction=1.5)
    assert (plan.success, plan.posture, "no vibration holds" in plan.message) == (False, None, True)
    plan = hf.plan_vibration(ROD, 1.9, frequency=5.0)
    assert (plan.success, "averaging does not apply at 5 Hz; from" in plan.message) == (False, True)


def test_gravity_alone_hangs_and_a_vibration_leaves_it_there():
    still = hf.vibration_posture(ROD, 0.0, 50.0, 1.0)
    assert [round(each.tilt, 9) for each in still if each.stable] == [0.0]
    assert still[0].frequencies[0] == pytest.approx(math.sqrt(1.5 * G / 0.3) / math.tau, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dry_friction": [1e-3]}, "viscous friction"),
        ({"drag": [1e-3]}, "viscous"),
        ({"max_bend": [1.0]}, "max_bend"),
        ({"friction_model": "printed"}, "friction_model"),
    ],
)
def test_ropes_that_averaging_does_not_know_are_refused(change, words):
    refuses(words, hf.vibration_posture, ROD.replace(**change), 0.01, 50.0, 2.0)


def test_wrong_arguments():
    refuses("no small angle", hf.vibration_posture, ROD, 0.2, 50.0, 2.0, arm=hf.Arm(length=0.1))
    refuses("no arm", hf.plan_vibration, ROD, 1.9, hf.MotorLimits())
    for change, words in (
        ({"direction": "a"}, "direction"),
        ({"direction": math.nan}, "direction"),
        ({"limits": 3}, "lim"),
    ):
        refuses(words, hf.plan_vibration, ROD, 1.9, arm=hf.Arm(length=0.1), **change)
    refuses("tilt is not a number", hf.plan_vibration, ROD, "a")
    refuses("without gravity", hf.plan_vibration, ROD.replace(gravity=(0.0, 0.0)), 1.9)
    refuses("does not yield along itself", hf.plan_vibration, ROD, 1.9, stiffness=1.0, push=1.9 + math.pi)
    refuses("number of amplitudes", hf.vibration_map, ROD, [], [30.0, 60.0], 2.0)


def test_a_rod_does_not_yield_along_itself():
    held = hf.vibration_posture(ROD, 0.01, 60.0, 2.0)[0]
    assert held.stiffness(held.tilt) == math.inf
    assert 0.0 < held.stiffness(held.tilt + 1.0) < math.inf


def test_a_map_has_the_tilts_of_its_postures_and_can_be_drawn():
    ways, rates = np.linspace(0.004, 0.012, 5), np.linspace(30.0, 90.0, 4)
    found = hf.vibration_map(ROD, ways[::-1], rates, 2.4, arm=hf.Arm(length=0.1))
    alike = hf.vibration_posture(ROD, ways[3], rates[2], 2.4, arm=hf.Arm(length=0.1))[0]
    assert found.tilt[2, 3] == pytest.approx(alike.tilt, abs=1e-9)
    assert np.isfinite(found.tilt).any()
    axis = found.plot(hf.MotorLimits(speed=30.0, acceleration=9000.0)).axes[0]
    assert axis.get_xlabel() == "amplitude of the first joint, mm"
    assert [each.get_label() for each in axis.lines if "motor" in each.get_label()] != []


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.005, 5.0), (0.0129, 6.33), (0.01, 11.0)])
def test_a_rope_that_hangs_still_on_a_vertical_vibration_keeps_its_balance(amplitude, frequency):
    run = hf.simulate(ROD, hf.vibrating_pivot(amplitude, frequency, math.pi), duration=4.0)
    assert np.abs(run.q).max() < 1e-12


def test_vibrations_are_sinusoids_for_ever():
    t = np.linspace(0.0, 1.3, 400)  # over several of its loops
    wave = np.cos(math.tau * 20.0 * t)
    turned = hf.vibrate_arm(0.2, 20.0, 0.5)
    np.testing.assert_allclose(turned.angle(t), 0.5 + 0.2 * wave, rtol=0, atol=1e-7)
    motion = hf.vibrating_pivot(0.01, 20.0, 0.5 * math.pi)
    np.testing.assert_allclose(motion.point(t), np.stack([0.01 * wave, 0.0 * wave], axis=1), rtol=0, atol=5e-9)
    setup = hf.Setup(ROD, motion, duration=0.1)
    assert hf.Setup.loads(setup.dumps()).motion == motion
