"""Sensor models with derivatives, for identification and filters: angles, markers, motor torque."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, ByName, Indices
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import Drive
from hyperflex.core.integrate.observation import observe, senses
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput
from hyperflex.model import PROPERTIES, Arm, Rope, unit_across, unit_along
from hyperflex.simulation import ParameterChange
from hyperflex.trajectory import State

__all__ = ["Angles", "Markers", "Measurement", "MotorTorque", "PostureSensor", "lever_arms"]

ANGLE_STEP = 1e-5  # rad, and relative: step of differences, which have relative errors of 1e-10 for a smooth function
RATE_STEP = 1e-3  # rad/s: torque is quadratic in the rates, so only rounding errors occur


class Measurement(NamedTuple):
    """Channels of a sensor in a state x = (arm angle, q, arm rate, qd), and their derivatives.

    Attributes
    ----------
    y : (C,) float64
        The channels: rad or m.
    H : (C, 2 n + 2) float64
        Their derivatives with respect to x.
    """

    y: Array
    H: Array


class PostureSensor(ABC):
    """A sensor of the posture of a rope.

    `placed` is true if it measures positions, which depend on that of the first joint; `values` (V,) are the parameters
    of the sensor that can be fitted.
    """

    placed = False
    values = np.zeros(0)

    def with_values(self, values: Array) -> "PostureSensor":
        """Return the same sensor with other values (V,)."""
        return self

    @abstractmethod
    def predict(self, rope: Rope, q: Array, pivot: Array) -> Array:
        """Return channels (m, C) from angles (m, n), rad, and the first joint's positions (m, 2), m."""

    @abstractmethod
    def jacobian(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array) -> Array:
        """Return the channels' derivatives (m, C, D) from those of angles (m, n, D), pivot (m, 2, D), length (n, D)."""

    @abstractmethod
    def value_jacobian(self, rope: Rope, q: Array) -> Array:
        """Return derivatives of the channels with respect to the sensor's values (m, C, V)."""

    def measure(self, rope: Rope, arm: Arm, state: State) -> Measurement:
        """Return the channels in one state of a rope on an arm, with derivatives.

        Unknown (None) ``arm_angle`` of the state counts as 0. Raises InvalidInput if an argument cannot be used.
        """
        for name, value, kind in (("rope", rope, Rope), ("arm", arm, Arm), ("state", state, State)):
            checks.instance(name, value, kind)
        n, q = rope.n_links, checks.array("state q", state.q, (rope.n_links,))[None]
        angle = checks.number("state arm_angle", 0.0 if state.arm_angle is None else state.arm_angle, unit="rad")
        dq, dpivot = np.zeros((1, n, 2 * n + 2)), np.zeros((1, 2, 2 * n + 2))
        dq[0, :, 1 : n + 1] = np.eye(n)
        dpivot[0, :, 0] = arm.length * unit_across(np.array(angle))
        y = self.predict(rope, q, arm.tip(np.array([angle])))[0].copy()
        return Measurement(y, self.jacobian(rope, q, dq, dpivot, np.zeros((n, 2 * n + 2)))[0])


class Angles(PostureSensor):
    """Absolute link angles, rad, times `factor`: 1 for a calibrated sensor."""

    def __init__(self, factor: float = 1.0) -> None:
        self.values = np.array([checks.positive("factor", factor)])

    def with_values(self, values: Array) -> "Angles":
        return Angles(float(values[0]))

    def predict(self, rope: Rope, q: Array, pivot: Array) -> Array:
        return float(self.values[0]) * q

    def jacobian(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array) -> Array:
        return float(self.values[0]) * dq

    def value_jacobian(self, rope: Rope, q: Array) -> Array:
        return q[:, :, None]


class Markers(PostureSensor):
    """Positions of K markers along the rope, m, in channels x0, y0, x1, y1, ...

    Parameters
    ----------
    arc_lengths : (K,) array_like
        Distance along the rope from the first joint, m. Markers beyond the tip lie on the line of the last link, those
        before the first joint on the line of the first link.
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
    >>> rope = hf.Rope.uniform(length=2.0, mass=0.1, n_links=4, radius=0.002, friction=0.0)
    >>> seen = Markers([0.75, 2.0]).measure(rope, hf.Arm(length=0.1), hf.State(0.0, [0.0] * 4, [0.0] * 4))
    >>> seen.y.round(9).tolist(), seen.H.shape
    ([0.0, -0.85, 0.0, -2.1], (4, 10))
    """

    placed = True

    def __init__(self, arc_lengths: ArrayLike, origin: ArrayLike = (0.0, 0.0)) -> None:
        self.arc_lengths = checks.array("arc_lengths", arc_lengths, (-1,), unit="m")
        if not self.arc_lengths.size:
            raise InvalidInput("arc_lengths is empty", allowed="at least one marker")
        self.values = np.concatenate([checks.array("origin", origin, (2,), unit="m"), self.arc_lengths])

    def with_values(self, values: Array) -> "Markers":
        return Markers(values[2:], values[:2])

    def predict(self, rope: Rope, q: Array, pivot: Array) -> Array:
        places = self.values[:2] + pivot[:, None] + lever_arms(rope, self.arc_lengths)[1] @ unit_along(q)
        return places.reshape(q.shape[0], -1)

    def jacobian(self, rope: Rope, q: Array, dq: Array, dpivot: Array, dlength: Array) -> Array:
        link, arms = lever_arms(rope, self.arc_lengths)
        along, across = unit_along(q), unit_across(q)
        before = np.tril(np.ones((q.shape[1], q.shape[1])), -1)[link]  # (K, n): links before the link of each marker
        result = np.einsum("ki,mia,mid->mkad", arms, across, dq, optimize=True)
        if dlength.any():  # a marker keeps its arc length: longer links before it shorten its part of its own link
            result += np.einsum("ki,mia,id->mkad", before, along, dlength, optimize=True)
            result -= np.einsum("mka,kd->mkad", along[:, link], before @ dlength, optimize=True)
        result += dpivot[:, None]
        return np.asarray(result.reshape(q.shape[0], -1, dq.shape[2]))

    def value_jacobian(self, rope: Rope, q: Array) -> Array:
        link, _ = lever_arms(rope, self.arc_lengths)
        result = np.zeros((q.shape[0], link.size, 2, self.values.size))
        result[:, :, 0, 0] = result[:, :, 1, 1] = 1.0
        for k, i in enumerate(link):
            result[:, k, :, 2 + k] = unit_along(q[:, i])
        return result.reshape(q.shape[0], -1, self.values.size)


def lever_arms(rope: Rope, arc_lengths: Array) -> tuple[Indices, Array]:
    """Return the links (K,) of points at arc lengths (K,), m, and the length of each link before them (K, n), m.

    These lengths times the links' directions give the points. Points beyond the tip lie on the line of the last link,
    points before the first joint on the line of the first link.
    """
    ends = rope.link_ends
    link = np.minimum(np.searchsorted(ends, arc_lengths - 1e-12 * ends[-1]), rope.n_links - 1)
    arms = np.tril(np.ones((rope.n_links, rope.n_links)), -1)[link] * rope.length
    arms[np.arange(arc_lengths.size), link] = arc_lengths - (ends - rope.length)[link]
    return link, arms


class MotorTorque:
    """Torque (m,) of the motor of a prescribed `arm`, N m, as ``Trajectory.motor_torque`` defines it.

    The torque follows from the state at a sample without integration. Its derivatives are central differences with each
    joint slipping or sticking as in the sample, chained with the exact derivatives of the state. The sensor's values
    (4,) are the arm's inertia, kg m^2, viscous, N m s/rad, and dry friction, N m, and `constant`.

    Parameters
    ----------
    arm : Arm
    constant : float
        Torque over the reading: 1 for a torque in N m, the torque constant, N m/A, for a current.
    """

    def __init__(self, arm: Arm, constant: float = 1.0) -> None:
        self.arm = arm
        constant = checks.positive("constant", constant)
        self.values = np.array([arm.inertia, arm.friction, arm.dry_friction, constant])

    def with_values(self, values: Array) -> "MotorTorque":
        """Return the same sensor with other values (4,)."""
        inertia, friction, dry, constant = (float(each) for each in values)
        return MotorTorque(replace(self.arm, inertia=inertia, friction=friction, dry_friction=dry), constant)

    def predict(self, chain: Chain, drive: Drive, t: Array, y: Array) -> Array:
        """Return the torque (m,), N m, at times t (m,) and states y (m, 2n or more)."""
        return self._torque(chain, drive, t, y, senses(chain, drive, t, y))

    def jacobian(
        self, chain: Chain, drive: Drive, parts: tuple[ParameterChange, ...], t: Array, y: Array, dy: Array
    ) -> Array:
        """Return the torque's derivatives (m, 2n + P) by the initial state and by parameters whose changes are `parts`.

        `parts` are P changes of the chain, or of the drive's ``breaks`` and ``coef``; y is (m, 2n or more), dy
        (m, 2n, 2n + P) the derivatives of angles and rates along the same directions.
        """
        slip = senses(chain, drive, t, y)
        n = chain.length.size
        by_state = np.empty((t.size, 2 * n))
        for i in range(2 * n):
            step = ANGLE_STEP if i < n else RATE_STEP
            up, down = y.copy(), y.copy()
            up[:, i] += step
            down[:, i] -= step
            change = self._torque(chain, drive, t, up, slip) - self._torque(chain, drive, t, down, slip)
            by_state[:, i] = change / (2.0 * step)
        result: Array = np.einsum("mi,mid->md", by_state, dy)
        for k, part in enumerate(parts):
            up, down = (
                self._torque(*_changed(chain, drive, part, step), t, y, slip) for step in (ANGLE_STEP, -ANGLE_STEP)
            )
            result[:, 2 * n + k] += (up - down) / (2.0 * ANGLE_STEP)
        return result

    def value_jacobian(self, chain: Chain, drive: Drive, t: Array, y: Array) -> Array:
        """Return derivatives of the torque (m, 4) with respect to the sensor's values."""
        _, _, rate, acceleration = self._seen(chain, drive, t, y, np.ones((t.size, chain.length.size))).T
        sense = np.sign(np.where(rate != 0.0, rate, acceleration))
        by_torque = -self.predict(chain, drive, t, y)
        return np.asarray(np.stack([acceleration, rate, sense, by_torque], axis=1) / self.values[3])

    def _torque(self, chain: Chain, drive: Drive, t: Array, y: Array, slip: Array) -> Array:
        rope, angle, rate, acceleration = self._seen(chain, drive, t, y, slip).T
        shaft = self.arm.shaft_torque(np.array([chain.gx, chain.gy]), angle, rate, acceleration)
        return np.asarray((rope + shaft) / self.values[3])

    @staticmethod
    def _seen(chain: Chain, drive: Drive, t: Array, y: Array, slip: Array) -> Array:
        """Load of the rope on the shaft, N m, and angle, rate and acceleration of the arm (m, 4)."""
        base, scalars = np.empty((t.size, 9)), np.empty((t.size, 5))
        observe(chain, drive, t, y, slip, np.empty((t.size, chain.length.size)), base, scalars)
        acceleration, rate, angle = base[:, 2:5].T
        pull = np.cos(angle) * scalars[:, 2] + np.sin(angle) * scalars[:, 3]
        return np.stack([scalars[:, 4] + drive.arm_length * pull, angle, rate, acceleration], axis=1)


def _changed(chain: Chain, drive: Drive, part: ParameterChange, step: float) -> tuple[Chain, Drive]:
    """Return chain and drive with their properties changed by `step` times `part`."""
    of_chain, of_drive = ByName(), ByName()
    for name, change in part.items():
        known = PROPERTIES.get(name)
        if name in ("breaks", "coef"):
            of_drive[name] = getattr(drive, name) + step * change
        elif name == "arm_length":
            of_drive[name] = drive.arm_length + step * float(change[0])
        elif name == "gravity":
            of_chain |= {"gx": chain.gx + step * float(change[0]), "gy": chain.gy + step * float(change[1])}
        elif known is not None and known.field:
            by = change if known.owner == "link" else float(change[0])
            of_chain[known.field] = getattr(chain, known.field) + step * by
    return read_only(chain._replace(**of_chain)), read_only(drive._replace(**of_drive))
