"""The chain tends to the inextensible string, and ropes of other numbers of links are the same string."""

import numpy as np
import pytest

import hyperflex as hf
from hyperflex.model import divided
from tests.reference.string import String, tension
from tests.refusals import refuses

LENGTH, MU, VISCOSITY, HINGE = 2.0, 0.0625, 2e-5, 5e-4
CABLE = hf.Rope.uniform(length=LENGTH, mass=0.125, n_links=50, radius=0.0025, friction=HINGE)  # the paper's
T = np.linspace(0.0, 1.5, 16)


def start(s):
    """Angle of a rope that is let go, rad; straight at both ends."""
    return 0.4 * np.cos(np.pi * s / LENGTH)


def cable(n: int, *, hinge: float = 0.0) -> hf.Rope:
    rope = hf.with_links(CABLE.replace(radius=0.0, inertia=CABLE.mass * CABLE.length**2 / 12.0), n)
    return rope.replace(friction=[hinge, *rope.friction[1:]])


def stroke(t):
    """Minimum jerk from -pi/2 to pi/2 in .73 s by an arm of .105 m: base acceleration and rate of the arm."""
    motion, reach = hf.move_arm(-0.5 * np.pi, 0.5 * np.pi, 0.73, "minimum-jerk"), 0.105
    angle, rate, turn = (float(each([t])[0]) for each in (motion.angle, motion.rate, motion.acceleration))
    along, across = np.array([np.sin(angle), -np.cos(angle)]), np.array([np.cos(angle), np.sin(angle)])
    return reach * (turn * across - rate**2 * along), rate


def orders(errors):
    return np.log2(errors[:-1] / errors[1:])


def test_a_free_swing_tends_to_the_string_with_order_two():
    string = String(LENGTH, MU, VISCOSITY, modes=32)
    truth = string.tip(string.run(string.fit(start), T, tol=1e-8))
    errors = []
    for n in (25, 50, 100, 200):
        rope = cable(n)
        run = hf.simulate(rope, duration=1.5, q0=start(rope.link_middles), t_eval=T, tol=1e-9)
        errors.append(np.linalg.norm(run.tip - truth, axis=1).max())
    # The next term of the error is l^4; the string is right to 1e-6 m (20, 28, 36 modes).
    np.testing.assert_allclose(orders(np.array(errors))[1:], 2.0, rtol=0, atol=0.1)
    assert errors[-1] < 5e-4


@pytest.mark.nightly
def test_a_cast_tends_to_the_string_with_order_two():
    string = String(LENGTH, MU, VISCOSITY, modes=28)
    t = np.linspace(0.0, 1.2, 13)
    truth = string.tip(string.run(string.fit(np.zeros_like), t, stroke, tol=1e-8))
    motion, errors = hf.move_arm(-0.5 * np.pi, 0.5 * np.pi, 0.73, "minimum-jerk"), []
    for n in (25, 50, 100):
        run = hf.simulate(cable(n), motion, arm=hf.Arm(length=0.105), duration=1.2, t_eval=t, tol=1e-9)
        errors.append(np.linalg.norm(run.tip - run.base - truth, axis=1).max())
    np.testing.assert_allclose(orders(np.array(errors)), 2.0, rtol=0, atol=0.15)


def test_the_tension_is_that_of_the_boundary_problem():
    """At a state in motion; of links of 20 mm and 10 mm, without friction, so that the string has no shear force."""
    n, errors = 100, []
    for count in (n, 2 * n):
        rope = hf.with_links(CABLE.replace(friction=np.zeros(50), radius=0.0), count)
        q, rates = 0.9 * np.cos(1.5 * rope.link_middles), 2.0 * np.sin(rope.link_middles)
        run = hf.simulate(rope, duration=1e-6, q0=q, qd0=rates, t_eval=[0.0])
        joints = np.append(0.0, rope.link_ends)
        expected = tension(
            LENGTH, MU, lambda s: (0.9 * np.cos(1.5 * s), -1.35 * np.sin(1.5 * s)), lambda s: 2.0 * np.sin(s), joints
        )
        errors.append(np.abs(hf.rope_tension(run)[0] - expected)[count // 10 :: count // 10].max())
    assert errors[0] < 2e-3 * MU * LENGTH * 9.81
    assert orders(np.array(errors))[0] == pytest.approx(2.0, abs=0.2)


def test_converting_a_rope_keeps_its_swing():
    """From 50 links to others and back: within 1 % of the swing's size, which is that of the polygon's own error."""
    paths = {}
    for n in (35, 50, 100, 300):
        rope = hf.with_links(CABLE, n)
        paths[n] = hf.simulate(
            rope, duration=6.0, q0=np.cos(0.25 * np.pi * rope.link_middles), t_eval=np.arange(61) / 10
        ).tip
    size = np.abs(paths[50][:, 0]).max()
    for n, path in paths.items():
        assert np.linalg.norm(path - paths[50], axis=1).max() < 0.01 * size, n
    again = hf.with_links(hf.with_links(CABLE, 200), 50)
    np.testing.assert_allclose(again.friction, CABLE.friction, rtol=1e-12)
    np.testing.assert_allclose(again.inertia, CABLE.inertia, rtol=1e-12)


@pytest.mark.parametrize(
    "how",
    [
        {"motion": hf.arm_swings(), "arm": hf.Arm()},
        {"motion": hf.arm_swings(path="over"), "arm": hf.Arm()},
        {"q0": np.cos(0.25 * np.pi * CABLE.link_middles)},
    ],
    ids=["cast", "over", "swing"],
)
def test_the_limit_and_its_error_bar_contain_the_run_of_800_links(how):
    t = np.linspace(0.0, 8.0, 81)
    run = hf.simulate(CABLE, duration=8.0, t_eval=t, extrapolate=True, **how)
    fine = hf.with_links(CABLE, 800)
    same = {name: value if name != "q0" else np.cos(0.25 * np.pi * fine.link_middles) for name, value in how.items()}
    truth = hf.simulate(fine, duration=8.0, t_eval=t, tol=1e-8, **same)
    away = np.linalg.norm(run.limit - truth.joints[:, ::16], axis=2).max(axis=1)
    assert (away <= run.limit_error).all()
    own = np.linalg.norm(run.tip - truth.tip, axis=1).max()
    assert np.linalg.norm(run.limit[:, -1] - truth.tip, axis=1).max() < 0.35 * own  # it is nearer than the run itself


def test_another_number_of_links_keeps_the_rope_or_is_refused():
    weighted = CABLE.replace(com=[*CABLE.com[:-1], 0.99 * CABLE.length[-1]])
    assert hf.with_links(weighted, 50) is weighted
    refuses("link 49 is not uniform", hf.with_links, weighted, 100)
    heavy = CABLE.replace(inertia=3.0 * CABLE.inertia)
    np.testing.assert_allclose(hf.with_links(heavy, 100).inertia, divided(heavy, 2).inertia, rtol=1e-9)


def test_a_limit_survives_its_file(tmp_path):
    rope = hf.with_links(CABLE, 4)
    run = hf.simulate(rope, duration=0.2, q0=[0.1, 0.2, 0.3, 0.4], extrapolate=True)
    run.to_netcdf(tmp_path / "run.nc")
    again = hf.read_trajectory(tmp_path / "run.nc")
    np.testing.assert_array_equal(again.limit, run.limit)
    np.testing.assert_array_equal(again.limit_error, run.limit_error)


def test_a_limit_is_of_a_free_run_from_its_start():
    refuses("free run", hf.simulate, CABLE, duration=1.0, pegs=[hf.Peg(1.0, -1.0, 0.1)], refine=False, extrapolate=True)
    refuses("extrapolate", hf.simulate, CABLE, duration=1.0, extrapolate="yes")
    refuses("no smooth shape", hf.simulate, CABLE, duration=1.0, q0=1.2 * (CABLE.link_middles > 1.0), extrapolate=True)
