"""QR factorisation with column pivoting that ends where what is left is negligible."""

import numpy as np

from hyperflex.core.jit import non_allocating

CANCELLED = 1e-8  # part of a column's square below which what is left is summed anew, for differences have lost it


@non_allocating
def rank_revealing_qr(rows, work):  # type: ignore[no-untyped-def]
    """Turn rows (m, n) by reflections so that the first of them hold all that is not negligible; return how many.

    Parameters
    ----------
    rows : (m, n) float64
        Set on return. Columns keep their places: row k is zero in the columns that were pivots before.
    work : (3, n) float64

    Returns
    -------
    int
        Number of pivots greater than 1, but 1 at least.

    Notes
    -----
    Businger and Golub 1965, Numerische Mathematik 7, 269-276, with Householder's reflections. The squares of the
    columns that are left follow from those before by differences, as in LAPACK's dgeqp3.
    """
    m, n = rows.shape
    squares, summed, products = work[0], work[1], work[2]
    for j in range(n):
        squares[j] = summed[j] = 0.0
    for k in range(min(m, n)):
        pivot = largest_column(rows, k, squares, summed)
        for j in range(n):
            products[j] = 0.0
        for i in range(k, m):
            part = rows[i, pivot]
            for j in range(n):
                products[j] += part * rows[i, j]
        first, size = rows[k, pivot], np.sqrt(products[pivot])
        if k > 0 and not size > 1.0:
            return k
        corner = -size if first > 0.0 else size
        scale = 1.0 / max(size * (size + abs(first)), 1e-300)
        for j in range(n):
            products[j] = (products[j] - corner * rows[k, j]) * scale
            rows[k, j] -= (first - corner) * products[j]
        for i in range(k + 1, m):
            part = rows[i, pivot]
            for j in range(n):
                rows[i, j] -= part * products[j]
            rows[i, pivot] = 0.0
        rows[k, pivot], squares[pivot] = corner, -1.0
    return min(m, n)


@non_allocating
def largest_column(rows, k, squares, summed):  # type: ignore[no-untyped-def]
    """Return the column (n) of the greatest square in rows k and on, and set the squares; -1: a pivot before."""
    m, n = rows.shape
    largest = -1
    for j in range(n):
        if squares[j] < 0.0:
            continue
        if k > 0:
            squares[j] = max(squares[j] - rows[k - 1, j] * rows[k - 1, j], 0.0)
        if squares[j] <= CANCELLED * summed[j]:
            squares[j] = 0.0
            for i in range(k, m):
                squares[j] += rows[i, j] * rows[i, j]
            summed[j] = squares[j]
        if largest < 0 or squares[j] > squares[largest]:
            largest = j
    return largest
