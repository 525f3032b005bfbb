"""Bars that are hidden, and colours that cannot be told."""

import numpy as np
import pytest

from hyperflex import InvalidInput
from hyperflex.vision import BarDetector

DARK, BLUE = (75.0, 60.0, 63.0), (223.0, 84.0, 30.0)
WALL = np.tile(np.uint8([124, 144, 164]), (332, 316, 1))


def test_a_hidden_bar_is_nan():
    image, detector = WALL.copy(), BarDetector([DARK, BLUE], [4000.0, 3500.0])
    image[100:200, 140:180] = DARK
    assert np.isnan(detector.find(WALL).centres).all()
    seen = detector.find(image)
    assert np.isfinite(seen.centres[0]).all()
    assert np.isnan(seen.centres[1]).all()
    assert np.isnan(seen.covariances[1]).all()


@pytest.mark.parametrize(
    ("colours", "message"),
    [([DARK] * 4, "1 to 3"), ([BLUE, np.array(BLUE) * 0.99], "alike"), ([(124.0, 144.0, 164.0)], "alike, or like")],
)
def test_colours_that_cannot_be_told_are_refused(colours, message):
    with pytest.raises(InvalidInput, match=message):
        BarDetector(colours).find(WALL)
