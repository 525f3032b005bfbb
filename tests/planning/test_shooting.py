"""Shooting on residuals whose minimum is known."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest

from hyperflex.budget import Budget
from hyperflex.planning.shooting import shoot


class Point(NamedTuple):
    x: np.ndarray
    t: float
    residuals: np.ndarray


def at(x: np.ndarray) -> Point:
    """Two residuals that are curved, and badly scaled, in three parameters; the time is the first of them."""
    return Point(x, float(x[0]), np.array([x[0] + 0.1 * x[1] ** 2 - 1.0, 100.0 * (x[1] - 0.02 * x[2])]))


def fly(one: Point, changes: Sequence[np.ndarray], later: Sequence[float]) -> list[Point | None]:
    for change, late in zip(changes, later, strict=True):
        assert late == pytest.approx(change[0] if late else 0.0, abs=1e-3)  # the time is predicted
    found = [at(one.x + change) for change in changes]
    return [each if each.x[0] < 0.9 else None for each in found]  # there is none beyond


def test_residuals_are_reduced_and_failed_flights_are_passed_over():
    scale, begin = np.array([0.1, 0.1, 5.0]), at(np.array([0.0, 0.5, 0.0]))
    best, varied = shoot(begin, scale, fly, close=1e-6, rounds=60, difference=1e-4, budget=Budget())
    assert np.linalg.norm(best.residuals) < 0.2 * np.linalg.norm(begin.residuals)
    assert best.x[0] < 0.9
    assert [np.flatnonzero(each.x - best.x).tolist() for each in varied] in ([[0], [1], [2]], [[], [1], [2]])
    (first, _), (none, _) = (
        shoot(begin, scale, fly, close=close, rounds=1, difference=1e-4, budget=Budget()) for close in (0.0, math.inf)
    )
    assert np.abs(first.x - begin.x).max() / scale.max() <= 0.6
    assert none is begin
