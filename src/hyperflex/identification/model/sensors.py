"""What is measured, as a function of the rope's state: link angles, or places along the rope."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hyperflex.checks import Array
from hyperflex.model import Rope


class Sensor(Protocol):
    """Turns angles into what is measured; `pivot` and `dpivot` matter only where `placed`."""

    placed: bool

    def see(self, rope: Rope, pivot: Array, q: Array, own: Array) -> Array:
        """Return channels (m, C) from the first joint's places (m, 2), angles (m, n) and the sensor's values (V,)."""
        ...

    def slopes(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array, own: Array) -> Array:
        """Return their derivatives (m, C, D) from those of angles (m, n, D), pivot (m, 2, D) and lengths (n, D)."""
        ...

    def own_slopes(self, rope: Rope, q: Array, own: Array) -> Array:
        """Return their derivatives with respect to the sensor's values (m, C, V)."""
        ...


class Angles:
    """Absolute link angles, rad; it has no values of its own."""

    placed = False

    def see(self, rope: Rope, pivot: Array, q: Array, own: Array) -> Array:
        """Return channels (m, C)."""
        return q

    def slopes(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array, own: Array) -> Array:
        """Return derivatives of the channels (m, C, D)."""
        return dq

    def own_slopes(self, rope: Rope, q: Array, own: Array) -> Array:
        """Return derivatives with respect to the values of the sensor (m, C, V)."""
        return np.zeros((*q.shape, 0))


class Places:
    """Places of K markers along the rope, m, in channels x0, y0, x1, y1, ...

    Its values (2 + K,): where the camera sees the origin (x, y), m, and how far along the rope each marker sits, m.
    Markers beyond the tip lie on the last link's line; those before the first joint on the first's.
    """

    placed = True

    def see(self, rope: Rope, pivot: Array, q: Array, own: Array) -> Array:
        """Return channels (m, C)."""
        link, beyond = self._on(rope, own[2:])
        along = np.stack([np.sin(q), -np.cos(q)], axis=2)  # (m, n, 2)
        joints = np.cumsum(rope.length[:, None] * along, axis=1) - rope.length[:, None] * along
        places = own[:2] + pivot[:, None] + joints[:, link] + beyond[:, None] * along[:, link]
        result: Array = places.reshape(q.shape[0], -1)
        return result

    def slopes(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array, own: Array) -> Array:
        """Return derivatives of the channels (m, C, D)."""
        link, beyond = self._on(rope, own[2:])
        along = np.stack([np.sin(q), -np.cos(q)], axis=2)
        across = np.stack([np.cos(q), np.sin(q)], axis=2)
        before = np.tril(np.ones((q.shape[1], q.shape[1])), -1)[link]  # (K, n): which links lie before a marker's own
        arms = before * rope.length
        arms[np.arange(link.size), link] = beyond
        result = np.einsum("ki,mia,mid->mkad", arms, across, dq, optimize=True)
        if dlength.any():  # a marker keeps its distance along the rope: what is longer before it is shorter in its link
            result += np.einsum("ki,mia,id->mkad", before, along, dlength, optimize=True)
            result -= np.einsum("mka,kd->mkad", along[:, link], before @ dlength, optimize=True)
        result += dpivot[:, None]
        return np.asarray(result.reshape(q.shape[0], -1, dq.shape[2]))

    def own_slopes(self, rope: Rope, q: Array, own: Array) -> Array:
        """Return derivatives with respect to the values of the sensor (m, C, V)."""
        link, _ = self._on(rope, own[2:])
        result = np.zeros((q.shape[0], link.size, 2, own.size))
        result[:, :, 0, 0] = result[:, :, 1, 1] = 1.0
        for k, i in enumerate(link):
            result[:, k, 0, 2 + k], result[:, k, 1, 2 + k] = np.sin(q[:, i]), -np.cos(q[:, i])
        return result.reshape(q.shape[0], -1, own.size)

    @staticmethod
    def _on(rope: Rope, arcs: Array) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], Array]:
        """Return on which link each marker sits, and how far beyond its first joint, m."""
        ends = np.cumsum(rope.length)
        link = np.minimum(np.searchsorted(ends, arcs - 1e-12 * ends[-1]), rope.n_links - 1)
        return link, arcs - (ends - rope.length)[link]
