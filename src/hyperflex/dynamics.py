"""The paper's equations (1)-(3): mass matrix, bias and partial linearization.

Coordinates are absolute angles, the arm's (index a) before the rope's (index u): with the arm's inertia and friction,
M [a; u] + bias = [tau; 0], where bias gathers the centrifugal, potential and friction terms, C + P - F.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain import articulated_body as core
from hyperflex.core.chain.drive import ANGLE
from hyperflex.core.integrate.observation import observe, senses
from hyperflex.core.read_only import read_only
from hyperflex.errors import InvalidInput
from hyperflex.model import Arm, Rope, Setup
from hyperflex.simulation import Interval, Stepper, commanded_accelerations, setup_for


class PartialLinearization(NamedTuple):
    """Equation (2): with the arm's acceleration u as input, the rope's accelerations are ``a_u + b_u * u``.

    Attributes
    ----------
    a_u : (n,) float64
        A_u = -M_uu^-1 (C_u + P_u - F_u), rad/s^2.
    b_u : (n,) float64
        B_u = -M_uu^-1 M_ua.
    effective_inertia : float
        M_aa + M_ua^T B_u, kg m^2: the inertia at the motor.
    arm_bias : float
        C_a + P_a - F_a + M_ua^T A_u, N m: the torque at which the arm does not accelerate.
    """

    a_u: Array
    b_u: Array
    effective_inertia: float
    arm_bias: float


def mass_matrix(rope: Rope, q: ArrayLike, *, arm: Arm | None = None, arm_angle: float = 0.0) -> Array:
    """Return the inertia matrix M of (1) in absolute angles.

    Parameters
    ----------
    rope : Rope
    q : (n,) array_like
        Link angles, rad.
    arm : Arm, optional
        With an arm the matrix has its row and column first.
    arm_angle : float
        Angle of the arm, rad.

    Returns
    -------
    (n, n) or (n + 1, n + 1) float64
        kg m^2, symmetric and positive definite (positive semidefinite for an arm without inertia).

    Notes
    -----
    Cost O(n^2). Paper (1); docs/models.md (M.4).
    """
    angles = _joined(rope, q, "q", "rad", arm, arm_angle)
    chain = rope.chain() if arm is None else arm.chain(rope)
    result = np.empty((angles.size, angles.size))
    core.mass_matrix(chain, angles, result)
    return result


def forward_kinematics(rope: Rope, q: ArrayLike, *, arm: Arm | None = None, arm_angle: ArrayLike = 0.0) -> Array:
    """Return the positions of the joints and the tip.

    Parameters
    ----------
    rope : Rope
    q : (..., n) array_like
        Link angles, rad.
    arm : Arm, optional
        Without one the first joint is at the origin.
    arm_angle : (...) array_like
        Angle of the arm, rad.

    Returns
    -------
    (..., n + 1, 2) float64
        Joints from the motor to the tip, m; x to the right, y upwards. For points between joints see
        :class:`hyperflex.sensors.Markers`.

    Examples
    --------
    >>> import hyperflex as hf
    >>> rope = hf.Rope.uniform(length=2.0, mass=0.1, n_links=2, radius=0.002, friction=0.0)
    >>> hf.forward_kinematics(rope, [0.0, 0.0], arm=hf.Arm(length=0.5)).tolist()
    [[0.0, -0.5], [0.0, -1.5], [0.0, -2.5]]
    """
    checks.instance("rope", rope, Rope)
    angles = checks.array("q", q, None, unit="rad")
    angles = checks.array("q", angles, (*angles.shape[:-1], rope.n_links), unit="rad")
    turned = checks.array("arm_angle", arm_angle, angles.shape[:-1], scalar=True, unit="rad")
    base = np.zeros((*turned.shape, 2)) if arm is None else checks.instance("arm", arm, Arm).tip(turned)
    return rope.joints(angles, base)


def linearize(
    rope: Rope,
    arm: Arm,
    q: ArrayLike,
    qd: ArrayLike,
    arm_angle: float = 0.0,
    arm_rate: float = 0.0,
    *,
    command: str = "acceleration",
    u: float = 0.0,
    dt: float | None = None,
) -> tuple[Array, Array]:
    """Return A and B of rope and arm about a state x = (arm angle, q, arm rate, qd) and a command u.

    Parameters
    ----------
    rope, arm : Rope, Arm
    q, qd : (n,) array_like
        Link angles, rad, and rates, rad/s.
    arm_angle, arm_rate : float
        Of the arm, rad and rad/s.
    command : {"acceleration", "torque", "angle"}
        Meaning of u: the arm's acceleration, rad/s^2, or the motor's torque, N m; with `dt` also the arm's angle, rad
        (see :class:`hyperflex.Stepper`).
    u : float
    dt : float, optional
        Interval, s: A x + B u is then x after the interval, to first order; without `dt` it is dx/dt.

    Returns
    -------
    A : (2 n + 2, 2 n + 2) float64
    B : (2 n + 2, 1) float64

    Raises
    ------
    InvalidInput
        If an argument cannot be used.

    Notes
    -----
    Exact derivatives, as (M.19)-(M.25), not differences; O(n^2). Joints that stick in this state are locked. For a
    sequence of states use the faster :meth:`hyperflex.Stepper.linearize`.
    """
    checks.instance("rope", rope, Rope)
    q, qd = (checks.array(name, value, (rope.n_links,)) for name, value in (("q", q), ("qd", qd)))
    if np.isfinite(rope.max_bend).any():
        raise InvalidInput("derivatives are of free flight", got="a rope with joint limits", fix="Leave max_bend out")
    if dt is not None:
        stepper = Stepper(rope, arm=arm, command=command)
        begin = stepper.start(q, qd, arm_angle=arm_angle, arm_rate=arm_rate)
        over = stepper.linearize(begin, u, dt)
        return over.A, over.B
    if command == "angle":
        raise InvalidInput("an angle is commanded over an interval", got="no dt", fix="Give dt")
    checks.choice("command", command, ("acceleration", "torque"))
    angles, rates = _joined(rope, q, "q", "rad", arm, arm_angle), _joined(rope, qd, "qd", "rad/s", arm, arm_rate)
    setup = setup_for(command, Setup(rope, None, arm))
    _, slopes = commanded_accelerations(command, setup, angles, rates, checks.number("u", u))
    result = np.concatenate([np.eye(angles.size, slopes.shape[1], angles.size), slopes])
    return result[:, :-1].copy(), result[:, -1:].copy()


def bias(
    rope: Rope,
    q: ArrayLike,
    qd: ArrayLike,
    *,
    arm: Arm | None = None,
    arm_angle: float = 0.0,
    arm_rate: float = 0.0,
) -> Array:
    """Return C + P - F of (1), N m: the torques (n,) that keep every acceleration at zero at q, rad, and qd, rad/s.

    With an arm, which has an angle, rad, and a rate, rad/s, there are n + 1 torques, the arm's first.

    Notes
    -----
    From the accelerations of one O(n) sweep: bias = -M qdd for tau = 0. Dry friction is included for rotating joints; a
    joint at rest transmits the torque that the motion requires, which is unknown here. Paper (1).
    """
    angles = _joined(rope, q, "q", "rad", arm, arm_angle)
    rates = _joined(rope, qd, "qd", "rad/s", arm, arm_rate)
    chain = rope.chain() if arm is None else arm.chain(rope)
    result = np.empty(angles.size)
    sense = np.sign(np.diff(rates, prepend=0.0))
    chain = read_only(chain._replace(dry=np.where(sense == 0.0, 0.0, chain.dry)))
    slip = np.where(sense == 0.0, 1.0, sense)
    core.accelerations(chain, angles, rates, slip, np.zeros(7), 0.0, 0.0, result, np.empty(6 * angles.size))
    mass = np.empty((angles.size, angles.size))
    core.mass_matrix(chain, angles, mass)
    return -mass @ result


def partial_linearization(
    rope: Rope, arm: Arm, q: ArrayLike, qd: ArrayLike, arm_angle: float, arm_rate: float
) -> PartialLinearization:
    """Return A_u and B_u of (2) and the terms of (3), by two O(n) sweeps; angles in rad, rates in rad/s.

    Notes
    -----
    Joints that dry friction holds while the arm keeps its rate (u = 0) count as locked; if u releases them, (2)
    changes. The dry friction of the arm is included if it rotates.
    """
    angles = checks.array("q", q, (rope.n_links,), unit="rad")
    rates = checks.array("qd", qd, (rope.n_links,), unit="rad/s")
    angle, rate = checks.number("arm_angle", arm_angle), checks.number("arm_rate", arm_rate)
    chain, interval = rope.chain(), Interval(Setup(rope, None, arm).drive())
    interval.set(0.0, 1.0, ANGLE, [angle, rate, 0.0, 0.0, 0.0, 0.0])
    t, y = np.zeros(1), np.concatenate([angles, rates])[None]
    slip, outputs = senses(chain, interval.drive, t, y), (np.empty((1, rope.n_links)), np.empty((1, 9)))
    shaft = arm.shaft_torque(rope.gravity, np.array(angle), np.array(rate), np.zeros(()))

    def driven(u: float) -> tuple[Array, float]:
        """Rope accelerations (n,) and motor torque at the arm's acceleration u."""
        interval.set(0.0, 1.0, ANGLE, [angle, rate, 0.5 * u, 0.0, 0.0, 0.0])
        loads = np.empty((1, 5))
        observe(chain, interval.drive, t, y, slip, *outputs, loads)
        own = shaft + (arm.inertia + arm.mass * arm.com**2) * u
        return outputs[0][0].copy(), float(own + arm.rope_torque(angle, loads[:, 2:])[0])

    rest, unit = driven(0.0), driven(1.0)
    return PartialLinearization(rest[0], unit[0] - rest[0], unit[1] - rest[1], rest[1])


def input_from_torque(linear: PartialLinearization, tau: float) -> float:
    """Return u of (3), the arm's acceleration, rad/s^2, for a motor torque `tau`, N m."""
    return (checks.number("tau", tau, unit="N m") - linear.arm_bias) / linear.effective_inertia


def torque_from_input(linear: PartialLinearization, u: float) -> float:
    """Return the motor torque, N m, that gives the arm the acceleration `u`, rad/s^2: (3) solved for tau."""
    return linear.effective_inertia * checks.number("u", u, unit="rad/s^2") + linear.arm_bias


def _joined(rope: Rope, value: ArrayLike, name: str, unit: str, arm: Arm | None, own: float) -> Array:
    checks.instance("rope", rope, Rope)
    links = checks.array(name, value, (rope.n_links,), unit=unit)
    if arm is not None:
        checks.instance("arm", arm, Arm)
    arm_name = "arm_angle" if name == "q" else "arm_rate"
    return links if arm is None else np.append(checks.number(arm_name, own, unit=unit), links)
