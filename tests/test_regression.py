"""Regression (4)-(6): least squares of J and eta on the equation of motion, refusals."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.paper.regression import least_squares, regression
from tests.refusals import refuses

N = 4


def rough_rope(friction_model: str = "relative") -> hf.Rope:
    """A rope in which all numbers differ, but for J and eta."""
    rng = np.random.default_rng(4)
    return hf.Rope(
        length=rng.uniform(0.1, 0.3, N),
        mass=rng.uniform(0.01, 0.1, N),
        com=rng.uniform(0.02, 0.2, N),
        inertia=3e-4,
        friction=5e-4,
        dry_friction=rng.uniform(1e-4, 1e-3, N),
        stiffness=rng.uniform(1e-3, 1e-2, N),
        rest_angle=rng.uniform(-0.3, 0.3, N),
        tip_mass=0.02,
        gravity=(1.0, -9.0),
        friction_model=friction_model,
    )


@pytest.mark.parametrize("friction_model", ["relative", "printed"])
def test_least_squares_find_what_made_the_motion(friction_model):
    made = hf.Rope.uniform(1.0, 0.01, N, inertia=2e-6, friction=5e-4, friction_model=friction_model)
    for rope in (made, rough_rope(friction_model).replace(dry_friction=0.0)):
        run = hf.simulate(rope, duration=3.0, q0=rope.hanging_angle + np.linspace(0.3, 0.9, N), tol=1e-9)
        uneven = np.linspace(1.0, 2.0, N)  # of what is sought, the given values do not count
        found = hf.fit_regression(rope.replace(inertia=9e-6 * uneven, friction=uneven), run.q, run.qd, run.qdd)
        # The simulation's accelerations fulfil (1) at its states to rounding; J's torque is 1e-3 of the others.
        assert found.inertia == pytest.approx(rope.inertia[0], rel=1e-7)
        assert found.friction == pytest.approx(5e-4, rel=1e-7)


def test_dry_friction_acts_against_the_rate_of_each_joint():
    """Samples of no motion at all: the equation holds torques, whatever moves."""
    rope = rough_rope()
    q, qd, qdd = np.random.default_rng(5).normal(size=(3, 7, N))
    _, rough = regression(rope, q, qd, qdd)
    _, smooth = regression(rope.replace(dry_friction=0.0), q, qd, qdd)
    friction = rope.dry_friction * np.sign(np.diff(qd, prepend=0.0))
    np.testing.assert_allclose(smooth - rough, friction - np.pad(friction[:, 1:], ((0, 0), (0, 1))), rtol=1e-9)


def test_standard_deviations_are_those_of_repeated_noise():
    rope = hf.Rope.uniform(1.0, 0.01, N, inertia=2e-5, friction=5e-4)
    run = hf.simulate(rope, duration=3.0, q0=np.linspace(0.3, 0.9, N), tol=1e-9)
    columns, known = regression(rope, run.q, run.qd, run.qdd)
    rng = np.random.default_rng(1)
    draws = [least_squares(columns, known + 1e-4 * rng.standard_normal(known.shape)) for _ in range(400)]
    spread = np.std([(each.inertia, each.friction) for each in draws], axis=0)
    # A standard deviation from 400 draws is known within 3.5 % (one sigma).
    np.testing.assert_allclose(list(draws[0].std.values()), spread, rtol=0.14)


def test_samples_with_gaps_are_omitted():
    rope = hf.Rope.uniform(1.0, 0.01, N, inertia=2e-6, friction=5e-4)
    run = hf.simulate(rope, duration=3.0, q0=np.linspace(0.3, 0.9, N), tol=1e-9)
    q, known = run.q.copy(), np.delete(np.arange(run.t.size), slice(10, 20))
    q[10:20, 1] = np.nan
    found = hf.fit_regression(rope, q, run.qd, run.qdd)
    assert found == hf.fit_regression(rope, run.q[known], run.qd[known], run.qdd[known])
    assert found.friction == pytest.approx(5e-4, rel=1e-8)


def test_what_the_samples_do_not_determine_is_refused():
    """Unknowns that act alike, a common factor of both, and fewer equations than unknowns."""
    q, qd, qdd = np.random.default_rng(5).normal(size=(3, 7, N))
    rod = hf.Rope(length=[0.2], mass=[0.1], friction=1e-3)
    light = hf.Rope(length=[0.2], mass=[0.0], inertia=1e-3)
    first = (each[:, :1] for each in (q, qd, qdd))
    for rope, given, message in (
        (rough_rope(), (q, 0.0 * qd, qdd), "act alike, or one not at all"),
        (light, first, "common factor"),
        (rod, (q[:1, :1], qd[:1, :1], qdd[:1, :1]), "too few samples"),
        (rough_rope(), (np.nan * q, qd, qdd), "too few samples"),
    ):
        refuses(message, hf.fit_regression, rope, *given)
