"""QR with pivoting that ends early, against scipy's (LAPACK's) QR with pivoting of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import qr

from hyperflex.core.rank_revealing_qr import rank_revealing_qr


@pytest.mark.parametrize(("m", "n", "smallest"), [(12, 30, 1.0), (30, 12, 1.0), (40, 40, -9.0), (5, 1, 0.0)])
def test_the_rows_are_those_of_a_qr_with_pivoting(m: int, n: int, smallest: float) -> None:
    """Sizes from 1e4 down to 1e-9: columns that are left lose all digits of their squares."""
    rng = np.random.default_rng(m)
    sizes = np.logspace(4.0, smallest, min(m, n))
    left = np.linalg.qr(rng.normal(size=(m, sizes.size)))[0]
    rows = left @ (sizes[:, None] * np.linalg.qr(rng.normal(size=(n, sizes.size)))[0].T)
    upper, pivots = qr(rows, mode="r", pivoting=True)
    wanted = np.zeros_like(upper)
    wanted[:, pivots] = upper
    work = rows.copy()
    rank = rank_revealing_qr(work, np.empty((3, n)))
    assert rank == (np.abs(np.diag(upper)) > 1.0).sum()
    signs = np.sign(work[:rank, pivots].diagonal() * wanted[:rank, pivots].diagonal())
    np.testing.assert_allclose(work[:rank], signs[:, None] * wanted[:rank], atol=1e-11 * 1e4)  # rounding of the largest


def test_one_row_is_always_kept() -> None:
    for rows in (np.zeros((4, 3)), 0.1 * np.eye(3)):
        assert rank_revealing_qr(rows.copy(), np.empty((3, 3))) == 1
