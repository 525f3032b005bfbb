"""A motion behind a first-order lag, against the filter's own equation integrated by another solver."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hyperflex.motion import arm_moves, arm_swings, lagged, torque_profile
from tests.refusals import refuses

# Short and long rests, one shorter than the lag; bang-bang and with a way at full speed.
MOTION = arm_moves([-1.5, 1.5, 0.0, 0.3], [0.2, 0.004, 0.3], [0.7, 0.4, 0.2], [0.5, 0.3, 0.5])


def filtered(t: np.ndarray, lag: float) -> np.ndarray:
    """The filter's equation integrated from break to break, so that no step meets a jump."""
    found, value = np.empty_like(t), -1.5
    for low, high in itertools.pairwise([*MOTION.breaks, t[-1] + 1e-9]):
        inside = (t >= low) & (t < high)
        ask = np.append(t[inside], high)
        run = solve_ivp(
            lambda s, y: (MOTION.angle(s) - y) / lag, (low, high), [value], t_eval=ask, rtol=1e-11, atol=1e-12
        )
        found[inside], value = run.y[0][:-1], run.y[0][-1]
    return found


@pytest.mark.parametrize("lag", [pytest.param(0.002, marks=pytest.mark.nightly), 0.01, 0.05])
def test_it_is_the_filters_answer(lag):
    t = np.linspace(0.0, 2.5, 1001)
    true = filtered(t, lag)
    slow = lagged(MOTION, lag)
    # The polynomials leave 1e-4 of what fades, 60 rad/s^2 lag^2 at most.
    np.testing.assert_allclose(slow.angle(t), true, atol=1e-8 + 0.006 * lag**2)
    rate = (MOTION.angle(t) - true) / lag
    np.testing.assert_allclose(slow.rate(t), rate, atol=1e-3)
    assert float(np.abs(MOTION.angle(t) - slow.angle(t)).max()) > 5.0 * lag  # rad: the speed is 10 rad/s at most


def test_it_joins_smoothly_and_comes_to_rest_where_it_was_asked_to():
    slow = lagged(MOTION, 0.01)
    before, after = slow.breaks - 1e-12, slow.breaks + 1e-12
    np.testing.assert_allclose(slow.angle(before), slow.angle(after), atol=1e-10)
    np.testing.assert_allclose(slow.rate(before), slow.rate(after), atol=1e-8)
    assert float(slow.angle(5.0)) == pytest.approx(0.3, abs=1e-12)
    assert lagged(MOTION, 0.0) is MOTION


def test_what_repeats_or_gives_a_torque_is_refused():
    refuses("only the arm's angle lags", lagged, arm_swings(), 0.01)
    refuses("only the arm's angle lags", lagged, torque_profile([0.0, 1.0], [0.0, 1.0]), 0.01)
