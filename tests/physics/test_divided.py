"""A rope whose links are cut loses as much energy as before: in a given shape, and in a slow swing."""

import numpy as np
import pytest
from scipy.special import j0, j1, jn_zeros

import hyperflex as hf
from hyperflex.model import divided

ROPE = hf.Rope.uniform(length=1.0, mass=0.06, n_links=10, radius=0.002, friction=2e-4)
UNEVEN = hf.Rope(
    length=[0.10, 0.06, 0.14, 0.10, 0.20, 0.15, 0.05],
    mass=[0.02, 0.01, 0.02, 0.01, 0.01, 0.005, 0.005],
    radius=0.002,
    friction=[7e-4, 3e-4, 5e-4, 2e-4, 1e-4, 4e-4, 3e-4],
    stiffness=[2e-3, 4e-3, 1e-3, 3e-3, 2e-3, 5e-3, 1e-3],
)


@pytest.mark.parametrize("name", ["friction", "stiffness"])
@pytest.mark.parametrize("pieces", [20, [30, 15, 40, 25, 50, 20, 10]])
def test_a_given_shape_takes_as_much_of_a_cut_rope(name, pieces):
    """Power lost at given rates, or energy of given angles, against the integral along the rope, and its hinge."""

    def shape(s):
        return np.cos(3.0 * s)  # its slope is 0 at the hinge, so that the first link is nearly there

    joints = np.append(0.0, np.cumsum(UNEVEN.length)[:-1])
    value = getattr(UNEVEN, name)
    per_length = value[1:] * 0.5 * (UNEVEN.length[1:] + UNEVEN.length[:-1])
    s = np.linspace(0.0, UNEVEN.total_length, 40001)
    slope = -3.0 * np.sin(3.0 * s)
    expected = value[0] + np.trapezoid(np.interp(s, joints[1:], per_length) * slope**2, s)
    fine = divided(UNEVEN, pieces)
    middles = np.cumsum(fine.length) - 0.5 * fine.length
    turned = np.diff(np.append(0.0, shape(middles)))
    # Sums in place of integrals: links of 2 to 7 mm, curved over 1/3 m, so some (7 mm * 3 / m)^2 / 4 = 1e-4.
    assert getattr(fine, name) @ turned**2 == pytest.approx(expected, rel=5e-4)


def decay(rope: hf.Rope) -> float:
    """Rate, 1/s, at which the amplitude of the slowest swing falls."""
    slowest, drop, g = jn_zeros(0, 1)[0], rope.total_length, 9.81
    middles = np.cumsum(rope.length) - 0.5 * rope.length
    z = slowest * np.sqrt(1.0 - middles / drop)
    q0 = 0.02 * slowest * j1(z) / z  # slope of J0(z), the shape of a hanging chain that swings
    period = 4.0 * np.pi / slowest * np.sqrt(drop / g)
    run = hf.simulate(rope, duration=3.0 * period, q0=q0, t_eval=[0.0, 3.0 * period], tol=1e-9)
    carried = np.append(np.cumsum((rope.mass)[::-1])[::-1][1:], 0.0) * rope.length + rope.mass * rope.com
    whole = g * float(carried @ (1.0 - np.cos(q0)))  # energy over that of the rope at rest
    return float(-np.log1p(-run.dissipated_energy[-1] / whole) / (2.0 * run.t[-1]))


def expected_decay(rope: hf.Rope) -> float:
    """Rayleigh's quotient of a hanging chain that swings as J0: what hinge and bending take, over twice its energy."""
    slowest, drop = jn_zeros(0, 1)[0], rope.total_length
    s = np.linspace(0.0, drop, 20001)[:-1]  # at the end z is 0
    z = slowest * np.sqrt(1.0 - s / drop)
    angle, place = j1(z) / z, j0(z) * 2.0 * drop / slowest**2
    per_length = rope.friction[1] * rope.length[1]
    lost = rope.friction[0] * angle[0] ** 2 + per_length * np.trapezoid(np.gradient(angle, s) ** 2, s)
    return float(lost / (2.0 * rope.mass.sum() / drop * np.trapezoid(place**2, s)))


def test_a_slow_swing_of_a_cut_rope_decays_as_that_of_a_hanging_chain() -> None:
    # Friction so weak that it does not bend the shape. The chain's error falls with the length of its links, here
    # 3.2, then 1.5 %; without that part 0.1 % are left, of its square.
    weak = ROPE.replace(friction=np.full(10, 1e-6))
    twice, four = (decay(divided(weak, pieces)) / expected_decay(weak) for pieces in (2, 4))
    assert abs(four - 1.0) < 0.02
    assert 2.0 * four - twice == pytest.approx(1.0, abs=0.004)


def test_the_hinge_keeps_its_friction_and_the_first_link_bends_as_the_rope_beyond():
    fine = divided(UNEVEN, 5)
    assert (fine.friction[0], fine.stiffness[0]) == (7e-4, 2e-3)
    # per length that of the second joint, which represents 0.08 m; pieces of 0.02 m
    np.testing.assert_allclose(fine.friction[1:5], 3e-4 * 0.08 / 0.02, rtol=1e-12)


def test_a_single_link_bends_like_its_hinge():
    rod = hf.Rope(length=[0.4], mass=[0.1], friction=3e-4)
    np.testing.assert_allclose(divided(rod, 4).friction, [3e-4, 12e-4, 12e-4, 12e-4], rtol=1e-12)


def test_joints_between_links_that_are_left_alone_keep_what_they_have():
    fine = divided(UNEVEN, [1, 1, 1, 1, 4, 1, 1])
    np.testing.assert_allclose(fine.friction[[0, 1, 2, 3, 9]], UNEVEN.friction[[0, 1, 2, 3, 6]], rtol=1e-12)
