"""Candidate models of a rope: what resists the joints' turning, and how many links there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hyperflex import checks
from hyperflex.checks import Array
from hyperflex.errors import InvalidInput
from hyperflex.identification.model.parameters import lumped
from hyperflex.model import Rope
from hyperflex.model.rope import bend_limits, bend_ratios
from hyperflex.model.rope_table import LINK_FIELDS, MOST_LINKS

SLIGHT = 1e-3  # dry friction at the start, as a part of gravity's torque
RESISTANCES = ("dry_friction", "stiffness")  # beyond the viscous friction that every candidate may have


@dataclass(frozen=True)
class Candidate:
    """A model to be fitted: a name, a guess and the words of ``free``."""

    name: str
    guess: Rope
    free: tuple[str, ...]

    def within(self, other: Candidate) -> bool:
        """Tell whether all that is free here is free in `other` as well, which frees more."""
        return set(self.free) < set(other.free) and self.guess.n_links == other.guess.n_links

    def handed_on(self, other: Candidate, rope: Rope) -> Rope:
        """Return the guess of `other` with what was fitted here, to `rope`, as its start; laws keep their guess."""
        plain = [word for word in self.free if word.partition(":")[2] in ("", "shared")]
        names = {_property(word) for word in plain} & {*LINK_FIELDS, "tip_mass"}
        return other.guess.replace(**{name: getattr(rope, name) for name in sorted(names)})


def candidates(
    guess: Rope, free: Sequence[str], models: Mapping[str, object] | None, links: Sequence[int]
) -> list[Candidate]:
    """Return what is to be compared.

    Parameters
    ----------
    guess, free
        As given to ``compare_models``.
    models : mapping, optional
        Names to words of ``free``, or to a pair of a guess and words; None: viscous, + dry, + stiffness, all three.
    links : sequence of int
        Further numbers of links, each with `free` as it is.
    """
    if models is None:
        result = _resistances(guess, free)
    elif not isinstance(models, Mapping) or not models:
        raise InvalidInput("models names no candidates", got=models, allowed="a mapping of names to what is free")
    else:
        result = [_own(str(name), guess, value) for name, value in models.items()]
    simplest = result[0]
    for count in links:
        n = checks.count("links", count, most=MOST_LINKS)
        if n != guess.n_links:
            result.append(Candidate(f"{n} links", recut(simplest.guess, n), simplest.free))
    names = [each.name for each in result]
    if len(set(names)) < len(names):
        raise InvalidInput("two candidates have one name", got=names, allowed="each name once")
    return result


def _own(name: str, guess: Rope, value: object) -> Candidate:
    """Return a candidate that the user has made himself."""
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], Rope):
        guess, value = value
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InvalidInput(
            f"candidate {name!r} cannot be used", got=value, allowed="what is free, or a pair (guess, what is free)"
        )
    return Candidate(name, guess, tuple(value))


def _resistances(guess: Rope, free: Sequence[str]) -> list[Candidate]:
    """Return the viscous rope, and those with dry friction, stiffness or both; what is not free is 0 in them."""
    if isinstance(free, str):
        raise InvalidInput("free names no parameters", got=free, allowed="a list such as ['inertia', 'friction']")
    plain = tuple(word for word in free if _property(word) not in RESISTANCES)
    own = {_property(word): word for word in free}
    law = ":shared" if ":" in own.get("friction", "") else ""
    if not guess.dry_friction.any():  # started from 0 it may stay there: a joint that never sticks tells little of it
        guess = guess.replace(dry_friction=SLIGHT * lumped(guess)[0] * float(np.hypot(*guess.gravity)))
    result = []
    for name, beside in (
        ("viscous", ()),
        ("viscous + dry", RESISTANCES[:1]),
        ("viscous + stiffness", RESISTANCES[1:]),
        ("viscous + dry + stiffness", RESISTANCES),
    ):
        words = tuple(own.get(each, each + law) for each in beside)
        absent = {each: 0.0 for each in RESISTANCES if each not in beside}
        result.append(Candidate(name, guess.replace(**absent), plain + words))
    return result


def _property(word: object) -> str:
    return str(word).partition(":")[0].partition("[")[0]


def recut(rope: Rope, n_links: int) -> Rope:
    """Cut a rope into `n_links` equal links.

    Mass is spread evenly along each old link, so that new links have their part of it, their centre and inertia from
    there. A joint stands for the bending of the rope around it: what resists there, per length, is that of the old
    joints. The first joint is what the rope hangs from, and keeps its own.
    """
    ends = np.append(0.0, np.cumsum(rope.length))
    cuts = np.linspace(0.0, ends[-1], n_links + 1)
    low, high = np.maximum(cuts[:-1, None], ends[:-1]), np.minimum(cuts[1:, None], ends[1:])
    part = np.maximum(high - low, 0.0)  # (new, old), m
    mass = part * (rope.mass / rope.length)
    middle = 0.5 * (low + high) - cuts[:-1, None]
    total = mass.sum(axis=1)
    com = (mass * middle).sum(axis=1) / np.maximum(total, 1e-300)
    inertia = (mass * (part**2 / 12.0 + (middle - com[:, None]) ** 2)).sum(axis=1)
    length = np.full(n_links, ends[-1] / n_links)
    joints = {name: _joints(getattr(rope, name), rope.length, cuts, ends) for name in ("friction", *RESISTANCES)}
    joints["dry_friction"] = np.interp(cuts[:-1], ends[:-1], rope.dry_friction)
    limits = bend_limits(_joints(bend_ratios(rope.max_bend), rope.length, cuts, ends))
    return Rope(
        length,
        total,
        com,
        inertia + 0.25 * total * rope.radius**2,
        **joints,
        drag=part @ rope.drag / length,
        max_bend=np.append(rope.max_bend[0], limits[1:]),
        tip_mass=rope.tip_mass,
        gravity=rope.gravity,
        friction_model=rope.friction_model,
        radius=rope.radius,
        name=rope.name,
    )


def _joints(value: Array, length: Array, cuts: Array, ends: Array) -> Array:
    """Return the resistance of each new joint, in inverse proportion to the length whose bending it stands for."""
    new = np.diff(cuts)[0]
    if value.size == 1:
        return np.append(value, np.full(cuts.size - 2, value[0]))
    bending = value[1:] * 0.5 * (length[:-1] + length[1:])
    rest: Array = np.interp(cuts[1:-1], ends[1:-1], bending) / new
    return np.append(value[0], rest)
