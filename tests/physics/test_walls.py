"""Straight obstacles against closed forms: a rope on a floor, a bouncing rod, a wall's end, and a slit."""

import math

import numpy as np
import pytest

import hyperflex as hf
from tests.refusals import refuses

RADIUS = 0.0025  # m, of the ropes here


def test_a_rope_comes_to_rest_on_the_floor():
    rope = hf.Rope.uniform(0.6, 0.06, 15, RADIUS, friction=5e-3)
    floor = hf.Ground(0.0, -0.3, mu=0.5)
    run = hf.simulate(rope, duration=4.0, q0=np.full(15, 1.6), pegs=[floor], tol=1e-3, contact_step=1e-3)
    assert run.joints[..., 1].min() > -0.3 + RADIUS - 2e-4  # the goal for penetration
    lying = np.isclose(run.joints[-1, :, 1], -0.3 + RADIUS, atol=1e-4)
    assert lying.sum() >= 5
    # At rest the floor carries the load that the pin at the top does not: the weight less the tension there.
    up = run.contact_force[-20:, :, 1].sum(axis=1).mean()
    assert up + hf.rope_tension(run)[-20:, 0].mean() == pytest.approx(0.06 * 9.81, rel=0.02)


@pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
def test_a_rod_bounces_as_its_restitution_says(e):
    """A rod without weight swings against a wall at its end: it comes back with e times the rate."""
    rod = hf.Rope(length=[0.5], mass=[0.05], radius=RADIUS, gravity=(0.0, 0.0))
    wall = hf.Wall(0.3, -1.0, 0.3, 1.0, mu=0.0, restitution=e)
    at = math.asin((0.3 - RADIUS) / 0.5)
    run = hf.simulate(
        rod, duration=0.4, q0=[0.0], qd0=[4.0], pegs=[wall], t_eval=np.union1d(at / 4.0, np.linspace(0.0, 0.4, 41))
    )
    assert run.q.max() == pytest.approx(at, abs=1e-5)  # a gap that counts as touching is 1e-6 m
    assert run.qd[-1, 0] == pytest.approx(-4.0 * e, abs=5e-3)  # pushed out at a millimetre a second at most
    lost = 0.5 * (0.05 * 0.25 / 3.0 + 0.25 * 0.05 * RADIUS**2) * 16.0 * (1.0 - e * e)
    assert run.contact_loss[-1] == pytest.approx(lost, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(("rate", "back"), [(0.11, 0.0), (0.14, -0.07)])
def test_with_long_steps_what_closes_slowly_does_not_bounce(rate, back):
    """At 1 ms the limit is 50 mm/s; the rod's end closes at 44 and at 56 mm/s."""
    rod = hf.Rope(length=[0.5], mass=[0.05], radius=RADIUS, gravity=(0.0, 0.0))
    wall = hf.Wall(0.3, -1.0, 0.3, 1.0, mu=0.0, restitution=0.5)
    run = hf.simulate(rod, duration=7.0, q0=[0.0], qd0=[rate], pegs=[wall], contact_step=1e-3)
    assert run.qd[-1, 0] == pytest.approx(back, abs=5e-3)  # pushed out at a millimetre a second at most


def test_a_bouncing_rope_gains_no_energy():
    rope = hf.Rope.uniform(0.6, 0.06, 12, RADIUS, friction=1e-3)
    floor, peg = hf.Ground(0.0, -0.35, mu=0.4, restitution=0.8), hf.Peg(0.2, -0.2, 0.03, 0.4, restitution=0.8)
    run = hf.simulate(rope, duration=0.6, q0=np.full(12, 1.9), pegs=[floor, peg], refine=False)
    assert np.diff(run.contact_loss).min() > -1e-5
    assert run.energy_error.max() < 1e-5  # the goal for these joints
    assert run.attrs["contact_impacts"] > 5


def test_a_rope_hangs_over_the_end_of_a_wall():
    """The end of a wall is round, with the rope's radius: nothing passes through it, and it supports the rope."""
    rope = hf.Rope.uniform(0.6, 0.06, 30, RADIUS, friction=5e-3)
    wall = hf.Wall(0.15, -1.0, 0.15, -0.1, mu=0.3)
    run = hf.simulate(rope, duration=1.5, q0=np.full(30, 1.6), pegs=[wall], tol=1e-3, contact_step=1e-3)
    x, y = run.joints[-1].T
    k = int(np.argmax(x > 0.15))
    crossing = np.interp(0.15, x[k - 1 : k + 1], y[k - 1 : k + 1])
    assert -0.1 + RADIUS - 2e-4 < crossing < -0.1 + 2.0 * RADIUS  # it lies on the end
    below = y[k:] < -0.1
    assert below.sum() > 5
    assert x[k:][below].min() > 0.15 + RADIUS - 2e-4  # and from there on hangs on the far side
    assert run.attrs["contact_deepest"] < 2e-4


def test_a_rope_slides_to_and_fro_on_a_floor_without_friction():
    """The earlier direction of sliding has no effect: a few more steps than with almost no friction, and none
    unsolved."""
    rope, how = hf.Rope.uniform(0.6, 0.06, 15, RADIUS, friction=1e-3), {"q0": np.full(15, 1.6), "duration": 2.0}
    facts = []
    for mu in (0.0, 1e-9):
        run = hf.simulate(rope, pegs=[hf.Ground(0.0, -0.3, mu=mu)], tol=1e-3, contact_step=1e-3, **how)
        facts.append(run.attrs)
        sliding = run.tip_velocity[run.contact_force[:, -1, 1] > 0.0, 0]
        assert sliding.min() < -0.05 < 0.05 < sliding.max()
    assert facts[0]["contact_unsolved"] == 0.0
    assert facts[0]["contact_steps"] < 1.5 * facts[1]["contact_steps"]


def test_a_fast_rope_does_not_pass_a_wall():
    rod = hf.Rope(length=[1.0], mass=[0.05], radius=RADIUS, gravity=(0.0, 0.0))
    wall = hf.Wall(0.6, -0.9, 0.6, -0.5, mu=0.0)
    run = hf.simulate(rod, duration=0.1, q0=[0.0], qd0=[50.0], pegs=[wall])
    assert run.tip[:, 0].max() < 0.6


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: hf.Wall(0.0, 0.0, 0.0, 0.0), "ends of a wall coincide"),
        (lambda: hf.Wall(0.0, math.nan, 1.0, 0.0), "wall y is not finite"),
        (lambda: hf.Ground(0.0, 0.0, 0.0, 0.0), "vector out of the ground is zero"),
        (lambda: hf.Ground(0.0, 0.0, mu=-1.0), "ground mu has the wrong sign"),
        (lambda: hf.Peg(0.0, 0.0, 0.1, restitution=1.5), "peg restitution is too large"),
    ],
)
def test_bad_obstacles_are_refused(make, words):
    refuses(words, make)


def test_obstacles_survive_their_file():
    obstacles = [
        hf.Peg(0.5, 0.0, 0.02, 0.2, 0.1),
        hf.Wall(0.0, 1.0, 2.0, 3.0, 0.4, 0.5),
        hf.Ground(0.0, -1.0, 0.1, 0.9),
    ]
    setup = hf.Setup(hf.Rope.uniform(1.0, 0.1, 5, RADIUS, friction=0.0), pegs=obstacles)
    assert hf.Setup.loads(setup.dumps()).pegs == tuple(obstacles)
    refuses(r"table \[walls\] does not know this key: got 'x3'", hf.Setup.loads, setup.dumps().replace("x2", "x3"))
    ropes = hf.Setup(setup.rope).dumps()
    assert hf.Setup.loads(ropes + "[grounds]\nx = 0.0\ny = 1.0\n").pegs == (hf.Ground(0.0, 1.0),)  # one alone
    several = "[[grounds]]\nx = 0.0\ny = 1.0\n[[grounds]]\ny = 1.0\n"
    refuses(r"table 2 of \[\[grounds\]\] lacks x", hf.Setup.loads, ropes + several)
    listed = "[grounds]\nx = [0.0, 1.0]\ny = [1.0, 1.0]\n"
    refuses(r"x in the grounds table is a list.*of its own: \[\[grounds\]\]", hf.Setup.loads, ropes + listed)
