"""Equations (1)-(3): mass matrix, bias and partial linearisation of arm and rope, against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.dynamics import bias, input_from_torque, mass_matrix, partial_linearization, torque_from_input
from hyperflex.errors import InvalidInput
from tests.reference import dense
from tests.reference.arm import links_of
from tests.reference.dense import Links

ARM = hf.Arm(length=0.105, inertia=1e-3, mass=0.2, com=0.04, friction=2e-3, dry_friction=5e-3)
N = 6
# Two ways through 7 x 7 matrices with condition numbers of some hundreds.
SAME = 1e-11


def rope(friction_model: str = "relative") -> hf.Rope:
    grow = np.linspace(1.0, 1.5, N)
    return hf.Rope(
        length=0.1 * grow,
        mass=0.02 / grow,
        com=0.04 * grow,
        friction=1e-3 * grow,
        dry_friction=1e-3 / grow,
        stiffness=0.02 * grow,
        rest_angle=0.1 * grow,
        tip_mass=0.01,
        gravity=(0.7, -9.6),
        friction_model=friction_model,
    )


def with_arm(rope: hf.Rope) -> Links:
    """Arm and rope as one chain of the reference; the arm hangs from the wall and has no spring."""
    own = {
        "length": ARM.length,
        "mass": ARM.mass,
        "com": ARM.com,
        "inertia": ARM.inertia,
        "viscous": ARM.friction,
        "dry": ARM.dry_friction,
        "stiffness": 0.0,
        "rest": 0.0,
    }
    links = links_of(rope)
    return links._replace(**{name: np.append(value, getattr(links, name)) for name, value in own.items()})


def state(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles and rates (7,), the arm's first."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 3, N + 1), rng.uniform(-5, 5, N + 1)


both = pytest.mark.parametrize("friction_model", ["relative", "printed"])
seeds = pytest.mark.parametrize("seed", range(3))


@seeds
def test_mass_matrix_of_arm_and_rope(seed: int) -> None:
    q, _ = state(seed)
    want = dense.mass_matrix(with_arm(rope()), q)
    got = mass_matrix(rope(), q[1:], arm=ARM, arm_angle=q[0])
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-14 * want.max())
    alone = mass_matrix(rope(), q[1:])
    np.testing.assert_allclose(alone, want[1:, 1:], rtol=0, atol=1e-14 * want.max())


@both
@seeds
def test_bias_is_what_the_accelerations_owe_to(seed: int, friction_model: str) -> None:
    q, w = state(seed)
    links = with_arm(rope(friction_model))
    free = np.asarray(dense.accelerations(links, q, w, np.zeros(7)).alpha, float)
    want = -dense.mass_matrix(links, q) @ free
    got = bias(rope(friction_model), q[1:], w[1:], arm=ARM, arm_angle=q[0], arm_rate=w[0])
    np.testing.assert_allclose(got, want, rtol=0, atol=SAME * np.abs(want).max())


@both
@seeds
def test_bias_of_a_rope_alone_hangs_on_a_wall(seed: int, friction_model: str) -> None:
    q, w = state(seed)
    links = links_of(rope(friction_model))
    free = np.asarray(dense.accelerations(links, q[1:], w[1:], np.zeros(7)).alpha, float)
    want = -dense.mass_matrix(links, q[1:]) @ free
    np.testing.assert_allclose(bias(rope(friction_model), q[1:], w[1:]), want, rtol=0, atol=SAME * np.abs(want).max())


@both
@seeds
def test_equations_2_and_3_are_the_partitioned_equation_1(seed: int, friction_model: str) -> None:
    """Form A_u, B_u and the rest from the reference's M and bias, as the paper writes them."""
    q, w = state(seed)
    links = with_arm(rope(friction_model))
    matrix = dense.mass_matrix(links, q)
    loads = -matrix @ np.asarray(dense.accelerations(links, q, w, np.zeros(7)).alpha, float)
    a_u = -np.linalg.solve(matrix[1:, 1:], loads[1:])
    b_u = -np.linalg.solve(matrix[1:, 1:], matrix[1:, 0])
    got = partial_linearization(rope(friction_model), ARM, q[1:], w[1:], q[0], w[0])
    np.testing.assert_allclose(got.a_u, a_u, rtol=0, atol=SAME * np.abs(a_u).max())
    np.testing.assert_allclose(got.b_u, b_u, rtol=0, atol=SAME * np.abs(a_u).max())  # a difference of two sweeps
    assert got.effective_inertia == pytest.approx(matrix[0, 0] + matrix[0, 1:] @ b_u, rel=1e-9)
    assert got.arm_bias == pytest.approx(loads[0] + matrix[0, 1:] @ a_u, rel=1e-9)


@both
@seeds
def test_the_arm_obeys_the_input(seed: int, friction_model: str) -> None:
    """C1, at a state: tau from u, put on the whole chain, gives the arm the acceleration u and the rope A_u + B_u u."""
    q, w = state(seed)
    linear = partial_linearization(rope(friction_model), ARM, q[1:], w[1:], q[0], w[0])
    u = 37.0
    tau = torque_from_input(linear, u)
    answer = np.asarray(dense.accelerations(with_arm(rope(friction_model)), q, w, np.zeros(7), torque=tau).alpha, float)
    np.testing.assert_allclose(
        answer, np.append(u, linear.a_u + linear.b_u * u), rtol=0, atol=1e-10 * abs(answer).max()
    )
    assert input_from_torque(linear, tau) == pytest.approx(u, rel=1e-13)


def test_the_torque_of_a_led_arm_is_that_of_equation_3() -> None:
    """`motor_torque` of a run counts all of the arm: inertia, weight, viscous and dry friction."""
    motion = hf.swings(0.4, 0.3)
    t = np.array([0.05, 0.15, 0.3, 0.55])
    run = hf.simulate(rope(), motion, arm=ARM, duration=0.6, t_eval=t)
    for k in range(t.size):
        linear = partial_linearization(rope(), ARM, run.q[k], run.qd[k], run.arm_angle[k], run.arm_rate[k])
        want = torque_from_input(linear, float(motion.acceleration(t[k])))
        assert run.motor_torque[k] == pytest.approx(want, rel=1e-9)


def test_bad_arguments_are_named() -> None:
    for call, word in (
        (lambda: mass_matrix(rope(), np.zeros(5)), "q has the wrong shape"),
        (lambda: bias(rope(), np.zeros(N), np.full(N, np.nan)), r"qd\[0\]"),
        (lambda: partial_linearization(rope(), ARM, np.zeros(N), np.zeros(N), np.inf, 0.0), "arm_angle"),
        (lambda: mass_matrix(rope(), np.zeros(N), arm=ARM, arm_angle=np.nan), "arm"),
    ):
        with pytest.raises(InvalidInput, match=word):
            call()
