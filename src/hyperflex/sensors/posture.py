"""Posture sensors: link angles, or positions of markers along the rope."""

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Rope
from hyperflex.sensors.sensor import Measurement, angles_and_rates
from hyperflex.trajectory import State


class PostureSensor(ABC):
    """A sensor of the posture of a rope.

    `placed` is true if it measures places, which depend on the first joint's; `values` (V,) are parameters of the
    sensor that may be fitted.
    """

    placed = False
    values = np.zeros(0)

    def with_values(self, values: Array) -> "PostureSensor":
        """Return the same sensor with other values (V,)."""
        return self

    @abstractmethod
    def predict(self, rope: Rope, q: Array, pivot: Array) -> Array:
        """Return channels (m, C) from angles (m, n), rad, and the first joint's places (m, 2), m."""

    @abstractmethod
    def jacobian(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array) -> Array:
        """Return their derivatives (m, C, D) from those of angles (m, n, D), pivot (m, 2, D) and lengths (n, D)."""

    @abstractmethod
    def value_jacobian(self, rope: Rope, q: Array) -> Array:
        """Return their derivatives with respect to the sensor's values (m, C, V)."""

    def measure(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Measurement:
        """Return the channels in one state, with derivatives; see :class:`Sensor`."""
        angles, _ = angles_and_rates(rope, arm, state)
        checks.number("acceleration", acceleration, unit="rad/s^2")
        n, angle, q = rope.n_links, angles[0], angles[None, 1:]
        dq, dpivot = np.zeros((1, n, 2 * n + 2)), np.zeros((1, 2, 2 * n + 2))
        dq[0, :, 1 : n + 1] = np.eye(n)
        dpivot[0, :, 0] = arm.length * np.array([np.cos(angle), np.sin(angle)])
        y = self.predict(rope, q, arm.tip(np.array([angle])))[0].copy()
        slopes = self.jacobian(rope, q, dq, dpivot, np.zeros((n, 2 * n + 2)))[0]
        return Measurement(y, slopes, np.zeros((y.size, 1)))


class Angles(PostureSensor):
    """Absolute link angles, rad, times `factor`: 1 for a calibrated sensor."""

    def __init__(self, factor: float = 1.0) -> None:
        self.values = np.array([checks.number("factor", factor, sign="positive")])

    def with_values(self, values: Array) -> "Angles":
        return Angles(float(values[0]))

    def predict(self, rope: Rope, q: Array, pivot: Array) -> Array:
        return float(self.values[0]) * q

    def jacobian(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array) -> Array:
        return float(self.values[0]) * dq

    def value_jacobian(self, rope: Rope, q: Array) -> Array:
        return q[:, :, None]


class Markers(PostureSensor):
    """Places of K markers along the rope, m, in channels x0, y0, x1, y1, ...

    Parameters
    ----------
    arc_lengths : (K,) array_like
        Distance along the rope from the first joint, m. Markers beyond the tip lie on the last link's line; those
        before the first joint on the first's.
    origin : (2,) array_like
        Origin in the camera's frame, m.

    Raises
    ------
    InvalidInput
        If a value is not finite, or there is no marker.

    Examples
    --------
    >>> import hyperflex as hf
    >>> from hyperflex.sensors import Markers
    >>> rope = hf.Rope.uniform(length=2.0, mass=0.1, n_links=4, radius=0.002)
    >>> seen = Markers([0.75, 2.0]).measure(rope, hf.Arm(length=0.1), hf.State(0.0, [0.0] * 4, [0.0] * 4))
    >>> seen.y.round(9).tolist(), seen.H.shape
    ([0.0, -0.85, 0.0, -2.1], (4, 10))
    """

    placed = True

    def __init__(self, arc_lengths: npt.ArrayLike, origin: npt.ArrayLike = (0.0, 0.0)) -> None:
        self.arc_lengths = checks.array("arc_lengths", arc_lengths, (-1,), unit="m")
        if not self.arc_lengths.size:
            raise InvalidInput("arc_lengths is empty", allowed="at least one marker")
        self.values = np.concatenate([checks.array("origin", origin, (2,), unit="m"), self.arc_lengths])

    def with_values(self, values: Array) -> "Markers":
        return Markers(values[2:], values[:2])

    def predict(self, rope: Rope, q: Array, pivot: Array) -> Array:
        along = np.stack([np.sin(q), -np.cos(q)], axis=2)
        places = self.values[:2] + pivot[:, None] + lever_arms(rope, self.arc_lengths)[1] @ along
        return np.asarray(places.reshape(q.shape[0], -1))

    def jacobian(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array) -> Array:
        link, arms = lever_arms(rope, self.arc_lengths)
        along = np.stack([np.sin(q), -np.cos(q)], axis=2)
        across = np.stack([np.cos(q), np.sin(q)], axis=2)
        before = np.tril(np.ones((q.shape[1], q.shape[1])), -1)[link]  # (K, n): which links lie before a marker's own
        result = np.einsum("ki,mia,mid->mkad", arms, across, dq, optimize=True)
        if dlength.any():  # a marker keeps its arc length: links before it grow, its part of its own link shrinks
            result += np.einsum("ki,mia,id->mkad", before, along, dlength, optimize=True)
            result -= np.einsum("mka,kd->mkad", along[:, link], before @ dlength, optimize=True)
        result += dpivot[:, None]
        return np.asarray(result.reshape(q.shape[0], -1, dq.shape[2]))

    def value_jacobian(self, rope: Rope, q: Array) -> Array:
        link, _ = lever_arms(rope, self.arc_lengths)
        result = np.zeros((q.shape[0], link.size, 2, self.values.size))
        result[:, :, 0, 0] = result[:, :, 1, 1] = 1.0
        for k, i in enumerate(link):
            result[:, k, 0, 2 + k], result[:, k, 1, 2 + k] = np.sin(q[:, i]), -np.cos(q[:, i])
        return result.reshape(q.shape[0], -1, self.values.size)


def lever_arms(rope: Rope, arc_lengths: Array) -> tuple[npt.NDArray[np.intp], Array]:
    """Return the links (K,) of points at arc lengths (K,), m, and the length of each link before them (K, n), m.

    The latter times the links' directions gives the points; beyond the tip they lie on the line of the last link,
    before the first joint on that of the first.
    """
    ends = np.cumsum(rope.length)
    link = np.minimum(np.searchsorted(ends, arc_lengths - 1e-12 * ends[-1]), rope.n_links - 1)
    arms = np.tril(np.ones((rope.n_links, rope.n_links)), -1)[link] * rope.length
    arms[np.arange(arc_lengths.size), link] = arc_lengths - (ends - rope.length)[link]
    return link, arms
