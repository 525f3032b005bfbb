"""Events that end a run: closed forms, and tight runs sampled near the event."""

import numpy as np
import pytest
from scipy.special import ellipk

import hyperflex as hf
from hyperflex.motion import Motion
from tests.refusals import refuses

LENGTH, MASS, G = 0.5, 0.1, 9.81
ROD = hf.Rope(length=[LENGTH], mass=[MASS])
ARM = hf.Arm(length=0.105)
START = 1.2
# A quarter of a large swing takes K(sin^2(start / 2)) / omega, from the elliptic integral.
QUARTER = float(ellipk(np.sin(START / 2) ** 2) / np.sqrt(1.5 * G / LENGTH))


def cable(**changes: object) -> hf.Rope:
    kept = {"length": 2.0, "mass": 0.125, "n_links": 20, "radius": 0.0025, "friction": 5e-4, **changes}
    return hf.Rope.uniform(**kept)


PASSES = [  # event, quarters of a swing from the start at +1.2 rad
    (hf.tip_crosses((0.0, -0.3), (-1.0, 0.0)), 1),
    (hf.tip_crosses((0.0, 0.0), (2.0, 0.0)), 3),
    (hf.tip_crosses((0.0, 0.0), (1.0, 0.0), sense=-1), 1),
    (hf.tip_crosses((0.0, 0.0), (1.0, 0.0), sense=0), 1),
    (hf.tip_crosses((0.0, 0.0), (1.0, 0.0), sense=0, after=0.5), 3),
    (hf.angle_reached(0.0, 0), 1),
    (hf.angle_reached(0.0, 0, sense=1), 3),
    (hf.tip_speed_peak(), 1),
    (hf.tip_speed_peak(after=0.5), 3),
    (hf.phase_reached(np.pi, 0.2), 1),
    (hf.phase_reached(-2 * np.pi, 0.2), 3),
]


@pytest.mark.parametrize("how", [{"tol": 1e-12}, {"step": 1e-3}], ids=["extrapolation", "rk4"])
@pytest.mark.parametrize("case", range(len(PASSES)))
def test_a_pendulum_passes_the_bottom(case, how):
    until, quarters = PASSES[case]
    run = hf.simulate(ROD, duration=10.0, q0=[START], until=until, **how)
    assert run.event is not None
    assert run.event[0] == until.name
    assert run.event[1] == run.t[-1] == run.state.t
    assert run.t.size > 10 * quarters
    # The events are located to 1e-12 s; both integrators' own errors come to less than 1e-10 rad at 6 rad/s.
    assert run.t[-1] == pytest.approx(quarters * QUARTER, abs=1e-9)
    assert abs(run.tip[-1, 0]) < 1e-9


def test_where_it_is_farthest_out():
    """The rod turns back at the phases pi/2 and -pi/2, whatever the time constant."""
    run = hf.simulate(ROD, duration=10.0, q0=[START], until=hf.phase_reached(1.5 * np.pi, 0.3), tol=1e-12)
    assert run.t[-1] == pytest.approx(2 * QUARTER, abs=1e-9)
    assert run.q[-1, 0] == pytest.approx(-START, abs=1e-9)


def test_a_phase_on_the_other_side_is_not_reached():
    """Gravity to the right: the tip stays there, its phase sways about pi/2, and passes the ray opposite to -pi/2."""
    rod = ROD.replace(gravity=(G, 0.0))
    kept = {"duration": 3.0, "q0": [START], "tol": 1e-9}
    assert hf.simulate(rod, until=hf.phase_reached(-np.pi / 2, 0.3), **kept).event is None
    assert hf.simulate(rod, until=hf.phase_reached(np.pi / 2, 0.3), **kept).event is not None


def test_a_cast_to_a_phase_and_to_a_peak():
    """Against a run at a tight tolerance, sampled a microsecond before and after."""
    kept = {"arm": ARM, "duration": 4.0, "tol": 1e-10}
    motion = hf.arm_swings()
    for until in (
        hf.tip_crosses((0.3, -1.0), (1.0, 0.5), after=1.0),
        hf.tip_speed_peak(after=0.9),
        hf.phase_reached(2.0, 0.4, after=1.0),
        hf.angle_reached(0.4, 11),
        hf.angle_reached(0.2),
    ):
        run = hf.simulate(cable(), motion, until=until, **kept)
        assert run.event is not None
        near = 1e-4
        beside = hf.simulate(cable(), motion, t_eval=run.t[-1] + near * np.arange(-2, 3), **kept)
        np.testing.assert_allclose(beside.q[2], run.q[-1], rtol=0, atol=1e-9)
        v, x = beside.tip_velocity, beside.tip
        reading = {
            "tip crosses": (x - [0.3, -1.0]) @ [1.0, 0.5],
            "phase reached": np.arctan2(x[:, 0], 0.4 * v[:, 0]) - 2.0,
            "angle reached": beside.q[:, 11] - 0.4 if until.numbers[1] == 11 else beside.arm_angle - 0.2,
        }
        if until.name == "tip speed peak":
            speed = np.hypot(*v.T)
            assert speed[2] == speed.max()
            fitted = np.polyfit(np.arange(-2, 3), speed, 2)
            assert abs(-0.5 * fitted[1] / fitted[0]) < 0.05  # of 1e-4 s: noise of the speeds limits the parabola
        else:
            values = reading[until.name]
            slope = (values[3] - values[1]) / (2 * near)
            assert abs(values[2] / slope) < 1e-9  # s
            assert values[1] < 0.0 < values[3]


def test_a_peak_may_be_a_corner():
    """The wheel speeds up, then slows down at once: a point on it is fastest at the switch."""
    coef = np.zeros((2, 4, 6))
    coef[0, 0, :3] = 0.0, 0.0, 1.0
    coef[1, 0, :3] = 1.0, 2.0, -0.5
    wheel = Motion(np.array([0.0, 1.0, 2.0]), coef, np.ones(3, dtype=bool))
    stiff = hf.Rope(length=[0.1], mass=[0.1], dry_friction=10.0, gravity=(0.0, 0.0))
    run = hf.simulate(stiff, wheel, arm=ARM, duration=2.0, until=hf.tip_speed_peak())
    assert run.event == ("tip speed peak", 1.0)


def test_what_does_not_happen():
    run = hf.simulate(ROD, duration=1.0, q0=[START], until=hf.tip_crosses((0.0, 1.0), (0.0, 1.0)), tol=1e-10)
    plain = hf.simulate(ROD, duration=1.0, q0=[START], tol=1e-10)
    assert run.event is None
    assert run.t[-1] == 1.0
    # steps are shorter while something is awaited; both runs are good to some tol
    np.testing.assert_allclose(run.q, plain.q, rtol=0, atol=1e-8)


def test_going_on_from_an_event(tmp_path):
    until = hf.tip_crosses((0.0, 0.0), (1.0, 0.0), sense=0)
    state, times = None, []
    for _ in range(4):
        q0 = [START] if state is None else None
        run = hf.simulate(ROD, duration=3.0, q0=q0, until=until, state=state, tol=1e-12)
        run.to_netcdf(tmp_path / "run.nc")
        again = hf.read_trajectory(tmp_path / "run.nc")
        assert again.event == run.event
        assert run.dataset.attrs["event"] == "tip crosses"
        state = again.state
        times.append(run.t[-1])
    np.testing.assert_allclose(times, QUARTER * np.array([1, 3, 5, 7]), rtol=0, atol=1e-9)


def test_with_dry_friction_and_a_torque():
    rope = cable(n_links=3, dry_friction=3e-3)
    arm = hf.Arm(length=0.1, inertia=1e-3, mass=0.05)
    kept = {"arm": arm, "torque": 0.2, "duration": 3.0, "tol": 1e-10}
    run = hf.simulate(rope, until=hf.angle_reached(1.0), **kept)
    assert run.event is not None
    assert run.arm_angle[-1] == pytest.approx(1.0, abs=1e-10)
    plain = hf.simulate(rope, t_eval=[run.t[-1]], **kept)
    np.testing.assert_allclose(run.q[-1], plain.q[-1], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: hf.tip_crosses((0.0, 0.0), (0.0, 0.0)), "direction has no length"),
        (lambda: hf.tip_crosses((0.0,), (0.0, 1.0)), "point"),
        (lambda: hf.tip_crosses((0.0, 0.0), (0.0, 1.0), sense=2), "sense"),
        (lambda: hf.phase_reached(1.0, 0.0), "c"),
        (lambda: hf.tip_speed_peak(after=np.nan), "after"),
        (lambda: hf.simulate(ROD, duration=1.0, until=hf.angle_reached(1.0, 1)), "link"),
        (lambda: hf.simulate(ROD, duration=1.0, until=hf.angle_reached(1.0)), "arm"),
        (lambda: hf.simulate(ROD, duration=1.0, until=3.0), "until"),
    ],
)
def test_bad_events(make, words):
    refuses(words, make)
