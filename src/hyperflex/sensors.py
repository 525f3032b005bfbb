"""Sensor models with derivatives, for identification and filters: angles, markers, accelerometers, motor torque."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, ByName, Indices
from hyperflex.core.chain.articulated_body import Chain
from hyperflex.core.chain.drive import ANGLE, Drive
from hyperflex.core.integrate.observation import observe, senses
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput
from hyperflex.model import PROPERTIES, Arm, Rope, Setup, unit_across, unit_along
from hyperflex.simulation import Interval, ParameterChange, arm_polynomials, commanded_accelerations
from hyperflex.trajectory import State

__all__ = ["Accelerometer", "Angles", "Markers", "Measurement", "MotorTorque", "PostureSensor", "Sensor", "lever_arms"]

ROUNDING = 1e-9  # of the rope's length: larger than the rounding error of sums of link lengths
ANGLE_STEP = 1e-5  # rad, and relative: step of differences, which have relative errors of 1e-10 for a smooth function
RATE_STEP = 1e-3  # rad/s: torque is quadratic in the rates, so only rounding errors occur


class Measurement(NamedTuple):
    """Channels of a sensor in a state x = (arm angle, q, arm rate, qd), and their derivatives.

    Attributes
    ----------
    y : (C,) float64
        The channels: rad, m, N m or m/s^2.
    H : (C, 2 n + 2) float64
        Their derivatives with respect to x.
    D : (C, 1) float64
        With respect to the arm's acceleration, per rad/s^2.
    """

    y: Array
    H: Array
    D: Array


class Sensor(Protocol):
    """Sensor of a rope on an arm."""

    def measure(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Measurement:
        """Return the channels in one state, with derivatives.

        Parameters
        ----------
        rope, arm : Rope, Arm
        state : State
            Unknown (None) ``arm_angle`` and ``arm_rate`` count as 0.
        acceleration : float
            Of the arm, rad/s^2; it has no effect on positions and angles.

        Raises
        ------
        InvalidInput
            If an argument cannot be used.
        """
        ...


def angles_and_rates(rope: Rope, arm: Arm, state: State) -> tuple[Array, Array]:
    """Return angles, rad, and rates, rad/s, (n + 1,) of the arm and all links, validated."""
    if not isinstance(rope, Rope) or not isinstance(arm, Arm) or not isinstance(state, State):
        got = [type(each).__name__ for each in (rope, arm, state)]
        raise InvalidInput("a sensor measures a rope on an arm", got=got, allowed="Rope, Arm, State")
    q, w = (checks.array(f"state {name}", getattr(state, name), (rope.n_links,)) for name in ("q", "qd"))
    angle = checks.number("state arm_angle", 0.0 if state.arm_angle is None else state.arm_angle, unit="rad")
    rate = checks.number("state arm_rate", 0.0 if state.arm_rate is None else state.arm_rate, unit="rad/s")
    return np.append(angle, q), np.append(rate, w)


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

    def measure(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Measurement:
        """Return the channels in one state, with derivatives; see :class:`Sensor`."""
        angles, _ = angles_and_rates(rope, arm, state)
        checks.number("acceleration", acceleration, unit="rad/s^2")
        n, angle, q = rope.n_links, angles[0], angles[None, 1:]
        dq, dpivot = np.zeros((1, n, 2 * n + 2)), np.zeros((1, 2, 2 * n + 2))
        dq[0, :, 1 : n + 1] = np.eye(n)
        dpivot[0, :, 0] = arm.length * unit_across(angle)
        y = self.predict(rope, q, arm.tip(np.array([angle])))[0].copy()
        slopes = self.jacobian(rope, q, dq, dpivot, np.zeros((n, 2 * n + 2)))[0]
        return Measurement(y, slopes, np.zeros((y.size, 1)))


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


class Accelerometer:
    """Proper acceleration (2,) of a point on a link, acceleration minus gravity, m/s^2, in the frame of the link.

    The frame is the world's, rotated by the link's angle q: x is (cos q, sin q), across the link, and y is
    (-sin q, cos q), along it towards the motor. A rope that hangs at rest reads (0, 9.81).

    Parameters
    ----------
    link : int
        Link with the sensor, from 0.
    arc_length : float
        Along the rope, m from the first joint; on that link, ends included. At a joint, the two links read
        differently.
    bias : (2,) array_like
        Reading in free fall without rotation, m/s^2.

    Attributes
    ----------
    values : (3,) float64
        Bias, m/s^2, and arc length, m.

    Raises
    ------
    InvalidInput
        If a value is not finite, or the link is no whole number from 0.

    Examples
    --------
    >>> import hyperflex as hf
    >>> from hyperflex.sensors import Accelerometer
    >>> rope = hf.Rope.uniform(length=2.0, mass=0.1, n_links=4, radius=0.002, friction=0.0)
    >>> seen = Accelerometer(1, 0.75).measure(rope, hf.Arm(length=0.1), hf.State(0.0, [0.0] * 4, [0.0] * 4))
    >>> abs(seen.y).round(9).tolist(), seen.H.shape, seen.D.shape
    ([0.0, 9.81], (2, 10), (2, 1))
    """

    def __init__(self, link: int, arc_length: float, bias: ArrayLike = (0.0, 0.0)) -> None:
        self.link = checks.count("link", link, least=0)
        self.arc_length = checks.number("arc_length", arc_length, unit="m")
        self.bias = checks.array("bias", bias, (2,), unit="m/s^2")
        self.values = np.append(self.bias, self.arc_length)

    def with_values(self, values: Array) -> "Accelerometer":
        """Return the same sensor with another bias and arc length (3,)."""
        return Accelerometer(self.link, float(values[2]), values[:2])

    def measure(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Measurement:
        """Return the measurement in one state, y (2,), with derivatives; see :class:`Sensor`.

        Raises
        ------
        InvalidInput
            If the point is not on the link, or an argument cannot be used.

        Notes
        -----
        Derivatives are exact, as in :func:`hyperflex.linearize`: in free flight, with joints locked that dry friction
        holds in this state. If a torque drives the arm, its acceleration depends on the state too: with A, B of
        ``linearize(..., command="torque")`` without `dt`, the derivatives are H + D A[n + 1] and D B[n + 1].
        """
        q, w, alphas, slopes = _moving(rope, arm, state, acceleration)
        link, arms = self.link + 1, np.append(arm.length, rope.length)  # the arm is treated as a link before the others
        arms[link:] = 0.0
        arms[link] = self._beyond(rope)
        dq, dw = np.eye(q.size, slopes.shape[1]), np.eye(q.size, slopes.shape[1], k=q.size)
        across, along = arms * unit_across(q, 0), arms * unit_along(q, 0)  # (2, n + 1)
        seen = across @ alphas - along @ w**2 - rope.gravity
        moved = across @ slopes - (along * alphas + across * w**2) @ dq - (2.0 * along * w) @ dw
        frame = np.array([unit_across(q[link]), -unit_along(q[link])])
        x, y = frame @ seen
        moved = frame @ moved + np.outer([y, -x], dq[link])
        return Measurement(self.bias + np.array([x, y]), moved[:, :-1], moved[:, -1:])

    def value_jacobian(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Array:
        """Return the derivatives (2, 3) by bias and arc length; arguments as of :meth:`measure`."""
        _, rates, alphas, _ = _moving(rope, arm, state, acceleration)
        self._beyond(rope)
        return np.column_stack([np.eye(2), [alphas[self.link + 1], rates[self.link + 1] ** 2]])

    def _beyond(self, rope: Rope) -> float:
        """Return the distance of the sensor from its link's first joint, m."""
        if self.link >= rope.n_links:
            raise InvalidInput("link is not of this rope", got=self.link, allowed=f"0 to {rope.n_links - 1}")
        begin = float(rope.length[: self.link].sum())
        end, faint = begin + float(rope.length[self.link]), ROUNDING * rope.total_length
        if not begin - faint <= self.arc_length <= end + faint:
            raise InvalidInput(
                f"arc_length is not on link {self.link}",
                got=self.arc_length,
                allowed=f"{begin:g} to {end:g} m",
                fix="Give the link that the place is on",
            )
        return self.arc_length - begin


def _moving(rope: Rope, arm: Arm, state: State, acceleration: float) -> tuple[Array, Array, Array, Array]:
    """Return angles, rates and accelerations (n + 1,) of the arm and all links, and the latter's derivatives."""
    angles, rates = angles_and_rates(rope, arm, state)
    u = checks.number("acceleration", acceleration, unit="rad/s^2")
    return angles, rates, *commanded_accelerations("acceleration", Setup(rope, None, arm), angles, rates, u)


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

    def measure(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Measurement:
        """Return the torque in one state, y (1,), with derivatives; see :class:`Sensor`.

        Inertia and friction are the sensor's own values, not those of `arm`.
        """
        angles, rates = angles_and_rates(rope, arm, state)
        motor = MotorTorque(arm).with_values(self.values)
        n, interval = rope.n_links, Interval(Setup(rope, None, arm).drive())
        u = checks.number("acceleration", acceleration, unit="rad/s^2")
        rows, _ = arm_polynomials("acceleration", 1.0)
        interval.set(0.0, 1.0, ANGLE, np.array([angles[0], rates[0], u]) @ rows)
        y = np.concatenate([angles[1:], rates[1:]])[None]
        parts = tuple({"coef": np.pad(row[None, None], ((0, 0), (ANGLE, 3 - ANGLE), (0, 0)))} for row in rows)
        t, chain, moved = np.zeros(1), rope.chain(), np.eye(2 * n, 2 * n + 3)[None]
        slopes = motor.jacobian(chain, interval.drive, parts, t, y, moved)
        order = [2 * n, *range(n), 2 * n + 1, *range(n, 2 * n)]
        return Measurement(motor.predict(chain, interval.drive, t, y), slopes[:, order], slopes[:, 2 * n + 2 :])

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
