"""Dense output of an extrapolated step: its substeps, weighed for any time within the step.

A column that takes j substeps h = H / j has the states Y_j(t) = y(t) + h e_1(t) + h^2 e_2(t) + ... on the way, where
all e_k are zero at the beginning (Hairer and Ostermann 1990, doi:10.1007/BF01386410). The p (p + 1) / 2 substeps of the
columns 1..p fix all terms in h^k (t - t_0)^m with k + m <= p, and so y(t) to the order of the step, for nothing but
sums.
"""

import numpy as np

from hyperflex.core.chain import lanes as ln
from hyperflex.core.jit import kernel, non_allocating, summing

MOST_SUBSTEPS = 40  # rounds times lanes of order 8, and a spare round
# Parts of the step at which the error is looked at, where friction settles and in the middle, and what it counts there:
# where friction settles, estimates are half of the error. Two: ``rollout.error_norms`` takes as many errors
LOOKS = ((0.125, 2.0), (0.5, 1.0))


def polynomials(order, column, done):  # type: ignore[no-untyped-def]
    """Weights of the substeps as polynomials of the part of the step that has passed.

    Parameters
    ----------
    order : int, of the dense output
    column, done : (rounds, lanes) int, as in ``steps.Scheme``; the columns beyond 1..order help as well

    Returns
    -------
    (order, rounds lanes) : row m - 1 holds the coefficients of part^m; the least that will do where there is a choice
    """
    used = column.ravel() > 0
    step = 1.0 / column.ravel()[used]
    part = (done.ravel()[used] + 1) * step
    terms = [(k, m) for k in range(order) for m in range(1, order - k + 1)]
    weights = np.linalg.pinv(np.array([step**k * part**m for k, m in terms]))
    found = np.zeros((order, used.size))
    found[:, used] = weights[:, [terms.index((0, m)) for m in range(1, order + 1)]].T
    return found


@non_allocating
def keep(turn, y, lanes, kept):  # type: ignore[no-untyped-def]
    """Keep what the lanes have reached in a round, less the state y (2 n + 2,) that the step began with."""
    k = len(ln.COLUMNS)
    n = (y.size - 2) // 2
    for j in range(k):
        row = kept[turn * k + j]
        for i in range(n):
            row[i] = lanes[((i + 1) * ln.ROW + ln.Q) * k + j] - y[i]
            row[n + i] = lanes[((i + 1) * ln.ROW + ln.W) * k + j] - y[n + i]
        row[2 * n] = lanes[ln.WORK * k + j] - y[2 * n]
        row[2 * n + 1] = lanes[ln.LOST * k + j] - y[2 * n + 1]


@summing
def weigh_terms(terms, part, weight):  # type: ignore[no-untyped-def]
    """Weights of the substeps where `part` of the step, 0..1, has passed, from their polynomials (p, ...)."""
    weight[:] = 0.0
    for m in range(terms.shape[0] - 1, -1, -1):
        for s in range(weight.size):
            weight[s] = (weight[s] + terms[m, s]) * part


@summing
def add_substeps(weight, kept, out):  # type: ignore[no-untyped-def]
    """Add to `out` (2 n + 2,) the kept substeps, each times its weight.

    `weight` (s,): s is a multiple of 4 (of whole rounds), and at most the number of rows of `kept`.
    """
    for s in range(0, weight.size, 4):  # four at once: `out` is read and written a quarter as often
        a, b, c, d = weight[s], weight[s + 1], weight[s + 2], weight[s + 3]
        for i in range(out.size):
            out[i] += (a * kept[s, i] + b * kept[s + 1, i]) + (c * kept[s + 2, i] + d * kept[s + 3, i])


@kernel
def new_substeps(n):  # type: ignore[no-untyped-def]
    """Room for the substeps of a chain of n links (MOST_SUBSTEPS, 2 n + 2), and for their weights."""
    return np.zeros((MOST_SUBSTEPS, 2 * n + 2)), np.zeros(MOST_SUBSTEPS)
