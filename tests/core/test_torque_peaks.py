"""Sliding windows of the motor's torque against integrals over all windows."""

import numpy as np
import pytest

from hyperflex.core.chain.torque_peaks import CELL, COLUMNS, FIRST, PARTS, PEAK, SUM, add_impulse

WINDOW = 5e-4  # s


def watched(begins: list[float], steps: list[float], impulses: list[float]) -> np.ndarray:
    row = np.zeros(COLUMNS)
    for t, h, impulse in zip(begins, steps, impulses, strict=True):
        add_impulse(row, WINDOW / PARTS, impulse, t, h)
    return row


@pytest.mark.parametrize("seed", range(4))
def test_the_peak_is_that_of_all_windows(seed):
    """Up to the effect of the ends of a window: the order within a cell is unknown."""
    rng = np.random.default_rng(seed)
    h = 10.0 ** rng.uniform(-7.0, -3.3, 400) * (rng.random(400) < 0.9)  # some are impacts
    end = np.cumsum(h)
    impulse = np.where(h > 0.0, h * rng.normal(1.0, 0.5, 400), rng.normal(0.0, 1e-4, 400))
    row = watched(list(end - h), list(h), list(impulse))
    after = end + 1e-13 * np.arange(400)  # impacts one behind the other
    at = np.append(0.0, np.stack([after - 5e-14, after], axis=1).ravel())
    total = np.cumsum(impulse)
    total = np.append(0.0, np.stack([total - np.where(h > 0.0, 0.0, impulse), total], axis=1).ravel())
    grid = np.union1d(np.linspace(0.0, end[-1], 4000), at)
    least, most = (
        np.abs(np.interp(grid, at, total, left=0.0) - np.interp(grid - span - 1e-13, at, total, left=0.0))
        for span in (WINDOW * (1.0 - 2.0 / PARTS), WINDOW * (1.0 + 1.0 / PARTS))
    )
    assert 0.999 * least.max() < WINDOW * abs(row[PEAK]) < 1.001 * most.max()
    assert row[SUM] == pytest.approx(row[FIRST:].sum(), rel=0, abs=1e-15)


@pytest.mark.parametrize("begin", [0.0, 0.25 * WINDOW, 0.5 * WINDOW, 0.75 * WINDOW])
def test_a_blow_counts_in_full_wherever_it_falls(begin):
    """Windows that follow each other would cut it in two."""
    h = WINDOW / 50
    begins = list(np.arange(200) * h)
    row = watched(begins, [h] * 200, [h if 1e-3 + begin <= t < 1e-3 + begin + 0.8 * WINDOW else 0.0 for t in begins])
    assert row[PEAK] == pytest.approx(0.8, rel=0.03)


def test_free_flight_is_forgotten():
    row = watched([0.0, 1e-3], [1e-4, 1e-4], [1e-4, 1e-4])
    assert row[SUM] == pytest.approx(1e-4, rel=1e-12)
    assert row[PEAK] == pytest.approx(0.2, rel=1e-9)
    assert row[CELL] >= 20
