"""Accelerometer on a link of the rope: proper acceleration in the link's own frame, with its derivatives."""

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.drive import ANGLE
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Rope, Setup
from hyperflex.sensors.sensor import Measurement, angles_and_rates
from hyperflex.simulation import (
    Interval,
    acceleration_jacobian,
    arm_polynomials,
    link_accelerations,
    set_commands,
    state_directions,
)
from hyperflex.trajectory import State

ROUNDING = 1e-9  # of the rope's length: more than the rounding error of sums of link lengths
POWERS = arm_polynomials("acceleration", 1.0)[0]


class Accelerometer:
    """Proper acceleration (2,) of a place on a link, acceleration less gravity, m/s^2, in the link's own frame.

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
    >>> rope = hf.Rope.uniform(length=2.0, mass=0.1, n_links=4, radius=0.002)
    >>> seen = Accelerometer(1, 0.75).measure(rope, hf.Arm(length=0.1), hf.State(0.0, [0.0] * 4, [0.0] * 4))
    >>> abs(seen.y).round(9).tolist(), seen.H.shape, seen.D.shape
    ([0.0, 9.81], (2, 10), (2, 1))
    """

    def __init__(self, link: int, arc_length: float, bias: npt.ArrayLike = (0.0, 0.0)) -> None:
        self.link = checks.count("link", link, least=0)
        self.arc_length = checks.number("arc_length", arc_length, unit="m")
        self.bias = checks.array("bias", bias, (2,), unit="m/s^2")
        self.values = np.append(self.bias, self.arc_length)

    def with_values(self, values: Array) -> "Accelerometer":
        """Return the same sensor with another bias and arc length (3,)."""
        return Accelerometer(self.link, float(values[2]), values[:2])

    def measure(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Measurement:
        """Return what is seen in one state, y (2,), with derivatives; see :class:`Sensor`.

        Raises
        ------
        InvalidInput
            If the place is not on the link, or an argument cannot be used.

        Notes
        -----
        Exact derivatives, as those of :func:`hyperflex.linearize`: free flight, joints that dry friction holds in this
        state locked. Where a torque drives the arm, its acceleration depends on the state too: let A, B be those of
        ``linearize(..., command="torque")`` without `dt`; then H + D A[n + 1] and D B[n + 1] are the derivatives.
        """
        angles, rates, interval = _moving(rope, arm, state, acceleration)
        n, beyond = rope.n_links, self._beyond(rope)
        chain, start = rope.chain(), (angles[1:], rates[1:])
        by_state, seeds = state_directions("acceleration", chain, interval.drive)
        set_commands("acceleration", seeds, POWERS)

        # the arm is treated as a link before the others
        alphas, slopes = (
            np.append(acceleration, link_accelerations(chain, interval.drive, 0.0, *start)),
            np.zeros((n + 1, 2 * n + 3)),
        )
        slopes[0, -1] = 1.0
        slopes[1:] = acceleration_jacobian(chain, interval.drive, start, seeds, by_state)[:, : 2 * n + 3]
        lengths = np.append(arm.length, rope.length)
        y, dy = _seen(lengths, rope.gravity, self.link + 1, beyond, angles, rates, alphas, slopes)
        return Measurement(y + self.bias, dy[:, :-1], dy[:, -1:])

    def value_jacobian(self, rope: Rope, arm: Arm, state: State, acceleration: float = 0.0) -> Array:
        """Return the derivatives (2, 3) by bias and arc length; arguments as of :meth:`measure`."""
        self._beyond(rope)
        angles, rates, interval = _moving(rope, arm, state, acceleration)
        alphas = link_accelerations(rope.chain(), interval.drive, 0.0, angles[1:], rates[1:])
        return np.column_stack([np.eye(2), [alphas[self.link], rates[self.link + 1] ** 2]])

    def _beyond(self, rope: Rope) -> float:
        """Return how far beyond its link's first joint it sits, m."""
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


def _moving(rope: Rope, arm: Arm, state: State, acceleration: float) -> tuple[Array, Array, Interval]:
    """Return angles and rates (n + 1,) of the arm and all links, checked, and the interval that drives the arm so."""
    angles, rates = angles_and_rates(rope, arm, state)
    u = checks.number("acceleration", acceleration, unit="rad/s^2")
    interval = Interval(Setup(rope, None, arm).drive())
    interval.set(0.0, 1.0, ANGLE, np.array([angles[0], rates[0], u]) @ POWERS)
    return angles, rates, interval


def _seen(
    lengths: Array, gravity: Array, link: int, beyond: float, q: Array, w: Array, alphas: Array, dalphas: Array
) -> tuple[Array, Array]:
    """Return proper acceleration (2,) and its derivatives (2, 2 N + 1) by angles, rates and arm acceleration.

    Parameters
    ----------
    lengths, q, w, alphas : (N,) arrays
        Of the arm and all links, m, rad, rad/s, rad/s^2.
    link, beyond : int, float
        Which of them, and how far from its first joint, m.
    dalphas : (N, 2 N + 1) array
        Derivatives of `alphas`.
    """
    dq, dw = np.eye(q.size, dalphas.shape[1]), np.eye(q.size, dalphas.shape[1], k=q.size)
    across, along = np.stack([np.cos(q), np.sin(q)]), np.stack([np.sin(q), -np.cos(q)])  # (2, N)
    before = slice(0, link)
    joint = (across * alphas - along * w**2)[:, before] @ lengths[before] - gravity
    turned = -(along * alphas + across * w**2)  # by the angle of each
    djoint = (across * lengths)[:, before] @ dalphas[before] + (turned * lengths)[:, before] @ dq[before]
    djoint -= (2.0 * along * w * lengths)[:, before] @ dw[before]
    frame = np.stack([across[:, link], -along[:, link]])
    x, y = frame @ joint
    own = frame @ djoint + np.outer([y, -x], dq[link])
    own += beyond * np.stack([dalphas[link], 2.0 * w[link] * dw[link]])
    return np.array([x, y]) + beyond * np.array([alphas[link], w[link] ** 2]), own
