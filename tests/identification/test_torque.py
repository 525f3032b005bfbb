"""Motor torque as a measured channel: against the dense reference, its slopes, and a twin whose scale it fixes."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from benchmarks.wrong_input import DOUBLE, longer, noisy

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.identification import Kind
from hyperflex.identification.measurements import build_plant
from hyperflex.identification.model import ANGLES, ARM_LENGTH, TORQUE, Plant, extended
from hyperflex.sensors import MotorTorque
from tests.identification.twins import QUICK
from tests.reference import dense
from tests.reference.arm import bang_bang_swings, links_of
from tests.refusals import refuses

ROPE = DOUBLE.replace(stiffness=[1e-3, 2e-3], tip_mass=0.01)
ARM = hf.Arm(length=0.1, inertia=2e-4, mass=0.05, com=0.04, friction=1e-3)
MOVE = hf.arm_swings(t_move=0.7, t_rest=0.4, profile="minimum-jerk")
NOISE, TORQUE_NOISE = 2e-3, 5e-3  # rad; N m, some 2 % of its rms
SCALED = ["mass", "inertia", "friction"]


def run(rope: hf.Rope = ROPE, duration: float = 5.0) -> hf.Trajectory:
    t = np.arange(round(50 * duration) + 1) / 50
    return hf.simulate(rope, MOVE, arm=ARM, duration=duration, t_eval=t, tol=1e-9)


def plant(free: list[str], rope: hf.Rope = ROPE) -> Plant:
    recording = hf.Recording([0.0, 1.0], np.zeros((2, 2)))
    return build_plant(recording, rope, free, hf.RecordingSetup(MOVE, ARM, torque=np.zeros(recording.t.size)))


# ---- the function and its slopes


def by_matrices(rope: hf.Rope, arm: hf.Arm, t: float, q: Array, w: Array, grip: Array | None = None) -> Any:
    """Motor torque of the paper's bang-bang swings, from dense matrices in long doubles."""
    stretch = next(each for each in bang_bang_swings(0.7, 0.4, 10.0) if each.end > t)
    base = stretch.base(t, arm.length)
    answer = dense.accelerations(links_of(rope), q, w, base, grip=grip)
    angle, rate, acceleration = base[4], base[3], base[2]
    lever = arm.length * (np.cos(angle) * answer.force[0] + np.sin(angle) * answer.force[1])
    weight = -arm.mass * arm.com * (rope.gravity[0] * np.cos(angle) + rope.gravity[1] * np.sin(angle))
    turning = (arm.inertia + arm.mass * arm.com**2) * acceleration + arm.friction * rate
    return answer.torque + lever + weight + turning


def states(rng: np.random.Generator, m: int = 20) -> tuple[Array, Array]:
    """Times away from the switches and random states."""
    t = np.sort(rng.uniform(0.0, 2.0, m))
    return t, np.hstack([rng.uniform(-2.0, 2.0, (m, 2)), rng.uniform(-8.0, 8.0, (m, 2))])


@pytest.mark.parametrize("model", ["relative", "printed"])
def test_torque_is_that_of_dense_matrices(model):
    """Rounding of a sweep: some hundred operations on torques of about 1 N m."""
    rope = ROPE.replace(friction_model=model)
    t, y = states(np.random.default_rng(0))
    drive = _drive(hf.arm_swings(0.7, 0.4))
    seen = MotorTorque(ARM).predict(rope.chain(), drive, t, y)
    expected = [float(by_matrices(rope, ARM, s, row[:2], row[2:])) for s, row in zip(t, y, strict=True)]
    np.testing.assert_allclose(seen, expected, rtol=1e-10, atol=1e-12)


def _drive(motion: Any, rope: hf.Rope = ROPE) -> Any:
    from hyperflex.model import Setup

    return Setup(rope, motion, ARM).drive()


def test_torque_of_a_stuck_joint_is_what_it_bears():
    rope = ROPE.replace(dry_friction=[5.0, 5.0])  # more than the motion can break
    stretch = next(iter(bang_bang_swings(0.7, 0.4, 1.0)))
    rate = stretch.at(0.2)[1]
    q, w = np.array([0.3, 0.5]), np.full(2, rate)
    t, y = np.array([0.2]), np.hstack([q, w])[None]
    drive = _drive(hf.arm_swings(0.7, 0.4), rope)
    seen = MotorTorque(ARM).predict(rope.chain(), drive, t, y)
    stuck = by_matrices(rope, ARM, 0.2, q, w, grip=np.zeros(2))
    assert float(seen[0]) == pytest.approx(float(stuck), rel=1e-10)
    # it moves as one body: along the arm's turning the slopes see no friction jump
    slope = MotorTorque(ARM).jacobian(rope.chain(), drive, (), t, y, np.eye(4)[None])
    ahead, behind = (by_matrices(rope, ARM, 0.2, q + np.array([h, 0.0]), w, grip=np.zeros(2)) for h in (1e-6, -1e-6))
    assert slope[0, 0] == pytest.approx(float((ahead - behind) / 2e-6), rel=1e-6)


def test_slopes_by_the_state_are_those_of_the_reference():
    """The reference differenced in long doubles with 1e-7 errs by 1e-11 or less; the kernel by 1e-5 squared."""
    t, y = states(np.random.default_rng(1))
    chain, drive = ROPE.chain(), _drive(hf.arm_swings(0.7, 0.4))
    slopes = MotorTorque(ARM).jacobian(chain, drive, (), t, y, np.broadcast_to(np.eye(4), (t.size, 4, 4)))
    exact = np.empty_like(slopes)
    step = np.longdouble(1e-7)
    for k, (time, row) in enumerate(zip(t, y, strict=True)):
        for i in range(4):
            ends = [row + sign * step * np.eye(4, dtype=np.longdouble)[i] for sign in (1, -1)]
            up, down = (by_matrices(ROPE, ARM, time, each[:2], each[2:]) for each in ends)
            exact[k, i] = float((up - down) / (2 * step))
    # by an angle the third derivative is some 30 times the first at these rates: 30 / 6 * 1e-10, and rounding 1e-10
    np.testing.assert_allclose(slopes, exact, rtol=1e-8, atol=2e-8)


def test_slopes_by_the_parameters_are_those_of_the_reference():
    """At fixed states; differences of 1e-5 on either side err by 1e-10 times a third derivative, and so do ours."""
    t, y = states(np.random.default_rng(2))
    free = ["inertia", "mass", "com", "length", "friction", "stiffness", "tip_mass", "gravity_angle"]
    rope = ROPE.replace(gravity=(2.0, -9.0))
    parameters = plant(free, rope).parameters
    x = parameters.start
    parts = tuple(part for _, part in parameters.parts(x))
    still = np.zeros((t.size, 4, 4 + len(parts)))
    slopes = MotorTorque(ARM).jacobian(rope.chain(), _drive(hf.arm_swings(0.7, 0.4)), parts, t, y, still)
    for k, label in enumerate(parameters.labels):
        ends = [parameters.rope(x + h * np.eye(x.size)[k]) for h in (1e-5, -1e-5)]
        for row, time in enumerate(t):
            up, down = (by_matrices(each, ARM, time, y[row, :2], y[row, 2:]) for each in ends)
            assert slopes[row, 4 + k] == pytest.approx(float((up - down) / 2e-5), rel=1e-7, abs=1e-9), label


def test_what_no_object_holds_starts_from_what_does_nothing():
    names = [ANGLES, TORQUE, ARM_LENGTH, "gravity_scale", "gravity_angle", "delay"]
    subject = plant(["friction"])
    subject, x, _ = extended(subject, subject.parameters.start, names)
    values = dict(zip(subject.parameters.labels, subject.parameters.values(x), strict=True))
    assert [values[name] for name in names] == [1.0, 1.0, 1.0, 1.0, 0.0, 0.0]


def test_an_impossible_arm_has_no_prediction():
    subject, swing = plant(["inertia", "arm_inertia"]), run(duration=0.2)
    below = np.array([1.0, 1.0, -1.0])  # two standard deviations below its estimate a parameter may be beyond its bound
    assert subject.predict(below, swing.t, np.concatenate([swing.q[0], swing.qd[0]])) is None


def test_slopes_by_everything_are_those_of_whole_rollouts():
    """Fourth-order differences of rollouts: these err by some 1e-7 rad, which over a step of 3e-3 makes 3e-5 N m."""
    free = ["inertia", "mass", "com", "length[0]", "friction", "stiffness", "tip_mass", "gravity_angle", "delay"]
    subject = plant([*free, "arm_inertia", "arm_friction"])
    subject, x, _ = extended(subject, subject.parameters.start, [TORQUE, ARM_LENGTH])
    t = np.arange(30, 61) / 50  # while the arm moves
    swing = run(duration=1.3)
    state = np.concatenate([swing.q[30], swing.qd[30]])
    found = subject.jacobian(x, t, state)
    assert found.channels.shape == (31, 3)

    def seen(k, h):
        result = subject.predict(x + h * np.eye(x.size)[k], t, state)
        return result

    h = 3e-3
    for k, label in enumerate(subject.parameters.labels):
        numeric = (8.0 * (seen(k, h) - seen(k, -h)) - (seen(k, 2 * h) - seen(k, -2 * h))) / (12.0 * h)
        assert np.abs(found.shared[:, 2, k] - numeric[:, 2]).max() < 6e-5, label
        assert np.abs(found.shared[:, 2, k]).max() > 1.8e-3, label  # 30 times as much

    def begun(i, h):
        result = subject.predict(x, t, state + h * np.eye(4)[i])
        return result

    for i in range(4):
        numeric = (8.0 * (begun(i, h) - begun(i, -h)) - (begun(i, 2 * h) - begun(i, -2 * h))) / (12.0 * h)
        np.testing.assert_allclose(found.state[:, 2, i], numeric[:, 2], atol=2e-3 * np.abs(numeric[:, 2]).max())


def test_what_the_plant_sees_is_what_the_simulator_calls_motor_torque():
    swing = run()
    subject = plant(["mass"])
    seen = subject.predict(subject.parameters.start, swing.t[:60], np.concatenate([swing.q[0], swing.qd[0]]))
    # two runs of tolerances 1e-9 and 6e-8 m
    np.testing.assert_allclose(seen[:, 2], swing.motor_torque[:60], atol=1e-5 * np.abs(swing.motor_torque).max())
    assert replace(subject, torque=False).motor is None


# ---- the twin


@cache
def measured() -> tuple[hf.Recording, Array]:
    """Angles and torque of the twin; simulated, with noise."""
    swing = run(ROPE.replace(stiffness=0.0, tip_mass=0.0))
    rng = np.random.default_rng(3)
    recording = hf.Recording(swing.t, swing.q + NOISE * rng.standard_normal(swing.q.shape), noise=NOISE)
    torque = swing.motor_torque + TORQUE_NOISE * rng.standard_normal(swing.t.size)
    return recording, torque


GUESS = ROPE.replace(stiffness=0.0, tip_mass=0.0, mass=[0.14, 0.09], inertia=5e-4, friction=1e-3)
LIGHT = hf.Arm(length=0.1, inertia=5e-5, mass=0.05, com=0.04, friction=1e-3)
BARE = hf.Arm(length=0.1, mass=0.05, com=0.04, friction=1e-3)


@cache
def fit(*, torque: bool) -> hf.Identification:
    recording, values = measured()
    if not torque:
        return hf.identify(recording, GUESS, SCALED, setup=hf.RecordingSetup(motion=MOVE, arm=LIGHT))
    free = [*SCALED, "arm_inertia"]
    exact = {"length_std": 0.0, "clock_std": 0.0, "torque_std": 0.0}
    setup = hf.RecordingSetup(motion=MOVE, arm=LIGHT, torque=values, torque_noise=TORQUE_NOISE)
    return hf.identify(recording, GUESS, free, setup=setup, options=hf.FitOptions(**exact))


def test_without_the_torque_the_scale_is_unknown():
    found = fit(torque=False)
    assert found.has(Kind.COMMON_FACTOR)
    assert np.isinf(found.std["mass"]).all()
    assert found.torque_residuals is None
    assert "torque_rms" not in found.summary()


def test_the_torque_fixes_the_scale():
    """Every figure within 4 of its stated standard deviations, which leave 6e-5 each to chance."""
    found = fit(torque=True)
    assert found.identifiable
    assert found.has(Kind.IDENTIFIABLE)
    assert found.grade == "usable"
    assert found.has(Kind.TORQUE_SCALE)
    for name, truth in (("mass", ROPE.mass), ("inertia", ROPE.inertia), ("friction", ROPE.friction)):
        assert (np.abs(found.values[name] - truth) < 4.0 * found.std[name]).all(), name
        assert (found.std[name] < 0.1 * truth).all(), name
    assert abs(found.values["arm_inertia"] - ARM.inertia) < 4.0 * found.std["arm_inertia"]
    assert (found.std["mass"] < 0.01 * ROPE.mass).all()  # 5 mN m of some 0.25, over 250 samples: 0.15 % at best
    # what is left of the torque stands beside the angles
    np.testing.assert_allclose(found.residual_rms, [NOISE] * 2, rtol=0.15)  # 3 std of 200 samples each
    assert found.summary()["torque_rms"] == found.torque_rms == pytest.approx(TORQUE_NOISE, rel=0.15)
    assert found.torque_residuals.shape == found.residual_t.shape
    assert "torque error" in str(found)
    assert not found.has(Kind.POOR_FIT, Kind.POOR_TORQUE)


@pytest.mark.nightly
def test_a_torque_of_the_wrong_sign_is_reported():
    """Masses then go where the torque is least, and angles alone still fit."""
    recording, values = measured()
    setup = hf.RecordingSetup(motion=MOVE, arm=LIGHT, torque=-values, torque_noise=TORQUE_NOISE)
    found = hf.identify(recording, GUESS, [*SCALED, "arm_inertia"], setup=setup, options=QUICK)
    assert found.has(Kind.POOR_TORQUE)
    assert not found.success


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("inertia", "kinds"), [(2e-4, [Kind.ARM_INERTIA]), (1e-3, [Kind.ARM_INERTIA, Kind.HELD, Kind.POOR_TORQUE])]
)
def test_an_arm_that_has_more_inertia_than_declared_is_reported(inertia, kinds):
    """Its torque goes into masses otherwise, by their own deviations and more."""
    motion, t = hf.arm_swings(0.7, 0.4, "minimum-jerk"), np.arange(300) / 50.0
    run = hf.simulate(DOUBLE, motion, arm=hf.Arm(length=0.1, inertia=inertia), duration=t[-1], t_eval=t, tol=1e-9)
    measured: dict[str, Any] = {"torque": noisy(run.motor_torque, 1e-3, 1), "torque_noise": 1e-3, "motion": motion}
    recording = hf.Recording(t, noisy(run.q), noise=2e-3)
    guess = DOUBLE.replace(inertia=5e-4, friction=3e-4)
    setup = hf.RecordingSetup(arm=hf.Arm(length=0.1), **measured)
    found = hf.identify(recording, guess, ["mass", "inertia", "friction"], setup=setup, options=QUICK)
    assert found.findings[0].kind in kinds
    assert found.has(Kind.ARM_INERTIA)
    assert (found.grade == "do not use") == (inertia == 1e-3)
    np.testing.assert_array_less(np.abs(found.rope.mass - DOUBLE.mass), 2.0 * found.std["mass"])


def driven(*, length: float = 1.0, arm: float = 1.0, clock: float = 1.0, scale: float = 1.0, **exact: float) -> Any:
    """Fit a twin whose lengths, arm, clock or torque are declared wrong by a factor."""
    t = np.arange(300) / 50.0
    run = hf.simulate(DOUBLE, MOVE, arm=hf.Arm(length=0.1), duration=t[-1], t_eval=t, tol=1e-9)
    measured: dict[str, Any] = {"torque": scale * noisy(run.motor_torque, 1e-3, 1), "torque_noise": 1e-3}
    recording = hf.Recording(clock * t, noisy(run.q), noise=2e-3)
    guess = longer(DOUBLE.replace(inertia=5e-4, friction=3e-4), length)
    motion = hf.arm_swings(0.7 * clock, 0.4 * clock, "minimum-jerk")
    setup = hf.RecordingSetup(motion=motion, arm=hf.Arm(length=0.1 * arm), **measured)
    return hf.identify(recording, guess, SCALED, setup=setup, options=hf.FitOptions(intervals=None, **exact))


def off(found: hf.Identification) -> float:
    """Return how many standard deviations masses, inertias and frictions are from the truth, at most."""
    return max(float(np.max(np.abs(found.values[k] - getattr(DOUBLE, k)) / found.std[k])) for k in SCALED)


def test_the_scale_of_the_torque_is_in_the_deviations_of_values_alone():
    found, exact = driven(scale=1.02), driven(scale=1.02, torque_std=0.0, length_std=0.0, clock_std=0.0)
    assert off(found) < 1.2
    assert off(exact) > 20.0
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.concatenate(list(found.std.values())))
    whole = driven(scale=1.02, length_std=0.0, clock_std=0.0)
    np.testing.assert_allclose(whole.std["mass"], np.hypot(exact.std["mass"], 0.02 * whole.values["mass"]), rtol=1e-3)
    for name, std in exact.ratio_std.items():
        np.testing.assert_allclose(whole.ratio_std[name], std, rtol=1e-3, atol=1e-12)
    assert found.settings["torque_std"] == 0.02
    assert found.has(Kind.TORQUE_SCALE)
    assert found.summary()["settings"]["torque_std"] == 0.02
    refuses("torque_std has the wrong sign", driven, torque_std=-0.01)


@pytest.mark.parametrize(
    ("length", "arm", "clock"),
    [(0.99, 1.01, 1.0), (1.01, 1.01, 1.0), (0.99, 0.99, 1.0), (1.0, 0.99, 1.0), (1.0, 1.0, 1.005)],
)
def test_lengths_arm_and_clock_that_err_as_declared_are_in_the_deviations_of_masses(length, arm, clock):
    """With all lengths 1 % off mass[1] was 5.3 deviations off: an arm's length had none, and a clock no torque."""
    found = driven(length=length, arm=arm, clock=clock, torque_std=0.0)
    assert found.grade == "usable"
    assert off(found) < 2.0
    assert (found.std["mass"] < 0.03 * DOUBLE.mass).all()  # not by saying that nothing is known


def test_gaps_in_the_torque_and_a_held_out_part():
    recording, torque = measured()
    torque = torque.copy()
    torque[::3] = np.nan
    free = [*SCALED, "arm_inertia"]
    setup = hf.RecordingSetup(motion=MOVE, arm=LIGHT, torque=torque, torque_noise=TORQUE_NOISE)
    found = hf.identify(recording, GUESS, free, setup=setup, options=hf.FitOptions(train=3.4))
    assert found.held_out.rms.shape == (2,)  # of the angles: nothing is predicted of the torque
    np.testing.assert_allclose(found.held_out.rms, NOISE, rtol=0.5)  # 50 samples, and the error of the state
    assert np.isnan(found.torque_residuals).sum() >= 50
    assert (np.abs(found.values["mass"] - ROPE.mass) < 4.0 * found.std["mass"]).all()


def test_models_are_compared_with_the_torque():
    recording, torque = measured()
    models = {"arm with inertia": [*SCALED, "arm_inertia"], "without": SCALED}
    found = hf.compare_models(
        recording, GUESS, models, setup=hf.RecordingSetup(MOVE, BARE, torque=torque, torque_noise=TORQUE_NOISE)
    )
    assert found.preferred == "arm with inertia"


def test_torque_that_cannot_be_used_is_refused():
    recording, torque = measured()
    bare = hf.Recording(recording.t, recording.data)
    arm: dict[str, Any] = {"motion": MOVE, "arm": LIGHT}
    for options, message in (
        ({"motion": MOVE, "torque": torque, "torque_noise": 1e-3}, "without the arm"),
        ({**arm, "torque": torque}, "torque_noise is not given"),
        ({**arm, "torque": torque[1:], "torque_noise": 1e-3}, "wrong shape"),
        ({**arm, "torque": torque, "torque_noise": 0.0}, "torque_noise"),
        ({**arm, "torque": np.full(torque.size, np.nan), "torque_noise": 1e-3}, "no value at all"),
    ):
        with pytest.raises(hf.InvalidInput, match=message):
            hf.identify(recording, GUESS, SCALED, setup=hf.RecordingSetup(**options))
    with pytest.raises(hf.InvalidInput, match="noise of the recording"):
        hf.identify(bare, GUESS, SCALED, setup=hf.RecordingSetup(torque=torque, torque_noise=1e-3, **arm))
    setup = hf.RecordingSetup(**arm)
    refuses(r"that is fitted.*torque_std", hf.RecordingSetup, torque=np.zeros(3), torque_noise=1e-3)
    refuses("no torque of an arm's motor is measured", hf.identify, recording, GUESS, ["arm_inertia"], setup=setup)


def test_an_arm_that_is_held_tells_the_scale_as_well():
    """A free swing from an arm that the motor holds still: the torque that holds it is a known force."""
    rope = ROPE.replace(stiffness=0.0, tip_mass=0.0)
    t = np.arange(251) / 50
    motion = hf.hold_arm(1.0)
    swing = hf.simulate(rope, motion, arm=ARM, duration=5.0, t_eval=t, tol=1e-9, q0=[0.8, 1.2])
    rng = np.random.default_rng(5)
    recording = hf.Recording(t, swing.q + NOISE * rng.standard_normal(swing.q.shape), noise=NOISE)
    torque = swing.motor_torque + TORQUE_NOISE * rng.standard_normal(t.size)
    found = hf.identify(
        recording,
        GUESS,
        SCALED,
        setup=hf.RecordingSetup(motion=motion, arm=ARM, torque=torque, torque_noise=TORQUE_NOISE),
    )
    assert found.identifiable
    assert (np.abs(found.values["mass"] - rope.mass) < 4.0 * found.std["mass"]).all()
