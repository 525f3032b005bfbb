"""Regression (4)-(6): the columns against the mass matrix and bias of `hyperflex.dynamics`, least squares, refusals."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.dynamics import bias, mass_matrix
from hyperflex.identification import lumped
from tests.refusals import refuses

N = 4


def rough_rope(friction_model: str = "relative") -> hf.Rope:
    """A rope in which all numbers differ."""
    rng = np.random.default_rng(4)
    return hf.Rope(
        length=rng.uniform(0.1, 0.3, N),
        mass=rng.uniform(0.01, 0.1, N),
        com=rng.uniform(0.02, 0.2, N),
        inertia=rng.uniform(1e-4, 1e-3, N),
        friction=rng.uniform(1e-4, 1e-3, N),
        dry_friction=rng.uniform(1e-4, 1e-3, N),
        stiffness=rng.uniform(1e-3, 1e-2, N),
        rest_angle=rng.uniform(-0.3, 0.3, N),
        tip_mass=0.02,
        gravity=(1.0, -9.0),
        friction_model=friction_model,
    )


def states(samples: int = 7) -> np.ndarray:
    """Angles, rates and accelerations of no motion at all: the equations hold torques, whatever moves."""
    return np.random.default_rng(5).normal(size=(3, samples, N))


def own_values(rope: hf.Rope, names: tuple[str, ...]) -> np.ndarray:
    """The rope's own values of single unknowns such as ``friction[2]``."""
    tables = dict(zip(("p", "J"), lumped(rope), strict=True))
    values = []
    for name in names:
        bare, _, link = name.rstrip("]").partition("[")
        whole = tables.get(bare)
        whole = np.atleast_1d(getattr(rope, bare)) if whole is None else whole
        values.append(whole[int(link or 0)])
    return np.array(values)


@pytest.mark.parametrize("friction_model", ["relative", "printed"])
@pytest.mark.parametrize(
    "names",
    [
        ["inertia", "friction"],
        ["mass", "inertia[1]"],
        ["tip_mass", "stiffness", "dry_friction"],
        ["p", "J", "friction"],
        ["p[0]", "J[3]", "friction[1]", "dry_friction[2]", "stiffness[0]"],
        ["mass[2]", "tip_mass"],
    ],
    ids="+".join,
)
def test_columns_and_known_torques_make_up_the_equation_of_motion(names, friction_model):
    rope = rough_rope(friction_model)
    q, qd, qdd = states()
    made = hf.fit_regression(rope, q, qd, qdd, names)
    torques = np.array([mass_matrix(rope, a) @ c + bias(rope, a, b) for a, b, c in zip(q, qd, qdd, strict=True)])
    # Both are sums of some 20 terms of the size of the torques, so they agree to rounding.
    np.testing.assert_allclose(
        made.columns @ own_values(rope, made.names) - made.known, torques, rtol=0, atol=1e-13 * np.abs(torques).max()
    )


def test_a_shared_unknown_is_the_sum_of_the_single_ones_and_nothing_of_it_is_known():
    rope = rough_rope()
    single = hf.fit_regression(rope, *states(), ["friction", "inertia"])
    shared = hf.fit_regression(rope, *states(), ["friction:shared", "inertia:shared"])
    np.testing.assert_allclose(shared.columns[..., 0], single.columns[..., :N].sum(axis=2), rtol=1e-14)
    np.testing.assert_allclose(shared.known, single.known, rtol=0, atol=1e-15)


def test_a_moving_arm_enters_by_its_acceleration_angle_and_rate():
    rope, arm = rough_rope(), hf.Arm(length=0.2, inertia=1e-3)
    q, qd, qdd = states(1)
    angle, rate, acceleration = 0.4, -1.3, 2.1
    pull = 0.2 * acceleration * np.array([np.cos(angle), np.sin(angle)])
    pull += 0.2 * rate**2 * np.array([-np.sin(angle), np.cos(angle)])
    bare = rope.replace(stiffness=np.zeros(N), rest_angle=np.zeros(N))
    led = {"pivot_acceleration": [pull], "arm_angle": angle, "arm_rate": rate}
    made = hf.fit_regression(bare, q, qd, qdd, ["friction"], **led)
    moving = {"arm": arm, "arm_angle": angle}
    whole = mass_matrix(bare, q[0], **moving) @ np.append(acceleration, qdd[0])
    whole += bias(bare, q[0], qd[0], **moving, arm_rate=rate)
    np.testing.assert_allclose(made.columns[0] @ bare.friction - made.known[0], whole[1:], rtol=0, atol=1e-13)


@pytest.mark.parametrize("friction_model", ["relative", "printed"])
def test_least_squares_find_what_made_the_motion(friction_model):
    rope = hf.Rope.uniform(1.0, 0.01, N, inertia=2e-6, friction=5e-4, friction_model=friction_model)
    run = hf.simulate(rope, duration=3.0, q0=np.linspace(0.3, 0.9, N), tol=1e-9)
    found = hf.fit_regression(rope.replace(inertia=9e-6, friction=0.0), run.q, run.qd, run.qdd).solve()
    # The simulation's accelerations fulfil (1) at its states to rounding; J's torque is 1e-3 of the others.
    assert found["inertia:shared"] == pytest.approx(2e-6, rel=1e-8)
    assert found["friction:shared"] == pytest.approx(5e-4, rel=1e-8)


def test_every_moment_and_friction_is_found_at_once_up_to_one_that_is_known():
    rope = rough_rope().replace(stiffness=np.zeros(N), dry_friction=np.zeros(N))
    run = hf.simulate(rope, duration=4.0, q0=rope.hanging_angle + np.linspace(1.2, -0.5, N), tol=1e-9)
    names = [*(f"p[{k}]" for k in range(1, N)), "J", "friction"]
    blind = rope.replace(mass=0.3 * rope.mass, friction=np.zeros(N))
    known = blind.replace(com=rope.com)
    # p[0] is what is known: give the blind rope the right one by its first centre of mass.
    missing = lumped(rope)[0][0] - lumped(known)[0][0]
    known = known.replace(com=known.com + np.eye(N)[0] * missing / known.mass[0])
    found = hf.fit_regression(known, run.q, run.qd, run.qdd, names).solve()
    expected = np.concatenate([lumped(rope)[0][1:], lumped(rope)[1], rope.friction])
    np.testing.assert_allclose(found.values, expected, rtol=1e-7)


def test_standard_deviations_are_those_of_repeated_noise():
    rope = hf.Rope.uniform(1.0, 0.01, N, inertia=2e-5, friction=5e-4)
    run = hf.simulate(rope, duration=3.0, q0=np.linspace(0.3, 0.9, N), tol=1e-9)
    exact = hf.fit_regression(rope, run.q, run.qd, run.qdd)
    rng = np.random.default_rng(1)
    draws = []
    for _ in range(400):
        noisy = type(exact)(exact.names, exact.columns, exact.known + 1e-4 * rng.standard_normal(exact.known.shape))
        draws.append(noisy.solve())
    spread = np.std([draw.values for draw in draws], axis=0)
    # A standard deviation from 400 draws is known within 3.5 % (one sigma).
    np.testing.assert_allclose(draws[0].std, spread, rtol=0.14)


def test_samples_with_gaps_are_omitted():
    rope = hf.Rope.uniform(1.0, 0.01, N, inertia=2e-6, friction=5e-4)
    run = hf.simulate(rope, duration=3.0, q0=np.linspace(0.3, 0.9, N), tol=1e-9)
    q = run.q.copy()
    q[10:20, 1] = np.nan
    found = hf.fit_regression(rope, q, run.qd, run.qdd).solve()
    assert found["friction:shared"] == pytest.approx(5e-4, rel=1e-8)
    assert np.isnan(found.residual[10:20]).any(axis=1).all()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["eta"], "not known"),
        (["friction[9]"], "does not fit"),
        (["tip_mass[0]"], "does not fit"),
        (["friction[1]:shared"], "not known"),
        (["friction", "friction[1]"], "overlap"),
        (["friction:shared", "friction[1]"], "overlap"),
        (["p", "mass"], "overlap"),
        (["J", "inertia[0]"], "overlap"),
        ([], "overlap"),
    ],
)
def test_names_are_refused(names, message):
    refuses(message, hf.fit_regression, rough_rope(), *states(), names)


def test_what_the_samples_do_not_determine_is_refused():
    """Unknowns that act alike, a common factor of all, and fewer samples than unknowns."""
    q, qd, qdd = states()
    free = rough_rope().replace(stiffness=np.zeros(N), dry_friction=np.zeros(N))
    for rope, given, names, message in (
        (rough_rope(), (q, 0.0 * qd, qdd), (), r"act alike.*friction:shared"),
        (free, (q, qd, qdd), (["p", "J", "friction"],), "common factor"),
        (rough_rope(), states(1), (["p[1]", "J", "friction"],), "too few samples"),
    ):
        refuses(message, hf.fit_regression(rope, *given, *names).solve)


def test_air_drag_is_the_virtual_work_of_the_wind_along_the_links():
    """Its columns against 4000 strips a link, each with its own velocity across the link and lever dx/dq.

    Midpoints err by the square of a strip's part of a link times the curvature of v |v|, 1e-7 of the torque.
    """
    rng = np.random.default_rng(5)
    n, strips = 3, 4000
    rope = hf.Rope(length=[0.3, 0.2, 0.25], mass=[0.02, 0.01, 0.03], drag=[3e-3, 5e-3, 2e-3])
    q, qd, qdd = (scale * rng.standard_normal((6, n)) for scale in (1.0, 4.0, 20.0))
    qd[0, 1] = 0.0  # a link that only moves along: v is the same all over it
    pivot = rng.standard_normal((6, 2))
    found = hf.fit_regression(rope, q, qd, qdd, ["drag"], pivot_velocity=pivot)
    normal = np.stack([np.cos(q), np.sin(q)], axis=2)
    for sample in range(6):
        for k in range(n):
            s = (np.arange(strips) + 0.5) / strips * rope.length[k]
            lever = [rope.length[i] * np.ones(strips) if i < k else s for i in range(k + 1)]  # along each link's normal
            v = pivot[sample] + sum(qd[sample, i] * lever[i][:, None] * normal[sample, i] for i in range(k + 1))
            across = v @ normal[sample, k]
            force = across * np.abs(across) * rope.length[k] / strips
            work = [float((force * lever[i]).sum() * (normal[sample, i] @ normal[sample, k])) for i in range(k + 1)]
            scale = np.abs(work).max()
            np.testing.assert_allclose(found.columns[sample, : k + 1, k], work, atol=1e-6 * scale)
            assert not found.columns[sample, k + 1 :, k].any()
    held = hf.fit_regression(rope, q, qd, qdd, ["friction"], pivot_velocity=pivot).known
    bare = hf.fit_regression(rope.replace(drag=0.0), q, qd, qdd, ["friction"], pivot_velocity=pivot).known
    np.testing.assert_allclose(bare - held, found.columns @ rope.drag, rtol=1e-9, atol=1e-15)
