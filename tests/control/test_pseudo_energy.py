"""Pseudo-energy and spiral coordinates of the tip: paper eqs. (9)-(11)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperflex.control.spiral_coordinates import driving_constant, pseudo_energy, spiral
from tests.refusals import refuses


@given(st.floats(0.05, 5.0), st.floats(0.01, 3.0), st.floats(-3.0, 3.0))
def test_a_harmonic_swing_has_constant_radius_and_a_straight_phase(c, amplitude, start):
    t = np.linspace(0.0, 20.0 * c, 801)
    swing = spiral(t, amplitude * np.sin(t / c + start), amplitude / c * np.cos(t / c + start), c)
    np.testing.assert_allclose(swing.r, amplitude, rtol=1e-12)  # sin^2 + cos^2 = 1 up to rounding
    # The phase passes through arctan2 of values rounded to 2e-16 and 6 turns of unwrapping.
    np.testing.assert_allclose(swing.theta - swing.theta[0], t / c, atol=1e-11)


@given(st.floats(0.05, 5.0), st.floats(0.01, 10.0), st.floats(-3.0, 3.0), st.floats(-9.0, 9.0))
def test_radius_is_the_root_of_twice_the_energy_over_the_stiffness(c, mass, x, velocity):
    place, speed = np.array([x]), np.array([velocity])
    stiffness = mass / c**2
    expected = np.sqrt(2.0 * pseudo_energy(place, speed, mass, c) / stiffness)
    np.testing.assert_allclose(spiral([0.0], place, speed, c).r, expected, rtol=1e-12, atol=1e-150)


def test_quadrants_of_the_phase():
    # Moving right through the middle 0, standing on the right pi/2, moving left through the middle pi, and so on.
    swing = spiral([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 0.0, -1.0, 0.0], [1.0, 0.0, -1.0, 0.0, 1.0], 0.4)
    np.testing.assert_allclose(swing.theta, np.arange(5) * np.pi / 2, atol=1e-15)


def test_the_papers_two_constants_are_the_driving_period():
    assert round(driving_constant(0.73, 0.53), 2) == 0.40
    assert round(driving_constant(0.73, 0.34), 2) == 0.34


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"c": 0.0}, "c has the wrong sign"),
        ({"c": np.nan}, "c is not finite"),
        ({"x": [0.0, np.nan]}, r"x\[1\] cannot be used"),
        ({"velocity": [0.0]}, "velocity has the wrong shape"),
        ({"t": [1.0, 0.0]}, "t goes back in time"),
    ],
)
def test_bad_input_is_named(change, message):
    refuses(message, spiral, **{"t": [0.0, 1.0], "x": [0.0, 0.1], "velocity": [0.0, 0.1], "c": 0.4, **change})
