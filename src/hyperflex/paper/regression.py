"""Linear regression of the equation of motion on its parameters (paper (4)-(6)).

The first moments p, the inertias J about the joints and all resistances enter the torques of a chain
linearly, and so do masses and inertias where lengths and centres of mass are known.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.core import joint_law
from hyperflex.core.chain.air import link_drag
from hyperflex.errors import InvalidInput
from hyperflex.identification import lumped
from hyperflex.model import RESISTANCES, Rope, parse_label

LUMPED = ("p", "J", *(each.name for each in RESISTANCES))  # blocks of n columns, in this order
NAMES = ("inertia", "mass", "tip_mass", *LUMPED)
WITHIN = {"p": {"mass", "tip_mass"}, "J": {"inertia", "mass", "tip_mass"}}  # what a lumped one already contains
ALIKE = 1e-10  # singular values below this part of the largest mean that columns cannot be told apart


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
            If there are fewer equations than unknowns, two unknowns act alike in these data, or nothing known acts.
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
        if sizes[-1] <= ALIKE * sizes[0]:
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
    """What :meth:`Regression.solve` found.

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
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    qdd: npt.ArrayLike,
    names: Sequence[str] = ("inertia:shared", "friction:shared"),
    *,
    pivot_velocity: npt.ArrayLike | None = None,
    pivot_acceleration: npt.ArrayLike | None = None,
    arm_angle: npt.ArrayLike = 0.0,
    arm_rate: npt.ArrayLike = 0.0,
) -> Regression:
    """Divide the equation of motion into terms with known and with unknown parameters (paper (4), (5)).

    Parameters
    ----------
    rope : Rope
        Values of what is not named; its friction model decides what the friction of a joint acts on:
        both links ("relative", -eta S^T S qd) or the outer one only ("printed", -eta S qd, as (4) prints it).
    q, qd, qdd : (T, n) array_like
        Absolute angles, rad, rates, rad/s, and accelerations, rad/s^2; NaN marks gaps.
    names : sequence of str
        The unknowns: ``inertia`` (about the centre of mass), ``mass`` and the resistances, ``friction`` and others, of
        each link; ``friction[2]`` of one link, ``friction:shared`` one value for all; ``tip_mass``; the lumped moments
        ``p`` (kg m) and ``J`` (about the joint, kg m^2) of docs/notation.md. By default the paper's J and eta.
    pivot_velocity, pivot_acceleration : (T, 2) array_like, optional
        Of the first joint, m/s (for air drag alone) and m/s^2; by default it stands still.
    arm_angle, arm_rate : (T,) array_like or float
        Of what the first joint is fixed to, rad and rad/s.

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
    shape = angles.shape
    rates = checks.array("qd", qd, shape, unit="rad/s", gaps=True)
    accelerations = checks.array("qdd", qdd, shape, unit="rad/s^2", gaps=True)
    moved = np.zeros((shape[0], 2)) if pivot_acceleration is None else pivot_acceleration
    moved = checks.array("pivot_acceleration", moved, (shape[0], 2), unit="m/s^2")
    velocity = np.zeros((shape[0], 2)) if pivot_velocity is None else pivot_velocity
    velocity = checks.array("pivot_velocity", velocity, (shape[0], 2), unit="m/s")
    arm_angle = checks.array("arm_angle", arm_angle, shape[:1], unit="rad", scalar=True)
    arm_rate = checks.array("arm_rate", arm_rate, shape[:1], unit="rad/s", scalar=True)
    unknowns = _unknowns(rope, names)
    every = np.concatenate(
        [
            *_moments(rope, angles, rates, accelerations, rope.gravity - moved),
            *_joints(rope, angles, rates, arm_angle, arm_rate),
            _drag(rope, angles, rates, velocity),
        ],
        axis=2,
    )
    held = np.concatenate([*lumped(rope), *(getattr(rope, each.name) for each in RESISTANCES)])
    sizes = np.abs(held)
    spread = np.zeros((held.size, len(unknowns)))
    for column, (_, name, links) in zip(spread.T, unknowns, strict=True):
        for part, own in (_lumped_part(rope, name, link) for link in links):
            column += part
            held -= own * part
    held[np.abs(held) <= 1e-12 * sizes] = 0.0  # rounding, where all of it is unknown
    return Regression(tuple(label for label, _, _ in unknowns), every @ spread, -(every @ held))


def _moments(rope: Rope, q: Array, qd: Array, qdd: Array, gravity: Array) -> tuple[Array, Array]:
    """Return the torques (T, n, n) of a unit of each p and of each J.

    M_ij = l_i p_j cos(q_i - q_j), i < j, so p_j acts on link j and on all before it (docs/models.md (M.4)).
    """
    samples, n = q.shape
    apart = q[:, :, None] - q[:, None, :]
    # l_i times the acceleration of link j's direction, seen along link i's normal
    pull = np.cos(apart) * qdd[:, None, :] + np.sin(apart) * (qd**2)[:, None, :]
    first = np.where(np.arange(n)[:, None] < np.arange(n), rope.length[:, None] * pull, 0.0)
    carried = np.einsum("tjk,k->tj", np.tril(pull, -1), rope.length)
    weight = gravity[:, :1] * np.cos(q) + gravity[:, 1:] * np.sin(q)
    diagonal = np.arange(n)
    first[:, diagonal, diagonal] = carried - weight
    second = np.zeros((samples, n, n))
    second[:, diagonal, diagonal] = qdd
    return first, second


def _joints(rope: Rope, q: Array, qd: Array, angle: Array, rate: Array) -> tuple[Array, Array, Array]:
    """Return the torques (T, n, n) of a unit of viscous and dry friction and stiffness, in this order."""
    turning = np.diff(qd, axis=1, prepend=rate[:, None])
    bent = np.diff(q, axis=1, prepend=angle[:, None]) - rope.rest_angle
    share = 1.0 if rope.friction_model == "relative" else 0.0
    onto, back = np.eye(rope.n_links), np.eye(rope.n_links, k=1)

    def unit(*seed: float) -> Array:
        law = joint_law.variation((0.0,) * 4, seed, share, bent, turning, 0.0, np.sign(turning), 0.0, 0.0)
        return np.asarray(back * law[1][:, None, :] - onto * law[0][:, None, :])

    return unit(1.0, 0.0, 0.0, 0.0), unit(0.0, 1.0, 0.0, 0.0), unit(0.0, 0.0, 1.0, 0.0)


def _drag(rope: Rope, q: Array, qd: Array, pivot: Array) -> Array:
    """Return the torques (T, n, n) of a unit of air drag on each link; the first joint moves at `pivot` (T, 2), m/s."""
    length, normal = rope.length, np.stack([np.cos(q), np.sin(q)], axis=2)
    turn = (length * qd)[:, :, None] * normal
    across = ((pivot[:, None] + np.cumsum(turn, axis=1) - turn) * normal).sum(axis=2)
    force, moment = link_drag(1.0, length, across, length * qd)
    carried = length[:, None] * np.cos(q[:, :, None] - q[:, None, :]) * force[:, None, :]
    return np.asarray(np.triu(carried, 1) + np.eye(rope.n_links) * moment[:, None, :])


def _unknowns(rope: Rope, names: Sequence[str]) -> list[tuple[str, str, list[int]]]:
    """Return label, property and links of each unknown."""
    result = []
    for given in [names] if isinstance(names, str) else checks.sequence("names", names, "names of unknowns"):
        label = parse_label(given)
        if label is None or label.name not in NAMES or label.law not in ("", "shared"):
            raise InvalidInput(
                "an unknown of the regression is not known",
                got=given,
                allowed=", ".join(NAMES) + "; friction[2] for one link, friction:shared for all",
            )
        name = label.name
        links = list(range(rope.n_links)) if label.place is None else [label.place]
        if links[-1] >= rope.n_links or (name == "tip_mass" and given != name):
            raise InvalidInput("a name does not fit the rope", got=given, allowed=f"links 0 to {rope.n_links - 1}")
        if name == "tip_mass" or given != name:
            result.append((given, name, [0] if name == "tip_mass" else links))
        else:
            result += [(f"{name}[{k}]", name, [k]) for k in links]
    _refuse_overlaps(result)
    return result


def _refuse_overlaps(unknowns: list[tuple[str, str, list[int]]]) -> None:
    """Refuse an empty list, and what is there twice: ``friction[1]`` in ``friction:shared``, ``mass`` in ``p``."""
    single = [(name, k) for _, name, links in unknowns for k in links]
    present = {name for name, _ in single}
    within = [inner for outer in present & set(WITHIN) for inner in WITHIN[outer] & present]
    if not single or within or len(set(single)) < len(single):
        raise InvalidInput(
            "the unknowns of a regression overlap, or there are none",
            got=[label for label, _, _ in unknowns],
            allowed="each parameter once; p or mass, J or inertia",
        )


def _lumped_part(rope: Rope, name: str, link: int) -> tuple[Array, float]:
    """Return what a unit of a link's property adds to LUMPED, (n,) of each, and its own value."""
    n = rope.n_links
    result = np.zeros((len(LUMPED), n))
    if name in LUMPED:
        result[LUMPED.index(name), link] = 1.0
        own = dict(zip(("p", "J"), lumped(rope), strict=True))
        return result.ravel(), float((own[name] if name in own else getattr(rope, name))[link])
    if name == "tip_mass":
        result[0], result[1] = rope.length, rope.length**2
        return result.ravel(), rope.tip_mass
    if name == "inertia":
        result[1, link] = 1.0
    else:
        result[0, :link], result[0, link] = rope.length[:link], rope.com[link]
        result[1, :link], result[1, link] = rope.length[:link] ** 2, rope.com[link] ** 2
    return result.ravel(), float(getattr(rope, name)[link])
