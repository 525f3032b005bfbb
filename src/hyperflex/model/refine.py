"""Refinement of a rope's links where it may wind round a peg."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from hyperflex import checks
from hyperflex.checks import Array, Flags, Integers
from hyperflex.errors import InvalidInput
from hyperflex.model.arm import Arm
from hyperflex.model.obstacles import Obstacle, Peg, checked_obstacles
from hyperflex.model.properties import LINK_PROPERTIES
from hyperflex.model.rope import MOST_LINKS, Rope, bend_limits, bend_ratios

MIDDLE = 1e-9  # fraction of its length by which a uniform link's centre of mass may be off its middle


def uniform(rope: Rope) -> Flags:
    """Return whether each link (n,) has its centre of mass in the middle."""
    return np.abs(rope.com - 0.5 * rope.length) <= MIDDLE * rope.length


def across(rope: Rope) -> Array:
    """Return the part of each link's inertia (n,) that is due to its radius, kg m^2."""
    return np.minimum(0.25 * rope.mass * rope.radius**2, rope.inertia)


def stretched(rope: Rope, length: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    """Return length, com and inertia, for `Rope.replace`, of links of other lengths and the same masses.

    Parameters
    ----------
    rope : Rope
    length : (n,) ndarray
        m; complex ones give complex values, for derivatives.

    Returns
    -------
    dict of str to (n,) ndarray
        The centre of mass keeps its fraction of the length; the inertia scales with the square of the length, except
        for the part of the radius.
    """
    ratio, flat = length / rope.length, across(rope)
    with np.errstate(over="ignore", invalid="ignore"):  # a rope refuses infinite values
        inertia = flat + (rope.inertia - flat) * ratio**2
    return {"length": length, "com": rope.com * ratio, "inertia": inertia}


FINE = 0.3  # longest link in radii of the rope's axis on the peg: slip sets in within 2 % of exp(mu theta)
COARSE = 1.0  # ratio above which a set-up's rope is reported to hold less: by 15 % at 2
MOST_PIECES = 10_000  # of a divided rope: with more of them a run takes hours


def refine_rope(rope: Rope, pegs: Sequence[Obstacle], *, arm: Arm | None = None, ratio: float = FINE) -> Rope:
    """Divide the links that may touch a peg, so that the wound polygon holds as much as a smooth rope.

    Parameters
    ----------
    rope : Rope
        Links to be divided must have their centre of mass in the middle.
    pegs : sequence of Peg, Wall or Ground
    arm : Arm, optional
        Arm from which the rope hangs; without one the rope hangs from the origin.
    ratio : float
        Longest link in radii of the rope's axis on the peg (peg radius plus rope radius), > 0.

    Returns
    -------
    Rope
        Rope of the same length and mass; links that cannot reach a peg are unchanged.

    Raises
    ------
    InvalidInput
        If a link to be divided is not uniform, or the peg so thin that more than MOST_PIECES would result.

    Notes
    -----
    A piece has its part of the mass, and an inertia that preserves that of the straight link (for the default inertia:
    that of the cylinder). Viscous friction and stiffness represent distributed bending. Those of a joint are therefore
    inversely proportional to the length that it represents, half of both its links, and linear between old joints of
    different values. The first joint is a hinge, whose angle does not depend on the number of links: it keeps its
    friction and stiffness, and the pieces of the first link bend like the second joint. Each joint keeps the full dry
    friction, a torque that any bending must overcome; a rest angle stays with its joint. Air drag is per length. Joint
    limits keep the bend radius (:meth:`Rope.with_bend_radius`).

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> fine = hf.refine_rope(cable, [hf.Peg(x=1.0, y=-0.5, radius=0.03)])
    >>> fine.n_links, bool(fine.length.min() <= 0.3 * 0.0325)
    (142, True)
    """
    return divided(rope, cuts(rope, pegs, arm=arm, ratio=ratio))


def divided(rope: Rope, pieces: ArrayLike) -> Rope:
    """Divide each link of a rope into pieces, see :func:`refine_rope`.

    Parameters
    ----------
    rope : Rope
        Links to be divided must have their centre of mass in the middle.
    pieces : int or (n,) array_like of int
        Pieces of each link, >= 1.

    Raises
    ------
    InvalidInput
        If a link to be divided is not uniform, or `pieces` does not fit.
    """
    given = checks.array("pieces", pieces, (rope.n_links,), scalar=True)
    pieces = given.astype(np.int64)
    if (given < 1.0).any() or (given != pieces).any():
        raise InvalidInput("pieces are not whole numbers from 1 on", got=given.tolist(), allowed="1, 2, ...")
    if (pieces == 1).all():
        return rope
    _refuse_uneven(rope, pieces > 1)
    flat = across(rope)  # scales with the mass; the inertia along the link also with its length squared
    parts = {name: getattr(rope, name) / pieces for name in ("length", "mass", "com")}
    parts["inertia"] = (rope.inertia - flat) / pieces**3 + flat / pieces
    parts |= {each.name: getattr(rope, each.name) for each in LINK_PROPERTIES if each.cut == "alike"}
    links = {name: np.repeat(value, pieces) for name, value in parts.items()}
    return rope.replace(**links, **_joints(rope, links["length"]))


def _refuse_uneven(rope: Rope, cut: Flags) -> None:
    """Refuse links to be divided (n,) that are not uniform."""
    uneven = cut & ~uniform(rope)
    if uneven.any():
        k = int(np.argmax(uneven))
        fix = "Give shorter links there, or what hangs at the tip as tip_mass"
        got = float(rope.com[k])
        raise InvalidInput(
            f"link {k} is not uniform, so it cannot be cut", got=got, allowed="com = length / 2", fix=fix
        )


def with_links(rope: Rope, n_links: int) -> Rope:
    """Divide a rope into another number of equal links; the new chain represents the same continuous rope.

    Parameters
    ----------
    rope : Rope
    n_links : int
        Number of links, at least 1.

    Returns
    -------
    Rope
        Friction and stiffness of its joints are inversely proportional to the length of a link, as in
        :func:`refine_rope`, except for the first joint, a hinge, which is unchanged. Mass is distributed evenly along
        each old link. If the rope has these links already, it is returned.

    Raises
    ------
    InvalidInput
        If a link is not uniform, or the number cannot be used.

    Notes
    -----
    Friction in the joints of links of length l represents the bending viscosity B = l eta of a continuous rope; for the
    paper's cable B = 2e-5 N m^2 s (docs/theory/continuum.md).

    Examples
    --------
    >>> import hyperflex as hf
    >>> cable = hf.Rope.uniform(length=2.0, mass=0.125, n_links=50, radius=0.0025, friction=5e-4)
    >>> fine = hf.with_links(cable, 200)
    >>> fine.n_links, round(float(fine.friction[1] / cable.friction[1]), 9)
    (200, 4.0)
    """
    checks.instance("rope", rope, Rope)
    checks.count("n_links", n_links, most=MOST_LINKS)
    ends = np.append(0.0, rope.link_ends)
    length = np.full(n_links, ends[-1] / n_links)
    if n_links == rope.n_links and np.allclose(rope.length, length, rtol=MIDDLE, atol=0.0):
        return rope
    _refuse_uneven(rope, np.ones(rope.n_links, dtype=np.bool_))
    cuts = np.linspace(0.0, ends[-1], n_links + 1)
    low, high = np.maximum(cuts[:-1, None], ends[:-1]), np.minimum(cuts[1:, None], ends[1:])
    part = np.maximum(high - low, 0.0)  # (new, old), m
    mass = part * (rope.mass / rope.length)
    middle = 0.5 * (low + high) - cuts[:-1, None]
    total = mass.sum(axis=1)
    com = (mass * middle).sum(axis=1) / np.maximum(total, 1e-300)
    flat = across(rope)  # as in `divided`, the rest of a link's inertia scales with the square of its length
    own = (rope.inertia - flat) / (rope.mass * rope.length**2)
    inertia = (mass * (part**2 * own + (middle - com[:, None]) ** 2 + flat / rope.mass)).sum(axis=1)
    alike = {each.name: part @ getattr(rope, each.name) / length for each in LINK_PROPERTIES if each.cut == "alike"}
    return rope.replace(length=length, mass=total, com=com, inertia=inertia, **alike, **_joints(rope, length))


def cuts(rope: Rope, pegs: Sequence[Obstacle], *, arm: Arm | None = None, ratio: float = FINE) -> Integers:
    """Return the number of pieces (n,) of each link in :func:`refine_rope`; ``np.repeat(q0, cuts(...))``: angles."""
    ratio = checks.number("ratio", ratio, sign="positive")
    rope, pegs = checks.instance("rope", rope, Rope), checked_obstacles(pegs)
    if arm is not None:
        checks.instance("arm", arm, Arm)
    reach, (x, y) = (0.0, (0.0, 0.0)) if arm is None else (arm.length, arm.pivot)
    far = reach + rope.link_ends  # largest one of each link's far joint
    pieces = np.ones(rope.n_links, dtype=np.int64)
    for peg in pegs:
        if not isinstance(peg, Peg):
            continue  # a rope does not wind round a straight obstacle
        axis = peg.radius + rope.radius
        near = far >= np.hypot(peg.x - x, peg.y - y) - axis
        needed = np.ceil(rope.length / (ratio * axis) - 1e-9)
        pieces = np.maximum(pieces, np.where(near, np.minimum(needed, 1e15), 1.0).astype(np.int64))
    if (total := float(pieces.sum(dtype=np.float64))) > max(MOST_PIECES, rope.n_links):
        raise InvalidInput(
            "the rope would need too many links to wind round a peg so thin",
            got=f"{total:.3g} links",
            allowed=f"up to {MOST_PIECES}",
            fix="Check the radii of peg and rope, which are in m, or give a larger ratio",
        )
    return pieces


def _share(length: Array) -> Array:
    """Length of rope that each joint represents (n,): half of both its links; meaningless for the first joint."""
    return 0.5 * (np.append(length[0], length[:-1]) + length)


def _joints(rope: Rope, length: Array) -> dict[str, Array]:
    """Return the joint properties of the same rope divided into links of other lengths (m,)."""
    old, new = (np.cumsum(each) - each for each in (rope.length, length))
    found = {}
    for each in LINK_PROPERTIES:
        value = getattr(rope, each.name)
        if each.cut == "joint":
            found[each.name] = np.interp(new, old, value)
        elif each.cut == "bending":
            found[each.name] = _along(value, rope.length, length)
        elif each.cut == "limit":
            found[each.name] = bend_limits(_along(bend_ratios(value), rope.length, length))
            found[each.name][0] = value[0]
        elif each.cut == "stays":
            found[each.name] = np.zeros(length.size)
            np.add.at(found[each.name], np.abs(new[:, None] - old).argmin(axis=0), value)
    return found


def _along(value: Array, length: Array, shorter: Array) -> Array:
    """Return the bending resistance of new joints from that of the old ones: equal per length, except at the hinge."""
    bending = value * _share(length)
    if bending.size > 1:
        bending[0] = bending[1]
    new = np.interp(np.cumsum(shorter) - shorter, np.cumsum(length) - length, bending) / _share(shorter)
    new[0] = value[0]
    return new
