"""Candidate models of a rope: resistances at the joints and numbers of links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from hyperflex import checks
from hyperflex.errors import InvalidInput
from hyperflex.identification.model.names import scales
from hyperflex.model import Rope
from hyperflex.model.properties import DAMPING, FREE, RESISTANCES, parsed
from hyperflex.model.refine import recut
from hyperflex.model.rope_table import MOST_LINKS

SLIGHT = 0.1  # of its scale, what a guess has none of at the start
MAX_ADDED = 2  # resistances added viscous friction in one candidate


@dataclass(frozen=True)
class Candidate:
    """A model to be fitted: a name, a guess and the words of ``free``."""

    name: str
    guess: Rope
    free: tuple[str, ...]

    def nested_in(self, other: Candidate) -> bool:
        """Tell whether all that is free here is free in `other` as well, which frees more."""
        return set(self.free) < set(other.free) and self.guess.n_links == other.guess.n_links

    def starting_guess(self, other: Candidate, rope: Rope) -> Rope:
        """Return the guess of `other` with the values fitted here, of `rope`; laws keep their guess."""
        labels = [label for word in self.free if (label := parsed(word)) and label.law in ("", "shared")]
        names = {label.name for label in labels if FREE[label.name].owner in ("link", "rope")} - {"gravity_angle"}
        return other.guess.replace(**{name: getattr(rope, name) for name in sorted(names)})


def candidates(
    guess: Rope, free: Sequence[str], models: Mapping[str, object] | None, links: Sequence[int]
) -> list[Candidate]:
    """Return the candidates, made of the arguments of :func:`compare_models`."""
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
    """Return a candidate of the user's."""
    if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], Rope):
        guess, value = value
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise InvalidInput(
            f"candidate {name!r} cannot be used", got=value, allowed="what is free, or a pair (guess, what is free)"
        )
    return Candidate(name, guess, tuple(value))


def _resistances(guess: Rope, free: Sequence[str]) -> list[Candidate]:
    """Return the viscous rope, alone and with one or two resistances added; and what else damps in its place.

    What is not free is 0 in them, but viscous friction that is not in `free`, which all have as given.
    """
    if isinstance(free, str):
        raise InvalidInput("free names no parameters", got=free, allowed="a list such as ['inertia', 'friction']")
    own: dict[str, tuple[str, ...]] = {}
    for word in free:
        label = parsed(word)
        own.setdefault(label.name if label else "", ())
        own[label.name if label else ""] += (word,)
    viscous, *added = RESISTANCES
    law = ":shared" if ":" in "".join(own.get(viscous.name, ())) else ""
    for each in added:  # started from 0 it may stay there: a joint that never sticks tells little of dry friction
        if each.least and not getattr(guess, each.name).any():
            guess = guess.replace(**{each.name: SLIGHT * scales(guess, each.name)})
    sets = [more for count in range(MAX_ADDED + 1) for more in combinations(added, count)]
    chosen = [(viscous, *more) for more in sets]
    varied = [*added, viscous] if viscous.name in own else added
    if viscous in varied:
        chosen += [those for those in sets if those and all(each.name in DAMPING for each in those)]
    plain = tuple(word for name, words in own.items() for word in words if name not in [each.name for each in varied])
    result = []
    for those in chosen:
        words = [word for each in those if each in varied for word in own.get(each.name, (each.name + law,))]
        absent = {each.name: 0.0 for each in varied if each not in those}
        name = " + ".join(each.field for each in those)
        result.append(Candidate(name, guess.replace(**absent), (*plain, *words)))
    return result
