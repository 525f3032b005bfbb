"""The O(n) sweep and its neighbours against dense matrices, at every size and with everything switched on."""

import numpy as np
import pytest

from hyperflex.core.chain import articulated_body as kernels
from tests.core.helpers import chain_of, lost_power, sweep
from tests.reference import dense
from tests.reference.cases import random_grip, random_links, random_state

SIZES = [1, 2, 5, 50, 200]
# The goal of the project for every size. The sweep's own rounding grows with n, to some 1e-12 at n = 200; the reference
# solves its ill-conditioned matrix in extended precision, so its share is below that.
AGREEMENT = 1e-10


@pytest.mark.parametrize(("h", "stuck"), [(0.0, False), (1e-4, False), (0.01, False), (0.0, True), (0.01, True)])
@pytest.mark.parametrize("reaction", [1.0, 0.0], ids=["relative", "printed"])
@pytest.mark.parametrize("n", SIZES)
def test_accelerations_are_those_of_the_dense_reference(n, reaction, h, stuck):
    """Of a chain whose joints all slip, or of a constrained one, in which some are stuck."""
    for seed in range(3 if n < 200 else 1):
        links, state = random_links(n, seed, reaction=reaction, air=True), random_state(n, seed)
        grip = random_grip(n, seed) if stuck else None
        got = sweep(links, state, torque=0.03, h=h, grip=grip)
        want = dense.accelerations(links, *state, torque=0.03, h=h, grip=grip)
        scale, force = (float(np.abs(each).max()) for each in (want.alpha, want.force))
        np.testing.assert_allclose(got.alpha, want.alpha, rtol=0, atol=AGREEMENT * scale)
        np.testing.assert_allclose(got.force, want.force, rtol=0, atol=AGREEMENT * force)
        # The first joint's torque is a difference of terms of the size of friction and of the first link's moment; a
        # stuck one carries the moment of the whole chain: a sum of n forces of the size of m a l.
        moment = max(abs(float(want.torque)), scale * h * (links.viscous[0] + h * links.stiffness[0]))
        if grip is not None:
            parents = np.append(state.base[2], got.alpha[:-1])
            np.testing.assert_array_equal(got.alpha[grip == 0.0], parents[grip == 0.0])  # locked to the last bit
            moment = 1e-2 * scale * (np.sum(links.mass) + links.tip_mass) * np.sum(links.length) ** 2
        assert got.torque == pytest.approx(float(want.torque), abs=AGREEMENT * moment)


@pytest.mark.parametrize("n", SIZES)
def test_bare_chain_without_tip_mass_or_joint_torques(n):
    links, state = random_links(n, 7, joints=False, tip=False), random_state(n, 7)
    want = dense.accelerations(links, *state)
    got = sweep(links, state)
    np.testing.assert_allclose(got.alpha, want.alpha, rtol=0, atol=AGREEMENT * float(np.abs(want.alpha).max()))
    assert got.torque == 0.0  # nothing turns in a joint without friction or spring; exact


@pytest.mark.parametrize("field", ["viscous", "dry", "stiffness", "drag", "tip_mass", "gx", "gy"])
@pytest.mark.parametrize("h", [0.0, 0.01])
def test_each_term_alone(field, h):
    """One term at a time on a chain of five: two wrong terms cannot hide behind each other."""
    n = 5
    full, state = random_links(n, 11, air=True), random_state(n, 11)
    bare = random_links(n, 11, joints=False, tip=False)._replace(gx=0.0, gy=0.0)
    links = bare._replace(**{field: getattr(full, field), "rest": full.rest})
    want = dense.accelerations(links, *state, h=h)
    np.testing.assert_allclose(
        sweep(links, state, h=h).alpha, want.alpha, rtol=0, atol=AGREEMENT * float(np.abs(want.alpha).max())
    )


def test_the_papers_cable_at_rest_and_whirling():
    """The cable that the project is about: very light inertias (m l^2 / 12) make the worst-conditioned sweep."""
    n = 50
    one = np.ones(n)
    length, mass = 0.04, 2.5e-3
    links = dense.Links(
        length * one, mass * one, length / 2 * one, mass * (3 * 0.0025**2 + length**2) / 12 * one,
        5e-4 * one, 0 * one, 0 * one, 0 * one, 0 * one, np.inf * one, 0.0, 0.0, -9.81, 1.0,
    )  # fmt: skip
    for seed in range(3):
        state = random_state(n, seed)
        for h in (0.0, 0.01):
            want = dense.accelerations(links, *state, h=h)
            atol = AGREEMENT * float(np.abs(want.alpha).max())
            np.testing.assert_allclose(sweep(links, state, h=h).alpha, want.alpha, rtol=0, atol=atol)
    still = state._replace(q=np.zeros(n), w=np.zeros(n), base=np.zeros(7))
    at_rest = sweep(links, still)
    np.testing.assert_array_equal(at_rest.alpha, 0.0)  # hanging straight down is an equilibrium, exactly
    # The wall carries the weight: a sum of n terms, each rounded.
    np.testing.assert_allclose(at_rest.force, [0.0, n * mass * 9.81], rtol=1e-13, atol=0)


@pytest.mark.parametrize("n", SIZES)
def test_mass_matrix(n):
    links, state = random_links(n, 4), random_state(n, 4)
    out = np.full((n, n), np.nan)
    kernels.mass_matrix(chain_of(links), state.q, out)
    want = dense.mass_matrix(links, state.q)
    # Entries are sums of up to n positive terms times one cosine: n roundings of the largest entry at most.
    np.testing.assert_allclose(out, want, rtol=0, atol=1e-15 * (n + 4) * want.max())


@pytest.mark.parametrize("n", SIZES)
def test_energies(n):
    links, state = random_links(n, 6), random_state(n, 6)
    point, velocity, angle, rate = np.array([0.4, -1.1]), state.base[5:7], state.base[4], state.base[3]
    base = np.array([0.0, 0.0, 0.0, rate, angle, *velocity, *point])
    got = kernels.energies(chain_of(links), state.q, state.w, base, np.empty(2 * n))
    want = dense.energies(links, state.q, state.w, point, velocity, angle)
    # Sums over n links of positions that are sums themselves; the parts of the potential energy cancel in places.
    scale = abs(want[0]) + abs(want[1])
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-15 * (n + 10) * scale)


@pytest.mark.parametrize("reaction", [1.0, 0.0], ids=["relative", "printed"])
@pytest.mark.parametrize("n", SIZES)
def test_lost_power(n, reaction):
    links, state = random_links(n, 9, reaction=reaction, air=True), random_state(n, 9)
    got = lost_power(links, state)
    want = dense.dissipation(links, state.q, state.w, (state.base[4], state.base[3]), velocity=state.base[5:7])
    # A sum of n terms; with printed friction they differ in sign, so the sum of sizes sets the rounding.
    sizes = np.abs(dense.joints(links, state.q, state.w, (state.base[4], state.base[3])).friction)
    scale = float(sizes @ (np.abs(state.w) + np.abs(np.append(state.base[3], state.w[:-1])))) + want
    assert got == pytest.approx(want, abs=1e-15 * (n + 10) * scale)


def test_relative_friction_and_air_never_give_energy():
    for seed in range(20):
        links, state = random_links(6, seed, air=True), random_state(6, seed)
        assert lost_power(links, state) > 0.0


def test_sine_and_cosine_against_extended_precision():
    """As written 1.5e-16 for |x| < 1e6; the compiler's leave to contract and to use reciprocals makes it 2.5e-16."""
    rng = np.random.default_rng(0)
    near = np.concatenate([k * np.pi / 4 + rng.normal(0.0, 1e-9, 5) for k in range(-40, 41)])
    x = np.concatenate([near, rng.uniform(-10, 10, 2000), rng.uniform(-1e6, 1e6, 2000), [0.0, -0.0, 1e-300, 1e-9]])
    exact = np.longdouble(x)
    if np.finfo(np.longdouble).eps > 1e-18:
        exact = x  # a platform without 80 bit numbers compares with libm, right to half a unit in the last place
    got = np.array([kernels.sincos(float(value)) for value in x])
    assert np.abs(got[:, 0] - np.sin(exact)).max() < 3e-16
    assert np.abs(got[:, 1] - np.cos(exact)).max() < 3e-16
