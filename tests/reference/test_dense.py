"""The dense reference against Lagrange's equations and against what can be worked out by hand."""

import numpy as np
import pytest

from tests.reference import dense
from tests.reference.cases import random_links, random_state
from tests.reference.lagrange import friction_force, residual

# Rounding of some hundred operations on terms that cancel: 1e-16 * 1e3, with a margin of ten.
ROUNDING = 1e-12


@pytest.mark.parametrize("n", [1, 2, 3, 6])
@pytest.mark.parametrize("seed", range(4))
def test_the_dense_accelerations_satisfy_lagranges_equations(n, seed):
    links, state = random_links(n, seed), random_state(n, seed)
    answer = dense.accelerations(links, *state, torque=0.02)
    left, force = residual(links, state.q, state.w, np.asarray(answer.alpha, float), state.base)
    forces = friction_force(links, state.w, state.base[3])
    forces[0] += 0.02
    scale = np.abs(dense.mass_matrix(links, state.q)).max() * np.abs(answer.alpha).max()
    np.testing.assert_allclose(left, forces, rtol=0, atol=float(ROUNDING * scale))
    np.testing.assert_allclose(force, np.asarray(answer.force, float), rtol=0, atol=ROUNDING * np.abs(force).max())


@pytest.mark.parametrize("n", [1, 2, 5])
def test_printed_friction_acts_on_the_outer_link_only(n):
    links, state = random_links(n, 3, reaction=0.0), random_state(n, 3)
    answer = dense.accelerations(links, *state)
    left, _ = residual(links, state.q, state.w, np.asarray(answer.alpha, float), state.base)
    slip = np.diff(state.w, prepend=state.base[3])
    printed = -links.viscous * slip - links.dry * np.sign(slip)
    scale = np.abs(dense.mass_matrix(links, state.q)).max() * np.abs(answer.alpha).max()
    np.testing.assert_allclose(left, printed, rtol=0, atol=float(ROUNDING * scale))


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("reaction", [0.0, 1.0])
def test_the_implicit_answer_is_the_explicit_one_under_the_torques_at_the_end_of_the_step(n, reaction):
    """Viscous friction and springs are linear, so the implicit joints are exact: feed the end state to the torques."""
    h = 0.01
    links, state = random_links(n, 5, reaction=reaction)._replace(dry=np.zeros(n)), random_state(n, 5)
    implicit = dense.accelerations(links, *state, h=h)
    alpha = np.asarray(implicit.alpha, float)
    w_end = state.w + h * alpha
    parent_rate = state.base[3] + h * state.base[2]
    end = dense.joints(links, state.q + h * w_end, w_end, (state.base[4] + h * parent_rate, parent_rate))
    forces = end.friction_work @ end.friction + end.spring_work @ end.spring
    left, _ = residual(links, state.q, state.w, alpha, state.base)
    # `residual` holds the springs at the start of the step; take them out there and put them in at the end.
    start = dense.joints(links, state.q, state.w, (state.base[4], state.base[3]))
    left = left + start.spring_work @ start.spring
    scale = np.abs(forces).max() + np.abs(left).max()
    np.testing.assert_allclose(left, forces, rtol=0, atol=ROUNDING * scale)
    assert float(implicit.torque) == pytest.approx(reaction * end.friction[0] + end.spring[0], abs=ROUNDING * scale)


@pytest.mark.parametrize("reaction", [0.0, 1.0])
def test_locked_joints_are_a_chain_with_fewer_links(reaction):
    """Lock joint 1 of three: links 0 and 1 are one body. Its parameters, worked out by hand, give the same motion."""
    links, state = random_links(3, 4, reaction=reaction), random_state(3, 4)
    links = links._replace(stiffness=np.zeros(3))
    q = np.array([0.4, 0.4, state.q[2]])  # in line, so that the body's centre lies on it
    w = np.array([1.1, 1.1, state.w[2]])
    answer = dense.accelerations(links, q, w, state.base, torque=0.02, grip=np.array([1.0, 0.0, -1.0]))
    mass = links.mass[0] + links.mass[1]
    far = links.length[0] + links.com[1]
    com = (links.mass[0] * links.com[0] + links.mass[1] * far) / mass
    inertia = links.inertia[0] + links.inertia[1]
    inertia += links.mass[0] * (links.com[0] - com) ** 2 + links.mass[1] * (far - com) ** 2
    rigid = links._replace(
        length=np.array([links.length[0] + links.length[1], links.length[2]]),
        mass=np.array([mass, links.mass[2]]),
        com=np.array([com, links.com[2]]),
        inertia=np.array([inertia, links.inertia[2]]),
        **{name: getattr(links, name)[[0, 2]] for name in ("viscous", "dry", "stiffness", "rest")},
    )
    want = dense.accelerations(rigid, q[[0, 2]], w[[0, 2]], state.base, torque=0.02, grip=np.array([1.0, -1.0]))
    scale = float(np.abs(want.alpha).max())
    if reaction == 1.0:
        np.testing.assert_allclose(answer.alpha, want.alpha[[0, 0, 1]], rtol=0, atol=ROUNDING * scale)
        np.testing.assert_allclose(answer.force, want.force, rtol=0, atol=ROUNDING * np.abs(want.force).max())
    else:  # as printed, link 0 does not feel what holds link 1: it moves as if its friction were all that acts
        assert float(answer.alpha[1] - answer.alpha[0]) == pytest.approx(0.0, abs=ROUNDING * scale)
        left, _ = residual(links, q, w, np.asarray(answer.alpha, float), state.base)
        slip = w - np.array([state.base[3], w[0], w[1]])
        torques = -links.viscous * slip - links.dry * np.array([1.0, 0.0, -1.0]) + np.asarray(answer.held, float)
        torques[0] += 0.02
        size = np.abs(dense.mass_matrix(links, q)).max() * np.abs(answer.alpha).max()
        np.testing.assert_allclose(left, torques, rtol=0, atol=float(ROUNDING * size))


def test_one_link_is_the_textbook_pendulum():
    links = random_links(1, 2, joints=False)._replace(gx=0.0)
    q = np.array([0.7])
    alpha = dense.accelerations(links, q, np.array([1.3]), np.zeros(7)).alpha
    mass, length, com, tip = links.mass[0], links.length[0], links.com[0], links.tip_mass
    about_pivot = links.inertia[0] + mass * com**2 + tip * length**2
    assert float(alpha[0]) == pytest.approx(-9.81 * (mass * com + tip * length) * np.sin(0.7) / about_pivot, rel=1e-14)


def test_refined_solve_keeps_the_digits_of_an_ill_conditioned_matrix():
    if np.finfo(np.longdouble).eps > 1e-18:
        pytest.skip("this platform's long double is a double")
    links, state = random_links(200, 1), random_state(200, 1)
    matrix = dense.mass_matrix(links, state.q, np.longdouble)
    wanted = np.asarray(np.random.default_rng(0).normal(size=200), np.longdouble)
    # Long double carries 1e-19; times a condition number of some 1e7 that leaves 1e-12 to spare for the 1e-10 tests.
    assert np.abs(dense.solve(matrix, matrix @ wanted) - wanted).max() < 1e-11
