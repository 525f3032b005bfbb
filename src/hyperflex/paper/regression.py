"""Linear regression of the equation of motion on its parameters (paper (4)-(6)).

The first moments p, the inertias J about the joints and all resistances enter the torques of a chain
linearly, and so do masses and inertias where lengths and centres of mass are known.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core.chain.air import link_drag
from hyperflex.errors import InvalidInput
from hyperflex.identification import lumped
from hyperflex.model import RESISTANCES, Rope, parse_label, unit_across, unit_along

LUMPED = ("p", "J", *(each.name for each in RESISTANCES))  # blocks of n columns, in this order
NAMES = ("inertia", "mass", "tip_mass", *LUMPED)
WITHIN = {"p": {"mass", "tip_mass"}, "J": {"inertia", "mass", "tip_mass"}}  # what a lumped one already contains
INSEPARABLE = 1e-10  # singular values below this part of the largest mean that columns cannot be told apart


@dataclass(frozen=True, eq=False)
class Regression:
    """Columns times unknown values = known torques (paper (5)); :meth:`solve` is (6).

    Attributes
    ----------
    names : tuple of str
        The unknowns, (P,): ``friction:shared``, ``inertia[2]``, ...
    columns : (T, n, P) float64
        Lambda: torque in each equation for one SI unit of each unknown, N m per unit.
    known : (T, n) float64
        tau_id: torques of the known part of the model, N m. NaN where a sample is missing.
    """

    names: tuple[str, ...]
    columns: Array
    known: Array

    def solve(self) -> "LeastSquares":
        """Return the least squares values (paper (6)).

        Raises
        ------
        InvalidInput
            If there are fewer equations than unknowns, two unknowns have the same effect in these data, or no known
            term has an effect.
        """
        used = np.isfinite(self.known) & np.isfinite(self.columns).all(axis=2)
        matrix, right = self.columns[used], self.known[used]
        if right.size <= len(self.names):
            raise InvalidInput("too few samples for the unknowns", got=right.size, allowed=f"> {len(self.names)}")
        if not right.any():
            raise InvalidInput(
                "nothing known acts: the unknowns are fixed only up to a common factor",
                got=list(self.names),
                fix="Leave one of them out of names, p[0] say, or give the rope its masses",
            )
        scale = np.sqrt((matrix**2).sum(axis=0))
        scale[scale == 0.0] = 1.0
        left, sizes, rows = np.linalg.svd(matrix / scale, full_matrices=False)
        if sizes[-1] <= INSEPARABLE * sizes[0]:
            alike = [name for name, part in zip(self.names, np.abs(rows[-1]), strict=True) if part > 1e-3]
            raise InvalidInput(
                "some unknowns act alike, or not at all, in these data",
                got=alike,
                fix="Leave one of them out of names, or record another motion",
            )
        values = (rows.T @ ((left.T @ right) / sizes)) / scale
        residual = self.known - self.columns @ values
        variance = float((residual[used] ** 2).sum()) / (right.size - values.size)
        covariance = variance * ((rows.T / sizes**2) @ rows) / np.outer(scale, scale)
        return LeastSquares(self.names, values, covariance, residual)


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """The result of :meth:`Regression.solve`.

    Attributes
    ----------
    names, values : tuple of str, (P,) float64
        The unknowns and their values, SI units, not bounded.
    covariance : (P, P) float64
        Of the values, for white errors in the known torques. Noise in the columns (rates and accelerations by
        differences) biases the values, and is not covered.
    residual : (T, n) float64
        Torques that are left, N m.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    residual: Array = field(repr=False)

    @property
    def std(self) -> Array:
        """Standard deviations (P,)."""
        return np.sqrt(np.diag(self.covariance))

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])


def fit_regression(
    rope: Rope,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    names: Sequence[str] = ("inertia:shared", "friction:shared"),
    *,
    pivot_velocity: ArrayLike | None = None,
    pivot_acceleration: ArrayLike | None = None,
    arm_angle: ArrayLike = 0.0,
    arm_rate: ArrayLike = 0.0,
) -> Regression:
    """Divide the equation of motion into terms with known and with unknown parameters (paper (4), (5)).

    Parameters
    ----------
    rope : Rope
        Values of all other parameters. Its friction model states on which links the friction of a joint acts: both
        ("relative", -eta S^T S qd) or the outer one only ("printed", -eta S qd, as (4) prints it).
    q, qd, qdd : (T, n) array_like
        Absolute angles, rad, rates, rad/s, and accelerations, rad/s^2; NaN marks gaps.
    names : sequence of str
        The unknowns: ``inertia`` (about the centre of mass), ``mass`` and the resistances, ``friction`` and others, of
        each link; ``friction[2]`` of one link, ``friction:shared`` one value for all; ``tip_mass``; the lumped moments
        ``p`` (kg m) and ``J`` (about the joint, kg m^2) of docs/notation.md. By default the paper's J and eta.
    pivot_velocity, pivot_acceleration : (T, 2) array_like, optional
        Velocity, m/s (only for air drag), and acceleration, m/s^2, of the first joint; by default it is fixed.
    arm_angle, arm_rate : (T,) array_like or float
        Angle, rad, and rate, rad/s, of the body to which the first joint is attached.

    Raises
    ------
    InvalidInput
        For unknown names, one unknown within another (``mass`` and ``p``), or shapes that do not fit.

    Notes
    -----
    Dry friction counts by the sign of the joint's rate, and is 0 at rate 0.

    Examples
    --------
    >>> import numpy as np
    >>> import hyperflex as hf
    >>> rope = hf.Rope.uniform(length=1.0, mass=0.01, n_links=5, friction=6e-4)
    >>> run = hf.simulate(rope, duration=2.0, q0=np.full(5, 0.3), tol=1e-8)
    >>> found = hf.fit_regression(rope, run.q, run.qd, run.qdd).solve()
    >>> f"{found['friction:shared']:.3e}"
    '6.000e-04'
    """
    n = checks.instance("rope", rope, Rope).n_links
    angles = checks.array("q", q, (-1, n), unit="rad", gaps=True)
    samples = angles.shape[:1]
    still = np.zeros((*samples, 2))
    torques = _inverse_dynamics(
        rope,
        angles,
        checks.array("qd", qd, angles.shape, unit="rad/s", gaps=True),
        checks.array("qdd", qdd, angles.shape, unit="rad/s^2", gaps=True),
        pivot_velocity=checks.array(
            "pivot_velocity", still if pivot_velocity is None else pivot_velocity, still.shape, unit="m/s"
        ),
        pivot_acceleration=checks.array(
            "pivot_acceleration", still if pivot_acceleration is None else pivot_acceleration, still.shape, unit="m/s^2"
        ),
        arm_angle=checks.array("arm_angle", arm_angle, samples, unit="rad", scalar=True),
        arm_rate=checks.array("arm_rate", arm_rate, samples, unit="rad/s", scalar=True),
    )
    unknowns = _unknowns(rope, names)
    p, J = lumped(rope)
    held = np.stack([p, J, *(getattr(rope, each.name) for each in RESISTANCES)])
    own = {"p": p, "J": J, "tip_mass": np.full(n + 1, rope.tip_mass)}
    sizes, columns = np.abs(held), []
    for _, name, links in unknowns:
        units = [_unit(rope, name, link) for link in links]
        columns.append(torques(np.sum(units, axis=0)))
        for unit, link in zip(units, links, strict=True):
            held -= (own[name] if name in own else getattr(rope, name))[link] * unit
    held[np.abs(held) <= 1e-12 * sizes] = 0.0  # rounding, where all of it is unknown
    return Regression(tuple(label for label, _, _ in unknowns), np.stack(columns, axis=2), -torques(held))


def _inverse_dynamics(
    rope: Rope,
    q: Array,
    qd: Array,
    qdd: Array,
    *,
    pivot_velocity: Array,
    pivot_acceleration: Array,
    arm_angle: Array,
    arm_rate: Array,
) -> Callable[[Array], Array]:
    """Return a function of the values (6, n) of LUMPED that returns the torques (T, n) of the equation of motion.

    Link j acts on its own joint with J_j and with p_j times the acceleration of that joint, and pushes all joints
    before it with p_j times the second derivative of its direction (docs/models.md (M.4)).
    """
    normal = unit_across(q)
    turn = qdd[..., None] * normal - (qd**2)[..., None] * unit_along(q)
    length = rope.length[:, None]
    joint = (pivot_acceleration - rope.gravity)[:, None] + np.cumsum(length * turn, axis=1) - length * turn
    swing = (rope.length * qd)[..., None] * normal
    across = ((pivot_velocity[:, None] + np.cumsum(swing, axis=1) - swing) * normal).sum(axis=2)
    rate = np.diff(qd, axis=1, prepend=arm_rate[:, None])
    bend = np.diff(q, axis=1, prepend=arm_angle[:, None]) - rope.rest_angle
    reaction = 1.0 if rope.friction_model == "relative" else 0.0

    def torques(values: Array) -> Array:
        p, J, viscous, dry, stiffness, drag = values
        friction, spring = viscous * rate + dry * np.sign(rate), stiffness * bend
        force, moment = link_drag(drag, rope.length, across, rope.length * qd)
        push = p[:, None] * turn + force[..., None] * normal
        beyond = np.cumsum(push[:, ::-1], axis=1)[:, ::-1] - push
        back = np.pad((reaction * friction + spring)[:, 1:], ((0, 0), (0, 1)))
        carried = (normal * (p[:, None] * joint + length * beyond)).sum(axis=2)
        return np.asarray(J * qdd + carried + moment + friction + spring - back)

    return torques


def _unit(rope: Rope, name: str, link: int) -> Array:
    """Return what a unit of a link's property adds to LUMPED's values (6, n); a tip mass is that of link n."""
    result = np.zeros((len(LUMPED), rope.n_links))
    if name in ("mass", "tip_mass"):
        place = np.arange(rope.n_links)
        result[0] = np.where(place < link, rope.length, np.where(place == link, rope.com, 0.0))
        result[1] = result[0] ** 2
    else:
        result[LUMPED.index("J" if name == "inertia" else name), link] = 1.0
    return result


def _unknowns(rope: Rope, names: Sequence[str]) -> list[tuple[str, str, list[int]]]:
    """Return label, property and links of each unknown; a property that is unknown twice is refused."""
    n, result = rope.n_links, list[tuple[str, str, list[int]]]()
    for given in [names] if isinstance(names, str) else checks.sequence("names", names, "names of unknowns"):
        label = parse_label(given)
        if label is None or label.name not in NAMES or label.law not in ("", "shared"):
            raise InvalidInput(
                "an unknown of the regression is not known",
                got=given,
                allowed=", ".join(NAMES) + "; friction[2] for one link, friction:shared for all",
            )
        name, links = label.name, list(range(n)) if label.place is None else [label.place]
        if links[-1] >= n or (name == "tip_mass" and given != name):
            raise InvalidInput("a name does not fit the rope", got=given, allowed=f"links 0 to {n - 1}")
        if name == "tip_mass":
            result.append((given, name, [n]))
        elif given == name:
            result += [(f"{name}[{k}]", name, [k]) for k in links]
        else:
            result.append((given, name, links))
    single = [(name, k) for _, name, links in result for k in links]
    present = {name for name, _ in single}
    if not single or len(set(single)) < len(single) or any(WITHIN[outer] & present for outer in present & set(WITHIN)):
        raise InvalidInput(
            "the unknowns of a regression overlap, or there are none",
            got=[label for label, _, _ in result],
            allowed="each parameter once; p or mass, J or inertia",
        )
    return result
