"""Kernels of the motion out of the plane, against a chain in space by virtual work."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.core.chain.sideways import ROWS, planar_loads, side_accelerations
from tests.reference.arm import links_of
from tests.reference.sideways import unbalanced


def rope_of(n, rng):
    length = rng.uniform(0.1, 0.2, n)
    return hf.Rope(
        length=length,
        mass=rng.uniform(0.01, 0.03, n),
        com=rng.uniform(0.3, 0.7, n) * length,
        inertia=rng.uniform(1e-5, 1e-4, n),
        friction=rng.uniform(0.5, 2.0, n) * 1e-3,
        stiffness=rng.uniform(0.0, 0.02, n),
        rest_angle=rng.uniform(-0.2, 0.2, n),
        drag=rng.uniform(0.0, 0.02, n),
        tip_mass=0.02,
        gravity=(1.0, -9.0),
    )


def accelerations(rope, planar, base, x, v, h=0.0, guess=None):
    """Accelerations (n,) of the angles x at rates v."""
    chain, n = rope.chain(), x.size
    at = np.zeros((ROWS, n))
    out = np.zeros(n) if guess is None else guess.copy()
    planar_loads(chain, *planar, base, (0.0, 0.0), max(h, 1e-30), at)
    side_accelerations(chain, at, x, v, np.zeros((2, n)), out, np.zeros((3, n)))
    return out


def drawn(n, seed):
    """A rope, its planar motion, that of its first joint, and a small motion out of the plane."""
    rng = np.random.default_rng(seed)
    planar = rng.uniform(-1.0, 1.0, n).cumsum(), rng.uniform(-6, 6, n), rng.uniform(-40, 40, n)
    base = np.array([*rng.uniform(-5, 5, 4), rng.uniform(-2, 2), *rng.uniform(-1, 1, 2), 0.0, 0.0])
    return rope_of(n, rng), planar, base, *(1e-4 * rng.uniform(-1, 1, (2, n)) * [[1.0], [5.0]])


@pytest.mark.parametrize("n", [1, 2, 6])
def test_accelerations_leave_no_work_undone(n):
    rope, planar, base, x, v = drawn(n, n)
    found = accelerations(rope, planar, base, x, v)
    left, size = (unbalanced(links_of(rope), planar, base, (x, v, each)) for each in (found, 0.0 * found))
    # differences err by 1e-6, and what is linear by the square of 1e-4 rad
    np.testing.assert_allclose(left, 0.0, atol=3e-5 * np.abs(size).max())


@pytest.mark.parametrize(("friction", "bend"), [(1.0, 1.0), (1000.0, 2.5)])
def test_an_implicit_step_is_one_of_the_loads_at_its_end(friction, bend):
    """With the exact acceleration as a guess, a step changes nothing; from another it comes near it at once.

    Joints that bend by up to 2 rad resist with their own cosines: with those of a straight rope, steps lead away.
    """
    rope, (q, w, planar), base, x, v = drawn(6, 3)
    rope, planar = rope.replace(friction=friction * rope.friction), (bend * q, w, planar)
    h, a = 0.02, np.zeros_like(x)
    for _ in range(15):
        a = accelerations(rope, planar, base, x + h * v + h * h * a, v + h * a, h, a)
    at_end = accelerations(rope, planar, base, x + h * v + h * h * a, v + h * a)
    np.testing.assert_allclose(a, at_end, rtol=1e-6, atol=1e-7 * np.abs(a).max())
