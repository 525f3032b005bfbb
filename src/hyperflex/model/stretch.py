"""The same rope with links of other lengths."""

import numpy as np
import numpy.typing as npt

from hyperflex.checks import Array
from hyperflex.model.rope import Rope

MIDDLE = 1e-9  # part of its length by which a uniform link's centre of mass may be off its middle


def uniform(rope: Rope) -> npt.NDArray[np.bool_]:
    """Return which links (n,) have their centre of mass in their middle."""
    return np.asarray(np.abs(rope.com - 0.5 * rope.length) <= MIDDLE * rope.length)


def across(rope: Rope) -> Array:
    """Return the part of each link's inertia (n,) that its radius makes and its length does not, kg m^2."""
    return np.minimum(0.25 * rope.mass * rope.radius**2, rope.inertia)


def stretched(rope: Rope, length: npt.ArrayLike) -> Rope:
    """Return a rope with links of other lengths and the same masses.

    Parameters
    ----------
    rope : Rope
    length : (n,) array_like
        m.

    Returns
    -------
    Rope
        A uniform link's centre of mass stays in its middle, and its inertia grows with the square of its length, but
        for what the radius makes. Of other links both stay as they were: where their mass sits is not known.
    """
    new = np.broadcast_to(np.asarray(length, dtype=np.float64), rope.length.shape)
    moved = uniform(rope) & (new != rope.length)
    flat = across(rope)
    with np.errstate(over="ignore"):  # a rope refuses what is beyond all numbers
        grown = flat + (rope.inertia - flat) * (new / rope.length) ** 2
    return rope.replace(
        length=new, com=np.where(moved, 0.5 * new, rope.com), inertia=np.where(moved, grown, rope.inertia)
    )


def growth(rope: Rope, length: Array, change: Array) -> tuple[Array, Array]:
    """Return how centre of mass, m, and inertia, kg m^2, of :func:`stretched` change (n,) with its lengths.

    Parameters
    ----------
    rope : Rope
        Before it is stretched.
    length, change : (n,) float64
        The new lengths, m, and their change.
    """
    alike = uniform(rope)
    along = 2.0 * (rope.inertia - across(rope)) * length / rope.length**2
    return np.where(alike, 0.5 * change, 0.0), np.where(alike, along * change, 0.0)
