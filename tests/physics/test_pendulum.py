"""One link is a pendulum: its period is known for every amplitude."""

import numpy as np
import pytest
from scipy.special import ellipk

import hyperflex as hf

# A local error of 1e-12 m a step over some hundred steps of a 1 m pendulum: well below the required 1e-8.
TOL = 1e-12


def period(rope: hf.Rope, amplitude: float, expected: float) -> float:
    """Period from two passes through the bottom, five quarters of the expected period apart from the first."""
    passes = expected * np.array([0.25, 1.25])
    run = hf.simulate(rope, duration=1.5 * expected, q0=[amplitude], t_eval=passes, tol=TOL)
    late = run.q[:, 0] / run.qd[:, 0]  # at the bottom the rate is stationary, so this is exact to third order
    return float(np.diff(passes - late)[0])


@pytest.mark.parametrize("amplitude", [1e-3, 1.0, 2.5, 3.1])
def test_period_of_a_rod_is_the_elliptic_integral(amplitude):
    rope = hf.Rope(length=[1.0], mass=[0.3], com=[0.4], inertia=[0.02])
    omega = np.sqrt(0.3 * 9.81 * 0.4 / (0.02 + 0.3 * 0.4**2))
    exact = 4.0 / omega * ellipk(np.sin(amplitude / 2) ** 2)
    # 1e-8 is the goal of the project.
    assert period(rope, amplitude, exact) == pytest.approx(exact, rel=1e-8)


@pytest.mark.parametrize("amplitude", [0.5, 2.9])
def test_a_tip_mass_on_a_massless_link_is_the_mathematical_pendulum(amplitude):
    rope = hf.Rope(length=[0.7], mass=[0.0], tip_mass=0.2)
    exact = 4.0 * np.sqrt(0.7 / 9.81) * ellipk(np.sin(amplitude / 2) ** 2)
    assert period(rope, amplitude, exact) == pytest.approx(exact, rel=1e-8)


def test_gravity_may_point_anywhere():
    """Turned gravity turns the rest position; the period stays."""
    rope = hf.Rope(length=[0.7], mass=[0.0], tip_mass=0.2, gravity=(9.81 * np.sin(2.0), -9.81 * np.cos(2.0)))
    exact = 4.0 * np.sqrt(0.7 / 9.81) * ellipk(np.sin(0.45) ** 2)
    times = exact * np.array([0.25, 1.0])
    run = hf.simulate(rope, duration=1.5 * exact, q0=[2.9], t_eval=times, tol=TOL)
    # Angles to 1e-8 as above: a quarter period later at the bottom (2.0), a period later back at 2.9.
    np.testing.assert_allclose(run.q[:, 0], [2.0, 2.9], rtol=0, atol=1e-7)


def test_damped_small_swing_is_the_damped_oscillator():
    inertia, eta = 0.25 * 0.3 + 0.02, 0.05
    rope = hf.Rope(length=[1.0], mass=[0.3], com=[0.5], inertia=[0.02], friction=[eta])
    decay, omega0 = eta / inertia / 2, np.sqrt(0.3 * 9.81 * 0.5 / inertia)
    omega = np.sqrt(omega0**2 - decay**2)
    t = np.linspace(0.0, 5.0, 51)
    run = hf.simulate(rope, duration=5.0, q0=[1e-4], t_eval=t, tol=TOL)
    exact = 1e-4 * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    # sin q = q - q^3 / 6: the swing slows by q^2 / 16, 6e-10 of its 18 rad of phase, so 1e-8 of the amplitude.
    np.testing.assert_allclose(run.q[:, 0], exact, rtol=0, atol=2e-8 * 1e-4)
