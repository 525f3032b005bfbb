"""Equations (1)-(3): mass matrix, bias and partial linearisation of arm and rope, against dense algebra."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.dynamics import bias, input_from_torque, mass_matrix, partial_linearization, torque_from_input
from tests.reference import dense
from tests.reference.arm import Stretch, links_of
from tests.reference.dense import Links
from tests.refusals import refuses

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
    own = {"length": ARM.length, "mass": ARM.mass, "com": ARM.com, "inertia": ARM.inertia}
    own |= {"viscous": ARM.friction, "dry": ARM.dry_friction, "stiffness": 0.0, "rest": 0.0}
    links = links_of(rope)
    return links._replace(**{name: np.append(value, getattr(links, name)) for name, value in own.items()})


def state(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Angles and rates (7,), the arm's first."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 3, N + 1), rng.uniform(-5, 5, N + 1)


both = pytest.mark.parametrize("friction_model", ["relative", "printed"])
seeds = pytest.mark.parametrize("seed", range(3))


@seeds
def test_mass_matrix_of_arm_and_rope(seed):
    q, _ = state(seed)
    want = dense.mass_matrix(with_arm(rope()), q)
    got = mass_matrix(rope(), q[1:], arm=ARM, arm_angle=q[0])
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-14 * want.max())
    alone = mass_matrix(rope(), q[1:])
    np.testing.assert_allclose(alone, want[1:, 1:], rtol=0, atol=1e-14 * want.max())


@both
@seeds
def test_bias_is_what_the_accelerations_owe_to(seed, friction_model):
    """Arm and rope, and a rope alone on a wall."""
    (q, w), cable = state(seed), rope(friction_model)
    whole = bias(cable, q[1:], w[1:], arm=ARM, arm_angle=q[0], arm_rate=w[0])
    for links, first, got in ((with_arm(cable), 0, whole), (links_of(cable), 1, bias(cable, q[1:], w[1:]))):
        free = np.asarray(dense.accelerations(links, q[first:], w[first:], np.zeros(7)).alpha, float)
        want = -dense.mass_matrix(links, q[first:]) @ free
        np.testing.assert_allclose(got, want, rtol=0, atol=SAME * np.abs(want).max())


@both
@seeds
def test_equations_2_and_3_are_the_partitioned_equation_1(seed, friction_model):
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


def test_the_torque_of_a_led_arm_is_that_of_equation_3():
    """`motor_torque` of a run counts all of the arm: inertia, weight, viscous and dry friction."""
    motion = hf.arm_swings(0.4, 0.3)
    t = np.array([0.05, 0.15, 0.3, 0.55])
    run = hf.simulate(rope(), motion, arm=ARM, duration=0.6, t_eval=t)
    for k in range(t.size):
        linear = partial_linearization(rope(), ARM, run.q[k], run.qd[k], run.arm_angle[k], run.arm_rate[k])
        want = torque_from_input(linear, float(motion.acceleration(t[k])))
        assert run.motor_torque[k] == pytest.approx(want, rel=1e-9)
        assert input_from_torque(linear, want) == pytest.approx(float(motion.acceleration(t[k])), rel=1e-12)


def test_bad_arguments_are_named():
    for call, word in (
        (lambda: mass_matrix(rope(), np.zeros(5)), "q has the wrong shape"),
        (lambda: bias(rope(), np.zeros(N), np.full(N, np.nan)), r"qd\[0\]"),
        (lambda: partial_linearization(rope(), ARM, np.zeros(N), np.zeros(N), np.inf, 0.0), "arm_angle"),
        (lambda: mass_matrix(rope(), np.zeros(N), arm=ARM, arm_angle=np.nan), "arm"),
    ):
        refuses(word, call)


def slopes(command: str, friction_model: str, x: np.ndarray, u: float) -> np.ndarray:
    """Accelerations (n + 1,) of arm and rope by dense algebra in long doubles; x: arm angle, q, arm rate, qd."""
    cable, n = rope(friction_model), N
    if command == "torque":
        return dense.accelerations(with_arm(cable), x[: n + 1], x[n + 1 :], np.zeros(7), torque=u).alpha
    base = Stretch(0.0, 1.0, x[0], x[n + 1], u)
    along, across = np.array([np.sin(x[0]), -np.cos(x[0])]), np.array([np.cos(x[0]), np.sin(x[0])])
    push = ARM.length * (u * across - x[n + 1] ** 2 * along)
    whole = np.array([*push, u, x[n + 1], x[0], *base.base(0.0, ARM.length)[5:].astype(float)], dtype=np.longdouble)
    return np.append(u, dense.accelerations(links_of(cable), x[1 : n + 1], x[n + 2 :], whole).alpha)


@both
@pytest.mark.parametrize("command", ["acceleration", "torque"])
def test_linearization_is_that_of_dense_algebra(command, friction_model):
    """Differences of 1e-6 in long doubles err by 1e-12 of third derivatives, and by 1e-13 of rounding."""
    (q, qd), u = state(4), 0.7
    x = np.concatenate([q, qd]).astype(np.longdouble)
    a, b = hf.linearize(rope(friction_model), ARM, q[1:], qd[1:], q[0], qd[0], command=command, u=u)
    size = np.longdouble(1e-6)
    for k, e in enumerate(size * np.eye(x.size, dtype=np.longdouble)):
        change = slopes(command, friction_model, x + e, u) - slopes(command, friction_model, x - e, u)
        want = np.asarray(change / (2 * size), float)
        np.testing.assert_allclose(a[N + 1 :, k], want, rtol=0, atol=1e-8 * max(1.0, np.abs(want).max()))
    change = slopes(command, friction_model, x, u + size) - slopes(command, friction_model, x, u - size)
    np.testing.assert_allclose(b[N + 1 :, 0], np.asarray(change / (2 * size), float), rtol=0, atol=1e-8)
    np.testing.assert_array_equal(a[: N + 1], np.eye(N + 1, 2 * N + 2, N + 1))
    np.testing.assert_array_equal(b[: N + 1], 0.0)


def test_linearization_over_an_interval_is_the_steppers_and_tends_to_the_continuous_one():
    cable = rope().replace(dry_friction=0.0)
    q, qd = state(5)
    about = (cable, ARM, q[1:], qd[1:], q[0], qd[0])
    dt = 1e-6
    for command in ("acceleration", "torque"):
        a, b = hf.linearize(*about, command=command, u=0.1)
        ad, bd = hf.linearize(*about, command=command, u=0.1, dt=dt)
        # (exp(A dt) - 1) / dt - A is A^2 dt / 2
        np.testing.assert_allclose((ad - np.eye(2 * N + 2)) / dt, a, rtol=0, atol=dt * np.abs(a @ a).max())
        np.testing.assert_allclose(bd / dt, b, rtol=0, atol=dt * np.abs(a @ b).max() + 1e-6)
    refuses("an angle is commanded over an interval", hf.linearize, *about, command="angle")
    refuses("q has the wrong shape", hf.linearize, cable, ARM, q, qd)


def test_joints_are_sums_of_links_at_any_angle():
    rng = np.random.default_rng(5)
    cable, base = rope(), rng.normal(size=(4, 3, 2))
    q = rng.normal(size=(4, 3, N)) * np.array([1.0, 1e3, 1e7])[:, None]
    q[1, 1, 2], q[2, 0] = np.nan, np.arange(N) * np.pi / 2
    links = cable.length[:, None] * np.stack([np.sin(q), -np.cos(q)], axis=-1)
    places = base[..., None, :] + np.concatenate([np.zeros((4, 3, 1, 2)), np.cumsum(links, axis=-2)], axis=-2)
    told = cable.joints(q, base)
    # 7 sums of numbers up to 3 m; sine and cosine err by 3e-16, and angles of 1e7 rad know no more than 2e-9 rad.
    far = np.array([4e-15, 4e-15, 1e-8])[:, None, None]
    np.testing.assert_array_equal(np.isnan(told), np.isnan(places))
    assert np.isnan(told[1, 1, 3:]).all()
    assert (np.nan_to_num(np.abs(told - places)) <= far).all()
    np.testing.assert_array_equal(cable.joints(np.asfortranarray(q[:, 0]), base[:, 0]), told[:, 0])
    one = cable.joints(q[0, 0], base[0, 0])
    np.testing.assert_array_equal(one, told[0, 0])
    refuses(r"q has the wrong shape: got \(3,\)", cable.joints, np.zeros(3), np.zeros(2))


def test_velocities_of_places_are_their_difference_quotients():
    rng, h = np.random.default_rng(8), 1e-5
    cable, angle, rate = rope(), *rng.normal(size=(2, 4, 3))
    q, qd = rng.normal(size=(2, 4, 3, N))

    def places(t: float):
        base = ARM.tip(angle + t * rate)
        return base, cable.joints(q + t * qd, base), cable.mass_points(q + t * qd, qd, base, base)[0]

    velocity = ARM.tip_velocity(angle, rate)
    told = velocity, cable.joint_velocities(q, qd, velocity), cable.mass_points(q, qd, places(0.0)[0], velocity)[1]
    for late, early, want in zip(places(h), places(-h), told, strict=True):
        np.testing.assert_allclose((late - early) / (2.0 * h), want, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        ARM.rope_tip(cable.length, angle, rate, q, qd)[1], told[1][..., -1, :], rtol=0, atol=1e-14
    )
    beyond = (places(0.0)[2] - places(0.0)[1])[..., :-1, :]  # of the centres of mass from the joints before them
    np.testing.assert_allclose(np.hypot(*np.moveaxis(beyond, -1, 0)), np.broadcast_to(cable.com, q.shape), rtol=1e-12)
