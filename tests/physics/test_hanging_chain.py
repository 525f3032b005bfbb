"""Small swings of a hanging chain: the modes tend to those of a heavy string, whose frequencies are Bessel zeros."""

import numpy as np
import pytest
from scipy.special import jn_zeros

import hyperflex as hf
from tests.core.helpers import sweep
from tests.reference.arm import links_of
from tests.reference.cases import State

LENGTH = 2.0
STRING = jn_zeros(0, 4) / 2 * np.sqrt(9.81 / LENGTH)  # rad/s; Daniel Bernoulli's hanging chain


def modes(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, rad/s, and shapes (n, n) of a hanging chain of n links, from its accelerations."""
    links = links_of(hf.Rope.uniform(length=LENGTH, mass=0.125, n_links=n, friction=0.0))
    eps = 1e-6  # accelerations are odd in the angles, so the difference is right to eps^2
    columns = [sweep(links, State(eps * one, np.zeros(n), np.zeros(7))).alpha / eps for one in np.eye(n)]
    squares, shapes = np.linalg.eig(-np.array(columns).T)
    order = np.argsort(squares.real)
    return np.sqrt(squares.real[order]), shapes.real[:, order]


def test_modes_tend_to_the_bessel_frequencies_with_the_square_of_the_link_length():
    counts = np.array([10, 20, 40, 80])
    errors = np.array([modes(n)[0][:4] / STRING - 1.0 for n in counts])
    orders = np.log2(np.abs(errors[:-1] / errors[1:]))
    # Rigid links cut the corners of a smooth shape by a distance that goes with the link's length squared. The first
    # mode is there already; the fourth, with 80 links on four half waves, still has 4 % of its next term.
    np.testing.assert_allclose(orders[-1], 2.0, rtol=0, atol=0.1)
    assert orders[-1, 0] == pytest.approx(2.0, abs=0.01)
    # Remaining error at n = 80, with the order above: 5e-6 of the first, 1.8e-3 of the fourth (measured, rounded up).
    assert (np.abs(errors[-1]) < [6e-6, 2e-4, 8e-4, 2e-3]).all()


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_a_simulated_mode_swings_at_its_frequency(mode):
    n = 50
    frequencies, shapes = modes(n)
    omega = frequencies[mode]
    shape = shapes[:, mode] / np.abs(shapes[:, mode]).max()
    t = np.linspace(0.0, 3 * 2 * np.pi / omega, 31)
    rope = hf.Rope.uniform(length=LENGTH, mass=0.125, n_links=n, friction=0.0)
    run = hf.simulate(rope, duration=float(t[-1]) + 0.1, q0=1e-4 * shape, t_eval=t, tol=1e-12)
    ideal = 1e-4 * np.cos(omega * t)[:, None] * shape  # small: the sine's next term slows it by 1e-9 of its phase
    x = np.cumsum(rope.length * ideal, axis=1)  # sideways displacement of the joints, m
    # 1e-12 m a step, and without friction a thousand steps add up: 1e-9 m, of a swing of 2e-5 to 2e-4 m.
    np.testing.assert_allclose(run.joints[:, 1:, 0], x, rtol=0, atol=1e-9)
    # The string itself, with the error of 50 links that the convergence test above allows (1.8e-3 for the third mode).
    assert omega == pytest.approx(STRING[mode], rel=2e-3)
