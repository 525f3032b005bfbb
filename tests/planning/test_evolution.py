"""The evolution strategy: minima of functions whose minimum is known, whatever the scales and axes of their valleys."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hyperflex.planning.evolution import CmaEs


def least(loss: Callable[[np.ndarray], float], search: CmaEs, generations: int) -> tuple[float, np.ndarray]:
    """Return the least loss of so many generations, and its point."""
    best = np.inf, np.zeros(0)
    for _ in range(generations):
        points = search.ask()
        losses = [loss(x) for x in points]
        search.tell(points, losses)
        k = int(np.argmin(losses))
        best = min(best, (losses[k], points[k]), key=lambda each: each[0])
    return best


@pytest.mark.parametrize("turned", [False, True])
def test_a_narrow_valley_is_followed_to_its_end(turned: bool) -> None:
    """Without learning the covariance, steps that suit the steepest axis, 1000 times as steep, would take for ever."""
    random = np.random.default_rng(0)
    axes = np.linalg.qr(random.standard_normal((8, 8)))[0] if turned else np.eye(8)
    steep = 10.0 ** np.linspace(0.0, 3.0, 8)
    search = CmaEs(np.full(8, 1.0), 0.5, np.ones(8), 12, random)
    value, x = least(lambda x: float(((steep * (axes @ (x - 2.0))) ** 2).sum()), search, 450)
    assert value < 1e-8
    np.testing.assert_allclose(x, 2.0, atol=1e-3)


def test_a_bent_valley_is_followed_to_its_end() -> None:
    """Rosenbrock's function of six variables."""
    search = CmaEs(np.full(6, -0.5), 0.3, np.ones(6), 16, np.random.default_rng(1))
    value, x = least(lambda x: float((100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2).sum()), search, 400)
    assert value < 1e-8
    np.testing.assert_allclose(x, 1.0, atol=1e-3)


def test_the_first_generation_has_the_spreads_asked_for() -> None:
    search = CmaEs(np.array([1.0, 2.0]), 0.5, np.array([0.1, 4.0]), 4000, np.random.default_rng(2))
    points = np.array(search.ask())
    np.testing.assert_allclose(points.mean(axis=0), [1.0, 2.0], atol=0.1)
    np.testing.assert_allclose(points.std(axis=0), [0.05, 2.0], rtol=0.05)


def test_the_step_grows_on_a_slope_and_shrinks_about_a_minimum() -> None:
    slope, bowl = (CmaEs(np.zeros(5), 1.0, np.ones(5), 12, np.random.default_rng(3)) for _ in range(2))
    least(lambda x: float(x[0]), slope, 20)
    least(lambda x: float((x**2).sum()), bowl, 40)
    assert slope.size > 3.0
    assert bowl.size < 0.1


def test_the_same_random_numbers_make_the_same_search() -> None:
    one, other = (CmaEs(np.zeros(4), 1.0, np.ones(4), 8, np.random.default_rng(4)) for _ in range(2))
    values = [least(lambda x: float((x**2).sum()), search, 10)[0] for search in (one, other)]
    assert values[0] == values[1]
