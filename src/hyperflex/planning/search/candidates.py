"""Candidates of a search: swings that strike and throws that were simulated in contact; which of them are alike."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from hyperflex.checks import Array
from hyperflex.planning.throw import LAST, Throw

APART = 0.1  # least difference of two swings that are not alike: strokes in half turns, or rests in periods
SCREENED = 4  # throws at once that are simulated with shorter links too
SHARED = 0.8  # fraction of a throw's loss with better links that other throws of the same swing lose too


class Swing(NamedTuple):
    """A free swing that strikes the peg at time t, s; x is its point (2 k + 4,)."""

    score: float
    side: int
    x: Array
    t: float


class Candidate(NamedTuple):
    """A throw that was simulated in contact with the peg: its score, and the turns that stay."""

    score: float
    turns: float
    side: int
    x: Array
    throw: Throw
    confirmed: bool = False  # whether score and turns take a run with shorter links into account
    t: float = np.inf  # s, of the strike


Point = TypeVar("Point", Swing, Candidate)


def distinct(some: Iterable[Point], others: Sequence[Point], count: int, apart: float = APART) -> list[Point]:
    """Return the first swings or throws, `count` at most, that are not near each other, nor near others."""
    found: list[Point] = []
    for one in some:
        if len(found) == count:
            break
        if not any(near(one, other, apart) for other in [*others, *found]):
            found.append(one)
    return found


def near(one: Swing | Candidate, other: Swing | Candidate, apart: float) -> bool:
    """Whether two points of one side differ by `apart` at most in every coordinate."""
    return one.side == other.side and bool(np.abs(one.x - other.x).max() <= apart)


def same_swing(one: Candidate, other: Candidate) -> bool:
    """Whether two throws are alike until the strike."""
    count, k = min(one.throw.count, other.throw.count), (one.x.size - LAST) // 2
    way = (one.x - other.x)[: 2 * k].reshape(2, k)[:, :count]
    return one.side == other.side and bool(np.abs(way).max() <= APART)


def unconfirmed(candidates: Sequence[Candidate], asked: float) -> list[Candidate]:
    """Return throws of `asked` turns that score better than the best confirmed one; the best of each swing."""
    found: list[Candidate] = []
    for one in candidates:
        if one.turns >= asked and (one.confirmed or len(found) == SCREENED):
            break
        if one.turns >= asked and not any(same_swing(one, other) for other in found):
            found.append(one)
    return found


def corrected(
    candidates: Sequence[Candidate], one: Candidate, turns: float, score: float, asked: float
) -> list[Candidate]:
    """Return the candidates, best first, with one corrected to the turns and the score of a better run.

    If it makes fewer turns than `asked` then, throws of the same swing, which mostly fail alike, lose SHARED of its
    loss; confirmed ones do so only if it was confirmed itself.
    """
    known = one._replace(score=min(one.score, score), turns=min(one.turns, turns), confirmed=True)
    lost, undone = SHARED * (one.score - known.score), SHARED * (one.turns - known.turns)

    def correct(each: Candidate) -> Candidate:
        if each.x is one.x:
            return known
        share = known.turns < asked and (one.confirmed or not each.confirmed) and same_swing(each, one)
        return each._replace(score=each.score - lost, turns=each.turns - undone) if share else each

    return sorted(map(correct, candidates), key=lambda each: -each.score)
