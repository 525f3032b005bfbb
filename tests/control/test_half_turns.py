"""Half turns of the arm at chosen instants."""

import numpy as np
import pytest

import hyperflex as hf
from tests.refusals import refuses


@pytest.mark.parametrize("path", ["under", "over"])
@pytest.mark.parametrize("profile", ["bang-bang", "ramp", "minimum-jerk"])
def test_equal_rests_are_the_papers_swings(path, profile):
    t = np.linspace(0.0, 4.9, 491)
    free = hf.arm_strokes(1.26 * np.arange(4), 0.73, profile, path)
    swings = hf.arm_swings(0.73, 0.53, profile, path)
    # The same polynomials, from breaks that differ by rounding: 1e-12 of some 25 rad/s^2 times that.
    np.testing.assert_allclose(free.angle(t), swings.angle(t), atol=1e-12)
    np.testing.assert_allclose(free.rate(t), swings.rate(t), atol=1e-12)


def test_later_half_turns_begin_where_earlier_ones_ended():
    whole, later = hf.arm_strokes([0.0, 1.0, 2.5]), hf.arm_strokes([0.0, 1.5], made=1)
    t = np.linspace(0.0, 3.0, 301)
    np.testing.assert_allclose(later.angle(t), whole.angle(t + 1.0), atol=1e-12)  # rounding


def test_half_turns_may_follow_each_other_at_once_and_none_is_a_rest():
    joined = hf.arm_strokes([0.0, 0.73, 1.46])
    assert joined.angle(3.0) == pytest.approx(np.pi / 2)
    assert (np.diff(joined.breaks) > 0.3).all()  # no sliver between half turns
    assert hf.arm_strokes([], made=1).angle(5.0) == pytest.approx(np.pi / 2)


def test_overlap_and_times_before_zero_are_refused():
    refuses("half turn 1 starts before half turn 0 ends", hf.arm_strokes, [0.0, 0.5])
    refuses("starts", hf.arm_strokes, [-0.1])
