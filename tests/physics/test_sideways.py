"""Motion out of the plane of a run: exact solutions, the spherical pendulum, and figures of another program."""

import math

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.simulation import out_of_plane
from hyperflex.status import Status
from tests.refusals import refuses

DEGREE = math.radians(1.0)


def swing(duration=1.0, dt=0.01, pegs=(), **changes):
    """A rope of eight links that swings widely from a fixed point, with friction and air."""
    kept = {"length": 1.0, "mass": 0.1, "n_links": 8, "radius": 0.003, "friction": 1e-3, "drag_coefficient": 1.2}
    rope = hf.Rope.uniform(**{**kept, **changes})
    t = np.arange(0.0, duration + 1e-9, dt)
    return hf.simulate(rope, duration=duration + 1e-9, q0=np.linspace(1.0, 2.0, 8), t_eval=t, pegs=pegs, tol=1e-7)


def test_a_plane_that_is_turned_about_the_vertical_is_the_same_swing():
    """x = e sin q solves the equations exactly: tension and air are those of the rotated plane.

    Not with friction: the wall does not rotate, and its joint resists the twist.
    """
    off, known = [], []
    for dt in (0.01, 0.005, 0.0025):
        run = swing(dt=dt, friction=0.0)
        want = DEGREE * np.sin(run.q)
        found = hf.sideways(run, tilt=want[0], rate=DEGREE * np.cos(run.q[0]) * run.qd[0])
        off.append(np.abs(found.angles - want).max() / DEGREE)
        wrong = np.abs(np.cumsum(run.setup.rope.length * (found.angles - want), axis=1)).max()
        known.append(found.error / wrong)
    assert off[0] < 0.03
    assert off[1] < 0.4 * off[0]  # order 3: an eighth in the limit
    assert off[2] < 0.25 * off[1]
    assert min(known) > 1.0  # the error is known, and not much less than what is said: order 3 gives 7/2
    assert max(known) < 4.0


def test_steps_are_finer_where_those_of_10_ms_are_too_coarse():
    """A shorter rope swings faster."""
    run = swing(length=0.3, friction=0.0)
    want = DEGREE * np.sin(run.q)
    found = hf.sideways(run, tilt=want[0], rate=DEGREE * np.cos(run.q[0]) * run.qd[0])
    wrong = np.abs(np.cumsum(run.setup.rope.length * (found.angles - want), axis=1)).max()
    assert found.finer > 1
    assert wrong < found.error < 0.05 * np.abs(found.joints).max()


def test_a_leaning_plane_and_a_draught_hold_a_rope_aside():
    rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=8, friction=1e-3, tip_mass=0.02)
    run = hf.simulate(rope, duration=2.0)
    np.testing.assert_allclose(hf.sideways(run, lean=DEGREE).angles, DEGREE, rtol=1e-9)
    rope = rope.replace(tip_mass=0.0)  # weight and draught are then in proportion at each place
    run, force = hf.simulate(rope, duration=2.0), 0.01
    angle = force / (0.1 * 9.81)
    np.testing.assert_allclose(hf.sideways(run, tilt=angle, side=force).angles, angle, rtol=1e-9)


@pytest.mark.parametrize("detuning", [-0.05, 0.25, 0.4])
def test_a_pendulum_near_resonance_leaves_its_plane(detuning):
    """Growth of a spherical pendulum's motion out of the plane it is driven in (Miles, 1962).

    Driven so that it swings as q = A cos(w t), its equation across is x'' + w0^2 [1 + A^2/4 - 3/4 A^2 cos(2 w t)] x = 0
    to second order in A. Averaged: growth rate 1/(2 w) sqrt((3/8 A^2 w0^2)^2 - (w0^2 (1 + A^2/4) - w^2)^2), so it grows
    for w^2/w0^2 from 1 - A^2/8, where it swings freely, to 1 + 5/8 A^2.
    """
    length, most = 1.0, 0.2
    w0 = math.sqrt(9.81 / length)
    w = w0 * math.sqrt(1.0 + detuning * most**2)
    period, cycles, count = 2.0 * math.pi / w, 100, 64
    phase = 2.0 * math.pi * np.arange(count) / count
    q = most * np.cos(phase)
    pull = -length * (-w * w * q + w0 * w0 * np.sin(q)) / np.cos(q)  # acceleration of the pivot for that swing
    waves = np.fft.rfft(pull) / count
    order = np.arange(1, 8)
    t = period / count * np.arange(cycles * count + 1)
    turn = np.outer(t, order * w)
    path = -2.0 * (
        np.cos(turn) @ (waves[order].real / (order * w) ** 2) - np.sin(turn) @ (waves[order].imag / (order * w) ** 2)
    )
    rope = hf.Rope(length=[length], mass=[0.0], inertia=[1e-9], tip_mass=1.0)
    pivot = hf.moving_pivot(t, path, 0.0 * t)
    run = hf.simulate(rope, pivot, duration=float(t[-1]), q0=[most], t_eval=t, tol=1e-7)
    assert np.abs(run.q[:, 0]).max() == pytest.approx(most, rel=0.01)
    found = hf.sideways(run, tilt=1e-3, rate=0.0)
    size = np.hypot(found.angles[:, 0], found.rates[:, 0] / w)
    late, last = 60 * count, 100 * count
    rate = math.log(size[last] / size[late]) / (t[last] - t[late])
    theory = math.sqrt((0.375 * most**2 * w0**2) ** 2 - (w0**2 * (1.0 + 0.25 * most**2) - w**2) ** 2) / (2.0 * w)
    assert rate == pytest.approx(theory, rel=0.04)  # the next order is A^2 = 4 %


def test_growth_is_that_of_the_worst_start():
    run = swing()
    t, growth = hf.sideways(run, tilt=0.0).growth()
    assert growth[0] == 1.0
    assert t[-1] == run.t[-1]
    reach = math.sqrt(1.0 / 9.81)
    rng = np.random.default_rng(0)
    rows = np.searchsorted(run.t, t - 1e-9)
    for _ in range(3):
        found = hf.sideways(run, tilt=rng.normal(0.0, DEGREE, 8), rate=rng.normal(0.0, DEGREE, 8))
        speed = np.cumsum(run.setup.rope.length * found.rates, axis=1)
        size = np.linalg.norm(np.hstack([found.joints[:, 1:], reach * speed]), axis=1)
        assert (size[rows] <= 1.01 * growth * size[0]).all()  # the steps are others


def test_it_ends_where_the_rope_touches():
    rope = hf.Rope.uniform(length=1.0, mass=0.1, n_links=8, radius=0.005, friction=1e-3)
    run = hf.simulate(rope, duration=1.0, q0=0.8, pegs=[hf.Peg(0.0, -0.6, 0.05)], refine=False)
    found = hf.sideways(run, tilt=DEGREE)
    assert found.touch == run.t[found.t.size]
    assert not run.contact_force[: found.t.size].any()
    assert run.contact_force[found.t.size].any()
    assert "touches" in repr(found)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (
            lambda: hf.simulate(hf.Rope.uniform(1.0, 0.1, 4, friction=1e-3, friction_model="printed"), duration=0.1),
            "pla",
        ),
        (
            lambda: hf.simulate(
                hf.Rope.uniform(1.0, 0.1, 4, friction=1e-3), arm=hf.Arm(inertia=1e-3), torque=0.1, duration=0.1
            ),
            "torque",
        ),
        (lambda: swing(0.1, dry_friction=1e-5), "dry friction is not"),
        (lambda: swing(2.0, dt=0.05, stiffness=0.5), "the motion is wrong by"),
        (lambda: swing(1.0, dt=0.04, pegs=[hf.Peg(0.0, -2.0, 0.05)]), "apart with obstacles"),
        (lambda: swing(0.01), "too few samples"),
    ],
)
def test_runs_that_it_cannot_follow_are_refused(made, words):
    refuses(words, hf.sideways, made(), tilt=DEGREE)


def test_a_motion_that_is_not_finite_is_an_error(monkeypatch):
    run = swing(0.1)
    monkeypatch.setattr(out_of_plane, "integrate", lambda *of: of[6].fill(math.inf))  # angles
    with pytest.raises(hf.SimulationError, match="beyond all bounds") as caught:
        hf.sideways(run, tilt=DEGREE)
    assert (caught.value.status, caught.value.time) == (Status.NOT_FINITE, run.t[-1])


def test_large_angles_are_reported_and_a_bent_rope_needs_its_tilt():
    run = hf.simulate(hf.Rope.uniform(1.0, 0.1, 8, friction=1e-3), q0=0.5, duration=1.0)
    assert "useless at 74" in repr(hf.sideways(run, tilt=25.0 * DEGREE))
    assert hf.sideways(run, tilt=0.5 * DEGREE).warning() == ""
    refuses("hanging at rest", hf.sideways, run, lean=DEGREE)
