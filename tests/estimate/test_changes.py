"""Tests for changes: what they notice, when and as what; finer truths, places in metres. All data are simulated."""

import numpy as np
import pytest
from scipy import stats

import hyperflex as hf
from hyperflex.checks import Array
from hyperflex.estimate import Change, ChangeTests, EstimatedParameter, Observations, RopeFilter
from tests.estimate.runs import disturbed, rope, track
from tests.oracles.mujoco_chain import HingeChain
from tests.refusals import refuses

AT = 3.0
CAMERA = np.array([0.0, -1.0, 4.0])  # m: where the picture is taken from, in front of the swing plane


def noticed(changes: list[Change], name: str) -> float:
    """Seconds from the change until its detection with the right name."""
    return next((each.noticed for each in changes if each.name == name), np.inf) - AT


@pytest.mark.parametrize(
    ("moved", "allowed"),
    [pytest.param(True, 0.5, id="cast"), pytest.param(False, 2.0, id="free swing", marks=pytest.mark.nightly)],
)
def test_a_mass_at_the_tip(moved, allowed):
    """5 g of 125 g. It is noticed, from then on it is estimated, and 2 s later known to 10 %."""
    truth = disturbed(moved=moved, duration=AT + 2.3, at=AT, tip_mass=5e-3)
    found = track(truth, frames=30.0, moved=moved, tests=ChangeTests())
    assert found.changes[0].noticed - AT < allowed
    assert 0.0 < noticed(found.changes, "tip_mass") < allowed + 0.5
    change = next(each for each in found.changes if each.name == "tip_mass")
    assert change.size == pytest.approx(5e-3, abs=3.0 * change.std)
    assert change.probability > 0.5
    value, std = found.tracker.values["tip_mass"]
    assert value == pytest.approx(5e-3, rel=0.1)
    assert std < 5e-4
    assert {each.name for each in found.changes} <= {"tip_mass", "touch"}


@pytest.mark.parametrize(
    ("moved", "force", "allowed"),
    [
        (True, 0.02, 0.3),
        (False, 0.2, 0.1),
        pytest.param(True, 0.2, 0.1, marks=pytest.mark.nightly),
        pytest.param(False, 0.02, 0.3, marks=pytest.mark.nightly),
    ],
)
def test_a_touch(moved, force, allowed):
    """For 0.1 s, across the rope, between two of the places where touches are tried."""
    angle = float(disturbed(moved=moved, duration=AT, at=AT).q[-1, 65])
    touch = (1.3, force * np.cos(angle), force * np.sin(angle), 0.1)
    found = track(
        disturbed(moved=moved, duration=AT + 1.2, at=AT, touch=touch), frames=30.0, moved=moved, tests=ChangeTests()
    )
    assert [each.name for each in found.changes] == ["touch"]
    change = found.changes[0]
    assert 0.0 < change.noticed - AT <= allowed + 1e-6
    assert abs(change.time - AT) < 0.15
    assert change.arc_length == pytest.approx(1.3, abs=0.3)
    assert np.hypot(*change.impulse) == pytest.approx(change.size)
    assert change.impulse[0] * touch[1] + change.impulse[1] * touch[2] > 0.0  # it points the right way
    assert found.rms("tip", AT + 0.5) < 3e-3


@pytest.mark.parametrize(("moved", "duration"), [pytest.param(False, 10.0, marks=pytest.mark.nightly), (True, 7.0)])
def test_nothing_has_changed(moved, duration):
    """A finer rope, swinging freely or pumped: no alarm in 15 s, where one in 600 s is allowed."""
    found = track(disturbed(moved=moved, duration=duration, at=1.0), frames=30.0, moved=moved, tests=ChangeTests())
    assert found.changes == []


def test_the_rate_of_false_alarms_is_what_was_requested():
    """White innovations with 1.5 s required between alarms: at most as many, by Bonferroni's bound, but more than
    none."""
    cable, rng = rope(6), np.random.default_rng(0)
    interval, dt, frames, count = 1.5, 1 / 30, 3000, 0
    tests = ChangeTests(("length", "touch"), interval, {"length": 0.0, "touch": 0.0})
    tracker = RopeFilter(cable, [0.7, 1.4, 2.0], tests=tests)
    detector = tracker._detector  # its own innovations are never quite white: it is given some that are
    x, n = np.zeros(13), 6
    transition = np.eye(13)
    transition[:n, n : 2 * n] = dt * np.eye(n)
    transition[: 2 * n] *= 0.97
    jacobian = rng.normal(size=(6, 13))
    detector.begin(0.0)
    for k in range(frames):
        detector.predict((x, x), k * dt, (k + 1) * dt, transition)
        found = detector.update((k + 1) * dt, jacobian, np.zeros((13, 6)), np.eye(6), rng.normal(size=6))
        if found is not None and found.change is not None:
            count += 1
            detector.begin((k + 1) * dt)
    mean = frames * dt / interval
    assert count <= stats.poisson.ppf(0.999, mean)
    assert count >= 1


def test_the_kick_of_an_impulse_is_that_of_mujoco():
    """M^-1 J' by MuJoCo's mass matrix and its Jacobian of a point on a link, in relative angles."""
    import mujoco

    cable, n = rope(7), 7
    rng = np.random.default_rng(4)
    q = rng.normal(size=n)
    chain = HingeChain(cable)
    chain.put(q, np.zeros(n))
    matrix, jacobian = np.zeros((n, n)), np.zeros((3, n))
    mujoco.mj_fullM(chain.model, chain.data, matrix)
    joints = chain.joints()
    point = np.array([joints[4, 0], 0.0, joints[4, 1]])  # where the fourth link ends
    mujoco.mj_jac(chain.model, chain.data, jacobian, None, point, 4)  # body 0 is the world
    expected = np.cumsum(np.linalg.solve(matrix, jacobian[[0, 2]].T), axis=0)
    tracker = RopeFilter(cable, [1.0])
    arms = np.where(np.arange(n) < 4, cable.length, 0.0)[None]
    np.testing.assert_allclose(tracker.process.kicks(q, arms), expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def tilted(t: float, places: Array) -> Array:
    """The swing plane turned by 5 degrees about a vertical line, as the camera that does not know it shows it."""
    apart = places - CAMERA[:2]
    depth = apart[:, :1] * np.sin(np.deg2rad(5.0))
    return CAMERA[:2] + apart * [np.cos(np.deg2rad(5.0)), 1.0] / (1.0 + depth / CAMERA[2])


def swaying(t: float, places: Array) -> Array:
    """The tip sways by 50 mm towards the camera and back, once a swing."""
    depth = 0.05 * np.sin(2.0 * np.pi * t / 2.8) * np.linspace(0.1, 1.0, len(places))[:, None]
    return CAMERA[:2] + (places - CAMERA[:2]) / (1.0 + depth / CAMERA[2])


@pytest.mark.parametrize("view", [tilted, swaying])
@pytest.mark.parametrize("moved", [False, True], ids=["free swing", "cast"])
@pytest.mark.nightly
def test_motion_out_of_the_plane_is_reported(view, moved):
    """Within 5 s; runs in their plane say nothing (above)."""
    truth = disturbed(moved=moved, duration=5.5, at=1.0)
    found = track(truth, frames=30.0, moved=moved, view=view, tests=ChangeTests())
    assert any(each.name == "misfit" and each.size > 1.25 for each in found.changes)


def test_what_is_estimated_is_tested_too():
    tests = ChangeTests(("scale", "touch"))
    tracker = RopeFilter(rope(5), [1.0, 2.0], parameters=[EstimatedParameter("scale", 0.01)], tests=tests)
    assert list(tracker.values) == ["scale"]
    assert tracker.parameters.names == ("scale",)


def test_bad_input():
    refuses("no test for a change of this", ChangeTests, ("colour",))
    refuses("no test for a change of this", ChangeTests, tolerances={"colour": 1.0})
    refuses("false_alarm_interval", ChangeTests, false_alarm_interval=0.0)
    refuses("tolerance of length", ChangeTests, tolerances={"length": -1.0})
    refuses("the rope has none", RopeFilter, rope(5), [1.0], tests=ChangeTests(("drag",)))
    assert ChangeTests().names_for(rope(5)) == ("length", "friction", "tip_mass", "touch")


def test_a_slow_camera_is_tested_too():
    """3.3 frames/s: a mass at the tip is detected, as at 10."""
    cable, gap = hf.Rope.uniform(length=1.0, mass=0.05, n_links=10, radius=0.002, friction=1e-4), 0.3
    heavy, rng = cable.replace(tip_mass=0.02), np.random.default_rng(0)
    first = hf.simulate(cable, duration=3.9, q0=np.full(10, 0.8), t_eval=np.arange(0.0, 3.91, gap))
    then = hf.simulate(heavy, duration=6.0, q0=first.q[-1], qd0=first.qd[-1], t_eval=np.arange(0.0, 5.9, gap))
    tracker, told = RopeFilter(cable, [0.2, 0.5, 0.7, 1.0], tests=ChangeTests(("tip_mass",))), []
    for k, joints in enumerate(np.concatenate([first.joints, then.joints[1:]])):
        tracker.update(Observations(gap * k, joints[[2, 5, 7, 10]] + 1e-3 * rng.normal(size=(4, 2)), std=1e-3))
        told += tracker.changes
    assert {"tip_mass"} <= {each.name for each in told}
    assert tracker.values["tip_mass"][0] == pytest.approx(0.02, rel=0.1)
