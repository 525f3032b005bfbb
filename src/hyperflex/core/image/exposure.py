"""Moving capsules integrated over the exposure of each row of a picture."""

from typing import NamedTuple

import numpy as np

from hyperflex.core.jit import kernel


class Capsules(NamedTuple):
    """S moving capsules (segments with a radius), from back to front.

    Attributes
    ----------
    ends : (K, S, 4) float64
        u, v of both ends at K >= 2 equally spaced times, px.
    radii : (S,) float64
        px.
    layers : (S,) int64
        Not decreasing. Capsules of one layer form one shape; each layer covers the layers before it.
    colours : (S, 3) float32
        Three channels, 0 to 255.
    """

    ends: np.ndarray
    radii: np.ndarray
    layers: np.ndarray
    colours: np.ndarray


class RowTimes(NamedTuple):
    """Exposure times of rows, in steps between the K times: row v at first + v slope, for a duration around it.

    Attributes
    ----------
    first, slope, duration : float
        In steps.
    samples : int
        Instants over which the exposure is averaged.
    """

    first: float
    slope: float
    duration: float
    samples: int


@kernel
def expose(capsules, times, out):  # type: ignore[no-untyped-def]
    """Average the capsules' cover and colours over the exposure of each row.

    Parameters
    ----------
    capsules, times : Capsules, RowTimes
    out : (height, width, 4) float32
        Zeros on entry; on return colour times cover, and cover, 0 to 1.

    Notes
    -----
    A pixel is covered by 1/2 + r - d, cut to 0 and 1, at a distance d from the capsule's axis: exact for a straight
    edge through its middle along rows or columns, and symmetric, so that discs are not displaced.
    """
    height, width = out.shape[0], out.shape[1]
    steps, count = capsules.ends.shape[0], capsules.radii.size
    low, high = np.empty(count), np.empty(count)
    for s in range(count):
        low[s] = min(capsules.ends[:, s, 1].min(), capsules.ends[:, s, 3].min()) - capsules.radii[s] - 1.0
        high[s] = max(capsules.ends[:, s, 1].max(), capsules.ends[:, s, 3].max()) + capsules.radii[s] + 1.0
    active = np.empty(count, np.int64)
    cover, tint = np.zeros(width, np.float32), np.zeros(width, np.int64)
    row = np.zeros((width, 4), np.float32)
    share = np.float32(1.0 / times.samples)
    for v in range(height):
        n = 0
        for s in range(count):
            if low[s] <= v <= high[s]:
                active[n] = s
                n += 1
        if n == 0:
            continue
        for j in range(times.samples):
            tau = times.first + v * times.slope + times.duration * ((j + 0.5) / times.samples - 0.5)
            tau = min(max(tau, 0.0), steps - 1.000001)
            k = int(tau)
            far = tau - k
            near = 1.0 - far
            left, right = width, -1
            first, last = width, -1
            layer = np.int64(-1)
            for m in range(n):
                s = active[m]
                if capsules.layers[s] != layer:
                    put_over(row, cover, tint, capsules.colours, first, last)
                    left, right = min(left, first), max(right, last)
                    first, last = width, -1
                    layer = capsules.layers[s]
                here, there = capsules.ends[k, s], capsules.ends[k + 1, s]
                au, av = near * here[0] + far * there[0], near * here[1] + far * there[1]
                bu, bv = near * here[2] + far * there[2], near * here[3] + far * there[3]
                begin, end = cover_row(cover, tint, s, v, au, av, bu, bv, capsules.radii[s])
                first, last = min(first, begin), max(last, end)
            put_over(row, cover, tint, capsules.colours, first, last)
            left, right = min(left, first), max(right, last)
            for u in range(left, right + 1):
                for c in range(4):
                    out[v, u, c] += share * row[u, c]
                    row[u, c] = 0.0


@kernel
def cover_row(cover, tint, s, v, au, av, bu, bv, radius):  # type: ignore[no-untyped-def]
    """Raise the cover of row v to that of capsule s from a to b; return the first and last column that it may touch."""
    width = cover.size
    reach = radius + 1.0
    if min(av, bv) - reach > v or max(av, bv) + reach < v:
        return width, -1
    du, dv = bu - au, bv - av
    t0, t1 = 0.0, 1.0
    if abs(dv) > 1e-9:  # the part of the axis near the row
        ta, tb = (v - reach - av) / dv, (v + reach - av) / dv
        t0, t1 = max(0.0, min(ta, tb)), min(1.0, max(ta, tb))
    ua, ub = au + t0 * du, au + t1 * du
    low, high = min(ua, ub) - reach, max(ua, ub) + reach
    if high < 0.0 or low > width - 1:
        return width, -1
    first, last = int(max(low, 0.0)), int(min(high + 1.0, width - 1.0))
    square = du * du + dv * dv
    scale = 1.0 / square if square > 1e-12 else 0.0
    full = min(1.0, 2.0 * radius)
    for u in range(first, last + 1):
        pu, pv = u - au, v - av
        t = min(max((pu * du + pv * dv) * scale, 0.0), 1.0)
        qu, qv = pu - t * du, pv - t * dv
        value = min(0.5 + radius - np.sqrt(qu * qu + qv * qv), full)
        if value > cover[u]:
            cover[u] = value
            tint[u] = s
    return first, last


@kernel
def put_over(row, cover, tint, colours, first, last):  # type: ignore[no-untyped-def]
    """Lay a layer with its cover over a row (colour times cover, cover) between two columns, and clear the cover."""
    for u in range(first, last + 1):
        value = cover[u]
        if value > 0.0:
            for c in range(3):
                row[u, c] += value * (colours[tint[u], c] - row[u, c])
            row[u, 3] += value * (1.0 - row[u, 3])
            cover[u] = 0.0
