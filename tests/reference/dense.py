"""The planar chain by dense matrices: positions, Jacobians, virtual work. Nothing here knows of a recursion.

Every body is a point with a position x(q) and an orientation. With J = dx/dq the velocities are J w, the accelerations
J alpha + Jdot w + base, and Newton's and Euler's equations projected on the virtual displacements give::

    (sum m J^T J + diag(inertia)) alpha = sum m J^T (g - Jdot w - base) + Q

Q, the generalised forces of the joints, comes from the virtual work of each torque on the two links that it acts on.
All functions take any object with the fields of :class:`Links` (that of the package too). Angles are absolute:
0 hanging, positive towards +x; x right, y up. Arithmetic runs in ``dtype``; with ``numpy.longdouble`` (the default of
:func:`solve`) an ill-conditioned mass matrix costs digits that nobody needs, where the platform has an 80 bit type.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tests.reference import drag

Real = npt.NDArray[Any]


class Links(NamedTuple):
    """Parameters of a chain of n links: arrays (n,) in SI units, then scalars."""

    length: Real
    mass: Real
    com: Real
    inertia: Real
    viscous: Real
    dry: Real
    stiffness: Real
    rest: Real
    drag: Real
    max_bend: Real
    tip_mass: float
    gx: float
    gy: float
    reaction: float


class Answer(NamedTuple):
    """Accelerations alpha (n,); force (2,) of the base on the chain; torque that the parent gives to the first joint.

    The torque is that on the parent: with the printed friction, which has no reaction, only that of the spring.
    ``held`` (n,) is the friction torque of each stuck joint, 0 for the others.
    """

    alpha: Real
    force: Real
    torque: float
    held: Real


def directions(q: Real) -> tuple[Real, Real]:
    """Unit vectors along (n, 2) and across (n, 2) the links."""
    s, c = np.sin(q), np.cos(q)
    return np.stack([s, -c], axis=-1), np.stack([c, s], axis=-1)


def bodies(links: Any, dtype: Any = float) -> tuple[Real, Real]:
    """Masses (n+1,) and reach matrix (n+1, n): body k sits at base + sum_j reach[k, j] d_j. The last is the tip."""
    n = len(links.length)
    length, com = np.asarray(links.length, dtype), np.asarray(links.com, dtype)
    reach = np.tril(np.ones((n + 1, n), dtype), -1) * length
    reach[:n] += np.diag(com)
    return np.append(np.asarray(links.mass, dtype), dtype(links.tip_mass)), reach


def mass_matrix(links: Any, q: Real, dtype: Any = float) -> Real:
    """Joint-space mass matrix (n, n), kg m^2, as a sum over bodies of m J^T J."""
    q = np.asarray(q, dtype)
    mass, reach = bodies(links, dtype)
    _, across = directions(q)
    matrix = np.diag(np.asarray(links.inertia, dtype))
    for axis in range(2):
        jacobian = reach * across[:, axis]
        matrix = matrix + jacobian.T @ (mass[:, None] * jacobian)
    return matrix


class Joints(NamedTuple):
    """Joint torques in terms of what they act on: see :func:`joints`."""

    friction: Real  # (n,) torque on link i from the joint at its motor side, before any implicit term
    spring: Real  # (n,)
    friction_slope: Real  # (n,) loss of torque per relative acceleration, kg m^2
    spring_slope: Real  # (n,)
    friction_work: Real  # (n, n) virtual work: generalised force = friction_work @ friction
    spring_work: Real  # (n, n)
    relative: Real  # (n, n): relative rate = relative @ w - e_0 * parent rate


def joints(
    links: Any, q: Real, w: Real, parent: tuple[Any, Any], h: float = 0.0, dtype: Any = float, grip: Real | None = None
) -> Joints:
    """Joint torques at (q, w) relative to a parent with (angle, rate), with the slopes of an Euler step of h seconds.

    ``grip`` (n,) are the senses in which the joints slip, by default those of their rates.
    """
    n = len(links.length)
    q, w, h = np.asarray(q, dtype), np.asarray(w, dtype), dtype(h)
    relative = np.eye(n, dtype=dtype) - np.eye(n, k=-1, dtype=dtype)
    first = np.eye(n, dtype=dtype)[0]
    turn = relative @ q - first * dtype(parent[0])
    rate = relative @ w - first * dtype(parent[1])
    viscous, dry = np.asarray(links.viscous, dtype), np.asarray(links.dry, dtype)
    stiffness = np.asarray(links.stiffness, dtype)
    sense = np.sign(rate) if grip is None else np.asarray(grip, dtype)
    # A virtual turn of link i does work with the torque of its own joint and, if the joint reacts, with minus that of
    # the next joint. The printed friction has no reaction; the spring always has.
    one = np.eye(n, dtype=dtype)
    next_one = np.eye(n, k=1, dtype=dtype)
    return Joints(
        friction=-viscous * rate - dry * sense,
        spring=-stiffness * (turn + h * rate - np.asarray(links.rest, dtype)),
        friction_slope=h * viscous,
        spring_slope=h**2 * stiffness,
        friction_work=one - dtype(links.reaction) * next_one,
        spring_work=one - next_one,
        relative=relative,
    )


def solve(matrix: Real, right: Real) -> Real:
    """Solve in double precision; refine with the residual in the precision of the arguments, if that is higher."""
    coarse = np.asarray(matrix, float)
    x = np.zeros_like(right)
    for _ in range(1 if right.dtype == float else 8):
        x = x + np.linalg.solve(coarse, np.asarray(right - matrix @ x, float))
    return x


def accelerations(
    links: Any,
    q: Real,
    w: Real,
    base: Real,
    torque: Any = 0.0,
    h: float = 0.0,
    dtype: Any = np.longdouble,
    grip: Real | None = None,
) -> Answer:
    """Accelerations of the links for a given motion of the base, h > 0 with linearly implicit joints.

    A joint whose ``grip`` is 0 (and that has dry friction) is locked: its friction is an unknown torque, a Lagrange
    multiplier, with the condition of equal accelerations of both links.

    Parameters
    ----------
    q, w : (n,) rad, rad/s
    base : (7,) acceleration x, y of the first joint; alpha, rate and angle of the parent; velocity x, y of the joint.
    torque : N m on link 0, or (m,) on the first m links
    h : s
    """
    q, w, base = (np.asarray(value, dtype) for value in (q, w, base))
    mass, reach = bodies(links, dtype)
    along, across = directions(q)
    g = np.array([links.gx, links.gy], dtype)
    drift = base[:2] - (reach * w**2) @ along  # acceleration of each body if all alpha were zero, (n+1, 2)
    right = np.zeros_like(q)
    for axis in range(2):
        right = right + (reach * across[:, axis]).T @ (mass * (g[axis] - drift[:, axis]))
    external = np.atleast_1d(np.asarray(torque, dtype))
    right[: external.size] += external
    j = joints(links, q, w, (base[4], base[3]), h, dtype, grip)
    right = right + j.friction_work @ j.friction + j.spring_work @ j.spring
    airy = bool(np.any(np.asarray(links.drag) != 0.0))
    pushes, push, _ = drag.forces(links, q, w, base[5:7]) if airy else (np.zeros_like(q), np.zeros(2, dtype), 0.0)
    right = right + pushes
    matrix = mass_matrix(links, q, dtype)
    for work, slope in ((j.friction_work, j.friction_slope), (j.spring_work, j.spring_slope)):
        matrix = matrix + work @ (slope[:, None] * j.relative)
        right = right + work[:, 0] * slope[0] * base[2]
    locked = np.zeros(len(q), bool) if grip is None else (np.asarray(grip) == 0.0) & (np.asarray(links.dry) > 0.0)
    count, n = int(locked.sum()), len(q)
    whole = np.zeros((n + count, n + count), right.dtype)
    whole[:n, :n], whole[:n, n:], whole[n:, :n] = matrix, -j.friction_work[:, locked], j.relative[locked]
    known = np.concatenate([right - j.friction_work[:, locked] @ j.friction[locked], np.zeros(count, right.dtype)])
    if locked[0]:
        known[n] = base[2]
    both = solve(whole, known)
    alpha, held = both[:n], np.zeros_like(right)
    held[locked] = both[n:]
    force = mass @ (drift + (reach * alpha) @ across - g) - push
    torques = (
        torque - slope * (alpha[0] - base[2])
        for torque, slope in ((j.friction[0], j.friction_slope[0]), (j.spring[0], j.spring_slope[0]))
    )
    friction, spring = torques
    if locked[0]:
        friction = held[0]
    return Answer(alpha, force, dtype(links.reaction) * friction + spring, held)


def energies(links: Any, q: Real, w: Real, point: Real, velocity: Real, angle: Any = 0.0) -> tuple[Any, Any]:
    """Kinetic and potential energy, J, from positions and velocities of the bodies; springs included.

    Works for complex arguments too (no absolute value, no conjugate), which is what :mod:`lagrange` needs.
    """
    q, w = np.asarray(q), np.asarray(w)
    mass, reach = bodies(links)
    along, across = directions(q)
    x = point + reach @ along
    v = velocity + (reach * w) @ across
    kinetic = 0.5 * np.sum(mass * np.sum(v * v, axis=1)) + 0.5 * np.sum(links.inertia * w * w)
    turn = q - np.append(angle, q[:-1])
    spring = 0.5 * np.sum(links.stiffness * (turn - links.rest) ** 2)
    return kinetic, spring - np.sum(mass * (x @ np.array([links.gx, links.gy])))


def dissipation(
    links: Any, q: Real, w: Real, parent: tuple[float, float], grip: Real | None = None, velocity: Any = (0.0, 0.0)
) -> float:
    """Power lost in the joints and to the air, W: minus that of the friction torques on the links and on the parent.

    `velocity` (2,) is that of the first joint, m/s.
    """
    j = joints(links, q, w, parent, grip=grip)
    on_links = float(w @ (j.friction_work @ j.friction))
    air = float(drag.forces(links, q, w, np.asarray(velocity, float))[2])
    return air - (on_links - links.reaction * float(j.friction[0]) * parent[1])


def joint_positions(links: Any, q: Real, point: Real) -> Real:
    """Positions (n+1, 2) of the joints and the tip, m."""
    along, _ = directions(np.asarray(q))
    steps = np.asarray(links.length)[:, None] * along
    return np.asarray(point, float) + np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
