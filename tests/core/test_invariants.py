"""What must hold whatever the chain and the state: symmetries, power balance, cuts, a positive definite mass matrix."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperflex.core.chain import articulated_body as kernels
from tests.core.helpers import EXAMPLES, chain_of, lost_power, sweep
from tests.reference import dense
from tests.reference.cases import State, random_links, random_state
from tests.reference.dense import Links, Real

# Both sides of each comparison are sweeps over at most 30 links, right to some 1e-14 of the largest acceleration each
# (measured against the dense reference); a hundred times that leaves room for the worst draw.
SAME = 1e-12

cases = st.tuples(st.integers(1, 30), st.integers(0, 10**6), st.sampled_from([1.0, 0.0]))
steps = st.sampled_from([0.0, 1e-3, 0.05])


def drawn(case: tuple[int, int, float], *, air: bool = False) -> tuple[Links, State]:
    n, seed, reaction = case
    return random_links(n, seed, reaction=reaction, air=air), random_state(n, seed)


def assert_same(got: Real, want: Real, among: Real | None = None) -> None:
    scale = float(np.abs(want if among is None else among).max())
    np.testing.assert_allclose(got, want, rtol=0, atol=SAME * scale)


@given(cases)
@settings(max_examples=EXAMPLES)
def test_the_mass_matrix_is_symmetric_and_positive_definite(case):
    links, state = drawn(case)
    n = len(state.q)
    matrix = np.full((n, n), np.nan)
    kernels.mass_matrix(chain_of(links), state.q, matrix)
    np.testing.assert_array_equal(matrix, matrix.T)
    np.linalg.cholesky(matrix)  # raises where it is not positive definite
    # The sweep and the matrix are two readings of one thing: a torque on link 0 alone answers with M^-1's first column.
    column = sweep(links, state, torque=1.0).alpha - sweep(links, state, torque=0.0).alpha
    push = matrix @ column
    push[0] -= 1.0
    # Rounding of the two accelerations, seen through the matrix.
    noise = SAME * np.abs(matrix).sum(axis=1).max() * max(np.abs(sweep(links, state, torque=1.0).alpha).max(), 1.0)
    assert np.abs(push).max() <= noise


@given(cases, st.floats(-1.0, 1.0))
@settings(max_examples=EXAMPLES)
def test_power_balance_at_a_state(case, torque):
    """Rate of change of the energy = power of the base and of the torque, less what friction takes; both readings."""
    links, state = drawn(case, air=True)
    got = sweep(links, state, torque)
    velocity, rate = state.base[5:7], state.base[3]
    inward = got.force @ velocity + got.torque * rate + torque * state.w[0]
    lost = lost_power(links, state)
    terms = np.abs([*(got.force * velocity), got.torque * rate, torque * state.w[0], lost])
    # The energy's derivative sums terms that may cancel: n of them, each of the size of m v a.
    moving = np.sum(links.mass) * np.abs(got.alpha).max() * np.sum(links.length) ** 2 * np.abs(state.w).max()
    assert energy_rate(links, state, got.alpha) == pytest.approx(inward - lost, abs=SAME * (terms.sum() + moving))


def energy_rate(links: Links, state: State, alpha: Real) -> float:
    """Derivative of the reference's energy along the motion, by a complex step (no truncation error)."""
    t = 1e-30j
    base = state.base
    kinetic, potential = dense.energies(
        links,
        state.q + state.w * t,
        state.w + alpha * t,
        base[5:7] * t,
        base[5:7] + base[:2] * t,
        base[4] + base[3] * t,
    )
    return float((kinetic + potential).imag / 1e-30)


@given(cases, steps, st.floats(-7.0, 7.0))
@settings(max_examples=EXAMPLES)
def test_turning_everything_turns_only_the_force(case, h, turn):
    links, state = drawn(case)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    base = state.base.copy()
    base[:2], base[5:7] = rotation @ base[:2], rotation @ base[5:7]
    base[4] += turn
    gx, gy = rotation @ [links.gx, links.gy]
    got = sweep(links._replace(gx=float(gx), gy=float(gy)), State(state.q + turn, state.w, base), 0.1, h)
    want = sweep(links, state, 0.1, h)
    # The turned angles are rounded to 1e-15, which large accelerations feel: a factor of the centrifugal terms.
    assert_same(got.alpha, want.alpha)
    assert_same(got.force, rotation @ want.force, among=want.force)


@given(cases, steps)
@settings(max_examples=EXAMPLES)
def test_mirrored_left_to_right(case, h):
    links, state = drawn(case)
    mirror = np.array([-1.0, 1.0, -1.0, -1.0, -1.0, -1.0, 1.0])
    mirrored = links._replace(gx=-links.gx, rest=-links.rest)
    got = sweep(mirrored, State(-state.q, -state.w, state.base * mirror), -0.1, h)
    want = sweep(links, state, 0.1, h)
    assert_same(got.alpha, -want.alpha)
    assert_same(got.force, want.force * [-1.0, 1.0], among=want.force)


@given(cases)
@settings(max_examples=EXAMPLES)
def test_without_friction_time_runs_both_ways(case):
    links, state = drawn(case)
    links = links._replace(viscous=0 * links.viscous, dry=0 * links.dry)
    backward = state.base * np.array([1.0, 1.0, 1.0, -1.0, 1.0, -1.0, -1.0])
    got, want = sweep(links, State(state.q, -state.w, backward), 0.1), sweep(links, state, 0.1)
    np.testing.assert_array_equal(got.alpha, want.alpha)  # rates enter as squares only: the same arithmetic


@given(cases.filter(lambda case: case[0] > 1), steps)
@settings(max_examples=EXAMPLES)
def test_the_outer_part_of_a_cut_chain_moves_as_before(case, h):
    """Cut at a joint and lead the outer part along the path that the joint had: nothing beyond the cut changes."""
    links, state = drawn(case)
    n = len(state.q)
    whole = sweep(links, state, 0.1, h)
    cut = n // 2
    along, across = dense.directions(state.q[:cut])
    reach = links.length[:cut]
    accel = state.base[:2] + (reach * whole.alpha[:cut]) @ across - (reach * state.w[:cut] ** 2) @ along
    velocity = state.base[5:7] + (reach * state.w[:cut]) @ across
    base = np.array([*accel, whole.alpha[cut - 1], state.w[cut - 1], state.q[cut - 1], *velocity])
    part = sweep(tail(links, cut), State(state.q[cut:], state.w[cut:], base), 0.0, h)
    # The path of the cut sums up to 15 accelerations, whose rounding the lighter outer links feel in full.
    np.testing.assert_allclose(part.alpha, whole.alpha[cut:], rtol=0, atol=10 * SAME * np.abs(whole.alpha).max())


def tail(links: Links, cut: int) -> Links:
    arrays = {name: value[cut:] for name, value in links._asdict().items() if isinstance(value, np.ndarray)}
    return links._replace(**arrays)


@given(cases, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
@settings(max_examples=EXAMPLES)
def test_a_moving_frame_feels_no_speed_and_takes_acceleration_for_gravity(case, x, y):
    links, state = drawn(case)
    want = sweep(links, state)
    base = state.base + np.array([x, y, 0.0, 0.0, 0.0, 3 * x, y])
    got = sweep(links._replace(gx=links.gx + x, gy=links.gy + y), state._replace(base=base))
    assert_same(got.alpha, want.alpha, among=np.append(want.alpha, 10.0 / links.length.min()))
    assert_same(got.force, want.force, among=np.append(want.force, links.mass.sum() + links.tip_mass))


@given(cases, steps, st.tuples(*[st.floats(0.2, 5.0)] * 3))
@settings(max_examples=EXAMPLES)
def test_other_units_give_the_same_motion(case, h, units):
    """Metres, kilogrammes and seconds may be changed: every term must have the dimension that it claims."""
    links, state = drawn(case)
    metre, kilo, second = units
    torque_unit = kilo * metre**2 / second**2
    scaled: dict[str, Any] = {
        "length": links.length * metre,
        "com": links.com * metre,
        "mass": links.mass * kilo,
        "tip_mass": links.tip_mass * kilo,
        "inertia": links.inertia * kilo * metre**2,
        "viscous": links.viscous * torque_unit * second,
        "dry": links.dry * torque_unit,
        "stiffness": links.stiffness * torque_unit,
        "gx": links.gx * metre / second**2,
        "gy": links.gy * metre / second**2,
    }
    base = state.base / np.array([second**2 / metre] * 2 + [second**2, second, 1.0] + [second / metre] * 2)
    other = State(state.q, state.w / second, base)
    got = sweep(links._replace(**scaled), other, 0.1 * torque_unit, h * second)
    want = sweep(links, state, 0.1, h)
    assert_same(got.alpha * second**2, want.alpha)
    assert_same(got.force * second**2 / kilo / metre, want.force)


@given(st.integers(0, 10**6), steps)
@settings(max_examples=EXAMPLES)
def test_one_link_cannot_tell_the_friction_readings_apart(seed, h):
    links, state = random_links(1, seed), random_state(1, seed)
    got, want = (sweep(links._replace(reaction=reaction), state, 0.1, h) for reaction in (0.0, 1.0))
    # The same arithmetic in separate kernels: the compiler may fuse other products and sums. Where terms of about
    # 1 cancel, their rounding is left.
    np.testing.assert_allclose(got.alpha, want.alpha, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(got.force, want.force, rtol=0, atol=1e-13 * np.abs(want.force).max())
