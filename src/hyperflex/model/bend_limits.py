"""Joint limits, and the radius to which they let a rope bend, as a ratio to the length that a joint stands for."""

import numpy as np

from hyperflex.checks import Array


def bend_ratios(max_bend: Array) -> Array:
    """Return twice the bend radius of joints over the length that each stands for; 0 where there is no limit."""
    return np.where(max_bend < np.pi, 1.0 / np.tan(0.5 * np.minimum(max_bend, np.pi)), 0.0)


def bend_limits(ratios: Array) -> Array:
    """Return the joint limits, rad, that go with such ratios; inf where one is 0."""
    return np.where(ratios > 0.0, 2.0 * np.arctan2(1.0, ratios), np.inf)
