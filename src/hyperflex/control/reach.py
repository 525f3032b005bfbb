"""When the tip first is as far out as wanted."""

from __future__ import annotations

import numpy as np

from hyperflex.checks import Array

SHORTFALL_COST = 3.0  # s/m


def reach_time(t: Array, reach: Array, wanted: float) -> Array:
    """Return when a reach first is there.

    Parameters
    ----------
    t : (T,) float64
        Time, s.
    reach : (m, T) float64
        ``|x|`` of the tip in m ways, m.
    wanted : float
        m.

    Returns
    -------
    (m,) float64
        Time, s, straight between samples; inf where it is never reached.

    Examples
    --------
    >>> reach_time(np.array([0.0, 1.0, 2.0]), np.array([[0.0, 0.5, 1.5], [0.0, 0.1, 0.2]]), 1.0)
    array([1.5, inf])
    """
    beyond = reach >= wanted
    k = beyond.argmax(axis=1)
    rows = np.arange(len(reach))
    before = np.maximum(k - 1, 0)
    rise = reach[rows, k] - reach[rows, before]
    part = np.where((k > 0) & (rise > 0.0), (wanted - reach[rows, before]) / np.where(rise > 0.0, rise, 1.0), 1.0)
    return np.where(beyond.any(axis=1), t[before] + part * (t[k] - t[before]), np.inf)


def soonest(t: Array, reach: Array, wanted: float) -> Array:
    """Return when a reach (m, T) first is there (m,), s; where it never is, later than that by what is missing."""
    first = reach_time(t, reach, wanted)
    return np.where(np.isfinite(first), first, t[-1] + SHORTFALL_COST * (wanted - reach.max(axis=1)))
